"""Friction shared by redundant sticking contacts: its limit, incipient slip and distribution.

With W = L Lᵀ in the tangential rows of these contacts, friction f balances the load b = −Lᵀf while
b·d ≤ Σ μ_j F_j |L_j d| for every d, (14.13). (theory.md, section 14.4)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import filled, largest
from ..._numeric.products import add, dot
from ..._numeric.semidefinite import factor
from ..._numeric.tolerances import EXACT, TINY
from .codes import STUCK
from .first_fall import NEVER, first_fall, value_at
from .propagation_stages import Springs, minimize
from .propagation_state import NOT_SHARED, SHARED, loads
from .tolerances import NEGLIGIBLE

COARSE, FINER = 0.1, 0.01
"""Largest ε for which (14.10) is solved, and the factor to the next one, down to `NEGLIGIBLE`."""

CLEAR = 1e-6
"""Acceleration, over the largest friction bound, above which the slipping contacts are reliably known."""

APPROACHES = 30
"""Largest number of directions d that approach the limit."""

FIRM = 1e-2
"""Eigenvalue of LᵀL, relative to the largest, above which impulses of creep are corrected so that they do not
change velocities. The correction is small there; below, creep changes velocities by `NEGLIGIBLE` only."""

LOOKS = 6
"""Number of points of a step at which (14.13) is tested."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
NODES, WEIGHTS = 0.5 + 0.5 * NODES, 0.5 * WEIGHTS


@inlined
def mark_shared(system, state):
    """Mark the sticking contacts if their friction is not unique; return whether this is so."""
    n, count = len(system.friction), 0
    for j in range(n):
        if state.tangent[j] == STUCK:
            state.shared[j] = NOT_SHARED
            count += loads(state.normal[j])
    if count < 2:
        return False
    at, rows = _shared_rows(system, state)
    if not rows.shape[1] < 2 * count:
        return False
    for j in at:
        state.shared[j] = SHARED
    return True


