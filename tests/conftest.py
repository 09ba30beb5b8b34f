"""Settings of all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# the first example compiles kernels, and the machine may be busy: time is nobody's law
settings.register_profile("project", deadline=None)
settings.register_profile("gate", deadline=None, derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "project"))
