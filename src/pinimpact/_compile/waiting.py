"""Telling whoever waits for kernels to be compiled what for, and about how long.

The logger "pinimpact.compiling" says it once for every purpose, with a warning, so that it is seen where
nobody has set up logging; ``logging.getLogger("pinimpact.compiling").setLevel("ERROR")`` silences it. At the
level INFO it counts the kernels of `jit.compile_all`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from types import FunctionType
from typing import Any

from .ahead import callees
from .sources import PACKAGE

LOG = logging.getLogger(f"{PACKAGE}.compiling")

PURPOSES = {"scene": "scenes", "robot": "impacts of robots", "contact_space": "impacts"}
"""What the kernels of each package are for."""

COUNT = "compiling, once: %d of %d"
"""What is said at the level INFO."""

BYTES_PER_SECOND = 7500
"""Of Python's own code of kernels, compiled on one core of a present machine, about."""

SHORT = 1.0
"""A wait [s] that needs no word."""

_told: set[str] = set()


def expected(kernels: Iterable[Any], processes: int = 1) -> float:
    """Return about how long some kernels take to compile, with all that they call [s]."""
    code = sum(len(function.__code__.co_code) for function in reached(kernels))
    return code / BYTES_PER_SECOND / processes**0.5


def tell(kernels: Sequence[Any], kept: bool, processes: int = 1) -> None:
    """Say that kernels are being compiled.

    Args:
        kernels: All of them that are to be compiled now; the first one names the purpose.
        kept: Whether they stay on disk.
        processes: How many compile them.
    """
    package = kernels[0].py_func.__module__.removeprefix(f"{PACKAGE}.").split(".")[0]
    seconds = expected(kernels, processes)
    if package in _told or seconds < SHORT:
        return
    _told.add(package)
    often = (
        "once per machine" if kept else "in every process, for no folder is writable (see NUMBA_CACHE_DIR)"
    )
    LOG.warning(
        "%s: compiling kernels for %s, %s: up to about %.0f s",
        *(PACKAGE, PURPOSES.get(package, package), often, seconds),
    )


def reached(kernels: Iterable[Any]) -> set[FunctionType]:
    """Return the Python functions of kernels and of all that they call."""
    found: set[FunctionType] = set()
    waiting = [kernel.py_func for kernel in kernels]
    while waiting:
        function = waiting.pop()
        if function in found:
            continue
        found.add(function)
        waiting += [one.py_func for one in callees(function)]
    return found
