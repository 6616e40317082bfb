"""Equations of variations δq, δv of a motion, at the stages of a collocation method. (derivatives.md, 9)"""

from __future__ import annotations

import numpy as np
from numba import types

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.least_norm import least_norms
from ..._numeric.loops import assign, filled, ones
from ..._numeric.lu import factorize, substitute
from ..._numeric.tolerances import RANK, TINY

FLOAT_STACK4 = types.float64[:, :, :, ::1]


@declared(
    *(float, FLOATS, FLOAT_ROWS, FLOAT_ROWS, INTEGERS, FLOAT_ROWS),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS),
)
@jit
def stage_equations(
    h, nodes, weights, twice, turned, force, by_state, response, inverse, by_friction, turning, x
):
    """Return the equations of the rates of δv at the stages. (D24)

    Args:
        h: Length of the interval [s].
        nodes, weights, twice: c (s,), A and A² (s, s) of the method.
        turned: (k,) indices in v of joints that turn.
        force: (nv, n) variations of a constant generalized force.
        by_state, response, inverse, by_friction, turning: See `slopes_along`.
        x: (2 nv, n) variations at the start; the last columns are by parameters.

    Returns:
        The matrix of the rates (s nv, s nv); their right-hand sides without those by the state, and for unit
        forces of the active rows (s, nv, n + s m); derivatives of the rows after v̇ with respect to the rates
        (s (m or 2 m), s nv); variations at the stages without rates (s, 2 nv, n); and derivatives of δq of
        joints that turn with respect to the rates (s, k, s, k).
    """
    stages, rows, nv = by_state.shape[0], by_state.shape[1], len(x) // 2
    m, n, first = response.shape[2], x.shape[1], x.shape[1] - by_friction.shape[2]
    start, right = np.empty((stages, 2 * nv, n)), np.zeros((stages, nv, n + stages * m))
    for i in range(stages):
        for r in range(nv):
            for c in range(n):
                start[i, r, c] = x[r, c] + h * nodes[i] * x[nv + r, c]
                start[i, nv + r, c] = x[nv + r, c]
            for c in range(by_friction.shape[2]):
                right[i, r, first + c] = by_friction[i, r, c]
            for c in range(m):
                right[i, r, n + i * m + c] = response[i, r, c]
        for k in range(nv):
            for c in range(n):
                if force[k, c] != 0.0:
                    for r in range(nv):
                        right[i, r, c] += inverse[i, r, k] * force[k, c]
    moved = _turn(h, weights, twice, turned, turning, start)
    straight = ones(nv)
    for k in turned:
        straight[k] = 0.0
    below = rows - nv
    matrix, vanishing = np.empty((stages * nv, stages * nv)), np.empty((stages * below, stages * nv))
    line = np.empty(nv)
    for i in range(stages):
        for r in range(rows):
            for j in range(stages):
                once, second = h * weights[i, j], h * h * twice[i, j]
                for k in range(nv):
                    line[k] = once * by_state[i, r, nv + k] + second * straight[k] * by_state[i, r, k]
                for a in range(len(turned)):
                    for b in range(len(turned)):
                        line[turned[b]] += by_state[i, r, turned[a]] * moved[i, a, j, b]
                if r < nv:
                    for k in range(nv):
                        matrix[i * nv + r, j * nv + k] = -line[k]
                else:
                    for k in range(nv):
                        vanishing[i * below + r - nv, j * nv + k] = line[k]
    for k in range(stages * nv):
        matrix[k, k] += 1.0
    return matrix, right, vanishing, start, moved


