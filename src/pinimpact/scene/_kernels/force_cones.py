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

from ..._compile.ahead import FLAGS, FLOAT_ROWS, FLOATS, INTEGERS, ahead
from ..._compile.jit import separate
from ..._numeric.cone_program import CONE, cone_program
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, flags, repeated
from ..._numeric.products import apply
from .force_pivots import forces_by_pivots

SYSTEM = (FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLOATS, FLOATS)
"""Types: W, accelerations, velocities of slip, friction, held, bounds, and the forces."""

OUTER = 60
"""Convex programs that are solved at most."""

POLISH = 8
"""Steps of Newton's method after one."""

MOST_CHOSEN = 8
"""Contacts that slip of which all choices are tried."""

ACCURATE, USABLE = 1e-11, 1e-10
"""Residuals of forces: one at which to stop, and one that will do where it falls no more."""

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

CLOSED, AS_FORCES_SAY = np.int64(1), np.int64(-1)
"""What `polish` is told of a contact in its first iteration."""


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS)
@separate
def residual(delassus, free, velocity, mu, held, lower, upper, x, accelerations, scale_a, scale_f):
    """Return how far forces are from Coulomb's law, in parts of the scales: complementarity row by row."""
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    apply(delassus, x, accelerations)
    worst = 0.0
    for a in range(size):
        accelerations[a] += free[a]
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], accelerations[b + 2] * scale_a[b]
        f1, f2 = x[b] / scale_f[b], x[b + 1] / scale_f[b]
        a1, a2 = accelerations[b] * scale_a[b], accelerations[b + 1] * scale_a[b]
        if held[i]:
            worst = max(worst, abs(an), abs(a1), abs(a2))
            continue
        worst = max(worst, abs(fn - max(0.0, fn - an)))
        if mu[i] == 0.0:
            continue
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        if speed > 0.0:
            worst = max(
                worst,
                abs(f1 + mu[i] * fn * velocity[i, 0] / speed),
                abs(f2 + mu[i] * fn * velocity[i, 1] / speed),
            )
            continue
        g1, g2 = f1 - a1, f2 - a2  # the projection of f − a onto the disc is f
        limit, length = mu[i] * max(fn, 0.0), math.hypot(g1, g2)
        if length > limit:
            g1, g2 = g1 * limit / length, g2 * limit / length
        worst = max(worst, abs(f1 - g1), abs(f2 - g2))
    for i in range(ns):
        b = 3 * nc + i
        f, rate = x[b] / scale_f[b], accelerations[b] * scale_a[b]
        worst = max(worst, abs(f - min(max(f - rate, lower[i] / scale_f[b]), upper[i] / scale_f[b])))
    return worst


@ahead(*SYSTEM, FLOATS, FLOATS)
@separate
def forces_by_modes(delassus, free, velocity, mu, held, lower, upper, x, scale_a, scale_f):
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
            residual(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
            worst = polish(
                delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f, math.inf, closed
            )
            if worst <= 1e-12:
                return worst
    return worst


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS)
@separate
def newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f):
    """Take forces x to rounding by Newton's method on what they say is active; return the residual."""
    worst = residual(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
    if not 0.0 < worst < math.inf:
        return worst
    undecided = repeated(len(mu), AS_FORCES_SAY)
    return polish(
        delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f, worst, undecided
    )


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS)
@separate
def forces_at_bounds(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f):
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
            worst = newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
            if worst <= USABLE:
                return worst
    assign(x, start)
    return residual(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)


@ahead(FLOAT_ROWS, FLOATS, int, FLOATS, FLOATS, FLOATS, result=float)
@separate
def scale(delassus, free, contacts, d, scale_a, scale_f):
    """Fill scales, contact by contact so that cones keep their shape; return their unit, zero if none.

    Args:
        delassus, free: Of the rows (m,), three for each contact first.
        contacts: How many.
        d: (m,) takes what makes the diagonal one.
        scale_a: (m,) takes factors of accelerations.
        scale_f: (m,) takes units of forces.
    """
    size = len(free)
    largest = unit = 0.0
    for a in range(size):
        largest = max(largest, delassus[a, a])
    for i in range(contacts):
        softest = max(delassus[3 * i, 3 * i], delassus[3 * i + 1, 3 * i + 1])
        softest = max(softest, delassus[3 * i + 2, 3 * i + 2])
        for a in range(3 * i, 3 * i + 3):
            d[a] = 1.0 / math.sqrt(max(softest, 1e-14 * largest))
    for a in range(3 * contacts, size):
        d[a] = 1.0 / math.sqrt(max(delassus[a, a], 1e-14 * largest))
    for a in range(size):
        unit = max(unit, abs(d[a] * free[a]))
    if unit > 0.0:
        for a in range(size):
            scale_a[a], scale_f[a] = d[a] / unit, d[a] * unit
    return unit


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS, FLOATS)
@separate
def forces_on_path(delassus, free, velocity, mu, held, lower, upper, x, a_now, d, scale_a, scale_f):
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
        worst = newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
        while worst < 0.5 * before and worst > ACCURATE:  # slow where hardly anything begins to slip
            before = worst
            worst = newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
        if worst < best:
            best = worst
            assign(best_x, x)
        sides *= 2
    assign(x, best_x)
    return best


