"""Choice of forces where they are not unique and the motion depends on them. (theory.md, 11.4)

Several slipping contacts can share a load in more than one way, each with a different friction and motion.
The limit of small compliances (11.12) is chosen if it satisfies its bounds and is consistent with the slip
that begins; otherwise the forces from which the modes were determined. Until the modes are chosen again, the
solution nearest to the chosen one is used.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import filled
from .active_set import scalar_rows
from .contact_forces import SLIP, slips_with_friction
from .dynamics import evaluate
from .tolerances import DOUBTFUL, NEGLIGIBLE
from .widest_margin import widest_margin
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS)
@external
def choose_forces(work, t, out):
    """Choose the forces at the start of a motion, just evaluated; `out` as in `dynamics.evaluate`."""
    if work.forces_unique:
        return
    if not slips_with_friction(work):
        if work.force_margin < 0.0 and widest_margin(work, work.inner_forces) > 0.0:
            evaluate(work, t, out)
        return
    if work.force_margin >= 0.0 and opposes_slip(work, out):
        return
    use_found_forces(work)
    evaluate(work, t, out)
    if work.force_margin >= -doubtful_margin(work) and opposes_slip(work, out):
        return
    filled(work.inner_forces, 0.0)
    evaluate(work, t, out)


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


@inlined
def opposes_slip(work, out):
    """Return whether every incipient slip is opposed by its friction, at the accelerations `out`."""
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
def use_found_forces(work):
    """Copy the forces from which the modes were determined, `found_forces`, to `inner_forces`."""
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
