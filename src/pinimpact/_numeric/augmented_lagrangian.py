"""Coulomb's law with more rows than velocities, by the method of augmented Lagrangians. (theory.md, 16)

A fixed point f⁺ = f of (16.3), see `augmented_newton`, satisfies the law for any r. From f = 0 the first f⁺
are the impulses of contacts with compliances r; each further iteration reduces u by a factor of about r/W.
"""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_STACK, FLOATS, declared
from .._compile.jit import external, inlined
from .augmented_newton import (
    Iterate,
    VelocityProblem,
    add_transposed,
    find_profile,
    impulses,
    rates,
    solve_compliances,
)
from .loops import assign, filled, largest
from .products import add
from .profile import apply_within
from .tolerances import RANK, STALLED, TINY

ITERATIONS = 60
"""Largest number of iterations of (16.3)."""

PATIENCE = 8
"""Number of successive iterations without halving of the change after which the method may end."""

FINER = 0.1
"""Factor of r after an iteration that hardly reduces the change of f, if the last factor has halved it."""

QUICK, HALF = 0.2, 0.5
"""Factors by which an iteration is to reduce the change of f, before and after r is first reduced. A smaller
r takes fewer iterations, but may make Newton's method fail."""


@external
def fill_compliances(problem, part, diagonal, given):
    """Fill the diagonal (n,) of W, for each contact its largest entry, and the compliances r, given (n,).

    The largest r of a contact is `part` times the largest diagonal entry of W of contacts; without contacts r
    is in proportion to the diagonal. The diagonal of rows that no impulse moves is replaced by the largest.
    """
    _, inverse, _, values, columns, counts, _, _, compliance = problem
    nc, n, softest, largest = len(compliance), len(given), 0.0, 0.0
    for a in range(n):
        diagonal[a] = 0.0
        for k in range(counts[a]):
            row, total = inverse[columns[a, k]], 0.0
            for o in range(k):
                total += row[columns[a, o]] * values[a, o]
            diagonal[a] += values[a, k] * (2.0 * total + row[columns[a, k]] * values[a, k])
    for i in range(nc):
        j = 3 * i
        diagonal[j] = diagonal[j + 1] = diagonal[j + 2] = max(diagonal[j], diagonal[j + 1], diagonal[j + 2])
        softest = max(softest, compliance[i])
    for a in range(3 * nc if nc > 0 else n):
        largest = max(largest, diagonal[a])
    for a in range(n):
        if diagonal[a] <= RANK * largest:
            diagonal[a] = largest if largest > 0.0 else 1.0
        given[a] = part * diagonal[a]
        if nc > 0:
            given[a] = part * max(largest, TINY) * (compliance[a // 3] if a < 3 * nc else 1.0) / softest


@inlined
def iterate_of(problem, w, f):
    """Return an `Iterate` with arrays w (m,) and f (n,), the others uninitialized."""
    m, scale = len(w), np.empty(len(w))
    for a in range(m):
        scale[a] = 1.0 / math.sqrt(problem.mass[a, a])
    return Iterate(w, np.empty(len(f)), f, np.empty(m), np.empty(m), scale)


@inlined
def residual_of(problem, diagonal, x, now):
    """Fill an `Iterate` with w = M⁻¹ Jᵀ x and its u and f⁺; return the residual of Coulomb's law [m/s].

    The residual is max W_aa|f⁺ − x| with r = W_aa, the `diagonal` (n,); infinite if x (n,) is not finite.
    """
    w, u, f, momentum, _, _ = now
    values, columns, counts = problem.values, problem.columns, problem.counts
    filled(momentum, 0.0)
    add_transposed(values, columns, counts, x, momentum)
    apply_within(problem.inverse, problem.start, momentum, w)
    rates(values, columns, counts, w, u)
    add(u, 1.0, problem.free)
    impulses(problem.law, u, x, diagonal, f)
    worst = total = 0.0
    for a in range(len(u)):
        part = diagonal[a] * abs(f[a] - x[a])
        worst = max(worst, part)
        total += part
    return worst if math.isfinite(total) else math.inf


@external
def iterate(problem, profile, r, accuracy, size, begin, x, course, now):
    """Iterate (16.3) from x = 0 until x hardly changes; fill x with the iterate of least change.

    Args:
        problem: The `VelocityProblem`.
        profile: See `fill_system`.
        r: (n,) compliances at the start; overwritten with the last ones.
        accuracy: See `solve_velocities`.
        size: The largest |u_free|.
        begin: See `solve_velocities`.
        x: (n,) zeros; overwritten with the impulses.
        course: See `solve_velocities`.
        now: The `Iterate`, whose w is the initial guess.
    """
    n, m, w, f, least = len(x), len(begin), now.w, now.f, 0.1 * accuracy
    system, factored, taken, slow = np.empty((m, m)), False, 0, 0
    best, best_w = np.zeros(n), np.zeros(m)
    smallest, best_scale, best_taken = math.inf, 1.0, 0  # the least change, its r, and its iteration
    lowest, earlier = math.inf, math.inf  # the least change with this r, and with the one before
    scale, failed = 1.0, 0.0  # of r, and that with which Newton's method has failed
    for iteration in range(ITERATIONS):
        factored, solved = solve_compliances(problem, profile, r, x, least, now, system, factored)
        if not solved and iteration == 0:  # from a useless `begin`
            filled(w, 0.0)
            factored = False
            continue
        if not solved and scale < best_scale:
            for a in range(n):
                r[a] *= best_scale / scale
            failed, scale, taken, lowest = scale, best_scale, best_taken, math.inf
            assign(x, best)
            assign(w, best_w)
            factored, slow = False, 0
            continue
        if taken == 0:
            assign(begin, w)
        reached = 0.0
        for a in range(n):
            reached = max(reached, r[a] * abs(f[a] - x[a]) / size)
        assign(x, f)
        if taken < course.shape[1]:
            assign(course[0, taken], r)
            assign(course[1, taken], f)
        taken += 1
        if reached < smallest:
            smallest, best_scale, best_taken = reached, scale, taken
            assign(best, f)
            assign(best_w, w)
        slow = slow + 1 if reached > HALF * lowest else 0
        if reached <= accuracy or (slow >= PATIENCE and reached <= STALLED):
            break
        enough = QUICK if scale == 1.0 else HALF
        if scale * FINER > failed and reached > enough * lowest and lowest < HALF * earlier:
            earlier, lowest, slow, factored = lowest, math.inf, 0, False
            scale *= FINER
            for a in range(n):
                r[a] *= FINER
        lowest = min(lowest, reached)
    assign(x, best)
    for k in range(best_taken, course.shape[1]):
        filled(course[0, k], 0.0)


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
        course: (2, k, n) zeros; overwritten with r and f⁺ of the first k iterations.

    Returns:
        The residual of the law relative to u_free; infinite if the iteration has diverged.
    """
    free, least = problem.free, problem.law.least
    n, m, size = len(free), len(w), 0.0
    diagonal, r, f = np.empty(n), np.empty(n), np.empty(n)
    fill_compliances(problem, part, diagonal, r)
    filled(x, 0.0)
    size = largest(free)
    for i in range(len(least)):
        size = max(size, diagonal[3 * i + 2] * least[i])
    if size * size < TINY:  # or else squares of velocities underflow
        for a in range(m):
            w[a] = begin[a] = 0.0
        return 0.0
    profile = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    find_profile(problem, *profile)
    now = iterate_of(problem, w, f)
    assign(w, begin)
    iterate(problem, profile, r, accuracy, size, begin, x, course, now)
    return residual_of(problem, diagonal, x, now) / size
