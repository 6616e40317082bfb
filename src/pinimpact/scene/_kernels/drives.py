"""Drives: joints that a linear law draws to a reference, up to an effort that they cannot exceed.

Over a step a drive either follows its law or stays at its bound, so that the motion is smooth; that it
reaches or leaves the bound is an event.
"""

from __future__ import annotations

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import inlined, jit
from .tolerances import AT_BOUND
from .workspace import SceneWorkspace


@inlined
def law(work, q, v, j):
    """Return what the law of a drive asks for at a state [N or N m]."""
    off = work.drive_reference[j] - q[work.drive_coordinate[j]]
    return work.drive_stiffness[j] * off - work.drive_damping[j] * v[j]


@inlined
def drive(work):
    """Set the forces of the drives at the state that is set."""
    for j in work.drive_velocity:
        side = work.drive_side[j]
        work.control_force[j] = law(work, work.q, work.v, j) if side == 0 else side * work.drive_limit[j]


@declared(SceneWorkspace, FLOATS, FLOATS)
@jit
def set_saturation(work, q, v):
    """Tell which drives are at their bounds, at a state to which the velocity may have jumped."""
    for j in work.drive_velocity:
        asked = law(work, q, v, j)
        side, limit = work.drive_side[j], work.drive_limit[j]
        if side != 0 and side * asked < limit * (1.0 - AT_BOUND):
            side = 0
        if side == 0 and abs(asked) > limit * (1.0 + AT_BOUND):
            side = 1 if asked > 0.0 else -1
        work.drive_side[j] = side
