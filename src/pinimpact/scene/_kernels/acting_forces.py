"""Which forces act on what touches, by which its modes are chosen. (theory.md, 11)

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.coulomb_problem import (
    AS_FORCES_SAY,
    SYSTEM,
    USABLE,
    linearize,
    newton,
    residual,
    scale,
    solve_compliant,
    solve_coulomb,
)
from ..._numeric.elimination import RANK, solve
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, filled, nonzero, repeated
from .tolerances import NEGLIGIBLE

AT_REST, AS_BEFORE, NONE = range(3)
"""Forces from which the search begins: those at which what is pressed rests, those of before, and none."""


@declared(*SYSTEM, FLAGS, FLOATS, bool, result=bool)
@external
def find_forces(delassus, free, slip, mu, least, held, lower, upper, x, pressed, before, unique):
    """Find forces that obey Coulomb's law and last, if there are any; else the nearest to it. (11.4)

    Newton's method begins with what has been pressed at rest, so that it stays there where it can, then with
    the forces of before: near where they cease to exist these are a thousand times those of the loads.
    Last is the method of multipliers. The first forces that last are taken.

    Args:
        delassus, free, slip, mu, least, held, lower, upper: As of `solve_coulomb`.
        x: (3 nc + ns,) takes the forces.
        pressed: (nc + ns,) what has been pressed, or held, until now.
        before: (3 nc + ns,) forces of before.
        unique: Whether no others have the same effects; else the limit of small compliances comes first.

    Returns whether forces were found.
    """
    nc, size = len(mu), len(x)
    starts = (AT_REST, AT_REST, AS_BEFORE, NONE)  # first of the limit of small compliances
    width, scale_a, scale_f, a_now = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    filled(x, 0.0)
    if scale(delassus, free, nc, width, scale_a, scale_f) == 0.0:
        return True
    trial, found = np.empty(size), False
    for attempt in range(1 if unique else 0, len(starts)):
        soft, start = attempt < 1, starts[attempt]
        if start == AT_REST:
            at_rest(delassus, free, slip, mu, held, lower, upper, pressed, trial)
        elif start == AS_BEFORE:
            assign(trial, before)
        else:
            filled(trial, 0.0)
        if soft:
            off = solve_compliant(delassus, free, slip, mu, least, held, lower, upper, trial, np.ones(nc))
        elif start == NONE:
            off = solve_coulomb(delassus, free, slip, mu, least, held, lower, upper, trial)
        else:
            off = newton(delassus, free, slip, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f)
        if off > USABLE:
            if attempt == len(starts) - 1 and not found:
                assign(x, trial)
            continue
        lasts = orientation(
            delassus, free, slip, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f
        )
        if lasts > 0 or not found:
            assign(x, trial)
        found = True
        if lasts >= 0:
            break
    return found


@inlined
def at_rest(delassus, free, slip, mu, held, lower, upper, pressed, x):
    """Fill forces x (m,) at which what is pressed has no acceleration.

    Where a contact slides its friction changes with its normal force, against the slip.
    """
    nc, size = len(mu), len(x)
    moves, drag = np.zeros(size, dtype=np.int64), np.zeros((nc, 2))
    for k in range(nc):
        speed, slides = math.hypot(slip[k, 0], slip[k, 1]), mu[k] == 0.0
        if speed > 0.0 and not held[k]:
            slides = True
            drag[k, 0], drag[k, 1] = -mu[k] * slip[k, 0] / speed, -mu[k] * slip[k, 1] / speed
        moves[3 * k + 2] = pressed[k] or held[k]
        moves[3 * k] = moves[3 * k + 1] = held[k] or (pressed[k] and not slides)
    for m in range(len(lower)):  # dry joints rest, unless that is beyond their bounds
        moves[3 * nc + m] = pressed[nc + m] or -math.inf < lower[m] <= upper[m] < math.inf
    filled(x, 0.0)
    beyond = True
    while beyond:  # joints beyond their bounds are at them
        stop_rows(delassus, free, drag, nonzero(moves), x)
        beyond = False
        for m in range(len(lower)):
            a, within = 3 * nc + m, min(max(x[3 * nc + m], lower[m]), upper[m])
            if within != x[a]:
                x[a], moves[a], beyond = within, 0, True
    for k in range(nc):
        if moves[3 * k] == 0:
            x[3 * k], x[3 * k + 1] = drag[k, 0] * x[3 * k + 2], drag[k, 1] * x[3 * k + 2]


@inlined
def stop_rows(delassus, free, drag, rows, x):
    """Fill the forces x on some rows so that these have no acceleration, with the drag (nc, 2) of slip."""
    m, closed = len(rows), 3 * len(drag)
    system, right, solution = np.empty((m, m)), np.empty(m), np.empty(m)
    for c in range(m):
        x[rows[c]] = 0.0
    for c in range(m):
        right[c] = -free[rows[c]]
        for a in range(closed, len(x)):
            right[c] -= delassus[rows[c], a] * x[a]
        for d in range(m):
            b = rows[d]
            system[c, d] = delassus[rows[c], b]
            if b < closed and b % 3 == 2:
                for e in range(2):
                    system[c, d] += delassus[rows[c], b - 2 + e] * drag[b // 3, e]
    least_norm(system, right, RANK, solution, np.empty((0, m)))
    for c in range(m):
        x[rows[c]] = solution[c]


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS, result=int)
@external
def orientation(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f):
    """Return the sign of the determinant of the equations that forces x solve, zero where singular."""
    nc, size = len(mu), len(x)
    system, right, undecided = np.empty((size, size)), np.empty(size), repeated(nc, AS_FORCES_SAY)
    residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
    linearize(
        *(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f, undecided),
        *(system, right),
    )
    return solve(system, right, np.empty(size), RANK)


@inlined
def driven_in(delassus, free, slip, mu, held, x):
    """Return a contact that its slip drives in by itself, beside other forces x, or −1. (13.1)"""
    for k in range(len(mu)):
        b, speed = 3 * k, math.hypot(slip[k, 0], slip[k, 1])
        if held[k] or mu[k] == 0.0 or speed == 0.0:
            continue
        whole, acceleration = delassus[b + 2, b + 2], free[b + 2]
        across = (slip[k, 0] * delassus[b + 2, b] + slip[k, 1] * delassus[b + 2, b + 1]) / speed
        for a in range(len(x)):
            if not b <= a < b + 3:
                acceleration += delassus[b + 2, a] * x[a]
        if whole - mu[k] * across <= NEGLIGIBLE * whole and acceleration < 0.0:
            return k
    return -1
