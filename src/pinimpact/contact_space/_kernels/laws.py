"""Where compression and restitution end. (theory.md, section 2)"""

from __future__ import annotations

import math

from ..._numeric.jit import inner
from .codes import COMPRESSION, ENERGETIC, FALLS_BACK, LAW_MET, NEWTON, NOTHING, POISSON, STOPS
from .delassus import EPS


@inner
def restitution_goal(law, e, compression_impulse, compression_work, approach):
    """What restitution has to reach in all: an impulse, a work, or a velocity. (2.4)–(2.6)"""
    if law == POISSON:
        return e * compression_impulse
    if law == ENERGETIC:
        return -e * e * compression_work
    return -e * approach


@inner
def linear_event(phase, law, left, v3, rate):
    """Find the first event while dv₃/dP₃ = rate stays constant.

    Args:
        left: In restitution, what is left of the goal: impulse, work, or velocity still to be gained.

    Returns:
        the normal impulse until the event (inf: none) and which one it is.
    """
    if phase == COMPRESSION:
        if rate > 0.0:
            return max(0.0, -v3 / rate), STOPS
        if v3 >= 0.0 and rate >= 0.0:
            return 0.0, STOPS
        return math.inf, NOTHING
    if left <= 0.0:
        return 0.0, LAW_MET
    span, event = math.inf, NOTHING
    if law == POISSON:
        span, event = left, LAW_MET
    elif law == NEWTON:
        if rate > 0.0:
            span, event = left / rate, LAW_MET
    else:
        square = v3 * v3 + 2.0 * rate * left
        if square >= 0.0:
            slope = v3 + math.sqrt(square)
            if slope > 0.0:
                span, event = 2.0 * left / slope, LAW_MET
    if rate < 0.0 and -v3 / rate < span:
        return -v3 / rate, FALLS_BACK
    return span, event


@inner
def creates_energy(v1, v2, v3, w1, w2, w3, p1, p2, p3):
    """Whether the kinetic energy gained from v to w, ½ P·(v + w), is beyond its rounding. (1.5)"""
    gained = p1 * (v1 + w1) + p2 * (v2 + w2) + p3 * (v3 + w3)
    size = abs(p1) * (abs(v1) + abs(w1)) + abs(p2) * (abs(v2) + abs(w2)) + abs(p3) * (abs(v3) + abs(w3))
    return gained > 64.0 * EPS * size
