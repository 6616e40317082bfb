"""Derivatives of an impact along the moves of "exact". (derivatives.md, with equations (D n))"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import always_inlined, external, inlined, released
from ..._numeric.loops import assign, filled
from ..._numeric.tolerances import TINY
from . import codes as code
from .batch import asymmetry, write_result
from .contact_problem import prepare
from .crossing import cross
from .ending import Result, no_result
from .moves import slip_units
from .path import MAX_MOVES, SCRATCH, VANISHED, solve_into
from .recording import MOVE
from .sensitivities import (
    B1,
    B2,
    CHI,
    COMPRESSED,
    END,
    MEAN,
    MU,
    NORMAL,
    OUT1,
    OUT2,
    OUT3,
    P1,
    P2,
    P3,
    PATH,
    ROW,
    SKEW,
    STOP,
    V1,
    V2,
    V3,
    VT1,
    VT2,
    WORK_DONE,
    C,
    E,
    clear_rows,
    combine,
)
from .slip_equations import in_frame
from .slip_panels import ROOM
from .tolerances import COINCIDENT, FLAT, THIN

SLOPES = 14
"""Columns of the derivatives: v₁, v₂, v₃, W row by row, μ, e. Rows are those of v⁺ and P."""

BY_W, BY_W33, BY_MU, BY_E = 3, 11, 12, 13
ALL, ALL_BUT_E = np.int64(SLOPES), np.int64(BY_E)

START_AT_REST, STICK_THRESHOLD, EVENTS_COINCIDE, JUMP, GRAZING, BOUND, RANK = (
    np.int64(1 << i) for i in range(7)
)

WITHIN_RANGE = np.int64(1 << 20)
"""Flag of `differentiate_into`: the derivatives hold for changes of v° within the range of W. Slip and
compression end together after these, but not after others."""

GROWTH = 50.0
"""Largest ratio of speeds on a panel of two moves: the square changes by e⁸, which twelve nodes integrate."""


@inlined
def _add_identity(problem, values, row, t, p1, p2, p3):
    """Add the change of v₃ = v₃° + k·(v_t − v_t°) + s P₃ at fixed v_t, or its integral over P₃. (D4)

    (t, p1, p2, p3) is (1, P), or its integral over P₃.
    """
    k1, k2 = problem.k1, problem.k2
    values[row + V1] -= k1 * t
    values[row + V2] -= k2 * t
    values[row + V3] += t
    values[row + B1] += p1 - k1 * p3
    values[row + B2] += p2 - k2 * p3
    values[row + C] += p3
    values[row + MEAN] -= k1 * p1 + k2 * p2
    values[row + SKEW] -= k1 * p1 - k2 * p2
    values[row + CHI] -= k1 * p2 + k2 * p1


@inlined
def _tangential_rate(problem, mode, s1, s2, gain):
    """Return dv_t/dP₃."""
    mu = problem.mu
    if mode == code.IN_SLIP:
        return (
            problem.b1 - mu * (problem.a11 * s1 + problem.a12 * s2),
            problem.b2 - mu * (problem.a12 * s1 + problem.a22 * s2),
        )
    if mode == code.IN_RESUMED_SLIP:
        return gain * s1, gain * s2
    return 0.0, 0.0


@always_inlined
def _at_event(problem, works, values, p1, p2, p3, q1, q2):
    """Fill row NORMAL and, with `works`, row WORK_DONE at fixed P₃; (q1, q2) is ∫P_t dP₃. (D4)"""
    if problem.mu > 0.0:  # slip depends on μ and A through μA only
        per = 1.0 / problem.mu
        mean, half = 0.5 * (problem.a11 + problem.a22), 0.5 * (problem.a11 - problem.a22)
        for row in (VT1, VT2, PATH, STOP):
            total = mean * values[row + MEAN] + half * values[row + SKEW] + problem.a12 * values[row + CHI]
            values[row + MU] = per * total
    combine(values, NORMAL, problem.k1, VT1, problem.k2, VT2)
    _add_identity(problem, values, NORMAL, 1.0, p1, p2, p3)
    if works:
        combine(values, WORK_DONE, 1.0, PATH, 0.0, PATH)
        _add_identity(problem, values, WORK_DONE, p3, q1, q2, 0.5 * p3 * p3)


@always_inlined
def _to_user(view, values, out):
    """Convert the derivatives from the `View` to the caller's axes and units, `out` (6, SLOPES)."""
    lean1, lean2 = view.lean1, view.lean2
    if not view.leaning:
        lean1, lean2 = 0.0, 1.0
    r11, r12, r21, r22 = lean2 * view.sign1, -lean1 * view.sign2, lean1 * view.sign1, lean2 * view.sign2
    if view.swapped:
        r11, r12, r21, r22 = -lean1 * view.sign1, lean2 * view.sign2, lean2 * view.sign1, lean1 * view.sign2
    cos2, sin2, skew, cross = r11 * r11 - r21 * r21, 2.0 * r11 * r21, r11 * r12, 0.5 * (r11 * r22 + r12 * r21)
    unit_v, per_w = math.ldexp(1.0, view.scale_v), math.ldexp(1.0, -view.scale_w)
    for first, per in ((0, 1.0), (3, per_w)):
        x, y = OUT1 + ROW * first, OUT2 + ROW * first
        combine(values, VT1, r11, x, r21, y)
        combine(values, VT2, r12, x, r22, y)
        by_w, by_mu = per * unit_v * per_w, per * unit_v
        for k in range(3):
            row, at = out[first + k], (VT1, VT2, OUT3 + ROW * first)[k]
            x1, x2, mean = values[at + V1], values[at + V2], 0.5 * values[at + MEAN]
            row[0], row[1] = per * (r11 * x1 + r21 * x2), per * (r12 * x1 + r22 * x2)
            row[2] = per * values[at + V3]
            x1, x2, half = values[at + SKEW], values[at + CHI], 0.5 * by_w
            turned = 0.5 * (cos2 * x1 + sin2 * x2)
            row[3], row[7] = by_w * (mean + turned), by_w * (mean - turned)
            row[4] = row[6] = by_w * (skew * x1 + cross * x2)
            x1, x2 = values[at + B1], values[at + B2]
            row[5] = row[9] = half * (r11 * x1 + r21 * x2)
            row[8] = row[10] = half * (r12 * x1 + r22 * x2)
            row[11], row[12], row[13] = by_w * values[at + C], by_mu * values[at + MU], by_mu * values[at + E]


