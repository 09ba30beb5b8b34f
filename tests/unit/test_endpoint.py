"""Endpoints: both spellings of URLs, bytes through each kind of pipe, and one clear line for what cannot be opened."""

from __future__ import annotations

import os
import select
import socket
import time
from pathlib import Path

import pytest

from adapters.endpoint import Address, Endpoint, SerialEndpoint, in_process_pair, open_endpoint, parse_url
from missionplanner.errors import LinkError


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udpin:0.0.0.0:14550", Address("udpin", "0.0.0.0", 14550)),
        ("udp:127.0.0.1:14550", Address("udpin", "127.0.0.1", 14550)),
        ("udp://:14540", Address("udpin", "0.0.0.0", 14540)),
        ("udpin://0.0.0.0:14540", Address("udpin", "0.0.0.0", 14540)),
        ("udpout:127.0.0.1:14540", Address("udpout", "127.0.0.1", 14540)),
        ("udpout://192.168.1.7:14540", Address("udpout", "192.168.1.7", 14540)),
        ("UDPOUT:somehost", Address("udpout", "somehost", 14550)),
        ("tcp:127.0.0.1:5760", Address("tcpout", "127.0.0.1", 5760)),
        ("tcp://127.0.0.1:5762", Address("tcpout", "127.0.0.1", 5762)),
        ("tcpout://127.0.0.1:5762", Address("tcpout", "127.0.0.1", 5762)),
        ("tcpin:0.0.0.0:5760", Address("tcpin", "0.0.0.0", 5760)),
        ("tcpin://:5770", Address("tcpin", "0.0.0.0", 5770)),
        ("tcp:[::1]:5760", Address("tcpout", "::1", 5760)),
        ("/dev/ttyUSB0:57600", Address("serial", "/dev/ttyUSB0", baud=57600)),
        ("/dev/ttyACM0", Address("serial", "/dev/ttyACM0", baud=57600)),
        ("/dev/ttyUSB0,115200", Address("serial", "/dev/ttyUSB0", baud=115200)),
        ("serial:///dev/ttyUSB0:921600", Address("serial", "/dev/ttyUSB0", baud=921600)),
        ("serial:/dev/ttyUSB0:57600", Address("serial", "/dev/ttyUSB0", baud=57600)),
        ("COM3:57600", Address("serial", "COM3", baud=57600)),
    ],
)
def test_both_spellings_of_a_url(url: str, address: Address) -> None:
    assert parse_url(url) == address
    assert parse_url(str(address)) == address


@pytest.mark.parametrize("url", ["", "14550", "http://127.0.0.1:80", "udp:host:port", "udp:h:1:2", "tcp:h:70000"])
def test_what_is_no_url_is_refused_by_name(url: str) -> None:
    with pytest.raises(LinkError, match="expected") as error:
        parse_url(url)
    assert repr(url) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_listener_is_made_of_what_listen_means() -> None:
    assert str(parse_url("tcp:127.0.0.1:5760").listening().with_port_offset(10)) == "tcpin:127.0.0.1:5770"
    assert str(parse_url("udpout:127.0.0.1:5760").listening()) == "udpin:127.0.0.1:5760"


def _receive(endpoint: Endpoint, count: int = 1) -> list[bytes]:
    deadline = time.monotonic() + 5.0
    pieces: list[bytes] = []
    while len(b"".join(pieces)) < count and time.monotonic() < deadline:
        select.select(endpoint.filenos(), [], [], 0.05)
        pieces += [data for data, _ in endpoint.receive()]
    return pieces


def test_udp_answers_each_sender_separately() -> None:
    ground = open_endpoint("udpin:127.0.0.1:0")
    vehicles = [open_endpoint(parse_url(ground.url.replace("udpin", "udpout"))) for _ in range(2)]
    try:
        assert ground.receive() == []
        peers = []
        for k, vehicle in enumerate(vehicles):
            vehicle.send(b"hello %d" % k)
            select.select(ground.filenos(), [], [], 5.0)
            [(data, peer)] = ground.receive()
            assert data == b"hello %d" % k
            peers.append(peer)
        assert peers[0] != peers[1]
        ground.send(b"for 1", peers[1])
        assert _receive(vehicles[1]) == [b"for 1"]
        assert vehicles[0].receive() == []
        ground.send(b"all")
        assert [_receive(v) for v in vehicles] == [[b"all"], [b"all"]]
    finally:
        for endpoint in (ground, *vehicles):
            endpoint.close()


def test_udp_survives_a_closed_port_at_the_other_end() -> None:
    ground = open_endpoint("udpin:127.0.0.1:0")
    vehicle = open_endpoint(ground.url.replace("udpin", "udpout"))
    ground.close()
    for _ in range(3):
        vehicle.send(b"anybody?")
        assert vehicle.receive() == []
    vehicle.close()
    assert vehicle.receive() == []


def test_tcp_server_tells_its_clients_apart_and_forgets_who_left() -> None:
    server = open_endpoint("tcpin:127.0.0.1:0")
    url = server.url.replace("tcpin", "tcp")
    clients = [open_endpoint(url) for _ in range(2)]
    try:
        clients[0].send(b"one")
        assert _receive(server, 3) == [b"one"]
        clients[1].send(b"two")
        deadline = time.monotonic() + 5.0
        arrived = server.receive()
        while not arrived and time.monotonic() < deadline:
            arrived = server.receive()
        [(data, peer)] = arrived
        assert data == b"two"
        server.send(b"back", peer)
        assert _receive(clients[1], 4) == [b"back"]
        assert clients[0].receive() == []
        clients[1].close()
        clients[1].send(b"after closing")
        deadline = time.monotonic() + 5.0
        while len(server.filenos()) > 2 and time.monotonic() < deadline:
            server.receive()
        assert len(server.filenos()) == 2
        server.send(b"all")
        assert _receive(clients[0], 3) == [b"all"]
    finally:
        for endpoint in (server, *clients):
            endpoint.close()
    assert clients[0].receive() == []


