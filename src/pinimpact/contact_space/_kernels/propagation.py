"""An impact at many contacts: forces that follow from indentations, along a clock that all share.

(theory.md, section 14)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import power, repeated
from .codes import (
    COMPRESSION,
    FREE,
    HELD,
    IN_SLIP,
    IN_STICK,
    LOADING,
    NONE_YET,
    OPEN,
    RESTITUTION,
    RISING,
    SINKING,
    SLIPPING,
    STUCK,
)
from .first_fall import NEVER, first_fall, value_at
from .plastic import TINY, come_to_rest, end_plastically
from .propagation_friction import AT_BOUND, NEAR_BOUND, SLIP_SPEED, settle, unknown_after
from .propagation_series import (
    TIED,
    State,
    System,
    begins,
    expand,
    loads,
    natural_pace,
    new_series,
)

ORDER, SHORT, FIRST = np.int64(24), np.int64(2), np.int64(1)
"""Of the series; what is left of it where a slip runs straight at zero; what tells the pace of slips."""

AT_REST = 1e-11
"""A tangential velocity below this part of the largest is rounding of what a robot's is formed from."""

TIE = 1e-11
"""Events closer to each other than this, in the clock, are one."""

STOPS = 1e-7
"""A slip below this speed that runs straight at zero is taken there in one step."""

REACH = 20.0
"""Steps within which a slip that runs straight at zero is there."""

NOWHERE = 1e-6
"""Part of the speed at which slips begin that the series of one that begins has to reach."""

SEEN = 1e-3
"""Part of the accuracy of velocities that impulses have where velocities do not feel them."""

LONGEST = 1e3
"""The longest step, in units of the pace."""

MOVED = 1e-10
"""A speed at which what was thought to be held is not, and from which on what slips beside it is."""

RESTING = 1e-10
"""A speed of approach, in parts of the largest velocity, below which all that is left is rest."""

DRIFT = 1e-12
"""Part of the largest velocity by which one may differ from what the impulses make of it."""

MOST_EVENTS = 200
"""Events per contact, at most."""

FEWEST, PLASTIC_EVENTS = 20, 4
"""Events, and those per contact, after which an impact without restitution is ended by a plastic one."""

NO_ROW = np.int64(-1)
"""Where a contact has no row yet."""

POINTS = 4
"""Points recorded on a step."""


