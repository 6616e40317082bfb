"""Small convex programs over half-lines and second-order cones, by a primal-dual interior-point method.

    minimise ½ xᵀP x + cᵀx   with   s = h − G x in K,

where K consists of half-lines, then of cones s₀ ≥ |(s₁, …)|. Search directions are those of Nesterov and Todd
with Mehrotra's corrector. (L. Vandenberghe, The CVXOPT linear and quadratic cone program solvers, 2010)

Arguments of several kernels: `lines` is the number of half-lines, `sizes` (k,) the dimensions of the cones;
β, v and λ define the scaling W, see `scaling`.
"""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .loops import assign, ones
from .tolerances import EXACT, NOISE, TINY

CONE = np.int64(3)
"""Dimension of a friction cone."""

MAX_ITERATIONS = 60
"""Largest number of iterations; only badly scaled programs reach it."""

STEP = 0.99
"""Step length relative to the longest step inside the cone."""


@inlined
def _beyond_first(x, y, start, size):
    """Return xᵀy over the entries of a cone except its first one."""
    total = 0.0
    for i in range(start + 1, start + size):
        total += x[i] * y[i]
    return total


@inlined
def scaling(lines, sizes, s, z, beta, v, lam):
    """Fill the Nesterov–Todd scaling W at (s, z), as β and v, and λ = W z; return False outside the cone."""
    for i in range(lines):
        if not (s[i] > 0.0 and z[i] > 0.0):
            return False
        v[i] = math.sqrt(s[i] / z[i])
        lam[i] = math.sqrt(s[i] * z[i])
    start = lines
    for k in range(len(sizes)):
        n = sizes[k]
        ns, nz = math.sqrt(_beyond_first(s, s, start, n)), math.sqrt(_beyond_first(z, z, start, n))
        as2 = (s[start] - ns) * (s[start] + ns)
        az2 = (z[start] - nz) * (z[start] + nz)
        if not (as2 > 0.0 and az2 > 0.0 and s[start] > 0.0 and z[start] > 0.0):
            return False
        a_s, a_z = math.sqrt(as2), math.sqrt(az2)
        dot = 0.0
        for i in range(start, start + n):
            dot += (s[i] / a_s) * (z[i] / a_z)
        gamma = math.sqrt(0.5 * (1.0 + dot))
        w0 = 0.5 / gamma * (s[start] / a_s + z[start] / a_z)
        root = math.sqrt(2.0 * (w0 + 1.0))
        v[start] = (w0 + 1.0) / root
        for i in range(start + 1, start + n):
            v[i] = 0.5 / gamma * (s[i] / a_s - z[i] / a_z) / root
        beta[k] = math.sqrt(a_s / a_z)
        start += n
    scale(lines, sizes, beta, v, z, lam, False)
    return True


@inlined
def scale(lines, sizes, beta, v, x, out, inverse):
    """Fill out with W x, or with W⁻¹ x."""
    for i in range(lines):
        out[i] = x[i] / v[i] if inverse else x[i] * v[i]
    start = lines
    for k in range(len(sizes)):
        n = sizes[k]
        dot = v[start] * x[start]
        for i in range(start + 1, start + n):
            dot += -v[i] * x[i] if inverse else v[i] * x[i]
        b = 1.0 / beta[k] if inverse else beta[k]
        out[start] = b * (2.0 * v[start] * dot - x[start])
        for i in range(start + 1, start + n):
            vi = -v[i] if inverse else v[i]
            out[i] = b * (2.0 * vi * dot + x[i])
        start += n


@inlined
def product(lines, sizes, x, y, out):
    """Fill out with the Jordan product x ∘ y."""
    for i in range(lines):
        out[i] = x[i] * y[i]
    start = lines
    for k in range(len(sizes)):
        n = sizes[k]
        dot = 0.0
        for i in range(start, start + n):
            dot += x[i] * y[i]
        x0, y0 = x[start], y[start]
        for i in range(start + 1, start + n):
            out[i] = x0 * y[i] + y0 * x[i]
        out[start] = dot
        start += n


@inlined
def quotient(lines, sizes, lam, y, out):
    """Fill out with the solution x of λ ∘ x = y."""
    for i in range(lines):
        out[i] = y[i] / lam[i]
    start = lines
    for k in range(len(sizes)):
        n = sizes[k]
        norm, dot = math.sqrt(_beyond_first(lam, lam, start, n)), _beyond_first(lam, y, start, n)
        l0, y0 = lam[start], y[start]
        det = (l0 - norm) * (l0 + norm)
        x0 = (l0 * y0 - dot) / det
        for i in range(start + 1, start + n):
            out[i] = (y[i] - x0 * lam[i]) / l0
        out[start] = x0
        start += n


