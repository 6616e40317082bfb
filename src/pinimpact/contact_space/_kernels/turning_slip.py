"""Slip that turns: to its next event, or as far as one series carries. (theory.md, 3.3 and 4)"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import always_inlined_bitcode
from .codes import (
    COMPRESSION_ENDS,
    COMPRESSION_RESUMES,
    IMPULSE,
    LAW_MET,
    NEAR_JUMP,
    NEVER,
    NO_EVENT,
    NO_FLAG,
    RESTITUTION,
    VELOCITY,
    WORK,
)
from .contact_problem import Problem
from .invariant_direction import expand_around_root, nearby_root
from .moves import NO_FORCE, Move, State, Units, jams, lifting, tied
from .recording import record_series
from .slip_equations import TERMS, Polynomials, Shape, expand, reach
from .slip_events import seek, seek_near
from .slip_series import SlipSeries, first_root, halley, last_root, point
from .slip_works import works
from .tolerances import CLOSE_TO_JUMP

BEYOND_GUESS = 1.0625
"""How far a series is made for an event, over the guess of where it lies, mostly right to a percent."""

FURTHEST = 100.0
"""Growth of slip, as an exponent, up to which one series follows it as it leaves an invariant direction."""


@declared(
    *(FLOATS, FLOATS, FLOATS, Problem, Units, State, Polynomials, float, float, float, int, float, float),
    *(bool, FLOAT_ROWS, int),
)
@always_inlined_bitcode
def turning_move(
    coefficients, reciprocals, nodes, problem, units, state, polynomials, bl, bp, rate, phase, goal,
    left, traced, path, points,
):  # fmt: skip
    """Follow slip that turns along one series, on which v₃ is monotone.

    Args:
        coefficients, reciprocals, nodes: Scratch for the coefficients of the series, for 1/(a + k), and
            for the works.
        problem, units, state: The impact, and where it stands.
        polynomials, bl, bp, rate: The slip equations, b∥, b⊥ and dv₃/dP₃ in the present frame.
        phase, goal, left: Of the restitution, from the `Ledger`.
        traced: Whether the works of the move are written down.
        path, points: Where points are recorded, and how many there are.

    Returns:
        the `Move`, the state after it, flags to be set, and the points recorded.
    """
    s1, s2, speed, v3, turn, p1, p2, p3 = state
    mu, c, s, endless_slip, counts = problem.mu, problem.c, problem.s, problem.endless_slip, problem.counts
    t1, m0 = polynomials.p1, polynomials.m0
    event, flags = NO_EVENT, NO_FLAG
    span = along = across = ratio = t = v3_end = work = rubbed = 0.0
    jam0, jam1, jam2 = rate, -2.0 * mu * bp, c + mu * bl
    scale = speed * units.per
    d1, d2, n1, x, root = s1, s2, 0.0, 0.0, 0.0
    restoring = phase == RESTITUTION
    around_invariant = whole_series = event != NO_EVENT  # False, but no literal: see `codes`
    last, terms, count = 0.0, 1.0, 0
    shape = Shape(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    series = SlipSeries(
        *(around_invariant, coefficients, reciprocals, shape, scale, mu, jam0, jam1, jam2, v3, speed)
    )

    # most often the next event is near: try for it at once
    sought, aim, guess = VELOCITY, goal if restoring else 0.0, 0.0
    bend = m0 - 0.5 * t1
    if restoring and counts == IMPULSE:
        sought, aim = IMPULSE, left
        guess = halley(-left, scale, bend)
    elif restoring and counts == WORK:
        sought, aim = WORK, left
        square = v3 * v3 + 2.0 * rate * left
        if square > 0.0:
            guess = halley(-2.0 * left / (v3 + math.sqrt(square)), scale, bend)
    elif rate > 0.0:
        guess = halley(v3 - aim, scale * rate, bend + 0.5 * turn * jam1 / jam0)
    if guess > 0.0 and guess * max(abs(turn), abs(t1)) < 1.0:
        near = BEYOND_GUESS * guess
        count, last, shape = expand(coefficients, turn, polynomials, near)
        series = SlipSeries(
            *(around_invariant, coefficients[: count + 1], reciprocals, shape, scale, mu),
            *(jam0, jam1, jam2, v3, speed),
        )
        whole_series = count == TERMS
        if whole_series:
            near = reach(last, shape)
        if guess <= near:
            x = seek_near(series, nodes, sought, aim, guess, near)
        if x > 0.0:
            event = LAW_MET if restoring else COMPRESSION_ENDS

    if event == NO_EVENT:
        # go as far as the series converges and v₃ is monotone: into the invariant direction ahead, or far
        # from the one behind ...
        root = nearby_root(turn, polynomials)
        leaving = root != 0.0 and t1 > 0.0
        if root != 0.0:
            whole_series = False
            around_invariant, count, end, e1, e2, n1, el, ep, terms, shape = expand_around_root(
                coefficients, reciprocals, units.weak,
                units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2, root, leaving,
            )  # fmt: skip
        if around_invariant and endless_slip and abs(shape.exponent * n1) <= NO_FORCE * terms:
            h, factor, unit, _, start, sign, q1, q2, q3, w0, w1, w2, q4, w3 = shape
            shape = Shape(h, factor, unit, 0.0, start, sign, q1, q2, q3, w0, w1, w2, q4, w3)
        if around_invariant and leaving:
            end *= shape.h
            whole = (end + root) / (1.0 - end * root)
            t = first_root(jam0, jam1, jam2, whole, root)
            x = math.log1p(-t * (1.0 + root * root) / (root * (1.0 + t * root)))
            most = FURTHEST / max(1.0, abs(shape.exponent))
            peaks = t != whole and x < most
            x = min(x, most)
        if around_invariant:
            d1, d2, bl, bp = e1, e2, el * units.omega, ep * units.omega
            lift = c - mu * bl
            if units.weak > 0:
                lift = lifting(problem, units.omega, d1, d2, lift, 0.5 * shape.exponent * n1, terms, 0.0, 0.0)
            if endless_slip and shape.exponent == 0.0:
                lift = s
            jam0, jam1, jam2 = lift, -2.0 * mu * bp, c + mu * bl
            if not leaving:
                t = last_root(jam0, jam1, jam2, -root)
                peaks = t != 0.0
                x = math.log(-root / t) if peaks else math.inf
        else:
            # ... or some way towards it
            if not whole_series:
                count, last, shape = expand(coefficients, turn, polynomials, math.inf)
            whole = reach(last, shape)
            end = shape.h * whole
            x = first_root(jam0, jam1, jam2, end, end) / shape.h
            peaks = x < whole
        series = SlipSeries(
            *(around_invariant, coefficients[: count + 1], reciprocals, shape, scale, mu),
            *(jam0, jam1, jam2, v3, speed),
        )
        endless = x == math.inf and shape.exponent <= 0.0
        if endless:
            span = math.inf
            v3_end = math.inf if jam0 > 0.0 else -math.inf
            if jam0 == 0.0:
                v3_end = (problem.k1 * d1 + problem.k2 * d2) * speed * shape.factor + problem.offset
        else:
            span, along, across, dv3, ratio, t, _, _ = point(series, x)
            v3_end = v3 + dv3
            if x == math.inf and s == 0.0:
                v3_end = problem.offset
        # what the velocity brings
        met = v3_end > goal or (v3_end == goal and x < math.inf)
        aim = goal if counts == VELOCITY and restoring and met else 0.0
        if restoring:
            if aim > 0.0:
                event = LAW_MET
            elif v3_end < 0.0:
                event = COMPRESSION_RESUMES
            elif counts == VELOCITY and peaks and rate > 0.0 and goal - v3_end < CLOSE_TO_JUMP * goal:
                flags |= NEAR_JUMP
        elif v3_end > 0.0 or (v3_end == 0.0 and x < math.inf):
            event = COMPRESSION_ENDS
        if event != NO_EVENT:
            x = seek(series, nodes, VELOCITY, aim, v3 - aim, v3_end - aim, x, rate)
            endless = False
        # what the sum of impulse or work brings before that
        if restoring and counts != VELOCITY:
            total = math.inf
            if not endless:
                total = span if event == NO_EVENT else point(series, x)[0]
                if counts == WORK:
                    total, _ = works(series, nodes, x)
                    work = total
            if total >= left:
                event = LAW_MET
                x = seek(series, nodes, counts, left, -left, total - left, x, rate)
                endless = False
        if endless:
            return Move(NEVER, span, 0.0, 0.0, rate, 0.0, 0.0), state, flags, points

    if event != NO_EVENT:
        span, along, across, dv3, ratio, t, _, _ = point(series, x)
        v3_end = v3 + dv3

    if traced or (counts == WORK and not restoring):
        work, rubbed = works(series, nodes, x)
    if path.shape[0] > 0:
        points = record_series(path, points, series, x, d1, d2, p1, p2, p3)
    p1 += d1 * along - d2 * across
    p2 += d2 * along + d1 * across
    p3 += span
    if event in (COMPRESSION_ENDS, COMPRESSION_RESUMES):
        v3_end = 0.0
    # v₃ is monotone, but at both ends it may stand still
    middle = 0.5 * (t + shape.h * shape.start if around_invariant else t)
    flags |= jams(jam0 + middle * (jam1 + middle * jam2))
    chord = 1.0 + t * t
    rate = (jam0 + t * (jam1 + t * jam2)) / chord
    cos, sin = (1.0 - t * t) / chord, 2.0 * t / chord
    error1, error2 = abs(d1 * cos) + abs(d2 * sin), abs(d2 * cos) + abs(d1 * sin)
    s1, s2 = d1 * cos - d2 * sin, d2 * cos + d1 * sin
    norm = 1.0 / math.sqrt(s1 * s1 + s2 * s2)
    s1 *= norm
    s2 *= norm
    speed *= ratio
    if s == 0.0 and event == NO_EVENT:
        v3_end = tied(problem, s1, s2, speed, error1, error2, v3_end)
    if around_invariant:
        y = t / shape.h
        turn = n1 * t * (1.0 + y * (shape.q1 + y * (shape.q2 + y * shape.q3))) / (chord * chord)
    else:
        turn *= (1.0 + x * (shape.q1 + x * (shape.q2 + x * (shape.q3 + x * shape.q4)))) / (chord * chord)
    state = State(s1, s2, speed, v3_end, turn, p1, p2, p3)
    root = root if around_invariant else 0.0
    return Move(event, span, work, rubbed, rate, shape.sign * x, root), state, flags, points
