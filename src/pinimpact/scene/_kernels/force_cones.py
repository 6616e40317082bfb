"""Forces that obey Coulomb's law at the level of accelerations, where sweeps take too long. (theory.md, 11)

With a dual cone in place of the law, f minimises ½ fᵀWf + fᵀ(a⁰ + s) in its cone, s_i = μ|a_it| along n for a
contact at rest: a convex program for given s, repeated with the s that it gives. (Acary, Cadoux, Lemaréchal,
Malick, A formulation of the linear discrete Coulomb friction problem via convex optimization, 2011.) Friction
of contacts that slip is carried over from one program to the next. From what is open, sticks and slips then
Newton's method goes to rounding. It is also tried first, from what the sweeps have left (which go away from
solutions of a negative determinant) and from each choice of which slipping contacts close, and last from what
Lemke's pivots find, see `force_pivots`.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.ahead import FLOATS, ahead
from ..._compile.jit import separate
from ..._numeric.cone_program import CONE, cone_program
from ..._numeric.coulomb_problem import (
    ACCURATE,
    CLOSED,
    SYSTEM,
    USABLE,
    newton,
    polish,
    residual,
    scale,
)
from ..._numeric.loops import assign, flags, repeated
from .force_pivots import forces_by_pivots

OUTER = 60
"""Convex programs that are solved at most."""

MOST_CHOSEN = 8
"""Contacts that slip of which all choices are tried."""

PATIENCE = 4
"""Programs without half the residual after which it does that."""

STEADY = 0.9
"""Cosine of two changes of s from which on they go the same way: past where a solution has just ceased to
exist they are small and many, so each is taken twice as far as the one before. One that turns back is taken
as far as a change that is linear in s would vanish, for s then lies between the last two."""

LONGEST = 1e12

GAP = 1e-20
"""Gap to which programs are solved: what is about to slip has an acceleration of 10⁻⁸ beside those of others,
and its force is to be at its bound to 10⁻¹² nevertheless."""

FEWEST_SIDES, MOST_SIDES = np.int64(8), np.int64(64)
"""Sides of the polygons in place of cones, where pivots are tried."""


@ahead(*SYSTEM, FLOATS, FLOATS)
@separate
def forces_by_modes(delassus, free, velocity, mu, least, held, lower, upper, x, scale_a, scale_f):
    """Fill x with forces by Newton's method from each choice of which contacts that slip are closed.

    Choices with fewer closed ones come first: of several solutions, the contact that opens. Returns the
    residual.
    """
    nc, size = len(mu), len(x)
    slips = np.empty(nc, dtype=np.int64)
    count = 0
    closed, a_now = repeated(nc, CLOSED), np.empty(size)
    for i in range(nc):
        if not held[i] and (velocity[i, 0] != 0.0 or velocity[i, 1] != 0.0):
            slips[count] = i
            count += 1
    worst = math.inf
    if count > MOST_CHOSEN:
        return worst
    for total in range(count + 1):
        for choice in range(1 << count):
            chosen = 0
            for c in range(count):
                closed[slips[c]] = (choice >> c) & 1
                chosen += closed[slips[c]]
            if chosen != total:
                continue
            for a in range(size):
                x[a] = 0.0
            residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
            worst = polish(
                delassus,
                free,
                velocity,
                mu,
                least,
                held,
                lower,
                upper,
                x,
                a_now,
                scale_a,
                scale_f,
                math.inf,
                closed,
            )
            if worst <= 1e-12:
                return worst
    return worst


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS)
@separate
def forces_at_bounds(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f):
    """Take one scalar force at a time to a bound, and go on from there; keep x where nothing comes of it.

    Where a solution has just ceased to exist, another is often a joint's yielding away. Returns the residual.
    """
    start, nc = x.copy(), len(mu)
    for i in range(len(lower)):
        for bound in (lower[i], upper[i]):
            if abs(bound) == math.inf or bound == start[3 * nc + i]:
                continue
            assign(x, start)
            x[3 * nc + i] = bound
            worst = newton(
                delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f
            )
            if worst <= USABLE:
                return worst
    assign(x, start)
    return residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS, FLOATS)
@separate
def forces_on_path(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, d, scale_a, scale_f):
    """Fill x with forces from Lemke's pivots and Newton's method; return the residual."""
    ns, size = len(lower), len(x)
    w, f0, f = np.empty((size, size)), np.empty(size), np.empty(size)
    low, high = np.empty(ns), np.empty(ns)
    for a in range(size):
        f0[a] = scale_a[a] * free[a]
        for b in range(size):
            w[a, b] = d[a] * delassus[a, b] * d[b]
    for i in range(ns):
        low[i], high[i] = lower[i] / scale_f[size - ns + i], upper[i] / scale_f[size - ns + i]
    best, best_x = math.inf, x.copy()
    sides = FEWEST_SIDES
    while best > USABLE and sides <= MOST_SIDES:
        if not forces_by_pivots(w, f0, velocity, mu, held, low, high, sides, f):
            break
        for a in range(size):
            x[a] = f[a] * scale_f[a]
        before = math.inf
        worst = newton(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
        while worst < 0.5 * before and worst > ACCURATE:  # slow where hardly anything begins to slip
            before = worst
            worst = newton(
                delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f
            )
        if worst < best:
            best = worst
            assign(best_x, x)
        sides *= 2
    assign(x, best_x)
    return best


@ahead(*SYSTEM)
@separate
def forces_by_cones(delassus, free, velocity, mu, least, held, lower, upper, x):
    """Fill x with forces: near those that it has, or from convex programs. (see above)

    Returns the residual.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    d, scale_a, scale_f = np.empty(size), np.empty(size), np.empty(size)
    if scale(delassus, free, nc, d, scale_a, scale_f) == 0.0:
        for a in range(size):
            x[a] = 0.0
        return 0.0
    a_now = np.empty(size)
    if newton(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f) <= 1e-12:
        return 0.0
    if forces_by_modes(delassus, free, velocity, mu, least, held, lower, upper, x, scale_a, scale_f) <= 1e-12:
        return 0.0
    w = np.empty((size, size))
    f0 = np.empty(size)
    for a in range(size):
        f0[a] = scale_a[a] * free[a]
        for b in range(size):
            w[a, b] = d[a] * delassus[a, b] * d[b]
    # variables: three of a contact at rest with friction or held, one of others, one of a scalar row
    which = np.empty(size, dtype=np.int64)
    n = lines = cones = 0
    at_rest = flags(nc, False)
    for i in range(nc):
        at_rest[i] = (mu[i] > 0.0 and velocity[i, 0] == 0.0 and velocity[i, 1] == 0.0) or held[i]
        if at_rest[i]:
            which[n], which[n + 1] = 3 * i, 3 * i + 1
            n += 2
            cones += not held[i]
        else:
            lines += 1
        which[n] = 3 * i + 2
        n += 1
    for i in range(ns):
        which[n] = 3 * nc + i
        n += 1
        lines += int(lower[i] > -math.inf) + int(upper[i] < math.inf)
    P, c, y = np.empty((n, n)), np.empty(n), np.zeros(n)
    for a in range(n):
        for b in range(n):
            P[a, b] = w[which[a], which[b]]
    m = lines + 3 * cones
    G, h, s, z = np.zeros((m, n)), np.zeros(m), np.empty(m), np.empty(m)
    sizes = repeated(cones, CONE)
    line, cone = 0, lines
    for a in range(n):
        row = which[a]
        if row < 3 * nc:
            i = row // 3
            if row % 3 == 2 and not at_rest[i]:
                G[line, a] = -1.0
                line += 1
            elif row % 3 == 2 and not held[i]:
                G[cone, a] = -mu[i]
                G[cone + 1, a - 2] = -1.0
                G[cone + 2, a - 1] = -1.0
                cone += 3
        else:
            i = row - 3 * nc
            if lower[i] > -math.inf:
                G[line, a], h[line] = -1.0, -lower[i] / scale_f[row]
                line += 1
            if upper[i] < math.inf:
                G[line, a], h[line] = 1.0, upper[i] / scale_f[row]
                line += 1
    f = np.zeros(size)
    corrected = np.zeros(size)  # what is added to the free accelerations
    lifts, changes, reach = np.zeros(nc), np.zeros(nc), 1.0  # s, its last changes, and a factor on them
    worst = math.inf
    best, best_x, since = math.inf, np.empty(size), 0
    for outer in range(OUTER):
        for k in range(n):
            c[k] = f0[which[k]] + corrected[which[k]]
        cone_program(P, c, G, h, lines, sizes, GAP, y, s, z)
        for a in range(size):
            f[a] = 0.0
        for k in range(n):
            f[which[k]] = y[k]
        for i in range(nc):
            if not at_rest[i] and mu[i] > 0.0:
                speed = math.hypot(velocity[i, 0], velocity[i, 1])
                f[3 * i] = -mu[i] * f[3 * i + 2] * velocity[i, 0] / speed
                f[3 * i + 1] = -mu[i] * f[3 * i + 2] * velocity[i, 1] / speed
        for a in range(size):
            x[a] = f[a] * scale_f[a]
        worst = residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
        if worst <= 1e-12:
            return worst
        if worst <= 1e-3 or outer == OUTER - 1:
            worst = newton(
                delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f
            )
            since += 1
            if worst < best:
                since = 0 if worst < 0.5 * best else since
                best = worst
                assign(best_x, x)
            if best <= ACCURATE or (best <= USABLE and since >= PATIENCE):
                assign(x, best_x)
                return best
            # go on from the convex program's own answer
            for a in range(size):
                x[a] = f[a] * scale_f[a]
            worst = residual(
                delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f
            )
        along = new = old = 0.0
        for i in range(nc):
            if at_rest[i] and not held[i]:
                b = 3 * i
                lift = mu[i] * math.hypot(a_now[b] * scale_a[b], a_now[b + 1] * scale_a[b + 1])
                change = lift - lifts[i]
                along += change * changes[i]
                new, old = new + change**2, old + changes[i] ** 2
                changes[i] = change
        if along < 0.0:
            reach *= (old - along) / (new - 2.0 * along + old)
        else:
            reach = min(2.0 * reach, LONGEST if along > STEADY * math.sqrt(new * old) else 1.0)
        last = corrected.copy()
        gone = 0.0
        for a in range(size):
            corrected[a] = 0.0
        for i in range(nc):
            b = 3 * i
            if at_rest[i]:
                lift = max(0.0, lifts[i] + reach * changes[i])
                gone += (lift - lifts[i]) * changes[i]
                lifts[i] = lift
                corrected[b + 2] += lift
            else:
                for a in range(size):
                    corrected[a] += w[a, b] * f[b] + w[a, b + 1] * f[b + 1]
        if new > 0.0:
            reach = gone / new
        moved = 0.0
        for a in range(size):
            moved = max(moved, abs(corrected[a] - last[a]))
        if moved == 0.0:  # the same program again
            break
    if best > USABLE:
        worst = forces_on_path(
            delassus, free, velocity, mu, least, held, lower, upper, x, a_now, d, scale_a, scale_f
        )
    if best < worst:
        worst = best
        assign(x, best_x)
    if worst > USABLE:
        worst = forces_at_bounds(
            delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f
        )
    return worst
