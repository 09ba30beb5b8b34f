"""MAVProxy signs, by its own module and passphrase; a vehicle that holds the key obeys it, and not before."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.signing import Signing
from adapters.waypoints_file import waypoints_text
from sim.fleet import SimFleet, listen_fleet, serve, sim_vehicles
from tests.simulated import HOME, mission

pytestmark = pytest.mark.slow

PATIENCE_S = 60.0
PASSPHRASE = "sesame-1"


def wait_for(what: Callable[[], bool], told: str, patience_s: float = PATIENCE_S) -> None:
    end_s = time.monotonic() + patience_s
    while not what():
        assert time.monotonic() < end_s, f"no {told}"
        time.sleep(0.05)


def test_mavproxy_uploads_once_it_signs(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("mavproxy.py")
    if not program.exists():
        pytest.skip("mavproxy.py is not beside this Python")
    fleet = SimFleet(sim_vehicles(1, HOME))
    signing = Signing(hashlib.sha256(PASSPHRASE.encode()).digest(), time.time)
    listen_fleet(fleet, "tcp:127.0.0.1:0", signing.sealed)
    port = fleet.endpoints()[0].url.rpartition(":")[2]
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(fleet, 4.0, stop.is_set), daemon=True)
    thread.start()
    items = mission("ardupilot")
    (tmp_path / "mission.txt").write_text(waypoints_text(items, "ardupilot", HOME))
    proxy = subprocess.Popen(
        [
            *(sys.executable, str(program), f"--master=tcp:127.0.0.1:{port}"),
            "--default-modules=wp,link,signing,param",
            "--mav20",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    )
    assert proxy.stdin is not None
    assert proxy.stdout is not None
    output = proxy.stdout
    said: list[str] = []
    reader = threading.Thread(target=lambda: said.extend(iter(output.readline, "")), daemon=True)
    reader.start()

    def tell(command: str) -> None:
        assert proxy.stdin is not None
        proxy.stdin.write(command + "\n")
        proxy.stdin.flush()

    try:
        wait_for(lambda: any("online" in line.lower() for line in said), "vehicle online")
        tell("wp load mission.txt")
        wait_for(lambda: sum(d.unsigned for d in signing.dropped.values()) > 5, "unsigned frames")
        time.sleep(1.0)
        assert not fleet.links[0].missions.items()
        tell(f"signing key {PASSPHRASE}")
        time.sleep(1.0)
        tell("wp load mission.txt")
        wait_for(lambda: len(fleet.links[0].missions.items()) == len(items), "mission: " + "".join(said))
        assert all(dropped.wrong == 0 for dropped in signing.dropped.values())
    finally:
        proxy.kill()
        proxy.wait(10.0)
        reader.join(5.0)
        output.close()
        proxy.stdin.close()
        stop.set()
        thread.join(10.0)
        fleet.close()