@ahead(*SYSTEM)
@separate
def forces_by_cones(delassus, free, velocity, mu, held, lower, upper, x):
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
    if newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f) <= 1e-12:
        return 0.0
    if forces_by_modes(delassus, free, velocity, mu, held, lower, upper, x, scale_a, scale_f) <= 1e-12:
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
        worst = residual(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
        if worst <= 1e-12:
            return worst
        if worst <= 1e-3 or outer == OUTER - 1:
            worst = newton(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
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
            worst = residual(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
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
            delassus, free, velocity, mu, held, lower, upper, x, a_now, d, scale_a, scale_f
        )
    if best < worst:
        worst = best
        assign(x, best_x)
    if worst > USABLE:
        worst = forces_at_bounds(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f)
    return worst


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS, INTEGERS, FLOAT_ROWS, FLOATS)
@separate
def linearize(
    delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f, closed, system, right
):
    """Fill the equations of a step of Newton's method from forces x, whose accelerations are `a_now`.

    Contacts are closed (1; those at rest stick) or open (0) as `closed` has it; −1 leaves that to the forces.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    for a in range(size):
        for b in range(size):
            system[a, b] = 0.0
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], a_now[b + 2] * scale_a[b]
        given = closed[i] >= 0
        opens = closed[i] == 0 if given else fn - an <= 0.0
        if not held[i] and opens:
            for r in range(b, b + 3):
                system[r, r], right[r] = 1.0, -x[r] / scale_f[r]
            continue
        for k in range(size):
            system[b + 2, k] = scale_a[b] * delassus[b + 2, k] * scale_f[k]
        right[b + 2] = -an
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        f1, f2 = x[b] / scale_f[b], x[b + 1] / scale_f[b]
        if not held[i] and (speed > 0.0 or mu[i] == 0.0):
            s1 = velocity[i, 0] / speed if speed > 0.0 else 0.0
            s2 = velocity[i, 1] / speed if speed > 0.0 else 0.0
            system[b, b], system[b, b + 2], right[b] = 1.0, mu[i] * s1, -f1 - mu[i] * fn * s1
            system[b + 1, b + 1], system[b + 1, b + 2], right[b + 1] = (
                1.0,
                mu[i] * s2,
                -f2 - mu[i] * fn * s2,
            )
            continue
        a1, a2 = a_now[b] * scale_a[b], a_now[b + 1] * scale_a[b]
        g1, g2 = f1 - a1, f2 - a2
        if held[i] or given or math.hypot(g1, g2) <= mu[i] * fn:  # sticks
            for k in range(size):
                system[b, k] = scale_a[b] * delassus[b, k] * scale_f[k]
                system[b + 1, k] = scale_a[b] * delassus[b + 1, k] * scale_f[k]
            right[b], right[b + 1] = -a1, -a2
        else:  # begins to slip: f_t = μ f_n g/|g|, g = f_t − a_t
            length = math.hypot(g1, g2)
            u1, u2 = g1 / length, g2 / length
            share = mu[i] * fn / length
            right[b], right[b + 1] = -f1 + mu[i] * fn * u1, -f2 + mu[i] * fn * u2
            for k in range(size):
                h1 = -scale_a[b] * delassus[b, k] * scale_f[k] + (1.0 if k == b else 0.0)
                h2 = -scale_a[b] * delassus[b + 1, k] * scale_f[k] + (1.0 if k == b + 1 else 0.0)
                across = u1 * h2 - u2 * h1
                system[b, k] = (1.0 if k == b else 0.0) + share * u2 * across
                system[b + 1, k] = (1.0 if k == b + 1 else 0.0) - share * u1 * across
            system[b, b + 2] -= mu[i] * u1
            system[b + 1, b + 2] -= mu[i] * u2
    for i in range(ns):
        b = 3 * nc + i
        f, rate = x[b] / scale_f[b], a_now[b] * scale_a[b]
        low, high = lower[i] / scale_f[b], upper[i] / scale_f[b]
        if f - rate <= low:
            system[b, b], right[b] = 1.0, low - f
        elif f - rate >= high:
            system[b, b], right[b] = 1.0, high - f
        else:
            for k in range(size):
                system[b, k] = scale_a[b] * delassus[b, k] * scale_f[k]
            right[b] = -rate


@ahead(*SYSTEM, FLOATS, FLOATS, FLOATS, float, INTEGERS)
@separate
def polish(delassus, free, velocity, mu, held, lower, upper, x, a_now, scale_a, scale_f, worst, closed):
    """Newton's method on the equations of what is open, sticks and slips now; keeps what it improves.

    In the first iteration contacts are closed (1; those at rest stick) or open (0) as `closed` has it; −1
    leaves that to the forces.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    system, right, step = np.empty((size, size)), np.empty(size), np.empty(size)
    trial = x.copy()
    best = worst
    no_basis, undecided = np.empty((0, size)), repeated(nc, AS_FORCES_SAY)
    chosen = closed
    for _ in range(POLISH):
        linearize(
            *(delassus, free, velocity, mu, held, lower, upper, trial, a_now, scale_a, scale_f),
            *(chosen, system, right),
        )
        chosen = undecided
        least_norm(system, right, 1e-11, step, no_basis)
        for a in range(size):
            trial[a] += step[a] * scale_f[a]
        now = residual(delassus, free, velocity, mu, held, lower, upper, trial, a_now, scale_a, scale_f)
        if now < best:
            best = now
            for a in range(size):
                x[a] = trial[a]
        if now <= 1e-14 or not now < 10.0 * best:
            break
    return best
