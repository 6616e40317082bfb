"""Coulomb's law for contacts and bounded scalar rows: one problem, one solver. (theory.md, 11)

    u = u_free + W f,
    contacts:     0 ≤ f_3 − l ⟂ u_3 ≥ 0,  |f_t| ≤ μ f_3,  f_t = −μ f_3 u_t/|u_t| where u_t ≠ 0,
    scalar rows:  lower ≤ f ≤ upper,  u = 0 between them, u ≥ 0 at lower, u ≤ 0 at upper.

u are velocities and f impulses, or u accelerations and f forces. A contact that slides has its friction along
the direction of its slip, whatever u_t. Solutions are found as in time steps (`augmented_newton`), with a
root of W as the Jacobian; Newton's method on the open, sticking and sliding contacts converges to rounding.
"""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .augmented_newton import ATTEMPTS, LESS, VelocityProblem, augment, give_way
from .least_norm import least_norm
from .loops import assign, repeated
from .products import apply
from .semidefinite import factor
from .tolerances import EXACT, PIVOT, POLISHED, ROUNDING, SMALL, SOFTEST
from .tolerances import USABLE as USABLE  # for those who solve

SYSTEM = (FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLOATS, FLAGS, FLOATS, FLOATS, FLOATS)
"""Types: W, u_free, velocities of slip, friction, least normal forces, held, bounds, and the forces."""

POLISH = 8
"""Steps of Newton's method per trial."""

AS_FORCES_SAY = np.int64(-1)
"""Instead of a mode of a contact in `linearize`."""


@inlined
def order_rows(held, scalars, rows):
    """Fill the order of rows (m,) with contacts that have bounds first; return how many these are."""
    nc, bounded, at = len(held), 0, 0
    for first in (False, True):
        for i in range(nc):
            if held[i] == first:
                bounded += not first
                for e in range(3):
                    rows[at] = 3 * i + e
                    at += 1
    for i in range(scalars):
        rows[at] = 3 * nc + i
        at += 1
    return bounded


@inlined
def velocity_problem(delassus, free, velocity, mu, least, lower, upper, compliance, scales, rows, bounded):
    """Return the `VelocityProblem` of bodies of unit mass that has the same W, but for a diagonal of one.

    Contacts without bounds are scalar rows of it. Arguments are those of `solve_coulomb`, those filled by
    `scale`, and those of `order_rows`.
    """
    d, scale_a, scale_f = scales
    size, nc, others = len(free), len(mu), len(free) - 3 * bounded
    scaled, root, order = np.empty((size, size)), np.zeros((size, size)), np.empty(size, dtype=np.int64)
    for a in range(size):
        for b in range(size):
            scaled[a, b] = d[rows[a]] * delassus[rows[a], rows[b]] * d[rows[b]]
    rank = factor(scaled, order, root, ROUNDING)
    mass, columns, rates = np.zeros((rank, rank)), np.empty((size, rank), dtype=np.int64), np.empty(size)
    for k in range(rank):
        mass[k, k] = 1.0
        for a in range(size):
            columns[a, k] = k
    for a in range(size):
        rates[a] = scale_a[rows[a]] * free[rows[a]]
    friction, push, soft = np.empty(bounded), np.empty(bounded), np.empty(bounded)
    slip = np.zeros((bounded, 2))
    for k in range(bounded):
        i = rows[3 * k] // 3
        friction[k], push[k], soft[k] = mu[i], least[i] / scale_f[3 * i], compliance[i] * d[3 * i] ** 2
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        if speed > 0.0:
            slip[k, 0], slip[k, 1] = velocity[i, 0] / speed, velocity[i, 1] / speed
    low, high = np.empty(others), np.empty(others)
    for k in range(others):
        a = rows[3 * bounded + k]
        low[k], high[k] = -math.inf, math.inf
        if a >= 3 * nc:
            low[k], high[k] = lower[a - 3 * nc] / scale_f[a], upper[a - 3 * nc] / scale_f[a]
    given, counts = (rates, friction, push, slip, low, high, soft), repeated(size, rank)
    return VelocityProblem(mass, mass, root[:, :rank].copy(), columns, counts, *given)


