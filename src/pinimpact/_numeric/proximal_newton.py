"""Coulomb's law with more rows than velocities: Newton's method in the velocities. (theory.md, 16)

From the impulses f of one iteration the next ones are

    f⁺ = P(f − (u + s n)/r),   u = u_free + J w,   M w = Jᵀ f⁺,                                         (16.3)

P the projection onto the cones of the contacts and the bounds of the scalar rows, s = μ|u_t|, r > 0 a
compliance for each contact or row. A fixed point satisfies the law, whatever r: this is the proximal point
method (R. T. Rockafellar, SIAM J. Control Optim. 14, 1976). For given s, w is the minimum of a convex
function. Newton's method with a line search finds it in a few steps, since M + Jᵀ (∂P/r) J is definite
whatever the rank of J. The matrix has the size of w, and zeros for bodies that do not touch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._compile.declared import FLOATS, FloatRows, Floats, IntegerRows, Integers, declared
from .._compile.jit import external, inlined
from .coulomb_problem import into_cone
from .loops import assign
from .products import apply, dot
from .profile import apply_within, solve_profile
from .tolerances import BALANCED, STALLED

ITERATIONS = 40
"""Largest number of iterations of the proximal point method."""

STEPS = 40
"""Largest number of steps of Newton's method in an iteration, and of a line search."""


PATIENCE = 3
"""Iterations without progress after which r is made smaller, or the iteration ends."""

FINER = 0.1
"""Part of r that is used from there on, once: the distribution of loads has converged by then."""

INEXACT = 0.03
"""Tolerance of Newton's method, relative to the change of the previous iteration."""

FARTHEST = 5.0
"""Largest extrapolation, in changes of s."""

DRIFT, WAITS = 0.03, 8
"""Part of the largest impulse by which an inaccurate s may change it in an iteration, along impulses that
satisfy the law; else f does not change, and s is improved first, at most `WAITS` times."""

SLOPE = 0.1
"""Largest slope at the end of a line search, relative to that at its start."""


class VelocityProblem(NamedTuple):
    """The law for nc contacts, three rows (t₁, t₂, n) each, and for ns scalar rows, in m velocities.

    Attributes:
        mass: (m, m) M.
        inverse: (m, m) its inverse.
        values: (n, …) the nonzero entries of each row of J, with the same columns for all rows of a contact.
        columns: (n, …) their columns, in ascending order.
        counts: (n,) their numbers.
        free: (n,) u without impulses.
        friction: (nc,) coefficients of friction.
        lower: (ns,) lower bounds of scalar impulses.
        upper: (ns,) upper bounds of scalar impulses.
        compliance: (nc,) of the contacts, up to a factor.
    """

    mass: FloatRows
    inverse: FloatRows
    values: FloatRows
    columns: IntegerRows
    counts: Integers
    free: Floats
    friction: Floats
    lower: Floats
    upper: Floats
    compliance: Floats


class Iterate(NamedTuple):
    """Where the iteration stands.

    Attributes:
        w: (m,) velocities.
        u: (n,) u_free + J w.
        f: (n,) f⁺ of (16.3).
        shift: (nc,) s.
        momentum: (m,) M w.
        off: (m,) M w − Jᵀ f⁺.
    """

    w: Floats
    u: Floats
    f: Floats
    shift: Floats
    momentum: Floats
    off: Floats


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


@inlined
def slip(u, mu, shift):
    """Fill s (nc,) = μ|u_t|."""
    for i in range(len(mu)):
        shift[i] = mu[i] * length(u[3 * i], u[3 * i + 1])


@inlined
def extrapolate(u, mu, iteration, shift, last, gain):
    """Replace s (nc,) by the next one: that of u, and from the second iteration on extrapolated by a secant.

    Args:
        u: (n,) velocities.
        mu: (nc,) coefficients of friction.
        iteration: Its number.
        shift: (nc,) s.
        last: (nc,) μ|u_t| of the previous iteration; takes the present one.
        gain: (nc,) its difference from s; takes the present one.
    """
    along = across = 0.0
    for i in range(len(mu)):
        now = mu[i] * length(u[3 * i], u[3 * i + 1]) - shift[i]
        turn = now - gain[i]
        along += now * turn
        across += turn * turn
    part = along / across if iteration > 1 and across > 0.0 else 0.0
    part = min(max(part, -FARTHEST), 0.5)
    for i in range(len(mu)):
        now = mu[i] * length(u[3 * i], u[3 * i + 1])
        gain[i] = now - shift[i]
        shift[i] = max((1.0 - part) * now + part * last[i], 0.0)
        last[i] = now


