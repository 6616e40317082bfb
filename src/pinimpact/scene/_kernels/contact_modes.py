"""Which contacts stay active at an instant, in which modes, and which joints their dry friction holds.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.coulomb_problem import USABLE, scale
from ..._numeric.elimination import largest_of
from ..._numeric.loops import assign, flags, nonzero
from ..._numeric.semidefinite import factor
from .acting_forces import driven_in, find_forces
from .active_set import close, scalar_row, scalar_rows, stop_along
from .approach import PRESSED, SLIDES, TOUCHES
from .coming_to_rest import come_to_rest
from .contact_forces import FREE, HELD, LEAST_SIZE, RIGID, SLIP, STICK, delassus_of_rows
from .dynamics import (
    evaluate_without_contacts,
    follow_surface,
    invert_mass_matrix,
    motion_of_contact,
    set_state,
)
from .slip import CERTAIN, behind
from .workspace import SceneWorkspace

ROUNDS = 4
"""How often modes are determined again: contacts that close change the velocity, and with it the direction of
slip and the forces that depend on it."""

INSIDE = 1.0 - 1e-9
"""Part of the largest friction below which it holds, whatever rounding leaves of the acceleration."""

ROUNDED, ROUNDED_SHARED = 1e-11, 1e-9
"""Part of what makes up an acceleration below which it is none, where forces are unique and else. (11.10)"""

SEPARATES, RUBS, KEEPS_SLIDING = 1, 2, 3
"""State of a rejected candidate, see `find_modes`."""

NOTHING = 1e-3
"""Part of the speed of sticking that changes nothing."""


@declared(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS)
@jit
def set_modes(work, t, q, v, slow):
    """Set the modes of what touches without bouncing (`slow`, see `approach`); results as of `find_modes`."""
    dry, sliding = work.dry_friction, work.sliding_friction
    n, touching = len(v), len(slow)
    candidates, modes = np.zeros(touching + n, dtype=np.int64), np.zeros(touching + n, dtype=np.int64)
    for i in range(touching):
        candidates[i] = slow[i]
    reference, breaking = np.zeros((work.contacts, 2)), np.zeros(n)
    rejected, before, slid = np.zeros(touching + n, dtype=np.int64), v.copy(), sliding.copy()
    dragged = np.zeros(n, dtype=np.int64)
    certain, error = work.certain_speed, error_of_step(work, v)
    jamming, converged, energy, stopped, tried = -1, True, 0.0, math.inf, 0
    while tried < ROUNDS and stopped > NOTHING * work.stick_speed:
        for j in range(n):  # stopping one may have set other joints in motion
            if dry[j] > 0.0:
                slow_enough = abs(v[j]) <= work.stick_speed
                moves = sliding[j] * v[j] > dry[j] * certain
                rests = slow_enough and not moves and dragged[j] == 0
                held = work.modes[work.contacts + work.limits + j] != 0
                candidates[touching + j] = (PRESSED if held else TOUCHES) if rests else 0
                # in the first round nothing has been stopped yet
                way = float(dragged[j]) if tried == 0 and dragged[j] != 0 else v[j]
                sliding[j] = 0.0 if rests else math.copysign(dry[j], way)
        if len(nonzero(candidates)) == 0:
            break
        jamming, converged, gained, stopped, off = find_modes(
            work, t, q, v, candidates, certain, modes, reference, breaking, rejected
        )
        energy, tried, error = energy + gained, tried + 1, max(error, off)
        released, last = False, tried == ROUNDS or stopped <= NOTHING * work.stick_speed
        if jamming >= 0 or work.callback_failed:
            assign(sliding, slid)
            return jamming, converged, energy
        drags, without_forces = False, certain > 0.0 and not converged
        for i in range(len(rejected)):
            if i >= touching or rejected[i] == KEEPS_SLIDING:
                drags |= rejected[i] != 0
            elif rejected[i] != 0 and modes[i] == FREE:
                candidates[i], released = 0 if rejected[i] == SEPARATES else SLIDES, True
            elif rejected[i] == SEPARATES and without_forces:
                candidates[i], released = 0, True
        much = drags or (last and largest_of(v - before, 0) > CERTAIN * error)
        if not released and much and certain > error:
            # sticking that changes other velocities by more than the error of a step is rejected (11.8)
            certain, released = error, True
            for j in range(n):
                dragged[j] = 0  # by contacts that may not stick
        elif not released and drags:
            released = True
            for i in range(touching):
                if rejected[i] == KEEPS_SLIDING:
                    candidates[i] = SLIDES
            for j in range(n):
                if rejected[touching + j] != 0:
                    dragged[j] = rejected[touching + j]
        if released:
            for i in range(len(rejected)):
                rejected[i] = 0
            assign(v, before)
            assign(sliding, slid)
            energy, stopped, tried = 0.0, math.inf, 0
    for j in range(n):
        if breaking[j] != 0.0:
            if idles(work, v[j], certain) and slid[j] != 0.0:
                sliding[j] = slid[j]
            else:
                sliding[j] = -math.copysign(dry[j], breaking[j] if v[j] == 0.0 else -v[j])
    assign(work.modes, modes)
    close(work, reference)
    return jamming, converged, energy


@declared(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS, float, INTEGERS, FLOAT_ROWS, FLOATS, INTEGERS)
@external
def find_modes(work, t, q, v, candidates, certain, modes, reference, breaking, rejected):
    """Find which of the candidates stay active: contacts, limits, and joints held by dry friction.

    Args:
        work: The workspace, with the modes that hold until now.
        t: Time [s].
        q: (nq,) configuration.
        v: (nv,) the velocity; what active contacts and joints stop of it is removed.
        candidates: Not zero for what touches, in the order of the modes; as `approach` says, and
            `PRESSED` for joints that their dry friction has held.
        certain: The speed above which a sliding contact keeps sliding.
        modes: Takes the modes.
        reference: (n, 2) takes the directions of slip where they are known.
        breaking: (nv,) takes the force on each joint that its dry friction holds no longer.
        rejected: (n + nl + nv,) takes the state of rejected candidates: `SEPARATES` for an open contact or
            limit that separates, `RUBS` for an open contact that loses a velocity along its surface, both
            if it stays open; `KEEPS_SLIDING` for a contact whose sticking would accelerate a joint against
            its force. For a joint that sticking contacts drag against its friction, or that would so
            accelerate another one, the sign of its velocity. (11.9)

    Returns:
        The contact with negative normal acceleration for which no force exists, or −1; whether the forces
        were found to the usual accuracy; the kinetic energy gained; the largest speed that was removed; the
        largest speed of what was active before.
    """
    for i in range(len(modes)):
        modes[i] = FREE
    for i in range(len(reference)):
        reference[i, 0] = reference[i, 1] = 0.0
    for j in range(len(v)):
        breaking[j], rejected[work.contacts + work.limits + j] = 0.0, 0
    for i in range(work.contacts):
        rejected[i] = 0 if rejected[i] == KEEPS_SLIDING else rejected[i]
    contacts = nonzero(candidates[: work.contacts])
    scalar = candidates[work.contacts :]
    joints = scalar_rows(work, scalar)
    nc, ns, n = len(contacts), len(joints), len(v)
    size = 3 * nc + ns
    set_state(work, q, v)
    evaluate_without_contacts(work, t, np.empty(2))
    if work.callback_failed or not invert_mass_matrix(work):
        return -1, True, 0.0, 0.0, 0.0
    rows, response, delassus = np.zeros((size, n)), np.empty((size, n)), np.empty((size, size))
    velocity, free = np.empty((nc, 3)), np.empty(size)
    surface, mu, held = np.empty(3), np.empty(nc), np.empty(nc, dtype=np.bool_)
    slip = np.zeros((nc, 2))  # left zero where a contact may stick
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
        rows[3 * nc + m, scalars[m]] = 1.0
        free[3 * nc + m] = work.acceleration[scalars[m]]
    delassus_of_rows(rows, work.minverse, response, delassus)
    force, strength, found, least = np.zeros((nc, 3)), np.zeros(ns), work.found_forces, np.zeros(nc)
    both, known, unique = np.empty(size), np.empty(size), determines_forces(delassus)
    forces_of_before(work, contacts, joints, known)
    pressed = np.empty(nc + ns, dtype=np.bool_)
    for k in range(nc):
        pressed[k] = candidates[contacts[k]] == PRESSED
    for m in range(ns):
        pressed[nc + m] = scalar[joints[m]] == PRESSED
    converged = find_forces(delassus, free, slip, mu, least, held, lower, upper, both, pressed, known, unique)
    for a in range(size):  # if not found, then the nearest to it
        if a < 3 * nc:
            force[a // 3, a % 3] = both[a]
        else:
            strength[a - 3 * nc] = both[a]
    jamming = -1 if converged else driven_in(delassus, free, slip, mu, held, both)
    if jamming >= 0:
        b = 3 * jamming + 2
        gained = stop_along(rows[b : b + 1], velocity[jamming, 2:], work.minverse, v)
        return contacts[jamming], True, gained, 0.0, 0.0
    for k in range(nc):
        assign(found[contacts[k]], force[k])
    for m in range(ns):
        found[work.contacts + joints[m], 0] = strength[m]
    stopped, against = flags(size, False), np.zeros(size)  # rows at rest, and those that leave it, see below
    pace = np.empty(size)
    resulting_accelerations(delassus, free, force, strength, unique, pace)
    modes_of_contacts(
        work, contacts, velocity, slip, mu, held, force, unique, free, pace, stopped, modes, reference
    )
    for k in range(nc):
        i = contacts[k]
        if work.modes[i] == FREE and stopped[3 * k + 2]:
            if velocity[k, 2] > certain:
                rejected[i] = SEPARATES
            elif stopped[3 * k] and math.hypot(velocity[k, 0], velocity[k, 1]) > certain:
                rejected[i] = RUBS
    for m in range(ns):
        a, i = 3 * nc + m, scalars[m]
        rubs = scalar[work.limits + i] != 0
        # a force at its bound holds what it does not let move; else the row starts or keeps moving
        closed = not (
            (free[a] > pace[a] and strength[m] <= INSIDE * lower[m] + work.force_tolerance)
            or (free[a] < -pace[a] and strength[m] >= INSIDE * upper[m] - work.force_tolerance)
        )
        stopped[a] = closed
        if rubs and not closed:
            breaking[i] = strength[m]
            against[a] = 0.0 if idles(work, v[i], certain) else math.copysign(1.0, strength[m])
        limit = joints[m]
        modes[work.contacts + limit] = 1 if closed else 0
        parts = limit < work.limits and work.limit_sign[limit] * v[i] > certain
        if closed and parts and work.modes[work.contacts + limit] == FREE:
            rejected[work.contacts + limit] = SEPARATES
        if rubs:
            modes[work.contacts + work.limits + i] = 1 if closed else 0
    start, off = np.empty(size), 0.0
    for a in range(size):
        if a < 3 * nc:
            mode, start[a] = work.modes[contacts[a // 3]], velocity[a // 3, a % 3]
            was_active = mode != FREE and (a % 3 == 2 or mode != SLIP)
        else:
            start[a] = v[scalars[a - 3 * nc]]
            was_active = work.modes[work.contacts + joints[a - 3 * nc]] != 0
        if was_active:
            off = max(off, abs(start[a]))
    on, moves = np.zeros(size, dtype=np.int64), flags(size, False)
    for k in range(nc):
        b, i = 3 * k, contacts[k]
        if stopped[b] and not held[k]:
            moves[b] = moves[b + 1] = keeps_sliding(work, i, velocity[k, 0], velocity[k, 1], 0.0)
        if modes[i] == SLIP and mu[k] > 0.0 and slip[k, 0] == 0.0 and slip[k, 1] == 0.0:
            turn_rows(reference[i], rows[b : b + 2], start[b : b + 2])
            stopped[b], against[b] = False, -1.0
    for m in range(ns):
        moves[3 * nc + m] = joints[m] >= work.limits and scalar[joints[m]] == TOUCHES
    limits = CERTAIN * error_of_step(work, v), behind(work), work.stick_speed
    gained, fastest = come_to_rest(
        work.minverse, rows, start, stopped, against, moves, 3 * nc, *limits, on, v
    )
    for k in range(nc):
        if on[3 * k] != 0 or on[3 * k + 1] != 0:
            rejected[contacts[k]] = KEEPS_SLIDING
    for m in range(ns):
        rejected[work.contacts + work.limits + scalars[m]] = on[3 * nc + m]
        if stopped[3 * nc + m] and against[3 * nc + m] != 0.0:
            v[scalars[m]] = 0.0  # not even a rounding error begins against the force
    return -1, converged, gained, fastest, off


@inlined
def error_of_step(work, v):
    """Return the error of a step, in a velocity (nv,)."""
    return work.atol + work.rtol * largest_of(v, 0)


@inlined
def forces_of_before(work, contacts, joints, x):
    """Fill forces x on contacts and scalar rows with those that modes were last found by."""
    closed = 3 * len(contacts)
    for a in range(closed):
        x[a] = work.found_forces[contacts[a // 3], a % 3]
    for m in range(len(joints)):
        x[closed + m] = work.found_forces[work.contacts + joints[m], 0]


@inlined
def turn_rows(direction, rows, velocity):
    """Turn two rows (2, nv) of a contact and their velocities: along a direction (2,), and across it."""
    x, y = direction
    for j in range(rows.shape[1]):
        first, second = rows[0, j], rows[1, j]
        rows[0, j], rows[1, j] = x * first + y * second, x * second - y * first
    first, second = velocity
    velocity[0], velocity[1] = x * first + y * second, x * second - y * first


@inlined
def idles(work, speed, certain):
    """Whether a joint that yields is too fast for rest, now that less is taken for it. (11.8)"""
    return certain < abs(speed) <= work.certain_speed


@declared(FLOAT_ROWS)
@external
def determines_forces(delassus):
    """Return whether no forces but one set have the same effects."""
    size = len(delassus)
    rank = factor(delassus.copy(), np.empty(size, dtype=np.int64), np.zeros((size, size)))
    stiffest = 0.0
    for a in range(size):
        stiffest = max(stiffest, delassus[a, a])
    for a in range(size):
        rank += delassus[a, a] <= RIGID * stiffest  # nothing moves this way
    return rank == size


@inlined
def resulting_accelerations(delassus, free, force, scalar_force, unique, pace):
    """Add to the accelerations of the rows what the forces cause.

    Args:
        delassus: (m, m) of the rows.
        free: (m,) accelerations without forces, updated.
        force: (nc, 3) forces of the contacts.
        scalar_force: (ns,) those of the scalar rows.
        unique: Whether no other forces have the same effects.
        pace: (m,) takes the accelerations that count as none. (11.10)
    """
    size, closed = len(free), 3 * len(force)
    width, scale_a, scale_f = np.empty(size), np.empty(size), np.empty(size)
    unit = scale(delassus, free, len(force), width, scale_a, scale_f)
    for a in range(size):
        pace[a] = abs(free[a])
        for b in range(size):
            part = delassus[a, b] * (force[b // 3, b % 3] if b < closed else scalar_force[b - closed])
            free[a] += part
            pace[a] += abs(part)
    for a in range(size):
        if a < closed and a % 3 == 0:  # the axes of a contact are arbitrary
            pace[a] = pace[a + 1] = pace[a + 2] = max(pace[a], pace[a + 1], pace[a + 2])
        pace[a] = (ROUNDED if unique else ROUNDED_SHARED) * (pace[a] + LEAST_SIZE)
        if unit > 0.0:  # forces are no more accurate
            pace[a] += USABLE / scale_a[a]


@inlined
def modes_of_contacts(
    work, contacts, velocity, slip, mu, held, force, unique, acceleration, pace, stopped, modes, reference
):
    """Fill modes, directions of slip, and which velocities vanish, from the forces on the contacts.

    Args:
        work: The workspace.
        contacts: (nc,) their numbers.
        velocity: (nc, 3) contact velocities.
        slip: (nc, 2) velocities of slip, zero for a contact that may stick.
        mu: (nc,) friction coefficients.
        held: (nc,) True for bilateral contacts.
        force: (nc, 3) forces.
        unique: Whether no other forces have the same effects.
        acceleration: (m,) of the rows, with the forces.
        pace: (m,) accelerations that count as none.
        stopped: (m,) takes whether the velocity of a row becomes zero.
        modes, reference: As in `find_modes`.
    """
    before = work.modes
    for k in range(len(contacts)):
        b, i = 3 * k, contacts[k]
        normal, tangent = force[k, 2], math.hypot(force[k, 0], force[k, 1])
        speed = math.hypot(slip[k, 0], slip[k, 1])
        if held[k]:
            modes[i] = HELD
            for a in range(b, b + 3):
                stopped[a] = True
            continue
        if normal <= work.force_tolerance and acceleration[b + 2] > pace[b]:
            stopped[b + 2] = velocity[k, 2] < 0.0
            continue
        stopped[b + 2] = True
        # a sliding contact that has stopped keeps sliding where its force stays on the cone, if no other one
        # would do; a contact at rest that is not accelerated sticks; whether it leaves the cone is decided
        # just after, see `events.force_bound`
        pushes = normal > work.force_tolerance  # a contact without load may be moved by others
        begins = math.hypot(acceleration[b], acceleration[b + 1])
        inside = pushes and tangent <= INSIDE * mu[k] * normal
        inside |= (not unique or before[i] != SLIP) and begins <= pace[b]
        if mu[k] > 0.0 and speed == 0.0 and inside:
            modes[i] = STICK
            stopped[b] = stopped[b + 1] = True
            continue
        modes[i] = SLIP
        if mu[k] > 0.0 and speed == 0.0:  # slip begins from rest
            stopped[b] = stopped[b + 1] = True
        reference[i, 0] = 1.0
        if speed > 0.0:
            reference[i, 0], reference[i, 1] = slip[k, 0] / speed, slip[k, 1] / speed
        elif pushes and tangent > 0.0:
            reference[i, 0], reference[i, 1] = -force[k, 0] / tangent, -force[k, 1] / tangent
        elif begins > 0.0:
            reference[i, 0], reference[i, 1] = acceleration[b] / begins, acceleration[b + 1] / begins


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
