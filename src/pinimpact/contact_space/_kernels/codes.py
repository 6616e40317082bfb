"""Integers that the kernels speak: the values of `status.Status` and `status.Flag`, modes, phases, events.

They are NumPy's, for numba takes Python's as literals and compiles a function again for each.
"""

from collections.abc import Iterator

import numpy as np


def _counting(count: int) -> Iterator[np.int64]:
    return (np.int64(i) for i in range(count))


def _bits(count: int) -> Iterator[np.int64]:
    return (np.int64(1 << i) for i in range(count))


# status.Status
SEPARATED, ENDED_AT_REST, NO_IMPACT, LOCKED, *_failures = _counting(10)
INVALID_NUMBERS, INDEFINITE_DELASSUS, UNSTOPPABLE, LAW_UNREACHABLE, OUT_OF_RANGE, NOT_CONVERGED = _failures

# status.Flag
NO_FLAG = np.int64(0)
JAM, IMPACT_WITHOUT_COLLISION, SECOND_COMPRESSION, STICKS, SLIP_RESUMED, LOCKS, *_more = _bits(11)
ENERGY_CREATED, NEAR_JUMP, NEAR_STICK_THRESHOLD, SINGULAR_DELASSUS, SLIP_TURNS = _more

NONE_YET = np.int64(0)
"""Where a count begins."""

IN_SLIP, IN_STICK, IN_RESUMED_SLIP = _counting(3)
"""The mode of a row of the trace."""

COMPRESSION, RESTITUTION = _counting(2)
"""The phase of a row of the trace."""

NO_EVENT, COMPRESSION_ENDS, LAW_MET, COMPRESSION_RESUMES, NEVER = _counting(5)
"""What ends a move; NEVER: nothing ever will."""

VELOCITY, IMPULSE, WORK = _counting(3)
"""What a law counts during restitution: v₃, the normal impulse, or the normal work."""

OPEN, LOADING, RISING, SINKING, HELD = _counting(5)
"""Modes of one of many contacts along the normal: apart; pressed deeper than ever since it closed; in elastic
unloading; in elastic reloading; pressed without moving, for it restores nothing."""

FREE, SLIPPING, STUCK, BOUND = _counting(4)
"""And in the plane: without friction; ...; held by friction, by all that it can give where BOUND."""