@declared(
    FLOAT_ROWS,
    FLOATS,
    FLOATS,
    FLOATS,
    FLOATS,
    float,
    float,
    int,
    FLOATS,
    FLOATS,
    FLOAT_ROWS,
    INTEGERS,
    FLOAT_ROWS,
    FLOAT_ROWS,
)
@jit
def propagate(
    w,
    start,
    friction,
    restitution,
    stiffness,
    exponent,
    accuracy,
    most_steps,
    v,
    impulse,
    works,
    counts,
    rows,
    path,
):
    """Resolve an impact at n contacts.

    Args:
        w: (3n, 3n) W.
        start: (3n,) velocities before it.
        friction: (n,) μ.
        restitution: (n,) e, of the energetic law.
        stiffness: (n,) κ.
        exponent: η, 1 or 3/2.
        accuracy: Part of the velocities that a step may miss.
        most_steps: A bound.
        v: (3n,) takes the velocities after it.
        impulse: (3n,) takes P.
        works: (n, 3) takes the works of compression, restitution and friction.
        counts: (5,) takes the numbers of steps, events, rows and points, and how it ended: 0 by itself, 1
            since all was slow or plastic, 2 not: modes are not known, or steps or events at their bound.
        rows: (m, 5) takes contact, mode, phase, P₃ at start and end; (0, 5): not wanted.
        path: (m, 6n + 1) takes the clock, velocities and impulses; (0, …): not wanted.

    Returns:
        Whether the approach could be stopped, and what the answer misses: velocities that the impulses do not
        make, in parts of the largest before it, friction beyond its cone, in parts of the strongest impulse,
        or energy that they create, in parts of the works' sizes.
    """
    n = len(friction)
    order = _of_their_own(w, start, friction, restitution, stiffness)
    places = np.empty(3 * n, dtype=np.int64)
    scale, most = 0.0, 0.0
    for j in range(n):
        for k in range(3):
            places[3 * j + k] = 3 * order[j] + k
            scale = max(scale, abs(start[3 * j + k]))
        most = max(most, stiffness[j] * w[3 * j + 2, 3 * j + 2])
    scale, most = scale if scale > 0.0 else 1.0, most if most > 0.0 else 1.0
    own_w, before, p = np.empty((3 * n, 3 * n)), np.empty(3 * n), np.zeros(3 * n)
    numbers, own_works = np.empty((3, n)), np.zeros((n, 3))
    for i in range(3 * n):
        before[i] = start[places[i]] / scale
        for k in range(3 * n):
            own_w[i, k] = w[places[i], places[k]]
    for j in range(n):
        numbers[0, j], numbers[1, j] = friction[order[j]], restitution[order[j]]
        numbers[2, j] = stiffness[order[j]] / most
    u = before.copy()
    stopped = _follow(
        own_w,
        u,
        numbers[0],
        numbers[1],
        numbers[2],
        exponent,
        accuracy,
        most_steps,
        p,
        own_works,
        counts,
        rows,
        path,
    )
    missed = gained = size = 0.0
    made = before.copy()
    for i in range(3 * n):
        for k in range(3 * n):
            made[i] += own_w[i, k] * p[k]
        missed = max(missed, abs(u[i] - made[i]))
        stopped = stopped and math.isfinite(u[i]) and math.isfinite(p[i])
    if missed > DRIFT:  # what has been set to zero at many events adds up
        u = made
    strongest = outside = 0.0
    for j in range(n):
        strongest = max(strongest, p[3 * j + 2])
        outside = max(outside, math.hypot(p[3 * j], p[3 * j + 1]) - numbers[0, j] * p[3 * j + 2])
        for k in range(3):
            gained += own_works[j, k]
            size += abs(own_works[j, k])
            works[order[j], k] = own_works[j, k] * scale * scale
    missed = max(missed, outside / max(strongest, 1e-300))
    for i in range(3 * n):
        v[places[i]] = u[i] * scale
        impulse[places[i]] = p[i] * scale
    for row in range(min(counts[2], len(rows))):
        rows[row, 0] = order[int(rows[row, 0])]
        rows[row, 3] *= scale
        rows[row, 4] *= scale
    for row in range(min(counts[3], len(path))):
        point = path[row].copy()
        for i in range(3 * n):
            path[row, 1 + places[i]] = point[1 + i] * scale
            path[row, 1 + 3 * n + places[i]] = point[1 + 3 * n + i] * scale
    return stopped, max(missed, gained / max(size, 1e-300))


@inlined
def _of_their_own(w, v, friction, restitution, stiffness):
    """Return an order (n,) of the contacts by what they are, so that nothing comes of how they are numbered.

    Where rounding decides, as at ties, sums in another order decide otherwise.
    """
    n = len(friction)
    keys, order = np.empty((n, 9)), np.empty(n, dtype=np.int64)
    for j in range(n):
        for k in range(3):
            keys[j, k] = v[3 * j + 2 - k]
            keys[j, 3 + k] = w[3 * j + 2 - k, 3 * j + 2 - k]
        keys[j, 6], keys[j, 7], keys[j, 8] = friction[j], restitution[j], stiffness[j]
        place = j
        while place > 0 and _comes_first(keys, j, order[place - 1]):
            order[place] = order[place - 1]
            place -= 1
        order[place] = j
    return order


@inlined
def _comes_first(keys, i, j):
    """Return whether row i comes before row j where their first numbers differ."""
    for k in range(keys.shape[1]):
        if keys[i, k] != keys[j, k]:
            return keys[i, k] < keys[j, k]
    return False


