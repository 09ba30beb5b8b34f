"""Orders from another terminal: given once, answered, or surely not given."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from adapters.fleet_flight import Request
from adapters.order_box import OrderBox, give_order
from missionplanner.errors import LinkError, MissionError
from missionplanner.plan import Ordered

OUTCOMES = (
    Ordered("alpha", "rtl", 12.5, "obeyed", "alpha returns home"),
    Ordered("bravo", "rtl", None, "silent", "bravo does not answer"),
)


def test_an_order_is_taken_once_and_answered(tmp_path: Path) -> None:
    box = OrderBox(tmp_path / "orders")
    taken: list[Request] = []

    def fly(_seconds: float) -> None:
        request = box.take()
        if request is not None:
            taken.append(request)
            assert box.take() is None
            box.answer(OUTCOMES)

    request = Request("rtl", frozenset({"bravo", "alpha"}), unproven=True)
    assert give_order(tmp_path / "orders", request, fly) == OUTCOMES
    assert taken == [request]
    box.close()
    assert not (tmp_path / "orders").exists()


def test_an_order_that_nobody_takes_is_withdrawn(tmp_path: Path) -> None:
    with pytest.raises(
        LinkError, match=r"expected a running fly .*found none: nothing was sent; give .* --connect URL"
    ):
        give_order(tmp_path / "orders", Request("land"), lambda _s: None)
    (tmp_path / "orders").mkdir()  # of a fly that was killed
    with pytest.raises(LinkError, match="nothing was sent"):
        give_order(tmp_path / "orders", Request("land"), lambda _s: None)
    assert list((tmp_path / "orders").iterdir()) == []


def test_an_order_that_is_taken_and_never_answered_is_not_said_to_be_given(tmp_path: Path) -> None:
    box = OrderBox(tmp_path / "orders")
    with pytest.raises(LinkError, match="the order was taken, and what came of it was not told"):
        give_order(tmp_path / "orders", Request("pause"), lambda _s: (box.take(), None)[1])
    steps = [box.take, box.close]
    with pytest.raises(LinkError, match="was not told"):
        give_order(tmp_path / "orders", Request("pause"), lambda _s: steps.pop(0)() and None)


def test_an_order_is_not_said_to_be_taken_when_the_flight_has_just_ended(tmp_path: Path) -> None:
    box = OrderBox(tmp_path / "orders")
    with pytest.raises(LinkError, match=r"has just ended, and whether it still took the order is not known: "):
        give_order(tmp_path / "orders", Request("rtl"), lambda _s: box.close())


def test_old_orders_are_not_obeyed(tmp_path: Path) -> None:
    (tmp_path / "orders").mkdir()
    (tmp_path / "orders" / "x.order").write_text('{"order": "land", "vehicles": [], "unproven": false}')
    assert OrderBox(tmp_path / "orders").take() is None


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", '{"order": "crash", "vehicles": [], "unproven": false}', '{"order": ["rtl"], "vehicles": 3}'],
)
def test_what_is_no_order_is_thrown_away(tmp_path: Path, text: str) -> None:
    box = OrderBox(tmp_path / "orders")
    (tmp_path / "orders" / "a.order").write_text(text)
    (tmp_path / "orders" / "b.order").write_text('{"order": "rtl", "vehicles": [], "unproven": false}')
    assert box.take() == Request("rtl")


def test_two_givers_get_each_their_own_answer(tmp_path: Path) -> None:
    box = OrderBox(tmp_path / "orders")
    ended = threading.Event()

    def fly() -> None:
        while not ended.wait(0.002):
            request = box.take()
            if request is not None:
                (name,) = request.vehicles
                box.answer([Ordered(name, request.order, 1.0, "obeyed", name)])

    flying = threading.Thread(target=fly)
    flying.start()
    found: dict[str, tuple[Ordered, ...]] = {}

    def give(name: str) -> None:
        pause = threading.Event()
        found[name] = give_order(
            tmp_path / "orders", Request("pause", frozenset({name})), lambda _s: pause.wait(0.01) and None
        )

    givers = [threading.Thread(target=give, args=(name,)) for name in ("alpha", "bravo", "charlie")]
    for giver in givers:
        giver.start()
    for giver in givers:
        giver.join()
    ended.set()
    flying.join()
    assert {name: [o.vehicle for o in outcomes] for name, outcomes in found.items()} == {
        name: [name] for name in ("alpha", "bravo", "charlie")
    }


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "plan").write_text("a file")
    with pytest.raises(MissionError, match="orders: expected a folder that can be written to"):
        OrderBox(tmp_path / "plan" / "orders")
