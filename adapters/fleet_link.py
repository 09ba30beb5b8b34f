"""A fleet on its links: find it, upload, verify, start together, watch. Non-blocking beneath, timed by a clock."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from typing import Protocol

from adapters.endpoint import Endpoint


class Clock(Protocol):
    """The time by which a fleet is flown: the wall's, or a simulator's that only runs while somebody waits."""

    def now_s(self) -> float:
        """Return seconds since some fixed instant; never falls."""
        ...

    def wait(self, seconds: float) -> None:
        """Let at most that time pass; may return as soon as something has arrived."""
        ...


class WallClock:
    """Real time; waiting ends early when one of the endpoints has something to read."""

    def __init__(self, endpoints: Sequence[Endpoint]) -> None:
        self._endpoints = endpoints
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return seconds since the clock was made."""
        return time.monotonic() - self._start_s

    def wait(self, seconds: float) -> None:
        """Sleep until something arrives, at most ``seconds``."""
        descriptors = [fd for endpoint in self._endpoints for fd in endpoint.filenos()]
        if descriptors:
            select.select(descriptors, [], [], max(seconds, 0.0))
        else:
            time.sleep(max(seconds, 0.0))
