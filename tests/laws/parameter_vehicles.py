"""A vehicle that serves parameters as ArduPilot does: a short queue, no word on names that it does not have."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.parameter_protocol import parameter_name

_STEP_S = 0.05
_LIMIT_S = 600.0


class Exchange(Protocol):
    """An exchange with a vehicle: what :mod:`adapters.parameter_protocol` offers."""

    @property
    def done(self) -> bool: ...
    def poll(self, now_s: float) -> list[Any]: ...
    def receive(self, message: Any, now_s: float) -> None: ...


class LossyVehicle:
    """Answers requests in order, a few per step, over a link that loses a share of the messages each way."""

    def __init__(self, values: dict[str, float], loss: float, seed: int, queue: int, sysid: int = 3) -> None:
        self.values = values
        self.overflows = 0
        self.asked = 0
        self.now_s = 0.0
        self._loss = loss
        self._rng = np.random.default_rng(seed)
        self._queue_max = queue
        self._queue: deque[tuple[str, int]] = deque()
        self._stream: deque[str] = deque()
        self._codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)

    def run(self, exchange: Exchange) -> None:
        """Let time pass until the exchange is done."""
        while not exchange.done:
            assert self.now_s < _LIMIT_S, "the exchange does not end"
            for message in exchange.poll(self.now_s):
                self.asked += 1
                if self._rng.random() >= self._loss:
                    self._take(message)
            for message in self._answers():
                if self._rng.random() >= self._loss:
                    exchange.receive(message, self.now_s)
            self.now_s += _STEP_S

    def _take(self, message: Any) -> None:
        names = list(self.values)
        if message.get_type() == "PARAM_REQUEST_LIST":
            self._stream.extend(names)
        elif len(self._queue) >= self._queue_max:
            self.overflows += 1
        elif message.param_index >= 0:
            self._queue.append((names[message.param_index], message.param_index))
        else:
            self._queue.append((parameter_name(message), 65_535))

    def _answers(self) -> list[Any]:
        answers = []
        for _ in range(min(5, len(self._queue))):
            name, index = self._queue.popleft()
            if name in self.values:
                answers.append(self._value(name, index))
        for _ in range(min(10, len(self._stream))):
            name = self._stream.popleft()
            answers.append(self._value(name, list(self.values).index(name)))
        return answers

    def _value(self, name: str, index: int) -> Any:
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        message = mavlink.MAVLink_param_value_message(name.encode(), self.values[name], kind, len(self.values), index)
        message.pack(self._codec)
        return message
