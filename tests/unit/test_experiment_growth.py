"""The growth and kernel experiments: what they plan and count, and the laws that they find."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import growth, kernel
from missionplanner.experiments.growth import Measured
from missionplanner.mission import parse_mission


def test_growth_is_the_power_of_what_was_planned() -> None:
    measured = [Measured("vehicles", n, 0.0, 1e-3 * n**1.5, 1.0, 1.0, "") for n in (1, 5, 20)]
    measured.append(Measured("vehicles", 100, 0.0, 1e-9, 1.0, 1.0, "no way"))
    assert growth.exponent(measured, "vehicles") == pytest.approx(1.5)
    assert growth.exponent(measured, "obstacles") is None
    text = growth.report(measured)
    assert "size^1.50" in text and "no plan: no way" in text


@pytest.mark.parametrize(("vehicles", "obstacles"), [(1, 10), (3, 7), (1, 200)])
def test_missions_have_what_they_say_and_free_ends(vehicles: int, obstacles: int) -> None:
    mission = parse_mission(growth.mission_text(vehicles, obstacles, 1), "growth")
    assert len(mission.vehicles) == vehicles
    assert len(mission.obstacles) == vehicles * obstacles


def test_hills_have_about_so_many_cells(tmp_path: Path) -> None:
    side = growth.write_hills(tmp_path / "hills.tif", 250_000)
    assert side == 500
    assert (tmp_path / "hills.tif").stat().st_size >= 4 * side * side


def test_a_made_instance_is_what_the_objective_takes() -> None:
    instance = kernel.made(1, 15)
    assert len(instance.arrays.threat) == 15
    assert np.isfinite(instance.price(0.5 * (instance.lower + instance.upper)[np.newaxis])).all()
    assert kernel.objective_flops(10, 30) > kernel.objective_flops(10, 15) > 0.0


def test_kernel_refuses_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"expected a folder with instances"):
        kernel.main(tmp_path / "out", instances=tmp_path, quick=True)
    with pytest.raises(MissionError, match="--yardstick: expected a Python file"):
        kernel.main(tmp_path / "out", yardstick=tmp_path / "none.py", quick=True)
    (tmp_path / "other.py").write_text("x = 1\n")
    with pytest.raises(MissionError, match="expected a class Inst"):
        kernel.main(tmp_path / "out", yardstick=tmp_path / "other.py", quick=True)
    for content, told in (
        ("x = (\n", "SyntaxError"),
        ("import no_such_module\n", "no_such_module"),
        ("class Inst:\n    def __init__(self, name):\n        pass\n", "TypeError"),
        ("class Inst:\n    def __init__(self, *a):\n        pass\n", "fb"),
    ):
        (tmp_path / "other.py").write_text(content)
        with pytest.raises(MissionError, match=f"--yardstick: expected an implementation.*{told}") as error:
            kernel._beside(kernel._yardstick(tmp_path / "other.py"), kernel.made(1, 3, 100))
        assert "\n" not in str(error.value)


def test_missions_are_read_before_anything_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "_pace", None)  # the first to be measured
    with pytest.raises(MissionError, match=r"none\.yaml"):
        kernel.main(tmp_path / "out", missions=[tmp_path / "none.yaml"], quick=True)


def test_quick_results_say_so() -> None:
    one = kernel.Measured("price", "m", 1.0, None, None, 1.5, 100.0, 10)
    assert "Quick: " in kernel.report([one], 1.0, quick=True)
    assert "Quick: " not in kernel.report([one], 1.0)


@pytest.mark.slow
def test_quick_runs(tmp_path: Path) -> None:
    for experiment, folder in ((growth, tmp_path / "growth"), (kernel, tmp_path / "kernel")):
        told = experiment.main(folder, quick=True)  # type: ignore[attr-defined]
        assert json.loads(json.dumps(told, allow_nan=False)) == told
        assert (folder / "results.md").is_file()
        assert len(list(folder.glob("*.png"))) == len(list(folder.glob("*.csv"))) == 1
