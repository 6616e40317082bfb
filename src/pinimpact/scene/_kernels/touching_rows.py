"""The contact problem at an instant: rows, forces, resulting accelerations. (theory.md, 11.1)

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined
from ..._numeric.augmented_newton import Law, coulomb_law
from ..._numeric.coulomb_problem import USABLE, scale
from ..._numeric.loops import filled, largest_diagonal, nonzero
from ..._numeric.products import add, dot
from ..._numeric.semidefinite import factor
from ..._numeric.tolerances import LITTLE, NOISE, RANK, ROUNDING, ROUNDOFF
from .acting_forces import find_forces
from .active_set import scalar_row, scalar_rows
from .approach import PRESSED, SLIDES
from .contact_forces import FREE, SLIP, mass_at_contact, negligible_force
from .dynamics import ABA, call_python, follow_surface, motion_of_contact, set_state
from .slip import fastest_of
from .tolerances import LEAST_SIZE, NEARLY_SINGULAR, NEGLIGIBLE, ROUNDED
from .workspace import SceneWorkspace


class Touching(NamedTuple):
    """The touching contacts, nc, and ns scalar rows; m = 3 nc + ns rows.

    Attributes:
        contacts: (nc,) numbers of the contacts.
        joints: (ns,) numbers of the scalar rows, see `scalar_rows`.
        scalars: (ns,) indices in v of the scalar rows.
        rows: (m, nv) Jacobian of the row velocities.
        velocity: (nc, 3) contact velocities [m/s].
        free: (m,) accelerations of the rows without contact forces [m/s²].
        law: Friction coefficients, tangential velocities of sliding contacts [m/s], bilateral contacts, and
            bounds of scalar forces [N].
    """

    contacts: Integers
    joints: Integers
    scalars: Integers
    rows: FloatRows
    velocity: FloatRows
    free: Floats
    law: Law


@inlined
def rows_of_touching(work, v, candidates, certain):
    """Return the `Touching` at the state last evaluated; arguments as in `find_modes`."""
    contacts, scalar = nonzero(candidates[: work.contacts]), candidates[work.contacts :]
    joints = scalar_rows(work, scalar)
    nc, ns, n = len(contacts), len(joints), len(v)
    rows, velocity, free = np.zeros((3 * nc + ns, n)), np.empty((nc, 3)), np.empty(3 * nc + ns)
    surface, mu, held = np.empty(3), np.empty(nc), np.empty(nc, dtype=np.bool_)
    slip = np.zeros((nc, 2))
    for i in range(work.contacts):
        work.slips[i] = 1  # also of contacts that are not candidates
    for k in range(nc):
        b, i = 3 * k, contacts[k]
        follow_surface(work, i)
        motion_of_contact(work, i, rows[b : b + 3], velocity[k], free[b : b + 3], surface)
        drop_rounding(work, free[b : b + 3])
        mu[k], held[k] = work.friction[i], work.bilateral[i] != 0
        if keeps_sliding(work, i, velocity[k, 0], velocity[k, 1], certain) or candidates[i] == SLIDES:
            slip[k, 0], slip[k, 1] = velocity[k, 0], velocity[k, 1]
        work.slips[i] = 0 if slip[k, 0] == 0.0 and slip[k, 1] == 0.0 else 1
    scalars, lower, upper = np.empty(ns, dtype=np.int64), np.empty(ns), np.empty(ns)
    for m in range(ns):
        scalars[m], lower[m], upper[m] = scalar_row(work, joints[m], scalar)
        metres = work.joint_metres[scalars[m]]
        rows[3 * nc + m, scalars[m]] = metres
        free[3 * nc + m] = metres * work.acceleration[scalars[m]]
        drop_rounding(work, free[3 * nc + m : 3 * nc + m + 1])
    return Touching(
        contacts, joints, scalars, rows, velocity, free, coulomb_law(mu, slip, held, lower, upper)
    )


@inlined
def drop_rounding(work, free):
    """Set entries of accelerations `free` that are rounding errors of the others, or of gravity, to zero.

    Where nothing else acts on the rows, no forces would satisfy the laws to rounding of such errors: rows
    that no force moves cannot be corrected, and rows of one joint contradict each other.
    """
    size = work.gravity + LEAST_SIZE
    for a in range(len(free)):
        size += abs(free[a])
    for a in range(len(free)):
        if abs(free[a]) <= NOISE * size:
            free[a] = 0.0


@inlined
def keeps_sliding(work, i, x, y, certain):
    """Return whether contact i slides at the tangential velocity (x, y) [m/s].

    It does above the sticking speed, or above `certain` [m/s] if it has been sliding.
    """
    speed = math.hypot(x, y)
    if speed > work.stick_speed:
        return True
    index, mode = work.active_index, work.active_mode
    for k in range(len(index)):
        if index[k] == i and mode[k] == SLIP:
            return speed > certain  # also if it has turned away from its reference direction
    return False


@inlined
def forces_on(work, what, problem, candidates, unique, force):
    """Fill the forces (m,) on the touching contacts, see `find_forces`; return whether they were found."""
    nc, ns = len(what.contacts), len(what.joints)
    pressed = np.empty(nc + ns, dtype=np.bool_)
    for k in range(nc):
        pressed[k] = candidates[what.contacts[k]] == PRESSED
    for m in range(ns):
        pressed[nc + m] = candidates[work.contacts + what.joints[m]] == PRESSED
    return find_forces(problem, force, pressed, unique)


@declared(FLOAT_ROWS, Law)
@external
def determines_forces(delassus, law):
    """Return whether the Delassus matrix (m, m) is regular, apart from rows without a force or an effect.

    No force acts along the tangential rows of contacts without friction, and none moves a robot that cannot
    move along a row.
    """
    acting, stiffest = np.ones(len(delassus), dtype=np.bool_), largest_diagonal(delassus)
    for a in range(len(delassus)):
        if a < 3 * len(law.friction) and a % 3 != 2:
            acting[a] = law.friction[a // 3] > 0.0 or law.held[a // 3]
        acting[a] &= delassus[a, a] > ROUNDOFF * stiffest
    rows = np.flatnonzero(acting)
    size = len(rows)
    part = np.empty((size, size))
    for a in range(size):
        for b in range(size):
            part[a, b] = delassus[rows[a], rows[b]]
    return factor(part, np.empty(size, dtype=np.int64), np.zeros((size, size)), RANK) == size


@inlined
def resulting_accelerations(delassus, free, force, contacts, unique, threshold):
    """Add the effect of the forces (m,) to the accelerations `free` (m,) of the rows.

    `threshold` (m,) is overwritten with the bounds (11.10) up to which accelerations are taken as zero;
    `unique` is whether the Delassus matrix is regular.
    """
    size, closed = len(free), 3 * contacts
    width, scale_a, scale_f = np.empty(size), np.empty(size), np.empty(size)
    unit = scale(delassus, free, contacts, width, scale_a, scale_f)
    for a in range(size):
        threshold[a] = abs(free[a])
        for b in range(size):
            part = delassus[a, b] * force[b]
            free[a] += part
            threshold[a] += abs(part)
    for a in range(size):
        if a < closed and a % 3 == 0:  # the axes of a contact are arbitrary
            threshold[a] = threshold[a + 1] = threshold[a + 2] = max(
                threshold[a], threshold[a + 1], threshold[a + 2]
            )
        threshold[a] = (ROUNDED if unique else NEGLIGIBLE) * (threshold[a] + LEAST_SIZE)
        if unit > 0.0:  # effect of the error of the forces
            threshold[a] += USABLE / scale_a[a]


@declared(SceneWorkspace, FLOATS, FLOATS, Touching, FLOAT_ROWS, FLOAT_ROWS, FLOATS)
@external
def curved_contacts(work, q, v, what, response, delassus, force):
    """Return the numbers of the contacts that the curvature of their gaps will separate. (11.14)

    Args:
        work: The workspace, at the state last evaluated.
        q, v: That state.
        what: The `Touching`.
        response: (m, nv) M⁻¹ rowsᵀ, row by row.
        delassus: (m, m) Delassus matrix of the rows.
        force: (m,) forces.
    """
    nc, n, metres, rows = len(what.contacts), len(v), work.joint_metres, what.rows
    curved, undecided = np.zeros(nc, dtype=np.int64), np.zeros(nc, dtype=np.int64)
    for k in range(nc):
        b = 3 * k
        immobile = delassus[b + 2, b + 2] <= NEARLY_SINGULAR**2 * max(delassus[b, b], delassus[b + 1, b + 1])
        undecided[k] = 1 if immobile and not what.law.held[k] else 0
    if len(nonzero(undecided)) == 0:
        return nonzero(undecided)
    motion = work.acceleration.copy()
    for a in range(len(force)):
        if a >= 3 * nc or undecided[a // 3] == 0:
            add(motion, force[a], response[a])
    near, size = work.touching_gap, work.gap_floor / ROUNDING
    # so fast that rounding errors of the other accelerations do not matter
    speed = math.sqrt((work.gravity + LEAST_SIZE + fastest_of(metres, motion)) * size)
    time = LITTLE * size / speed
    jacobian, acceleration, unused = np.empty((3, n)), np.empty(3), np.empty(3)
    for j in range(-1, n):
        left = nonzero(undecided)
        if len(left) == 0:
            break
        if j >= 0:
            filled(motion, 0.0)
            motion[j] = 1.0
        fastest = fastest_of(metres, motion)
        if fastest == 0.0:
            continue
        for i in range(n):
            motion[i] *= speed / fastest
        set_state(work, q, motion)
        call_python(work, ABA)
        for k in left:
            row = rows[3 * k + 2]
            gap = motion_of_contact(work, what.contacts[k], jacobian, unused, acceleration, unused)
            rise = 0.5 * time**2 * (acceleration[2] - dot(row, work.acceleration))
            change = time * dot(row, motion)
            change = change if j < 0 else -abs(change)
            if rise > 0.0 and rise + change > near and gap - min(change, 0.0) ** 2 / (4.0 * rise) > -near:
                curved[k] = 1
            if curved[k] != 0 or (j < 0 and abs(rise + change) > near):
                undecided[k] = 0
    set_state(work, q, v)
    call_python(work, ABA)
    return what.contacts[nonzero(curved)]


@inlined
def negligible_forces(work, what, response, delassus, force):
    """Return (m,) the forces of normal and scalar rows that are taken as zero [N], see `negligible_force`.

    `response` (m, nv) is M⁻¹ rowsᵀ, row by row; `force` (m,) are the forces.
    """
    closed, found = 3 * len(what.contacts), np.zeros(len(force))
    for a in range(len(force)):
        if a < closed and a % 3 != 2:
            continue
        if a < closed:
            mass = mass_at_contact(work, what.contacts[a // 3])
        else:
            mass = work.tree_mass[work.velocity_joint[what.scalars[a - closed]]]
        found[a] = negligible_force(work, mass, delassus[a, a], response[a], delassus[a], force)
    return found


@inlined
def speeds_of_rows(work, what, v, start):
    """Fill start (m,) with the velocities of the rows [m/s]; return the largest of rows active so far."""
    contacts, closed, active_speed = what.contacts, 3 * len(what.contacts), 0.0
    for a in range(len(start)):
        if a < closed:
            mode, start[a] = work.modes[contacts[a // 3]], what.velocity[a // 3, a % 3]
            was_active = mode != FREE and (a % 3 == 2 or mode != SLIP)
        else:
            j = what.scalars[a - closed]
            start[a] = work.joint_metres[j] * v[j]
            was_active = work.modes[work.contacts + what.joints[a - closed]] != 0
        if was_active:
            active_speed = max(active_speed, abs(start[a]))
    return active_speed