@inlined
def longest_step(lines, sizes, lam, d):
    """Return 1/α, α the largest with λ + α d in the cone; 0 if it is unbounded, infinite if λ is outside."""
    worst = 0.0
    for i in range(lines):
        worst = max(worst, -d[i] / lam[i])
    start = lines
    for k in range(len(sizes)):
        n = sizes[k]
        norm = math.sqrt(_beyond_first(lam, lam, start, n))
        if not lam[start] > norm:  # λ has left the cone by rounding
            return math.inf
        a = math.sqrt((lam[start] - norm) * (lam[start] + norm))
        rho = lam[start] / a * d[start]
        for i in range(start + 1, start + n):
            rho -= lam[i] / a * d[i]
        total = 0.0
        share = (rho + d[start]) / (lam[start] / a + 1.0)
        for i in range(start + 1, start + n):
            total += (d[i] - share * lam[i] / a) ** 2
        worst = max(worst, (math.sqrt(total) - rho) / a)
        start += n
    return worst


@inlined
def cholesky(matrix):
    """Replace a positive definite matrix by its Cholesky factor, with large pivots instead of lost ones."""
    n = len(matrix)
    whole, column = np.empty(n), np.empty(n)
    largest = TINY
    for i in range(n):
        whole[i] = matrix[i, i]
        largest = max(largest, whole[i])
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > EXACT * n * whole[k]:
            pivot = 1e64 * largest  # lost to rounding: this makes the unknown zero
        root = math.sqrt(pivot)
        matrix[k, k] = root
        for i in range(k + 1, n):
            matrix[i, k] /= root
            column[i] = matrix[i, k]
        for i in range(k + 1, n):
            part = column[i]
            for j in range(k + 1, i + 1):
                matrix[i, j] -= part * column[j]


@inlined
def substitute(lower, x):
    """Replace x by the solution y of lower lowerᵀ y = x."""
    n = len(x)
    for i in range(n):
        for j in range(i):
            x[i] -= lower[i, j] * x[j]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= lower[j, i] * x[j]
        x[i] /= lower[i, i]


@inlined
def lift(lines, sizes, x, by):
    """Add `by` times the axis of the cone to x."""
    for i in range(lines):
        x[i] += by
    start = lines
    for size in sizes:
        x[start] += by
        start += size


@inlined
def outside(lines, sizes, x):
    """Return the distance of x from the cone along its axis; negative inside."""
    worst = -math.inf
    for i in range(lines):
        worst = max(worst, -x[i])
    start = lines
    for size in sizes:
        worst = max(worst, math.sqrt(_beyond_first(x, x, start, size)) - x[start])
        start += size
    return worst


@inlined
def add_squares(rows, out):
    """Add rowsᵀ rows to the lower triangle of out (n, n), for sparse rows (m, n)."""
    m, n = rows.shape
    places = np.empty(n, dtype=np.int64)
    for k in range(m):
        count = 0
        for j in range(n):
            if rows[k, j] != 0.0:
                places[count] = j
                count += 1
        for a in range(count):
            i = places[a]
            part = rows[k, i]
            for b in range(a + 1):
                out[i, places[b]] += part * rows[k, places[b]]


@inlined
def add_transposed(rows, x, out):
    """Add rowsᵀ x, for rows (m, n), to out (n,)."""
    m, n = rows.shape
    for k in range(m):
        part = x[k]
        for i in range(n):
            out[i] += rows[k, i] * part


@inlined
def _residuals(P, c, G, h, x, s, z, rx, rz):
    """Fill rx (n,) with P x + Gᵀz + c, rz (m,) with G x + s − h; return sᵀz and the largest residual."""
    gap = residual = 0.0
    for i in range(len(s)):
        gap += s[i] * z[i]
    for i in range(len(x)):
        total = c[i]
        for j in range(len(x)):
            total += P[i, j] * x[j]
        rx[i] = total
    add_transposed(G, z, rx)
    for i in range(len(x)):
        residual = max(residual, abs(rx[i]))
    for i in range(len(s)):
        total = s[i] - h[i]
        for j in range(len(x)):
            total += G[i, j] * x[j]
        rz[i] = total
        residual = max(residual, abs(total))
    return gap, residual


@inlined
def _fill_system(P, G, lines, sizes, beta, v, scaled, lower):
    """Fill W⁻¹G (m, n) and the Cholesky factor of P + GᵀW⁻²G."""
    m, n = G.shape
    column, work = np.empty(m), np.empty(m)
    for j in range(n):
        for i in range(m):
            column[i] = G[i, j]
        scale(lines, sizes, beta, v, column, work, True)
        for i in range(m):
            scaled[i, j] = work[i]
    for i in range(n):
        for j in range(i + 1):
            lower[i, j] = P[i, j]
    add_squares(scaled, lower)
    cholesky(lower)


