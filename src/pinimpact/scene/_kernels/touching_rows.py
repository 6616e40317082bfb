"""What touches at an instant: its rows, the forces on it, and the accelerations that they cause.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOAT_ROWS, Flags, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined
from ..._numeric.coulomb_problem import USABLE, scale
from ..._numeric.loops import assign, nonzero
from ..._numeric.semidefinite import factor
from ..._numeric.tolerances import RANK, ROUNDOFF
from .acting_forces import find_forces
from .active_set import scalar_row, scalar_rows
from .approach import PRESSED, SLIDES
from .contact_forces import FREE, SLIP
from .dynamics import follow_surface, motion_of_contact
from .tolerances import LEAST_SIZE, NEGLIGIBLE, ROUNDED


class Touching(NamedTuple):
    """What touches: nc contacts with three rows (t₁, t₂, n) each, then ns scalar rows; m = 3 nc + ns.

    Attributes:
        contacts: (nc,) numbers of the contacts.
        joints: (ns,) numbers of the scalar rows, see `scalar_rows`.
        scalars: (ns,) their places in v.
        rows: (m, nv) the rows of velocities.
        velocity: (nc, 3) contact velocities [m/s].
        free: (m,) accelerations without forces of contacts.
        slip: (nc, 2) velocities of sliding contacts [m/s], zero where a contact may stick.
        mu: (nc,) friction coefficients.
        held: (nc,) True for bilateral contacts.
        lower: (ns,) lower bounds of scalar forces [N].
        upper: (ns,) upper bounds [N].
    """

    contacts: Integers
    joints: Integers
    scalars: Integers
    rows: FloatRows
    velocity: FloatRows
    free: Floats
    slip: FloatRows
    mu: Floats
    held: Flags
    lower: Floats
    upper: Floats


@inlined
def rows_of_touching(work, v, candidates, certain):
    """Return what is `Touching` at the state last evaluated; arguments as of `find_modes`."""
    contacts, scalar = nonzero(candidates[: work.contacts]), candidates[work.contacts :]
    joints = scalar_rows(work, scalar)
    nc, ns, n = len(contacts), len(joints), len(v)
    rows, velocity, free = np.zeros((3 * nc + ns, n)), np.empty((nc, 3)), np.empty(3 * nc + ns)
    surface, mu, held = np.empty(3), np.empty(nc), np.empty(nc, dtype=np.bool_)
    slip = np.zeros((nc, 2))
    for i in range(work.contacts):
        work.slips[i] = 1  # also those that are released
    for k in range(nc):
        b, i = 3 * k, contacts[k]
        follow_surface(work, i)
        motion_of_contact(work, i, rows[b : b + 3], velocity[k], free[b : b + 3], surface)
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
    return Touching(contacts, joints, scalars, rows, velocity, free, slip, mu, held, lower, upper)


@inlined
def keeps_sliding(work, i, x, y, certain):
    """Whether a contact of tangential velocity (x, y) slides, or keeps sliding, faster than `certain`."""
    speed = math.hypot(x, y)
    if speed > work.stick_speed:
        return True
    index, mode = work.active_index, work.active_mode
    for k in range(len(index)):
        if index[k] == i and mode[k] == SLIP:
            return speed > certain  # also where it has turned away from the direction last known
    return False


@inlined
def forces_on(work, what, delassus, candidates, unique, force):
    """Fill the forces (m,) on what touches, see `find_forces`; return whether they were found."""
    nc, ns = len(what.contacts), len(what.joints)
    known, pressed, least = np.empty(len(force)), np.empty(nc + ns, dtype=np.bool_), np.zeros(nc)
    forces_of_before(work, what.contacts, what.joints, known)
    for k in range(nc):
        pressed[k] = candidates[what.contacts[k]] == PRESSED
    for m in range(ns):
        pressed[nc + m] = candidates[work.contacts + what.joints[m]] == PRESSED
    return find_forces(
        *(delassus, what.free, what.slip, what.mu, least, what.held, what.lower, what.upper),
        *(force, pressed, known, unique),
    )


@inlined
def forces_of_before(work, contacts, joints, x):
    """Fill forces x on contacts and scalar rows with those that modes were last found by."""
    closed = 3 * len(contacts)
    for a in range(closed):
        x[a] = work.found_forces[contacts[a // 3], a % 3]
    for m in range(len(joints)):
        x[closed + m] = work.found_forces[work.contacts + joints[m], 0]


@inlined
def keep_forces(work, what, force):
    """Keep the forces (m,) by which modes are found, for the next search."""
    nc, found = len(what.contacts), work.found_forces
    for k in range(nc):
        assign(found[what.contacts[k]], force[3 * k : 3 * k + 3])
    for m in range(len(what.joints)):
        found[work.contacts + what.joints[m], 0] = force[3 * nc + m]


@declared(FLOAT_ROWS)
@external
def determines_forces(delassus):
    """Return whether no forces but one set have the same effects."""
    size = len(delassus)
    rank = factor(delassus.copy(), np.empty(size, dtype=np.int64), np.zeros((size, size)), RANK)
    stiffest = 0.0
    for a in range(size):
        stiffest = max(stiffest, delassus[a, a])
    for a in range(size):
        rank += delassus[a, a] <= ROUNDOFF * stiffest  # nothing moves this way
    return rank == size


@inlined
def resulting_accelerations(delassus, free, force, contacts, unique, pace):
    """Add to the accelerations `free` (m,) of the rows what the forces (m,) cause.

    `unique` is whether no other forces have the same effects. Pace (m,) takes the accelerations that count as
    none. (11.10)
    """
    size, closed = len(free), 3 * contacts
    width, scale_a, scale_f = np.empty(size), np.empty(size), np.empty(size)
    unit = scale(delassus, free, contacts, width, scale_a, scale_f)
    for a in range(size):
        pace[a] = abs(free[a])
        for b in range(size):
            part = delassus[a, b] * force[b]
            free[a] += part
            pace[a] += abs(part)
    for a in range(size):
        if a < closed and a % 3 == 0:  # the axes of a contact are arbitrary
            pace[a] = pace[a + 1] = pace[a + 2] = max(pace[a], pace[a + 1], pace[a + 2])
        pace[a] = (ROUNDED if unique else NEGLIGIBLE) * (pace[a] + LEAST_SIZE)
        if unit > 0.0:  # forces are no more accurate
            pace[a] += USABLE / scale_a[a]


@inlined
def speeds_of_rows(work, what, v, start):
    """Fill the velocities (m,) of the rows [m/s]; return the largest speed of what was active before."""
    contacts, closed, off = what.contacts, 3 * len(what.contacts), 0.0
    for a in range(len(start)):
        if a < closed:
            mode, start[a] = work.modes[contacts[a // 3]], what.velocity[a // 3, a % 3]
            was_active = mode != FREE and (a % 3 == 2 or mode != SLIP)
        else:
            j = what.scalars[a - closed]
            start[a] = work.joint_metres[j] * v[j]
            was_active = work.modes[work.contacts + what.joints[a - closed]] != 0
        if was_active:
            off = max(off, abs(start[a]))
    return off