@always_inlined
def _close(problem, values, rate1, rate2, rate, p1, p2, p3):
    """Fill the rows of v⁺ and P, with dv/dP₃ and P at the end and the change of P₃ in row END. (D15)"""
    a11, a12, a22 = problem.a11, problem.a12, problem.a22
    det = a11 * a22 - a12 * a12
    trace = a11 + a22
    i11, i12, i22 = a22 / det, -a12 / det, a11 / det
    if trace == 0.0:  # no tangential mobility
        i11 = i12 = i22 = 0.0
    elif problem.flat:
        i11, i12, i22 = a11 / (trace * trace), a12 / (trace * trace), a22 / (trace * trace)
    combine(values, OUT1, 1.0, VT1, rate1, END)
    combine(values, OUT2, 1.0, VT2, rate2, END)
    combine(values, OUT3, 1.0, NORMAL, rate, END)
    combine(values, VT1, 1.0, OUT1, -problem.b1, END)
    combine(values, VT2, 1.0, OUT2, -problem.b2, END)
    for row, column, along, skew, chi in ((VT1, V1, p1, p1, p2), (VT2, V2, p2, -p2, p1)):
        values[row + column] -= 1.0
        values[row + B1 + column] -= p3
        values[row + MEAN] -= along
        values[row + SKEW] -= skew
        values[row + CHI] -= chi
    combine(values, P1, i11, VT1, i12, VT2)
    combine(values, P2, i12, VT1, i22, VT2)
    combine(values, P3, 1.0, END, 0.0, END)
    if problem.flat and problem.s == 0.0:  # W has rank one: P_t is along b, and turns with it
        b1, b2 = problem.b1, problem.b2
        turn = (b1 * p1 + b2 * p2) / (b1 * b1 + b2 * b2) ** 2
        values[P1 + B1] += turn * b2 * b2
        values[P1 + B2] -= turn * b1 * b2
        values[P2 + B1] -= turn * b1 * b2
        values[P2 + B2] += turn * b1 * b1


