"""The effort of a drive reaches or leaves its limit."""

from __future__ import annotations

import math

from ...._compile.jit import external, inlined
from ....geometry.tolerances import SAFETY
from ..drives import law
from ..event_location import search_for_fall
from ..tolerances import AT_BOUND
from .consequences import SIDE_CHANGE

CONSEQUENCE = SIDE_CHANGE


@inlined
def value(work, i, t):
    """Return the distance of a drive's law from the effort limit, on its side, at the state set.

    i < nv is a velocity and, while the drive follows its law, the upper limit; i − nv ≥ 0 is a velocity and
    the lower limit.
    """
    n = len(work.v)
    j, sign = (i, 1.0) if i < n else (i - n, -1.0)
    side, asked = work.drive_side[j], law(work, work.q, work.v, j)
    if side != 0:
        return side * asked - work.drive_limit[j], 0.0
    return work.drive_limit[j] - sign * asked, 0.0


first_fall = search_for_fall(value)


@external
def first(work, end):
    """Return the first time before `end` at which a drive reaches or leaves its limit, or infinity; and i."""
    q0, v0, side, bounds, h = work.q0, work.v0, work.drive_side, work.rate_bounds, work.step_length
    time, which = math.inf, 0
    for j in work.drive_velocity:
        stiffness, damping, limit = work.drive_stiffness[j], work.drive_damping[j], work.drive_limit[j]
        if not limit < math.inf:
            continue
        start = law(work, q0, v0, j)
        reach = SAFETY * h * (stiffness * bounds[0, j] + damping * bounds[1, j])
        for part in range(2):
            room = side[j] * start - limit if side[j] != 0 else limit - (1.0 - 2.0 * part) * start
            if (side[j] != 0 and part == 1) or room > reach:
                continue
            i = j + part * len(v0)
            found = first_fall(work, i, end, AT_BOUND * limit)
            if found < end:
                time, end, which = found, found, i
    return time, which
