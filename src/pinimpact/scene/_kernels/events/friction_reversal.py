"""A joint that slides against its dry friction comes to rest."""

from __future__ import annotations

import math

from ...._numeric.jit import inner, separate
from ..event_location import search_for_root
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inner
def value(work, j, t):
    """Return the joint's velocity at the state that is set."""
    return work.v[j], 0.0


root = search_for_root(value)


@separate
def first(work, end):
    """Return the first time before `end` at which a joint comes to rest, infinite if none does; and which."""
    sliding, v0, v1 = work.sliding_friction, work.v0, work.v1
    start, last = work.step_start, work.step_start + work.step_length
    time, which = math.inf, 0
    for j in range(len(v0)):
        if sliding[j] * v1[j] < -1e-12 * abs(sliding[j]) and sliding[j] * v0[j] > 0.0:
            found = root(work, j, start, last, v0[j], v1[j])
            if found < end:
                time, end, which = found, found, j
    return time, which