@inlined
def _follow(
    w, v, friction, restitution, stiffness, exponent, accuracy, most_steps, impulse, works, counts, rows, path
):
    """Go from event to event, with velocities of size one and κ W₃₃ ≤ 1; see `propagate`.

    Args:
        v: (3n,) velocities; takes those after the impact.
    """
    n = len(friction)
    unloading, plastic = np.zeros(n), True
    for j in range(n):
        if restitution[j] > 0.0:
            plastic = False
            unloading[j] = 1.0 / (restitution[j] * restitution[j])
    system = System(w, friction, unloading, stiffness, exponent)
    state = State(
        v,
        impulse,
        np.zeros(n),
        np.zeros(n),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64),
        np.zeros(2 * n),
        np.zeros(n, dtype=np.int64),
        np.zeros(2 * n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
    )
    series = new_series(ORDER, n)
    roots, work = np.empty((n, 3)), np.empty((4, ORDER + 1))
    guard = np.empty(ORDER + 1)
    latest = repeated(n, NO_ROW)
    for j in range(n):
        if v[3 * j + 2] <= TINY:
            if not w[3 * j + 2, 3 * j + 2] > 0.0:
                if v[3 * j + 2] < -TINY:
                    return False
                continue
            _close(system, state, j)
    clock, at_once = 0.0, 0
    events = rows_used = points = steps = NONE_YET
    points = _record(path, points, clock, state)
    while True:
        presses = _loaded(state)
        time = _next_closing(state)
        if not presses and time == NEVER:
            break
        if _rests(system, state):
            counts[4] = 1
            come_to_rest(system, state, works)
            points = _record(path, points, clock, state)
            break
        if plastic and events >= FEWEST + PLASTIC_EVENTS * n:
            counts[4] = 1
            if not end_plastically(system, state, works):
                return False
            points = _record(path, points, clock, state)
            break
        if steps >= most_steps or events >= MOST_EVENTS * n:
            counts[4] = 2
            break
        if not presses:
            for j in range(n):
                if state.normal[j] == OPEN:
                    state.indentation[j] -= time * state.v[3 * j + 2]
                    if state.indentation[j] >= -TINY and state.v[3 * j + 2] < -TINY:
                        _close(system, state, j)
            clock += time
            events += 1
        unknown, inverse, weight, known = settle(system, state, series)
        if not known:
            counts[4] = 2
            break
        if _ring(system, state, unknown, inverse, series):
            events += 1
            continue
        turns = _presses_and_slips(state)
        while True:  # steps, up to the next event
            if turns:
                unknown, inverse, weight = unknown_after(system, state, _directions(state), weight)
            expand(system, state, unknown, inverse, FIRST, 1.0, series)
            pace = natural_pace(state, series)
            root = expand(system, state, unknown, inverse, ORDER, pace, series)
            h = _step_length(system, series, accuracy, pace, LONGEST)
            if _begins_badly(state, series, h):
                steps += 1
                continue
            if pace == 1.0 and h >= LONGEST and _at_rest(series, state):
                _loaded_ends(state)
                first = NEVER
                break
            first, degree = _find_events(system, state, series, h, at_once > 2 * n, roots, guard, work)
            h = first if degree == SHORT else min(h, first)
            if h > 0.0:
                at_once = 0 if h * pace > TIE else at_once
                rows_used = _advance(
                    system, state, series, h, degree, pace, root, works, rows, rows_used, latest
                )
                if path.shape[0] > 0:
                    points = _record_step(path, points, clock, series, state, h, degree, pace, root)
                clock += _time_power(NONE_YET, h, pace, root)
            steps += 1
            counts[0], counts[1], counts[2], counts[3] = steps, events, rows_used, points
            if first <= h or steps >= most_steps:
                break
        events += 1
        if first <= h:
            at_once += 1
            _apply(system, state, series, roots, first, TIE / pace)
    counts[0], counts[1], counts[2], counts[3] = steps, events, rows_used, points
    return True


@inlined
def _presses_and_slips(state):
    """Return whether any contact is held and slips."""
    found = False
    for j in range(len(state.normal)):
        found = found or (state.normal[j] == HELD and state.tangent[j] == SLIPPING)
    return found


@inlined
def _begins_badly(state, series, h):
    """Let a slip whose series reaches nowhere begin at a speed that does not matter; tell whether any did.

    The accelerations of one that begins at the bound of friction are not zero by as much as forces are off,
    and turn it in no time.
    """
    found = False
    for j in range(len(state.normal)):
        if state.tangent[j] == SLIPPING and begins(state.fresh[j]):
            speed = series.speed[0, j] * h * (h if state.fresh[j] == TIED else 1.0)
            if speed < NOWHERE * SLIP_SPEED:
                state.fresh[j] = 1
                state.v[3 * j] = SLIP_SPEED * state.direction[2 * j]
                state.v[3 * j + 1] = SLIP_SPEED * state.direction[2 * j + 1]
                found = True
    return found


