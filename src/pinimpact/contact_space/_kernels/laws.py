"""Restitution laws in kernels: their quantities and goals, and the first event at constant rates.

Only `counted`, `restitution_goal` and `law_of_slow_approach` distinguish laws, by their index in `laws.LAWS`;
other kernels depend only on the quantity that `counted` returns. (theory.md, section 2)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined
from ..laws import COUNTED, LAWS
from . import codes

POISSON, ENERGETIC, NEWTON = (np.int64(LAWS.index(name)) for name in ("poisson", "energetic", "newton"))
_COUNTED = np.array([getattr(codes, what.upper()) for what in COUNTED])


@inlined
def counted(law):
    """Return the quantity that a law prescribes for restitution: VELOCITY, IMPULSE or WORK."""
    return _COUNTED[law]


@inlined
def restitution_goal(law, e, compression_impulse, compression_work, approach):
    """Return the goal of restitution, an impulse, a work, or a velocity. (2.4)–(2.6)"""
    if law == POISSON:
        return e * compression_impulse
    if law == ENERGETIC:
        return -e * e * compression_work
    return -e * approach


@inlined
def law_of_slow_approach(law):
    """Return a law that is equivalent to `law` for v₃ linear in P₃ and does not need the work.

    The work of a very slow approach underflows. For linear v₃, W_r = −e² W_c is P_r = e P_c.
    """
    return POISSON if law == ENERGETIC else law


@inlined
def left_of_goal(counts, goal, v3, restored, restitution_work):
    """Return the remainder of the goal: the velocity, impulse or work still to be gained."""
    if counts == codes.IMPULSE:
        return goal - restored
    if counts == codes.WORK:
        return goal - restitution_work
    return goal - v3


@inlined
def first_event(phase, counts, left, v3, rate):
    """Return the normal impulse up to the first event at constant dv₃/dP₃, inf for none, and the event.

    Args:
        phase: COMPRESSION or RESTITUTION.
        counts: The quantity of the law.
        left: Remainder of its goal, in restitution.
        v3: v₃ at the start.
        rate: dv₃/dP₃.
    """
    if phase == codes.COMPRESSION:
        if rate > 0.0:
            return max(0.0, -v3 / rate), codes.COMPRESSION_ENDS
        if v3 >= 0.0 and rate >= 0.0:
            return 0.0, codes.COMPRESSION_ENDS
        return math.inf, codes.NO_EVENT
    if left <= 0.0:
        return 0.0, codes.LAW_MET
    span, event = math.inf, codes.NO_EVENT
    if counts == codes.IMPULSE:
        span, event = left, codes.LAW_MET
    elif counts == codes.VELOCITY:
        if rate > 0.0:
            span, event = left / rate, codes.LAW_MET
    else:
        square = v3 * v3 + 2.0 * rate * left
        if square >= 0.0:
            slope = v3 + math.sqrt(square)
            if slope > 0.0:
                span, event = 2.0 * left / slope, codes.LAW_MET
    if rate < 0.0 and -v3 / rate < span:
        return -v3 / rate, codes.COMPRESSION_RESUMES
    return span, event
