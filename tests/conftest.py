"""Settings of all tests."""

from __future__ import annotations

from hypothesis import settings

# the first example compiles kernels, and the machine may be busy: time is nobody's law
settings.register_profile("project", deadline=None)
settings.load_profile("project")
