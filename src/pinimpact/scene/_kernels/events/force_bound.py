"""Forces of the active set leave their bounds: a contact opens or slips, a joint starts to move. (11.6)"""

from __future__ import annotations

import math

import numpy as np

from ...._compile.declared import declared
from ...._compile.jit import external, inlined, jit
from ..dynamics import evaluate
from ..event_location import search_for_fall
from ..samples import clear_of_zero
from ..tolerances import DOUBTFUL, WEIGHTLESS
from ..widest_margin import widest_margin
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inlined
def value(work, _, t):
    """Return the force margin at the state set in the workspace [N].

    While the bounds of the present forces are ignored it is that of all forces of the modes, with any motion.
    """
    evaluate(work, t, np.empty(len(work.v) + 4))
    if not work.force_bound_ignored:
        return max(margin_of_forces(work, 0.0), -1e300), 0.0
    margin = work.force_margin
    if margin < 0.0:
        margin = 1e300 if work.forces_unique else widest_margin(work, False)
    return margin, 0.0


@declared(SceneWorkspace, float)
@jit
def margin_of_forces(work, enough):
    """Return the force margin (11.6) at the state last evaluated, with `row_tolerance` [N].

    If that of the present forces is below `enough`, it is maximized over all forces with the same motion.
    """
    margin = work.force_margin
    return widest_margin(work, True) if margin < enough and not work.forces_unique else margin


@declared(SceneWorkspace)
@jit
def doubtful_margin(work):
    """Return the force margin [N] up to which, given the errors, the forces may violate their bounds."""
    largest_force = tolerance = 0.0
    for force in work.solution:
        largest_force = max(largest_force, abs(force))
    for negligible in work.row_tolerance:
        tolerance = max(tolerance, negligible)
    return 2.0 * tolerance + DOUBTFUL * largest_force


first_fall = search_for_fall(value)


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time until `end` at which forces leave their bounds, or infinity; and index 0."""
    if work.active_contacts + work.active_scalars == 0:
        return math.inf, 0
    if work.force_bound_ignored and (work.forces_unique or work.force_bound_lost):
        return math.inf, 0
    if clear_of_zero(work.sample_times, work.sample_margins, work.samples):
        return math.inf, 0
    largest, least_load = 0.0, math.inf
    for a in range(len(work.solution)):
        largest = max(largest, abs(work.solution[a]))
        least_load = min(least_load, work.row_tolerance[a] / WEIGHTLESS)
    return first_fall(work, 0, end, work.rtol * min(largest, least_load)), 0
