"""Forces of the active set at a state, and their points of action, in world axes."""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import external, jit
from ...robot._kernels import contact_kinematics
from ...robot._kernels.placement import rotate
from .active_set import close
from .dynamics import evaluate_anew, set_state
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS, FLOATS, FLOAT_ROWS, bool)
@external
def evaluate_closed(work, t, q, v, directions, unique):
    """Evaluate motion and forces in the workspace for the modes `work.modes`; arguments as in `forces_at`."""
    close(work, directions)
    work.forces_unique = unique
    set_state(work, q, v)
    evaluate_anew(work, t, np.empty(len(v) + 4))


@declared(
    *(SceneWorkspace, float, FLOATS, FLOATS, FLOAT_ROWS, bool),
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOATS),
)
@jit
def forces_at(work, t, q, v, directions, unique, forces, points, normals, joints):
    """Fill the forces of the active set for the modes `work.modes`.

    Args:
        work: The workspace, with the modes, constants of the contacts, signs of dry friction and control.
        t, q, v: Time [s] and state.
        directions: (n, 2) reference directions of slip.
        unique: Whether the forces have been unique so far.
        forces: (n, 3) is overwritten with the forces on the robot in world axes [N]; zero before.
        points: (n, 3) is overwritten with their points of action in world axes [m].
        normals: (n, 3) is overwritten with the surface normals there, in world axes.
        joints: (nv,) is overwritten with the generalized forces of joint stops and dry friction; zero before.

    Returns:
        Whether the motion determines the forces.
    """
    evaluate_closed(work, t, q, v, directions, unique)
    if work.callback_failed:
        return False
    index, found = work.active_index, work.contact_force
    axes = np.empty((len(index), 3, 3))
    place = np.empty((len(index), 3))
    places_of_contacts(work, index, axes, place)
    for m in range(len(index)):
        i = index[m]
        for d in range(3):
            points[i, d], normals[i, d] = place[m, d], axes[m, 2, d]
            forces[i, d] = (
                found[m, 0] * axes[m, 0, d] + found[m, 1] * axes[m, 1, d] + found[m, 2] * axes[m, 2, d]
            )
    velocity, scalar = work.scalar_velocity, work.scalar_force
    for m in range(len(velocity)):
        joints[velocity[m]] += scalar[m]
    for j in range(len(joints)):
        joints[j] -= work.sliding_friction[j]
    return work.forces_unique


@declared(SceneWorkspace, INTEGERS, FLOAT_STACK, FLOAT_ROWS)
@jit
def places_of_contacts(work, index, axes, points):
    """Fill contact axes and points, in world axes, of contacts `index` (k,) at the last kinematics.

    `axes` (k, 3, 3) has t₁, t₂ and n of each as rows; `points` (k, 3) are the contact points [m].
    """
    for m in range(len(index)):
        k, tip = work.contact_constants[index[m]], work.placements[work.contact_joints[index[m], 0]]
        base = work.placements[work.contact_joints[index[m], 1]]
        _, _, _, _, points[m, 0], points[m, 1], points[m, 2] = contact_kinematics.at_contact(tip, base, k)
        _, _, _, x1, x2, x3 = contact_kinematics.relative(tip, base, k)
        _, n1, n2, n3 = contact_kinematics.distance(tip, base, k, x1, x2, x3)
        a1, a2, a3, b1, b2, b3 = contact_kinematics.carried_axes(k, n1, n2, n3)
        axes[m, 0, 0], axes[m, 0, 1], axes[m, 0, 2] = rotate(base, a1, a2, a3)
        axes[m, 1, 0], axes[m, 1, 1], axes[m, 1, 2] = rotate(base, b1, b2, b3)
        axes[m, 2, 0], axes[m, 2, 1], axes[m, 2, 2] = rotate(base, n1, n2, n3)