@always_inlined
def _ending(problem, values, restored, rate, v3, total):
    """Fill row END, the change of P₃ at the end. (D14)

    Args:
        problem, values: The `Problem`, and the rows of sensitivities.
        restored: Whether there was restitution.
        rate, v3: dv₃/dP₃ and v₃ at the end.
        total: The impulse or work of compression, by the quantity of the law.
    """
    e = problem.e
    if problem.counts == code.IMPULSE:
        combine(values, END, 1.0 + e, COMPRESSED, 0.0, COMPRESSED)
        values[END + E] = total
    elif problem.counts == code.VELOCITY or not restored:
        combine(values, END, -1.0 / rate, NORMAL, 0.0, NORMAL)
        if problem.counts == code.VELOCITY:
            values[END + V3] -= e / rate
            values[END + E] = -problem.v3 / rate
        else:
            values[END + E] = math.sqrt(-2.0 * total / rate)
    else:
        combine(values, END, (1.0 - e * e) / v3, COMPRESSED, -1.0 / v3, WORK_DONE)
        values[END + E] = -2.0 * e * total / v3


@inlined
def _fill(out, first, last, value):
    for i in range(6):
        for j in range(first, last):
            out[i, j] = value


@inlined
def _without_impact(v3, out):
    _fill(out, 0, SLOPES, 0.0)
    out[0, 0] = out[1, 1] = out[2, 2] = 1.0
    if v3 > 0.0:
        return code.NO_FLAG
    _fill(out, 2, 3, math.nan)
    return GRAZING


@always_inlined
def _book(problem, values, event, rate, p3):
    """Add the change of an event at P₃ to row COMPRESSED; return its contribution to the sum itself. (D14)"""
    sign = 1.0 if event == code.COMPRESSION_ENDS else -1.0
    row, per = (WORK_DONE, sign) if problem.counts == code.WORK else (NORMAL, -sign / rate)
    combine(values, COMPRESSED, 1.0, COMPRESSED, per, row)
    return sign * p3


@always_inlined
def _needed(problem, moves, rows):
    """Return the last move of slip on which the result depends, and the one at whose end v_t = 0; −1: none.

    Stick depends on the path before only through its events, unless the law is that of work.
    """
    stop = last = -1
    resumed = problem.counts == code.WORK
    for i in range(rows):
        if moves[i, 0] == code.IN_RESUMED_SLIP:
            resumed = True
        if moves[i, 0] == code.IN_SLIP and moves[i + 1, 9] == 0.0 and problem.mu > 0.0:
            stop = i
    for i in range(stop + 1):
        if moves[i, 6] != code.NO_EVENT or resumed:
            last = i
    return last, stop


@inlined
def _repels(problem, s1, s2):
    """Return whether small changes across σ grow as straight slip stops: η < ½. (D33)"""
    al, _, ap, bl, _ = in_frame(problem.a11, problem.a12, problem.a22, problem.b1, problem.b2, s1, s2)
    return not problem.flat and 2.0 * problem.mu * ap < problem.mu * al - bl


@always_inlined
def _join(moves, rows):
    """Join pairs of consecutive moves of turning slip in place; return the new number of moves.

    A series ends at a third of the distance to its singularity, two series at 5/9. Up to there the Gauss rule
    is exact to rounding, if the speed changes by at most `GROWTH`.
    """
    i = left = 0
    while i < rows:
        if left < i:
            assign(moves[left], moves[i])
        move, follower, speed = moves[left], moves[i + 1], moves[i, 9]
        turns = move[0] == code.IN_SLIP and move[12] == 0.0 and move[6] == code.NO_EVENT and i + 1 < rows
        if turns and follower[0] == code.IN_SLIP and follower[12] == 0.0:
            t, u, end = 0.5 * move[10] * move[11], 0.5 * follower[10] * follower[11], moves[i + 2, 9]
            turned = t + u
            if t * u != 0.0 and abs(turned) <= 1.0 - t * u and speed < GROWTH * end and end < GROWTH * speed:
                move[11] *= turned / (t * (1.0 - t * u))
                move[3], move[4], move[6], move[13] = (
                    follower[3],
                    move[4] + follower[4],
                    follower[6],
                    follower[13],
                )
                i += 1
        i, left = i + 1, left + 1
    if left < i:
        assign(moves[left], moves[i])
    return left


