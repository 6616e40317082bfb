"""Which forces act where they are not unique and the motion depends on them. (theory.md, 11)

Contacts that share their load and slip may share it in several ways, each with another friction, and the
motion is another for each. Those of least norm are taken where they keep within their bounds and let begin
what begins to slip; else those by which the modes were found, lest what they set in motion stays, or those
farthest from their bounds. Until the modes are set anew it is the nearest to them that act.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import external, inlined, jit
from .active_set import scalar_rows
from .contact_forces import SLIP, rubs
from .dynamics import evaluate
from .tolerances import ASIDE, DOUBTFUL, NEGLIGIBLE, STILL
from .widest_margin import ANY_MOTION, SAME_MOTION, widest_margin
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS)
@external
def choose_forces(work, t, out):
    """Choose the forces of a motion that begins, evaluated at its start; see `dynamics.evaluate`."""
    if work.forces_unique:
        return
    if not rubs(work):
        fit(work, t, out, 0.0)
        return
    known, doubtful = work.inner_forces, doubtful_margin(work)
    for enough in (doubtful, 0.0):  # forces that only just fit leave their bounds soon
        if fit(work, t, out, enough):
            return
        take_found(work)
        evaluate(work, t, out)
        if fit(work, t, out, enough):
            return
        if widest_margin(work, ANY_MOTION, known) > enough:
            evaluate(work, t, out)
            if fit(work, t, out, enough):
                return
        for a in range(len(known)):
            known[a] = 0.0
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
def fit(work, t, out, enough):
    """Return whether the forces last evaluated are so far in their bounds, or others with the same motion.

    These act then. And whether no slip begins backwards, or across rather than along the direction of its
    friction, nor a joint against its dry friction.
    """
    if work.force_margin < enough:
        if not widest_margin(work, SAME_MOTION, work.inner_forces) > enough:
            return False
        evaluate(work, t, out)
    mode, mu, jacobian = work.active_mode, work.active_friction, work.contact_jacobian
    velocity, reference, free = work.contact_velocity, work.slip_reference, work.contact_acceleration
    acceleration = work.acceleration
    for k in range(len(mode)):
        if mode[k] != SLIP or mu[k] == 0.0:
            continue
        speed = math.hypot(velocity[k, 0], velocity[k, 1])
        if speed > work.certain_speed:
            continue
        along = across = largest = 0.0
        for d in range(2):
            total = free[k, d]
            largest = max(largest, abs(total))
            for j in range(len(acceleration)):
                total += jacobian[k, d, j] * (out[j] - acceleration[j])
            along += reference[k, d] * total
            across += reference[k, 1 - d] * total * (1 - 2 * d)
        begins = speed <= STILL * work.stick_speed
        if along < -NEGLIGIBLE * largest or (begins and abs(across) > ASIDE * along + NEGLIGIBLE * largest):
            return False
    sliding, v = work.sliding_friction, work.v
    for j in range(len(acceleration)):
        if sliding[j] != 0.0 and abs(v[j]) <= work.certain_speed:
            along = out[j] if sliding[j] > 0.0 else -out[j]
            if along < -NEGLIGIBLE * (abs(acceleration[j]) + abs(out[j])):
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
