"""Incipient slip of redundant contacts as one rigid motion v_t = s² L y. (theory.md, section 14.4)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..._compile.declared import FloatRows, Floats, Integers
from ..._compile.jit import inlined
from ..._numeric.least_norm import least_norm
from ..._numeric.products import add, dot
from ..._numeric.semidefinite import factor, forward
from .tolerances import NEGLIGIBLE


class Mechanism(NamedTuple):
    """Rigid motions v_t = L y of m slipping contacts; W = L Lᵀ in their tangential rows, r columns.

    Attributes:
        lower: (2m, 2m) L, in its first r columns.
        order: (2m,) row permutation of its pivoting.
        rank: (1,) r.
        along, across: (m, 2m) rows of L in the directions of slip, and orthogonal to them (l_j).
        free: (2m, 2m) projection of y onto motions that turn no slip direction of a contact with friction.
        turn: (2m,) last coefficient of y without its projection by `free`.
    """

    lower: FloatRows
    order: Integers
    rank: Integers
    along: FloatRows
    across: FloatRows
    free: FloatRows
    turn: Floats


@inlined
def new_mechanism(m):
    """Return a `Mechanism` of m contacts, filled with zeros."""
    size = 2 * m
    return Mechanism(
        *(np.zeros((size, size)), np.zeros(size, dtype=np.int64), np.zeros(1, dtype=np.int64)),
        *(np.zeros((m, size)), np.zeros((m, size)), np.zeros((size, size)), np.zeros(size)),
    )


@inlined
def fill_mechanism(system, state, response, ties, force, mechanism):
    """Fill a mechanism.

    Args:
        system, state: The `System`, and the `State` with the directions of slip.
        response: (2m, 2m) response of tangential accelerations to tangential forces at the contacts.
        ties: (m,) indices of the contacts.
        force: (3n,) forces as slip begins.
        mechanism: Is overwritten.
    """
    m, along, across = len(ties), mechanism.along, mechanism.across
    r = mechanism.rank[0] = factor(response, mechanism.order, mechanism.lower, NEGLIGIBLE)
    weighted, null = np.empty((m, r)), np.zeros((r, r))
    for c in range(m):
        j = ties[c]
        dx, dy = state.direction[2 * j], state.direction[2 * j + 1]
        size = 0.0
        for k in range(r):
            lx, ly = mechanism.lower[2 * c, k], mechanism.lower[2 * c + 1, k]
            along[c, k], across[c, k] = lx * dx + ly * dy, ly * dx - lx * dy
            size = max(size, abs(lx), abs(ly))
        for k in range(r):
            if abs(across[c, k]) <= NEGLIGIBLE * size:
                across[c, k] = 0.0
            weighted[c, k] = system.friction[j] * force[3 * j + 2] * across[c, k]
    count = r - least_norm(weighted, np.zeros(m), NEGLIGIBLE, np.empty(r), null)
    for a in range(r):
        for b in range(r):
            mechanism.free[a, b] = dot(null[:count, a], null[:count, b])


@inlined
def turn_together(system, state, series, k, pace, ties, answers, mechanism):
    """Compute the coefficients k of slip directions and k − 1 of ρ. (14.14)

    Args:
        system, state: The `System` and the `State`.
        series: The `Series`; its coefficients k of directions and forces and k − 1 of `speed` are updated.
        k: Order, at least 1.
        pace: Time scale of the series.
        ties: (m,) indices of the contacts.
        answers: (m, 3n) change of the forces per angle of slip at each contact.
        mechanism: The `Mechanism` of these contacts.
    """
    m, r, factor_k = len(ties), mechanism.rank[0], (k + 1.0) / pace
    speed, unit, force = series.speed, series.unit, series.force
    along, across, turn = mechanism.along, mechanism.across, mechanism.turn[:r]
    right, gained, y, known = np.empty(2 * m), np.empty(2 * m), np.empty(r), np.empty(m)
    stiff = np.zeros((r, r))
    for a in range(2 * m):
        right[a] = dot(system.w[3 * ties[a // 2] + a % 2], force[k])
    forward(mechanism.lower, mechanism.order, r, right, gained)
    unbalanced = gained[:r]
    for a in range(r):
        y[a] = turn[a] + dot(mechanism.free[a, :r], unbalanced) / factor_k
    add(unbalanced, -factor_k, y)
    for c in range(m):
        j = ties[c]
        dx, dy = state.direction[2 * j], state.direction[2 * j + 1]
        rho = dot(along[c, :r], y)
        for i in range(k - 1):
            rho -= speed[i, j] * (unit[k - 1 - i, 2 * j] * dx + unit[k - 1 - i, 2 * j + 1] * dy)
        speed[k - 1, j] = rho
        if not speed[0, j] > 0.0:  # slip does not begin
            return
        total = 0.0
        for i in range(1, k):
            total -= speed[i, j] * (unit[k - i, 2 * j + 1] * dx - unit[k - i, 2 * j] * dy)
        known[c] = total / speed[0, j]
        push = system.friction[j] * force[0, 3 * j + 2]
        add(unbalanced, -push * known[c], across[c])
        for a in range(r):
            add(stiff[a], push / speed[0, j] * across[c, a], across[c])
    least_norm(stiff, unbalanced, NEGLIGIBLE, turn, np.empty((0, r)))
    for c in range(m):
        j = ties[c]
        x = dot(across[c, :r], turn) / speed[0, j] + known[c]
        unit[k, 2 * j] -= x * state.direction[2 * j + 1]
        unit[k, 2 * j + 1] += x * state.direction[2 * j]
        add(force[k], x, answers[c])
