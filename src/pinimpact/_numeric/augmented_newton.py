"""Coulomb's law with more rows than velocities: Newton's method in the velocities. (theory.md, 16)

From the impulses f of one iteration the next ones are

    f⁺ = P(f − u/r),   u = u_free + J w,   M w = Jᵀ f⁺,                                                 (16.3)

r > 0 a compliance for each contact or row, P for a contact

    P(z) = (Π_ρ(z_t), [z_n]₊),   ρ = μ [z_n]₊,                                                          (16.4)

Π_ρ the projection onto the disc of radius ρ, and for scalar rows that onto their bounds. A fixed point
satisfies the law, whatever r. (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991.) From
f = 0 the first f⁺ are the forces of contacts with compliances r; each further iteration makes u smaller, by a
factor of about r/W. Newton's method with a line search solves (16.3) for w in a few steps. Its matrix has the
size of w, and zeros for bodies that do not touch.
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
from .profile import apply_within, eliminate_profile
from .tolerances import STALLED, TINY

ITERATIONS = 40
"""Largest number of iterations of (16.3)."""

STEPS = 40
"""Largest number of steps of Newton's method in an iteration, and of a line search."""

PATIENCE = 3
"""Iterations that do not halve the change after which they end."""

FINER = 0.1
"""Part of r used from an iteration on that does not halve the change, if the last such part has halved it."""

SLOPE = 0.1
"""Largest slope at the end of a line search, relative to that at its start."""


class VelocityProblem(NamedTuple):
    """The law for nc contacts, three rows (t₁, t₂, n) each, and for ns scalar rows, in m velocities."""

    mass: FloatRows  # (m, m) M
    inverse: FloatRows  # (m, m) its inverse
    start: Integers  # (m,) first columns of their rows that may not be zero
    values: FloatRows  # (n, …) nonzero entries of each row of J, in the same columns for a whole contact
    columns: IntegerRows  # (n, …) their columns, in ascending order
    counts: Integers  # (n,) their numbers
    free: Floats  # (n,) u without impulses
    friction: Floats  # (nc,) coefficients of friction
    lower: Floats  # (ns,) lower bounds of scalar impulses
    upper: Floats  # (ns,) upper bounds of scalar impulses
    compliance: Floats  # (nc,) of the contacts, where that of scalar rows is 1


class Iterate(NamedTuple):
    """Where the iteration stands."""

    w: Floats  # (m,) velocities
    u: Floats  # (n,) u_free + J w
    f: Floats  # (n,) f⁺ of (16.3)
    momentum: Floats  # (m,) M w
    off: Floats  # (m,) M w − Jᵀ f⁺
    scale: Floats  # (m,) 1/√M_aa, times which momenta are in one unit


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
    """Return the length of a vector, in less time than `math.hypot`."""
    return math.sqrt(x * x + y * y)


