"""Drives: linear position and damping laws of joints, with effort limits.

Within a step a drive either follows its law or stays at its limit, so that the motion is smooth; reaching or
leaving the limit is an event.
"""

from __future__ import annotations

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import inlined, jit
from .tolerances import AT_BOUND
from .workspace import SceneWorkspace


@inlined
def law(work, q, v, j):
    """Return the effort of the law of drive j at a state, without limit [N or N m]."""
    error = work.drive_reference[j] - q[work.drive_coordinate[j]]
    return work.drive_stiffness[j] * error - work.drive_damping[j] * v[j]


@inlined
def drive(work):
    """Set the efforts of the drives at the state set in the workspace."""
    for j in work.drive_velocity:
        side = work.drive_side[j]
        work.control_force[j] = law(work, work.q, work.v, j) if side == 0 else side * work.drive_limit[j]


@declared(SceneWorkspace, FLOATS, FLOATS)
@jit
def set_saturation(work, q, v):
    """Update which drives are at their effort limits, at a state after a possible jump of v."""
    for j in work.drive_velocity:
        asked = law(work, q, v, j)
        side, limit = work.drive_side[j], work.drive_limit[j]
        if side != 0 and side * asked < limit * (1.0 - AT_BOUND):
            side = 0
        if side == 0 and abs(asked) > limit * (1.0 + AT_BOUND):
            side = 1 if asked > 0.0 else -1
        work.drive_side[j] = side