@declared(
    *(float, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, float, float, INTEGERS, int, int),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_STACK4, FLOAT_ROWS),
)
@jit
def changes_at_end(
    h, weights, twice, modes, decay, power, turned, states, forces, inverse, start, moved, rates
):
    """Return the variations (2 nv, n) after an interval, and an estimate of their relative error. (D24)

    The estimate assumes that the Legendre coefficients of the rates decay as those of an exponential. Errors
    of the first columns, by the state and by forces, are relative to the largest variation, or to that of a
    free motion under a force, since variations of held or stopped velocities are only rounding errors.

    Args:
        h, weights, twice, turned, inverse, start, moved: As in `stage_equations`.
        modes: (s, s) Legendre coefficients by values at the nodes.
        decay, power: Parameters of the extrapolation, see `sensitivities.Radau`.
        states, forces: Numbers of columns by states and by forces.
        rates: (s nv, n) rates of δv at the stages.
    """
    stages, nv, n = len(weights), start.shape[1] // 2, start.shape[2]
    half = (stages + 1) // 2
    end, last, part = start[stages - 1].copy(), stages - 1, np.empty(n)
    for a in range(len(turned)):
        for i in range(stages):
            for b in range(len(turned)):
                add(end[turned[a]], moved[last, a, i, b], rates[i * nv + turned[b]])
    straight, sizes, by_q = ones(nv), np.zeros(n), np.zeros(n)
    low, high = np.zeros(n), np.zeros(n)
    for k in turned:
        straight[k] = 0.0
    for r in range(nv):
        for i in range(stages):
            add(end[r], h * h * twice[last, i] * straight[r], rates[i * nv + r])
            add(end[nv + r], h * weights[last, i], rates[i * nv + r])
        raise_to(by_q, end[r])
        raise_to(sizes, end[nv + r])
        for k in range(stages):
            filled(part, 0.0)
            for i in range(stages):
                add(part, modes[k, i], rates[i * nv + r])
            raise_to(low if k < half else high, part)
    add(sizes, 1.0 / h, by_q)
    by_states = by_forces = 0.0
    for i in range(len(inverse)):
        for r in range(nv):
            for c in range(nv):
                by_forces = max(by_forces, h * abs(inverse[i, r, c]))
    for c in range(states):
        by_states = max(by_states, sizes[c])
    for c in range(states, states + forces):
        by_forces = max(by_forces, sizes[c])
    error = 0.0
    for c in range(n):
        size = by_states if c < states else by_forces if c < states + forces else sizes[c]
        if high[c] > 0.0:  # NaN is skipped: a shorter interval would not remove it
            found = h * decay * high[c] * (high[c] / max(low[c], TINY)) ** power
            error = max(error, found / max(size, TINY))
    return end, error


@declared(FLOAT_ROWS, FLOAT_ROWS, int, FLOAT_ROWS)
@jit
def stop(rows, response, first, x):
    """Return the variations x (2 nv, n) after the least impulses that stop some velocities. (D26)

    rows (m, 2 nv) are the derivatives of these velocities; NaN in one of them gives NaN in the result.
    Impulses change x from row `first` on by response (nv, m).
    """
    m, n = len(rows), x.shape[1]
    matrix, missed, forces = np.zeros((m, m)), np.zeros((m, n)), np.zeros((n, m))
    for a in range(m):
        for k in range(len(x)):
            if rows[a, k] != 0.0:
                add(missed[a], rows[a, k], x[k])
                if first <= k < first + len(response):
                    add(matrix[a], rows[a, k], response[k - first])
    least_norms(matrix, missed.T.copy(), RANK, forces, np.empty((0, m)))
    end = x.copy()
    for j in range(len(response)):
        for a in range(m):
            for c in range(n):
                end[first + j, c] -= response[j, a] * forces[c, a]
    return end


@inlined
def add(to, factor, values):
    """Add factor · values (n,) to the array `to` (n,)."""
    for i in range(len(to)):
        to[i] += factor * values[i]


@inlined
def raise_to(to, values):
    """Replace entries of `to` (n,) by the magnitudes of values (n,) where these are larger."""
    for i in range(len(to)):
        to[i] = max(to[i], abs(values[i]))


@inlined
def _turn(h, weights, twice, turned, turning, start):
    """Correct δq of joints that turn, in start (s, 2 nv, n); return its derivative by rates (s, k, s, k)."""
    stages, size = len(turning), len(turned)
    matrix, order = np.empty((stages * size, stages * size)), np.empty(stages * size, dtype=np.int64)
    for i in range(stages):
        for j in range(stages):
            for a in range(size):
                for b in range(size):
                    matrix[i * size + a, j * size + b] = h * weights[i, j] * turning[j, a, b]
    for k in range(len(matrix)):
        matrix[k, k] += 1.0
    factorize(matrix, order)
    column, inverse = np.empty(len(matrix)), np.empty((stages, size, stages, size))
    moved, straight = np.zeros((stages, size, stages, size)), np.empty((stages, size, start.shape[2]))
    for j in range(stages):
        for b in range(size):
            filled(column, 0.0)
            column[j * size + b] = 1.0
            substitute(matrix, order, column)
            for i in range(stages):
                for a in range(size):
                    inverse[i, a, j, b] = column[i * size + a]
            assign(straight[j, b], start[j, turned[b]])
    for i in range(stages):
        for a in range(size):
            for c in range(start.shape[2]):
                start[i, turned[a], c] = 0.0
            for j in range(stages):
                for b in range(size):
                    add(start[i, turned[a]], inverse[i, a, j, b], straight[j, b])
                    for k in range(stages):
                        moved[i, a, k, b] += inverse[i, a, j, b] * h * h * twice[j, k]
    return moved
