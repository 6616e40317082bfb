"""How velocities and forces of closed contacts change with the configuration. (derivatives.md, 9)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, INTEGERS, declared
from ..._compile.jit import jit
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
    columns, joint = work.joint_jacobian, work.velocity_joint
    points, at = np.empty((len(index), 3)), np.empty(slopes.PLACE)
    places_of_contacts(work, index, axes, points)
    forces[:, :] = 0.0
    slopes.fill_motions(columns, joint, parent, work.v, scratch)
    for m in range(len(index)):
        i = index[m]
        tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
        slopes.fill_place(
            work.contact_constants[i], work.placements[base], axes[m].reshape(9), points[m], True, at
        )
        slopes.velocity_slopes(columns, joint, parent, tip, base, at, scratch, True, velocities[m])
        f1, f2, f3 = rotate(at, force[m, 0], force[m, 1], force[m, 2])
        slopes.force_slopes(columns, joint, parent, tip, base, at, f1, f2, f3, forces)
