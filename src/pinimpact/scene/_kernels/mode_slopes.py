"""How velocities and forces of closed contacts change with the configuration. (derivatives.md, 9)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ...geometry._kernels import constants
from ...robot._kernels import configuration_slopes as slopes
from ...robot._kernels.placement import rotate
from .force_evaluation import places_of_contacts
from .workspace import SceneWorkspace


@declared(SceneWorkspace, INTEGERS, FLOAT_ROWS, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS)
@jit
def closed_slopes(work, parent, scratch, axes, velocities, forces):
    """Fill how contact velocities change with q, and Jᵀf at the forces that `forces_at` has left. (D19, D20)

    Args:
        work: The workspace.
        parent: (joints,) the joint that each stands on; the first is the world.
        scratch: (joints, 6).
        axes: (k, 3, 3) takes the axes of the closed contacts, as rows.
        velocities: (k, 3, nv) takes ∂(contact velocity)/∂q, in axes that turn with the surface.
        forces: (nv, nv) takes ∂(Jᵀf)/∂q at forces that turn with the axes.
    """
    index, force = work.active_index, work.contact_force
    columns, points = np.ascontiguousarray(work.joint_jacobian), np.empty((len(index), 3))
    at, push = np.empty(slopes.PLACE), np.empty(3)
    places_of_contacts(work, index, axes, points)
    forces[:, :] = 0.0
    for m in range(len(index)):
        _fill_place(work, index[m], axes[m], points[m], at)
        ends = work.contact_joints[index[m]]
        slopes.velocity_slopes(
            columns, work.velocity_joint, parent, ends, at, work.v, True, scratch, velocities[m]
        )
        for d in range(3):
            push[d] = force[m, 0] * axes[m, 0, d] + force[m, 1] * axes[m, 1, d] + force[m, 2] * axes[m, 2, d]
        slopes.force_slopes(columns, work.velocity_joint, parent, ends, at, push, forces)


@inlined
def _fill_place(work, i, axes, point, at):
    """Fill where a contact is, see `configuration_slopes.PLACE`."""
    k, base = work.contact_constants[i], work.placements[work.contact_joints[i, 1]]
    for d in range(3):
        for e in range(3):
            at[slopes.AXES + 3 * d + e] = axes[d, e]
        at[slopes.POINT + d] = point[d]
        at[slopes.TIP + d] = point[d] + k[constants.RADIUS] * axes[2, d]
    o, u, w = constants.POINT, constants.VELOCITY, constants.SPIN
    x1, x2, x3 = rotate(base, k[o], k[o + 1], k[o + 2])
    at[slopes.ORIGIN], at[slopes.ORIGIN + 1], at[slopes.ORIGIN + 2] = (
        x1 + base[9],
        x2 + base[10],
        x3 + base[11],
    )
    at[slopes.MATERIAL], at[slopes.MATERIAL + 1], at[slopes.MATERIAL + 2] = rotate(
        base, k[u], k[u + 1], k[u + 2]
    )
    at[slopes.SPIN], at[slopes.SPIN + 1], at[slopes.SPIN + 2] = rotate(base, k[w], k[w + 1], k[w + 2])
    at[slopes.RADIUS], at[slopes.ROUND], at[slopes.TURNS] = k[constants.RADIUS], 0.0, 1.0
    if k[constants.KIND] == constants.SPHERE:
        away = along = 0.0
        for d in range(3):
            x = at[slopes.TIP + d] - at[slopes.ORIGIN + d]
            away, along = away + x * x, along + x * axes[2, d]
        at[slopes.ROUND] = math.copysign(1.0 / math.sqrt(away), along)
