"""A joint reaches a limit that is not active."""

from __future__ import annotations

import math

from ...._compile.declared import declared
from ...._compile.jit import external, inlined
from ....geometry.tolerances import SAFETY
from ..dynamics import limit_gap
from ..event_location import search_for_closing
from ..workspace import SceneWorkspace
from .consequences import ARRIVAL

CONSEQUENCE = ARRIVAL


@inlined
def value(work, k, t):
    """Return gap [m] and gap rate [m/s] of limit k at the state set in the workspace."""
    return limit_gap(work, k, work.q, work.v)


first_closing = search_for_closing(value)


@inlined
def bound(work, k):
    """Fill `limit_bounds` of limit k over the step, see `gap_bounds.curvatures`; limits have no curvature."""
    bounds, rates, j = work.limit_bounds, work.rate_bounds, work.limit_v[k]
    scale = SAFETY * work.joint_metres[j]
    bounds[k, 0], bounds[k, 1], bounds[k, 2], bounds[k, 3] = (
        scale * rates[1, j],
        scale * rates[3, j],
        scale * rates[0, j],
        math.inf,
    )


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time until `end` at which a limit is reached, or infinity; and its number."""
    closed = work.modes[work.contacts :]
    time, which = math.inf, 0
    for k in range(work.limits):
        if closed[k] == 0:
            gap, rate = limit_gap(work, k, work.q0, work.v0)
            end_gap, end_rate = limit_gap(work, k, work.q1, work.v1)
            bound(work, k)
            found = first_closing(work, k, end, gap, rate, end_gap, end_rate, work.limit_bounds[k])
            if found <= end:
                time, end, which = found, found, k
    return time, which