@inlined
def _ring(system, state, unknown, inverse, series):
    """Let held contacts oscillate about their new forces; return whether any of them separates. (14.12)"""
    n = len(state.normal)
    some = False
    for j in range(n):
        some = some or state.normal[j] == HELD
    if not some:
        return False
    expand(system, state, unknown, inverse, np.int64(0), 1.0, series)
    least, strongest = 0.0, 0.0
    for j in range(n):
        if state.normal[j] == HELD:
            mean = series.force[0, 3 * j + 2]
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            strongest = max(strongest, cap)
            excited = state.ringing[j] + abs(state.last[j] - mean) / system.exponent
            state.ringing[j] = min(excited, max(cap - mean, 0.0) / system.exponent)
            state.last[j] = mean
            least = min(least, mean - state.ringing[j])
    if not least < -TIE * strongest:
        return False
    for j in range(n):
        if state.normal[j] == HELD and state.last[j] - state.ringing[j] <= least + TIE * strongest:
            if state.last[j] <= TIE * strongest:
                _open(state, j)
            else:
                _close(system, state, j)
    return True


@inlined
def _directions(state):
    """Return the directions (2n,) of slip."""
    unit = state.direction.copy()
    for j in range(len(state.normal)):
        speed = math.hypot(state.v[3 * j], state.v[3 * j + 1])
        if state.tangent[j] == SLIPPING and speed > 0.0:
            unit[2 * j], unit[2 * j + 1] = state.v[3 * j] / speed, state.v[3 * j + 1] / speed
    return unit


@inlined
def _close(system, state, j):
    """Let a contact begin to load."""
    state.normal[j] = LOADING
    state.indentation[j] = 0.0
    state.deepest[j] = 0.0
    state.tangent[j] = FREE
    if system.friction[j] > 0.0:
        state.tangent[j] = SLIPPING
        if math.hypot(state.v[3 * j], state.v[3 * j + 1]) <= AT_REST:
            _stick(state, j)


@inlined
def _stick(state, j):
    """Let the slip of a contact be at its end."""
    state.tangent[j] = STUCK
    state.v[3 * j] = 0.0
    state.v[3 * j + 1] = 0.0


@inlined
def _open(state, j):
    """Let a contact part."""
    state.normal[j] = OPEN
    state.tangent[j] = FREE
    state.indentation[j] = 0.0
    state.deepest[j] = 0.0


@inlined
def _loaded(state):
    """Return whether any contact is pressed or approaches; where none is, open those at rest."""
    n = len(state.normal)
    for j in range(n):
        if loads(state.normal[j]) and (state.indentation[j] > TINY or state.v[3 * j + 2] < -TINY):
            return True
    for j in range(n):
        if state.normal[j] != OPEN:
            _open(state, j)
    return False


@inlined
def _at_rest(series, state):
    """Return whether no velocity changes any more, and nothing is pressed on."""
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN and abs(state.v[3 * j + 2]) > MOVED:
            return False
    for k in range(1, ORDER + 1):
        for i in range(series.v.shape[1]):
            if abs(series.v[k, i]) > TINY:
                return False
    return True


@inlined
def _rests(system, state):
    """Return whether no contact approaches, or can come to, faster than what counts as rest."""
    for j in range(len(state.normal)):
        z = 3 * j + 2
        speed = -state.v[z]
        if state.normal[j] != OPEN and state.indentation[j] > 0.0:
            stored = system.stiffness[j] * state.indentation[j] ** (system.exponent + 1.0)
            speed = max(speed, math.sqrt(2.0 * stored / (system.exponent + 1.0) * system.w[z, z]))
        if speed > RESTING:
            return False
    return True


@inlined
def _loaded_ends(state):
    """Let go of what is locked: friction holds it, and what it has stored stays there."""
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN:
            state.v[3 * j + 2] = 0.0
            _open(state, j)