@external
def impulses(u, before, mu, lower, upper, r, out):
    """Fill out (n,) with f⁺ of (16.3) from u (n,) and f, `before` (n,)."""
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
    """Fill d (3, 3) with ∂P at z of a contact that is closed, unless `coupled` without that by z_n of ρ."""
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
    """Fill system (m, m) with the matrix of a step of Newton's method, M + Jᵀ (∂P/r) J.

    The profile has first and last columns (m,), see `find_profile`; r (n,) is that of (16.3), u (n,) are
    velocities, before (n,) is f. Unless friction is `coupled` to normal impulses the matrix is symmetric and
    definite.
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
def balance(problem, r, before, now):
    """Fill u, f⁺, M w and M w − Jᵀ f⁺ of an `Iterate`; return the relative size of the last, times 1/√M_aa.

    Other arguments are those of `fill_system`.
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
    """Return the length of a step, at most one: where its residual is orthogonal to it, zero if nowhere.

    Where friction does not follow normal impulses this is the minimum of a convex function. With r (n,) of
    (16.3), before (n,) f, the `Iterate` now, whose f takes the impulses at the end, the change du (n,) of u
    over the whole step d, slope dᵀM w and curvature dᵀM d.
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
        # Illinois: the end that stays counts half
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
    """Fill the first and the last columns (m,) of the rows of the factors of M + JᵀJ."""
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
    """Fill the diagonal (n,) of W, for each contact the largest, and the r (n,) of (16.3)."""
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
def solve_compliances(problem, profile, r, before, least, now, system):
    """Bring w to the solution of (16.3) for given f, by Newton's method.

    The arguments are those of `fill_system`, the relative size `least` of the residual that is enough, small
    so that w is a function that can be differentiated, and the `Iterate` now, which changes.
    """
    w, momentum, off = now.w, now.momentum, now.off
    m, reached = len(w), math.inf
    d, md, du = np.empty(m), np.empty(m), np.empty(len(r))
    for step in range(STEPS + 1):
        answer_signals()
        left = balance(problem, r, before, now)
        if step == STEPS or left <= least or (left < 1e3 * least and left > 0.5 * reached):
            break
        reached, share = left, 0.0
        for attempt in range(2):  # the second one descends in any case
            fill_system(problem, profile, r, now.u, before, attempt == 0, system)
            for a in range(m):
                d[a] = -off[a]
            if not eliminate_profile(system, profile[1], d):
                continue
            rates(problem.values, problem.columns, problem.counts, d, du)
            apply_within(problem.mass, problem.start, d, md)
            share = length_of_step(problem, r, before, now, du, dot(d, momentum), dot(d, md))
            if share > 0.0:
                break
        for a in range(m):
            w[a] += share * d[a]


@inlined
def residual_of(problem, diagonal, x, now):
    """Fill w = M⁻¹ Jᵀ x of an `Iterate` and what follows from it; return the residual of the law [m/s].

    It is W_aa|f⁺ − f|, with the diagonal (n,) of W as r; infinite if x (n,) is not finite.
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
    missed = total = 0.0
    for a in range(len(u)):
        part = diagonal[a] * abs(f[a] - x[a])
        missed = max(missed, part)
        total += part
    return missed if math.isfinite(total) else math.inf


@declared(VelocityProblem, float, float, FLOATS, FLOATS, FLOATS, FLOAT_STACK, result=float)
@external
def solve_velocities(problem, part, accuracy, begin, w, x, course):
    """Fill x (n,) with impulses that satisfy the law, and w (m,) with the change of velocities by them.

    Of several solutions that satisfy it nearly it is the limit of small compliances. `part` is the largest r,
    relative to the largest of W (`tolerances.SOFTEST`), `accuracy` the part of u_free by which f⁺ − f may
    change velocities at the end (`tolerances.SETTLED`). begin (m,) is an initial change of the velocities,
    and takes that of the first iteration, the best start for a nearly equal problem. Course (2, …, n) takes
    r and f⁺ of each iteration, as far as it has room. Returns the residual of the law, relative to u_free;
    infinite if the iteration has diverged.
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
    balanced = 0.1 * accuracy
    lowest, reached, before, slow = math.inf, 1.0, math.inf, 0
    for iteration in range(ITERATIONS):
        solve_compliances(problem, profile, r, x, balanced, now, system)
        if iteration == 0:
            assign(begin, w)
        reached = 0.0
        for a in range(n):
            reached = max(reached, r[a] * abs(f[a] - x[a]) / size)
        assign(x, f)
        if iteration < course.shape[1]:
            assign(course[0, iteration], r)
            assign(course[1, iteration], f)
        slow = slow + 1 if reached > 0.5 * lowest else 0
        if reached <= accuracy or (slow >= PATIENCE and reached <= STALLED):
            break
        if slow > 0 and lowest < 0.5 * before:
            before, lowest, slow = lowest, math.inf, 0
            for a in range(n):
                r[a] *= FINER
        lowest = min(lowest, reached)
    return residual_of(problem, diagonal, x, now) / size
