"""An impact at many contacts: forces that follow from indentations, along a clock that all share.

(theory.md, section 14)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.semidefinite import factor, forward
from ..._numeric.tolerances import ROUNDING, TINY
from .propagation_course import follow
from .propagation_series import ORDER, new_series
from .propagation_state import System, new_state
from .tolerances import NEGLIGIBLE, SLOW


@declared(
    *(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, float, float, int, FLOATS, FLOATS, FLOAT_ROWS),
    *(INTEGERS, FLOAT_ROWS, FLOAT_ROWS),
)
@jit
def propagate(
    w, start, friction, restitution, stiffness, exponent, accuracy, most_steps, v, impulse, works, counts,
    rows, path,
):  # fmt: skip
    """Resolve an impact at n contacts.

    Args:
        w: (3n, 3n) W.
        start: (3n,) velocities before it.
        friction: (n,) μ.
        restitution: (n,) e, of the energetic law.
        stiffness: (n,) κ.
        exponent: η, 1 or 3/2.
        accuracy: Part of the velocities that a step may miss.
        most_steps: A bound on the steps from one event to the next, and on all, per contact.
        v: (3n,) takes the velocities after it.
        impulse: (3n,) takes P.
        works: (n, 3) takes the works of compression, restitution and friction.
        counts: (5,) takes the numbers of steps, events, rows and points, and how it ended: 0 by itself, 1
            since all was slow or plastic, 2 not: steps or events at their bound.
        rows: (m, 5) takes contact, mode, phase, P₃ at start and end; (0, 5): not wanted.
        path: (m, 6n + 1) takes the clock, velocities and impulses; (0, …): not wanted.

    Returns:
        Whether the approach could be stopped, and what the answer misses: velocities that the impulses do not
        make, in parts of the largest before it, friction beyond its cone, in parts of the strongest impulse,
        or energy that they create, in parts of the works' sizes.
    """
    n = len(friction)
    order = _of_their_own(w, start, friction, restitution, stiffness)
    places = np.empty(3 * n, dtype=np.int64)
    scale = most = mobility = 0.0
    for j in range(n):
        for k in range(3):
            places[3 * j + k] = 3 * order[j] + k
            scale = max(scale, abs(start[3 * j + k]))
            mobility = max(mobility, w[3 * j + k, 3 * j + k])
        most = max(most, stiffness[j] * w[3 * j + 2, 3 * j + 2])
    scale, most = scale if scale > 0.0 else 1.0, most if most > 0.0 else 1.0
    unit = math.ldexp(1.0, math.frexp(mobility)[1] // 2 * 2)  # of W; a power of four is exact, and its root
    own_w, before, p = np.empty((3 * n, 3 * n)), np.empty(3 * n), np.zeros(3 * n)
    numbers, own_works = np.empty((3, n)), np.zeros((n, 3))
    for i in range(3 * n):
        before[i] = start[places[i]] / scale
        for k in range(3 * n):
            own_w[i, k] = w[places[i], places[k]] / unit
    for j in range(n):
        numbers[0, j], numbers[1, j] = friction[order[j]], restitution[order[j]]
        numbers[2, j] = stiffness[order[j]] / most * unit
    _make_consistent(own_w, before)
    u = before.copy()
    system = _system_of(own_w, numbers[0], numbers[1], numbers[2], exponent)
    stopped = follow(
        *(system, new_state(u, p), new_series(ORDER, n), np.empty((n, 3)), np.empty((5, ORDER + 1))),
        *(accuracy, most_steps, own_works, counts, rows, path),
    )
    missed = gained = size = 0.0
    made = before.copy()
    for i in range(3 * n):
        for k in range(3 * n):
            made[i] += own_w[i, k] * p[k]
        missed = max(missed, abs(u[i] - made[i]))
        stopped = stopped and math.isfinite(u[i]) and math.isfinite(p[i])
    if missed > ROUNDING:  # what has been set to zero at many events adds up
        u = made
    strongest = outside = 0.0
    for j in range(n):
        strongest = max(strongest, p[3 * j + 2])
        outside = max(outside, math.hypot(p[3 * j], p[3 * j + 1]) - numbers[0, j] * p[3 * j + 2])
        for k in range(3):
            gained += own_works[j, k]
            size += abs(own_works[j, k])
            works[order[j], k] = own_works[j, k] * scale * scale / unit
    missed = max(missed, outside / max(strongest, TINY))
    for i in range(3 * n):
        v[places[i]] = u[i] * scale
        impulse[places[i]] = p[i] * scale / unit
    _write_back(order, places, scale, scale / unit, rows[: counts[2]], path[: counts[3]])
    return stopped, max(missed, gained / max(size, TINY))


@inlined
def _of_their_own(w, v, friction, restitution, stiffness):
    """Return an order (n,) of the contacts by what they are, so that nothing comes of how they are numbered.

    Where rounding decides, as at ties, sums in another order decide otherwise.
    """
    n = len(friction)
    keys, order = np.empty((n, 9)), np.empty(n, dtype=np.int64)
    for j in range(n):
        for k in range(3):
            keys[j, k] = v[3 * j + 2 - k]
            keys[j, 3 + k] = w[3 * j + 2 - k, 3 * j + 2 - k]
        keys[j, 6], keys[j, 7], keys[j, 8] = friction[j], restitution[j], stiffness[j]
        place = j
        while place > 0 and _comes_first(keys, j, order[place - 1]):
            order[place] = order[place - 1]
            place -= 1
        order[place] = j
    return order


@inlined
def _make_consistent(w, v):
    """Let tangential velocities that follow from others by W do so to rounding, where they nearly do.

    Those of contacts are differences of larger terms. Where contacts are redundant no impulse changes what
    rounding leaves of that, and slip that should stop would continue with it. A Cholesky factorisation with
    complete pivoting, W = L Lᵀ, finds which velocities are dependent: v₂ = L₂₁ L₁₁⁻¹ v₁.

    Args:
        w: (m, m) W.
        v: (m,) velocities, changed where they are dependent to `SLOW`.
    """
    m = len(v)
    order, lower, y = np.empty(m, dtype=np.int64), np.zeros((m, m)), np.empty(m)
    rank = factor(w, order, lower, NEGLIGIBLE)
    forward(lower, order, rank, v, y)
    for k in range(rank, m):
        row, made = order[k], 0.0
        for b in range(rank):
            made += lower[row, b] * y[b]
        if row % 3 != 2 and w[row, row] > 0.0 and abs(made - v[row]) <= SLOW:
            v[row] = made


@inlined
def _write_back(order, places, speed, impulse, rows, path):
    """Bring rows (m, 5) and path (m, 6n + 1) into the numbering and the units of the problem."""
    m = len(places)
    for row in range(len(rows)):
        rows[row, 0] = order[int(rows[row, 0])]
        rows[row, 3] *= impulse
        rows[row, 4] *= impulse
    for row in range(len(path)):
        point = path[row].copy()
        for i in range(m):
            path[row, 1 + places[i]] = point[1 + i] * speed
            path[row, 1 + m + places[i]] = point[1 + m + i] * impulse


@inlined
def _comes_first(keys, i, j):
    """Return whether row i comes before row j where their first numbers differ."""
    for k in range(keys.shape[1]):
        if keys[i, k] != keys[j, k]:
            return keys[i, k] < keys[j, k]
    return False


@inlined
def _system_of(w, friction, restitution, stiffness, exponent):
    """Return the `System` of contacts with these coefficients (n,) of restitution."""
    n = len(friction)
    unloading = np.zeros(n)
    for j in range(n):
        if restitution[j] > 0.0:
            unloading[j] = 1.0 / (restitution[j] * restitution[j])
    filled, count = np.empty((3 * n, 3 * n), dtype=np.int64), np.zeros(3 * n, dtype=np.int64)
    for i in range(3 * n):
        for k in range(3 * n):
            if w[i, k] != 0.0:
                filled[i, count[i]] = k
                count[i] += 1
    return System(w, filled, count, friction, unloading, stiffness, exponent)
