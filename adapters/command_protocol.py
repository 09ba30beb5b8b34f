"""One command to one vehicle as a state machine (https://mavlink.io/en/services/command.html); no sockets."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_protocol import OWN_COMPONENT, OWN_SYSID
from missionplanner.errors import LinkError

Message = Any  # a pymavlink message: its classes are generated, and carry no types

_RETRY_S = 0.7
_BUSY_S = 1.0
_PROGRESS_S = 5.0  # after IN_PROGRESS, for the final answer
_PARAMS = 7


class Command:
    """A COMMAND_LONG, repeated until it is answered. ``result`` is its MAV_RESULT, None until then.

    A vehicle that answers TEMPORARILY_REJECTED is asked again until ``patience_s`` has passed; then that is the result.
    """

    def __init__(
        self,
        name: str,
        sysid: int,
        number: int,
        *params: float,
        own_sysid: int = OWN_SYSID,
        own_component: int = OWN_COMPONENT,
        retry_s: float = _RETRY_S,
        patience_s: float = 7.0,
    ) -> None:
        self.result: int | None = None
        self._name = name
        self._sysid = sysid
        self._number = number
        self._params = (*params, *[0.0] * (_PARAMS - len(params)))
        self._own_sysid = own_sysid
        self._own_component = own_component
        self._retry_s = retry_s
        self._patience_s = patience_s
        self.copies = 0  # sent
        self._due_s = -math.inf
        self._give_up_s: float | None = None

    def poll(self, now_s: float) -> list[Message]:
        """Send at the first call, then again when it is time.

        Raises
        ------
        LinkError
            No answer.
        """
        if self.result is not None or now_s < self._due_s:
            return []
        if self._give_up_s is None:
            self._give_up_s = now_s + self._patience_s
        elif now_s >= self._give_up_s:
            raise LinkError(
                f"{self._name} (sysid {self._sysid}): expected an answer to {command_name(self._number)}, got none"
            )
        self._due_s = now_s + self._retry_s
        message = mavlink.MAVLink_command_long_message(
            self._sysid, 1, self._number, min(self.copies, 255), *self._params
        )
        self.copies += 1
        return [message]

    def contradicts(self, other: Command | None) -> bool:
        """Return whether answers to copies of another command, which are still under way, look like ones to this."""
        return (
            other is not None and other._number == self._number and other._params != self._params and other.copies > 1
        )

    def receive(self, message: Message, now_s: float) -> None:
        """Take one message from anywhere; the vehicle's answer to such a command, to us, counts.

        It does not say which: ARM and DISARM are one command, and the answer to a copy of the one may come when the
        other has been sent. What matters is believed when it is seen, see ``Station.commanding_until``.
        """
        if (
            message.get_type() != "COMMAND_ACK"
            or message.get_srcSystem() != self._sysid
            or message.command != self._number
            or message.target_system not in (0, self._own_sysid)
            or message.target_component not in (0, self._own_component)  # 0: older firmware does not say
            or self.result is not None
        ):
            return
        if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            self._due_s = self._give_up_s = now_s + _PROGRESS_S
        elif (
            message.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
            and self._give_up_s is not None
            and now_s + _BUSY_S < self._give_up_s
        ):
            self._due_s = now_s + _BUSY_S
        else:
            self.result = int(message.result)


def command_name(number: int) -> str:
    """Return a MAV_CMD's name without its prefix, or its number."""
    entry = mavlink.enums["MAV_CMD"].get(number)
    return str(entry.name).removeprefix("MAV_CMD_") if entry else f"command {number}"
