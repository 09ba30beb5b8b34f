"""The fleet on a map: KML for Google Earth, GeoJSON for GIS. Straight legs as uploaded, homes and goals."""

from __future__ import annotations

import json
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from missionplanner.geodesy import FloatArray
from missionplanner.plan import FleetPlan, VehiclePlan

# aabbggrr, as KML wants it; the colours of the Okabe-Ito palette, apart for colour-blind eyes too
_COLOURS = ("ffb27200", "ff009fe6", "ff739e00", "ffa779cc", "ff005ed5", "ffe9b456", "ff42e4f0")


def _route_m(vehicle: VehiclePlan) -> FloatArray:
    """Return home and all waypoints (1 + W, 3)."""
    return np.vstack([vehicle.home_m, vehicle.waypoints_m])


def fleet_kml(plan: FleetPlan) -> str:
    """Return a KML document: per vehicle its legs, home and goal. KML's absolute altitudes are AMSL (EGM96)."""
    folders = []
    for k, vehicle in enumerate(plan.vehicles):
        lat_deg, lon_deg, alt_amsl_m = plan.frame.to_geo(_route_m(vehicle))
        places = [f"{lon:.7f},{lat:.7f},{alt:.3f}" for lat, lon, alt in zip(lat_deg, lon_deg, alt_amsl_m, strict=True)]
        name = escape(vehicle.name)
        summary = escape(
            f"sysid {vehicle.sysid}, {vehicle.autopilot} {vehicle.vehicle_class}, {vehicle.length_m:.0f} m at "
            f"{vehicle.speed_m_s:.2f} m/s, arrival {vehicle.arrival_s:.1f} s after the start"
        )
        colour = _COLOURS[k % len(_COLOURS)]
        folders.append(f"""  <Folder>
    <name>{name}</name>
    <description>{summary}</description>
    <Placemark>
      <name>{name}: path</name>
      <Style><LineStyle><color>{colour}</color><width>3</width></LineStyle></Style>
      <LineString><altitudeMode>absolute</altitudeMode><coordinates>{" ".join(places)}</coordinates></LineString>
    </Placemark>
    <Placemark>
      <name>{name}: home</name>
      <Point><altitudeMode>absolute</altitudeMode><coordinates>{places[0]}</coordinates></Point>
    </Placemark>
    <Placemark>
      <name>{name}: goal</name>
      <Point><altitudeMode>absolute</altitudeMode><coordinates>{places[-1]}</coordinates></Point>
    </Placemark>
  </Folder>
""")
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2">
<Document>
  <name>{escape(plan.mission.name)}</name>
  <description>{escape(plan.mission.description)}</description>
{"".join(folders)}</Document>
</kml>
"""


def fleet_geojson(plan: FleetPlan) -> str:
    """Return a GeoJSON feature collection (RFC 7946): per vehicle its legs, home and waypoints.

    Coordinates are two-dimensional: RFC 7946's third number is above the ellipsoid. Altitudes AMSL are properties.
    """
    features: list[dict[str, Any]] = []
    for vehicle in plan.vehicles:
        lat_deg, lon_deg, alt_amsl_m = plan.frame.to_geo(_route_m(vehicle))
        places = [[round(float(lon), 7), round(float(lat), 7)] for lat, lon in zip(lat_deg, lon_deg, strict=True)]
        alts_m = [round(float(alt), 3) for alt in alt_amsl_m]
        common = {"vehicle": vehicle.name, "sysid": vehicle.sysid}
        path = {
            **common,
            "kind": "path",
            "autopilot": vehicle.autopilot,
            "class": vehicle.vehicle_class,
            "speed_m_s": vehicle.speed_m_s,
            "length_m": round(vehicle.length_m, 3),
            "arrival_s": round(vehicle.arrival_s, 3),
            "alt_amsl_m": alts_m,
        }
        features.append(_feature("LineString", places, path))
        features.append(_feature("Point", places[0], {**common, "kind": "home", "alt_amsl_m": alts_m[0]}))
        for number, (place, alt_m) in enumerate(zip(places[1:], alts_m[1:], strict=True)):
            kind = "goal" if number == len(vehicle.waypoints_m) - 1 else "waypoint"
            reached_s = round(float(vehicle.reached_s[number]), 3)
            properties = {**common, "kind": kind, "number": number, "alt_amsl_m": alt_m, "reached_s": reached_s}
            features.append(_feature("Point", place, properties))
    return json.dumps({"type": "FeatureCollection", "name": plan.mission.name, "features": features}, indent=2) + "\n"


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }
