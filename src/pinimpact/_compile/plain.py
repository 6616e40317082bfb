"""Kernels compiled by plain numba, `njit(cache=True)`, if the compiler of `linking` cannot be used.

The results are the same to rounding. Compilation takes several times as long, since numba optimizes a
function again in each of its callers. Its cache depends on the source of a kernel only, not on those of its
callees: after an edit of kernels, empty the cache.
"""

from __future__ import annotations

import os
from functools import cache

import numba

from .numba_internals import MISSING
from .waiting import LOG, PACKAGE

VARIABLE = "PINIMPACT_PLAIN_NUMBA"

TESTED = (0, 61), (0, 68)
"""The oldest and the newest version of numba with which the compiler of `linking` has been tested."""

SECONDS = {"impacts": 40, "scenes": 150}
"""Approximate time of plain numba for the kernels of a first impact and a first scene [s]."""


def reason(version: tuple[int, ...] = numba.version_info[:2]) -> str:
    """Return why kernels are compiled by plain numba; empty if they are not."""
    if os.environ.get(VARIABLE, "0") not in ("", "0"):
        return f"{VARIABLE} is set"
    if not TESTED[0] <= version <= TESTED[1]:
        given, oldest, newest = (".".join(map(str, one)) for one in (version, *TESTED))
        return f"numba {given} has not been tested ({oldest} to {newest} have)"
    return f"this numba lacks a name: {MISSING}" if MISSING else ""


@cache
def warn(why: str) -> None:
    """Warn once that the first run takes longer with plain numba."""
    times = " and ".join(f"about {seconds} s for {purpose}" for purpose, seconds in SECONDS.items())
    LOG.warning("%s: %s: kernels are compiled by plain numba; a first run takes %s", PACKAGE, why, times)
