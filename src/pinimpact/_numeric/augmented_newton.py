"""Coulomb's law with more rows than velocities, solved by Newton's method in the velocities. (theory.md, 16)

The method of augmented Lagrangians (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991)
computes from impulses f the next ones, f⁺, by

    f⁺ = P(f − u/r),   u = u_free + J w,   M w = Jᵀ f⁺.                                                 (16.3)

r > 0 is a compliance for each contact or row. For a contact

    P(z) = (Π_ρ(z_t), [z_n]₊),   ρ = μ [z_n]₊,                                                          (16.4)

where Π_ρ is the projection onto the disc of radius ρ; for a scalar row P is the projection onto its bounds. A
fixed point satisfies the law for any r. From f = 0 the first f⁺ are the impulses of contacts with compliances
r; each further iteration reduces u by a factor of about r/W. Newton's method with a line search solves (16.3)
for w in a few steps. Its matrix has the size of w, with zeros for bodies that are not in contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._compile.declared import FLOAT_STACK, FLOATS, FloatRows, Floats, IntegerRows, Integers, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .loops import assign
from .products import dot
from .profile import apply_within, eliminate_profile, substitute_profile
from .tolerances import STALLED, TINY

ITERATIONS = 40
"""Largest number of iterations of (16.3)."""

STEPS = 40
"""Largest number of steps of Newton's method per iteration, and of steps of a line search."""

PATIENCE = 3
"""Number of successive iterations without halving of the change after which the method may end."""

FINER = 0.1
"""Factor of r after an iteration that hardly reduces the change of f, if the last factor has halved it."""

QUICK, HALF = 0.2, 0.5
"""Factors by which an iteration is to reduce the change of f, before and after r is first reduced. This saves
half of the iterations in piles; if many follow, Newton's method fails."""

SLOPE = 0.1
"""Slope at the end of a line search relative to that at its start."""


class VelocityProblem(NamedTuple):
    """A contact problem of nc contacts, three rows (t₁, t₂, n) each, and ns scalar rows, in m velocities."""

    mass: FloatRows  # (m, m) M
    inverse: FloatRows  # (m, m) its inverse
    start: Integers  # (m,) first column of each row of both that may be nonzero
    values: FloatRows  # (n, …) nonzero entries of each row of J; same columns for the rows of a contact
    columns: IntegerRows  # (n, …) their columns, in ascending order
    counts: Integers  # (n,) their numbers
    free: Floats  # (n,) u_free, velocities without impulses
    friction: Floats  # (nc,) coefficients of friction
    lower: Floats  # (ns,) lower bounds of scalar impulses
    upper: Floats  # (ns,) upper bounds of scalar impulses
    compliance: Floats  # (nc,) compliances of contacts relative to those of scalar rows


class Iterate(NamedTuple):
    """An iterate of Newton's method."""

    w: Floats  # (m,) change of the velocities
    u: Floats  # (n,) u_free + J w
    f: Floats  # (n,) f⁺ of (16.3)
    momentum: Floats  # (m,) M w
    residual: Floats  # (m,) M w − Jᵀ f⁺
    scale: Floats  # (m,) 1/√M_aa, which makes momenta comparable


@inlined
def rates(values, columns, counts, w, out):
    """Fill out (n,) with J w."""
    for a in range(len(out)):
        total = 0.0
        for k in range(counts[a]):
            total += values[a, k] * w[columns[a, k]]
        out[a] = total


@inlined
def add_transposed(values, columns, counts, x, out):
    """Add Jᵀ x to out (m,)."""
    for a in range(len(x)):
        for k in range(counts[a]):
            out[columns[a, k]] += values[a, k] * x[a]


@inlined
def length(x, y):
    """Return √(x² + y²), faster than `math.hypot`."""
    return math.sqrt(x * x + y * y)


@external
def impulses(u, before, mu, lower, upper, r, out):
    """Fill out (n,) with f⁺ = P(f − u/r) of (16.3), f = `before` (n,)."""
    nc = len(mu)
    for a in range(len(u)):
        out[a] = before[a] - u[a] / r[a]
    for i in range(nc):
        j = 3 * i
        out[j + 2] = max(out[j + 2], 0.0)
        size, radius = length(out[j], out[j + 1]), mu[i] * out[j + 2]
        if size > radius:
            out[j] *= radius / size
            out[j + 1] *= radius / size
    for i in range(len(lower)):
        out[3 * nc + i] = min(max(out[3 * nc + i], lower[i]), upper[i])


