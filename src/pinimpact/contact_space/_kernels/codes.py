"""Integer codes in kernels: the values of `status.Status` and `status.Flag`, modes, phases, events.

They are NumPy integers because numba treats Python integers as literals and compiles a function for each.
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
"""Initial value of a count."""

IN_SLIP, IN_STICK, IN_RESUMED_SLIP = _counting(3)
"""The mode of a row of the trace."""

COMPRESSION, RESTITUTION = _counting(2)
"""The phase of a row of the trace."""

NO_EVENT, COMPRESSION_ENDS, LAW_MET, COMPRESSION_RESUMES, NEVER = _counting(5)
"""The event that ends a move; NEVER: no event ever follows."""

VELOCITY, IMPULSE, WORK = _counting(3)
"""The quantity that a law prescribes for restitution: v₃, the normal impulse, or the normal work."""

OPEN, LOADING, RISING, SINKING, HELD = _counting(5)
"""Normal modes at several contacts: open; loading to a new largest indentation; unloading; reloading up to
the largest indentation; held at its peak with v₃ = 0, for e = 0."""

FREE, SLIPPING, STUCK, BOUND = _counting(4)
"""Tangential modes at several contacts: no friction force; slipping; sticking; sticking with friction at its
bound."""
