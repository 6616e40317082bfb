"""The equations of changes of a motion at the stages of a collocation method. (derivatives.md, 9)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.lu import factorize, substitute


@declared(
    *(float, FLOATS, FLOAT_ROWS, FLOAT_ROWS, INTEGERS),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS),
)
@jit
def stage_equations(h, nodes, weights, twice, turned, turning, by_q, by_v, x):
    """Return the equations of the rates of δv at the stages. (D24)

    Args:
        h: Length of the interval [s].
        nodes, weights, twice: c (s,), A and A² (s, s) of the method.
        turned: (k,) the velocities of joints that turn.
        turning: (s, k, k) N.
        by_q, by_v: (s, nv + m, nv) see `slopes_along`.
        x: (2 nv, n) changes at the start.

    Returns:
        The matrix of the rates (s nv, s nv); the velocities that vanish by the rates (s m, s nv); δq at the
        stages without rates (s, nv, n); and what rates add to it where joints turn (s, k, s, k).
    """
    stages, rows, nv = by_q.shape
    start = np.empty((stages, nv, x.shape[1]))
    for i in range(stages):
        for r in range(nv):
            for c in range(x.shape[1]):
                start[i, r, c] = x[r, c] + h * nodes[i] * x[nv + r, c]
    moved = _turn(h, weights, twice, turned, turning, start)
    straight = np.ones(nv)
    for k in turned:
        straight[k] = 0.0
    matrix, vanishing = np.empty((stages * nv, stages * nv)), np.empty((stages * (rows - nv), stages * nv))
    line = np.empty(nv)
    for i in range(stages):
        for r in range(rows):
            for j in range(stages):
                once, second = h * weights[i, j], h * h * twice[i, j]
                for k in range(nv):
                    line[k] = once * by_v[i, r, k] + second * straight[k] * by_q[i, r, k]
                for a in range(len(turned)):
                    for b in range(len(turned)):
                        line[turned[b]] += by_q[i, r, turned[a]] * moved[i, a, j, b]
                if r < nv:
                    for k in range(nv):
                        matrix[i * nv + r, j * nv + k] = -line[k]
                else:
                    for k in range(nv):
                        vanishing[i * (rows - nv) + r - nv, j * nv + k] = line[k]
    for k in range(stages * nv):
        matrix[k, k] += 1.0
    return matrix, vanishing, start, moved


@inlined
def _turn(h, weights, twice, turned, turning, start):
    """Change δq (s, nv, n) where joints turn; return what rates of velocities change of it (s, k, s, k)."""
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
    column, moved = np.empty(len(matrix)), np.empty((stages, size, stages, size))
    for c in range(start.shape[2]):
        for i in range(stages):
            for a in range(size):
                column[i * size + a] = start[i, turned[a], c]
        substitute(matrix, order, column)
        for i in range(stages):
            for a in range(size):
                start[i, turned[a], c] = column[i * size + a]
    for j in range(stages):
        for b in range(size):
            for k in range(len(column)):
                column[k] = 0.0
            for i in range(stages):
                column[i * size + b] = h * h * twice[i, j]
            substitute(matrix, order, column)
            for i in range(stages):
                for a in range(size):
                    moved[i, a, j, b] = column[i * size + a]
    return moved
