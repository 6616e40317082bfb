"""Choice of the modes of contacts, limits and joints with dry friction at an instant. (theory.md, 11.3)

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOATS, INTEGERS, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.coulomb_problem import CoulombProblem
from ..._numeric.loops import assign, filled, flags, nonzero
from . import touching_rows
from .acting_forces import jammed_contact
from .active_set import close, stop_along
from .approach import PRESSED, SLIDES, TOUCHES
from .coming_to_rest import come_to_rest
from .contact_forces import FREE, HELD, SLIP, STICK, delassus_of_rows
from .dynamics import evaluate_without_contacts, invert_mass_matrix, set_state
from .slip import CERTAIN, error_of_step, fastest_of, reversal_tolerance
from .tolerances import AT_BOUND, DIFFERENT, STILL
from .workspace import SceneWorkspace

ROUNDS = 4
"""Largest number of iterations of the choice: stopping rows changes the velocity, hence directions of slip
and forces."""

SEPARATES, RUBS, KEEPS_SLIDING = 1, 2, 3
"""State of a rejected candidate, see `find_modes`."""


class Choice(NamedTuple):
    """Modes that have been chosen, and their consequences.

    Attributes:
        modes: (n + nl + nv,) modes of contacts, limits and joints.
        reference: (n, 2) unit directions of slip of sliding contacts.
        breaking: (nv,) force on each joint that its dry friction no longer holds [N], else zero.
        rejected: (n + nl + nv,) state of rejected candidates. For a contact that was open: `SEPARATES` if it
            loses a separation velocity, `RUBS` if it loses a tangential velocity (both apply only if it stays
            open). For any contact: `SEPARATES` if its curvature opens it (11.14), `KEEPS_SLIDING` if its
            sticking would accelerate a joint against its force. For a joint that sticking contacts drag
            against its friction, or whose stop would accelerate another one, the sign of its velocity. (11.9)
    """

    modes: Integers
    reference: FloatRows
    breaking: Floats
    rejected: Integers


@declared(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS)
@jit
def set_modes(work, t, q, v, slow):
    """Choose the modes of the candidates `slow` (n + nl,), see `approach`; close the active set.

    `v` is changed: rows at rest stop. `modes`, `sliding_friction` and the active set are updated. Returns the
    first three results of `find_modes`, with the energy of all iterations.
    """
    dry, sliding, metres = work.dry_friction, work.sliding_friction, work.joint_metres
    n, touching = len(v), len(slow)
    candidates, modes = np.zeros(touching + n, dtype=np.int64), np.zeros(touching + n, dtype=np.int64)
    assign(candidates[:touching], slow)
    reference, breaking = np.zeros((work.contacts, 2)), np.zeros(n)
    rejected, before, friction_before = np.zeros(touching + n, dtype=np.int64), v.copy(), sliding.copy()
    chosen, dragged = Choice(modes, reference, breaking, rejected), np.zeros(n, dtype=np.int64)
    certain, error = work.certain_speed, error_of_step(work, v)
    jamming, converged, energy, stopped, tried = -1, True, 0.0, math.inf, 0
    while tried < ROUNDS and stopped > STILL * work.stick_speed:
        for j in range(n):  # in every iteration: stopping rows may have set joints in motion
            if dry[j] > 0.0:
                slow_enough = metres[j] * abs(v[j]) <= work.stick_speed
                moves = sliding[j] * metres[j] * v[j] > dry[j] * certain
                rests = slow_enough and not moves and dragged[j] == 0
                held = work.modes[work.contacts + work.limits + j] != 0
                candidates[touching + j] = (PRESSED if held else TOUCHES) if rests else 0
                # in the first iteration v is still the velocity before anything stops
                direction = float(dragged[j]) if tried == 0 and dragged[j] != 0 else v[j]
                sliding[j] = 0.0 if rests else math.copysign(dry[j], direction)
        if len(nonzero(candidates)) == 0:
            break
        jamming, converged, gained, stopped, active_speed = find_modes(
            work, t, q, v, candidates, certain, chosen
        )
        energy, tried, error = energy + gained, tried + 1, max(error, active_speed)
        released, last = False, tried == ROUNDS or stopped <= STILL * work.stick_speed
        if jamming >= 0 or work.callback_failed:
            assign(sliding, friction_before)
            return jamming, converged, energy
        drags = False
        for i in range(len(rejected)):
            if i >= touching or rejected[i] == KEEPS_SLIDING:
                drags |= rejected[i] != 0
            elif rejected[i] != 0 and modes[i] == FREE:
                candidates[i], released = 0 if rejected[i] == SEPARATES else SLIDES, True
        change = fastest_of(metres, v - before) if last else 0.0
        much = drags or change > CERTAIN * error
        if not released and much and certain > error:
            # stopping that changes other velocities by more than the error of a step is rejected (11.8)
            certain, released = error, True
            filled(dragged, 0)  # the contacts that drag these joints may now slide
        elif not released and change > CERTAIN * work.resting_speed:  # no force holds those that separate
            for i in range(touching):
                if rejected[i] == SEPARATES:
                    candidates[i], released = 0, True
        if not released and drags:
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
            assign(sliding, friction_before)
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
    """Find the modes of the candidates at given velocities: forces, modes, rows at rest. (theory.md, 11.3)

    Args:
        work: The workspace, with the modes so far.
        t, q, v: Time [s] and state; v is changed: rows at rest stop.
        candidates: (n + nl + nv,) nonzero for candidates in the order of `modes`: for contacts and limits
            see `approach`, for joints at rest `PRESSED` if dry friction has held them, else `TOUCHES`.
        certain: Speed above which a sliding contact keeps sliding [m/s].
        chosen: Is overwritten with the `Choice`.

    Returns:
        The contact that jams, so that no force exists, or −1; whether the forces were found to the usual
        accuracy; the kinetic energy gained [J]; the largest speed removed [m/s]; the largest speed of rows
        active so far [m/s].
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
    unique = touching_rows.determines_forces(delassus, what.law)
    problem = CoulombProblem(delassus, what.free, what.law)
    converged = touching_rows.forces_on(work, what, problem, candidates, unique, force)
    curved = touching_rows.curved_contacts(work, q, v, what, response, delassus, force)
    for i in curved:
        chosen.rejected[i] = SEPARATES
    if len(curved) > 0:  # modes are chosen again without them
        return -1, True, 0.0, 0.0, 0.0
    # if no forces were found, `force` has those of the last attempt
    jamming = -1 if converged else jammed_contact(problem, force)
    if jamming >= 0:
        b = 3 * jamming + 2
        gained = stop_along(what.rows[b : b + 1], what.velocity[jamming, 2:], work.minverse, v)
        return what.contacts[jamming], True, gained, 0.0, 0.0
    stopped, against = flags(size, False), np.zeros(size)  # see `come_to_rest`
    threshold = np.empty(size)
    touching_rows.resulting_accelerations(delassus, what.free, force, len(what.contacts), unique, threshold)
    negligible = touching_rows.negligible_forces(work, what, response, delassus, force)
    modes_of_contacts(work, what, force, negligible, unique, threshold, stopped, chosen)
    reject_contacts(work, what, stopped, certain, chosen.rejected)
    scalar = candidates[work.contacts :]
    modes_of_scalar_rows(work, what, scalar, force, negligible, threshold, stopped, against, chosen)
    start = np.empty(size)
    active_speed = touching_rows.speeds_of_rows(work, what, v, start)
    gained, fastest = stop(work, what, candidates, start, stopped, against, chosen, v)
    return -1, converged, gained, fastest, active_speed


