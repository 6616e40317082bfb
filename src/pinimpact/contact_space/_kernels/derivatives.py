"""Derivatives of an impact by the moves of "exact". (derivatives.md, whose equations are cited as D n)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import always_inlined, external, inlined, released
from .batch import asymmetry, write_result
from .codes import (
    COMPRESSION,
    COMPRESSION_ENDS,
    IMPULSE,
    IN_RESUMED_SLIP,
    IN_SLIP,
    INDEFINITE_DELASSUS,
    LAW_MET,
    LOCKED,
    LOCKS,
    NO_EVENT,
    NO_FLAG,
    NO_IMPACT,
    NONE_YET,
    SINGULAR_DELASSUS,
    SLIP_RESUMED,
    STICKS,
    VELOCITY,
    WORK,
)
from .contact_problem import prepare
from .crossing import cross
from .ending import Result, no_result
from .moves import slip_units
from .path import MAX_MOVES, SCRATCH, VANISHED, solve_into
from .recording import MOVE
from .slip_derivatives import DATA, NODE_ROOM, PATH, VT1, VT2

INPUTS = 11
"""v₁, v₂, v₃, w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃, μ, e: columns of the derivatives. Rows are those of v⁺ and P."""

V1, V2, V3, W11, W12, W13, W22, W23, W33, MU, E = range(INPUTS)
ALL, ALL_BUT_E = np.int64(INPUTS), np.int64(E)

START_AT_REST, STICK_THRESHOLD, EVENTS_COINCIDE, JUMP, GRAZING, BOUND, RANK = (
    np.int64(1 << i) for i in range(7)
)

NORMAL, WORK_DONE, COMPRESSED, END = 0, 1, 2, 3
"""Rows of what is differentiated by all inputs: v₃ and its work at fixed P₃, the law's sum over compression,
and the P₃ at which an event is."""

COINCIDENT = 1e-11
"""Distance of two events, over all of P₃, up to which rounding decides their order."""

AT_THRESHOLD = 1e-11
"""Distance of μ from the stick threshold, over μ, up to which rounding decides."""

FLAT = 1e-7
"""Of a rate or velocity over its scale at an event: below it v⁺ jumps or has a slope without bound nearby."""


@inlined
def _spread(problem, found, row, out, target):
    """Write a row of sensitivities by the columns of `DATA` into one by those of `INPUTS`."""
    alpha, delta, chi = found[row, 4], found[row, 5], found[row, 6]
    out[target, V1], out[target, V2], out[target, V3] = found[row, 0], found[row, 1], 0.0
    out[target, W11], out[target, W12], out[target, W22] = 0.5 * (alpha + delta), chi, 0.5 * (alpha - delta)
    out[target, W13], out[target, W23], out[target, W33] = found[row, 2], found[row, 3], 0.0
    out[target, MU], out[target, E] = found[row, 7], 0.0
    if problem.mu > 0.0:  # slip knows b and μA only
        mean, half = 0.5 * (problem.a11 + problem.a22), 0.5 * (problem.a11 - problem.a22)
        out[target, MU] = (alpha * mean + delta * half + chi * problem.a12) / problem.mu


@inlined
def _add_identity(problem, out, row, t, p1, p2, p3):
    """Add what v₃ = v₃° + κ·(v_t − v_t°) + s P₃ changes by at fixed v_t, or its integral. (D4)

    Args:
        t: 1, or its integral over P₃,
        p1, p2, p3: and P, or its integral.
    """
    k1, k2 = problem.k1, problem.k2
    out[row, V1] -= k1 * t
    out[row, V2] -= k2 * t
    out[row, V3] += t
    out[row, W11] -= k1 * p1
    out[row, W12] -= k1 * p2 + k2 * p1
    out[row, W22] -= k2 * p2
    out[row, W13] += p1 - k1 * p3
    out[row, W23] += p2 - k2 * p3
    out[row, W33] += p3


@inlined
def _tangential_rate(problem, mode, s1, s2, gain):
    """Return dv_t/dP₃."""
    mu = problem.mu
    if mode == IN_SLIP:
        return (
            problem.b1 - mu * (problem.a11 * s1 + problem.a12 * s2),
            problem.b2 - mu * (problem.a12 * s1 + problem.a22 * s2),
        )
    if mode == IN_RESUMED_SLIP:
        return gain * s1, gain * s2
    return 0.0, 0.0


@always_inlined
def _at_event(problem, works, found, out, p1, p2, p3, q1, q2):
    """Fill rows NORMAL and, if wanted, WORK_DONE at fixed P₃; q is ∫P_t dP₃. (D4)"""
    k1, k2 = problem.k1, problem.k2
    _spread(problem, found, VT1, out, NORMAL)
    _spread(problem, found, VT2, out, WORK_DONE)
    for j in range(INPUTS):
        out[NORMAL, j] = k1 * out[NORMAL, j] + k2 * out[WORK_DONE, j]
    _add_identity(problem, out, NORMAL, 1.0, p1, p2, p3)
    if works:
        _spread(problem, found, PATH, out, WORK_DONE)
        _add_identity(problem, out, WORK_DONE, p3, q1, q2, 0.5 * p3 * p3)


@always_inlined
def _to_user(view, out):
    """Turn and scale the derivatives back from the `View`."""
    lean1, lean2 = view.lean1, view.lean2
    if not view.leaning:
        lean1, lean2 = 0.0, 1.0
    r11, r12, r21, r22 = lean2 * view.sign1, -lean1 * view.sign2, lean1 * view.sign1, lean2 * view.sign2
    if view.swapped:
        r11, r12, r21, r22 = -lean1 * view.sign1, lean2 * view.sign2, lean2 * view.sign1, lean1 * view.sign2
    for j in range(INPUTS):
        for i in (0, 3):
            x, y = out[i, j], out[i + 1, j]
            out[i, j], out[i + 1, j] = r11 * x + r21 * y, r12 * x + r22 * y
    unit_v, per_v, per_w = (
        math.ldexp(1.0, view.scale_v),
        math.ldexp(1.0, -view.scale_v),
        math.ldexp(1.0, -view.scale_w),
    )
    for i in range(6):
        for j in (V1, W13):
            k = V2 if j == V1 else W23
            x, y = out[i, j], out[i, k]
            out[i, j], out[i, k] = r11 * x + r21 * y, r12 * x + r22 * y
        x, y, z = out[i, W11], out[i, W12], out[i, W22]
        out[i, W11] = r11 * r11 * x + r11 * r21 * y + r21 * r21 * z
        out[i, W12] = 2.0 * r11 * r12 * x + (r11 * r22 + r12 * r21) * y + 2.0 * r21 * r22 * z
        out[i, W22] = r12 * r12 * x + r12 * r22 * y + r22 * r22 * z
        unit = unit_v if i < 3 else unit_v * per_w
        for j in range(W11):
            out[i, j] *= unit * per_v
        for j in range(W11, MU):
            out[i, j] *= unit * per_w
        out[i, MU], out[i, E] = unit * out[i, MU], unit * out[i, E]


@always_inlined
def _close(problem, found, columns, rate1, rate2, rate, p1, p2, p3, out):
    """Fill the derivatives at the end, where P₃ changes by row END. (D15)

    Args:
        rate1, rate2, rate: dv/dP₃ there.
        p1, p2, p3: P.
    """
    _spread(problem, found, VT1, out, 0)
    _spread(problem, found, VT2, out, 1)
    a11, a12, a22 = problem.a11, problem.a12, problem.a22
    det = a11 * a22 - a12 * a12
    trace = a11 + a22
    i11, i12, i22 = a22 / det, -a12 / det, a11 / det
    if problem.flat:
        i11, i12, i22 = a11 / (trace * trace), a12 / (trace * trace), a22 / (trace * trace)
    for j in range(INPUTS):
        end = columns[END, j]
        out[0, j] += rate1 * end
        out[1, j] += rate2 * end
        out[2, j] = columns[NORMAL, j] + rate * end
        out[3, j], out[4, j], out[5, j] = out[0, j] - problem.b1 * end, out[1, j] - problem.b2 * end, end
    out[3, V1], out[3, W11], out[3, W12], out[3, W13] = (
        out[3, V1] - 1.0,
        out[3, W11] - p1,
        out[3, W12] - p2,
        out[3, W13] - p3,
    )
    out[4, V2], out[4, W12], out[4, W22], out[4, W23] = (
        out[4, V2] - 1.0,
        out[4, W12] - p1,
        out[4, W22] - p2,
        out[4, W23] - p3,
    )
    for j in range(INPUTS):
        x, y = out[3, j], out[4, j]
        out[3, j], out[4, j] = i11 * x + i12 * y, i12 * x + i22 * y


@always_inlined
def _ending(problem, columns, restored, rate, v3, total):
    """Fill row END: how the P₃ at the end changes. (D14)

    Args:
        restored: Whether there was restitution.
        rate, v3: dv₃/dP₃ and v₃ there.
        total: The sum that the law counts over compression.
    """
    e = problem.e
    for j in range(INPUTS):
        if problem.counts == IMPULSE:
            columns[END, j] = (1.0 + e) * columns[COMPRESSED, j]
        elif problem.counts == VELOCITY or not restored:
            columns[END, j] = -columns[NORMAL, j] / rate
        else:
            columns[END, j] = ((1.0 - e * e) * columns[COMPRESSED, j] - columns[WORK_DONE, j]) / v3
    if problem.counts == IMPULSE:
        columns[END, E] += total
    elif problem.counts == VELOCITY:
        columns[END, V3] -= e / rate
        columns[END, E] -= problem.v3 / rate
    elif restored:
        columns[END, E] -= 2.0 * e * total / v3
    else:
        columns[END, E] = math.sqrt(-2.0 * total / rate)


@inlined
def _fill(out, first, last, value):
    for i in range(6):
        for j in range(first, last):
            out[i, j] = value


@inlined
def _without_impact(v3, out):
    _fill(out, 0, INPUTS, 0.0)
    out[0, V1] = out[1, V2] = out[2, V3] = 1.0
    if v3 > 0.0:
        return NO_FLAG
    _fill(out, V3, V3 + 1, math.nan)
    return GRAZING


@always_inlined
def _book(problem, columns, event, rate, p3):
    """Add to row COMPRESSED what an event at P₃ does to the law's sum; return the sum's gain. (D14)"""
    sign = 1.0 if event == COMPRESSION_ENDS else -1.0
    row, per = (WORK_DONE, sign) if problem.counts == WORK else (NORMAL, -sign / rate)
    for j in range(INPUTS):
        columns[COMPRESSED, j] += per * columns[row, j]
    return sign * p3


@always_inlined
def _needed(problem, moves, rows):
    """Return the last move of slip that anything depends on, and the one at whose end v_t = 0; −1: none.

    In stick nothing of the path is left but events before it, unless its work counts.
    """
    stop = last = -1
    resumed = problem.counts == WORK
    for i in range(rows):
        if moves[i, 0] == IN_RESUMED_SLIP:
            resumed = True
        if moves[i, 0] == IN_SLIP and moves[i + 1, 9] == 0.0 and problem.mu > 0.0:
            stop = i
    for i in range(stop + 1):
        if moves[i, 6] != NO_EVENT or resumed:
            last = i
    return last, stop


@always_inlined
def _follow(problem, units, view, moves, values, found, columns, out, rows, after3):
    """Go through the moves and fill `out`, in the `View`.

    Args:
        problem, units, view: The impact.
        moves: (m, MOVE) trace of it,
        rows: of which so many are filled.
        values, found, columns: (NODE_ROOM,), (4, DATA), (4, INPUTS) scratch, the last two zero.
        out: (6, INPUTS).
        after3: v₃⁺.

    Returns:
        flags of `Boundary`, and how many columns have no derivative, from the first on.
    """
    boundary, unknown = NO_FLAG, NONE_YET
    at_rest = problem.speed <= VANISHED
    works = problem.counts == WORK
    unit, work_unit = (
        math.ldexp(1.0, view.scale_w - view.scale_v),
        math.ldexp(1.0, view.scale_w - 2 * view.scale_v),
    )
    whole = unit * moves[rows - 1, 3]
    steepest = problem.c + problem.mu * (abs(problem.b1) + abs(problem.b2))
    q1 = q2 = rest_at = total = 0.0
    if not at_rest:
        found[VT1, 0] = found[VT2, 1] = 1.0
    last_needed, stop = _needed(problem, moves, rows)
    for i in range(rows):
        move, after = moves[i], moves[i + 1]
        event, rate, last = move[6], move[13], i == rows - 1
        start, p3 = unit * move[2], unit * move[3]
        n1 = n2 = gain = 0.0
        if not last_needed < i <= stop:
            n1, n2, gain = cross(problem, units, move, after, start, p3, rest_at, values, found)
            if math.isnan(found[VT1, 0]):
                boundary |= STICK_THRESHOLD
        q1, q2 = q1 + (p3 - start) * move[14] - n1, q2 + (p3 - start) * move[15] - n2
        if i == stop:
            rest_at = p3
            if 0.0 < abs(move[11]) < math.inf:  # it still turned, so P* depends on directions as from rest
                boundary |= START_AT_REST
            for j in range(DATA):
                found[VT1, j] = found[VT2, j] = 0.0
        if works and move[1] == COMPRESSION:
            total += work_unit * move[4]
        if event == NO_EVENT:
            continue
        if rest_at > 0.0 and abs(p3 - rest_at) <= COINCIDENT * whole:
            boundary, unknown = boundary | EVENTS_COINCIDE, ALL if last else max(unknown, ALL_BUT_E)
        _at_event(problem, works, found, columns, after[14], after[15], p3, q1, q2)
        turns = event != LAW_MET
        if turns:
            gained = _book(problem, columns, event, rate, p3)
            total += 0.0 if works else gained
        steep = turns or problem.counts == VELOCITY
        if (steep and abs(rate) <= FLAT * steepest) or (
            rate < 0.0 and last and after3 <= FLAT * steepest * whole
        ):
            boundary, unknown = boundary | JUMP, ALL
        if last:
            _ending(problem, columns, not turns, rate, after3, total)
            on = after if move[0] == IN_SLIP and problem.mu > 0.0 else move
            rate1, rate2 = _tangential_rate(problem, move[0], on[7], on[8], gain)
            _close(problem, found, columns, rate1, rate2, rate, after[14], after[15], p3, out)
    return boundary, unknown


@always_inlined
def _differentiate(problem, view, flags, moves, values, found, columns, out, rows, after3):
    """Fill `out` with the derivatives, NaN in columns that have none; return flags of `Boundary`."""
    found[:, :] = 0.0
    columns[:, :] = 0.0
    after3 = math.ldexp(after3, -view.scale_v)
    boundary, unknown = _follow(
        problem, slip_units(problem), view, moves, values, found, columns, out, rows, after3
    )
    _to_user(view, out)
    _fill(out, 0, unknown, math.nan)
    mu, e = problem.mu, problem.e
    if mu == 0.0 or e == 0.0 or e == 1.0:
        boundary |= BOUND
    ratio = math.sqrt(problem.k1 * problem.k1 + problem.k2 * problem.k2)
    threshold = flags & (SLIP_RESUMED | STICKS) > 0 and abs(ratio - mu) <= AT_THRESHOLD * mu
    if threshold:
        boundary |= STICK_THRESHOLD
        _fill(out, W11, W33, math.nan)
        _fill(out, MU, E, math.nan)
    turned = boundary & START_AT_REST > 0
    boundary &= ~START_AT_REST
    if (problem.speed <= VANISHED or turned) and (flags & SLIP_RESUMED > 0 or threshold):
        boundary |= START_AT_REST
        _fill(out, V1, V3, math.nan)
        if turned:
            _fill(out, W11, W33, math.nan)
            _fill(out, MU, E, math.nan)
    if problem.v3 == 0.0:
        boundary |= JUMP
        _fill(out, V3, W11, math.nan)
    return boundary


_MOVES = SCRATCH
_VALUES = _MOVES + MAX_MOVES * MOVE
_FOUND = _VALUES + NODE_ROOM
_COLUMNS = _FOUND + 4 * DATA
ROOM = _COLUMNS + 4 * INPUTS
"""Floats of scratch that a derivative needs."""


@declared(int, *11 * [float], int, float, FLOATS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, INTEGERS)
@external
def differentiate_into(
    i, w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor, room, numbers, codes,
    out, boundaries,
):  # fmt: skip
    """Solve one problem and differentiate v⁺ and P by all inputs.

    Args:
        w11 … factor: As in `solve_into`.
        room: (ROOM,) of any numbers.
        out: (6, INPUTS) takes the derivatives; NaN in columns that have none.
        i, numbers, codes, boundaries: Row i takes the answer and flags, as in `differentiate_rows`.
    """
    factor, room, numbers, codes, out, boundaries = (
        *(borrowed(factor), borrowed(room), borrowed(numbers), borrowed(codes), borrowed(out)),
        borrowed(boundaries),
    )
    scratch, moves = room[:_MOVES], room[_MOVES:_VALUES].reshape((MAX_MOVES, MOVE))
    given = w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor
    result = Result(*solve_into(*given, scratch, moves, room[:0].reshape((0, 6))))
    write_result(i, result, numbers, codes)
    if result.status == NO_IMPACT:
        boundaries[i] = _without_impact(v3, out)
        return
    _fill(out, 0, INPUTS, math.nan)
    boundaries[i] = RANK if result.flags & SINGULAR_DELASSUS else NO_FLAG
    rows = result.trace_rows
    if result.status <= LOCKED and rows + 1 < MAX_MOVES and not result.flags & LOCKS:
        _, _, _, view, problem = prepare(*given)
        boundaries[i] |= _differentiate(
            *(problem, view, result.flags, moves, room[_VALUES:_FOUND]),
            *(room[_FOUND:_COLUMNS].reshape((4, DATA)), room[_COLUMNS:].reshape((4, INPUTS))),
            *(out, rows, result.v3),
        )


@always_inlined
def _write_slopes(out, slopes, i):
    """Write derivatives into row i, with W in full."""
    for k in range(6):
        for j in range(3):
            slopes[i, k, j] = out[k, j]
        w12, w13, w23 = 0.5 * out[k, W12], 0.5 * out[k, W13], 0.5 * out[k, W23]
        slopes[i, k, 3], slopes[i, k, 4], slopes[i, k, 5] = out[k, W11], w12, w13
        slopes[i, k, 6], slopes[i, k, 7], slopes[i, k, 8] = w12, out[k, W22], w23
        slopes[i, k, 9], slopes[i, k, 10], slopes[i, k, 11] = w13, w23, out[k, W33]
        slopes[i, k, 12], slopes[i, k, 13] = out[k, MU], out[k, E]


@declared(
    *(FLOAT_STACK, FLOAT_ROWS, FLOATS, FLOATS, int, FLOATS, FLOAT_ROWS),
    *(FLOAT_ROWS, INTEGER_ROWS, FLOAT_STACK, INTEGERS),
)
@released
def differentiate_rows(
    delassus, velocity, friction, restitution, law, velocity_scale, factors, numbers, codes, slopes,
    boundaries,
):  # fmt: skip
    """Solve N problems and differentiate v⁺ and P by all inputs.

    Args:
        delassus … codes: As in `batch.solve_rows`.
        slopes: (N, 6, 14) receives the derivatives by v, W, μ and e; NaN in columns that have none.
        boundaries: (N,) receives flags of `Boundary`.
    """
    room, none, out = np.empty(ROOM), np.empty(0), np.empty((6, INPUTS))
    for i in range(velocity.shape[0]):
        w, v = delassus[i], velocity[i]
        factor = none
        if len(factors) > 0 and factors[i, 6] > 0.0:
            factor = factors[i]
        if asymmetry(w):
            write_result(i, no_result(INDEFINITE_DELASSUS, 0.0), numbers, codes)
            slopes[i, :, :] = math.nan
            boundaries[i] = NO_FLAG
            continue
        differentiate_into(
            *(i, w[0, 0], 0.5 * (w[0, 1] + w[1, 0]), 0.5 * (w[0, 2] + w[2, 0]), w[1, 1]),
            *(0.5 * (w[1, 2] + w[2, 1]), w[2, 2], v[0], v[1], v[2], friction[i], restitution[i]),
            *(law, velocity_scale[i], factor, room, numbers, codes, out, boundaries),
        )
        _write_slopes(out, slopes, i)