@inlined
def _shared_rows(system, state):
    """Return the sticking contacts (m,), and L (3m, r) with zero normal rows; W = L Lᵀ in tangential rows."""
    n, count = len(system.friction), 0
    at = np.empty(n, dtype=np.int64)
    for j in range(n):
        if state.tangent[j] == STUCK and loads(state.normal[j]):
            at[count] = j
            count += 1
    size = 2 * count
    block, lower, order = np.empty((size, size)), np.zeros((size, size)), np.empty(size, dtype=np.int64)
    for a in range(size):
        for b in range(size):
            block[a, b] = system.w[3 * at[a // 2] + a % 2, 3 * at[b // 2] + b % 2]
    rank = factor(block, order, lower, NEGLIGIBLE)
    rows = np.zeros((3 * count, rank))
    for a in range(size):
        for k in range(rank):
            rows[3 * (a // 2) + a % 2, k] = lower[a, k]
    return at[:count].copy(), rows


@inlined
def holds_now(system, state, p):
    """Return whether friction of the sticking contacts can balance the other forces p (3n,). (14.13)"""
    at, rows = _shared_rows(system, state)
    m, r = len(at), rows.shape[1]
    bound, load, push = np.empty(m), np.empty(r), np.zeros(3 * m)
    for c in range(m):
        bound[c] = max(system.friction[at[c]] * p[3 * at[c] + 2], 0.0)
        for a in range(2):
            push[3 * c + a] = dot(system.w[3 * at[c] + a], p)
    least_norm(rows, push, NEGLIGIBLE, load, np.empty((0, r)))
    return not _creep(rows, bound, load, np.zeros(r), np.zeros(3 * m))


@inlined
def _creep(rows, bound, load, y, v):
    """Compute the acceleration that friction cannot balance, by (14.10); return whether any contact moves.

    Args:
        rows: (3m, r) L.
        bound: (m,) friction bounds μF; is divided by the largest.
        load: (r,) b; is divided by the largest bound.
        y: (r,) initial guess; is overwritten with the acceleration.
        v: (3m,) L y; likewise.
    """
    m, strongest = len(bound), max(TINY, largest(bound))
    for c in range(m):
        bound[c] /= strongest
    for k in range(len(load)):
        load[k] /= strongest
    none, soft = np.zeros(m), np.zeros(m, dtype=np.bool_)
    springs = Springs(none, none, none, none, 1.0)
    if not minimize(rows, bound, NEGLIGIBLE, springs, soft, none, 0.0, load, y, v):
        filled(y, 0.0)
        filled(v, 0.0)
        creep = COARSE
        while creep >= NEGLIGIBLE:
            minimize(rows, bound, creep, springs, soft, none, 0.0, load, y, v)
            creep *= FINER
    moves = False
    for c in range(m):
        moves = moves or _slips(v, c)
    return moves


@inlined
def _slips(v, c):
    """Return whether an acceleration v (3m,) moves contact c."""
    return math.hypot(v[3 * c], v[3 * c + 1]) >= NEGLIGIBLE


@inlined
def _loads_of(system, at, rows, series, degree):
    """Return the series (degree + 1, m) of the friction bounds, and (degree + 1, r) of the load b."""
    m, r = len(at), rows.shape[1]
    bounds, held = np.empty((degree + 1, m)), np.zeros((degree + 1, r))
    for k in range(degree + 1):
        for c in range(m):
            bounds[k, c] = system.friction[at[c]] * series.force[k, 3 * at[c] + 2]
            for a in range(2):
                add(held[k], -series.force[k, 3 * at[c] + a], rows[3 * c + a])
    return bounds, held


@inlined
def _creep_at(rows, bounds, held, degree, s, bound, load, y, v):
    """Evaluate the series of `_loads_of` at s into `bound` and `load`, and return `_creep` of them."""
    for c in range(len(bound)):
        bound[c] = max(value_at(bounds, c, degree, s), 0.0)
    for k in range(len(load)):
        load[k] = value_at(held, k, degree, s)
    return _creep(rows, bound, load, y, v)


@inlined
def limit_of_holding(system, state, series, degree, reach, roots, work):
    """Find the first time at which shared friction reaches its limit (14.13).

    The time is approached from later times, at which (14.13) is violated: the direction d of the remaining
    acceleration there gives the next, earlier time.

    Args:
        system: The `System`.
        state: The `State`; receives the directions of incipient slip.
        series: The `Series` of the step.
        degree: Degree to which it is evaluated.
        reach: End of the search interval.
        roots: (n, 3); roots[j, 2] is overwritten with the time for contacts j that begin to slip.
        work: (4, degree + 1) scratch.

    Returns:
        The time, or `NEVER` if it is later than `reach`.
    """
    at, rows = _shared_rows(system, state)
    m, r = len(at), rows.shape[1]
    bounds, held = _loads_of(system, at, rows, series, degree)
    bound, load, y, v = np.empty(m), np.empty(r), np.zeros(r), np.zeros(3 * m)
    d, excess, s = np.zeros(r), np.empty(degree + 1), NEVER
    slips = np.zeros(m, dtype=np.bool_)
    beyond = False
    for look in range(1, LOOKS + 1):
        s = reach * look / LOOKS
        if _creep_at(rows, bounds, held, degree, s, bound, load, y, v):
            beyond = _excess(bounds, held, degree, y, v, d, excess) > 0.0
            beyond = beyond and first_fall(excess, degree, s, 0.0, work) < NEVER
        if beyond:
            break
    if not beyond:
        return NEVER
    for approach in range(APPROACHES):
        if not _excess(bounds, held, degree, y, v, d, excess) > CLEAR and approach > 0:
            break
        for c in range(m):
            slips[c] = _slips(v, c)
        before, s = s, min(first_fall(excess, degree, s, 0.0, work), s)
        if not before - s > EXACT * reach:
            break
        _creep_at(rows, bounds, held, degree, s, bound, load, y, v)
    for c in range(m):
        j = at[c]
        ax, ay = dot(rows[3 * c], d), dot(rows[3 * c + 1], d)
        speed = math.hypot(ax, ay)
        if slips[c] and speed > 0.0:
            state.direction[2 * j], state.direction[2 * j + 1] = ax / speed, ay / speed
            roots[j, 2] = s
    return s


@inlined
def _excess(bounds, held, degree, y, v, d, excess):
    """Fill d = y/|y| and the series of Σ μF|Ld| − b·d, with L y = v (3m,); return |y|."""
    length = math.sqrt(dot(y, y))
    if not length > 0.0:
        return length
    for k in range(len(y)):
        d[k] = y[k] / length
    for k in range(degree + 1):
        excess[k] = -dot(held[k], d)
        for c in range(bounds.shape[1]):
            excess[k] += bounds[k, c] * math.hypot(v[3 * c], v[3 * c + 1]) / length
    return length


@inlined
def spread(system, state, series, degree, h, pace, root):
    """Fill `Series.beyond` with the redistribution of shared friction where (14.4) leaves the bounds.

    The impulses are those of creep, (14.10), integrated by Gauss quadrature on `POINTS` parts of the step,
    minus their part that would change velocities. Arguments as in `propagation_advance.advance`.
    """
    at, rows = _shared_rows(system, state)
    m, r = len(at), rows.shape[1]
    bounds, held = _loads_of(system, at, rows, series, degree)
    bound, load, y, v = np.empty(m), np.empty(r), np.zeros(r), np.zeros(3 * m)
    more, pushed, moves, gram = np.empty(3 * m), np.empty(r), np.empty(r), np.zeros((r, r))
    for row in rows:
        for a in range(r):
            add(gram[a], row[a], row)
    parts = len(series.beyond)
    for part in range(parts):
        filled(more, 0.0)
        filled(pushed, 0.0)
        for node in range(len(NODES)):
            s = h * (part + NODES[node]) / parts
            weight = WEIGHTS[node] * h / parts * pace * (2.0 * pace * s if root else 1.0)
            strongest = TINY
            for c in range(m):
                strongest = max(strongest, value_at(bounds, c, degree, s))
            _creep_at(rows, bounds, held, degree, s, bound, load, y, v)
            for c in range(m):
                speed = max(math.hypot(v[3 * c], v[3 * c + 1]), NEGLIGIBLE)
                for a in range(2):
                    pull = strongest * bound[c] * v[3 * c + a] / speed
                    more[3 * c + a] -= weight * (pull + value_at(series.force, 3 * at[c] + a, degree, s))
        for i in range(3 * m):
            add(pushed, more[i], rows[i])
        least_norm(gram, pushed, FIRM, moves, np.empty((0, r)))
        for i in range(3 * m):
            place = 3 * at[i // 3] + i % 3
            series.beyond[part, place] = more[i] - dot(rows[i], moves)
            if part > 0:
                series.beyond[part, place] += series.beyond[part - 1, place]
