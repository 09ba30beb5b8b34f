"""Real ground station software flies the simulated vehicles: it is the judge of their MAVLink."""

from __future__ import annotations

import collections
import collections.abc
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
from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point, Polygon
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
from tests.simulated import HOME, LAT, LON, NAN, mission

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

    def start(
        autopilot: Autopilot, count: int = 1, *, tcp: bool = False, listening: bool = False
    ) -> tuple[SimFleet, int]:
        fleet = SimFleet(sim_vehicles(count, HOME, autopilot=autopilot))
        port = free_port(socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM)
        if tcp or listening:
            listen_fleet(fleet, f"{'tcp' if tcp else 'udp'}:127.0.0.1:{port}")
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
    for order, mode in ((action.hold, "HOLD"), (action.return_to_launch, "RETURN_TO_LAUNCH"), (action.land, "LAND")):
        order()
        wait_for(lambda mode=mode: telemetry.flight_mode().name == mode, mode)  # type: ignore[misc]
    wait_for(lambda: not telemetry.in_air(), "touch-down")


def test_mavsdk_mission_plugin_loses_its_first_waypoint_to_ardupilots_home(
    simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:

    fleet, port = simulate("ardupilot")
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    Mission(system).upload_mission(mission_plan())
    held = [i for i in fleet.links[0].missions.items() if i.command == mavlink.MAV_CMD_NAV_WAYPOINT]
    assert [(i.x, i.y) for i in held] == [
        (343_000_000, -1_181_000_000),
        (343_010_000, -1_181_000_000),
        (343_010_000, -1_181_010_000),
    ]


PLACES = [(34.3005, -118.1), (34.301, -118.1), (34.301, -118.101)]


def mission_plan() -> Any:
    none = (Item.CameraAction.NONE, NAN, NAN, 2.0, NAN, NAN, Item.VehicleAction.NONE)
    return Plan([Item(*place, 20.0, 5.0, True, NAN, NAN, *none) for place in PLACES])


def test_mavsdk_mission_plugin_flies_px4_to_the_end(
    simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:
    _, port = simulate("px4")
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    telemetry, plugin, action = Telemetry(system), Mission(system), Action(system)
    wait_for(telemetry.health_all_ok, "health_all_ok")
    plugin.set_return_to_launch_after_mission(True)
    plugin.upload_mission(mission_plan())
    held = plugin.download_mission().mission_items
    assert [(round(i.latitude_deg, 7), round(i.longitude_deg, 7)) for i in held] == PLACES
    action.arm()
    plugin.start_mission()
    wait_for(telemetry.in_air, "take-off")
    plugin.pause_mission()
    plugin.start_mission()
    wait_for(plugin.is_mission_finished, "the mission's end")
    progress = plugin.mission_progress()
    assert progress.current == progress.total == len(PLACES)
    wait_for(lambda: not telemetry.in_air() and not telemetry.armed(), "touch-down")


@BOTH
def test_mavsdk_uploads_a_geofence_and_reads_it_back(
    autopilot: Autopilot, simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:
    fleet, port = simulate(autopilot)
    mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk_instance.first_autopilot(PATIENCE_S)
    wait_for(Telemetry(system).health_all_ok, "health_all_ok")
    corners = [Point(34.29, -118.11), Point(34.29, -118.09), Point(34.31, -118.09), Point(34.31, -118.11)]
    fence = GeofenceData(
        [Polygon(corners, FenceType.INCLUSION)], [Circle(Point(34.305, -118.1), 50.0, FenceType.EXCLUSION)]
    )
    plugin = Geofence(system)
    plugin.upload_geofence(fence)
    held = fleet.links[0].missions.items(mavlink.MAV_MISSION_TYPE_FENCE)
    inside, outside = (
        mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
    )
    assert [(i.command, i.param1) for i in held] == [(inside, 4.0)] * 4 + [(outside, 50.0)]
    assert [(i.x, i.y) for i in held[:2]] == [(342_900_000, -1_181_100_000), (342_900_000, -1_180_900_000)]
    read = plugin.download_geofence()
    assert [[(p.latitude_deg, p.longitude_deg) for p in polygon.points] for polygon in read.polygons] == [
        [pytest.approx((p.latitude_deg, p.longitude_deg), abs=1e-7) for p in corners]
    ]
    assert [circle.radius for circle in read.circles] == [50.0]
    plugin.clear_geofence()
    assert fleet.links[0].missions.items(mavlink.MAV_MISSION_TYPE_FENCE) == ()


@pytest.mark.parametrize("own_ports", [False, True])
@BOTH
def test_mavsdk_gives_ten_vehicles_each_its_mission(
    autopilot: Autopilot, own_ports: bool, simulate: Callable[..., tuple[SimFleet, int]], mavsdk_instance: Any
) -> None:
    fleet, port = simulate(autopilot, 10, listening=own_ports)
    if own_ports:
        for k in range(10):
            mavsdk_instance.add_any_connection(f"udpout://127.0.0.1:{port + 10 * k}")
    else:
        mavsdk_instance.add_any_connection(f"udpin://127.0.0.1:{port}")
    wait_for(lambda: mavsdk_instance.system_count() == 10, "ten systems")
    systems = {s.get_system_id(): s for s in mavsdk_instance.get_systems()}
    assert sorted(systems) == list(range(1, 11))
    wait_for(lambda: all(system.is_connected() for system in systems.values()), "ten connections")
    for sysid, system in systems.items():
        items = raw_items(RawItem, autopilot)
        for item in items:
            item.z += sysid
        MissionRaw(system).upload_mission(items)
    for link in fleet.links:
        wanted = [i.z + link.sysid for i in mission(autopilot) if i.command == mavlink.MAV_CMD_NAV_WAYPOINT]
        held = [i.z for i in link.missions.items() if i.command == mavlink.MAV_CMD_NAV_WAYPOINT]
        if autopilot == "ardupilot":  # home is the vehicle's own
            wanted, held = wanted[1:], held[1:]
        assert held == pytest.approx(wanted)


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


class MavProxy:
    """MAVProxy, told what to do on its standard input."""

    def __init__(self, port: int, folder: Path) -> None:
        program = Path(sys.executable).with_name("mavproxy.py")
        if not program.exists():
            pytest.skip("mavproxy.py is not beside this Python")
        modules = "mode,wp,fence,rally,ftp,param,arm,cmdlong,misc,link"
        self.process = subprocess.Popen(
            [sys.executable, str(program), f"--master=tcp:127.0.0.1:{port}", f"--default-modules={modules}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
        )
        self.said: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self.said.extend(iter(self.process.stdout.readline, ""))

    def hear(self, answer: str) -> None:
        wait_for(lambda: any(answer in line for line in self.said), f"{answer!r} in {''.join(self.said)}")

    def say(self, command: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def tell(self, command: str, answer: str) -> None:
        """Give a command, and wait for an answer that has not been given before."""
        before = len(self.said)
        self.say(command)
        wait_for(
            lambda: any(answer in line for line in self.said[before:]),
            f"{command!r} -> {answer!r} in {''.join(self.said)}",
        )

    def close(self) -> None:
        self.process.kill()  # it would wait for its standard input
        self.process.wait(10.0)
        self._reader.join(5.0)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@pytest.fixture
def mavproxy(tmp_path: Path) -> Iterator[Callable[[int], MavProxy]]:
    running: list[MavProxy] = []

    def start(port: int) -> MavProxy:
        running.append(MavProxy(port, tmp_path))
        return running[-1]

    yield start
    for proxy in running:
        proxy.close()


def fence_items() -> list[MissionItem]:
    corner = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    places = [(-10_000, -10_000), (-10_000, 10_000), (10_000, 10_000), (10_000, -10_000)]
    corners = [MissionItem(k, 3, corner, 4.0, x=LAT + x, y=LON + y) for k, (x, y) in enumerate(places)]
    hole = MissionItem(4, 3, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 30.0, x=LAT + 8_000, y=LON)
    return [*corners, hole]


def test_mavproxy_loads_lists_arms_and_flies(
    simulate: Callable[..., tuple[SimFleet, int]], mavproxy: Callable[[int], MavProxy], tmp_path: Path
) -> None:
    fleet, port = simulate("ardupilot", tcp=True)
    (tmp_path / "mission.txt").write_text(waypoints_text(mission("ardupilot")))
    (tmp_path / "fence.txt").write_text(waypoints_text(fence_items()))
    proxy = mavproxy(port)
    proxy.hear("parameters (ftp)")
    proxy.tell("wp load mission.txt", "ACCEPTED")
    proxy.tell("wp list", "Saved 6 waypoints")
    proxy.tell("fence load fence.txt", "ACCEPTED")
    proxy.tell("fence list", "Saved 5 fence")
    held = fleet.links[0].missions.items(mavlink.MAV_MISSION_TYPE_FENCE)
    assert [(i.command, i.param1, i.x, i.y) for i in held] == [(i.command, i.param1, i.x, i.y) for i in fence_items()]
    proxy.tell("param show WPNAV_SPEED", "1000.0")
    proxy.say("param set WPNAV_SPEED 900")
    wait_for(lambda: fleet.links[0].autopilot.parameters["WPNAV_SPEED"] == 900.0, "param set")
    proxy.tell("mode GUIDED", "Mode GUIDED")
    proxy.tell("arm throttle", "ARMED")
    proxy.tell("mode AUTO", "Mission: 1 Takeoff")
    proxy.hear("DISARMED")
    assert any("Reached command #4" in line for line in proxy.said)
    assert fleet.links[0].autopilot.landed


def test_mavproxy_speaks_with_px4(
    simulate: Callable[..., tuple[SimFleet, int]], mavproxy: Callable[[int], MavProxy], tmp_path: Path
) -> None:
    """PX4 has no file of parameters: MAVProxy lists them without its time-out. Integers come by their bytes."""
    fleet, port = simulate("px4", tcp=True)
    (tmp_path / "mission.txt").write_text(waypoints_text(mission("px4")))
    proxy = mavproxy(port)
    proxy.hear(f"Received {len(fleet.links[0].autopilot.parameters)} parameters")
    proxy.tell("wp load mission.txt", "ACCEPTED")
    proxy.tell("wp list", "Saved 5 waypoints")
    proxy.tell("param show NAV_RCL_ACT", "2")
    proxy.tell("arm throttle", "ARMED")
    proxy.tell("long DO_SET_MODE 157 4 4", "Mode MISSION")  # its "mode" takes PX4's modes for numbers
    proxy.hear("DISARMED")
    assert fleet.links[0].autopilot.landed
    assert "parameters (ftp)" not in "".join(proxy.said)


def test_dronekit_uploads_and_flies(simulate: Callable[..., tuple[SimFleet, int]]) -> None:
    """A library of 2020 that many scripts still use; on today's Python it needs what collections has lost."""
    collections.MutableMapping = collections.abc.MutableMapping  # type: ignore[attr-defined]
    try:
        dronekit = pytest.importorskip("dronekit", reason="dronekit 2.9.2 is not installed")
    finally:
        del collections.MutableMapping  # type: ignore[attr-defined]
    fleet, port = simulate("ardupilot", tcp=True)
    vehicle = dronekit.connect(f"tcp:127.0.0.1:{port}", wait_ready=True, timeout=PATIENCE_S)
    try:
        commands = vehicle.commands
        commands.download()  # learns home, which its upload puts before the items
        commands.wait_ready()
        commands.clear()
        for i in mission("ardupilot")[1:]:
            params = (i.param1, i.param2, i.param3, i.param4)
            commands.add(dronekit.Command(0, 0, 0, i.frame, i.command, 0, 1, *params, i.x * 1e-7, i.y * 1e-7, i.z))
        commands.upload()
        commands.download()
        commands.wait_ready()
        assert [c.command for c in commands] == [i.command for i in mission("ardupilot")[1:]]
        vehicle.mode = dronekit.VehicleMode("GUIDED")
        vehicle.armed = True
        wait_for(lambda: vehicle.armed, "arming")
        vehicle.mode = dronekit.VehicleMode("AUTO")
        wait_for(lambda: vehicle.location.global_relative_frame.alt > 15.0, "take-off")
        wait_for(lambda: not vehicle.armed, "the mission's end")
    finally:
        vehicle.close()
    assert fleet.links[0].autopilot.landed
