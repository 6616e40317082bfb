"""Telling whoever waits for kernels to be compiled what for, and about how long.

The logger "pinimpact.compiling" says it once for impacts and once for scenes, with a warning, so that it is
seen where nobody has set up logging; ``logging.getLogger("pinimpact.compiling").setLevel("ERROR")`` silences
it. At the level INFO it counts the kernels of `jit.compile_all`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from types import FunctionType
from typing import Any

from .declared import callees
from .sources import PACKAGE

LOG = logging.getLogger(f"{PACKAGE}.compiling")

IMPACTS, SCENES = "impacts", "scenes"
"""What kernels are for."""

COUNT = "compiling, once: %d of %d"
"""What is said at the level INFO."""

BYTES_PER_SECOND = 5500
"""Of Python's own code of kernels, compiled on one core of a present machine, about."""

SHORT = 1.0
"""A wait [s] that needs no word."""

_announced: set[str] = set()


def expected(kernels: Iterable[Any], processes: int = 1) -> float:
    """Return about how long some kernels take to compile, with all that they call [s]."""
    code = sum(len(function.__code__.co_code) for function in reached(kernels))
    return code / BYTES_PER_SECOND / processes**0.5


def announce(kernels: Sequence[Any], kept: bool, processes: int = 1) -> None:
    """Say that kernels are being compiled.

    Args:
        kernels: All of them that are to be compiled now.
        kept: Whether they stay on disk.
        processes: How many compile them.
    """
    modules = {kernel.py_func.__module__ for kernel in kernels}
    purpose = SCENES if any(one.startswith(f"{PACKAGE}.scene.") for one in modules) else IMPACTS
    seconds = expected(kernels, processes)
    if purpose in _announced or seconds < SHORT:
        return
    _announced.update((purpose, IMPACTS))  # scenes need those of impacts
    often = (
        "once per machine (`pinimpact warmup` compiles all)"
        if kept
        else "in every process, because no cache folder is writable (see NUMBA_CACHE_DIR)"
    )
    LOG.warning(
        "%s: compiling kernels for %s, %s: up to about %.0f s",
        *(PACKAGE, purpose, often, seconds),
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
