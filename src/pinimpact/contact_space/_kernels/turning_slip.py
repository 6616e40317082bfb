"""Moves of turning slip: along one power series, up to the next event. (theory.md, 3.3 and 4)"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import always_inlined, always_inlined_bitcode, inlined
from . import codes
from .contact_problem import Problem
from .delassus import ZERO
from .invariant_direction import expand_around_root, nearby_root
from .moves import Move, State, Units, jams, lifting, tied
from .recording import record_series
from .slip_equations import TERMS, Polynomials, Shape, expand, reach
from .slip_events import seek, seek_near
from .slip_series import SlipSeries, first_root, halley, last_root, point
from .slip_works import works
from .tolerances import CLOSE_TO_JUMP

BEYOND_GUESS = 1.0625
"""Length up to which a series is computed for an event, over the estimated place of the event, which is
mostly accurate to a percent."""

FURTHEST = 100.0
"""Largest ln of the growth of slip on one series that departs from an invariant direction."""


@declared(
    *(FLOATS, FLOATS, FLOATS, Problem, Units, State, Polynomials, float, float, float, int, float, float),
    *(bool, FLOAT_ROWS, int),
)
@always_inlined_bitcode
def turning_move(
    coefficients, reciprocals, nodes, problem, units, state, polynomials, bl, bp, rate, phase, goal,
    left, traced, path, points,
):  # fmt: skip
    """Advance turning slip along one series, on which v₃ is monotone.

    Args:
        coefficients, reciprocals, nodes: (TERMS + 1,), (TERMS + 5,), (WORK_SCRATCH,) scratch.
        problem, units, state: The `Problem`, its `Units`, and the `State` at the start.
        polynomials, bl, bp, rate: The `Polynomials`, b∥, b⊥ and dv₃/dP₃ in the axes (σ, σ⊥).
        phase, goal: Of the `Ledger`.
        left: Remainder of the goal, see `left_to_gain`.
        traced: Whether the work of the move is needed.
        path, points: As for `solve_into`, and the number of points so far.

    Returns:
        The `Move`, the state after it, flags to be set, and the number of points.
    """
    restoring, flags, work, friction_work = phase == codes.RESTITUTION, codes.NO_FLAG, 0.0, 0.0
    lift = rate, -2.0 * problem.mu * bp, problem.c + problem.mu * bl  # (3.16)
    scale = state.speed * units.per
    event, x, last, whole, series = _near_event(
        *(coefficients, reciprocals, nodes, problem, state, polynomials, scale, lift, rate),
        *(restoring, goal, left),
    )
    axes = state.s1, state.s2, 0.0, 0.0
    end = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if event == codes.NO_EVENT:
        series, x, peaks, axes = _far_series(
            coefficients, reciprocals, problem, units, state, polynomials, last, whole, series
        )
        event, x, endless, work, end, flags = _find_event(
            series, nodes, problem, axes, x, peaks, rate, restoring, goal, left
        )
        if endless:
            return Move(codes.NEVER, end[0], 0.0, 0.0, rate, 0.0, 0.0), state, flags, points
    if event != codes.NO_EVENT:
        end = _end_at(series, x)
    if traced or (problem.counts == codes.WORK and not restoring):
        work, friction_work = works(series, nodes, x)
    if path.shape[0] > 0:
        points = record_series(path, points, series, x, axes[0], axes[1], state.p1, state.p2, state.p3)
    state, rate, new_flags = _state_after(problem, state, series, axes, event, x, end)
    move = Move(event, end[0], work, friction_work, rate, series.shape.sign * x, axes[3])
    return move, state, flags | new_flags, points


@always_inlined
def _near_event(
    coefficients, reciprocals, nodes, problem, state, polynomials, scale, lift, rate, restoring, goal, left
):
    """Look for the next event on a short series, since it is near in most cases.

    Args:
        coefficients, reciprocals, nodes, problem, state, polynomials, rate, goal, left: As for
            `turning_move`.
        scale: The slip speed over ω.
        lift: j₀, j₁, j₂ of (3.16).
        restoring: Whether the phase is restitution.

    Returns:
        The event, or NO_EVENT, and its x on the series; the size of the last coefficient; whether the series
        has all `TERMS`; the `SlipSeries`.
    """
    v3, turn, mu = state.v3, state.turn, problem.mu
    t1, m0 = polynomials.p1, polynomials.m0
    event, x, last = codes.NO_EVENT, 0.0, 0.0
    around_invariant = whole = event != codes.NO_EVENT  # False, but not a literal, see `codes`
    shape = Shape(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    series = SlipSeries(
        *(around_invariant, coefficients, reciprocals, shape, scale, mu),
        *(lift[0], lift[1], lift[2], v3, state.speed),
    )
    sought, aim, guess = codes.VELOCITY, goal if restoring else 0.0, 0.0
    bend = m0 - 0.5 * t1
    if restoring and problem.counts == codes.IMPULSE:
        sought, aim = codes.IMPULSE, left
        guess = halley(-left, scale, bend)
    elif restoring and problem.counts == codes.WORK:
        sought, aim = codes.WORK, left
        square = v3 * v3 + 2.0 * rate * left
        if square > 0.0:
            guess = halley(-2.0 * left / (v3 + math.sqrt(square)), scale, bend)
    elif rate > 0.0:
        guess = halley(v3 - aim, scale * rate, bend + 0.5 * turn * lift[1] / lift[0])
    if guess > 0.0 and guess * max(abs(turn), abs(t1)) < 1.0:
        near = BEYOND_GUESS * guess
        count, last, shape = expand(coefficients, turn, polynomials, near)
        series = SlipSeries(
            *(around_invariant, coefficients[: count + 1], reciprocals, shape, scale, mu),
            *(lift[0], lift[1], lift[2], v3, state.speed),
        )
        whole = count == TERMS
        if whole:
            near = reach(last, shape)
        if guess <= near:
            x = seek_near(series, nodes, sought, aim, guess, near)
        if x > 0.0:
            event = codes.LAW_MET if restoring else codes.COMPRESSION_ENDS
    return event, x, last, whole, series


@always_inlined
def _far_series(coefficients, reciprocals, problem, units, state, polynomials, last, whole, series):
    """Expand a series around a nearby invariant direction, or else in the half-angle, up to its limit.

    Args:
        coefficients, reciprocals, problem, units, state, polynomials: As for `turning_move`.
        last, whole, series: As `_near_event` returns them.

    Returns:
        The `SlipSeries`; the x up to which it converges and v₃ is monotone; whether v₃ has an extremum there;
        and its axes: the direction at t = 0 (2), p₁ there, and the half-angle tangent of the invariant
        direction, 0 for none.
    """
    mu, s1, s2, turn = problem.mu, state.s1, state.s2, state.turn
    around_invariant, count, shape = series.around_invariant, len(series.coefficients) - 1, series.shape
    lift0, lift1, lift2 = series.j0, series.j1, series.j2
    d1, d2, n1, end, terms = s1, s2, 0.0, 0.0, 1.0
    root = nearby_root(turn, polynomials)
    leaving = root != 0.0 and polynomials.p1 > 0.0
    if root != 0.0:
        whole = False
        around_invariant, count, end, e1, e2, n1, el, ep, terms, shape = expand_around_root(
            coefficients, reciprocals, units.weak,
            units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2, root, leaving,
        )  # fmt: skip
    if around_invariant and problem.endless_slip and abs(shape.exponent * n1) <= ZERO * terms:
        h, factor, unit, _, start, sign, q1, q2, q3, w0, w1, w2, q4, w3 = shape
        shape = Shape(h, factor, unit, 0.0, start, sign, q1, q2, q3, w0, w1, w2, q4, w3)
    if around_invariant and leaving:
        end *= shape.h
        furthest = (end + root) / (1.0 - end * root)
        t = first_root(lift0, lift1, lift2, furthest, root)
        x = math.log1p(-t * (1.0 + root * root) / (root * (1.0 + t * root)))
        most = FURTHEST / max(1.0, abs(shape.exponent))
        peaks = t != furthest and x < most
        x = min(x, most)
    if around_invariant:
        d1, d2, bl, bp = e1, e2, el * units.omega, ep * units.omega
        lift = problem.c - mu * bl
        if units.weak > 0:
            lift = lifting(problem, units.omega, d1, d2, lift, 0.5 * shape.exponent * n1, terms, 0.0, 0.0)
        if problem.endless_slip and shape.exponent == 0.0:
            lift = problem.s
        lift0, lift1, lift2 = lift, -2.0 * mu * bp, problem.c + mu * bl
        if not leaving:
            t = last_root(lift0, lift1, lift2, -root)
            peaks = t != 0.0
            x = math.log(-root / t) if peaks else math.inf
    else:
        root = n1 = 0.0
        if not whole:
            count, last, shape = expand(coefficients, turn, polynomials, math.inf)
        far = reach(last, shape)
        end = shape.h * far
        x = first_root(lift0, lift1, lift2, end, end) / shape.h
        peaks = x < far
    found = SlipSeries(
        *(around_invariant, coefficients[: count + 1], reciprocals, shape, series.scale, mu),
        *(lift0, lift1, lift2, state.v3, state.speed),
    )
    return found, x, peaks, (d1, d2, n1, root)


@inlined
def _end_at(series, x):
    """Return ΔP₃, ΔP∥, ΔP⊥, |v_t| over that at x = 0, t, and v₃ at x."""
    span, along, across, dv3, ratio, t, _, _ = point(series, x)
    return span, along, across, ratio, t, series.v3 + dv3


@always_inlined
def _find_event(series, nodes, problem, axes, x, peaks, rate, restoring, goal, left):
    """Find the first event on a series up to x.

    Args:
        series, x, peaks, axes: As `_far_series` returns them.
        nodes, problem, goal, left: As for `turning_move`.
        rate: dv₃/dP₃ at the start of the series.
        restoring: Whether the phase is restitution.

    Returns:
        The event and its x; whether slip never ends and no event occurs; the normal work, if the law depends
        on it; `_end_at` of the given x; and flags.
    """
    v3, shape, counts = series.v3, series.shape, problem.counts
    event, flags, work = codes.NO_EVENT, codes.NO_FLAG, 0.0
    endless = x == math.inf and shape.exponent <= 0.0
    if endless:
        v3_end = math.inf if series.j0 > 0.0 else -math.inf
        if series.j0 == 0.0:
            slope = problem.k1 * axes[0] + problem.k2 * axes[1]
            v3_end = slope * series.speed * shape.factor + problem.offset
        end = math.inf, 0.0, 0.0, 0.0, 0.0, v3_end
    else:
        span, along, across, ratio, t, v3_end = _end_at(series, x)
        if x == math.inf and problem.s == 0.0:
            v3_end = problem.offset
        end = span, along, across, ratio, t, v3_end
    # events of v₃
    met = v3_end > goal or (v3_end == goal and x < math.inf)
    aim = goal if counts == codes.VELOCITY and restoring and met else 0.0
    if restoring:
        if aim > 0.0:
            event = codes.LAW_MET
        elif v3_end < 0.0:
            event = codes.COMPRESSION_RESUMES
        elif counts == codes.VELOCITY and peaks and rate > 0.0 and goal - v3_end < CLOSE_TO_JUMP * goal:
            flags |= codes.NEAR_JUMP
    elif v3_end > 0.0 or (v3_end == 0.0 and x < math.inf):
        event = codes.COMPRESSION_ENDS
    if event != codes.NO_EVENT:
        x = seek(series, nodes, codes.VELOCITY, aim, v3 - aim, v3_end - aim, x, rate)
        endless = False
    # an earlier goal of impulse or work
    if restoring and counts != codes.VELOCITY:
        total = math.inf
        if not endless:
            total = end[0] if event == codes.NO_EVENT else point(series, x)[0]
            if counts == codes.WORK:
                total, _ = works(series, nodes, x)
                work = total
        if total >= left:
            event = codes.LAW_MET
            x = seek(series, nodes, counts, left, -left, total - left, x, rate)
            endless = False
    return event, x, endless, work, end, flags


@always_inlined
def _state_after(problem, state, series, axes, event, x, end):
    """Return the state at x on a series, dv₃/dP₃ there, and flags.

    Args:
        problem, state, series: The `Problem`, the `State` at the start, and the `SlipSeries`.
        axes: As `_far_series` returns them.
        event, x: The event that ends the move, and its x.
        end: `_end_at` of x.
    """
    d1, d2, n1, _ = axes
    span, along, across, ratio, t, v3_end = end
    shape, turn, speed = series.shape, state.turn, state.speed * ratio
    j0, j1, j2 = series.j0, series.j1, series.j2
    if event in (codes.COMPRESSION_ENDS, codes.COMPRESSION_RESUMES):
        v3_end = 0.0
    # dv₃/dP₃ has one sign but may vanish at both ends, so its sign is taken in the middle
    middle = 0.5 * (t + shape.h * shape.start if series.around_invariant else t)
    flags = jams(j0 + middle * (j1 + middle * j2))
    chord = 1.0 + t * t
    rate = (j0 + t * (j1 + t * j2)) / chord
    cos, sin = (1.0 - t * t) / chord, 2.0 * t / chord
    error1, error2 = abs(d1 * cos) + abs(d2 * sin), abs(d2 * cos) + abs(d1 * sin)
    s1, s2 = d1 * cos - d2 * sin, d2 * cos + d1 * sin
    norm = 1.0 / math.sqrt(s1 * s1 + s2 * s2)
    s1 *= norm
    s2 *= norm
    if problem.s == 0.0 and event == codes.NO_EVENT:
        v3_end = tied(problem, s1, s2, speed, error1, error2, v3_end)
    if series.around_invariant:
        y = t / shape.h
        turn = n1 * t * (1.0 + y * (shape.q1 + y * (shape.q2 + y * shape.q3))) / (chord * chord)
    else:
        turn *= (1.0 + x * (shape.q1 + x * (shape.q2 + x * (shape.q3 + x * shape.q4)))) / (chord * chord)
    p1, p2 = state.p1 + (d1 * along - d2 * across), state.p2 + (d2 * along + d1 * across)
    return State(s1, s2, speed, v3_end, turn, p1, p2, state.p3 + span), rate, flags
