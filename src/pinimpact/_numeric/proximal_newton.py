"""Coulomb's law where there are more rows than velocities: Newton's method in the velocities. (theory.md, 16)

Of the impulses f of one iteration the next ones are

    f⁺ = P(f − (u + s n)/r),   u = u_free + J w,   M w = Jᵀ f⁺,                                         (16.3)

P the projection onto the cones of the contacts and the bounds of the scalar rows, s = μ|u_t|, r > 0 a
compliance for each contact or row. Where they no longer change they obey the law, whatever r: this is the
proximal point method (R. T. Rockafellar, SIAM J. Control Optim. 14, 1976). With s given, w is where a convex
function is least. Newton's method with a line search finds it in a few steps, for M + Jᵀ (∂P/r) J is definite
whatever the rank of J. The matrix has the size of w, and zeros where bodies do not touch.
"""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.jit import external, inlined
from .coulomb_problem import into_cone
from .lu import factorize
from .lu import substitute as solve_factored
from .products import apply, dot

SYSTEM = (FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
"""Types: M, its inverse, J, u_free, friction, bounds, compliances, and the impulses."""

PROXIMAL = 1e-5
"""The largest r, in parts of the largest of W: more of it takes more iterations, less of it longer ones."""

ITERATIONS = 40
"""Of the proximal point method, at most."""

EXPLICIT = 6
"""Iterations with s of the velocities before. Then every other one has s of its own velocities: its equations
are not those of a least value, but s cannot swing."""

SOFTER, SOFT = 20, 100.0
"""Until this iteration those after `EXPLICIT` have r larger by this factor: s then changes less at a time."""

STEPS = 40
"""Of Newton's method in an iteration, and of a line search, at most."""

BALANCED = 1e-11
"""Part of the largest momentum that M w − Jᵀf may be off after Newton's method."""

ENOUGH = 1e-11
"""Part of u_free that f⁺ − f may change velocities by, at the end."""

SLOPE = 1e-3
"""Part of the slope at the start of a line search that may be left at its end."""


@inlined
def rates(jacobian, columns, counts, w, out):
    """Fill out (n,) with J w."""
    for a in range(len(out)):
        total = 0.0
        for k in range(counts[a]):
            total += jacobian[a, columns[a, k]] * w[columns[a, k]]
        out[a] = total


@inlined
def slip(u, mu, shift):
    """Fill s (nc,) = μ|u_t|."""
    for i in range(len(mu)):
        shift[i] = mu[i] * math.hypot(u[3 * i], u[3 * i + 1])


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
    length = math.hypot(z1, z2)
    if length <= mu * z3:  # sticks
        d[0, 0] = d[1, 1] = d[2, 2] = 1.0
    elif mu * length > -z3:  # slips
        s1, s2 = z1 / max(length, 1e-300), z2 / max(length, 1e-300)
        share = 1.0 / (1.0 + mu * mu)
        across = mu * share * (mu * length + z3) / max(length, 1e-300)
        d[0, 0] = share * mu * mu * s1 * s1 + across * s2 * s2
        d[1, 1] = share * mu * mu * s2 * s2 + across * s1 * s1
        d[0, 1] = d[1, 0] = (share * mu * mu - across) * s1 * s2
        d[0, 2] = d[2, 0] = share * mu * s1
        d[1, 2] = d[2, 1] = share * mu * s2
        d[2, 2] = share


@external
def fill_system(mass, jacobian, mu, lower, upper, r, u, shift, before, columns, counts, implicit, system):
    """Fill the matrix of a step of Newton's method, M + Jᵀ (∂P/r) J, and with ∂s/∂u if it is `implicit`."""
    m, nc = len(mass), len(mu)
    d = np.empty((3, 3))
    for a in range(m):
        for b in range(m):
            system[a, b] = mass[a, b]
    for i in range(nc):
        j = 3 * i
        cone_derivative(
            before[j] - u[j] / r[j],
            before[j + 1] - u[j + 1] / r[j],
            before[j + 2] - (u[j + 2] + shift[i]) / r[j],
            mu[i],
            d,
        )
        speed = math.hypot(u[j], u[j + 1])
        if implicit and speed > 0.0:
            for a in range(3):
                d[a, 0] += d[a, 2] * mu[i] * u[j] / speed
                d[a, 1] += d[a, 2] * mu[i] * u[j + 1] / speed
        for k in range(counts[j]):
            c = columns[j, k]
            j0, j1, j2 = jacobian[j, c] / r[j], jacobian[j + 1, c] / r[j], jacobian[j + 2, c] / r[j]
            t0 = j0 * d[0, 0] + j1 * d[1, 0] + j2 * d[2, 0]
            t1 = j0 * d[0, 1] + j1 * d[1, 1] + j2 * d[2, 1]
            t2 = j0 * d[0, 2] + j1 * d[1, 2] + j2 * d[2, 2]
            for o in range(counts[j]):
                e = columns[j, o]
                system[c, e] += t0 * jacobian[j, e] + t1 * jacobian[j + 1, e] + t2 * jacobian[j + 2, e]
    for i in range(len(lower)):
        j = 3 * nc + i
        if lower[i] < before[j] - u[j] / r[j] < upper[i]:
            for k in range(counts[j]):
                c = columns[j, k]
                for o in range(counts[j]):
                    e = columns[j, o]
                    system[c, e] += jacobian[j, c] * jacobian[j, e] / r[j]


@external
def solve_profile(system, first, x):
    """Replace x by the solution of a definite system, whose row a begins at first[a], and that by L."""
    for a in range(len(x)):
        for b in range(first[a], a + 1):
            total = system[a, b]
            for k in range(max(first[a], first[b]), b):
                total -= system[a, k] * system[b, k]
            system[a, b] = math.sqrt(max(total, 1e-300)) if a == b else total / system[b, b]
        for k in range(first[a], a):
            x[a] -= system[a, k] * x[k]
        x[a] /= system[a, a]
    for a in range(len(x) - 1, -1, -1):
        x[a] /= system[a, a]
        for k in range(first[a], a):
            x[k] -= system[a, k] * x[a]


@external
def balance(
    mass,
    jacobian,
    free,
    mu,
    lower,
    upper,
    r,
    columns,
    counts,
    before,
    implicit,
    w,
    shift,
    u,
    f,
    momentum,
    out,
):
    """Fill u, f⁺, M w and M w − Jᵀ f⁺, and s if it is `implicit`; return how large the last is, in parts."""
    largest = square = 0.0
    rates(jacobian, columns, counts, w, u)
    for a in range(len(u)):
        u[a] += free[a]
    if implicit:
        slip(u, mu, shift)
    impulses(u, shift, before, mu, lower, upper, r, f)
    apply(mass, w, momentum)
    for a in range(len(out)):
        out[a] = momentum[a]
        largest = max(largest, abs(out[a]))
    for a in range(len(f)):
        for k in range(counts[a]):
            part = jacobian[a, columns[a, k]] * f[a]
            out[columns[a, k]] -= part
            largest = max(largest, abs(part))
    for a in range(len(out)):
        square += out[a] * out[a]
    return math.sqrt(square) / max(largest, 1e-300)


@external
def length_of_step(mu, lower, upper, r, before, shift, u, du, f, slope, curvature):
    """Return the part of a step after which the convex function is least, one at most.

    u (n,) changes by du over the whole step d; `slope` is dᵀM w at its start, `curvature` dᵀM d.
    """
    trial = np.empty(len(u))
    start, low, high, at_low, at_high, share = 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    for k in range(STEPS):
        for a in range(len(u)):
            trial[a] = u[a] + share * du[a]
        impulses(trial, shift, before, mu, lower, upper, r, f)
        now = slope + share * curvature - dot(du, f)
        if k == 0:
            start = at_low = now
            share = 1.0
            continue
        if abs(now) <= SLOPE * abs(start) or (k == 1 and now <= 0.0):
            break
        if now > 0.0:
            high, at_high = share, now
        else:
            low, at_low = share, now
        share = low - (high - low) * at_low / (at_high - at_low)
        share = min(max(share, low + 0.05 * (high - low)), high - 0.05 * (high - low))
    return share


@external
def find_columns(mass, jacobian, contacts, columns, counts, first):
    """Fill the columns of J that are not zero, a contact's rows together, and where rows of M + JᵀJ begin."""
    n, m = jacobian.shape
    for a in range(m):
        first[a] = a
        for b in range(a - 1, -1, -1):
            if mass[a, b] != 0.0:
                first[a] = b
    for a in range(n):
        start = 3 * (a // 3) if a < 3 * contacts else a
        end = start + 3 if a < 3 * contacts else a + 1
        counts[a] = 0
        for c in range(m):
            for b in range(start, end):
                if jacobian[b, c] != 0.0:
                    columns[a, counts[a]] = c
                    counts[a] += 1
                    break
        for k in range(counts[a]):
            first[columns[a, k]] = min(first[columns[a, k]], columns[a, 0])


@external
def fill_compliances(inverse, jacobian, columns, counts, compliance, diagonal, given):
    """Fill the diagonal (n,) of W, of each contact the largest, and the r (n,) of (16.3)."""
    nc, softest, largest = len(compliance), 0.0, 0.0
    for a in range(len(given)):
        diagonal[a] = 0.0
        for k in range(counts[a]):
            c = columns[a, k]
            for o in range(counts[a]):
                e = columns[a, o]
                diagonal[a] += jacobian[a, c] * inverse[c, e] * jacobian[a, e]
        given[a] = PROXIMAL * diagonal[a]
    for i in range(nc):
        j = 3 * i
        diagonal[j] = diagonal[j + 1] = diagonal[j + 2] = max(diagonal[j], diagonal[j + 1], diagonal[j + 2])
        largest, softest = max(largest, diagonal[j]), max(softest, compliance[i])
    for i in range(nc):
        for a in range(3 * i, 3 * i + 3):
            given[a] = PROXIMAL * largest * compliance[i] / softest


@declared(*SYSTEM, result=float)
@external
def solve_velocities(mass, inverse, jacobian, free, mu, lower, upper, compliance, x):
    """Fill x with impulses that obey the law.

    Args:
        mass: (m, m) M.
        inverse: (m, m) its inverse.
        jacobian: (n, m) J of nc contacts, three rows (t₁, t₂, n) each, then of ns scalar rows.
        free: (n,) u without impulses.
        mu: (nc,) coefficients of friction.
        lower: (ns,) least scalar impulses.
        upper: (ns,) largest scalar impulses.
        compliance: (nc,) of the contacts, up to a factor.
        x: (n,) impulses with whose velocities to begin; takes those found. Where several obey the law they
            are nearly those of least norm in the metric of the compliances.

    Returns:
        How far they are from the law, in parts of u_free.
    """
    n, m = jacobian.shape
    nc = len(mu)
    columns, counts = np.empty((n, m), dtype=np.int64), np.empty(n, dtype=np.int64)
    first, order = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    find_columns(mass, jacobian, nc, columns, counts, first)
    diagonal, given, r = np.empty(n), np.empty(n), np.empty(n)
    fill_compliances(inverse, jacobian, columns, counts, compliance, diagonal, given)
    u, f, du, shift = np.empty(n), np.empty(n), np.empty(n), np.zeros(nc)
    w, off, d, trial, md = np.empty(m), np.zeros(m), np.empty(m), np.empty(m), np.empty(m)
    momentum, system = np.empty(m), np.empty((m, m))
    size = 0.0
    for a in range(n):
        for k in range(counts[a]):
            off[columns[a, k]] += jacobian[a, columns[a, k]] * x[a]
        x[a] = 0.0
        size = max(size, abs(free[a]))
    if size == 0.0:
        return 0.0
    apply(inverse, off, w)
    rates(jacobian, columns, counts, w, u)
    for a in range(n):
        u[a] += free[a]
    for iteration in range(ITERATIONS):
        softer = SOFT if EXPLICIT <= iteration < SOFTER else 1.0
        for a in range(n):
            r[a] = softer * given[a]
        implicit = iteration >= EXPLICIT and iteration % 2 == 0
        slip(u, mu, shift)
        before = math.inf
        for _ in range(STEPS):
            now = balance(
                *(mass, jacobian, free, mu, lower, upper, r, columns, counts, x, implicit),
                *(w, shift, u, f, momentum, off),
            )
            if now <= BALANCED or (now < 1e3 * BALANCED and now > 0.5 * before):
                break
            before = now
            fill_system(
                *(mass, jacobian, mu, lower, upper, r, u, shift, x, columns, counts, implicit, system)
            )
            for a in range(m):
                d[a] = -off[a]
            share = 1.0
            if implicit:
                if not factorize(system, order):
                    break
                solve_factored(system, order, d)
                while share > SLOPE:
                    for a in range(m):
                        trial[a] = w[a] + share * d[a]
                    fallen = balance(
                        *(mass, jacobian, free, mu, lower, upper, r, columns, counts, x, implicit),
                        *(trial, shift, u, f, momentum, off),
                    )
                    if fallen < now:
                        break
                    share *= 0.5
                if share <= SLOPE:
                    break
            else:
                solve_profile(system, first, d)
                rates(jacobian, columns, counts, d, du)
                apply(mass, d, md)
                share = length_of_step(mu, lower, upper, r, x, shift, u, du, f, dot(d, momentum), dot(d, md))
            for a in range(m):
                w[a] += share * d[a]
        change = swing = 0.0
        balance(
            *(mass, jacobian, free, mu, lower, upper, r, columns, counts, x, implicit),
            *(w, shift, u, f, momentum, off),
        )
        for a in range(n):
            change = max(change, r[a] * abs(f[a] - x[a]))
            x[a] = f[a]
        for i in range(nc):
            swing = max(swing, abs(mu[i] * math.hypot(u[3 * i], u[3 * i + 1]) - shift[i]))
        if change <= ENOUGH * size and swing <= ENOUGH * size:
            break
    slip(u, mu, shift)
    impulses(u, shift, x, mu, lower, upper, diagonal, f)
    missed = 0.0
    for a in range(n):
        missed = max(missed, diagonal[a] * abs(f[a] - x[a]))
    return missed / size
