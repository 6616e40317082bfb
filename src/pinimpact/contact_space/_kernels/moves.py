"""Moves of an impact: the rates of change at a state, and straight moves in closed form.

An impact is a sequence of moves. Each leads from one `State` to the next, either with the constant rates of a
`Course` (straight slip, stick, resumed slip) or along a series of turning slip (`turning_slip`), up to an
event, the end of the mode, or the convergence limit of the series. The state after a move depends only on the
state before it, the `Problem` and the `Ledger`. (theory.md, sections 3 to 5)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import always_inlined, always_inlined_bitcode, inlined, inlined_bitcode
from . import codes
from .contact_problem import Problem
from .delassus import ZERO, jacobi_angle
from .laws import first_event
from .slip_equations import Polynomials, along_slip, in_frame, polynomials
from .tolerances import NEAR_THRESHOLD

STRAIGHT = 2.0**-54
"""Angle [rad] to an invariant direction below which slip is straight in double precision."""

WEAK = 2.0**-10
"""Ratio of the diagonal entries of A below which the axis of the smaller one is weak."""


class State(NamedTuple):
    """State of an impact between two moves.

    Attributes:
        s1, s2, speed: Direction σ and speed of slip.
        v3: Normal velocity.
        turn: p₀, the rate at which slip turns; a state variable to keep its relative accuracy.
        p1, p2, p3: Impulse so far.
    """

    s1: float
    s2: float
    speed: float
    v3: float
    turn: float
    p1: float
    p2: float
    p3: float


class Course(NamedTuple):
    """Rates of change with P₃ in a straight move.

    Attributes:
        mode: IN_SLIP, IN_STICK or IN_RESUMED_SLIP.
        rate: dv₃/dP₃.
        gain: d|v_t|/dP₃.
        dp1, dp2: dP_t/dP₃.
        until: Normal impulse after which the mode, or the straight slip, ends.
        ends_slip: Whether v_t = 0 there.
        turning, growth: m₀ and p₁: d ln|v_t|/ds, and twice d ln|p₀|/ds, along an invariant direction.
    """

    mode: np.int64
    rate: float
    gain: float
    dp1: float
    dp2: float
    until: float
    ends_slip: bool
    turning: float
    growth: float


class Units(NamedTuple):
    """The slip equations in units in which their coefficients are of order one.

    Attributes:
        a11, a12, a22: μA/ω.
        b1, b2: b/ω.
        omega, per: ω, a power of two, and 1/ω.
        weak: The axis along which A is weak, 1 or 2, or 0 for none.
    """

    a11: float
    a12: float
    a22: float
    b1: float
    b2: float
    omega: float
    per: float
    weak: int


class Move(NamedTuple):
    """Result of a move.

    Attributes:
        event: The event that ends it; NO_EVENT if only the course changes, NEVER if no event follows.
        span: Its normal impulse.
        work, friction_work: Work of the normal and the tangential impulse.
        rate: dv₃/dP₃ at its end.
        length, root: For turning slip, the length x of the series, or L of a series around an invariant
            direction, and the half-angle tangent of that direction; else 0.
    """

    event: np.int64
    span: float
    work: float
    friction_work: float
    rate: float
    length: float
    root: float


@inlined
def slip_units(problem):
    """Return the `Units` of a problem."""
    mu, b1, b2 = problem.mu, problem.b1, problem.b2
    largest = max(max(abs(b1), abs(b2)), mu * max(problem.a11, problem.a22))
    omega = math.ldexp(1.0, math.frexp(largest)[1]) if mu > 0.0 else 1.0
    per = 1.0 / omega
    muo = mu * per
    weak = 0
    if problem.flat:
        weak = 0  # no creep there, and rounding errors would be taken for forces
    elif problem.a22 < WEAK * problem.a11:
        weak = 2
    elif problem.a11 < WEAK * problem.a22:
        weak = 1
    return Units(
        muo * problem.a11, muo * problem.a12, muo * problem.a22, per * b1, per * b2, omega, per, weak
    )


@inlined
def tangential_velocity(problem, state):
    """Return v_t at a state."""
    if problem.mu == 0.0:
        return problem.v1 + problem.b1 * state.p3, problem.v2 + problem.b2 * state.p3
    return state.s1 * state.speed, state.s2 * state.speed


@inlined
def frictionless_course(problem):
    """Return the `Course` for μ = 0."""
    return Course(codes.IN_SLIP, problem.c, 0.0, 0.0, 0.0, math.inf, False, 0.0, 0.0)


@inlined
def lifting(problem, omega, s1, s2, rate, m0, terms, turn, doubt):
    """Return dv₃/dP₃ along a slip direction σ, by (6.7) if that is more accurate than `rate`.

    Args:
        problem: The `Problem`.
        omega: ω.
        s1, s2: σ.
        rate: c − μb∥, which suffers cancellation where slip creeps.
        m0, turn: m₀ and p₀, in units of ω.
        terms, doubt: Sizes of the terms that m₀ and p₀ are the sums of.
    """
    x1, x2, y1, y2 = problem.k1 * s1, problem.k2 * s2, problem.k2 * s1, problem.k1 * s2
    small = omega * ((abs(x1) + abs(x2)) * terms + (abs(y1) + abs(y2)) * (abs(m0) + abs(turn) + doubt))
    if problem.s + small < problem.c + problem.mu * (abs(problem.b1) + abs(problem.b2)):
        return problem.s + omega * ((x1 + x2) * m0 + (y1 - y2) * turn)
    return rate


@inlined
def tied(problem, s1, s2, speed, size1, size2, v3):
    """Return v₃ = k·v_t + η, which holds for s = 0, if it is more accurate than the sum over the path `v3`.

    `size1` and `size2` are the sizes of the terms that the slip direction (s1, s2) is the sum of.
    """
    k1, k2 = problem.k1, problem.k2
    if speed * (abs(k1) * size1 + abs(k2) * size2) + abs(problem.offset) < abs(problem.v3):
        now = speed * (k1 * s1 + k2 * s2) + problem.offset
        if now * v3 > 0.0:
            return now
    return v3


@declared(Problem, Units, State, bool)
@always_inlined_bitcode
def slip_course(problem, units, state, fresh):
    """Compute the rates of slip at a state.

    Args:
        problem, units: The `Problem` and its `Units`.
        state: The `State`.
        fresh: Whether p₀ is computed from the direction, as at the start, instead of taken from the state.

    Returns:
        The `Course`, valid for straight slip only; whether slip is straight; the state with its p₀; the
        `Polynomials` in the axes (σ, σ⊥); b∥ and b⊥.
    """
    s1, s2, speed, v3, turn, p1, p2, p3 = state
    mu = problem.mu
    al, ax, ap, bl, bp = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    doubt = 0.0
    if fresh:
        turn = 0.0 if problem.planar else bp - ax
        doubt = abs(bp) + abs(ax)
    t1, t2, t3, t4, m0, m1, m2, m3 = polynomials(al, ax, ap, bl, bp)
    terms, turning = 1.0, turn
    if units.weak > 0:
        # straight slip has the m₀ of the invariant direction
        if abs(turn) <= STRAIGHT * abs(t1):
            turning = doubt = 0.0
        m0, terms = along_slip(
            *(units.weak, units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2, al, ax, bl, bp),
            *(turning, doubt),
        )
    bl *= units.omega
    bp *= units.omega
    rate = problem.c - mu * bl
    if units.weak > 0:
        rate = lifting(problem, units.omega, s1, s2, rate, m0, terms, turning, doubt)
    if problem.endless_slip and abs(m0) <= ZERO * terms:
        m0 = 0.0
    bend = abs(turn) + abs(t1) + abs(t2) + abs(t3) + abs(t4)
    unbent = bend <= 0.25 * STRAIGHT * abs(m0)
    straight = unbent or (abs(turn) <= STRAIGHT * abs(t1) and abs(turn * t2) <= 0.1 * t1 * t1)
    gain, until, ends_slip = 0.0, math.inf, False
    if straight:
        gain = units.omega * m0
        if problem.endless_slip and m0 == 0.0:
            rate = problem.s
        if m0 < 0.0:
            until, ends_slip = -speed / gain, True
        if t1 > 0.0 and turn != 0.0 and not unbent:
            # departure from an unstable direction: straight until the angle reaches `STRAIGHT`
            tau = 2.0 / t1 * math.log(2.0 * STRAIGHT * t1 / abs(turn))
            leave = speed * units.per * (math.expm1(m0 * tau) / m0 if m0 != 0.0 else tau)
            if leave < until:
                until, ends_slip = leave, False
    course = Course(codes.IN_SLIP, rate, gain, -mu * s1, -mu * s2, until, ends_slip, m0, t1)
    state = State(s1, s2, speed, v3, turn, p1, p2, p3)
    return course, straight, state, Polynomials(t1, t2, t3, t4, m0, m1, m2, m3), bl, bp


@inlined
def resumed_direction(a11, a12, a22, b1, b2, mu):
    """Solve (λI + μA)σ = b, |σ| = 1, for λ ≥ 0, if ‖A⁺b‖ > μ; return λ and σ (2). (5.2)

    1/|(λI + μA)⁻¹b| increases with λ and is concave, so Newton's method from a lower bound converges
    monotonically.
    """
    if a12 == 0.0:
        cos, sin, low, high = 1.0, 0.0, mu * a11, mu * a22
    else:
        t, cos, sin = jacobi_angle(a11, a22, a12)
        low, high = mu * (a11 - t * a12), mu * (a22 + t * a12)
    low, high = max(low, 0.0), max(high, 0.0)
    y1 = cos * b1 - sin * b2
    y2 = sin * b1 + cos * b2
    lam = max(0.0, abs(y1) - low, abs(y2) - high, math.hypot(y1, y2) - max(low, high))
    x1 = x2 = 0.0
    for _ in range(60):
        d1, d2 = lam + low, lam + high
        x1 = y1 / d1 if y1 != 0.0 else 0.0
        x2 = y2 / d2 if y2 != 0.0 else 0.0
        square = x1 * x1 + x2 * x2
        norm = math.sqrt(square)
        slope = (x1 * x1 / d1 if y1 != 0.0 else 0.0) + (x2 * x2 / d2 if y2 != 0.0 else 0.0)
        step = (norm - 1.0) * square / slope
        if not (lam + step > lam):
            break
        lam += step
    norm = math.hypot(x1, x2)
    x1, x2 = x1 / norm, x2 / norm
    return lam, cos * x1 + sin * x2, cos * x2 - sin * x1


@declared(Problem, State)
@inlined_bitcode
def leave_zero_slip(problem, state):
    """Choose stick or resumed slip at v_t = 0. (theory.md, section 5)

    Returns:
        The `Course`, the state, and flags to be set.
    """
    s1, s2, _, v3, _, p1, p2, p3 = state
    k1, k2, s, mu, c, b1, b2 = (
        problem.k1,
        problem.k2,
        problem.s,
        problem.mu,
        problem.c,
        problem.b1,
        problem.b2,
    )
    before1, before2 = problem.v1, problem.v2
    flags = codes.NO_FLAG
    if s > 0.0 and abs(k1 * before1) + abs(k2 * before2) + s * p3 < abs(b1 * p1) + abs(b2 * p2) + c * p3:
        # v₃ = v₃° + k·(v_t − v_t°) + s P₃ is more accurate than the sum over the path
        v3 = problem.v3 - k1 * before1 - k2 * before2 + s * p3
    stick_ratio = math.sqrt(k1 * k1 + k2 * k2)
    excess = stick_ratio - mu
    if abs(excess) <= NEAR_THRESHOLD * mu:
        flags |= codes.NEAR_STICK_THRESHOLD
    if excess <= 0.0:
        mode, rate, dp1, dp2, gain = codes.IN_STICK, s, -k1, -k2, 0.0
        if s == 0.0:
            flags |= codes.LOCKS
            v3 = problem.offset
    else:
        mode = codes.IN_RESUMED_SLIP
        if problem.flat:
            s1, s2 = k1 / stick_ratio, k2 / stick_ratio
            gain = (problem.a11 + problem.a22) * excess
        else:
            gain, s1, s2 = resumed_direction(problem.a11, problem.a12, problem.a22, b1, b2, mu)
        rate = s + gain * (k1 * s1 + k2 * s2)
        dp1, dp2 = -mu * s1, -mu * s2
    course = Course(mode, rate, gain, dp1, dp2, math.inf, False, 0.0, 0.0)
    return course, State(s1, s2, 0.0, v3, 0.0, p1, p2, p3), flags


@always_inlined
def straight_move(problem, omega, course, state, phase, left):
    """Advance along a `Course` to the next event, or to its end, in closed form.

    Args:
        problem: The `Problem`.
        omega: ω.
        course, state: The `Course` and the `State` at its start.
        phase: COMPRESSION or RESTITUTION.
        left: Remainder of the goal of restitution, see `left_to_gain`.

    Returns:
        The `Move` and the state after it.
    """
    s1, s2, speed, v3, turn, p1, p2, p3 = state
    mode, rate, gain, dp1, dp2, until, ends_slip, m0, t1 = course
    span, event = first_event(phase, problem.counts, left, v3, rate)
    # v₃ = k·v_t, so both vanish at once in straight slip
    together = problem.s == 0.0 and problem.offset == 0.0 and event == codes.COMPRESSION_ENDS and ends_slip
    if until < span or together:
        span, event = until, codes.NO_EVENT
    if span == math.inf:
        return Move(codes.NEVER, span, 0.0, 0.0, rate, 0.0, 0.0), state
    v3_end = v3 + rate * span
    speed_end = speed + gain * span
    if span == until and ends_slip:
        speed_end = 0.0
        if problem.s == 0.0:
            v3_end = problem.offset
    work = 0.5 * (v3 + v3_end) * span
    friction_work = -0.5 * problem.mu * (speed + speed_end) * span if mode != codes.IN_STICK else 0.0
    if turn != 0.0 and speed > 0.0 and speed_end > 0.0:
        tau = math.log(speed_end / speed) / m0 if m0 != 0.0 else omega * span / speed
        turn *= math.exp(0.5 * t1 * tau)
    p1 += dp1 * span
    p2 += dp2 * span
    p3 += span
    if event in (codes.COMPRESSION_ENDS, codes.COMPRESSION_RESUMES):
        v3_end = 0.0
    return (
        Move(event, span, work, friction_work, rate, 0.0, 0.0),
        State(s1, s2, speed_end, v3_end, turn, p1, p2, p3),
    )


@inlined
def mode_flag(mode, span, p3):
    """Return the flag of the mode of a move over `span` up to `p3`, if `span` is not negligible."""
    if p3 - span < p3:
        if mode == codes.IN_STICK:
            return codes.STICKS
        if mode == codes.IN_RESUMED_SLIP:
            return codes.SLIP_RESUMED
    return codes.NO_FLAG


@inlined
def jams(rate):
    """Return `JAM` if dv₃/dP₃ < 0 during slip."""
    return codes.JAM if rate < 0.0 else codes.NO_FLAG
