"""The three ways a mission can fail, each with its exit code.

Every message is one line that says what was expected, what came, where, and what to do.
"""

from __future__ import annotations

from typing import ClassVar


class MissionPlannerError(Exception):
    """Base of every error that a user can cause and mend; anything else is a bug."""

    exit_code: ClassVar[int] = 1


class MissionError(MissionPlannerError):
    """The question is wrong: a mission file, a plan folder, a terrain file or an argument."""

    exit_code: ClassVar[int] = 2


class InfeasibleError(MissionPlannerError):
    """The question is sound and no safe plan answers it."""

    exit_code: ClassVar[int] = 3


class LinkError(MissionPlannerError):
    """The vehicle's side: nobody answers, a refusal, a mission that does not read back as sent."""

    exit_code: ClassVar[int] = 4
