"""An impact at many contacts by adaptive implicit steps, where events cannot be followed one by one.

(theory.md, section 14)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, FloatRows, Floats, declared
from ..._compile.interrupts import answer_signals
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign, filled
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
"""Of an implicit and an explicit method that share their weights; those of third order subtracted."""

STAGES = 6


GROWS, SHRINKS, SAFE = 5.0, 0.1, 0.9
"""By what a step may differ from the one before."""

CREEP = 10.0
"""A speed of slip, in parts of the accuracy, up to which friction is proportional to it."""


LOCKED, CHANGES, AT_BOUND = 1.0, 0.1, 100.0
"""The clock after which what creeps is locked, and by how much of ε it may change in a step. Contacts at
their bounds follow the creep of others: so many times ε at most."""

STIFF = 1.0
"""The unit of a contact's own clock: by explicit steps beyond it its oscillations would grow."""


class Contacts(NamedTuple):
    """The contacts of an impact by steps.

    Attributes:
        rows: (3n, r) J.
        friction: (n,) μ.
        springs: The `Springs`, with the largest penetrations.
        x: (n,) penetrations.
        pace: (n,) of velocities in their loading to indentations.
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
    """Resolve an impact at n contacts by steps of fourth order. (14.9)

    The velocities are `start` + J y, dy/ds = Jᵀ p. Penetrations x, dx/ds = −v₃, go by the explicit method, so
    normal forces are known at each stage, and y by the implicit one, whose stages are minima (with the energy
    of springs added where contacts are too stiff for explicit steps):

        ½|y − c|² + h a Σ μ_j F_j H(|v_jt|),                                                       (14.10)

    H(r) = r, but r²/2ε + ε/2 below ε. Where a step misses the accuracy, as at changes of contact, it is
    taken again with a shorter length.

    Args:
        rows: (3n, r) J, W = J Jᵀ, the largest of size one.
        start: (3n,) velocities before it, the largest of size one.
        friction: (n,) μ.
        restitution: (n,) e, of the energetic law, > 0.
        stiffness: (n,) κ, with κ W₃₃ ≤ 1.
        exponent: η, 1 or 3/2.
        accuracy: By how much a step may miss velocities and penetrations; ε is `CREEP` times as much.
        most: A bound on their number.
        impulse: (3n,) takes P.
        works: (n, 3) takes the works of compression, restitution and friction.
        path: (m, 3n + 1) takes the clock and P before each of the first m steps.

    Returns:
        The number of steps; 0: the bound has been reached.
    """
    n, r = len(friction), rows.shape[1]
    creep, mobility, pace = CREEP * accuracy, np.zeros(n), np.empty(n)
    for j in range(n):
        for k in range(r):
            mobility[j] += rows[3 * j + 2, k] ** 2
        pace[j] = math.sqrt(stiffness[j] * mobility[j])  # of velocities in its loading to indentations
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
    """Take the steps of `step_through`, from velocities v[0].

    Args:
        mobility: (n,) W₃₃ of each contact.
        v, force, rate: (STAGES, …) scratch.
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
            if held >= LOCKED:  # what is locked is pressed on, and that is of no impact
                assign(impulse, held_impulse)
                assign(works.ravel(), held_works)
                return step
        at = np.zeros(rows.shape[1])
        for k in range(len(at)):
            for i in range(STAGES):
                at[k] += h * WEIGHTS[i] * rate[i, k]
        _velocities(rows, v[0], at, v[0])
        assign(force[0], force[STAGES - 1])
        clock += h
        h *= factor
    return 0


@inlined
def _fill_forces(contacts, v, force):
    """Fill forces (3n,) at the start of a step; friction in the same part of its bound as at the last end."""
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
    """Let all move on for a time, at whose end the first of them close."""
    x, largest = contacts.x, contacts.springs.largest
    for j in range(len(x)):
        gap = largest[j] - x[j]
        x[j] -= time * v[3 * j + 2]
        if v[3 * j + 2] < 0.0 and gap <= -time * v[3 * j + 2]:
            x[j] = largest[j]


@inlined
def _find_step(contacts, v, force, rate, h, accuracy):
    """Find the stages of a step that keeps to the accuracy.

    Args:
        contacts: The `Contacts`.
        v: (STAGES, 3n) velocities, those at the start first.
        force: (STAGES, 3n) forces likewise.
        rate: (STAGES, r) dy/ds likewise.
        h: The length that is tried first.
        accuracy: By how much it may miss velocities and penetrations.

    Returns:
        Its length, and the factor to the next one.
    """
    pace, restitution = contacts.pace, contacts.springs.restitution
    while True:
        found = _find_stages(contacts, v, force, rate, h)
        missed = _missed(contacts, rate, v, h)
        factor = min(max(SAFE * (accuracy / max(missed, TINY)) ** 0.25, SHRINKS), GROWS)
        if h <= NEGLIGIBLE:
            break
        if missed <= accuracy and found:
            part = _until_a_turn(v[0], v[STAGES - 1], force[STAGES - 1], accuracy / h, pace, restitution)
            if part == 1.0:
                break
            h *= part
        else:
            h *= min(factor, SAFE) if found else SHRINKS
    return h, factor


