"""The forces of what is closed leave what their modes allow: a contact opens or slips, a joint moves."""

from __future__ import annotations

import math

import numpy as np

from ...._numeric.ahead import ahead
from ...._numeric.jit import inner, separate
from ..dynamics import evaluate
from ..event_location import sampled, search_for_root
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE

PARTS = 10
"""Parts of a step at which the forces are sampled where its stages saw them leave their bounds."""


@inner
def value(work, _, t):
    """Return by how much the forces keep to what their modes allow, at the state that is set."""
    evaluate(work, t, np.empty(len(work.v) + 4))
    return max(work.force_margin, -1e300), 0.0


value_at, root = sampled(value), search_for_root(value)


@ahead(SceneWorkspace, float)
@separate
def first(work, end):
    """Return the first time until `end` at which the forces are seen to leave their bounds, else infinity."""
    if work.closed_contacts + work.closed_scalars == 0:
        return math.inf, 0
    if not work.least_force_margin < 0.0 or work.force_bound_ignored:
        return math.inf, 0
    start = before = work.step_start
    margin_before = value_at(work, 0, start)[0]
    for part in range(1, PARTS + 1):
        time = end if part == PARTS else start + (end - start) * part / PARTS
        margin = value_at(work, 0, time)[0]
        if margin < 0.0:
            if margin_before > 0.0:
                return root(work, 0, before, time, margin_before, margin), 0
            return time, 0
        before, margin_before = time, margin
    return math.inf, 0
