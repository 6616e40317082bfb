"""Which forces act where they are not unique and the motion depends on them. (theory.md, 11)

Contacts that share their load and slip may share it in several ways, each with another friction, and the
motion is another for each. Those of least norm are taken where they keep within their bounds and let begin
what begins to slip; else those by which the modes were found, lest what they set in motion stays. Until the
modes are set anew it is the nearest to them that act.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import filled
from .active_set import scalar_rows
from .contact_forces import SLIP, rubs
from .dynamics import evaluate
from .tolerances import DOUBTFUL, NEGLIGIBLE
from .widest_margin import widest_margin
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS)
@external
def choose_forces(work, t, out):
    """Choose the forces of a motion that begins, evaluated at its start; see `dynamics.evaluate`."""
    if work.forces_unique:
        return
    if fit(work, t, out) or not rubs(work):
        return
    take_found(work)
    evaluate(work, t, out)
    if fit(work, t, out):
        return
    filled(work.inner_forces, 0.0)
    evaluate(work, t, out)


@declared(SceneWorkspace)
@jit
def doubtful_margin(work):
    """Return a margin up to which forces do not clearly keep to what their modes allow."""
    largest = 0.0
    for force in work.solution:
        largest = max(largest, abs(force))
    return 2.0 * work.force_tolerance + DOUBTFUL * largest


@inlined
def fit(work, t, out):
    """Return whether the forces last evaluated keep to their bounds, or others with the same motion.

    These act then. And whether no slip begins against the direction of its friction.
    """
    if work.force_margin < 0.0:
        if not widest_margin(work, work.inner_forces) > 0.0:
            return False
        evaluate(work, t, out)
    mode, mu, jacobian = work.active_mode, work.active_friction, work.contact_jacobian
    velocity, reference, free = work.contact_velocity, work.slip_reference, work.contact_acceleration
    acceleration = work.acceleration
    for k in range(len(mode)):
        if mode[k] != SLIP or mu[k] == 0.0:
            continue
        if math.hypot(velocity[k, 0], velocity[k, 1]) > work.certain_speed:
            continue
        along = largest = 0.0
        for d in range(2):
            total = free[k, d]
            largest = max(largest, abs(total))
            for j in range(len(acceleration)):
                total += jacobian[k, d, j] * (out[j] - acceleration[j])
            along += reference[k, d] * total
        if along < -NEGLIGIBLE * largest:
            return False
    return True


@inlined
def take_found(work):
    """Take as known the forces by which the modes were found."""
    known, found, mode, index = work.inner_forces, work.found_forces, work.active_mode, work.active_index
    a = 0
    for k in range(len(mode)):
        if mode[k] == SLIP:
            known[a] = found[index[k], 2]
            a += 1
        else:
            for d in range(3):
                known[a + d] = found[index[k], d]
            a += 3
    for i in scalar_rows(work, work.modes[work.contacts :]):
        known[a] = found[work.contacts + i, 0]
        a += 1