@inlined
def _find_stages(contacts, v, force, rate, h):
    """Fill the stages of a step after the first; return whether all were found. See `_find_step`."""
    rows, friction, springs, x, pace, creep = contacts
    n, r = len(friction), rows.shape[1]
    target, at, bound, now = np.empty(r), np.zeros(r), np.empty(n), np.empty(n)
    stiff, found = np.zeros(n, dtype=np.bool_), True
    for j in range(n):  # contacts whose own time is shorter than the step
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
        for k in range(r):
            target[k] = 0.0
            for before in range(i):
                target[k] += h * IMPLICIT[i, before] * rate[before, k]
            for j in range(n):
                if not stiff[j]:
                    target[k] += part * rows[3 * j + 2, k] * force[i, 3 * j + 2]
        _velocities(rows, v[0], at, v[i])
        found = found and find_stage(
            rows, friction, creep, springs, stiff, now, part, target, at, v[i], force[i], bound
        )
        _oppose(friction, creep, v[i], force[i])
        _push(rows, force[i], rate[i])
    return found


@inlined
def _sum_up(contacts, v, force, h, impulse, works):
    """Add a step to the impulses (3n,) and works (n, 3), and move the penetrations to its end."""
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
        if x[j] <= largest[j] - dent:  # it has separated, and would be loaded again from there
            largest[j] -= dent
            peak[j] = 0.0


@inlined
def _velocities(rows, start, y, v):
    """Fill v (3n,) with those at the contacts."""
    for i in range(len(v)):
        v[i] = start[i]
        for k in range(len(y)):
            v[i] += rows[i, k] * y[k]


@inlined
def _outlook(contacts, v, force, mobility):
    """Return the speed of approach, now or to come, the time to the next closing, and if any is pressed."""
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
    """Fill in the friction of forces (3n,)."""
    for j in range(len(friction)):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        part = -friction[j] * force[z] / max(math.sqrt(v[x] * v[x] + v[y] * v[y]), creep)
        force[x], force[y] = part * v[x], part * v[y]


@inlined
def _push(rows, force, rate):
    """Fill dy/ds (r,) = Jᵀ p."""
    for k in range(len(rate)):
        rate[k] = 0.0
    for z in range(2, len(force), 3):
        if force[z] > 0.0:
            for k in range(len(rate)):
                for a in range(z - 2, z + 1):
                    rate[k] += rows[a, k] * force[a]


@inlined
def _missed(contacts, rate, v, h):
    """Return by how much a step misses velocities, by the method of third order.

    What it misses of penetrations counts as the velocity that it comes to: 1/e times as much in unloading.
    """
    rows, _, springs, x, pace, _ = contacts
    r, most = rows.shape[1], 0.0
    off = np.empty(r)
    for k in range(r):
        off[k] = 0.0
        for i in range(STAGES):
            off[k] += h * ERROR[i] * rate[i, k]
    for a in range(rows.shape[0]):
        total = 0.0
        for k in range(r):
            total += rows[a, k] * off[k]
        most = max(most, abs(total))
    for j in range(len(x)):
        z, total = 3 * j + 2, 0.0
        for i in range(STAGES):
            total += h * ERROR[i] * v[i, z]
        unloads = x[j] < springs.largest[j] or v[STAGES - 1, z] > 0.0
        most = max(most, abs(total) * pace[j] / (springs.restitution[j] if unloads else 1.0))
    return most


@inlined
def _until_a_turn(first, last, force, slow, pace, restitution):
    """Return the part of a step up to where what is pressed turns, and its stiffness changes; 1 if none does.

    Args:
        first, last: (3n,) velocities.
        force: (3n,) at its end.
        slow: A change of velocity over the step that does not matter, in parts of its length.
        pace, restitution: (n,).
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
    """Return whether friction holds all that is pressed, so that no force changes, and nothing approaches.

    No velocity is left but creep: the rows of J where any would matter are in the span of the J_t that creep.
    """
    n, r = len(friction), rows.shape[1]
    span, left = np.empty((r, r)), np.empty(r)
    count, largest = 0, 0.0
    for a in range(3 * n):
        size = 0.0
        for k in range(r):
            size += rows[a, k] * rows[a, k]
        largest = max(largest, size)
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
            for k in range(r):
                left[k] = rows[a, k]
            for _ in range(2):  # so that they are orthogonal to rounding
                for i in range(count):
                    along = 0.0
                    for k in range(r):
                        along += span[i, k] * left[k]
                    for k in range(r):
                        left[k] -= along * span[i, k]
            length = 0.0
            for k in range(r):
                length += left[k] * left[k]
            if length > NEGLIGIBLE * NEGLIGIBLE * largest:
                if moves == 1:
                    return False
                for k in range(r):
                    span[count, k] = left[k] / math.sqrt(length)
                count += 1
    return count > 0