@inlined
def _next_closing(state):
    """Return the time of flight to the next contact that closes."""
    time = NEVER
    for j in range(len(state.normal)):
        v3 = state.v[3 * j + 2]
        if v3 < -TINY:
            time = min(time, state.indentation[j] / v3)
    return time


@inlined
def _step_length(system, series, accuracy, pace, h):
    """Return how far the series reaches."""
    n = len(system.friction)
    weight = 0.0
    for i in range(3 * n):
        weight = max(weight, system.w[i, i])
    for k in range(ORDER - 1, ORDER + 2):
        largest = 0.0
        for i in range(3 * n):
            largest = max(largest, abs(series.v[k, i]))
            # forces that cancel each other in all velocities are not seen there
            largest = max(largest, SEEN * weight * abs(series.force[k - 1, i]) * pace / k)
        for j in range(n):
            largest = max(largest, abs(series.indentation[k, j]))
        if largest > 0.0:
            h = min(h, (accuracy / largest) ** (1.0 / k))
    return h


@inlined
def _fall(c, h, zero, crowded, work):
    """Return where a guard falls; from zero at once does not count where that has been so too often."""
    time = first_fall(c, ORDER, h, zero, work)
    return NEVER if crowded and time <= 0.0 and c[0] >= -zero else time


@inlined
def _find_events(system, state, series, h, crowded, roots, guard, work):
    """Fill the times (n, 3) at which the modes of contacts end; return the first, and the degree to go by."""
    n = len(system.friction)
    first, degree = NEVER, ORDER
    strongest = 0.0
    for j in range(n):
        for k in range(2):
            strongest = max(strongest, abs(series.force[k, 3 * j + 2]))
    for j in range(n):
        mode, x, y, z = state.normal[j], 3 * j, 3 * j + 1, 3 * j + 2
        for k in range(3):
            roots[j, k] = NEVER
        for k in range(ORDER + 1):
            if mode == OPEN:
                guard[k] = -series.indentation[k, j]
            elif mode == HELD:
                guard[k] = series.force[k, z] - (state.ringing[j] if k == 0 else 0.0)
            elif mode == RISING:
                guard[k] = series.v[k, z]
            else:
                guard[k] = -series.v[k, z]
        roots[j, 0] = _fall(guard, h, TINY * strongest if mode == HELD else TINY, crowded, work)
        if mode == HELD and state.ringing[j] > 0.0 and series.force[1, z] > 0.0:
            for k in range(ORDER):
                guard[k] = (k + 1.0) * series.force[k + 1, z]
            guard[ORDER] = 0.0
            top = _fall(guard, h, TINY * strongest, crowded, work)
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            highest = value_at(series.force, z, ORDER, top) if top < roots[j, 0] else 0.0
            if highest + state.ringing[j] * system.exponent > cap * (1.0 + TIE):
                roots[j, 0] = top
        if mode in (RISING, SINKING, HELD):
            for k in range(ORDER + 1):
                if mode == RISING:
                    guard[k] = series.indentation[k, j]
                else:
                    guard[k] = -series.force[k, z] if mode == HELD else -series.indentation[k, j]
            if mode == SINKING:
                guard[0] += state.deepest[j]
            elif mode == HELD:
                guard[0] += system.stiffness[j] * state.deepest[j] ** system.exponent
            roots[j, 1] = _fall(guard, h, TINY * strongest if mode == HELD else TINY, crowded, work)
        if state.tangent[j] == STUCK:
            square = system.friction[j] * system.friction[j]
            for k in range(ORDER + 1):
                total = 0.0
                for i in range(k + 1):
                    total += square * series.force[i, z] * series.force[k - i, z]
                    total -= series.force[i, x] * series.force[k - i, x]
                    total -= series.force[i, y] * series.force[k - i, y]
                guard[k] = total
            roots[j, 2] = _fall(guard, h, 1e-2 * TIE * strongest * strongest, crowded, work)
        elif state.tangent[j] == SLIPPING:
            ux, uy = series.unit[0, 2 * j], series.unit[0, 2 * j + 1]
            speed = series.speed[0, j]
            for k in range(ORDER + 1):
                guard[k] = series.v[k, x] * ux + series.v[k, y] * uy
            if begins(state.fresh[j]):  # it begins with s² or s
                guard[0] = 0.0
            if state.fresh[j] == TIED:
                guard[1] = 0.0
            time = _fall(guard, h, 0.0, False, work)
            if time < NEVER:
                across = value_at(series.v, y, ORDER, time) * ux - value_at(series.v, x, ORDER, time) * uy
                if abs(across) <= 10.0 * TINY:
                    roots[j, 2] = time
            elif speed < STOPS and not begins(state.fresh[j]):
                along, across = guard[1], abs(series.v[1, y] * ux - series.v[1, x] * uy)
                near = speed <= REACH * h * -along  # else something else happens long before
                straight = along < 0.0 and near and across * speed <= TINY * -along
                if state.fresh[j] != 0:  # it has just begun
                    straight = straight and speed < 0.5 * SLIP_SPEED
                straight = straight and _neglected(series, -speed / along) <= TINY
                if straight or (state.fresh[j] == 0 and speed < 10.0 * TINY and across > 0.1 * along):
                    roots[j, 2] = -speed / along if straight else 0.0
                    if roots[j, 2] < first:
                        degree = SHORT
        for k in range(3):
            if roots[j, k] < first:
                first = roots[j, k]
                if k < 2 or state.tangent[j] == STUCK:
                    degree = ORDER
    return first, degree


