"""Equations of variations δq, δv of a motion, at the stages of a collocation method. (derivatives.md, 9)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.least_norm import least_norms
from ..._numeric.loops import assign, filled, largest, ones
from ..._numeric.lu import factorize, substitute
from ..._numeric.products import add, add_product, apply_symmetric, dot
from ..._numeric.tolerances import RANK, ROUNDOFF, TINY


@declared(
    *(float, FLOATS, FLOAT_ROWS, FLOAT_ROWS, INTEGERS, FLOAT_ROWS, bool),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS),
)
@jit
def stage_equations(
    h, nodes, weights, twice, turned, force, unique, by_state, response, inverse, by_friction, turning, x
):
    """Return the equations of the rates of δv at the stages. (D24)

    Args:
        h: Length of the interval [s].
        nodes, weights, twice: c (s,), A and A² (s, s) of the method.
        turned: (k,) indices in v of joints that turn.
        force: (nv, n) variations of a constant generalized force.
        unique: Whether to eliminate the forces of the active rows: nv equations per stage are left, those of
            the velocities that vanish in place of those that determine forces.
        by_state, response, inverse, by_friction, turning: See `slopes_along`.
        x: (2 nv, n) variations at the start; the last columns are by parameters.

    Returns:
        The matrix of the rates (s r, s nv), with r = nv rows of equations or, without forces, r as in
        `by_state`; their right-hand sides (s, r, n); variations at the stages without rates (s, 2 nv, n);
        derivatives of δq of joints that turn with respect to the rates (s k, s k); and whether the forces
        have independent effects, without which they cannot be eliminated.
    """
    stages, nv, n, size = len(by_state), len(x) // 2, x.shape[1], len(turned)
    total = nv if unique else by_state.shape[1]
    start, matrix = np.empty((stages, 2 * nv, n)), np.empty((stages * total, stages * nv))
    right, pushed = np.zeros((stages, total, n)), np.empty((total, nv))
    first, last = _used(force)
    given, applied = force[:, first:last].copy(), np.empty((total, last - first))
    for i in range(stages):
        for r in range(nv):
            assign(start[i, r], x[r])
            add(start[i, r], h * nodes[i], x[nv + r])
            assign(start[i, nv + r], x[nv + r])
    moved, straight = _turn(h, weights, twice, turned, turning, start), ones(nv)
    for k in turned:
        straight[k] = 0.0
    mass, lines, line = np.empty((total, nv)), np.empty((total, 2 * nv)), np.empty(nv)
    for i in range(stages):
        if not _fill_lines(h, unique, by_state[i], response[i], mass, lines):
            return matrix, right, start, moved, False
        pushed[:, :] = 0.0
        add_product(mass, inverse[i], pushed)
        applied[:, :] = 0.0
        add_product(pushed, given, applied)
        for r in range(total):
            assign(right[i, r, first:last], applied[r])
        add_product(lines, start[i], right[i])
        for r in range(total):
            for k in range(nv):
                for c in range(by_friction.shape[2]):
                    right[i, r, n - by_friction.shape[2] + c] += mass[r, k] * by_friction[i, k, c]
        for r in range(total):
            by_q, by_v = lines[r, :nv], lines[r, nv:]
            for j in range(stages):
                once, second = h * weights[i, j], h * h * twice[i, j]
                for k in range(nv):
                    line[k] = once * by_v[k] + second * straight[k] * by_q[k]
                for a in range(size):
                    row, part = moved[i * size + a, j * size : (j + 1) * size], by_q[turned[a]]
                    for b in range(size):
                        line[turned[b]] += part * row[b]
                out = matrix[i * total + r, j * nv : (j + 1) * nv]
                for k in range(nv):
                    out[k] = -line[k]
                if i == j:
                    add(out, 1.0, mass[r])
    return matrix, right, start, moved, True


@inlined
def _used(matrix):
    """Return the first column of a matrix that is not zero, and the one after the last."""
    first, last = matrix.shape[1], 0
    for r in range(len(matrix)):
        for c in range(matrix.shape[1]):
            if matrix[r, c] != 0.0:
                first, last = min(first, c), max(last, c + 1)
    return min(first, last), last


@inlined
def _fill_lines(h, unique, by_state, response, mass, lines):
    """Fill equations at a stage, mass · rates of δv = lines · (δq, δv); return whether forces are eliminated.

    With `unique` the rows y of the first are those with yᵀ · response = 0, of `response` with row pivoting.
    """
    nv, m = response.shape
    mass[:, :] = 0.0
    if not unique:
        for r in range(len(lines)):
            assign(lines[r], by_state[r])
            if r < nv:
                mass[r, r] = 1.0
        return True
    factors, order, least = response.copy(), np.empty(m, dtype=np.int64), 0.0
    for r in range(nv):
        least = max(least, ROUNDOFF * largest(response[r]))
    if not factorize(factors, order):
        return False
    for k in range(m):
        if not abs(factors[k, k]) > least:
            return False
    lines[:, :] = 0.0
    for r in range(m, nv):
        y = mass[r]
        y[r] = 1.0
        for k in range(m - 1, -1, -1):
            y[k] = -factors[r, k] - dot(y[k + 1 : m], factors[k + 1 : m, k])
        for k in range(m - 1, -1, -1):
            y[k], y[order[k]] = y[order[k]], y[k]
    for k in range(m):
        for c in range(2 * nv):
            lines[k, c] = by_state[nv + k, c] / h
    add_product(mass[m:], by_state[:nv], lines[m:])
    return True


@declared(
    *(float, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, float, float, INTEGERS, int, int),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS, FLOAT_ROWS),
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
        decay, power: Parameters of the extrapolation, see `collocation.Radau`.
        states, forces: Numbers of columns by states and by forces.
        rates: (s nv, n) rates of δv at the stages.
    """
    stages, nv, n = len(weights), start.shape[1] // 2, start.shape[2]
    half = (stages + 1) // 2
    end, last, part = start[stages - 1].copy(), stages - 1, np.empty(n)
    for a in range(len(turned)):
        for i in range(stages):
            for b in range(len(turned)):
                part_moved = moved[last * len(turned) + a, i * len(turned) + b]
                add(end[turned[a]], part_moved, rates[i * nv + turned[b]])
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