@inlined
def fill_derivative(z1, z2, z3, mu, coupled, d):
    """Fill d (3, 3) with ∂P/∂z of a closed contact, without ∂ρ/∂z_n unless `coupled`. (16.4)"""
    for a in range(3):
        for b in range(3):
            d[a, b] = 0.0
    d[2, 2] = 1.0
    size, radius = length(z1, z2), mu * z3
    if size <= radius:  # sticks
        d[0, 0] = d[1, 1] = 1.0
        return
    s1, s2 = z1 / size, z2 / size
    part = radius / size
    d[0, 0], d[1, 1] = part * s2 * s2, part * s1 * s1
    d[0, 1] = d[1, 0] = -part * s1 * s2
    if coupled:
        d[0, 2], d[1, 2] = mu * s1, mu * s2


@external
def fill_system(problem, profile, r, u, before, coupled, system):
    """Fill system (m, m) with the matrix of Newton's method, M + (1/r) Jᵀ ∂P J.

    Args:
        problem: The `VelocityProblem`.
        profile: First and last columns (m,) of each row, see `find_profile`.
        r: (n,) compliances.
        u: (n,) velocities.
        before: (n,) f.
        coupled: Whether ∂ρ/∂z_n is included; without it the matrix is symmetric and positive definite.
        system: (m, m) is overwritten.
    """
    mass, _, start, values, columns, counts, _, mu, lower, upper, _ = problem
    first, last = profile
    m, nc = len(mass), len(mu)
    d = np.empty((3, 3))
    for a in range(m):
        for b in range(first[a], last[a] + 1):
            system[a, b] = 0.0
    for a in range(m):
        for b in range(start[a], a + 1):
            system[a, b] = system[b, a] = mass[a, b]
    for i in range(nc):
        j = 3 * i
        z3 = before[j + 2] - u[j + 2] / r[j]
        if z3 <= 0.0:
            continue
        fill_derivative(before[j] - u[j] / r[j], before[j + 1] - u[j + 1] / r[j], z3, mu[i], coupled, d)
        for k in range(counts[j]):
            j0, j1, j2 = values[j, k] / r[j], values[j + 1, k] / r[j], values[j + 2, k] / r[j]
            t0 = j0 * d[0, 0] + j1 * d[1, 0]
            t1 = j0 * d[0, 1] + j1 * d[1, 1]
            t2 = j0 * d[0, 2] + j1 * d[1, 2] + j2
            row = system[columns[j, k]]
            for o in range(counts[j]):
                row[columns[j, o]] += t0 * values[j, o] + t1 * values[j + 1, o] + t2 * values[j + 2, o]
    for i in range(len(lower)):
        j = 3 * nc + i
        if lower[i] < before[j] - u[j] / r[j] < upper[i]:
            for k in range(counts[j]):
                for o in range(counts[j]):
                    system[columns[j, k], columns[j, o]] += values[j, k] * values[j, o] / r[j]


@external
def evaluate(problem, r, before, now):
    """Fill u, f⁺, M w and the residual of an `Iterate` from its w; return the relative norm of the residual.

    Momenta are scaled by 1/√M_aa. Other arguments are those of `fill_system`.
    """
    mass, _, start, values, columns, counts, free, mu, lower, upper, _ = problem
    w, u, f, momentum, out, scale = now
    largest = square = 0.0
    rates(values, columns, counts, w, u)
    for a in range(len(u)):
        u[a] += free[a]
    impulses(u, before, mu, lower, upper, r, f)
    apply_within(mass, start, w, momentum)
    for a in range(len(out)):
        out[a] = momentum[a]
        largest = max(largest, scale[a] * abs(out[a]))
    for a in range(len(f)):
        if f[a] != 0.0:
            for k in range(counts[a]):
                part = values[a, k] * f[a]
                out[columns[a, k]] -= part
                largest = max(largest, scale[columns[a, k]] * abs(part))
    for a in range(len(out)):
        square += (scale[a] * out[a]) ** 2
    return math.sqrt(square) / max(largest, TINY)


