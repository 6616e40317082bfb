"""Impact at several contacts by the LZB model, from event to event. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.products import dot
from ..._numeric.semidefinite import factor, forward
from ..._numeric.tolerances import ROUNDING, ROUNDOFF, TINY
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
    """Resolve an impact at n contacts from event to event. (14.1), (14.2)

    Args:
        w: (3n, 3n) Delassus matrix W [1/kg].
        start: (3n,) pre-impact velocities [m/s].
        friction: (n,) μ.
        restitution: (n,) e of the energetic law.
        stiffness: (n,) κ; only ratios matter.
        exponent: η, 1 or 3/2.
        accuracy: Tolerance of a step, relative to the largest velocity.
        most_steps: Largest number of steps between two events; `most_steps` n is the largest number of those
            within which the fastest approach has to halve.
        v: (3n,) is overwritten with the post-impact velocities [m/s].
        impulse: (3n,) is overwritten with P [N s].
        works: (n, 3) is overwritten with the work of compression, restitution and friction [J].
        counts: (5,) is overwritten with the numbers of steps, events, rows and points, and why it ended:
            0 nothing presses or approaches, 1 negligible approach or plastic end, 2 too many steps or events.
        rows: (m, 5) is filled with contact, mode, phase, P₃ at start and end; m = 0: no trace.
        path: (m, 6n + 1) is filled with the clock, velocities and impulses; m = 0: no path. The impact ends
            early if it or `rows` is full.

    Returns:
        Whether all approaches could be stopped, and the relative residual. The residual is the largest of
        |v − v⁻ − W P| over the largest pre-impact velocity, |P_t| − μ P₃ over the largest P₃, and the energy
        created over the sum of absolute work.
    """
    n = len(friction)
    order = _canonical_order(w, start, friction, restitution, stiffness)
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
        *(system, new_state(u, p), new_series(n), np.empty((n, 3)), np.empty((5, ORDER + 1))),
        *(accuracy, most_steps, own_works, counts, rows, path),
    )
    residual = gained = size = 0.0
    made = before.copy()
    for i in range(3 * n):
        made[i] += dot(own_w[i], p)
        residual = max(residual, abs(u[i] - made[i]))
        stopped = stopped and math.isfinite(u[i]) and math.isfinite(p[i])
    if residual > ROUNDING:  # velocities set to zero at many events add up
        u = made
    strongest = outside = 0.0
    for j in range(n):
        strongest = max(strongest, p[3 * j + 2])
        outside = max(outside, math.hypot(p[3 * j], p[3 * j + 1]) - numbers[0, j] * p[3 * j + 2])
        for k in range(3):
            gained += own_works[j, k]
            size += abs(own_works[j, k])
            works[order[j], k] = own_works[j, k] * scale * scale / unit
    residual = max(residual, outside / max(strongest, TINY))
    for i in range(3 * n):
        v[places[i]] = u[i] * scale
        impulse[places[i]] = p[i] * scale / unit
    _write_back(order, places, scale, scale / unit, rows[: counts[2]], path[: counts[3]])
    return stopped, max(residual, gained / max(size, TINY))


@inlined
def _canonical_order(w, v, friction, restitution, stiffness):
    """Return an order (n,) of the contacts by their data.

    The result then does not depend on their numbering: the order of sums can decide ties by rounding.
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
    """Make tangential velocities of redundant contacts consistent with W to rounding.

    Contact velocities are differences of larger terms. No impulse changes the part of their rounding errors
    in the null space of W, and slip that should stop would continue at that speed. A Cholesky factorisation
    with complete pivoting, W = L Lᵀ, gives the dependent velocities v₂ = L₂₁ L₁₁⁻¹ v₁.

    A planar mechanism cannot move across its plane. Its rows of L in this direction are zero or, where the
    plane is a coordinate plane only to rounding, roundings of the others; they are then set to zero.
    Otherwise the contact slips across the plane at a rounding error, and friction opposes that slip.

    Args:
        w: (m, m) W; tangential rows and columns that are rounding errors are set to zero.
        v: (m,) velocities; tangential ones that satisfy the relation to `SLOW` are overwritten.
    """
    m = len(v)
    order, lower, y = np.empty(m, dtype=np.int64), np.zeros((m, m)), np.empty(m)
    rank = factor(w, order, lower, NEGLIGIBLE)
    forward(lower, order, rank, v, y)
    for k in range(rank, m):
        row, made = order[k], dot(lower[order[k], :rank], y)
        first = row - row % 3
        mobility = max(w[first, first], w[first + 1, first + 1], w[first + 2, first + 2])
        if row % 3 != 2 and w[row, row] <= ROUNDOFF * ROUNDOFF * mobility:  # squares of rows of L
            if w[row, row] > 0.0 and abs(v[row]) <= SLOW:
                v[row] = 0.0
            w[row] = 0.0
            w[:, row] = 0.0
        if row % 3 != 2 and w[row, row] > 0.0 and abs(made - v[row]) <= SLOW:
            v[row] = made


@inlined
def _write_back(order, places, speed, impulse, rows, path):
    """Convert rows (m, 5) and path (m, 6n + 1) to the caller's numbering and units."""
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
    """Return whether row i precedes row j in lexicographic order."""
    for k in range(keys.shape[1]):
        if keys[i, k] != keys[j, k]:
            return keys[i, k] < keys[j, k]
    return False


@inlined
def _system_of(w, friction, restitution, stiffness, exponent):
    """Return the `System` of n contacts; arguments as in `propagate`."""
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
