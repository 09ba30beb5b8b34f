"""Open missions along small lines, for tests of views, coverage and inspections."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from missionplanner.mission import Mission
from missionplanner.scene import Scene, build_check_scene
from tests.scenes import at, question

STRAIGHT = ((0.0, 0.0), (0.0, 200.0), (0.0, 400.0))
"""Three towers along a line that runs north."""


def open_question(places: Sequence[tuple[float, float]] = STRAIGHT, **changes: Any) -> dict[str, Any]:
    """Return an open mission of two copters that inspects towers T1, T2, ... at places, 35 m high, on level ground.

    What is not a field of missions is one of the inspection: ``views``, ``spans``, ``lines``, ``camera`` ...
    """
    towers = [{"name": f"T{k + 1}", **at(x, y), "height_m": 35.0} for k, (x, y) in enumerate(places)]
    own = {name: changes.pop(name) for name in list(changes) if name not in Mission.model_fields}
    inspection = {"towers": towers, "assignment": {}} | own
    homes = [{"name": "alpha", "home": at(-150.0, -50.0)}, {"name": "bravo", "home": at(-150.0, 0.0)}]
    return question(*homes) | {"inspection": inspection} | changes


def open_scene(data: dict[str, Any], folder: Path = Path()) -> Scene:
    """Return the scene of an open mission: no routes."""
    return build_check_scene(Mission.model_validate(data), folder, [])
