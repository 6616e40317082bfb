"""Contact problems with Coulomb's law and bounded scalar rows, and their solver. (theory.md, 11)

    u = u_free + W f,
    contacts:     |f_t| ≤ μ f_3,  f_t = −μ f_3 u_t/|u_t| where u_t ≠ 0,  and f_3 and u_3 like
    scalar rows:  lower ≤ f ≤ upper,  u = 0 between them, u ≥ 0 at lower, u ≤ 0 at upper.

Either u are velocities and f impulses, or u accelerations and f forces. The friction of a sliding contact is
opposite to its given direction of slip σ, for any u_t. With De Saxcé's s = μ|u_t| this is a cone
complementarity problem: f in K and u + s n in the dual cone; for sliding contacts K is a half-line and
s = μ σ·u_t.

The method of augmented Lagrangians approaches a solution, see `augmented_newton`; Newton's method on the
active set then converges to rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, FloatRows, Floats, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .augmented_lagrangian import FINER, ITERATIONS, QUICK, fill_compliances, iterate_of
from .augmented_newton import (
    Law,
    VelocityProblem,
    add_transposed,
    continue_to,
    find_profile,
    solve_compliances,
)
from .elimination import solve
from .least_norm import least_norm
from .loops import assign, filled, largest_diagonal, ones, repeated
from .products import apply
from .semidefinite import factor
from .tolerances import COMPUTED, EXACT, HALF_DIGITS, LARGE, RANK, ROUNDING, ROUNDOFF, SMALL, UNDETERMINED
from .tolerances import USABLE as USABLE  # re-exported

LARGEST = 10.0
"""Largest r tried, relative to the largest diagonal entry of W."""

COURSE = 1e-2, 1e-4, 2.0 * SMALL, SMALL
"""Compliances to which a solution is continued in turn, relative to the same. From the last two it is
extrapolated to zero."""

POLISH = 8
"""Largest number of steps of Newton's method per trial."""


class CoulombProblem(NamedTuple):
    """A contact problem of nc contacts, three rows (t₁, t₂, n) each, and ns scalar rows; m = 3 nc + ns."""

    delassus: FloatRows  # (m, m) W
    free: Floats  # (m,) u_free
    law: Law


@declared(CoulombProblem, FLOATS, result=float)
@external
def solve_coulomb(problem, x):
    """Solve a contact problem for forces x.

    Newton's method starts from each iterate of (16.3) until it converges, preferably to forces whose
    equations have no negative determinant. The compliances r decrease where the iterates converge slowly, and
    increase where (16.3) is not solved.

    Args:
        problem: The `CoulombProblem`.
        x: (m,) is overwritten with the solution.

    Returns:
        The residual of the law relative to u_free; above `tolerances.USABLE` if no solution was found.
    """
    velocities, profile, now, matrix = in_velocities(problem, ones(len(problem.law.friction)))
    size = len(x)
    f, trial, r = np.zeros(size), np.empty(size), np.empty(size)
    part, last, best = 1.0, math.inf, math.inf
    filled(x, 0.0)
    for _ in range(ITERATIONS):
        fill_compliances(velocities, part, np.empty(size), r)
        _, solved = solve_compliances(velocities, profile, r, f, ROUNDING, now, matrix, False)
        if not solved:
            part /= FINER
            if part > LARGEST:
                break
            continue
        change = 0.0
        for a in range(size):
            change = max(change, r[a] * abs(now.f[a] - f[a]))
            f[a] = trial[a] = now.f[a]
        if change > QUICK * last and part > HALF_DIGITS:  # or else f grows until u is lost in rounding
            part *= FINER
        last = change
        error = polish(problem, trial, COMPUTED)
        if not (error < best or error <= USABLE):
            continue
        lasts = error <= USABLE and orientation(problem, trial) >= 0
        if lasts or best > USABLE:
            best = error
            assign(x, trial)
        if lasts:
            break
    return best


