"""The forces of what is closed leave what their modes allow: a contact opens or slips, a joint moves."""

from __future__ import annotations

import math

import numpy as np

from ...._compile.declared import declared
from ...._compile.jit import external, inlined, jit
from ..dynamics import evaluate
from ..event_location import search_for_fall
from ..samples import clear_of_zero
from ..widest_margin import widest_margin
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inlined
def value(work, _, t):
    """Return by how much forces can keep to what their modes allow, at the state that is set."""
    evaluate(work, t, np.empty(len(work.v) + 4))
    return max(margin_of_forces(work, 0.0), -1e300), 0.0


@declared(SceneWorkspace, float)
@jit
def margin_of_forces(work, enough):
    """Return by how much forces can keep to what their modes allow, at the state last evaluated.

    It is forces with the same motion that count, see `force_choice`, and those that are found are kept.
    Others than those that act are looked for where the margin of these is not `enough`.
    """
    margin = work.force_margin
    if margin < enough and not work.forces_unique:
        margin = widest_margin(work, work.inner_forces) + work.force_tolerance
    return margin


first_fall = search_for_fall(value)


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time until `end` at which the forces are seen to leave their bounds, else infinity."""
    if work.active_contacts + work.active_scalars == 0 or work.force_bound_ignored:
        return math.inf, 0
    if clear_of_zero(work.sample_times, work.sample_margins, work.samples):
        return math.inf, 0
    largest = 0.0
    for force in work.solution:
        largest = max(largest, abs(force))
    return first_fall(work, 0, end, work.rtol * largest), 0
