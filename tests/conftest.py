"""Profiles of hypothesis, warnings of kernels that are not compiled, and figures."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("default", derandomize=True, deadline=None, max_examples=100)
settings.register_profile("random", derandomize=False, deadline=None, max_examples=1000, print_blob=True)
settings.load_profile("default")


def pytest_configure(config: pytest.Config) -> None:
    """Ignore floating-point warnings of NumPy in kernels that are not compiled; compiled ones have none."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        config.addinivalue_line("filterwarnings", "ignore::RuntimeWarning")


@pytest.fixture(autouse=True)
def no_figures_left() -> Iterator[None]:
    """Close all figures after a test, since matplotlib warns about many open ones."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
