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
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inlined
def value(work, _, t):
    """Return the force margin (11.6) at the state set in the workspace, relative to `least_margin` [N]."""
    evaluate(work, t, np.empty(len(work.v) + 4))
    return max(work.force_margin - work.least_margin, -1e300), 0.0


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
    if work.least_margin == -math.inf:
        return math.inf, 0
    if clear_of_zero(work.sample_times, work.sample_margins, work.samples):
        return math.inf, 0
    largest, least_load = 0.0, math.inf
    for a in range(len(work.solution)):
        largest = max(largest, abs(work.solution[a]))
        least_load = min(least_load, work.row_tolerance[a] / WEIGHTLESS)
    return first_fall(work, 0, end, work.rtol * min(largest, least_load)), 0