@always_inlined
def _follow(problem, units, view, moves, values, rows, after3):
    """Propagate the sensitivities through all moves and fill the rows of v⁺ and P, in the `View`.

    Args:
        problem, units, view: The `Problem`, its `Units` and its `View`.
        moves, rows: (m, MOVE) trace of `record_course`, and its number of rows.
        values: (ROOM,) scratch; rows OUT1 to P3 are overwritten with the result.
        after3: v₃⁺.

    Returns:
        Flags of `Boundary`, and the number of columns, from the first on, without derivative.
    """
    boundary, unknown, rows = code.NO_FLAG, code.NONE_YET, _join(moves, rows)
    at_rest = problem.speed <= VANISHED
    works = problem.counts == code.WORK
    unit, work_unit = (
        math.ldexp(1.0, view.scale_w - view.scale_v),
        math.ldexp(1.0, view.scale_w - 2 * view.scale_v),
    )
    whole = unit * moves[rows - 1, 3]
    steepest = problem.c + problem.mu * (abs(problem.b1) + abs(problem.b2))
    q1 = q2 = rest_at = total = 0.0
    clear_rows(values, OUT1)
    if not at_rest:
        values[VT1 + V1] = values[VT2 + V2] = 1.0
    last_needed, stop = _needed(problem, moves, rows)
    # v₃ = 0 where v_t = 0, also after changes within the range of W: these events are one
    locks = problem.s == 0.0 and abs(problem.offset) <= COINCIDENT
    for i in range(rows):
        move, after = moves[i], moves[i + 1]
        event, rate, last = move[6], move[13], i == rows - 1
        start, p3 = unit * move[2], unit * move[3]
        n1 = n2 = gain = 0.0
        if not last_needed < i <= stop:
            n1, n2, gain = cross(problem, units, move, after, start, p3, rest_at, values)
        q1, q2 = q1 + (p3 - start) * move[14] - n1, q2 + (p3 - start) * move[15] - n2
        if i == stop:
            rest_at = p3
            if 0.0 < abs(move[11]) < math.inf:  # slip still turned: P* has derivatives along directions only
                boundary |= START_AT_REST
            elif _repels(problem, move[7], move[8]):
                boundary |= EVENTS_COINCIDE
            clear_rows(values, PATH)
        if works and move[1] == code.COMPRESSION:
            total += work_unit * move[4]
        if event == code.NO_EVENT:
            continue
        at_stop = rest_at > 0.0 and abs(p3 - rest_at) <= COINCIDENT * whole
        if at_stop and locks:
            boundary |= WITHIN_RANGE
        elif at_stop:
            boundary, unknown = boundary | EVENTS_COINCIDE, ALL if last else max(unknown, ALL_BUT_E)
        _at_event(problem, works, values, after[14], after[15], p3, q1, q2)
        if at_stop and locks:
            combine(values, NORMAL, 1.0, NORMAL, -rate, STOP)
        turns = event != code.LAW_MET
        if turns:
            gained = _book(problem, values, event, rate, p3)
            total += 0.0 if works else gained
        steep = turns or problem.counts == code.VELOCITY
        if (steep and abs(rate) <= FLAT * steepest) or (
            rate < 0.0 and last and after3 <= FLAT * steepest * whole
        ):
            boundary, unknown = boundary | JUMP, ALL
        if last:
            _ending(problem, values, not turns, rate, after3, total)
            on = after if move[0] == code.IN_SLIP and problem.mu > 0.0 else move
            rate1, rate2 = _tangential_rate(problem, move[0], on[7], on[8], gain)
            _close(problem, values, rate1, rate2, rate, after[14], after[15], p3)
    return boundary, unknown


@always_inlined
def _differentiate(problem, view, flags, moves, values, out, rows, after3):
    """Fill `out` (6, SLOPES) with the derivatives, NaN if they do not exist; return flags of `Boundary`.

    Other arguments as for `_follow`.
    """
    after3 = math.ldexp(after3, -view.scale_v)
    boundary, unknown = _follow(problem, slip_units(problem), view, moves, values, rows, after3)
    _to_user(view, values, out)
    _fill(out, 0, unknown, math.nan)
    mu, e = problem.mu, problem.e
    if mu == 0.0 or e == 0.0 or e == 1.0:
        boundary |= BOUND
    ratio = math.sqrt(problem.k1 * problem.k1 + problem.k2 * problem.k2)
    threshold = flags & (code.SLIP_RESUMED | code.STICKS) > 0 and abs(ratio - mu) <= COINCIDENT * mu
    if threshold:
        boundary |= STICK_THRESHOLD
        _fill(out, BY_W, BY_W33, math.nan)
        _fill(out, BY_MU, BY_E, math.nan)
    turned = boundary & START_AT_REST > 0
    boundary &= ~START_AT_REST
    if (problem.speed <= VANISHED or turned) and (flags & code.SLIP_RESUMED > 0 or threshold):
        boundary |= START_AT_REST
        _fill(out, 0, 2, math.nan)
        if turned:
            _fill(out, BY_W, BY_W33, math.nan)
            _fill(out, BY_MU, BY_E, math.nan)
    if problem.v3 == 0.0:
        boundary |= JUMP
        _fill(out, 2, BY_W, math.nan)
    trace = problem.a11 + problem.a22
    det = problem.a11 * problem.a22 - problem.a12 * problem.a12
    if not problem.flat and det < THIN * trace * trace:
        boundary |= RANK
        for row in out[3:5]:
            filled(row, math.nan if mu > 0.0 else 0.0)
            row[BY_MU] = math.nan
    return boundary