@inlined
def _fill_directions(lines, sizes, scaling, system, residuals, gap, room, ds, dz, dx):
    """Fill the search direction dx (n,), and ds, dz (m,) in scaled axes; return 1/(longest step).

    `scaling` is (β, v, λ), `system` the result of `_fill_system`, `residuals` is (rx, rz), gap = sᵀz, and
    room (3, m) is a scratch array.
    """
    beta, v, lam = scaling
    scaled, lower = system
    rx, rz = residuals
    m, n = scaled.shape
    right, work, reduced = room[0], room[1], room[2]
    centring = shortest = 0.0
    for corrected in range(2):
        # right = λ⋄(σμe − λ∘λ − ds∘dz), the last with the directions of the first pass
        product(lines, sizes, lam, lam, work)
        if corrected == 1:
            product(lines, sizes, ds, dz, right)
        for i in range(m):
            work[i] = -work[i] - right[i] if corrected == 1 else -work[i]
        lift(lines, sizes, work, centring * gap / (lines + len(sizes)))
        quotient(lines, sizes, lam, work, right)
        # P dx + GᵀW⁻¹dz = −rx,  W⁻¹G dx − dz = −W⁻¹rz − right, with dz = W δz and ds = W⁻¹δs
        scale(lines, sizes, beta, v, rz, work, True)
        for i in range(m):
            reduced[i] = -work[i] - right[i]
        for j in range(n):
            dx[j] = -rx[j]
        add_transposed(scaled, reduced, dx)
        substitute(lower, dx)
        for i in range(m):
            total = -reduced[i]
            for j in range(n):
                total += scaled[i, j] * dx[j]
            dz[i] = total
            ds[i] = right[i] - total
        shortest = max(longest_step(lines, sizes, lam, ds), longest_step(lines, sizes, lam, dz))
        if corrected == 0:
            centring = (1.0 - 1.0 / max(shortest, 1.0)) ** 3
    return shortest


@inlined
def _add_scaled(lines, sizes, beta, v, step, direction, inverse, work, x):
    """Add a step along a direction (m,) in scaled axes to x (m,); work (m,) is a scratch array."""
    scale(lines, sizes, beta, v, direction, work, inverse)
    for i in range(len(x)):
        x[i] += step * work[i]


@declared(FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, int, INTEGERS, float, FLOATS, FLOATS, FLOATS)
@external
def cone_program(P, c, G, h, lines, sizes, tolerance, x, s, z):
    """Solve a cone program for x (n,), s = h − G x (m,) and multipliers z (m,), P x + Gᵀz + c = 0.

    P (n, n) is positive semidefinite. The tolerance of the gap sᵀz, and of the equations as far as rounding
    allows, is absolute: scale the problem to order one. Returns the larger of the gap and the residual of the
    equations, which is above the tolerance if the iteration has stopped early.
    """
    m, n = G.shape
    beta, v, lam = ones(len(sizes)), np.zeros(m), np.empty(m)
    scaled, lower, room = np.empty((m, n)), np.empty((n, n)), np.empty((3, m))
    rx, rz, dx, ds, dz = np.empty(n), np.empty(m), np.empty(n), np.empty(m), np.empty(m)
    for i in range(n):
        x[i] = 0.0
    for i in range(m):
        s[i], z[i] = h[i], 0.0
    lift(lines, sizes, s, 1.0 + max(outside(lines, sizes, s), 0.0))
    lift(lines, sizes, z, 1.0)
    best = math.inf
    best_x, best_s, best_z = np.empty(n), np.empty(m), np.empty(m)
    for _ in range(MAX_ITERATIONS):
        answer_signals()
        gap, residual = _residuals(P, c, G, h, x, s, z, rx, rz)
        accuracy = max(gap, residual) if residual > NOISE else gap
        if accuracy < best:
            best = accuracy
            assign(best_x, x)
            assign(best_s, s)
            assign(best_z, z)
        if accuracy <= tolerance or not scaling(lines, sizes, s, z, beta, v, lam):
            break
        _fill_system(P, G, lines, sizes, beta, v, scaled, lower)
        shortest = _fill_directions(
            lines, sizes, (beta, v, lam), (scaled, lower), (rx, rz), gap, room, ds, dz, dx
        )
        if not shortest < math.inf:
            break
        step = STEP / max(shortest, STEP)
        for i in range(n):
            x[i] += step * dx[i]
        _add_scaled(lines, sizes, beta, v, step, ds, False, room[0], s)
        _add_scaled(lines, sizes, beta, v, step, dz, True, room[0], z)
    assign(x, best_x)
    assign(s, best_s)
    assign(z, best_z)
    return best
