"""The fleet on a map: well-formed, in the right order of coordinates, at AMSL altitudes."""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

import pytest

from adapters.geo_files import fleet_geojson, fleet_kml
from tests.plans import fleet_plan, small_fleet, vehicle_plan

_KML = {"k": "http://www.opengis.net/kml/2.2"}


def test_kml_holds_every_leg() -> None:
    plan = small_fleet("ardupilot")
    root = ET.fromstring(fleet_kml(plan))
    assert root.findtext("k:Document/k:description", namespaces=_KML) == plan.mission.description
    folders = root.findall("k:Document/k:Folder", _KML)
    assert [folder.findtext("k:name", namespaces=_KML) for folder in folders] == ["uav1", "uav2", "uav3"]
    for vehicle, folder in zip(plan.vehicles, folders, strict=True):
        text = folder.findtext(".//k:LineString/k:coordinates", namespaces=_KML)
        assert text is not None
        places = [[float(value) for value in place.split(",")] for place in text.split()]
        assert len(places) == 1 + len(vehicle.waypoints_m)
        assert {e.text for e in folder.findall(".//k:altitudeMode", _KML)} == {"absolute"}
        for (lon, lat, alt), point_m in zip(places[1:], vehicle.waypoints_m, strict=True):
            geo = plan.frame.geo_point(point_m)
            assert (lon, lat) == pytest.approx((geo.lon_deg, geo.lat_deg), abs=1e-7)
            assert alt == pytest.approx(point_m[2], abs=1e-3)


def test_geojson_is_longitude_first_and_says_its_datum() -> None:
    plan = fleet_plan(vehicle_plan("a", 1), vehicle_plan("b", 2, autopilot="px4"))
    document = json.loads(fleet_geojson(plan), parse_constant=pytest.fail)
    assert document["type"] == "FeatureCollection"
    kinds = [(f["properties"]["vehicle"], f["properties"]["kind"]) for f in document["features"]]
    assert kinds == [(v, k) for v in "ab" for k in ("path", "home", "waypoint", "waypoint", "goal")]
    path, home, *_, goal = document["features"][:5]
    assert path["geometry"]["type"] == "LineString"
    assert home["geometry"]["coordinates"] == [-118.18, 34.36]
    assert path["properties"]["alt_amsl_m"] == [1200.0, 1230.0, 1251.25, 1244.5]
    assert goal["geometry"]["coordinates"] == path["geometry"]["coordinates"][-1]
    assert goal["properties"]["reached_s"] == path["properties"]["arrival_s"]