@inlined
def clear(work, chosen):
    """Clear a `Choice`, except for rejected contacts."""
    modes, reference, breaking, rejected = chosen
    filled(modes, FREE)
    for i in range(len(reference)):
        reference[i, 0] = reference[i, 1] = 0.0
    for j in range(len(breaking)):
        breaking[j], rejected[work.contacts + work.limits + j] = 0.0, 0


@inlined
def reject_contacts(work, what, stopped, certain, rejected):
    """Reject open contacts that would lose a separation or tangential velocity above `certain` [m/s]."""
    velocity = what.velocity
    for k in range(len(what.contacts)):
        i = what.contacts[k]
        if stopped[3 * k + 2]:
            if velocity[k, 2] > certain:
                rejected[i] = SEPARATES
            elif (
                work.modes[i] == FREE
                and stopped[3 * k]
                and math.hypot(velocity[k, 0], velocity[k, 1]) > certain
            ):
                rejected[i] = RUBS


@inlined
def modes_of_scalar_rows(work, what, scalar, force, negligible, threshold, stopped, against, chosen):
    """Fill the modes of limits and of joints with dry friction from the forces on their rows.

    A row opens, or starts to slide, if its force is at a bound and its acceleration points away from it.
    `against` (m,) is overwritten with the sign of the force on a joint that starts to slide. `scalar` are the
    candidates after the contacts; other arguments as in `modes_of_contacts`.
    """
    modes, _, breaking, _ = chosen
    free, first = what.free, 3 * len(what.contacts)
    for m in range(len(what.joints)):
        a, i, limit, strength = first + m, what.scalars[m], what.joints[m], force[first + m]
        rubs = scalar[work.limits + i] != 0
        closed = not (
            (free[a] > threshold[a] and strength <= (1.0 - AT_BOUND) * what.law.lower[m] + negligible[a])
            or (free[a] < -threshold[a] and strength >= (1.0 - AT_BOUND) * what.law.upper[m] - negligible[a])
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
    """Stop the rows that come to rest; return the results of `come_to_rest`.

    The tangential rows of contacts with incipient slip, and their velocities in `start` (m,), are turned to
    the direction of slip. Rejected candidates are added to the `Choice`. Other arguments as in `find_modes`
    and `modes_of_scalar_rows`.
    """
    contacts, joints, scalars, rows, velocity, _, law = what
    mu, slip, held = law.friction, law.slip, law.held
    modes, reference, _, rejected = chosen
    size, closed = len(start), 3 * len(contacts)
    keep_sliding, moves = np.zeros(size, dtype=np.int64), flags(size, False)
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
    limits = CERTAIN * error_of_step(work, v), reversal_tolerance(work), work.stick_speed
    gained, fastest = come_to_rest(
        work.minverse,
        rows,
        start,
        stopped,
        against,
        moves,
        closed,
        *limits,
        work.joint_metres,
        keep_sliding,
        v,
    )
    for k in range(len(contacts)):
        if keep_sliding[3 * k] != 0 or keep_sliding[3 * k + 1] != 0:
            rejected[contacts[k]] = KEEPS_SLIDING
    for m in range(len(joints)):
        rejected[work.contacts + work.limits + scalars[m]] = keep_sliding[closed + m]
        if stopped[closed + m] and against[closed + m] != 0.0:
            v[scalars[m]] = 0.0  # a rounding error might point against the force
    return gained, fastest


@inlined
def turn_rows(direction, rows, velocity):
    """Turn two tangential rows (2, nv) and their velocities (2,): along a direction (2,), and across it.

    The row across is zero if it hardly moves the robot, as where the contact moves along one line only: to
    stop a rounding error along it would need a large change of velocity.
    """
    x, y = direction
    size = across = 0.0
    for j in range(rows.shape[1]):
        first, second = rows[0, j], rows[1, j]
        rows[0, j], rows[1, j] = x * first + y * second, x * second - y * first
        size, across = max(size, abs(first), abs(second)), max(across, abs(rows[1, j]))
    first, second = velocity
    velocity[0], velocity[1] = x * first + y * second, x * second - y * first
    if across <= DIFFERENT * size:
        filled(rows[1], 0.0)
        velocity[1] = 0.0


@inlined
def modes_of_contacts(work, what, force, negligible, unique, threshold, stopped, chosen):
    """Fill modes and directions of slip, and which rows stop, `stopped` (m,), from the forces on contacts.

    `what` is the `Touching`, whose `free` includes the forces by now; `negligible` (m,) are the forces that
    are taken as zero; other arguments as in `resulting_accelerations`.
    """
    contacts, _, _, _, velocity, acceleration, law = what
    mu, slip, held = law.friction, law.slip, law.held
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
        if normal <= negligible[b + 2] and acceleration[b + 2] > threshold[b]:
            stopped[b + 2] = velocity[k, 2] < 0.0
            continue
        stopped[b + 2] = True
        # a contact sticks if its force is inside the cone, or if it is not accelerated (unless it has been
        # sliding and forces are unique); whether its force then leaves the cone is an event, see
        # `events.force_bound`
        pushes = normal > negligible[b + 2]
        begins = math.hypot(acceleration[b], acceleration[b + 1])
        inside = pushes and tangent <= (1.0 - AT_BOUND) * mu[k] * normal
        inside |= (not unique or before[i] != SLIP) and begins <= threshold[b]
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