@declared(*SYSTEM, FLOATS, result=float)
@external
def solve_coulomb(delassus, free, velocity, mu, least, held, lower, upper, x, compliance):
    """Fill x with forces that satisfy the law; of several with the limit of small compliances. (11.12)

    Args:
        delassus: (3 nc + ns, 3 nc + ns) W of nc contacts (t₁, t₂, n), then of ns scalar rows.
        free: (3 nc + ns,) u without forces.
        velocity: (nc, 2) of sliding contacts, whose friction is along it; zero for contacts that can stick.
        mu: (nc,) coefficients of friction.
        least: (nc,) l ≥ 0, least normal forces.
        held: (nc,) contacts without bounds.
        lower: (ns,) lower bounds of scalar forces, infinite for none.
        upper: (ns,) upper bounds of scalar forces, likewise.
        x: (3 nc + ns,) takes the forces.
        compliance: (nc,) of the contacts, up to a factor.

    Returns:
        The residual of the law, relative to u_free; more than `tolerances.USABLE` if no forces are found.
    """
    nc, size = len(mu), len(free)
    system = delassus, free, velocity, mu, least, held, lower, upper
    d, scale_a, scale_f, a_now = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    loads = np.empty(size)  # of the order of what is solved, also where nothing but `least` acts
    for a in range(size):
        loads[a] = abs(free[a])
        for i in range(nc):
            loads[a] += abs(delassus[a, 3 * i + 2]) * least[i]
    if scale(delassus, loads, nc, d, scale_a, scale_f) == 0.0:
        for a in range(size):
            x[a] = 0.0
        return 0.0
    rows = np.empty(size, dtype=np.int64)
    bounded = order_rows(held, len(lower), rows)
    problem = velocity_problem(
        *(delassus, free, velocity, mu, least, lower, upper, compliance),
        *((d, scale_a, scale_f), rows, bounded),
    )
    w, far, found, part = np.zeros(len(problem.mass)), np.empty(size), np.empty(size), 1.0
    while part > 2.0 * SMALL:
        give_way(problem, part, w, found)
        part *= LESS
    give_way(problem, 2.0 * SMALL, w, far)
    give_way(problem, SMALL, w, found)
    best, trial, part = math.inf, np.empty(size), SOFTEST
    for attempt in range(1 + ATTEMPTS):
        for a in range(size):
            trial[rows[a]] = (2.0 * found[a] - far[a]) * scale_f[rows[a]]
        now, before = residual(*system, trial, a_now, scale_a, scale_f), math.inf
        while EXACT < now < 0.5 * before:
            before = now
            now = newton(*system, trial, a_now, scale_a, scale_f)
        if now < best:
            best = now
            assign(x, trial)
        if best <= USABLE or attempt == ATTEMPTS:
            break
        augment(problem, part, 0.1 * USABLE, w.copy(), w, found)
        assign(far, found)
        part *= LESS
    return best


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS)
@external
def residual(delassus, free, velocity, mu, least, held, lower, upper, x, accelerations, scale_a, scale_f):
    """Return the residual of Coulomb's law, relative to the scales: complementarity row by row."""
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    apply(delassus, x, accelerations)
    worst = 0.0
    for a in range(size):
        accelerations[a] += free[a]
        if not abs(accelerations[a]) < math.inf:
            return math.inf
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], accelerations[b + 2] * scale_a[b]
        f1, f2 = x[b] / scale_f[b], x[b + 1] / scale_f[b]
        a1, a2 = accelerations[b] * scale_a[b], accelerations[b + 1] * scale_a[b]
        if held[i]:
            worst = max(worst, abs(an), abs(a1), abs(a2))
            continue
        worst = max(worst, abs(fn - max(least[i] / scale_f[b], fn - an)))
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


@declared(FLOAT_ROWS, FLOATS, int, FLOATS, FLOATS, FLOATS, result=float)
@external
def scale(delassus, free, contacts, d, scale_a, scale_f):
    """Fill scales, contact by contact so that cones keep their shape; return their unit, zero if none.

    Args:
        delassus: (m, m) of the rows, three for each contact first.
        free: (m,) accelerations without forces.
        contacts: Number of contacts.
        d: (m,) takes the factors that make the diagonal one.
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


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS)
@external
def newton(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f):
    """Refine forces x to rounding by Newton's method on their active set; return the residual."""
    best = residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
    if not 0.0 < best < math.inf:
        return best
    size = len(free)
    system, right, step = np.empty((size, size)), np.empty(size), np.empty(size)
    trial, no_basis, undecided = x.copy(), np.empty((0, size)), repeated(len(mu), AS_FORCES_SAY)
    for _ in range(POLISH):
        answer_signals()
        linearize(
            *(delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f),
            *(undecided, system, right),
        )
        least_norm(system, right, PIVOT, step, no_basis)
        for a in range(size):
            trial[a] += step[a] * scale_f[a]
        now = residual(
            delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f
        )
        if now < best:
            best = now
            assign(x, trial)
        if now <= POLISHED or not now < 10.0 * best:
            break
    return best


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS, INTEGERS, FLOAT_ROWS, FLOATS)
@external
def linearize(
    delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f, closed, system, right
):
    """Fill the equations of a step of Newton's method from forces x, whose accelerations are `a_now`.

    `closed` has the contacts that are closed (1; those at rest stick) or open (0); −1 leaves that to the
    forces.
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
        lowest = least[i] / scale_f[b]
        opens = not held[i] and (closed[i] == 0 if given else fn - an <= lowest)
        if opens and lowest == 0.0:
            for r in range(b, b + 3):
                system[r, r], right[r] = 1.0, -x[r] / scale_f[r]
            continue
        if opens:
            system[b + 2, b + 2], right[b + 2] = 1.0, lowest - fn
        else:
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
