"""Integers that the kernels speak: the values of `outcome.Status` and `outcome.Flag`, modes, phases, events.

They are NumPy's, for numba takes Python's as literals and compiles a function anew for each.
"""

from collections.abc import Iterator

import numpy as np


def _counting(count: int) -> Iterator[np.int64]:
    return (np.int64(i) for i in range(count))


def _bits(count: int) -> Iterator[np.int64]:
    return (np.int64(1 << i) for i in range(count))


SEPARATED, ENDED_AT_REST, NO_IMPACT, LOCKED, *_failures = _counting(10)
INVALID_NUMBERS, INDEFINITE_DELASSUS, UNSTOPPABLE, LAW_UNREACHABLE, OUT_OF_RANGE, NOT_CONVERGED = _failures

JAM, IMPACT_WITHOUT_COLLISION, SECOND_COMPRESSION, STICKS, SLIP_RESUMED, LOCKS, *_more = _bits(11)
ENERGY_CREATED, NEAR_JUMP, NEAR_STICK_THRESHOLD, SINGULAR_DELASSUS, SLIP_TURNS = _more

SLIP, STICK, RESUMED = _counting(3)
COMPRESSION, RESTITUTION = _counting(2)
POISSON, ENERGETIC, NEWTON = _counting(3)
NOTHING, STOPS, LAW_MET, FALLS_BACK, NEVER = _counting(5)
