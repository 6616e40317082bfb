"""How the velocity changes where modes are set: sticking contacts stop; friction opposes what starts."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import assign, filled
from ..._numeric.products import apply, dot
from .active_set import stop_along
from .slip import fastest_of
from .tolerances import ROUNDING


@declared(
    FLOAT_ROWS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLAGS, int, float, float, float, FLOATS, INTEGERS, FLOATS
)
@external
def come_to_rest(minverse, rows, start, rests, against, moves, first, error, least, most, metres, on, v):
    """Change the velocity as little as possible so that sticking contacts and held joints stop. (11.9)

    Args:
        minverse: (nv, nv) M⁻¹.
        rows: (m, nv) rows of velocities, in metres also those of joints.
        start: (m,) these velocities [m/s].
        rests: (m,) which of them vanish; those that would begin against their friction are added.
        against: (m,) the sign of a velocity against its force where slip or sliding begins, else zero.
        moves: (m,) which of the stopping rows belong to slip that has not ended, both tangential ones of a
            contact.
        first: The row from which on they are those of joints.
        error: How much of any velocity it may take to stop a joint that hardly moves [m/s].
        least: The speed up to which slip does not turn back [m/s].
        most: The speed up to which a joint may be held [m/s]; a faster one has been accelerated by impulses.
        metres: (nv,) per unit of each velocity, see `joint_metres`.
        on: (m,) takes the sign of the velocity of a joint that is not to stop, one for rows of such contacts.
        v: (nv,) the velocity, which is changed.

    Returns:
        The kinetic energy gained, and the fastest speed that was taken away.
    """
    n, size = len(v), len(rows)
    before, way, speeds = v.copy(), np.empty(n), np.empty(size)
    resting, energy, fastest, again = rests, 0.0, 0.0, True
    rounding = ROUNDING * fastest_of(metres, v)
    while again:
        assign(v, before)
        resting, asked = rests.copy(), rests.copy()
        energy, fastest = stop_chosen(minverse, rows, resting, start, before, 0.0, v)
        if first < size:
            # a joint whose row hardly differs from those of contacts rests but for its error
            energy += stop_chosen(minverse, rows[:first], resting, start, before, least, v)[0]
        filled(on, 0)
        while True:
            slowest, a = math.inf, -1
            for b in range(first, size):
                speed = against[b] * velocity_of(rows, start, before, v, b)
                if speed > rounding and not asked[b] and speed < slowest:
                    slowest, a = speed, b
            if a < 0:
                break
            asked[a], sign = True, 1 if against[a] > 0.0 else -1
            if slowest > most:
                released(minverse, rows, start, rests, moves, first, before, a, sign, on)
                continue
            apply(minverse, rows[a], way)
            apply(rows, way, speeds)
            stop_chosen(minverse, rows, resting, speeds, way.copy(), 0.0, way)
            rate = dot(rows[a], way)
            much = fastest_of(metres, way) * slowest > error * rate
            if not rate > 0.0 or (slowest <= error and much):
                accelerated = slowest > 2.0 * against[a] * start[a]
                if not (
                    accelerated and released(minverse, rows, start, rests, moves, first, before, a, sign, on)
                ):
                    on[a] = sign
                continue
            for j in range(n):
                v[j] -= way[j] * against[a] * slowest / rate
            resting[a] = True
            energy, fastest = energy - 0.5 * slowest**2 / rate, max(fastest, slowest)
        again = False
        for a in range(first):
            back = against[a] * velocity_of(rows, start, before, v, a)
            if back > least and not rests[a]:
                rests[a] = again = True
    for a in range(size):
        speed = against[a] * velocity_of(rows, start, before, v, a)
        rests[a] = resting[a] or (a >= first and 0.0 < speed <= rounding)
    return energy, fastest


@inlined
def released(minverse, rows, start, rests, moves, first, before, a, sign, on):
    """Keep contacts sliding whose sticking would accelerate a joint, row a, against its force.

    They are those without whose sticking, of one or else of all, the joint has less than half of that
    velocity. Return whether there are such.
    """
    size, u, found = len(rows), before.copy(), False
    stop_chosen(minverse, rows, rests, start, before, 0.0, u)
    half = 0.5 * sign * velocity_of(rows, start, before, u, a)
    for b in range(size + 1):
        others, some = rests.copy(), False
        for c in range(size):
            of = c - c % 3 if c < first else c
            if (of == b or b == size) and moves[c] and start[c] != 0.0:
                others[c], some = False, True
        if not some or (b == size and found):
            continue
        assign(u, before)
        stop_chosen(minverse, rows, others, start, before, 0.0, u)
        if sign * velocity_of(rows, start, before, u, a) < half:
            found = True
            for c in range(size):
                if rests[c] and not others[c]:
                    on[c] = 1 if c < first or start[c] > 0.0 else -1
    return found


@inlined
def velocity_of(rows, start, before, v, a):
    """Return the velocity of row a at v, from what it was `before`."""
    velocity = start[a]
    for j in range(len(v)):
        velocity += rows[a, j] * (v[j] - before[j])
    return velocity


@declared(FLOAT_ROWS, FLOAT_ROWS, FLAGS, FLOATS, FLOATS, float, FLOATS)
@external
def stop_chosen(minverse, rows, stopped, start, before, least, v):
    """Stop rows that are `stopped`, if any of them is faster than the least speed that matters.

    Rows (k, nv) are the first of m, whose velocities were `start` (m,) at the velocity `before` (nv,). Other
    arguments and results as of `come_to_rest`.
    """
    taken, speeds = np.empty(rows.shape), np.empty(len(rows))
    fastest, total = 0.0, 0
    for a in range(len(rows)):
        if stopped[a]:
            speed = velocity_of(rows, start, before, v, a)
            assign(taken[total], rows[a])
            speeds[total], fastest = speed, max(fastest, abs(speed))
            total += 1
    if fastest < least:
        return 0.0, 0.0
    return stop_along(taken[:total], speeds[:total], minverse, v), fastest
