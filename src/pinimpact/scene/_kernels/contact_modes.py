"""Which contacts stay active at an instant, in which modes, and which joints their dry friction holds.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOATS, INTEGERS, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign, filled, flags, nonzero
from . import touching_rows
from .acting_forces import driven_in
from .active_set import close, stop_along
from .approach import PRESSED, SLIDES, TOUCHES
from .coming_to_rest import come_to_rest
from .contact_forces import FREE, HELD, SLIP, STICK, delassus_of_rows
from .dynamics import evaluate_without_contacts, invert_mass_matrix, set_state
from .slip import CERTAIN, behind, error_of_step, fastest_of
from .tolerances import AT_BOUND, STILL
from .workspace import SceneWorkspace

ROUNDS = 4
"""How often modes are determined again: contacts that close change the velocity, and with it the direction of
slip and the forces that depend on it."""

SEPARATES, RUBS, KEEPS_SLIDING = 1, 2, 3
"""State of a rejected candidate, see `find_modes`."""


class Choice(NamedTuple):
    """The modes of what touches, and what follows from them.

    Attributes:
        modes: (n + nl + nv,) modes of contacts, limits and joints.
        reference: (n, 2) directions of slip where they are known.
        breaking: (nv,) the force on each joint that its dry friction holds no longer.
        rejected: (n + nl + nv,) the state of rejected candidates: `SEPARATES` for an open contact
            that separates, `RUBS` for an open contact that loses a velocity along its surface, both if it
            stays open; `KEEPS_SLIDING` for a contact whose sticking would accelerate a joint against its
            force. For a joint that sticking contacts drag against its friction, or that would so accelerate
            another one, the sign of its velocity. (11.9)
    """

    modes: Integers
    reference: FloatRows
    breaking: Floats
    rejected: Integers


@declared(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS)
@jit
def set_modes(work, t, q, v, slow):
    """Set the modes of what touches without bouncing (`slow`, see `approach`); results as of `find_modes`."""
    dry, sliding, metres = work.dry_friction, work.sliding_friction, work.joint_metres
    n, touching = len(v), len(slow)
    candidates, modes = np.zeros(touching + n, dtype=np.int64), np.zeros(touching + n, dtype=np.int64)
    assign(candidates[:touching], slow)
    reference, breaking = np.zeros((work.contacts, 2)), np.zeros(n)
    rejected, before, slid = np.zeros(touching + n, dtype=np.int64), v.copy(), sliding.copy()
    chosen, dragged = Choice(modes, reference, breaking, rejected), np.zeros(n, dtype=np.int64)
    certain, error = work.certain_speed, error_of_step(work, v)
    jamming, converged, energy, stopped, tried = -1, True, 0.0, math.inf, 0
    while tried < ROUNDS and stopped > STILL * work.stick_speed:
        for j in range(n):  # stopping one may have set other joints in motion
            if dry[j] > 0.0:
                slow_enough = metres[j] * abs(v[j]) <= work.stick_speed
                moves = sliding[j] * metres[j] * v[j] > dry[j] * certain
                rests = slow_enough and not moves and dragged[j] == 0
                held = work.modes[work.contacts + work.limits + j] != 0
                candidates[touching + j] = (PRESSED if held else TOUCHES) if rests else 0
                # in the first round nothing has been stopped yet
                way = float(dragged[j]) if tried == 0 and dragged[j] != 0 else v[j]
                sliding[j] = 0.0 if rests else math.copysign(dry[j], way)
        if len(nonzero(candidates)) == 0:
            break
        jamming, converged, gained, stopped, off = find_modes(work, t, q, v, candidates, certain, chosen)
        energy, tried, error = energy + gained, tried + 1, max(error, off)
        released, last = False, tried == ROUNDS or stopped <= STILL * work.stick_speed
        if jamming >= 0 or work.callback_failed:
            assign(sliding, slid)
            return jamming, converged, energy
        drags = False
        for i in range(len(rejected)):
            if i >= touching or rejected[i] == KEEPS_SLIDING:
                drags |= rejected[i] != 0
            elif rejected[i] != 0 and modes[i] == FREE:
                candidates[i], released = 0 if rejected[i] == SEPARATES else SLIDES, True
        much = drags or (last and fastest_of(metres, v - before) > CERTAIN * error)
        if not released and much and certain > error:
            # sticking that changes other velocities by more than the error of a step is rejected (11.8)
            certain, released = error, True
            filled(dragged, 0)  # by contacts that may not stick
        elif not released and drags:
            released = True
            for i in range(touching):
                if rejected[i] == KEEPS_SLIDING:
                    candidates[i] = SLIDES
            for j in range(n):
                if rejected[touching + j] != 0:
                    dragged[j] = rejected[touching + j]
        if released:
            filled(rejected, 0)
            assign(v, before)
            assign(sliding, slid)
            energy, stopped, tried = 0.0, math.inf, 0
    for j in range(n):
        if breaking[j] != 0.0:
            sliding[j] = -math.copysign(dry[j], breaking[j] if v[j] == 0.0 else -v[j])
    assign(work.modes, modes)
    close(work, reference)
    return jamming, converged, energy


@declared(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS, float, Choice)
@external
def find_modes(work, t, q, v, candidates, certain, chosen):
    """Find which of the candidates stay active: contacts, limits, and joints held by dry friction.

    Args:
        work: The workspace, with the modes that hold until now.
        t, q, v: Time [s] and state; what active contacts and joints stop of the velocity is removed.
        candidates: Not zero for what touches, in the order of the modes; as `approach` says, and
            `PRESSED` for joints that their dry friction has held.
        certain: The speed above which a sliding contact keeps sliding [m/s].
        chosen: Takes the `Choice`.

    Returns:
        The contact with negative normal acceleration for which no force exists, or −1; whether the forces
        were found to the usual accuracy; the kinetic energy gained; the largest speed that was removed; the
        largest speed of what was active before.
    """
    clear(work, chosen)
    set_state(work, q, v)
    evaluate_without_contacts(work, t, np.empty(2))
    if work.callback_failed or not invert_mass_matrix(work):
        return -1, True, 0.0, 0.0, 0.0
    what = touching_rows.rows_of_touching(work, v, candidates, certain)
    size = len(what.free)
    response, delassus, force = np.empty(what.rows.shape), np.empty((size, size)), np.empty(size)
    delassus_of_rows(what.rows, work.minverse, response, delassus)
    unique = touching_rows.determines_forces(delassus)
    converged = touching_rows.forces_on(work, what, delassus, candidates, unique, force)
    # if not found, then the nearest to it
    jamming = -1 if converged else driven_in(delassus, what.free, what.slip, what.mu, what.held, force)
    if jamming >= 0:
        b = 3 * jamming + 2
        gained = stop_along(what.rows[b : b + 1], what.velocity[jamming, 2:], work.minverse, v)
        return what.contacts[jamming], True, gained, 0.0, 0.0
    touching_rows.keep_forces(work, what, force)
    stopped, against = flags(size, False), np.zeros(size)  # rows at rest, and those that leave it, see below
    pace = np.empty(size)
    touching_rows.resulting_accelerations(delassus, what.free, force, len(what.contacts), unique, pace)
    modes_of_contacts(work, what, force, unique, pace, stopped, chosen)
    reject_contacts(work, what, stopped, certain, chosen.rejected)
    scalar = candidates[work.contacts :]
    modes_of_scalar_rows(work, what, scalar, force, pace, stopped, against, chosen)
    start = np.empty(size)
    off = touching_rows.speeds_of_rows(work, what, v, start)
    gained, fastest = stop(work, what, candidates, start, stopped, against, chosen, v)
    return -1, converged, gained, fastest, off


@inlined
def clear(work, chosen):
    """Clear a `Choice`, but for contacts and limits that separate, or rub, if they stay open."""
    modes, reference, breaking, rejected = chosen
    filled(modes, FREE)
    for i in range(len(reference)):
        reference[i, 0] = reference[i, 1] = 0.0
    for j in range(len(breaking)):
        breaking[j], rejected[work.contacts + work.limits + j] = 0.0, 0
    for i in range(work.contacts):
        rejected[i] = 0 if rejected[i] == KEEPS_SLIDING else rejected[i]


@inlined
def reject_contacts(work, what, stopped, certain, rejected):
    """Note the open contacts that separate faster than `certain`, or lose so fast a velocity by sticking."""
    velocity = what.velocity
    for k in range(len(what.contacts)):
        i = what.contacts[k]
        if work.modes[i] == FREE and stopped[3 * k + 2]:
            if velocity[k, 2] > certain:
                rejected[i] = SEPARATES
            elif stopped[3 * k] and math.hypot(velocity[k, 0], velocity[k, 1]) > certain:
                rejected[i] = RUBS


@inlined
def modes_of_scalar_rows(work, what, scalar, force, pace, stopped, against, chosen):
    """Fill the modes of limits and of joints with dry friction from the forces on their rows.

    A force at its bound holds what it does not let move; else the row starts or keeps moving. `against` (m,)
    takes the sign of the force on a joint that starts moving, else zero; `scalar` are candidates past the
    contacts, other arguments as of `modes_of_contacts`.
    """
    modes, _, breaking, _ = chosen
    free, first = what.free, 3 * len(what.contacts)
    for m in range(len(what.joints)):
        a, i, limit, strength = first + m, what.scalars[m], what.joints[m], force[first + m]
        rubs = scalar[work.limits + i] != 0
        closed = not (
            (free[a] > pace[a] and strength <= (1.0 - AT_BOUND) * what.lower[m] + work.force_tolerance)
            or (free[a] < -pace[a] and strength >= (1.0 - AT_BOUND) * what.upper[m] - work.force_tolerance)
        )
        stopped[a] = closed
        if rubs and not closed:
            breaking[i] = strength
            against[a] = math.copysign(1.0, strength)
        modes[work.contacts + limit] = 1 if closed else 0
        if rubs:
            modes[work.contacts + work.limits + i] = 1 if closed else 0


@inlined
def stop(work, what, candidates, start, stopped, against, chosen, v):
    """Stop the rows that come to rest; see `come_to_rest`, whose values it returns.

    Rows of contacts that begin to slip, and their velocities in `start` (m,), turn to their directions. What
    is rejected is added to the `Choice`. Other arguments as of `find_modes` and `modes_of_scalar_rows`.
    """
    contacts, joints, scalars, rows, velocity, _, slip, mu, held, _, _ = what
    modes, reference, _, rejected = chosen
    size, closed = len(start), 3 * len(contacts)
    on, moves = np.zeros(size, dtype=np.int64), flags(size, False)
    for k in range(len(contacts)):
        b, i = 3 * k, contacts[k]
        if stopped[b] and not held[k]:
            moves[b] = moves[b + 1] = touching_rows.keeps_sliding(
                work, i, velocity[k, 0], velocity[k, 1], 0.0
            )
        if modes[i] == SLIP and mu[k] > 0.0 and slip[k, 0] == 0.0 and slip[k, 1] == 0.0:
            turn_rows(reference[i], rows[b : b + 2], start[b : b + 2])
            stopped[b], against[b] = False, -1.0
    for m in range(len(joints)):
        touches = candidates[work.contacts + joints[m]] == TOUCHES
        moves[closed + m] = joints[m] >= work.limits and touches
    limits = CERTAIN * error_of_step(work, v), behind(work), work.stick_speed
    gained, fastest = come_to_rest(
        work.minverse, rows, start, stopped, against, moves, closed, *limits, work.joint_metres, on, v
    )
    for k in range(len(contacts)):
        if on[3 * k] != 0 or on[3 * k + 1] != 0:
            rejected[contacts[k]] = KEEPS_SLIDING
    for m in range(len(joints)):
        rejected[work.contacts + work.limits + scalars[m]] = on[closed + m]
        if stopped[closed + m] and against[closed + m] != 0.0:
            v[scalars[m]] = 0.0  # not even a rounding error begins against the force
    return gained, fastest


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
def modes_of_contacts(work, what, force, unique, pace, stopped, chosen):
    """Fill modes and directions of slip, and which velocities are `stopped` (m,), from forces on contacts.

    `what` is `Touching`, with accelerations that include the forces; other arguments as of
    `resulting_accelerations`.
    """
    contacts, _, _, _, velocity, acceleration, slip, mu, held, _, _ = what
    before, modes, reference = work.modes, chosen.modes, chosen.reference
    for k in range(len(contacts)):
        b, i = 3 * k, contacts[k]
        normal, tangent = force[b + 2], math.hypot(force[b], force[b + 1])
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
        inside = pushes and tangent <= (1.0 - AT_BOUND) * mu[k] * normal
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
            reference[i, 0], reference[i, 1] = -force[b] / tangent, -force[b + 1] / tangent
        elif begins > 0.0:
            reference[i, 0], reference[i, 1] = acceleration[b] / begins, acceleration[b + 1] / begins
