from __future__ import annotations

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.map_tags import MapFeature, height_m, iso_dates, kind, plain, unread_heights, value, voltage_kv


def feature(shape: str = "point", *, osm: bool = False, places: int = 2, **tags: str) -> MapFeature:
    spelled = {name.replace("__", ":"): text for name, text in tags.items()}
    at_deg = np.zeros((1 if shape == "point" else places, 2))
    return MapFeature(shape, at_deg, spelled, "map, feature 1", openstreetmap=osm)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("Höhe [m]", "hoehe_m"),
        ("LETZTE BEGEHUNG", "letzte_begehung"),
        ("tower:height", "tower:height"),
        ("Mast-Nr.", "mast_nr"),
        ("@id", "@id"),
        ("Última inspección", "ultima_inspeccion"),
    ],
)
def test_names_are_read_in_any_spelling(written: str, name: str) -> None:
    assert plain(written) == name


def test_names_that_shapefiles_cut_off_are_known() -> None:
    assert value({"last_inspe": "2024-05-04"}, ("last_inspected",)) == ("last_inspected", "2024-05-04")
    assert value({"last_insp": "2024-05-04"}, ("last_inspected",)) is None


@pytest.mark.parametrize(
    ("tags", "metres"),
    [
        ({"height": "35"}, 35.0),
        ({"height": "35,5"}, 35.5),
        ({"hoehe_m": "35.5 m"}, 35.5),
        ({"tower:height": "~40"}, 40.0),
        ({"height": "100 ft"}, 30.48),
        ({"height": "100'"}, 30.48),
        ({"height_ft": "100"}, 30.48),
        ({"structure_": "22"}, 22.0),
        ({plain("Höhe über Grund"): "51,5"}, 51.5),
        ({plain("Höhe ü. Grund [m]"): "51,5"}, 51.5),
    ],
)
def test_heights_are_read_with_their_units(tags: dict[str, str], metres: float) -> None:
    found = height_m(feature(**tags))
    assert found is not None
    assert found[1] == pytest.approx(metres)


@pytest.mark.parametrize("tags", [{"ele": "431"}, {"ground_elev_m": "431"}, {"elevation": "431"}, {"z": "431"}, {}])
def test_elevations_are_no_heights(tags: dict[str, str]) -> None:
    assert height_m(feature(**tags)) is None


def test_columns_that_may_be_heights_and_are_not_read_are_told() -> None:
    assert unread_heights(feature(hoehe_uebe="51", name="T1", ele="431", hoehe_nn="480", hoehenlinie="x")) == (
        "hoehe_uebe",
        "hoehenlinie",
    )
    assert unread_heights(feature(hoehe_uebe="51", height="51")) == ()


@pytest.mark.parametrize("text", ["tall", "-3", "0", "35 cm", "1e400"])
def test_a_height_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(MissionError, match="map, feature 1: expected a height in metres"):
        height_m(feature(height=text))


@pytest.mark.parametrize("text", ["tall", "30;35", "0", "431", "1.5"])
def test_what_volunteers_wrote_and_nobody_can_read_is_no_height(text: str) -> None:
    assert height_m(feature(osm=True, power="tower", height=text)) is None


@pytest.mark.parametrize(
    ("tags", "osm", "kv"),
    [
        ({"voltage": "110000"}, True, 110.0),
        ({"voltage": "110000;20000"}, True, 110.0),
        ({"voltage": "20000;110000"}, True, 110.0),
        ({"voltage": "400"}, True, 0.4),
        ({"voltage": "110"}, True, 110.0),  # against the rules of tagging, and what is meant is plain
        ({"voltage": "110"}, False, 110.0),
        ({"voltage": "380"}, False, 380.0),
        ({"voltage": "110000"}, False, 110.0),
        ({"spannung": "110 kV"}, False, 110.0),
        ({"spannung": "110/20 kV"}, False, 110.0),
        ({"voltage_kv": "16,7"}, False, 16.7),
        ({"voltage": "400 V"}, False, 0.4),
        ({"voltage": "medium"}, True, None),
        ({"voltage": "0"}, True, None),
        ({}, True, None),
    ],
)
def test_voltages_are_read_as_volts_or_kilovolts(tags: dict[str, str], osm: bool, kv: float | None) -> None:
    assert voltage_kv(feature("line", osm=osm, **tags)) == kv


@pytest.mark.parametrize(
    ("thing", "is_a"),
    [
        (feature(power="tower"), "tower"),
        (feature(power="pole"), "tower"),
        (feature(power="portal"), "tower"),
        (feature(power="transformer"), "other"),
        (feature(disused__power="tower"), "tower"),
        (feature(osm=True, highway="crossing"), "other"),
        (feature(name="T1"), "tower"),
        (feature(type="Umspannwerk"), "other"),
        (feature(type="Tragmast"), "tower"),
        (feature(aerialway="pylon"), "pylon"),
        (feature(aerialway="station"), "other"),
        (feature(man_made="chimney"), "mast"),
        (feature(man_made="survey_point"), "other"),
        (feature(power="generator", generator__source="wind"), "turbine"),
        (feature(power="generator", generator__source="solar"), "other"),
        (feature("line", power="line"), "power"),
        (feature("line", power="minor_line"), "power"),
        (feature("line", power="line", location="underground"), "underground"),
        (feature("line", power="minor_line", position="underground"), "underground"),
        (feature("line", power="cable"), "underground"),
        (feature("line", power="cable", location="overhead"), "power"),
        (feature("line", power="cable", location="underwater"), "underground"),
        (feature("line", aerialway="chair_lift"), "aerialway"),
        (feature("line", aerialway="magic_carpet"), "other"),
        (feature("line", osm=True, highway="path"), "other"),
        (feature("line", name="110 kV A - B"), "power"),
        (feature(type="Trafomast"), "tower"),
        (feature(type="Maststation"), "tower"),
        (feature(type="Trafostation"), "other"),
        (feature(disused__man_made="mast"), "mast"),
        (feature("area", power="tower"), "tower"),
        (feature("line", places=5, power="tower"), "tower"),
        (feature("line", osm=True, power="portal"), "tower"),
        (feature("area", aerialway="pylon"), "pylon"),
        (feature("line", art="Luftkabel"), "power"),
        (feature("line", type="overhead cable"), "power"),
        (feature("line", type="cable"), "underground"),
        (feature("line", art="Erdkabel"), "underground"),
        (feature("line", art="Seilbahn"), "aerialway"),
        (feature("line", places=5, man_made="silo"), "mast"),
        (feature("area", man_made="silo"), "mast"),
        (feature("area", name="Betriebsgelände"), "other"),
    ],
)
def test_what_a_thing_is(thing: MapFeature, is_a: str) -> None:
    assert kind(thing) == is_a


def test_a_year_or_month_counts_from_its_first_day() -> None:
    assert iso_dates([("a", "2023"), ("b", "2023-05"), ("c", "2023/7")]) == {
        "a": "2023-01-01",
        "b": "2023-05-01",
        "c": "2023-07-01",
    }


@pytest.mark.parametrize("text", ["31.02.2024", "soon", "2024-13-01", "04.05.24", "12345", "32/01/2024", "May 2024"])
def test_what_is_no_date_is_refused(text: str) -> None:
    with pytest.raises(MissionError, match="row 1: expected a date"):
        iso_dates([("row 1", text)])
