"""Parameters through the command line and over sockets; a ground station's own library reads and sets them."""

from __future__ import annotations

import json
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavparm, mavutil

from missionplanner.autopilot_parameters import held, with_values
from missionplanner.errors import InfeasibleError
from missionplanner.parameter_files import read_parameters
from missionplanner.plan import FleetPlan
from missionplanner.plan_folder import PLAN_NAME, load_plan
from missionplanner.planner import plan_fleet
from missionplanner.vehicle import Autopilot
from sim.fleet import SimFleet, connect_fleet, planned_vehicles, serve, sim_vehicles
from tests.command_line import Cli, expect_line, expect_refusal
from tests.main_job import plan_into
from tests.scenes import at, copter, question, scene_of
from tests.simulated import HOME

SPEEDUP = 10.0


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan folder of two copters, one of which accelerates gently; not to be changed."""
    folder = tmp_path_factory.mktemp("planned")
    data = question(
        copter("alpha", (0, 0), (300, 0), parameters={"WPNAV_ACCEL": 150}), copter("bravo", (0, 60), (300, 60))
    )
    plan_into(folder / "plan", scene_of(data, folder))
    return folder / "plan"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def serving() -> Iterator[Callable[[SimFleet], int]]:
    """Let fleets speak to a UDP port, in threads of their own; returns the port."""
    running: list[tuple[SimFleet, threading.Event, threading.Thread]] = []

    def start(fleet: SimFleet) -> int:
        port = free_port()
        connect_fleet(fleet, f"udpout:127.0.0.1:{port}")
        stop = threading.Event()
        thread = threading.Thread(target=serve, args=(fleet, SPEEDUP, stop.is_set), daemon=True)
        thread.start()
        running.append((fleet, stop, thread))
        return port

    yield start
    for fleet, stop, thread in running:
        stop.set()
        thread.join()
        fleet.close()


def plan_of(folder: Path) -> FleetPlan:
    return load_plan(folder)[1]


def simulated(plan: FleetPlan, name: str, field: str, value: float) -> SimFleet:
    """Return the vehicles of a plan, one of them with another motion."""
    names = [vehicle.name for vehicle in plan.vehicles]
    vehicles = planned_vehicles(plan)
    k = names.index(name)
    object.__setattr__(vehicles[k], "motion", with_values(vehicles[k].motion, {field: value}))
    return SimFleet(vehicles, frame=plan.frame)


def test_a_plan_keeps_the_parameters_it_was_made_with(planned: Path, tmp_path: Path, cli: Cli) -> None:
    alpha, bravo = plan_of(planned).vehicles
    assert (alpha.motion.acceleration_m_s2, bravo.motion.acceleration_m_s2) == (1.5, 2.5)
    copy = Path(shutil.copytree(planned, tmp_path / "edited"))
    document = json.loads((copy / PLAN_NAME).read_text())
    assert document["vehicles"][0]["parameters"] == held(("ardupilot", "copter"), alpha.motion)
    document["vehicles"][1]["parameters"]["WPNAV_ACCEL"] = 300.0
    (copy / PLAN_NAME).write_text(json.dumps(document))
    told = "bravo: expected a plan made with WPNAV_ACCEL 250, got one made with 300: plan the mission again"
    expect_refusal(cli("export", copy), 2, told)


@pytest.mark.parametrize("command", ["upload", "fly"])
def test_a_vehicle_with_other_parameters_is_refused_before_anything_is_sent(
    planned: Path, cli: Cli, serving: Callable[[SimFleet], int], command: str
) -> None:
    fleet = simulated(plan_of(planned), "alpha", "acceleration_m_s2", 2.5)
    port = serving(fleet)
    outcome = cli(command, planned, "--connect", f"udpin:127.0.0.1:{port}", "--json")
    expect_refusal(
        outcome,
        4,
        "alpha: holds WPNAV_ACCEL 250, planned with 150: set it to 150 on the vehicle, or put WPNAV_ACCEL: 250 into",
        "nothing was uploaded",
    )
    assert all(len(link.autopilot.mission) == 0 for link in fleet.links)
    assert not any(link.autopilot.armed for link in fleet.links)


def test_an_override_is_told_in_full(planned: Path, cli: Cli, serving: Callable[[SimFleet], int]) -> None:
    port = serving(simulated(plan_of(planned), "alpha", "acceleration_m_s2", 2.5))
    outcome = cli("upload", planned, "--unproven", "--connect", f"udpin:127.0.0.1:{port}")
    assert outcome.code == 0, outcome.err
    assert "UNPROVEN: alpha: holds WPNAV_ACCEL 250, planned with 150" in outcome.err


def test_vehicles_that_hold_what_was_planned_are_served(
    planned: Path, cli: Cli, serving: Callable[[SimFleet], int]
) -> None:
    port = serving(simulated(plan_of(planned), "alpha", "return_height_m", 99.0))  # which the plan sets
    outcome = cli("upload", planned, "--connect", f"udpin:127.0.0.1:{port}")
    assert outcome.code == 0, outcome.err
    assert "verified" in outcome.out


def test_built_in_vehicles_hold_what_was_planned(planned: Path, cli: Cli) -> None:
    outcome = cli("fly", planned, "--json")
    assert outcome.code == 0, outcome.err
    assert [vehicle["name"] for vehicle in outcome.json["vehicles"]] == ["alpha", "bravo"]


def test_parameters_are_read_saved_and_taken_up_again(
    tmp_path: Path, cli: Cli, serving: Callable[[SimFleet], int]
) -> None:
    fleet = SimFleet(sim_vehicles(2, HOME))
    fleet.links[0].autopilot.parameters["WPNAV_ACCEL"] = 175.0
    url = f"udpin:127.0.0.1:{serving(fleet)}"
    table = cli("parameters", "--connect", url)
    assert table.code == 0, table.err
    assert "WPNAV_ACCEL" in table.out
    assert "acceleration_m_s2 = 1.75 m/s^2" in table.out
    expect_refusal(
        cli("parameters", "--connect", url, "-o", "all.param"), 2, "--output: expected one vehicle, heard sysids 1, 2"
    )
    expect_refusal(cli("parameters", "--connect", url, "-o", "v.txt"), 2, "expected a name that ends in .param")

    saved = cli("parameters", "--connect", url, "--sysid", "1", "-o", "v.param", "--json")
    assert saved.code == 0, saved.err
    assert saved.json["file"] == "v.param"
    [row] = saved.json["vehicles"]
    assert (row["sysid"], row["parameters"]["WPNAV_ACCEL"], row["differences"]) == (1, 175.0, [])
    assert read_parameters(tmp_path / "v.param")["WPNAV_ACCEL"].value == 175.0

    everything = cli("parameters", "--connect", url, "--sysid", "2", "--all", "-o", "v.params", "--json")
    assert everything.code == 0, everything.err
    assert set(everything.json["vehicles"][0]["parameters"]) == set(fleet.links[1].autopilot.parameters)
    assert set(read_parameters(tmp_path / "v.params")) == set(fleet.links[1].autopilot.parameters)

    # a mission that assumes the usual is told apart, one that takes up the file is not
    data = question(copter("alpha", (0, 0), (300, 0)))
    (tmp_path / "usual.yaml").write_text(json.dumps(data))
    differs = cli("parameters", "--connect", url, "--mission", "usual.yaml")
    expect_line(differs, 3, "alpha: holds WPNAV_ACCEL 175, planned with 250: set it to 250 on the vehicle")
    data = question(copter("alpha", (0, 0), (300, 0), parameter_file="v.param"))
    (tmp_path / "known.yaml").write_text(json.dumps(data))
    same = cli("parameters", "--connect", url, "--mission", "known.yaml")
    assert same.code == 0, same.err


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_ground_stations_own_library_reads_and_sets_them(
    autopilot: Autopilot, serving: Callable[[SimFleet], int]
) -> None:
    fleet = SimFleet(sim_vehicles(1, HOME, autopilot=autopilot))
    holds = fleet.links[0].autopilot.parameters
    master: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{serving(fleet)}", source_system=254)
    try:
        assert master.wait_heartbeat(timeout=30) is not None
        master.param_fetch_all()
        read = mavparm.MAVParmDict()
        give_up_s = time.monotonic() + 30.0
        while len(read) < len(holds):
            assert time.monotonic() < give_up_s
            message = master.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0)
            if message is not None:
                read[message.param_id] = message.param_value
        reals = {name: value for name, value in holds.items() if isinstance(value, float)}
        assert {name: read[name] for name in reals} == pytest.approx(reals)
        name, value = ("WPNAV_SPEED", 700.0) if autopilot == "ardupilot" else ("MPC_XY_CRUISE", 7.0)
        assert read.mavset(master, name, value, retries=10)
        assert fleet.links[0].autopilot.default_speed_m_s == 7.0
    finally:
        master.close()


def test_a_vehicle_tuned_to_leave_its_legs_is_not_proven() -> None:
    """How far a copter strays is known of the defaults; with others, its predicted flight must stay within that."""
    stops = [at(100, 60, agl=40), at(200, -60, agl=40)]

    def planned_with(**parameters: float) -> list[str]:
        plan = plan_fleet(scene_of(question(copter("alpha", (0, 0), (300, 0), stops=stops, parameters=parameters))))
        assert plan.certificate is not None
        assert plan.certificate.proven
        return [f.detail for f in plan.certificate.findings if "with its speed and parameters" in f.detail]

    assert planned_with() == []
    [told] = planned_with(WPNAV_ACCEL=150.0)
    assert 0.0 < float(told.removeprefix("is predicted at most ").split()[0]) < 2.0
    with pytest.raises(
        InfeasibleError, match=r"off its legs with its speed and parameters, allowed 2 m: fly slower, or"
    ):
        planned_with(PSC_POSXY_P=0.5, PSC_VELXY_P=0.5)


def test_what_vehicles_hold_is_not_proven_where_they_move_otherwise(
    planned: Path, tmp_path: Path, cli: Cli, serving: Callable[[SimFleet], int]
) -> None:
    plan = plan_of(planned)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame)
    url = f"udpin:127.0.0.1:{serving(fleet)}"
    assert cli("upload", planned, "--connect", url).code == 0
    mission = tmp_path / "m.yaml"
    mission.write_text(json.dumps(json.loads((planned / PLAN_NAME).read_text())["mission"]))
    assert cli("check", "--mission", mission, "--connect", url).code == 0
    fleet.links[1].autopilot.parameters["WPNAV_RADIUS"] = 700.0
    outcome = cli("check", "--mission", mission, "--connect", url, "--json")
    assert outcome.code == 3
    told = [f for f in outcome.json["findings"] if f["check"] == "understood" and not f["proven"]]
    assert [(f["vehicle"], f["detail"]) for f in told] == [("bravo", "WPNAV_RADIUS is 700, planned with 200")]
