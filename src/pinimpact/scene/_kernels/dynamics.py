"""Accelerations and gaps of a robot with active contacts, evaluated in compiled code. (theory.md, 9, 10)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.elimination import RANK, solve
from ..._numeric.loops import assign, filled
from ..._numeric.products import dot
from ..._numeric.semidefinite import solve_definite
from ..._numeric.tolerances import LITTLE
from ...geometry._kernels.constants import ABSENT, KIND, RADIUS
from ...robot._kernels import contact_kinematics, contact_motion
from ...robot._kernels.python_calls import call
from . import contact_forces
from .compliant_forces import compliant_forces
from .drives import drive
from .tolerances import NEGLIGIBLE, SINGULAR_STILL, UNDECIDED
from .workspace import SceneWorkspace

ABA, INVERT, KINEMATICS, CONTROL = np.int64(0), np.int64(2), np.int64(4), np.int64(6)
"""Positions of the functions' addresses in `calls`; the address of the arguments follows each."""

FAR = 0.1
"""Gap of a bounding sphere, relative to its radius, beyond which gaps of its contacts are not computed."""


@inlined
def set_state(work, q, v):
    """Copy q (nq,) and v (nv,) into the workspace, where Pinocchio reads them."""
    assign(work.q, q)
    assign(work.v, v)


@inlined
def call_python(work, k):
    """Call function k of `calls`; return whether no call has failed so far."""
    if not call(work.calls[k], work.calls[k + 1]):
        work.callback_failed = True
    return not work.callback_failed


# ---- gaps


@inlined
def compute_kinematics(work):
    """Fill `placements` and `local_velocities` of the joints at the state set in the workspace."""
    call_python(work, KINEMATICS)


@inlined
def gap_of(work, i, constants):
    """Return gap [m] and gap rate [m/s] of a tip with these constants at the joints of contact i."""
    placements, velocities, joints = work.placements, work.local_velocities, work.contact_joints
    tip, base = joints[i, 0], joints[i, 1]
    return contact_motion.gap_and_rate(
        placements[tip], velocities[tip], placements[base], velocities[base], constants
    )


@inlined
def contact_gap(work, i):
    """Return gap [m] and gap rate [m/s] of contact i, at the kinematics last computed."""
    return gap_of(work, i, work.contact_constants[i])


@inlined
def sphere_gap(work, k, first):
    """Return gap [m] and gap rate [m/s] of bounding sphere k, whose first contact is `first`."""
    return gap_of(work, first, work.sphere_constants[k])


@declared(SceneWorkspace, FLOAT_ROWS, FLOAT_ROWS)
@external
def contact_gaps(work, found, spheres):
    """Fill gap and gap rate of all contacts, found (n, 2), and bounding spheres (k, 2), at the state set.

    The gap of a contact whose sphere is farther from the surface than `FAR` is set to infinity.
    """
    blocks, constants, contacts = work.contact_blocks, work.sphere_constants, work.contact_constants
    compute_kinematics(work)
    for b in range(len(blocks)):
        first, stop, k = blocks[b, 0], blocks[b, 1], blocks[b, 2]
        far = False
        if k >= 0:
            spheres[k, 0], spheres[k, 1] = sphere_gap(work, k, first)
            far = spheres[k, 0] > FAR * constants[k, RADIUS]
        for i in range(first, stop):
            if far or contacts[i, KIND] == ABSENT:
                found[i, 0], found[i, 1] = math.inf, 0.0
            else:
                found[i, 0], found[i, 1] = contact_gap(work, i)


@inlined
def limit_gap(work, k, q, v):
    """Return gap [m] and gap rate [m/s] of joint limit k at a state, scaled by κ of (10.6)."""
    scale = limit_scale(work, k)
    return scale * (q[work.limit_q[k]] - work.limit_bound[k]), scale * v[work.limit_v[k]]


@inlined
def limit_scale(work, k):
    """Return the derivative of the gap of joint limit k with respect to its coordinate [m/rad, or 1]."""
    return work.limit_sign[k] * work.joint_metres[work.limit_v[k]]