@external
def length_of_step(problem, r, before, now, du, slope, curvature):
    """Return the length t ≤ 1 of a step d at which the residual is orthogonal to d; 0 if d does not descend.

    Without ∂ρ/∂z_n this is the minimum of a convex function along d. `now` is the `Iterate` at t = 0, whose f
    is overwritten; du (n,) is J d, slope dᵀM w, curvature dᵀM d; other arguments as in `fill_system`.
    """
    mu, lower, upper, u, f = problem.friction, problem.lower, problem.upper, now.u, now.f
    trial = np.empty(len(u))
    start = slope - dot(du, f)
    if not start < 0.0:
        return 0.0
    low, high, at_low, at_high, share, side = 0.0, 1.0, start, 0.0, 1.0, 0
    for k in range(STEPS):
        for a in range(len(u)):
            trial[a] = u[a] + share * du[a]
        impulses(trial, before, mu, lower, upper, r, f)
        here = slope + share * curvature - dot(du, f)
        if abs(here) <= SLOPE * abs(start) or (k == 0 and here <= 0.0):
            break
        # Illinois method: halve the value at the end that is kept
        if here > 0.0:
            high, at_high, at_low = share, here, (0.5 * at_low if side > 0 else at_low)
            side = 1
        else:
            low, at_low, at_high = share, here, (0.5 * at_high if side < 0 else at_high)
            side = -1
        share = low - (high - low) * at_low / (at_high - at_low)
    return share


@external
def find_profile(problem, first, last):
    """Fill the first and the last nonzero columns (m,) of each row of the factors of M + JᵀJ."""
    start, columns, counts = problem.start, problem.columns, problem.counts
    m = len(start)
    for a in range(m):
        last[a] = a
    for a in range(m):
        last[start[a]] = max(last[start[a]], a)
    for a in range(len(counts)):
        if counts[a] > 0:
            last[columns[a, 0]] = max(last[columns[a, 0]], columns[a, counts[a] - 1])
    k = 0
    for a in range(m):
        if a > 0:
            last[a] = max(last[a], last[a - 1])
        while last[k] < a:
            k += 1
        first[a] = k