@declared(
    *(int, *11 * [float], int, float, FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS),
    *(INTEGER_ROWS, FLOAT_ROWS, INTEGERS),
)
@external
def differentiate_into(
    i, w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor, scratch, moves, numbers,
    codes, out, boundaries,
):  # fmt: skip
    """Solve one problem and differentiate v⁺ and P by all inputs.

    Args:
        w11 … factor: As for `solve_into`.
        scratch, moves: (SCRATCH + ROOM,), (MAX_MOVES + 1, MOVE) scratch.
        out: (6, SLOPES) is overwritten with the derivatives; NaN if they do not exist.
        i, numbers, codes, boundaries: Row i is overwritten with result and flags, as in `differentiate_rows`.
    """
    factor, scratch, moves, numbers = borrowed(factor), borrowed(scratch), borrowed(moves), borrowed(numbers)
    codes, out, boundaries = borrowed(codes), borrowed(out), borrowed(boundaries)
    if mu < TINY:
        mu = 0.0  # where 1/μ overflows, and μA underflows, the derivatives are those without friction
    given = w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor
    result = Result(*solve_into(*given, scratch, moves, moves[:0]))
    write_result(i, result, numbers, codes)
    if result.status == code.NO_IMPACT:
        boundaries[i] = _without_impact(v3, out)
        return
    boundaries[i] = RANK if result.flags & code.SINGULAR_DELASSUS else code.NO_FLAG
    rows = result.trace_rows
    if result.status > code.LOCKED or result.flags & code.LOCKS:
        _fill(out, 0, SLOPES, math.nan)
        return
    _, _, _, view, problem = prepare(*given)
    boundaries[i] |= _differentiate(
        problem, view, result.flags, moves, scratch[SCRATCH:], out, rows, result.v3
    )


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
        delassus … codes: As for `batch.solve_rows`.
        slopes: (N, 6, SLOPES) is overwritten with the derivatives by v, W, μ and e; NaN if they do not exist.
        boundaries: (N,) is overwritten with flags of `Boundary`.
    """
    scratch, moves, none = np.empty(SCRATCH + ROOM), np.empty((MAX_MOVES + 1, MOVE)), np.empty(0)
    delassus, velocity, friction = borrowed(delassus), borrowed(velocity), borrowed(friction)
    restitution, velocity_scale, factors = borrowed(restitution), borrowed(velocity_scale), borrowed(factors)
    slopes, boundaries = borrowed(slopes), borrowed(boundaries)
    for i in range(velocity.shape[0]):
        w, v, out = delassus[i], velocity[i], slopes[i]
        factor = none
        if len(factors) > 0 and factors[i, 6] > 0.0:
            factor = factors[i]
        if asymmetry(w):
            write_result(i, no_result(code.INDEFINITE_DELASSUS, 0.0), numbers, codes)
            _fill(out, 0, SLOPES, math.nan)
            boundaries[i] = code.NO_FLAG
            continue
        differentiate_into(
            *(i, w[0, 0], 0.5 * (w[0, 1] + w[1, 0]), 0.5 * (w[0, 2] + w[2, 0]), w[1, 1]),
            *(0.5 * (w[1, 2] + w[2, 1]), w[2, 2], v[0], v[1], v[2], friction[i], restitution[i]),
            *(law, velocity_scale[i], factor, scratch, moves, numbers, codes, out, boundaries),
        )
        if boundaries[i] & WITHIN_RANGE:
            boundaries[i] = boundaries[i] & ~WITHIN_RANGE | EVENTS_COINCIDE
            _fill(out, 0, ALL_BUT_E, math.nan)
