"""Telling whoever waits for kernels to be compiled what for, and about how long.

The logger "pinimpact.compiling" says it once for every purpose, with a warning, so that it is seen where
nobody has set up logging; ``logging.getLogger("pinimpact.compiling").setLevel("ERROR")`` silences it. At the
level INFO it counts the kernels of `jit.compile_all`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from types import FunctionType, ModuleType
from typing import Any

from .sources import PACKAGE

LOG = logging.getLogger(f"{PACKAGE}.compiling")

PURPOSES = {"scene": "scenes", "robot": "impacts of robots", "contact_space": "impacts"}
"""What the kernels of each package are for."""

BYTES_PER_SECOND = 4000
"""Of Python's own code of kernels, compiled on one core of a present machine, about."""

SHORT = 1.0
"""A wait [s] that needs no word."""

_told: set[str] = set()


def tell(kernels: Sequence[Any], kept: bool) -> None:
    """Say that kernels are being compiled.

    Args:
        kernels: All of them that are to be compiled now; the first one names the purpose.
        kept: Whether they stay on disk.
    """
    package = kernels[0].py_func.__module__.removeprefix(f"{PACKAGE}.").split(".")[0]
    seconds = sum(len(function.__code__.co_code) for function in reached(kernels)) / BYTES_PER_SECOND
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
        names = function.__code__.co_names
        seen = [function.__globals__.get(name) for name in names]
        seen += [cell.cell_contents for cell in function.__closure__ or ()]
        seen += [getattr(one, name, None) for one in seen if isinstance(one, ModuleType) for name in names]
        waiting += [one.py_func for one in seen if hasattr(one, "py_func")]
    return found