def test_tcp_keeps_what_the_system_will_not_take_yet() -> None:
    server = open_endpoint("tcpin:127.0.0.1:0")
    client = open_endpoint(server.url.replace("tcpin", "tcp"))
    try:
        data = os.urandom(900_000)
        client.send(data)
        received = b""
        deadline = time.monotonic() + 20.0
        while len(received) < len(data) and time.monotonic() < deadline:
            client.receive()  # a poll also sends what waits
            received += b"".join(piece for piece, _ in server.receive())
        assert received == data
    finally:
        client.close()
        server.close()


def test_a_broken_tcp_connection_comes_back() -> None:
    server = open_endpoint("tcpin:127.0.0.1:0")
    client = open_endpoint(server.url.replace("tcpin", "tcp"))
    url = server.url
    server.close()
    deadline = time.monotonic() + 10.0
    while client.filenos() and time.monotonic() < deadline:
        client.receive()
    again = open_endpoint(url)
    try:
        received: list[bytes] = []
        while not received and time.monotonic() < deadline:
            client.receive()
            client.send(b"here again")
            received = [data for data, _ in again.receive()]
            time.sleep(0.01)
        assert received[0].startswith(b"here again")
    finally:
        client.close()
        again.close()
    assert client.receive() == []


def test_in_process_ends_hear_each_other_only() -> None:
    ground, vehicle = in_process_pair("uav1")
    vehicle.send(b"a")
    vehicle.send(b"b")
    assert ground.receive() == [(b"a", "uav1"), (b"b", "uav1")]
    assert ground.receive() == vehicle.receive() == []
    ground.send(b"c", "somebody else")
    assert vehicle.receive() == []
    ground.send(b"d", "uav1")
    assert vehicle.receive() == [(b"d", "uav1")]
    ground.close()
    ground.send(b"e")
    assert vehicle.receive() == []


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_in_use_is_said_so(kind: str) -> None:
    first = open_endpoint(f"{kind}:127.0.0.1:0")
    try:
        with pytest.raises(LinkError, match=r"cannot listen there.*choose another") as error:
            open_endpoint(first.url)
        assert first.url in str(error.value)
    finally:
        first.close()


def test_nobody_listening_is_said_so() -> None:
    server = open_endpoint("tcpin:127.0.0.1:0")
    url = server.url.replace("tcpin", "tcpout")
    server.close()
    with pytest.raises(LinkError, match="start the vehicle or simulator first"):
        open_endpoint(url)


def test_a_missing_serial_device_is_said_so() -> None:
    with pytest.raises(LinkError, match=r"/dev/ttyNOSUCH9:57600: expected a serial device"):
        open_endpoint("/dev/ttyNOSUCH9:57600")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")
def test_serial_line_both_ways() -> None:
    master, slave = os.openpty()
    try:
        line = open_endpoint(f"{os.ttyname(slave)}:57600")
    except LinkError:
        pytest.skip("this system's pseudo-terminals cannot be opened as serial lines")
    try:
        os.write(master, b"from the vehicle")
        assert b"".join(_receive(line, 16)) == b"from the vehicle"
        line.send(b"to the vehicle")
        assert os.read(master, 100) == b"to the vehicle"
    finally:
        line.close()
        os.close(master)
        os.close(slave)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")
def test_a_serial_device_that_comes_back_is_used_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.endpoint._RETRY_S", 0.0)
    device = tmp_path / "ttyUSB0"
    lines = [os.openpty(), os.openpty()]
    device.symlink_to(os.ttyname(lines[0][1]))
    try:
        line = SerialEndpoint(Address("serial", str(device)))
    except LinkError:
        pytest.skip("this system's pseudo-terminals cannot be opened as serial lines")
    try:
        os.write(lines[0][0], b"before")
        assert b"".join(_receive(line, 6)) == b"before"
        device.unlink()
        for descriptor in lines[0]:
            os.close(descriptor)
        for _ in range(3):  # it is gone, and nobody minds
            assert line.receive() == []
            line.send(b"lost")
        assert line.filenos() == []
        device.symlink_to(os.ttyname(lines[1][1]))
        assert line.receive() == []
        os.write(lines[1][0], b"after")
        assert b"".join(_receive(line, 5)) == b"after"
        line.close()
        assert line.receive() == []
        assert line.filenos() == []
    finally:
        line.close()
        for descriptor in lines[1]:
            os.close(descriptor)


def test_ever_new_senders_do_not_crowd_out_who_still_speaks() -> None:
    listening = open_endpoint("udpin:127.0.0.1:0")
    regular = open_endpoint(listening.url.replace("udpin", "udpout"))
    target = parse_url(listening.url)
    try:
        for k in range(1_100):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"x", (target.host, target.port))
            if k % 50 == 0:
                regular.send(b"here")
            listening.receive()
        assert len(listening._peers) <= 1_024  # type: ignore[attr-defined]
        listening.send(b"all")
        select.select(regular.filenos(), [], [], 5.0)
        assert [data for data, _ in regular.receive()] == [b"all"]
    finally:
        listening.close()
        regular.close()
