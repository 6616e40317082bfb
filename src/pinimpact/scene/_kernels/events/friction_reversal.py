"""A joint that slides against its dry friction comes to rest."""

from __future__ import annotations

import math

from ...._compile.declared import declared
from ...._compile.jit import external, inlined
from ....geometry.tolerances import SAFETY
from ..event_location import search_for_fall
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inlined
def value(work, j, t):
    """Return the velocity of joint j against its dry friction at the state set in the workspace."""
    return math.copysign(work.v[j], work.v[j] * work.sliding_friction[j]), 0.0


first_fall = search_for_fall(value)


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time before `end` at which a joint comes to rest, or infinity; and its index in v."""
    sliding, v0, peak_rates, h = work.sliding_friction, work.v0, work.rate_bounds[1], work.step_length
    time, which = math.inf, 0
    for j in range(len(v0)):
        if sliding[j] != 0.0 and not abs(v0[j]) > SAFETY * h * peak_rates[j]:
            speed = max(abs(v0[j]), abs(work.v1[j]))
            found = first_fall(work, j, end, work.atol + work.rtol * speed)
            if found < end:
                time, end, which = found, found, j
    return time, which
