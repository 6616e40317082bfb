"""Friction that redundant contacts share: how long it holds, how slip begins, and who bears what.

What contacts that stick, with W = L Lᵀ in their tangential rows, hold against is b = −Lᵀf; how they share it
changes nothing of the motion. They can hold while b·d ≤ Σ μ_j F_j |L_j d| for every d, a velocity in the
columns of L. (14.13)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, filled
from ..._numeric.products import dot
from ..._numeric.semidefinite import factor
from ..._numeric.tolerances import EXACT, TINY
from .codes import STUCK
from .first_fall import NEVER, first_fall, value_at
from .propagation_stages import Springs, minimize
from .propagation_state import NOT_SHARED, SHARED, loads
from .tolerances import NEGLIGIBLE

COARSE, FINER = 0.1, 0.01
"""The first creep for which (14.10) is solved, and the factor to the next, down to `NEGLIGIBLE`."""

CLEAR = 1e-6
"""Acceleration beyond the limit, in parts of the largest bound, from which on it is known what slips."""

APPROACHES, TURNS = 30, 8
"""Mechanisms from which the limit is approached, and steps of Newton's method at it, at most."""

FIRM = 1e-2
"""Part of the largest of LᵀL from which on impulses of creep are corrected by what they miss, beside which
a correction is small; where it is less, creep is what moves, by a part `NEGLIGIBLE`."""

