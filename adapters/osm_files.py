"""OpenStreetMap's own files, XML and PBF: what carries or is a line, and what stands in the way."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import osmium

from missionplanner.errors import MissionError
from missionplanner.map_tags import KEYS, MapFeature, plain

_MAX_VERTICES = 2_000_000


def read_osm(path: Path, name: str, most: int) -> Iterator[MapFeature]:
    """Yield the tagged nodes and ways that matter; the file is read thrice, so that its size does not fill the memory.

    Ways whose nodes are not all in the file (extracts cut them) are told in pieces.

    Raises
    ------
    MissionError
        A damaged file, or more than ``most`` features.
    """
    if path.suffix.lower() == ".osm":
        with path.open("rb") as file:
            if b"<!ENTITY" in file.read(65536):
                raise MissionError(f"{name}: expected OpenStreetMap XML without entities of its own, got some")
    keys = osmium.filter.KeyFilter(*KEYS)
    try:
        ways = [
            (way.id, tuple(node.ref for node in way.nodes), _tags(way))
            for way in _objects(path, osmium.osm.WAY, keys, name, most)
        ]
        refs = {ref for _, nodes, _ in ways for ref in nodes}
        tagged = [
            (node.id, (node.location.lat, node.location.lon), _tags(node))
            for node in _objects(path, osmium.osm.NODE, keys, name, most)
            if node.location.valid()
        ]
        wanted = osmium.filter.IdFilter(refs)
        places = {
            node.id: (node.location.lat, node.location.lon)
            for node in (_objects(path, osmium.osm.NODE, wanted, name, _MAX_VERTICES) if refs else ())
            if node.location.valid()
        }
    except (RuntimeError, OSError, ValueError, osmium.InvalidLocationError) as error:
        reason = " ".join(str(error).split())
        raise MissionError(f"{name}: expected an OpenStreetMap file, got a damaged one: {reason[:300]}") from error
    for number, place, tags in tagged:
        yield MapFeature("point", np.array([place]), tags, f"{name}, node {number}", str(number), (), True)
    for number, nodes, tags in ways:
        for known, run in itertools.groupby(nodes, key=places.__contains__):
            piece = list(run)
            if known and len(piece) > 1:
                at_deg = np.array([places[ref] for ref in piece])
                ids = tuple(map(str, piece))
                yield MapFeature("line", at_deg, tags, f"{name}, way {number}", "", ids, True)


def _objects(path: Path, what: Any, keys: Any, name: str, most: int) -> Iterator[Any]:
    for count, thing in enumerate(osmium.FileProcessor(str(path), what).with_filter(keys)):
        if count >= most:
            raise MissionError(f"{name}: expected at most {most} features, got more: cut it first (osmium extract)")
        yield thing


def _tags(thing: Any) -> dict[str, str]:
    return {plain(tag.k): tag.v.strip() for tag in thing.tags if tag.v.strip()}