@external
def impulses(u, shift, before, mu, lower, upper, r, out):
    """Fill out (n,) with f⁺ of (16.3) from u (n,), s (nc,) and f, `before` (n,)."""
    nc, nowhere = len(mu), np.empty((0, 2))
    for a in range(len(u)):
        out[a] = before[a] - u[a] / r[a]
    for i in range(nc):
        out[3 * i + 2] -= shift[i] / r[3 * i + 2]
        into_cone(out, 3 * i, mu[i], 0.0, nowhere, False)
    for i in range(len(lower)):
        out[3 * nc + i] = min(max(out[3 * nc + i], lower[i]), upper[i])


@inlined
def cone_derivative(z1, z2, z3, mu, d):
    """Fill d (3, 3) with ∂P at z of a contact."""
    for a in range(3):
        for b in range(3):
            d[a, b] = 0.0
    size = length(z1, z2)
    if size < mu * z3:  # sticks
        d[0, 0] = d[1, 1] = d[2, 2] = 1.0
    elif mu * size > -z3:  # slips
        s1, s2 = z1 / max(size, 1e-300), z2 / max(size, 1e-300)
        share = 1.0 / (1.0 + mu * mu)
        across = mu * share * (mu * size + z3) / max(size, 1e-300)
        d[0, 0] = share * mu * mu * s1 * s1 + across * s2 * s2
        d[1, 1] = share * mu * mu * s2 * s2 + across * s1 * s1
        d[0, 1] = d[1, 0] = (share * mu * mu - across) * s1 * s2
        d[0, 2] = d[2, 0] = share * mu * s1
        d[1, 2] = d[2, 1] = share * mu * s2
        d[2, 2] = share


@external
def fill_system(problem, start, r, u, shift, before, system):
    """Fill the upper triangle of the matrix of a step of Newton's method, M + Jᵀ (∂P/r) J.

    Args:
        problem: The `VelocityProblem`.
        start: (m,) first columns of the rows of M.
        r: (n,) of (16.3).
        u: (n,) velocities.
        shift: (nc,) s.
        before: (n,) f.
        system: (m, m) takes the matrix.
    """
    mass, _, values, columns, counts, _, mu, lower, upper, _ = problem
    m, nc = len(mass), len(mu)
    d = np.empty((3, 3))
    for a in range(m):
        for b in range(a, m):
            system[a, b] = mass[a, b] if start[b] <= a else 0.0
    for i in range(nc):
        j = 3 * i
        cone_derivative(
            before[j] - u[j] / r[j],
            before[j + 1] - u[j + 1] / r[j],
            before[j + 2] - (u[j + 2] + shift[i]) / r[j],
            mu[i],
            d,
        )
        if d[2, 2] == 0.0:
            continue
        for k in range(counts[j]):
            j0, j1, j2 = values[j, k] / r[j], values[j + 1, k] / r[j], values[j + 2, k] / r[j]
            t0 = j0 * d[0, 0] + j1 * d[1, 0] + j2 * d[2, 0]
            t1 = j0 * d[0, 1] + j1 * d[1, 1] + j2 * d[2, 1]
            t2 = j0 * d[0, 2] + j1 * d[1, 2] + j2 * d[2, 2]
            row = system[columns[j, k]]
            for o in range(k, counts[j]):
                row[columns[j, o]] += t0 * values[j, o] + t1 * values[j + 1, o] + t2 * values[j + 2, o]
    for i in range(len(lower)):
        j = 3 * nc + i
        if lower[i] < before[j] - u[j] / r[j] < upper[i]:
            for k in range(counts[j]):
                for o in range(k, counts[j]):
                    system[columns[j, k], columns[j, o]] += values[j, k] * values[j, o] / r[j]


@external
def balance(problem, start, r, before, now):
    """Fill u, f⁺, M w and M w − Jᵀ f⁺ of an `Iterate`; return the relative size of the last.

    Other arguments are those of `fill_system`.
    """
    mass, _, values, columns, counts, free, mu, lower, upper, _ = problem
    w, u, f, shift, momentum, out = now
    largest = square = 0.0
    rates(values, columns, counts, w, u)
    for a in range(len(u)):
        u[a] += free[a]
    impulses(u, shift, before, mu, lower, upper, r, f)
    apply_within(mass, start, w, momentum)
    for a in range(len(out)):
        out[a] = momentum[a]
        largest = max(largest, abs(out[a]))
    for a in range(len(f)):
        if f[a] != 0.0:
            for k in range(counts[a]):
                part = values[a, k] * f[a]
                out[columns[a, k]] -= part
                largest = max(largest, abs(part))
    for a in range(len(out)):
        square += out[a] * out[a]
    return math.sqrt(square) / max(largest, 1e-300)