@declared(CoulombProblem, FLOATS, FLOATS, float, result=float)
@external
def solve_compliant(problem, x, compliance, rank):
    """Solve as `solve_coulomb`; of several solutions compute the limit of small compliances. (11.12)

    The solutions of (16.3) from f = 0 for r = 2ε C and r = ε C are extrapolated to ε = 0, where Newton's
    method converges to the nearest solution. C is diagonal, up to a factor `compliance` (nc,) for the rows
    of contacts and 1 for scalar rows. With friction there may be several such solutions; this one continues
    that of a larger r by (11.15), which does not depend on where Newton's method starts. It starts from the
    velocities of the given x, which should have the symmetry of the problem; `rank` is that of `polish`.
    """
    velocities, profile, now, matrix = in_velocities(problem, compliance)
    size = len(x)
    add_transposed(velocities.values, velocities.columns, velocities.counts, x, now.w)
    none, r = np.zeros(size), np.empty(size)
    fill_compliances(velocities, LARGE, np.empty(size), r)
    _, solved = solve_compliances(velocities, profile, r, none, ROUNDING, now, matrix, False)
    before = LARGE
    for part in COURSE:
        factored = continue_to(velocities, profile, r, part / before, now, matrix)
        _, found = solve_compliances(velocities, profile, r, none, ROUNDING, now, matrix, factored)
        solved = solved and found
        for a in range(size):
            x[a] = 2.0 * now.f[a] - x[a] if part == SMALL else now.f[a]
        before = part
    best = polish(problem, x, rank) if solved else math.inf
    return best if best <= UNDETERMINED else solve_coulomb(problem, x)


@inlined
def in_velocities(problem, compliance):
    """Return the problem in velocities, its profile, an `Iterate` with w = 0, and scratch (m, m)."""
    velocities = velocity_problem(problem, compliance)
    m = len(velocities.mass)
    profile = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    find_profile(velocities, *profile)
    now = iterate_of(velocities, np.zeros(m), np.empty(len(problem.free)))
    return velocities, profile, now, np.empty((m, m))


@inlined
def velocity_problem(problem, compliance):
    """Return the `VelocityProblem` with M = 1 of a contact problem, by the factor of W = J Jᵀ."""
    delassus, free, law = problem
    size, nc = len(free), len(law.friction)
    factors, order, scaled = np.zeros((size, size)), np.empty(size, dtype=np.int64), np.empty((size, size))
    d, unused = np.empty(size), np.empty(size)
    scale(delassus, free, nc, d, unused, unused)  # rows of different units have one rank
    for a in range(size):
        for b in range(size):
            scaled[a, b] = d[a] * delassus[a, b] * d[b]
    m = factor(scaled, order, factors, RANK)
    values, columns = np.empty((size, m)), np.empty((size, m), dtype=np.int64)
    for a in range(size):
        for k in range(m):
            values[a, k], columns[a, k] = factors[a, k] / d[a], k
    return VelocityProblem(
        *(np.eye(m), np.eye(m), np.arange(m), values, columns, repeated(size, m)),
        *(free, law, compliance),
    )


@inlined
def scales_of(problem):
    """Return the unit of `scale`, and the arrays `accelerations`, scale_a and scale_f of `residual`."""
    delassus, free, least = problem.delassus, problem.free, problem.law.least
    size, nc = len(free), len(least)
    d, scale_a, scale_f, loads = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    for a in range(size):  # the magnitude of u, also where u_free is zero and only `least` acts
        loads[a] = abs(free[a])
        for i in range(nc):
            loads[a] += abs(delassus[a, 3 * i + 2]) * least[i]
    return scale(delassus, loads, nc, d, scale_a, scale_f), (np.empty(size), scale_a, scale_f)


@declared(CoulombProblem, FLOATS, float, result=float)
@external
def polish(problem, x, rank):
    """Refine forces x by Newton's method as long as it halves the residual; return that. See `newton`.

    Forces do not change along directions of Newton's matrix whose pivots are below `rank` times the largest.
    """
    unit, scales = scales_of(problem)
    if unit == 0.0:
        filled(x, 0.0)
        return 0.0
    now, before = residual(problem, x, *scales), math.inf
    while EXACT < now < 0.5 * before:
        before = now
        now = newton(problem, x, rank, *scales)
    return now


