"""How slips begin whose friction has come to its bound, or beyond it. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined
from ..._numeric.elimination import solve
from ..._numeric.tolerances import COMPUTED, ROUNDING
from .codes import SLIPPING, STUCK
from .propagation_series import answer_of_turn, expand, unknown_after
from .propagation_state import AT_BOUND, LATE, RESUMED, TIED
from .tolerances import BEGINS, NEGLIGIBLE, SLIP_SPEED

TURNS = 6
"""Of Newton's method for directions of slip that begins."""


@inlined
def begin_at_bound(system, state, unit, weight, series):
    """Return whether contacts begin to slip whose friction has come to its bound, and let them.

    They are those whose slip, v_t = s² ρ u, has ρ > 0 at its beginning. (14.5)
    """
    n = len(system.friction)
    chosen = np.zeros(n, dtype=np.int64)
    count = 0
    for j in range(n):
        if state.fresh[j] == AT_BOUND and state.tangent[j] == STUCK:
            state.tangent[j] = SLIPPING
            state.fresh[j] = TIED
            chosen[j] = 1
            count += 1
    while count > 0:
        unknown, inverse, weight = unknown_after(system, state, unit, weight)
        expand(system, state, unknown, inverse, np.int64(1), 1.0, series)
        dropped = 0
        for j in range(n):
            if chosen[j] == 1:
                size = 0.0
                for i in range(3 * n):
                    row = abs(system.w[3 * j, i]) + abs(system.w[3 * j + 1, i])
                    size += row * abs(series.force[1, i])
                if not series.speed[0, j] > NEGLIGIBLE * size:
                    state.tangent[j] = STUCK
                    state.fresh[j] = 0
                    chosen[j] = 0
                    dropped += 1
        if dropped == 0:
            return True
        count -= dropped
    return False


@inlined
def align(system, state, unit, weight, series):
    """Turn slips that begin with an acceleration to where it is along them; else let them find that.

    The directions found a little ahead are off by as much as forces change until then.
    """
    n = len(system.friction)
    m = 3 * n
    places, gradual = np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    count = begun = 0
    first = np.int64(0)  # order at which forces begin
    for j in range(n):
        if state.tangent[j] == SLIPPING and state.fresh[j] in (RESUMED, LATE):
            begun += 1
            first = np.int64(1) if state.fresh[j] == LATE else first
    if begun == 0:
        return
    unknown, inverse, weight = unknown_after(system, state, unit, weight)
    expand(system, state, unknown, inverse, first, 1.0, series)
    for j in range(n):
        if state.tangent[j] == SLIPPING and state.fresh[j] == RESUMED:
            size = 0.0
            for i in range(m):
                row = abs(system.w[3 * j, i]) + abs(system.w[3 * j + 1, i])
                size += row * abs(series.force[0, i])
            if abs(series.speed[0, j]) <= BEGINS * size:
                state.fresh[j] = TIED
                gradual[j] = 1
    expand(system, state, unknown, inverse, np.int64(1), 1.0, series)
    for j in range(n):
        if gradual[j] == 1 and not series.speed[0, j] > 0.0:
            state.fresh[j] = RESUMED
            gradual[j] = 0
        if state.tangent[j] == SLIPPING and state.fresh[j] in (RESUMED, LATE):
            places[count] = j
            count += 1
    largest = _turn_along(system, state, unit, weight, series, places[:count], first)
    unknown, inverse, weight = unknown_after(system, state, unit, weight)
    expand(system, state, unknown, inverse, np.int64(1), 1.0, series)
    for j in range(n):
        if state.tangent[j] == SLIPPING and (state.fresh[j] in (RESUMED, LATE) or gradual[j] == 1):
            lost = gradual[j] == 0 and not largest <= ROUNDING
            if lost or not series.speed[0, j] > 0.0:
                state.fresh[j] = 1
                for i in range(2):
                    state.v[3 * j + i] = SLIP_SPEED * state.direction[2 * j + i]


@inlined
def _turn_along(system, state, unit, weight, series, places, first):
    """Turn the directions of slips to their accelerations, by Newton's method; return the last turn.

    Args:
        places: The contacts.
        first: Order of the series at which forces begin.
    """
    count = len(places)
    matrix, right, turn = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    answer, largest = np.empty(len(state.v)), 0.0
    for _ in range(TURNS if count > 0 else 0):
        unknown, inverse, weight = unknown_after(system, state, unit, weight)
        fixed = np.empty(len(unknown))
        expand(system, state, unknown, inverse, first, 1.0, series)
        for c in range(count):
            j, force = places[c], series.force[first]
            answer_of_turn(system, state, series.unit[0], unknown, inverse, fixed, j, force, answer)
            for other in range(count):
                matrix[other, c] = _across(system, state, places[other], answer)
            right[c] = -_across(system, state, j, force)
        for c in range(count):
            matrix[c, c] -= (first + 1.0) * series.speed[0, places[c]]
        if solve(matrix, right, turn, COMPUTED) == 0:
            return math.inf
        largest = 0.0
        for c in range(count):
            j = places[c]
            dx, dy = state.direction[2 * j], state.direction[2 * j + 1]
            length = math.hypot(1.0, turn[c])
            state.direction[2 * j] = (dx - turn[c] * dy) / length
            state.direction[2 * j + 1] = (dy + turn[c] * dx) / length
            largest = max(largest, abs(turn[c]))
        if not largest > ROUNDING:
            break
    return largest


@inlined
def _across(system, state, j, force):
    """Return the acceleration across the direction with which a slip begins, for forces (3n,)."""
    total = 0.0
    for i in range(len(force)):
        row = (
            system.w[3 * j + 1, i] * state.direction[2 * j] - system.w[3 * j, i] * state.direction[2 * j + 1]
        )
        total += row * force[i]
    return total