@declared(SceneWorkspace, FLOATS, FLOATS, FLOAT_ROWS)
@external
def all_gaps(work, q, v, found):
    """Fill found (n + nl, 2) with gap and gap rate of contacts, then of joint limits, at a state.

    Gaps of distant contacts are infinite, see `contact_gaps`.
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
    """Fill `velocity_signs` of contact i."""
    signs = filled(work.velocity_signs, 0.0)
    for end in range(2):
        c = work.joint_velocity[work.contact_joints[i, end]]
        while c >= 0:
            signs[c] += 1.0 - 2.0 * end
            c = work.velocity_parent[c]


@inlined
def moving_columns(work, i, columns, signs):
    """Fill, in ascending order, the velocities that move only the tip or only the surface of contact i.

    Signs are those of `velocity_signs`. Returns the number of these velocities.
    """
    a = work.joint_velocity[work.contact_joints[i, 0]]
    b = work.joint_velocity[work.contact_joints[i, 1]]
    count = 0
    while a != b:  # common ancestors move both
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
    """Fill the motion of contact i, see `contact_motion.contact_motion`; return the gap [m]."""
    set_signs(work, i)
    turning = surface  # unused here: `surface` is filled afterwards
    return motion_by_columns(
        work, i, work.joint_jacobian, work.velocity_signs, jacobian, velocity, acceleration, turning, surface
    )


@inlined
def motion_by_columns(work, i, columns, signs, jacobian, velocity, acceleration, turning, surface):
    """Fill the motion of contact i from columns of the joint Jacobian and their signs; return the gap [m]."""
    places, velocities, accelerations = work.placements, work.spatial_velocities, work.spatial_accelerations
    tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
    return contact_motion.contact_motion(
        *(places[tip], velocities[tip], accelerations[tip], places[base], velocities[base]),
        *(accelerations[base], work.contact_constants[i], columns, signs),
        *(jacobian, velocity, acceleration, turning, surface),
    )


@inlined
def follow_surface(work, i):
    """Rotate the axes of contact i with its surface normal, see `contact_kinematics.follow`."""
    tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
    contact_kinematics.follow(work.placements[tip], work.placements[base], work.contact_constants[i])


@inlined
def motion_of_contacts(work, index, jacobian, velocity, acceleration, surface, gap):
    """Fill the motion of contacts `index` (k,) at the state last evaluated without contact forces."""
    for k in range(len(index)):
        gap[k] = motion_of_contact(work, index[k], jacobian[k], velocity[k], acceleration[k], surface[k])


# ---- accelerations


@declared(SceneWorkspace, float, FLOATS)
@external
def evaluate_without_contacts(work, t, powers):
    """Compute v̇ without contact forces and the kinematics; fill powers (2,) of control and joints [W]."""
    if work.calls[CONTROL] != 0:
        work.control_time = t
        if not call_python(work, CONTROL):
            return
    drive(work)
    work.evaluations += 1
    work.evaluated = False
    contact_forces.joint_forces(work, powers)
    call_python(work, ABA)


@inlined
def invert_mass_matrix(work):
    """Fill `minverse` at the state last evaluated; return whether this succeeded."""
    work.evaluated = False
    return call_python(work, INVERT)


@declared(SceneWorkspace, float, FLOATS)
@external
def evaluate(work, t, out):
    """Fill out (nv + 4,) with v̇ (9.2) and the powers of control, joints, sliding friction and surfaces [W].

    The forces (9.3), their margin, and whether they are unique are stored in the workspace.
    """
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
    add_forces(work, out)


@declared(SceneWorkspace, float, FLOATS)
@external
def evaluate_anew(work, t, out):
    """Evaluate like `evaluate`, and decide the rank of (9.3) for the motion from here."""
    work.rank_tolerance = UNDECIDED
    evaluate(work, t, out)
    if work.rank_tolerance == UNDECIDED:
        work.rank_tolerance = SINGULAR_STILL


@declared(SceneWorkspace)
@external
def solve_equations(work):
    """Solve (9.3); return the sign of its determinant, 0 if singular, and whether forces are shared then."""
    system, target, orientation = work.system, work.target, 0
    if contact_forces.slips_with_friction(work):
        rank = RANK if work.forces_unique else SINGULAR_STILL
        orientation = solve(system, target, work.solution, rank)
    elif work.forces_unique:
        orientation = 1 if solve_definite(system, target, work.solution) else 0
    work.forces_unique = orientation != 0
    return orientation, orientation == 0 and not contact_forces.limit_of_compliances(work)


@inlined
def cancel(work):
    """Return whether the effect of a force is so large that rounding errors of the sum matter."""
    largest, size = 0.0, work.gravity
    for a in range(len(work.target)):
        largest = max(largest, abs(work.system[a, a] * work.solution[a]))
        size = max(size, abs(work.target[a]))
    return LITTLE * largest > size


@declared(SceneWorkspace, FLOATS, FLOATS)
@external
def refine(work, required, acceleration):
    """Correct v̇ (nv,) and the forces by the solution of (9.3) for what rows times v̇ miss.

    Large forces on a light body, as between two heavy ones, nearly cancel: v̇ has their rounding errors.
    `required` (m,) is −Ġv, the accelerations that the rows require.
    """
    target, solution, unique = work.target, work.solution, work.forces_unique
    before, forces = target.copy(), solution.copy()
    for a in range(len(target)):
        target[a] = required[a] - dot(work.equation_rows[a], acceleration)
    solve_equations(work)
    contact_forces.accelerate(work, acceleration)
    for a in range(len(target)):
        solution[a] += forces[a]
        target[a] = before[a]
    work.forces_unique = unique


@declared(SceneWorkspace, FLOATS)
@external
def add_forces(work, out):
    """Add the effect of the forces (9.3) to v̇ in `out`, see `evaluate`.

    M⁻¹ and the motion of the active contacts without contact forces are those in the workspace.
    """
    n = len(work.acceleration)
    effective = contact_forces.set_up_equations(work, out[:n])
    system, target = work.system, work.target
    total = 0.0
    for a in range(len(target)):
        total += target[a]
        for b in range(len(target)):
            total += system[a, b]
    if not math.isfinite(total):  # a stage of too long a step, which will be rejected
        filled(out, math.nan)
        return
    orientation, shared = solve_equations(work)
    if orientation == 0:
        work.forces_unique = not (shared or contact_forces.slips_with_friction(work))
    required = np.empty(len(target) if cancel(work) else 0)
    for a in range(len(required)):
        required[a] = target[a] + dot(work.equation_rows[a], work.acceleration)
    margin = contact_forces.set_forces(work, out[n + 2 :])
    if margin < 0.0 and shared and compliant_forces(work):
        margin = contact_forces.set_forces(work, out[n + 2 :])
    contact_forces.accelerate(work, out[:n])
    if len(required) > 0:
        refine(work, required, out[:n])
        margin = contact_forces.set_forces(work, out[n + 2 :])
    # without friction the determinant is positive: a negative one shows that slip has passed a singularity
    jams = effective <= NEGLIGIBLE and contact_forces.accelerates_inward(work)
    work.force_margin = -math.inf if orientation < 0 or jams else margin
