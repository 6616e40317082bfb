"""What all tests share: the profiles of hypothesis, see `pytest --hypothesis-profile`."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("default", derandomize=True, deadline=None, max_examples=100)
settings.register_profile("random", derandomize=False, deadline=None, max_examples=1000, print_blob=True)
settings.load_profile("default")