@declared(CoulombProblem, FLOATS, FLOATS, FLOATS, FLOATS, result=float)
@external
def residual(problem, x, accelerations, scale_a, scale_f):
    """Return the largest residual of Coulomb's law over the rows, scaled by `scale`; infinite if not finite.

    `accelerations` (m,) is overwritten with u = u_free + W x. Other arguments as in `solve_coulomb`.
    """
    delassus, free, law = problem
    mu, velocity, least, most, held, lower, upper = law
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
        worst = max(worst, abs(fn - min(max(fn - an, least[i] / scale_f[b]), most[i] / scale_f[b])))
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
    """Fill scales, equal for the rows of a contact so that cones keep their shape; return the unit.

    Args:
        delassus: (m, m) W, whose first rows are three per contact.
        free: (m,) u_free.
        contacts: Number of contacts.
        d: (m,) is overwritten with the factors that make the diagonal of W at most one.
        scale_a: (m,) is overwritten with the factors of accelerations.
        scale_f: (m,) is overwritten with the units of forces.

    Returns:
        The unit max |d u_free|; if it is zero the last two are not filled.
    """
    size = len(free)
    largest, unit = largest_diagonal(delassus), 0.0
    for i in range(contacts):
        softest = max(delassus[3 * i, 3 * i], delassus[3 * i + 1, 3 * i + 1])
        softest = max(softest, delassus[3 * i + 2, 3 * i + 2])
        for a in range(3 * i, 3 * i + 3):
            d[a] = 1.0 / math.sqrt(max(softest, ROUNDOFF * largest))
    for a in range(3 * contacts, size):
        d[a] = 1.0 / math.sqrt(max(delassus[a, a], ROUNDOFF * largest))
    for a in range(size):
        unit = max(unit, abs(d[a] * free[a]))
    if unit > 0.0:
        for a in range(size):
            scale_a[a], scale_f[a] = d[a] / unit, d[a] * unit
    return unit


@declared(CoulombProblem, FLOATS, float, FLOATS, FLOATS, FLOATS, result=float)
@external
def newton(problem, x, rank, a_now, scale_a, scale_f):
    """Refine forces x to rounding by Newton's method on their active set; return the residual.

    `rank` is that of `polish`, other arguments as in `residual`; x is kept where a step does not reduce the
    residual.
    """
    best = residual(problem, x, a_now, scale_a, scale_f)
    if not 0.0 < best < math.inf:
        return best
    size = len(x)
    system, right, step = np.empty((size, size)), np.empty(size), np.empty(size)
    trial, no_basis = x.copy(), np.empty((0, size))
    for _ in range(POLISH):
        answer_signals()
        linearize(problem, trial, a_now, scale_a, scale_f, system, right)
        least_norm(system, right, rank, step, no_basis)
        for a in range(size):
            trial[a] += step[a] * scale_f[a]
        now = residual(problem, trial, a_now, scale_a, scale_f)
        if now < best:
            best = now
            assign(x, trial)
        if now <= ROUNDOFF or not now < 10.0 * best:
            break
    return best


@declared(CoulombProblem, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT_ROWS, FLOATS)
@external
def linearize(problem, x, a_now, scale_a, scale_f, system, right):
    """Fill the equations `system` · step = `right` of Newton's method at forces x with accelerations a_now.

    They are scaled as in `residual`. The active set is that of the forces and accelerations.
    """
    delassus, law = problem.delassus, problem.law
    mu, velocity, least, most, held, lower, upper = law
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    for row in system:
        filled(row, 0.0)
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], a_now[b + 2] * scale_a[b]
        low, high = least[i] / scale_f[b], most[i] / scale_f[b]
        bounded = not held[i] and not low < fn - an < high
        bound = min(max(fn - an, low), high)
        if bounded and bound == 0.0:  # open
            for r in range(b, b + 3):
                system[r, r], right[r] = 1.0, -x[r] / scale_f[r]
            continue
        if bounded:
            system[b + 2, b + 2], right[b + 2] = 1.0, bound - fn
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
        if held[i] or math.hypot(g1, g2) <= mu[i] * fn:  # sticks
            for k in range(size):
                system[b, k] = scale_a[b] * delassus[b, k] * scale_f[k]
                system[b + 1, k] = scale_a[b] * delassus[b + 1, k] * scale_f[k]
            right[b], right[b + 1] = -a1, -a2
        else:  # incipient slip: f_t = μ f_n g/|g|, g = f_t − a_t
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


@declared(CoulombProblem, FLOATS, result=int)
@external
def orientation(problem, x):
    """Return the sign of the determinant of Newton's equations at forces x; zero if they are singular.

    Forces that are not unique have the sign for small compliances, which are added to the diagonal of W.
    """
    size, (unit, scales) = len(x), scales_of(problem)
    system, right, soft = np.empty((size, size)), np.empty(size), problem.delassus.copy()
    if unit == 0.0:
        return 0
    a_now, scale_a, scale_f = scales
    residual(problem, x, a_now, scale_a, scale_f)
    for a in range(size):
        soft[a, a] += HALF_DIGITS / (scale_a[a] * scale_f[a])
    softened = CoulombProblem(soft, problem.free, problem.law)
    linearize(softened, x, a_now, scale_a, scale_f, system, right)
    return solve(system, right, np.empty(size), RANK)
