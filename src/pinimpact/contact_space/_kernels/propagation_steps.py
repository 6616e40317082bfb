"""Impact at several contacts by adaptive implicit steps, for very many events. (theory.md, section 14.9)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, FloatRows, Floats, declared
from ..._compile.interrupts import answer_signals
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign, filled
from ..._numeric.products import add, dot
from ..._numeric.tolerances import LITTLE, TINY
from .first_fall import NEVER
from .propagation_stages import Springs, find_stage, force_at
from .tolerances import NEGLIGIBLE, SLOW

# C. A. Kennedy and M. H. Carpenter, Appl. Numer. Math. 44 (2003) 139–181, ARK4(3)6L[2]SA
IMPLICIT = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 4, 1 / 4, 0, 0, 0, 0],
        [8611 / 62500, -1743 / 31250, 1 / 4, 0, 0, 0],
        [5012029 / 34652500, -654441 / 2922500, 174375 / 388108, 1 / 4, 0, 0],
        [
            *(15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768),
            *(2285395 / 8070912, 1 / 4, 0),
        ],
        [82889 / 524892, 0, 15625 / 83664, 69875 / 102672, -2260 / 8211, 1 / 4],
    ]
)
EXPLICIT = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 2, 0, 0, 0, 0, 0],
        [13861 / 62500, 6889 / 62500, 0, 0, 0, 0],
        [
            *(-116923316275 / 2393684061468, -2731218467317 / 15368042101831),
            *(9408046702089 / 11113171139209, 0, 0, 0),
        ],
        [
            *(-451086348788 / 2902428689909, -2682348792572 / 7519795681897),
            *(12662868775082 / 11960479115383, 3355817975965 / 11060851509271, 0, 0),
        ],
        [
            *(647845179188 / 3216320057751, 73281519250 / 8382639484533),
            *(552539513391 / 3454668386233, 3354512671639 / 8306763924573, 4040 / 17871, 0),
        ],
    ]
)
WEIGHTS = IMPLICIT[5].copy()
ERROR = WEIGHTS - np.array(
    [
        *(4586570599 / 29645900160, 0, 178811875 / 945068544),
        *(814220225 / 1159782912, -3700637 / 11593932, 61727 / 225920),
    ]
)
"""Coefficients of the implicit and the explicit method, which share `WEIGHTS`; `ERROR` is the difference of
the weights to those of the embedded method of third order."""

STAGES = 6

GROWS, SHRINKS, SAFE = 5.0, 0.1, 0.9
"""Largest and least factor from one step size to the next, and safety factor."""

CREEP = 10.0
"""ε of (14.10), the slip speed below which friction is regularized, over the accuracy of a step."""

LOCKED, CHANGES, AT_BOUND = 1.0, 0.1, 100.0
"""Friction has locked a mechanism if no velocity changes by more than `CHANGES` ε per step for `LOCKED` units
of the clock. Contacts with slip up to `AT_BOUND` ε count as sticking: those at their bounds follow the creep
of others."""

STIFF = 1.0
"""Step size, over a contact's time scale 1/√(κ W₃₃) in loading or e times that in unloading, above which its
spring is integrated implicitly."""


class Contacts(NamedTuple):
    """Parameters and penetrations of the contacts.

    Attributes:
        rows: (3n, r) J.
        friction: (n,) μ.
        springs: The `Springs`; their largest penetrations are updated after each step.
        x: (n,) penetrations.
        pace: (n,) √(κ W₃₃), which converts penetrations to velocities.
        creep: ε.
    """

    rows: FloatRows
    friction: Floats
    springs: Springs
    x: Floats
    pace: Floats
    creep: float


@declared(*(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, float, float, int), *(FLOATS, FLOAT_ROWS, FLOAT_ROWS))
@jit
def step_through(
    rows, start, friction, restitution, stiffness, exponent, accuracy, most, impulse, works, path
):
    """Resolve an impact at n contacts by adaptive steps of fourth order. (14.9), (14.10)

    The explicit method integrates the penetrations x, dx/ds = −v₃, so normal forces are known at each stage.
    The implicit method integrates y, with velocities `start` + J y and dy/ds = Jᵀ p; its stages minimize
    (14.10), to which the energy of springs too stiff for explicit steps is added.

    Args:
        rows: (3n, r) J with W = J Jᵀ, scaled to a largest row of size one.
        start: (3n,) pre-impact velocities, scaled to a largest of one.
        friction: (n,) μ.
        restitution: (n,) e > 0 of the energetic law.
        stiffness: (n,) κ, with κ W₃₃ ≤ 1.
        exponent: η, 1 or 3/2.
        accuracy: Tolerance of velocities and penetrations in a step; ε is `CREEP` times as large.
        most: Largest number of steps.
        impulse: (3n,) is overwritten with P.
        works: (n, 3) is overwritten with the work of compression, restitution and friction.
        path: (m, 3n + 1) is filled with the clock and P before each of the first m steps.

    Returns:
        The number of steps, or 0 if the impact has not ended after `most` steps.
    """
    n, r = len(friction), rows.shape[1]
    creep, mobility, pace = CREEP * accuracy, np.empty(n), np.empty(n)
    for j in range(n):
        mobility[j] = dot(rows[3 * j + 2], rows[3 * j + 2])
        pace[j] = math.sqrt(stiffness[j] * mobility[j])
    filled(works.ravel(), 0.0)
    filled(impulse, 0.0)
    springs = Springs(np.zeros(n), np.zeros(n), restitution, stiffness, exponent)
    contacts = Contacts(rows, friction, springs, np.zeros(n), pace, creep)
    rate, v, force = np.zeros((STAGES, r)), np.zeros((STAGES, 3 * n)), np.zeros((STAGES, 3 * n))
    assign(v[0], start)
    return _take_steps(contacts, mobility, v, force, rate, accuracy, most, impulse, works, path)


@declared(
    *(Contacts, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, float, int, FLOATS, FLOAT_ROWS, FLOAT_ROWS),
    result=int,
)
@external
def _take_steps(contacts, mobility, v, force, rate, accuracy, most, impulse, works, path):
    """Take the steps of `step_through`; return their number, or 0 for more than `most`.

    Args:
        contacts: The `Contacts`; their penetrations are overwritten.
        mobility: (n,) W₃₃ of each contact.
        v: (STAGES, 3n) velocities of the stages; v[0] is given.
        force, rate: (STAGES, 3n) p and (STAGES, r) dy/ds of the stages; scratch.
        accuracy, most, impulse, works, path: As for `step_through`.
    """
    contacts, v, force, rate = borrowed(contacts), borrowed(v), borrowed(force), borrowed(rate)
    impulse, works, path = borrowed(impulse), borrowed(works), borrowed(path)
    rows, friction, creep = contacts.rows, contacts.friction, contacts.creep
    held_impulse, held_works = np.empty(len(impulse)), np.empty(works.size)
    h, clock, held = LITTLE, 0.0, 0.0
    for step in range(1, most + 1):
        answer_signals()
        if step <= len(path):
            path[step - 1, 0] = clock
            assign(path[step - 1, 1:], impulse)
        _fill_forces(contacts, v[0], force[0])
        speed, time, pressed = _outlook(contacts, v[0], force[0], mobility)
        if speed <= max(SLOW, accuracy):
            return step
        if not pressed:
            _fly(contacts, v[0], time)
        _push(rows, force[0], rate[0])
        h, factor = _find_step(contacts, v, force, rate, h, accuracy)
        _sum_up(contacts, v, force, h, impulse, works)
        if not _locked(rows, friction, v[0], v[STAGES - 1], force[STAGES - 1], creep):
            held = 0.0
        else:
            if held == 0.0:
                assign(held_impulse, impulse)
                assign(held_works, works.ravel())
            held += h
            if held >= LOCKED:  # the impact ended as locking began; later impulses are static load
                assign(impulse, held_impulse)
                assign(works.ravel(), held_works)
                return step
        at = np.zeros(rows.shape[1])
        for i in range(STAGES):
            add(at, h * WEIGHTS[i], rate[i])
        _velocities(rows, v[0], at, v[0])
        assign(force[0], force[STAGES - 1])
        clock += h
        h *= factor
    return 0


@inlined
def _fill_forces(contacts, v, force):
    """Update forces (3n,) at the start of a step; friction keeps its ratio to the normal force."""
    for j in range(len(contacts.x)):
        normal = force_at(contacts.springs, j, contacts.x[j])
        for a in range(3 * j, 3 * j + 2):
            if force[3 * j + 2] > 0.0:
                force[a] *= normal / force[3 * j + 2]
            else:
                slip = math.hypot(v[3 * j], v[3 * j + 1])
                force[a] = -contacts.friction[j] * normal * v[a] / max(slip, contacts.creep)
        force[3 * j + 2] = normal


@inlined
def _fly(contacts, v, time):
    """Advance open contacts by the time of flight, and close those whose gap is then zero."""
    x, largest = contacts.x, contacts.springs.largest
    for j in range(len(x)):
        gap = largest[j] - x[j]
        x[j] -= time * v[3 * j + 2]
        if v[3 * j + 2] < 0.0 and gap <= -time * v[3 * j + 2]:
            x[j] = largest[j]


@inlined
def _find_step(contacts, v, force, rate, h, accuracy):
    """Compute the stages of a step whose error is within the accuracy.

    Args:
        contacts: The `Contacts`.
        v, force, rate: (STAGES, …) velocities, forces and dy/ds of the stages; the first of each is given,
            the others are overwritten.
        h: Step size that is tried first.
        accuracy: Tolerance of velocities and penetrations.

    Returns:
        The step size, and its ratio to the proposed next one.
    """
    pace, restitution = contacts.pace, contacts.springs.restitution
    while True:
        converged = _compute_stages(contacts, v, force, rate, h)
        error = _error_of_step(contacts, rate, v, h)
        factor = min(max(SAFE * (accuracy / max(error, TINY)) ** 0.25, SHRINKS), GROWS)
        if h <= NEGLIGIBLE:
            break
        if error <= accuracy and converged:
            part = _until_a_turn(v[0], v[STAGES - 1], force[STAGES - 1], accuracy / h, pace, restitution)
            if part == 1.0:
                break
            h *= part
        else:
            h *= min(factor, SAFE) if converged else SHRINKS
    return h, factor


@inlined
def _compute_stages(contacts, v, force, rate, h):
    """Compute the stages after the first, for `_find_step`; return whether all converged."""
    rows, friction, springs, x, pace, creep = contacts
    n, r = len(friction), rows.shape[1]
    target, at, bound, now = np.empty(r), np.zeros(r), np.empty(n), np.empty(n)
    stiff, converged = np.zeros(n, dtype=np.bool_), True
    for j in range(n):
        e = springs.restitution[j] if x[j] < springs.largest[j] or v[0, 3 * j + 2] > 0.0 else 1.0
        stiff[j] = h * pace[j] > STIFF * e
    for i in range(1, STAGES):
        part = h * IMPLICIT[i, i]
        for j in range(n):
            z = 3 * j + 2
            now[j] = x[j]
            for before in range(i):
                now[j] -= h * (IMPLICIT if stiff[j] else EXPLICIT)[i, before] * v[before, z]
            force[i, z] = force[i - 1, z] if stiff[j] else force_at(springs, j, now[j])
        filled(target, 0.0)
        for before in range(i):
            add(target, h * IMPLICIT[i, before], rate[before])
        for j in range(n):
            if not stiff[j]:
                add(target, part * force[i, 3 * j + 2], rows[3 * j + 2])
        _velocities(rows, v[0], at, v[i])
        converged = converged and find_stage(
            rows, friction, creep, springs, stiff, now, part, target, at, v[i], force[i], bound
        )
        _oppose(friction, creep, v[i], force[i])
        _push(rows, force[i], rate[i])
    return converged


@inlined
def _sum_up(contacts, v, force, h, impulse, works):
    """Add a step to the impulses (3n,) and work (n, 3), and advance the penetrations to its end."""
    x, springs = contacts.x, contacts.springs
    largest, peak = springs.largest, springs.peak
    for j in range(len(x)):
        z = 3 * j + 2
        for i in range(STAGES):
            part = h * WEIGHTS[i]
            x[j] -= part * v[i, z]
            works[j, 0 if v[i, z] < 0.0 else 1] += part * force[i, z] * v[i, z]
            for a in range(z - 2, z + 1):
                impulse[a] += part * force[i, a]
                if a < z:
                    works[j, 2] += part * force[i, a] * v[i, a]
        if x[j] > largest[j]:
            peak[j] += x[j] - largest[j]
            largest[j] = x[j]
        dent = springs.restitution[j] ** 2 * peak[j]
        if x[j] <= largest[j] - dent:  # separated; the next loading starts from here
            largest[j] -= dent
            peak[j] = 0.0


@inlined
def _velocities(rows, start, y, v):
    """Fill v (3n,) with the contact velocities `start` + J y."""
    for i in range(len(v)):
        v[i] = start[i] + dot(rows[i], y)


@inlined
def _outlook(contacts, v, force, mobility):
    """Return the largest speed of approach, the time to the next closing, and whether any contact is pressed.

    The speed includes the one that stored energy could still cause; `mobility` (n,) is W₃₃.
    """
    x = contacts.x
    largest, _, restitution, stiffness, exponent = contacts.springs
    speed, time, pressed = 0.0, NEVER, False
    for j in range(len(x)):
        normal, approach = force[3 * j + 2], -v[3 * j + 2]
        if normal > 0.0:
            pressed = True
            depth = (normal / stiffness[j]) ** (1.0 / exponent)
            stored = restitution[j] ** 2 * normal * depth / (exponent + 1.0)
            approach = max(approach, math.sqrt(2.0 * stored * mobility[j]))
        elif approach > 0.0:
            pressed = pressed or x[j] >= largest[j]
            time = min(time, (largest[j] - x[j]) / approach)
        speed = max(speed, approach)
    return speed, time, pressed


@inlined
def _oppose(friction, creep, v, force):
    """Fill the friction components of forces (3n,), from their normal components and v (3n,)."""
    for j in range(len(friction)):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        part = -friction[j] * force[z] / max(math.sqrt(v[x] * v[x] + v[y] * v[y]), creep)
        force[x], force[y] = part * v[x], part * v[y]


@inlined
def _push(rows, force, rate):
    """Fill dy/ds (r,) = Jᵀ p."""
    filled(rate, 0.0)
    for z in range(2, len(force), 3):
        if force[z] > 0.0:
            for a in range(z - 2, z + 1):
                add(rate, force[a], rows[a])


@inlined
def _error_of_step(contacts, rate, v, h):
    """Estimate the error of a step by the embedded method of third order, as a velocity.

    Errors of penetrations are multiplied by √(κ W₃₃), and by 1/e in unloading.
    """
    rows, _, springs, x, pace, _ = contacts
    most, error = 0.0, np.zeros(rows.shape[1])
    for i in range(STAGES):
        add(error, h * ERROR[i], rate[i])
    for row in rows:
        most = max(most, abs(dot(row, error)))
    for j in range(len(x)):
        z, total = 3 * j + 2, 0.0
        for i in range(STAGES):
            total += h * ERROR[i] * v[i, z]
        unloads = x[j] < springs.largest[j] or v[STAGES - 1, z] > 0.0
        most = max(most, abs(total) * pace[j] / (springs.restitution[j] if unloads else 1.0))
    return most


@inlined
def _until_a_turn(first, last, force, slow, pace, restitution):
    """Return the fraction of a step up to the first change of sign of v₃ at a pressed contact, or 1.

    The stiffness of the contact changes there.

    Args:
        first, last: (3n,) velocities at start and end of the step.
        force: (3n,) forces at its end.
        slow: Negligible change of a velocity, over the step size.
        pace, restitution: (n,) √(κ W₃₃) and e.
    """
    part = 1.0
    for j in range(len(pace)):
        z = 3 * j + 2
        if force[z] > 0.0 and first[z] * last[z] < 0.0:
            turn = first[z] / (first[z] - last[z])
            way = min(turn * abs(first[z]), (1.0 - turn) * abs(last[z]))
            if way * pace[j] > slow * restitution[j]:
                part = min(part, turn)
    return part


@inlined
def _locked(rows, friction, before, v, force, creep):
    """Return whether friction locks all pressed contacts and no contact approaches.

    The rows of J at contacts that are pressed, or approach, are then in the span of the tangential rows of
    sticking contacts, so that no velocity but creep remains.

    Args:
        rows: (3n, r) J.
        friction: (n,) μ.
        before, v: (3n,) velocities at start and end of the step.
        force: (3n,) forces at its end.
        creep: ε.
    """
    n, r = len(friction), rows.shape[1]
    span, rest = np.empty((r, r)), np.empty(r)
    count, largest = 0, 0.0
    for row in rows:
        largest = max(largest, dot(row, row))
    for moves in range(2):
        for a in range(3 * n):
            j = a // 3
            z = 3 * j + 2
            if force[z] > 0.0 and abs(v[a] - before[a]) > CHANGES * creep:
                return False
            rubs = friction[j] > 0.0 and force[z] > 0.0
            creeps = rubs and math.hypot(v[z - 2], v[z - 1]) <= AT_BOUND * creep
            if moves == 0:
                counts = a != z and creeps
            else:
                counts = (a != z and rubs and not creeps) or (a == z and (force[z] > 0.0 or v[z] < -SLOW))
            if not counts:
                continue
            assign(rest, rows[a])
            for _ in range(2):  # Gram–Schmidt twice, to be orthogonal to rounding
                for i in range(count):
                    add(rest, -dot(span[i], rest), span[i])
            length = dot(rest, rest)
            if length > NEGLIGIBLE * NEGLIGIBLE * largest:
                if moves == 1:
                    return False
                for k in range(r):
                    span[count, k] = rest[k] / math.sqrt(length)
                count += 1
    return count > 0
