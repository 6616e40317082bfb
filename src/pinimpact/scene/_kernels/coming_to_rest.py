"""The change of velocity (11.9) when modes are chosen: rows at rest stop, friction opposes incipient slip."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import assign, filled
from ..._numeric.products import apply, apply_symmetric, dot
from .active_set import stop_along
from .slip import fastest_of
from .tolerances import ROUNDING


@declared(
    FLOAT_ROWS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLAGS, int, float, float, float, FLOATS, INTEGERS, FLOATS
)
@external
def come_to_rest(
    minverse, rows, start, rests, against, moves, first, error, least, most, metres, keep_sliding, v
):
    """Stop sticking contacts and held joints by the least change of velocity in the metric of M. (11.9)

    Args:
        minverse: (nv, nv) M⁻¹.
        rows: (m, nv) rows of velocities: contacts, then joints scaled to metres.
        start: (m,) velocities of the rows [m/s].
        rests: (m,) which rows stop; rows that would start to move against their friction are added.
        against: (m,) for incipient slip and sliding the sign of a velocity against the friction, else zero.
        moves: (m,) which of the stopping rows were sliding until now, both tangential rows of a contact.
        first: The first row of joints.
        error: Largest change of a velocity, 10 η, allowed to stop a joint slower than it (11.11) [m/s].
        least: Speed of reversed slip that is attributed to errors [m/s].
        most: Speed up to which a joint may be held [m/s]; a faster one has been accelerated by impulses.
        metres: (nv,) κ of (10.6).
        keep_sliding: (m,) is overwritten with 1 for the rows of contacts that must keep sliding, and with the
            sign of the velocity for such joints; else 0.
        v: (nv,) the velocity; changed.

    Returns:
        The kinetic energy gained [J], and the largest speed removed [m/s].
    """
    n, size = len(v), len(rows)
    before, direction, speeds = v.copy(), np.empty(n), np.empty(size)
    resting, energy, fastest, again = rests, 0.0, 0.0, True
    rounding = ROUNDING * fastest_of(metres, v)
    while again:
        assign(v, before)
        resting, tested = rests.copy(), rests.copy()
        energy, fastest = stop_chosen(minverse, rows, resting, start, before, 0.0, v)
        if first < size:
            # stopping a joint whose row almost depends on contact rows leaves an error in these: stop again
            energy += stop_chosen(minverse, rows[:first], resting, start, before, least, v)[0]
        filled(keep_sliding, 0)
        while True:
            slowest, a = math.inf, -1
            for b in range(first, size):
                speed = against[b] * velocity_of(rows, start, before, v, b)
                if speed > rounding and not tested[b] and speed < slowest:
                    slowest, a = speed, b
            if a < 0:
                break
            tested[a], sign = True, 1 if against[a] > 0.0 else -1
            if slowest > most:
                mark_causes(minverse, rows, start, rests, moves, first, before, a, sign, keep_sliding)
                continue
            apply_symmetric(minverse, rows[a], direction)
            apply(rows, direction, speeds)
            stop_chosen(minverse, rows, resting, speeds, direction.copy(), 0.0, direction)
            rate = dot(rows[a], direction)
            much = fastest_of(metres, direction) * slowest > error * rate
            if not rate > 0.0 or (slowest <= error and much):
                accelerated = slowest > 2.0 * against[a] * start[a]
                if not (
                    accelerated
                    and mark_causes(minverse, rows, start, rests, moves, first, before, a, sign, keep_sliding)
                ):
                    keep_sliding[a] = sign
                continue
            for j in range(n):
                v[j] -= direction[j] * against[a] * slowest / rate
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
def mark_causes(minverse, rows, start, rests, moves, first, before, a, sign, keep_sliding):
    """Mark the contacts and joints whose stop makes a joint, row a, move against its force; return if any.

    They are those without whose stop, of one or else of all, the joint has less than half of that velocity.
    They must keep sliding: their rows of `keep_sliding` are set. Other arguments as in `come_to_rest`.
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
                    keep_sliding[c] = 1 if c < first or start[c] > 0.0 else -1
    return found


@inlined
def velocity_of(rows, start, before, v, a):
    """Return the velocity of row a at v (nv,), given start (m,) at the velocity `before` (nv,)."""
    velocity = start[a]
    for j in range(len(v)):
        velocity += rows[a, j] * (v[j] - before[j])
    return velocity


@declared(FLOAT_ROWS, FLOAT_ROWS, FLAGS, FLOATS, FLOATS, float, FLOATS)
@external
def stop_chosen(minverse, rows, stopped, start, before, least, v):
    """Stop the rows marked by `stopped` if any of them is at least as fast as `least` [m/s].

    `rows` (k, nv) are the first of m rows. Other arguments and results are those of `come_to_rest` and
    `velocity_of`.
    """
    chosen, speeds = np.empty(rows.shape), np.empty(len(rows))
    fastest, total = 0.0, 0
    for a in range(len(rows)):
        if stopped[a]:
            speed = velocity_of(rows, start, before, v, a)
            assign(chosen[total], rows[a])
            speeds[total], fastest = speed, max(fastest, abs(speed))
            total += 1
    if fastest < least:
        return 0.0, 0.0
    return stop_along(chosen[:total], speeds[:total], minverse, v), fastest
