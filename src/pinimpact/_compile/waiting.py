"""Messages about the compilation of kernels, with their purpose and the estimated time.

The logger "pinimpact.compiling" logs one warning for impacts and one for scenes, and another one if a
longer compilation follows. They are visible without configuration of logging;
``logging.getLogger("pinimpact.compiling").setLevel("ERROR")`` silences them. At the level INFO it counts
the kernels of `jit.compile_all`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from types import FunctionType
from typing import Any

from .declared import callees
from .sources import PACKAGE

LOG = logging.getLogger(f"{PACKAGE}.compiling")

IMPACTS, SCENES = "impacts", "impacts and scenes"
"""Purposes of kernels."""

COUNT = "compiling, once: %d of %d"
"""Message at the level INFO."""

BYTES_PER_SECOND = 5500
"""Approximate rate of compilation on one core [bytes of Python bytecode/s]."""

SHORT = 1.0
"""Estimated compilation time below which there is no message [s]."""

_announced: dict[str, float] = {}
"""The longest time reported for each purpose [s]."""


def expected(kernels: Iterable[Any], processes: int = 1) -> float:
    """Return the estimated compilation time of kernels with their callees [s]."""
    code = sum(len(function.__code__.co_code) for function in reached(kernels))
    return code / BYTES_PER_SECOND / processes**0.5


def announce(kernels: Sequence[Any], kept: bool, processes: int = 1) -> None:
    """Report that kernels are being compiled, and whether they are cached on disk (`kept`)."""
    modules = {kernel.py_func.__module__ for kernel in kernels}
    purpose = SCENES if any(one.startswith(f"{PACKAGE}.scene.") for one in modules) else IMPACTS
    seconds = expected(kernels, processes)
    if seconds < SHORT or seconds <= _announced.get(purpose, 0.0):
        return
    for included in {purpose, IMPACTS}:  # kernels of scenes include those of impacts
        _announced[included] = max(seconds, _announced.get(included, 0.0))
    often = (
        "which are then cached (`pinimpact warmup` compiles all in advance)"
        if kept
        else "in every process, because no cache folder is writable (see NUMBA_CACHE_DIR)"
    )
    LOG.warning("%s: compiling kernels for %s, %s: about %.0f s", *(PACKAGE, purpose, often, seconds))


def reached(kernels: Iterable[Any]) -> set[FunctionType]:
    """Return the Python functions of kernels and of all their callees."""
    found: set[FunctionType] = set()
    waiting = [kernel.py_func for kernel in kernels]
    while waiting:
        function = waiting.pop()
        if function in found:
            continue
        found.add(function)
        waiting += [one.py_func for one in callees(function)]
    return found