@declared(
    *(float, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, float, float, INTEGERS, int, int, FLOAT_ROWS),
    *(FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS),
)
@jit
def changes_across(
    h, nodes, weights, twice, modes, decay, power, turned, states, forces, force, by_state, response,
    inverse, by_friction, turning, x,
):  # fmt: skip
    """Return the results of `changes_at_end` if forces are unique, and whether the equations are regular."""
    equations = h, nodes, weights, twice, turned, force, True
    slopes = by_state, response, inverse, by_friction, turning
    matrix, right, start, moved, regular = stage_equations(*equations, *slopes, x)
    rates, order = right.reshape((len(matrix), x.shape[1])), np.empty(len(matrix), dtype=np.int64)
    if regular and factorize(matrix, order):
        substitute(matrix, order, rates)
        at_end = weights, twice, modes, decay, power, turned, states, forces
        end, error = changes_at_end(h, *at_end, inverse, start, moved, rates)
        return end, error, True
    return x, 0.0, False


@declared(FLOAT_ROWS, FLOAT_ROWS, int, FLOAT_ROWS)
@jit
def stop(rows, response, first, x):
    """Return the variations x (2 nv, n) after the least impulses that stop some velocities. (D26)

    rows (m, 2 nv) are the derivatives of these velocities; NaN in one of them gives NaN in the result.
    Impulses change x from row `first` on by response (nv, m).
    """
    m, end = len(rows), x.copy()
    missed, matrix = np.zeros((m, x.shape[1])), np.zeros((m, m))
    add_product(rows, x, missed)
    add_product(rows[:, first : first + len(response)].copy(), response, matrix)
    unit, inverse = np.zeros((m, m)), np.zeros((m, m))
    for a in range(m):
        unit[a, a] = -1.0
    least_norms(matrix, unit, RANK, inverse, np.empty((0, m)))
    forces = np.zeros(missed.shape)
    add_product(inverse.T.copy(), missed, forces)
    add_product(response, forces, end[first : first + len(response)])
    return end


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def admitted(rows, gaps, response, inverse, x):
    """Return variations x (2 nv, n) at a start, projected onto those that active contacts admit.

    Args:
        rows: (m, 2 nv) derivatives of the velocities that vanish.
        gaps: (k,) those of them that are rates of gaps, which stay closed.
        response: (nv, m) derivatives of v̇ by the forces.
        inverse: (nv, nv) M⁻¹.
        x: (2 nv, n) variations.
    """
    nv, k = len(inverse), len(gaps)
    place, pushed, rate = np.zeros((k, 2 * nv)), np.empty((nv, k)), np.empty(nv)
    for a in range(k):
        assign(place[a, :nv], rows[gaps[a], nv:])
        apply_symmetric(inverse, place[a, :nv], rate)
        for j in range(nv):
            pushed[j, a] = rate[j]
    return stop(rows, response, nv, stop(place, pushed, 0, x))


@inlined
def raise_to(to, values):
    """Replace entries of `to` (n,) by the magnitudes of values (n,) where these are larger."""
    for i in range(len(to)):
        to[i] = max(to[i], abs(values[i]))


@inlined
def _turn(h, weights, twice, turned, turning, start):
    """Correct δq of joints that turn, in start (s, 2 nv, n); return its derivatives by rates (s k, s k)."""
    stages, size, n = len(turning), len(turned), start.shape[2]
    total = stages * size
    matrix, order = np.empty((total, total)), np.empty(total, dtype=np.int64)
    sides = np.zeros((total, total + n))
    for i in range(stages):
        for a in range(size):
            row, side = matrix[i * size + a], sides[i * size + a]
            for j in range(stages):
                for b in range(size):
                    row[j * size + b] = h * weights[i, j] * turning[j, a, b]
                side[j * size + a] = h * h * twice[i, j]
            row[i * size + a] += 1.0
            assign(side[total:], start[i, turned[a]])
    factorize(matrix, order)
    substitute(matrix, order, sides)
    for i in range(stages):
        for a in range(size):
            assign(start[i, turned[a]], sides[i * size + a, total:])
    return sides[:, :total].copy()
