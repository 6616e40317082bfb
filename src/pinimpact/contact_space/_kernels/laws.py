"""The restitution laws in the kernels: what each counts, its goal, and the first event at constant rates.

Only `counted`, `restitution_goal` and `law_of_slow_approach` tell laws apart, by codes that `laws.LAWS`
gives; all else asks what is counted. (theory.md, section 2)
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
    """Return what the law counts in restitution: VELOCITY, IMPULSE or WORK."""
    return _COUNTED[law]


@inlined
def restitution_goal(law, e, compression_impulse, compression_work, approach):
    """What restitution has to reach in all: an impulse, a work, or a velocity. (2.4)–(2.6)"""
    if law == POISSON:
        return e * compression_impulse
    if law == ENERGETIC:
        return -e * e * compression_work
    return -e * approach


@inlined
def law_of_slow_approach(law):
    """Return the law that ends the impact where `law` does while v₃ is linear in P₃, and needs no work.

    For an approach so slow that works underflow: then W_r = e² W_c is P_r = e P_c.
    """
    return POISSON if law == ENERGETIC else law


@inlined
def left_of_goal(counts, goal, v3, restored, restitution_work):
    """Return what is left of the goal: velocity, impulse or work still to be gained."""
    if counts == codes.IMPULSE:
        return goal - restored
    if counts == codes.WORK:
        return goal - restitution_work
    return goal - v3


@inlined
def first_event(phase, counts, left, v3, rate):
    """Return the normal impulse until the first event while dv₃/dP₃ = rate stays constant, and which it is.

    It is infinite where there is none. `counts` is what the law counts; in restitution `left` is left of its
    goal.
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