@inlined
def _neglected(series, h):
    """Return what velocities change in a step beyond its short series."""
    largest = 0.0
    for i in range(series.v.shape[1]):
        largest = max(largest, abs(series.v[SHORT + 1, i]))
    return largest * h**3


@inlined
def _time_power(k, h, pace, root):
    """Return what the coefficient k of a force comes to in an impulse at the end of a step."""
    if root:
        return 2.0 * pace * pace * power(h, k + 2) / (k + 2.0)
    return pace * power(h, k + 1) / (k + 1.0)


@inlined
def _advance(system, state, series, h, degree, pace, root, works, rows, used, latest):
    """Go to the end of a step, with works and rows; return how many rows there are."""
    n = len(system.friction)
    for j in range(n):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        before = state.impulse[z]
        if state.normal[j] != OPEN:
            normal_work = friction_work = 0.0
            for k in range(degree + 1):
                normal_power = friction_power = 0.0
                for i in range(k + 1):
                    normal_power += series.force[i, z] * series.v[k - i, z]
                    friction_power += series.force[i, x] * series.v[k - i, x]
                    friction_power += series.force[i, y] * series.v[k - i, y]
                part = _time_power(k, h, pace, root)
                normal_work += normal_power * part
                friction_work += friction_power * part
                for i in range(x, z + 1):
                    state.impulse[i] += series.force[k, i] * part
            restores = state.normal[j] == RISING or state.normal[j] == HELD
            works[j, 1 if restores else 0] += normal_work
            works[j, 2] += friction_work
            if rows.shape[0] > 0 and state.impulse[z] > before:
                slips = state.tangent[j] == SLIPPING or state.tangent[j] == FREE
                mode, phase = IN_SLIP if slips else IN_STICK, RESTITUTION if restores else COMPRESSION
                last = latest[j]
                if last >= 0 and rows[last, 1] == mode and rows[last, 2] == phase and rows[last, 4] == before:
                    rows[last, 4] = state.impulse[z]
                elif used < rows.shape[0]:
                    rows[used, 0], rows[used, 1], rows[used, 2] = j, mode, phase
                    rows[used, 3], rows[used, 4] = before, state.impulse[z]
                    latest[j] = used
                    used += 1
        for i in range(x, z + 1):
            state.v[i] = value_at(series.v, i, degree, h)
        speed = math.hypot(state.v[x], state.v[y])
        if speed > 10.0 * SLIP_SPEED:
            state.fresh[j] = 0
        if speed > MOVED and state.tangent[j] != FREE:
            state.tangent[j] = SLIPPING
        if state.normal[j] == HELD and abs(state.v[z]) > MOVED:
            if state.v[z] < 0.0:
                state.normal[j] = LOADING
            else:
                _open(state, j)
        if state.normal[j] == HELD:
            state.last[j] = value_at(series.force, z, degree, h)
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            state.ringing[j] = min(state.ringing[j], max(cap - state.last[j], 0.0) / system.exponent)
        state.indentation[j] = value_at(series.indentation, j, degree, h)
        if state.normal[j] == LOADING:
            state.deepest[j] = state.indentation[j]
    return used


