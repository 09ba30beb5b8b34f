"""Real ground station software flies the simulated vehicles: it is the judge of their MAVLink."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import mavsdk
import pytest
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission import Mission
from mavsdk.plugins.mission import MissionItem as Item
from mavsdk.plugins.mission import MissionPlan as Plan
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry
from pymavlink import mavutil, mavwp
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from missionplanner.vehicle import Autopilot
from sim.fleet import SimFleet, connect_fleet, listen_fleet, serve, sim_vehicles
from tests.simulated import HOME, NAN, mission

pytestmark = pytest.mark.slow

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
SPEEDUP = 6.0
PATIENCE_S = 60.0  # real time; a mission takes about 10 s


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def simulate() -> Iterator[Callable[..., tuple[SimFleet, int]]]:
    """Start fleets that run in a thread; returns the fleet and the port that it speaks to or listens on."""
    running: list[tuple[SimFleet, threading.Event, threading.Thread]] = []

    def start(autopilot: Autopilot, count: int = 1, *, tcp: bool = False) -> tuple[SimFleet, int]:
        fleet = SimFleet(sim_vehicles(count, HOME, autopilot=autopilot))
        port = free_port(socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM)
        if tcp:
            listen_fleet(fleet, f"tcp:127.0.0.1:{port}")
        else:
            connect_fleet(fleet, f"udpout:127.0.0.1:{port}")
        stop = threading.Event()
        thread = threading.Thread(target=serve, args=(fleet, SPEEDUP, stop.is_set), daemon=True)
        thread.start()
        running.append((fleet, stop, thread))
        return fleet, port

    yield start
    for fleet, stop, thread in running:
        stop.set()
        thread.join()
        fleet.close()


def wait_for(condition: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    give_up_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < give_up_s, f"waited {patience_s} s in vain: {what}"
        time.sleep(0.02)


def raw_items(kind: Any, autopilot: Autopilot) -> list[Any]:
    """Return the mission as MAVSDK's raw mission items."""
    unset = NAN if autopilot == "px4" else 0.0
    return [
        kind(
            *(i.seq, i.frame, i.command, i.current, i.autocontinue),
            *(i.param1, i.param2, i.param3),
            unset if i.command != mavlink.MAV_CMD_DO_CHANGE_SPEED else 0.0,
            *(i.x, i.y, i.z, 0),
        )
        for i in mission(autopilot)
    ]


@pytest.fixture
def mavsdk_instance() -> Iterator[Any]:
    instance = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    yield instance
    instance.destroy()