@external
def length_of_step(problem, r, before, now, du, slope, curvature):
    """Return the length of a step, at most one, that minimizes the convex function.

    Args:
        problem: The `VelocityProblem`.
        r: (n,) of (16.3).
        before: (n,) f.
        now: The `Iterate` at its start; its f takes the impulses at the end.
        du: (n,) change of u over the whole step d.
        slope: dᵀM w at its start.
        curvature: dᵀM d.
    """
    mu, lower, upper, u, f, shift = problem.friction, problem.lower, problem.upper, now.u, now.f, now.shift
    trial = np.empty(len(u))
    start = slope - dot(du, f)
    low, high, at_low, at_high, share, side = 0.0, 1.0, start, 0.0, 1.0, 0
    for k in range(STEPS):
        for a in range(len(u)):
            trial[a] = u[a] + share * du[a]
        impulses(trial, shift, before, mu, lower, upper, r, f)
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
def find_profile(problem, start, last):
    """Fill the first columns of the rows of M (m,), and the last ones of the factor of M + JᵀJ (m,)."""
    mass, columns, counts = problem.mass, problem.columns, problem.counts
    m = len(mass)
    for a in range(m):
        start[a], last[a] = a, a
        for b in range(a):
            if mass[a, b] != 0.0:
                start[a] = b
                break
        for b in range(start[a], a):
            last[b] = max(last[b], a)
    for a in range(len(counts)):
        for k in range(counts[a]):
            last[columns[a, k]] = max(last[columns[a, k]], columns[a, counts[a] - 1])
    for a in range(1, m):
        if last[a - 1] >= a:
            last[a] = max(last[a], last[a - 1])


@external
def fill_compliances(problem, proximal, diagonal, given):
    """Fill the diagonal (n,) of W, for each contact the largest, and the r (n,) of (16.3)."""
    _, inverse, values, columns, counts, _, _, _, _, compliance = problem
    nc, softest, largest = len(compliance), 0.0, 0.0
    for a in range(len(given)):
        diagonal[a] = 0.0
        for k in range(counts[a]):
            row, total = inverse[columns[a, k]], 0.0
            for o in range(k):
                total += row[columns[a, o]] * values[a, o]
            diagonal[a] += values[a, k] * (2.0 * total + row[columns[a, k]] * values[a, k])
        given[a] = proximal * diagonal[a]
    for i in range(nc):
        j = 3 * i
        diagonal[j] = diagonal[j + 1] = diagonal[j + 2] = max(diagonal[j], diagonal[j + 1], diagonal[j + 2])
        largest, softest = max(largest, diagonal[j]), max(softest, compliance[i])
    for i in range(nc):
        for a in range(3 * i, 3 * i + 3):
            given[a] = proximal * largest * compliance[i] / softest


@inlined
def minimize(problem, profile, r, before, least, now, system):
    """Bring w to the minimum of the convex function for given s and f, by Newton's method.

    Its gradient is M w − Jᵀ f⁺, its second derivative M + Jᵀ (∂P/r) J.

    Args:
        problem: The `VelocityProblem`.
        profile: First columns (m,) and last ones (m,), see `find_profile`.
        r: (n,) of (16.3).
        before: (n,) f.
        least: Relative sizes of the gradient: at which rounding may stop the steps, and which is enough.
        now: The `Iterate`; all but its s changes.
        system: (m, m) is overwritten.
    """
    start, last = profile
    rounded, enough = least
    w, momentum, off = now.w, now.momentum, now.off
    m, reached = len(w), math.inf
    d, md, du = np.empty(m), np.empty(m), np.empty(len(r))
    for step in range(STEPS + 1):
        left = balance(problem, start, r, before, now)
        if step == STEPS or left <= enough or (left < 1e3 * rounded and left > 0.5 * reached):
            break
        reached = left
        fill_system(problem, start, r, now.u, now.shift, before, system)
        for a in range(m):
            d[a] = -off[a]
        solve_profile(system, last, d)
        rates(problem.values, problem.columns, problem.counts, d, du)
        apply_within(problem.mass, start, d, md)
        share = length_of_step(problem, r, before, now, du, dot(d, momentum), dot(d, md))
        for a in range(m):
            w[a] += share * d[a]