@external
def fill_compliances(problem, part, diagonal, given):
    """Fill the diagonal (n,) of W, for each contact its largest entry, and the compliances r, given (n,).

    The largest r of a contact is `part` times the largest diagonal entry of W; without contacts r is in
    proportion to the diagonal.
    """
    _, inverse, _, values, columns, counts, _, _, _, _, compliance = problem
    nc, softest, largest = len(compliance), 0.0, 0.0
    for a in range(len(given)):
        diagonal[a] = 0.0
        for k in range(counts[a]):
            row, total = inverse[columns[a, k]], 0.0
            for o in range(k):
                total += row[columns[a, o]] * values[a, o]
            diagonal[a] += values[a, k] * (2.0 * total + row[columns[a, k]] * values[a, k])
        given[a] = part * diagonal[a]
    for i in range(nc):
        j = 3 * i
        diagonal[j] = diagonal[j + 1] = diagonal[j + 2] = max(diagonal[j], diagonal[j + 1], diagonal[j + 2])
        largest, softest = max(largest, diagonal[j]), max(softest, compliance[i])
    for a in range(len(given) if nc > 0 else 0):
        given[a] = part * largest * (compliance[a // 3] if a < 3 * nc else 1.0) / softest


@inlined
def solve_compliances(problem, profile, r, before, least, now, system, factored):
    """Solve (16.3) for w of the `Iterate` now, given f, by Newton's method.

    It stops at a relative norm `least` of the residual, which is small so that results are differentiable.
    If system (m, m) is `factored`, it contains the factors of a previous iteration, which are used as long as
    each step halves the residual: the active set is mostly the same. Return whether it contains factors at
    the end. Other arguments as in `fill_system`.
    """
    w, momentum, residual = now.w, now.momentum, now.residual
    m, previous_error, reuse = len(w), math.inf, factored
    d, md, du = np.empty(m), np.empty(m), np.empty(len(r))
    for step in range(STEPS + 1):
        answer_signals()
        error = evaluate(problem, r, before, now)
        stalled = error > HALF * previous_error
        if step == STEPS or error <= least or (stalled and not reuse and error < 1e3 * least):
            break
        reuse = reuse and not stalled
        previous_error, share = error, 0.0
        for attempt in range(2):  # the second matrix is definite, so its step descends
            for a in range(m):
                d[a] = -residual[a]
            if reuse:
                substitute_profile(system, profile[1], d)
                share = 1.0
                break
            fill_system(problem, profile, r, now.u, before, attempt == 0, system)
            factored = eliminate_profile(system, profile[1], d)
            if not factored:
                continue
            rates(problem.values, problem.columns, problem.counts, d, du)
            apply_within(problem.mass, problem.start, d, md)
            share = length_of_step(problem, r, before, now, du, dot(d, momentum), dot(d, md))
            if share > 0.0:
                break
        for a in range(m):
            w[a] += share * d[a]
    return factored


@inlined
def residual_of(problem, diagonal, x, now):
    """Fill an `Iterate` with w = M⁻¹ Jᵀ x and its u and f⁺; return the residual of Coulomb's law [m/s].

    The residual is max W_aa|f⁺ − x| with r = W_aa, the `diagonal` (n,); infinite if x (n,) is not finite.
    """
    w, u, f, momentum, _, _ = now
    values, columns, counts = problem.values, problem.columns, problem.counts
    for a in range(len(w)):
        momentum[a] = 0.0
    add_transposed(values, columns, counts, x, momentum)
    apply_within(problem.inverse, problem.start, momentum, w)
    rates(values, columns, counts, w, u)
    for a in range(len(u)):
        u[a] += problem.free[a]
    impulses(u, x, problem.friction, problem.lower, problem.upper, diagonal, f)
    worst = total = 0.0
    for a in range(len(u)):
        part = diagonal[a] * abs(f[a] - x[a])
        worst = max(worst, part)
        total += part
    return worst if math.isfinite(total) else math.inf


@declared(VelocityProblem, float, float, FLOATS, FLOATS, FLOATS, FLOAT_STACK, result=float)
@external
def solve_velocities(problem, part, accuracy, begin, w, x, course):
    """Compute impulses that satisfy Coulomb's law, and the change of velocities by them.

    Of several solutions it is nearly the limit of small compliances.

    Args:
        problem: The `VelocityProblem`.
        part: Largest r, relative to the largest diagonal entry of W; see `tolerances.SOFTEST`.
        accuracy: Change of velocities by f⁺ − f at the end, relative to u_free; see `tolerances.SETTLED`.
        begin: (m,) warm start: change of the velocities; overwritten with that of the first iteration, the
            best start for a similar problem.
        w: (m,) is overwritten with the change of velocities.
        x: (n,) is overwritten with the impulses.
        course: (2, k, n) is overwritten with r and f⁺ of the first k iterations.

    Returns:
        The residual of the law relative to u_free; infinite if the iteration has diverged.
    """
    free = problem.free
    n, m, size = len(free), len(w), 0.0
    for a in range(n):
        x[a] = 0.0
        size = max(size, abs(free[a]))
    if size == 0.0:
        for a in range(m):
            w[a] = begin[a] = 0.0
        return 0.0
    profile = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    find_profile(problem, *profile)
    diagonal, r, system = np.empty(n), np.empty(n), np.empty((m, m))
    fill_compliances(problem, part, diagonal, r)
    f = np.empty(n)
    now = Iterate(w, np.empty(n), f, np.empty(m), np.empty(m), np.empty(m))
    for a in range(m):
        now.scale[a] = 1.0 / math.sqrt(problem.mass[a, a])
    assign(w, begin)
    balanced, factored = 0.1 * accuracy, False
    lowest, reached, before, slow, enough = math.inf, 1.0, math.inf, 0, QUICK
    for iteration in range(ITERATIONS):
        factored = solve_compliances(problem, profile, r, x, balanced, now, system, factored)
        if iteration == 0:
            assign(begin, w)
        reached = 0.0
        for a in range(n):
            reached = max(reached, r[a] * abs(f[a] - x[a]) / size)
        assign(x, f)
        if iteration < course.shape[1]:
            assign(course[0, iteration], r)
            assign(course[1, iteration], f)
        slow = slow + 1 if reached > HALF * lowest else 0
        if reached <= accuracy or (slow >= PATIENCE and reached <= STALLED):
            break
        if reached > enough * lowest and lowest < HALF * before:
            before, lowest, slow, enough = lowest, math.inf, 0, HALF
            factored = False
            for a in range(n):
                r[a] *= FINER
        lowest = min(lowest, reached)
    return residual_of(problem, diagonal, x, now) / size
