"""What the command line has said, for tests that run it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """How a run of the command line ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What it printed, as the one strict JSON document that it must be."""
        return json.loads(self.out, parse_constant=_refuse)


Cli = Callable[..., Outcome]


def _refuse(constant: str) -> float:
    raise ValueError(f"expected JSON, got {constant}")


def expect_line(outcome: Outcome, code: int, *expected: str) -> None:
    """Check that stderr has exactly one line, with everything expected in it."""
    assert outcome.code == code, outcome.err
    assert outcome.err.startswith("missionplanner: ")
    assert outcome.err.count("\n") == 1, outcome.err
    assert outcome.err.endswith("\n")
    assert len(outcome.err) < 1000
    for part in expected:
        assert part in outcome.err


def expect_refusal(outcome: Outcome, code: int, *expected: str) -> None:
    """Check that there is exactly one line, with everything expected in it, and the same as JSON where asked for."""
    expect_line(outcome, code, *expected)
    if outcome.out:
        message = outcome.err.removeprefix("missionplanner: ").removesuffix("\n")
        assert outcome.json == {"error": {"message": message, "exit_code": code}}