@BOTH
@pytest.mark.parametrize("tcp", [False, True])
def test_mavsdk_uploads_flies_and_downloads(
    autopilot: Autopilot, tcp: bool, simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:

    _, port = simulate(autopilot, tcp=tcp)
    mavsdk_instance.add_any_connection(f"{'tcpout' if tcp else 'udpin'}://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    assert system is not None
    telemetry, raw, action = Telemetry(system), MissionRaw(system), Action(system)
    wait_for(telemetry.health_all_ok, "health_all_ok")
    items = raw_items(RawItem, autopilot)
    raw.upload_mission(items)
    held = raw.download_mission()
    assert [(i.command, i.x, i.y) for i in held] == [(i.command, i.x, i.y) for i in items]
    action.arm()
    raw.start_mission()
    wait_for(telemetry.in_air, "take-off")
    wait_for(raw.is_mission_finished, "the mission's end")
    assert raw.mission_progress().current == len(items)
    wait_for(lambda: not telemetry.in_air() and not telemetry.armed(), "touch-down")


@BOTH
def test_mavsdk_reads_parameters_holds_returns_and_lands(
    autopilot: Autopilot, simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:

    fleet, port = simulate(autopilot)
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    telemetry, action, param = Telemetry(system), Action(system), Param(system)
    wait_for(telemetry.health_all_ok, "health_all_ok")
    real, whole = ("WPNAV_SPEED", "DISARM_DELAY") if autopilot == "ardupilot" else ("MPC_XY_CRUISE", "NAV_RCL_ACT")
    param.set_param_float(real, 7.0)
    param.set_param_int(whole, 5)
    assert param.get_param_float(real) == 7.0
    assert param.get_param_int(whole) == 5
    everything = param.get_all_params()
    assert len(everything.float_params) + len(everything.int_params) == len(fleet.links[0].autopilot.parameters)
    action.arm()
    action.takeoff()
    wait_for(telemetry.in_air, "take-off")
    action.hold()
    action.return_to_launch()
    action.land()
    wait_for(lambda: not telemetry.in_air(), "touch-down")


def test_mavsdk_mission_plugin_loses_its_first_waypoint_to_ardupilots_home(
    simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:

    fleet, port = simulate("ardupilot")
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    none = (Item.CameraAction.NONE, NAN, NAN, 5.0, NAN, NAN, Item.VehicleAction.NONE)
    places = [(34.3005, -118.1), (34.301, -118.1), (34.301, -118.101)]
    Mission(system).upload_mission(Plan([Item(*place, 20.0, 5.0, True, NAN, NAN, *none) for place in places]))
    held = [i for i in fleet.links[0].missions.items() if i.command == mavlink.MAV_CMD_NAV_WAYPOINT]
    assert [(i.x, i.y) for i in held] == [
        (343_000_000, -1_181_000_000),
        (343_010_000, -1_181_000_000),
        (343_010_000, -1_181_010_000),
    ]


def test_mavsdk_sees_ten_vehicles_on_one_port(
    simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:
    _, port = simulate("px4", 10)
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    wait_for(lambda: mavsdk_instance.system_count() == 10, "ten systems")
    assert sorted(s.get_system_id() for s in mavsdk_instance.get_systems()) == list(range(1, 11))


@BOTH
def test_mavsdk_grpc_flies_a_mission(autopilot: Autopilot, simulate: Callable[..., tuple[SimFleet, int]]) -> None:
    _, port = simulate(autopilot)
    script = f"""
import asyncio
from mavsdk_grpc import System
from mavsdk_grpc.mission_raw import MissionItem
async def main():
    drone = System(port={free_port(socket.SOCK_STREAM)})
    await drone.connect(system_address="udpin://127.0.0.1:{port}")
    async for state in drone.core.connection_state():
        if state.is_connected:
            break
    async for healthy in drone.telemetry.health_all_ok():
        if healthy:
            break
    items = [MissionItem(*row) for row in {[_row(i) for i in mission(autopilot)]!r}]
    await drone.mission_raw.upload_mission(items)
    assert len(await drone.mission_raw.download_mission()) == len(items)
    await drone.action.arm()
    await drone.mission_raw.start_mission()
    async for progress in drone.mission_raw.mission_progress():
        if progress.current == progress.total:
            print("FINISHED")
            break
asyncio.run(asyncio.wait_for(main(), {PATIENCE_S}))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False
    )
    assert "FINISHED" in done.stdout, done.stdout + done.stderr


def _row(item: MissionItem) -> tuple[float, ...]:
    return (
        *(item.seq, item.frame, item.command, item.current, item.autocontinue),
        *(item.param1, item.param2, item.param3, item.param4),
        *(item.x, item.y, item.z, 0),
    )


@BOTH
def test_pymavlink_waypoint_loader_uploads_and_downloads(
    autopilot: Autopilot, simulate: Callable[..., tuple[SimFleet, int]], tmp_path: Path
) -> None:
    """The way of countless scripts: mavutil, mavwp, float requests answered by hand."""
    _, port = simulate(autopilot, tcp=True)
    link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=255)
    try:
        link.wait_heartbeat(timeout=PATIENCE_S)
        loader = mavwp.MAVWPLoader(1, 1)
        path = tmp_path / "mission.waypoints"
        path.write_text(waypoints_text(mission(autopilot)))
        assert loader.load(str(path)) == len(mission(autopilot))
        link.mav.mission_count_send(1, 1, loader.count())
        while True:
            message = link.recv_match(
                type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=PATIENCE_S
            )
            if message.get_type() == "MISSION_ACK":
                break
            link.mav.send(loader.wp(message.seq))
        assert message.type == mavlink.MAV_MISSION_ACCEPTED
        link.mav.mission_request_list_send(1, 1)
        count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=PATIENCE_S).count
        assert count == len(mission(autopilot))
        for seq in range(count):
            link.mav.mission_request_send(1, 1, seq)
            item = link.recv_match(type="MISSION_ITEM", blocking=True, timeout=PATIENCE_S)
            assert (item.seq, item.command) == (seq, mission(autopilot)[seq].command)
    finally:
        link.close()


def waypoints_text(items: Sequence[MissionItem]) -> str:
    rows = [
        [
            *(i.seq, i.current, i.frame, i.command, i.param1, i.param2, i.param3, i.param4),
            *(f"{i.x * 1e-7:.8f}", f"{i.y * 1e-7:.8f}", i.z, i.autocontinue),
        ]
        for i in items
    ]
    return "QGC WPL 110\n" + "".join("\t".join(map(str, row)) + "\n" for row in rows)


def test_mavproxy_loads_lists_arms_and_flies(simulate: Callable[..., tuple[SimFleet, int]], tmp_path: Path) -> None:
    fleet, port = simulate("ardupilot", tcp=True)
    (tmp_path / "mission.txt").write_text(waypoints_text(mission("ardupilot")))
    program = Path(sys.executable).with_name("mavproxy.py")
    if not program.exists():
        pytest.skip("mavproxy.py is not beside this Python")
    modules = "mode,wp,param,arm,cmdlong,misc,link"
    proxy = subprocess.Popen(
        [sys.executable, str(program), f"--master=tcp:127.0.0.1:{port}", f"--default-modules={modules}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    )
    said: list[str] = []
    assert proxy.stdout is not None
    assert proxy.stdin is not None
    reader = threading.Thread(target=lambda: said.extend(iter(proxy.stdout.readline, "")), daemon=True)  # type: ignore[union-attr]
    reader.start()

    def tell(command: str, answer: str) -> None:
        assert proxy.stdin is not None
        proxy.stdin.write(command + "\n")
        proxy.stdin.flush()
        wait_for(lambda: any(answer in line for line in said), f"{command!r} -> {answer!r} in {''.join(said)}")

    try:
        wait_for(lambda: any("Received" in line for line in said), "parameters")
        tell("wp load mission.txt", "ACCEPTED")
        tell("wp list", "Saved 6 waypoints")
        tell("param show WPNAV_SPEED", "1000.0")
        tell("mode GUIDED", "Mode GUIDED")
        tell("arm throttle", "ARMED")
        tell("mode AUTO", "Mission: 1 Takeoff")
        wait_for(lambda: any("DISARMED" in line for line in said), "the mission's end")
        assert any("Reached command #4" in line for line in said)
    finally:
        proxy.kill()  # it would wait for its standard input
        proxy.wait(10.0)
        reader.join(5.0)
        proxy.stdin.close()
        proxy.stdout.close()
    assert fleet.links[0].autopilot.landed