LOOKS = 6
"""How often in a step it is looked whether friction still holds."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
NODES, WEIGHTS = 0.5 + 0.5 * NODES, 0.5 * WEIGHTS


@inlined
def mark_shared(system, state):
    """Mark the contacts that stick where they can hold in several ways; return whether they can."""
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
    """Return the contacts (m,) that stick, and rows L (3m, r) of their velocities, W = L Lᵀ in the plane."""
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
    """Return whether friction of the contacts that stick can hold against the other forces p (3n,)."""
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
    """Find the acceleration y (r,) that is left, v (3m,) at the contacts, by (14.10); tell whether any moves.

    They are given from nearby, or zero. The bounds (m,) and what is held against, (r,), are brought to parts
    of the largest bound.
    """
    m, strongest = len(bound), TINY
    for c in range(m):
        strongest = max(strongest, bound[c])
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
    """Whether what is left, v (3m,), moves a contact."""
    return math.hypot(v[3 * c], v[3 * c + 1]) >= NEGLIGIBLE


@inlined
def _loads_of(system, at, rows, series, degree):
    """Return the series (degree + 1, m) of the bounds, and (degree + 1, r) of what is held against."""
    m, r = len(at), rows.shape[1]
    bounds, held = np.empty((degree + 1, m)), np.zeros((degree + 1, r))
    for k in range(degree + 1):
        for c in range(m):
            bounds[k, c] = system.friction[at[c]] * series.force[k, 3 * at[c] + 2]
            for a in range(2):
                for i in range(r):
                    held[k, i] -= rows[3 * c + a, i] * series.force[k, 3 * at[c] + a]
    return bounds, held


@inlined
def _creep_at(rows, bounds, held, degree, s, bound, load, y, v):
    """Find what is left at s, see `_creep`."""
    for c in range(len(bound)):
        bound[c] = max(value_at(bounds, c, degree, s), 0.0)
    for k in range(len(load)):
        load[k] = value_at(held, k, degree, s)
    return _creep(rows, bound, load, y, v)


@inlined
def limit_of_holding(system, state, series, degree, reach, roots, work):
    """Return until when shared friction holds, within a reach; `NEVER` if it does so beyond.

    That time is in roots[j, 2] of the contacts j that begin to slip, in directions that the state takes. The
    first s at which (14.13) fails for some d is found from beyond: the d of one s gives the next.
    """
    at, rows = _shared_rows(system, state)
    m, r = len(at), rows.shape[1]
    bounds, held = _loads_of(system, at, rows, series, degree)
    bound, load, y, v = np.empty(m), np.empty(r), np.zeros(r), np.zeros(3 * m)
    d, excess, s = np.zeros(r), np.empty(degree + 1), NEVER
    slips, friction = np.zeros(m, dtype=np.bool_), np.zeros((m, 2))
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
            break  # no more is known of who slips
        for c in range(m):
            slips[c] = _slips(v, c)
            for a in range(2):
                friction[c, a] = bound[c] * v[3 * c + a] / NEGLIGIBLE
        before, s = s, min(first_fall(excess, degree, s, 0.0, work), s)
        if not before - s > EXACT * reach:
            break
        _creep_at(rows, bounds, held, degree, s, bound, load, y, v)
    s = _polish(rows, bounds, held, degree, reach, s, d, slips, friction)
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
    """Fill the direction d of what is left, y, and the series of Σ μF|Ld| − b·d; return |y|."""
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
def _polish(rows, bounds, held, degree, reach, s, d, slips, friction):
    """Improve d (r,) and the s of a limit by Newton's method; return s.

    b(s) = Σ μF(s) Lᵀu(d) where it slips, + Σ Lᵀf where Ld = 0, in parts of the largest bound; |d| = 1.
    """
    m, r = len(slips), len(d)
    places, count = np.empty(m, dtype=np.int64), 0
    for c in range(m):
        if not slips[c]:
            places[c] = r + 2 * count
            count += 1
    size = r + 2 * count + 1
    last = size - 1
    matrix, right, change = np.empty((size, size)), np.empty(size), np.empty(size)
    start, direction, strongest = s, d.copy(), TINY
    for c in range(m):
        strongest = max(strongest, value_at(bounds, c, degree, s))
    for _ in range(TURNS):
        filled(matrix.ravel(), 0.0)
        filled(right, 0.0)
        for k in range(r):
            right[k] = -value_at(held, k, degree, s) / strongest
            matrix[k, last] = _slope_at(held, k, degree, s) / strongest
        for c in range(m):
            if not slips[c]:
                for a in range(2):
                    for k in range(r):
                        part, place = rows[3 * c + a, k], places[c] + a
                        right[k] += part * friction[c, a]
                        matrix[k, place] = -part
                        matrix[place, k] = part
                        right[place] -= part * d[k]
                continue
            ax, ay = dot(rows[3 * c], d), dot(rows[3 * c + 1], d)
            speed = math.hypot(ax, ay)
            if not speed > 0.0:
                return start
            ux, uy = ax / speed, ay / speed
            most = value_at(bounds, c, degree, s) / strongest
            slope = _slope_at(bounds, c, degree, s) / strongest
            for k in range(r):
                along = rows[3 * c, k] * ux + rows[3 * c + 1, k] * uy
                across = rows[3 * c + 1, k] * ux - rows[3 * c, k] * uy
                right[k] += most * along
                matrix[k, last] -= slope * along
                for i in range(r):
                    other = rows[3 * c + 1, i] * ux - rows[3 * c, i] * uy
                    matrix[k, i] -= most / speed * across * other
        for k in range(r):
            matrix[last, k] = d[k]
        least_norm(matrix, right, NEGLIGIBLE, change, np.empty((0, size)))
        largest = 0.0
        for k in range(r):
            d[k] += change[k]
            largest = max(largest, abs(change[k]))
        for c in range(m):
            if not slips[c]:
                friction[c, 0] += change[places[c]]
                friction[c, 1] += change[places[c] + 1]
        s += change[last]
        if not abs(s - start) <= NEGLIGIBLE**0.5 * reach:
            assign(d, direction)
            return start
        if largest <= EXACT:
            break
    return min(max(s, 0.0), reach)


@inlined
def _slope_at(rows, i, degree, s):
    """Return the derivative of Σ rows[k, i] sᵏ."""
    total = degree * rows[degree, i]
    for k in range(degree - 1, 0, -1):
        total = total * s + k * rows[k, i]
    return total


@inlined
def spread(system, state, series, degree, h, pace, root):
    """Fill `beyond` of the series: what impulses of shared friction are where (14.4) leaves the bounds.

    They are those of creep, (14.10), at Gauss' nodes of a few parts of the step, less what would change
    velocities.
    """
    at, rows = _shared_rows(system, state)
    m, r = len(at), rows.shape[1]
    bounds, held = _loads_of(system, at, rows, series, degree)
    bound, load, y, v = np.empty(m), np.empty(r), np.zeros(r), np.zeros(3 * m)
    more, pushed, moves, gram = np.empty(3 * m), np.empty(r), np.empty(r), np.zeros((r, r))
    for i in range(3 * m):
        for a in range(r):
            for b in range(r):
                gram[a, b] += rows[i, a] * rows[i, b]
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
            for k in range(r):
                pushed[k] += rows[i, k] * more[i]
        least_norm(gram, pushed, FIRM, moves, np.empty((0, r)))
        for i in range(3 * m):
            place = 3 * at[i // 3] + i % 3
            series.beyond[part, place] = more[i] - dot(rows[i], moves)
            if part > 0:
                series.beyond[part, place] += series.beyond[part - 1, place]