@inlined
def changes(mu, r, before, u, f, shift):
    """Return by how much an iteration changes impulses and s, and what an inaccurate s does to impulses.

    Args:
        mu: (nc,) coefficients of friction.
        r: (n,) of (16.3).
        before: (n,) f.
        u: (n,) velocities.
        f: (n,) f⁺.
        shift: (nc,) s.

    Returns:
        the largest of r|f⁺ − f| and of |μ|u_t| − s| [m/s]; whether the latter, over r, is too large a part of
        the largest impulse.
    """
    change = swing = pushed = drift = 0.0
    for a in range(len(f)):
        change, pushed = max(change, r[a] * abs(f[a] - before[a])), max(pushed, abs(f[a]))
    for i in range(len(mu)):
        lag = abs(mu[i] * length(u[3 * i], u[3 * i + 1]) - shift[i])
        swing = max(swing, lag)
        if f[3 * i + 2] > 0.0:
            drift = max(drift, lag / r[3 * i + 2])
    return max(change, swing), drift > DRIFT * pushed


@inlined
def residual_of(problem, diagonal, x, now):
    """Fill w = M⁻¹ Jᵀ x of an `Iterate` and what follows from it; return the residual of the law [m/s].

    It is W_aa|f⁺ − f|, with the diagonal (n,) of W as r; infinite if x (n,) is not finite.
    """
    w, u, f, shift, momentum, _ = now
    values, columns, counts, mu = problem.values, problem.columns, problem.counts, problem.friction
    for a in range(len(w)):
        momentum[a] = 0.0
    add_transposed(values, columns, counts, x, momentum)
    apply(problem.inverse, momentum, w)
    rates(values, columns, counts, w, u)
    for a in range(len(u)):
        u[a] += problem.free[a]
    slip(u, mu, shift)
    impulses(u, shift, x, mu, problem.lower, problem.upper, diagonal, f)
    missed = total = 0.0
    for a in range(len(u)):
        part = diagonal[a] * abs(f[a] - x[a])
        missed = max(missed, part)
        total += part
    return missed if math.isfinite(total) else math.inf


@declared(VelocityProblem, float, float, FLOATS, FLOATS, FLOATS, result=float)
@external
def solve_velocities(problem, proximal, accuracy, begin, w, x):
    """Fill x with impulses that satisfy the law.

    Args:
        problem: The `VelocityProblem`.
        proximal: The largest r, relative to the largest of W, see `tolerances.PROXIMAL`.
        accuracy: Part of u_free by which f⁺ − f may change velocities at the end; see `tolerances.SETTLED`.
        begin: (m,) initial change of the velocities; takes that of the first iteration, which is the best
            start for a nearly equal problem.
        w: (m,) takes the change by the impulses.
        x: (n,) takes the impulses. If several satisfy the law they are nearly those of least norm in the
            metric of the compliances.

    Returns:
        The residual of the law, relative to u_free; infinite if the iteration has diverged.
    """
    free, mu = problem.free, problem.friction
    n, m, nc, size = len(free), len(w), len(mu), 0.0
    for a in range(n):
        x[a] = 0.0
        size = max(size, abs(free[a]))
    if size == 0.0:
        for a in range(m):
            w[a] = begin[a] = 0.0
        return 0.0
    start, last = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    find_profile(problem, start, last)
    diagonal, r, system = np.empty(n), np.empty(n), np.empty((m, m))
    fill_compliances(problem, proximal, diagonal, r)
    u, f, shift, slipped, gain = np.empty(n), np.empty(n), np.zeros(nc), np.zeros(nc), np.zeros(nc)
    now = Iterate(w, u, f, shift, np.empty(m), np.empty(m))
    assign(w, begin)
    rates(problem.values, problem.columns, problem.counts, w, u)
    for a in range(n):
        u[a] += free[a]
    balanced = max(BALANCED, 0.1 * accuracy)
    lowest, since, reached, waited, finer = math.inf, 0, 1.0, 0, False
    for iteration in range(ITERATIONS):
        extrapolate(u, mu, iteration, shift, slipped, gain)
        minimize(problem, (start, last), r, x, (balanced, max(balanced, INEXACT * reached)), now, system)
        if iteration == 0:
            assign(begin, w)
        change, drifts = changes(mu, r, x, u, f, shift)
        reached = change / size
        if drifts and waited < WAITS:
            waited += 1
            continue
        waited = 0
        assign(x, f)
        since = since + 1 if reached > 0.5 * lowest else 0
        lowest = min(lowest, reached)
        if reached <= accuracy:
            break
        if since >= PATIENCE and reached <= STALLED:
            if finer:
                break
            finer, lowest, since = True, math.inf, 0
            for a in range(n):
                r[a] *= FINER
    return residual_of(problem, diagonal, x, now) / size
