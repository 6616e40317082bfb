"""v̇ of a robot with the contacts that are closed, evaluated from compiled code."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.elimination import RANK, solve
from ..._numeric.loops import assign, filled
from ..._numeric.semidefinite import solve_definite
from ...geometry._kernels.constants import RADIUS
from ...robot._kernels import contact_kinematics, contact_motion
from ...robot._kernels.python_calls import call
from . import contact_forces
from .drives import drive
from .tolerances import NEGLIGIBLE, SINGULAR_STILL
from .workspace import SceneWorkspace

ABA, INVERT, KINEMATICS, CONTROL = np.int64(0), np.int64(2), np.int64(4), np.int64(6)
"""Where `calls` has the function; its arguments follow."""

FAR = 0.1
"""Of the radius of a sphere that bounds contacts: beyond this gap none of them touches, nor is soon to."""


@inlined
def set_state(work, q, v):
    """Copy a state to where Pinocchio reads it."""
    assign(work.q, q)
    assign(work.v, v)


@inlined
def call_python(work, k):
    """Call the k-th of `calls`; return whether that went well."""
    if not call(work.calls[k], work.calls[k + 1]):
        work.callback_failed = True
    return not work.callback_failed


# ---- gaps


@inlined
def compute_kinematics(work):
    """Leave placements and velocities of the joints at the state that is set."""
    call_python(work, KINEMATICS)


@inlined
def gap_of(work, i, constants):
    """Return gap and gap rate at the joints of a contact, at the kinematics last computed."""
    placements, velocities, joints = work.placements, work.local_velocities, work.contact_joints
    tip, base = joints[i, 0], joints[i, 1]
    return contact_motion.gap_and_rate(
        placements[tip], velocities[tip], placements[base], velocities[base], constants
    )


@inlined
def contact_gap(work, i):
    """Return gap and gap rate of a contact."""
    return gap_of(work, i, work.contact_constants[i])


@inlined
def sphere_gap(work, k, first):
    """Return gap and gap rate of a sphere that bounds contacts, given the first of them."""
    return gap_of(work, first, work.sphere_constants[k])


@declared(SceneWorkspace, FLOAT_ROWS, FLOAT_ROWS)
@external
def contact_gaps(work, found, spheres):
    """Fill gap and gap rate (n, 2) of all contacts, and of the spheres that bound some, at the state set.

    Contacts whose sphere is far from its surface are not looked at: their gap is infinite here.
    """
    blocks, constants = work.contact_blocks, work.sphere_constants
    compute_kinematics(work)
    for b in range(len(blocks)):
        first, stop, k = blocks[b, 0], blocks[b, 1], blocks[b, 2]
        far = False
        if k >= 0:
            spheres[k, 0], spheres[k, 1] = sphere_gap(work, k, first)
            far = spheres[k, 0] > FAR * constants[k, RADIUS]
        for i in range(first, stop):
            if far:
                found[i, 0], found[i, 1] = math.inf, 0.0
            else:
                found[i, 0], found[i, 1] = contact_gap(work, i)


@inlined
def limit_gap(work, k, q, v):
    """Return gap and gap rate of a joint limit at a state, in metres as of a contact."""
    scale = limit_scale(work, k)
    return scale * (q[work.limit_q[k]] - work.limit_bound[k]), scale * v[work.limit_v[k]]


@inlined
def limit_scale(work, k):
    """Return the derivative of the gap of a joint limit by its coordinate [m/rad, or 1]."""
    return work.limit_sign[k] * work.joint_metres[work.limit_v[k]]


@declared(SceneWorkspace, FLOATS, FLOATS, FLOAT_ROWS)
@external
def all_gaps(work, q, v, found):
    """Fill (n + nl, 2) gaps and rates of all contacts, then of the joint limits, at a state.

    A gap is infinite as `contact_gaps` says.
    """
    set_state(work, q, v)
    contacts = work.contacts
    if contacts > 0:
        contact_gaps(work, found[:contacts], np.empty((work.spheres, 2)))
    for k in range(work.limits):
        found[contacts + k, 0], found[contacts + k, 1] = limit_gap(work, k, q, v)


# ---- contact motion


@external
def set_signs(work, i):
    """Set which velocities move the tip of a contact, or its surface, only."""
    signs = filled(work.velocity_signs, 0.0)
    for end in range(2):
        c = work.joint_velocity[work.contact_joints[i, end]]
        while c >= 0:
            signs[c] += 1.0 - 2.0 * end
            c = work.velocity_parent[c]


@inlined
def moving_columns(work, i, columns, signs):
    """Fill which velocities move the tip of a contact or its surface only, in order, and their signs.

    Return how many they are.
    """
    a = work.joint_velocity[work.contact_joints[i, 0]]
    b = work.joint_velocity[work.contact_joints[i, 1]]
    count = 0
    while a != b:  # what they share moves both
        if a > b:
            columns[count], signs[count] = a, 1.0
            a = work.velocity_parent[a]
        else:
            columns[count], signs[count] = b, -1.0
            b = work.velocity_parent[b]
        count += 1
    for k in range(count // 2):
        o = count - 1 - k
        columns[k], columns[o] = columns[o], columns[k]
        signs[k], signs[o] = signs[o], signs[k]
    return count


@declared(SceneWorkspace, int, FLOAT_ROWS, FLOATS, FLOATS, FLOATS)
@external
def motion_of_contact(work, i, jacobian, velocity, acceleration, surface):
    """Fill the motion of a contact, see `contact_motion.contact_motion`; return the gap [m]."""
    set_signs(work, i)
    turning = surface  # which is filled after it
    return motion_by_columns(
        work, i, work.joint_jacobian, work.velocity_signs, jacobian, velocity, acceleration, turning, surface
    )


@inlined
def motion_by_columns(work, i, columns, signs, jacobian, velocity, acceleration, turning, surface):
    """Fill the motion of a contact, with some columns of the joint Jacobian and their signs."""
    places, velocities, accelerations = work.placements, work.spatial_velocities, work.spatial_accelerations
    tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
    return contact_motion.contact_motion(
        *(places[tip], velocities[tip], accelerations[tip], places[base], velocities[base]),
        *(accelerations[base], work.contact_constants[i], columns, signs),
        *(jacobian, velocity, acceleration, turning, surface),
    )


@inlined
def follow_surface(work, i):
    """Let the axes of a contact follow its surface, see `contact_kinematics.follow`."""
    tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
    contact_kinematics.follow(work.placements[tip], work.placements[base], work.contact_constants[i])


@inlined
def motion_of_contacts(work, index, jacobian, velocity, acceleration, surface, gap):
    """Fill the motion of some contacts at the state last evaluated without contact forces."""
    for k in range(len(index)):
        gap[k] = motion_of_contact(work, index[k], jacobian[k], velocity[k], acceleration[k], surface[k])


# ---- accelerations


@declared(SceneWorkspace, float, FLOATS)
@external
def evaluate_without_contacts(work, t, powers):
    """Leave v̇ without contact forces, and the kinematics; fill the powers of control and joints."""
    if work.calls[CONTROL] != 0:
        work.control_time = t
        if not call_python(work, CONTROL):
            return
    drive(work)
    work.evaluations += 1
    contact_forces.joint_forces(work, powers)
    call_python(work, ABA)


@inlined
def invert_mass_matrix(work):
    """Leave M⁻¹ at the state last evaluated; return whether that went well."""
    return call_python(work, INVERT)


@declared(SceneWorkspace, float, FLOATS)
@external
def evaluate(work, t, out):
    """Fill `out` (nv + 4) with v̇ and the powers of control, joints, sliding friction and surfaces."""
    acceleration = work.acceleration
    n = len(acceleration)
    evaluate_without_contacts(work, t, out[n:])
    assign(out[:n], acceleration)
    if work.active_contacts + work.active_scalars == 0 or work.callback_failed:
        return
    if not invert_mass_matrix(work):
        return
    motion_of_contacts(
        *(work, work.active_index, work.contact_jacobian, work.contact_velocity),
        *(work.contact_acceleration, work.surface_velocity, work.contact_gap),
    )
    effective = contact_forces.set_up_equations(work, out[:n])
    system, target = work.system, work.target
    total = 0.0
    for a in range(len(target)):
        total += target[a]
        for b in range(len(target)):
            total += system[a, b]
    if not math.isfinite(total):  # a stage far off; the step will be refused
        filled(out, math.nan)
        return
    orientation, rubs = 0, contact_forces.rubs(work)
    if rubs:
        rank = RANK if work.forces_unique else SINGULAR_STILL
        orientation = solve(system, target, work.solution, rank)
    elif work.forces_unique:  # else it says nothing new, and without slip there is no jam
        orientation = 1 if solve_definite(system, target, work.solution) else 0
    work.forces_unique = orientation != 0
    if orientation == 0:
        work.forces_unique = contact_forces.solve_least_norm(work) and not rubs
    margin = contact_forces.apply_forces(work, out[:n], out[n + 2 :])
    # without friction the determinant is positive, so where it is not, slip has passed a singularity
    drives = effective <= NEGLIGIBLE and contact_forces.accelerates_inward(work)
    work.force_margin = -math.inf if orientation < 0 or drives else work.force_tolerance + margin