@inlined
def _apply(system, state, series, roots, first, tie):
    """Change the modes of contacts whose time has come."""
    now = first + tie
    before = state.tangent.copy()
    at_bound = False
    for j in range(len(system.friction)):
        at_bound = at_bound or (before[j] == STUCK and roots[j, 2] <= now)
    for j in range(len(system.friction)):
        z = 3 * j + 2
        state.fresh[j] = 0 if state.fresh[j] == AT_BOUND else state.fresh[j]
        normal, held, tangent = roots[j, 0] <= now, roots[j, 1] <= now, roots[j, 2] <= now
        mode = state.normal[j]
        if mode in (LOADING, RISING, SINKING):  # at zero with what has come there, but for rounding
            normal = normal or abs(state.v[z]) <= TINY < abs(series.v[0, z])
        if tangent and before[j] == SLIPPING:
            _stick(state, j)
            for other in range(len(system.friction)):  # a body that comes to rest does so at all its contacts
                speed = math.hypot(state.v[3 * other], state.v[3 * other + 1])
                if state.tangent[other] == SLIPPING and state.fresh[other] == 0 and speed <= MOVED:
                    _stick(state, other)
        elif at_bound and before[j] == STUCK:  # with all that are as good as there
            fx, fy = value_at(series.force, z - 2, ORDER, first), value_at(series.force, z - 1, ORDER, first)
            length = math.hypot(fx, fy)
            bound = system.friction[j] * value_at(series.force, z, ORDER, first)
            if length > 0.0 and (tangent or length >= (1.0 - NEAR_BOUND) * bound):
                state.direction[2 * j], state.direction[2 * j + 1] = -fx / length, -fy / length
                state.fresh[j] = AT_BOUND
        if not (normal or held):
            continue
        if mode == OPEN:
            _close(system, state, j)
        elif mode == LOADING or (mode == SINKING and normal):
            state.v[z] = 0.0
            if state.indentation[j] <= TINY:
                _open(state, j)
            else:
                state.normal[j] = HELD if system.unloading[j] == 0.0 else RISING
                state.last[j] = system.stiffness[j] * state.indentation[j] ** system.exponent
                state.ringing[j] = 0.0
        elif mode == SINKING:
            state.normal[j] = LOADING
            state.indentation[j] = state.deepest[j]
        elif mode == RISING and held:
            _open(state, j)
        elif mode == RISING:
            state.v[z] = 0.0
            state.normal[j] = SINKING
        elif held:
            state.normal[j] = LOADING
        elif state.ringing[j] <= TIE:
            _open(state, j)
        elif state.last[j] <= state.ringing[j] + TIE:
            _close(system, state, j)


@inlined
def _record(path, points, clock, state):
    """Append a point to the path, if there is room."""
    if points < path.shape[0]:
        path[points, 0] = clock
        for i in range(len(state.v)):
            path[points, 1 + i] = state.v[i]
            path[points, 1 + len(state.v) + i] = state.impulse[i]
        return points + 1
    return points


@inlined
def _record_step(path, points, clock, series, state, h, degree, pace, root):
    """Append the points of a step to the path, its end the last of them."""
    m = len(state.v)
    for part in range(1, POINTS):
        if points < path.shape[0]:
            s = h * part / POINTS
            path[points, 0] = clock + _time_power(NONE_YET, s, pace, root)
            for i in range(m):
                path[points, 1 + i] = value_at(series.v, i, degree, s)
                rest = 0.0
                for k in range(degree + 1):
                    rest += series.force[k, i] * (
                        _time_power(k, h, pace, root) - _time_power(k, s, pace, root)
                    )
                path[points, 1 + m + i] = state.impulse[i] - rest
            points += 1
    return _record(path, points, clock + _time_power(NONE_YET, h, pace, root), state)
