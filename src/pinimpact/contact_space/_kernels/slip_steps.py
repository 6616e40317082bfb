"""Steps of dP_t/dP₃ = −μ v_t/|v_t|, v = v⁻ + W P, and the first event within a step; the paper's scheme."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._compile.jit import always_inlined, inlined
from . import codes
from .butcher import Tableau
from .contact_problem import norm
from .delassus import EPS
from .moves import Move, jams
from .stiff_step import settling, stiff_step
from .tolerances import ROOM

TURNED = 64.0 * EPS
"""Angle [rad] of slip in a step that is more than rounding."""

STIFF = 2.0
"""Step size times the rate at which the slip direction settles, above which adaptive steps are implicit;
explicit ones are unstable somewhat above 3."""

SLIP_ENDS, V3_ZERO, GOAL = 0, 1, 2
"""Events for which a step is bisected."""


class Stepping(NamedTuple):
    """Parameters of the steps of an impact.

    Attributes:
        table: The Runge–Kutta method.
        tangent: A₁₁, A₁₂, A₂₂, b₁, b₂.
        c: W₃₃.
        mu: μ.
        flat: Whether A is singular.
        lasting: Whether slip never ends.
        counts: The quantity of the restitution law.
        rtol: Relative tolerance of adaptive steps; 0 for fixed ones.
        scale: Scale of P₃.
        negligible: Slip ends if the tangential impulse that stops it is below this fraction of μ P₃.
        k: (m, 4) scratch for the stages.
    """

    table: Tableau
    tangent: tuple[float, float, float, float, float]
    c: float
    mu: float
    flat: bool
    lasting: bool
    counts: np.int64
    rtol: float
    scale: float
    negligible: float
    k: NDArray[np.float64]


class At(NamedTuple):
    """State of an impact before a step.

    Attributes:
        v1, v2, v3, speed: Velocity, and |v_t|.
        p1, p2, p3: Impulse so far.
        phase: COMPRESSION or RESTITUTION.
        left: Remainder of the goal of restitution.
    """

    v1: float
    v2: float
    v3: float
    speed: float
    p1: float
    p2: float
    p3: float
    phase: np.int64
    left: float


class Step(NamedTuple):
    """A step of slip.

    Attributes:
        d1, d2: ΔP_t.
        q1, q2: ∫ΔP_t dP₃ over it.
        u1, u2: v_t at its end.
        error: Estimate of the error of ΔP_t.
        least: The least v·v_t/|v_t|² of the stages and the end; ≤ 0 if slip ended or reversed.
    """

    d1: float
    d2: float
    q1: float
    q2: float
    u1: float
    u2: float
    error: float
    least: float


@inlined
def slip_step(table, tangent, mu, v1, v2, h, k):
    """Take one explicit step of slip.

    Args:
        table: The Runge–Kutta method.
        tangent: A₁₁, A₁₂, A₂₂, b₁, b₂.
        mu: μ.
        v1, v2: v_t at the start.
        h: Increment of P₃.
        k: (m, 4) scratch for the stages.

    Returns:
        The values of a `Step`.
    """
    a11, a12, a22, b1, b2 = tangent
    square = v1 * v1 + v2 * v2
    least = 1.0
    d1 = d2 = q1 = q2 = e1 = e2 = 0.0
    for i in range(len(table.b)):
        x1 = x2 = 0.0
        for j in range(i):
            x1 += table.a[i, j] * k[j, 0]
            x2 += table.a[i, j] * k[j, 1]
        u1 = v1 + h * (a11 * x1 + a12 * x2 + table.c[i] * b1)
        u2 = v2 + h * (a12 * x1 + a22 * x2 + table.c[i] * b2)
        least = min(least, (u1 * v1 + u2 * v2) / square)
        speed = norm(u1, u2)
        pull = -mu / speed if speed > 0.0 else 0.0
        y1, y2 = pull * u1, pull * u2
        k[i, 0], k[i, 1] = y1, y2
        d1 += table.b[i] * y1
        d2 += table.b[i] * y2
        q1 += table.area[i] * y1
        q2 += table.area[i] * y2
        e1 += table.error[i] * y1
        e2 += table.error[i] * y2
    d1, d2 = h * d1, h * d2
    u1 = v1 + a11 * d1 + a12 * d2 + b1 * h
    u2 = v2 + a12 * d1 + a22 * d2 + b2 * h
    least = min(least, (u1 * v1 + u2 * v2) / square)
    return d1, d2, h * h * q1, h * h * q2, u1, u2, h * math.hypot(e1, e2), least


@inlined
def stop_impulse(flat, a11, a12, a22, v1, v2):
    """Return −A⁺v_t, the tangential impulse that ends slip; `flat`: whether A is singular."""
    det, trace = a11 * a22 - a12 * a12, a11 + a22
    if det > 0.0 and not flat:
        return (a12 * v2 - a22 * v1) / det, (a12 * v1 - a11 * v2) / det
    if trace == 0.0:
        return 0.0, 0.0
    return -(a11 * v1 + a12 * v2) / (trace * trace), -(a12 * v1 + a22 * v2) / (trace * trace)


@inlined
def trial_step(stepping, stiff, at, h):
    """Return the `Step` over h from `at`, by `stiff_step` if `stiff`, else by the table."""
    table, tangent, mu, k = stepping.table, stepping.tangent, stepping.mu, stepping.k
    if stiff:
        return Step(*stiff_step(tangent, mu, at.v1, at.v2, h, k))
    return Step(*slip_step(table, tangent, mu, at.v1, at.v2, h, k))


@inlined
def gains(stepping, at, h, step):
    """Return v₃ at the end of a step, and its normal work."""
    b1, b2, c = stepping.tangent[3], stepping.tangent[4], stepping.c
    v3_end = at.v3 + c * h + b1 * step.d1 + b2 * step.d2
    return v3_end, h * at.v3 + 0.5 * c * h * h + b1 * step.q1 + b2 * step.q2


@inlined
def graded(stepping, at, stride):
    """Return the step size of a fixed-step method, graded towards v_t = 0.

    With ρ the approximate impulse up to v_t = 0, steps proportional to ρ^{1 − 1/m} increase the number N of
    steps only little, and their errors (h/ρ)⁵ρ sum to N⁻⁴ for m = 5. Steps ≤ 2ρ keep the direction from
    oscillating.
    """
    a11, a12, a22, b1, b2 = stepping.tangent
    mu, scale, grading, v1, v2 = stepping.mu, stepping.scale, stepping.table.grading, at.v1, at.v2
    speed = norm(v1, v2)
    pull = mu / speed
    push = norm(b1 - pull * (a11 * v1 + a12 * v2), b2 - pull * (a12 * v1 + a22 * v2))
    rest = speed / (push + speed * settling(stepping.tangent, mu, v1, v2))
    return min(stride, grading * stride * (rest / scale) ** (1.0 - 1.0 / grading), 2.0 * rest)


@inlined
def before_event(stepping, sought, stiff, at, h):
    """Return the guard of the event `sought` at the end of a step over h; positive before the event."""
    if sought == GOAL and stepping.counts == codes.IMPULSE:
        return at.left - h
    step = trial_step(stepping, stiff, at, h)
    if sought == SLIP_ENDS:
        return step.least
    v3_end, work = gains(stepping, at, h, step)
    if sought == GOAL:
        return at.left - (work if stepping.counts == codes.WORK else v3_end - at.v3)
    return v3_end if at.phase == codes.RESTITUTION else -v3_end


@inlined
def locate(stepping, sought, stiff, at, h):
    """Return the step size up to the event `sought` within a step over h, by secants and bisection."""
    low, high = 0.0, h
    at_low = before_event(stepping, sought, stiff, at, low)
    at_high = before_event(stepping, sought, stiff, at, high)
    for i in range(200):
        if at_high == 0.0 or high - low <= EPS * high:
            break
        middle = 0.5 * (low + high)
        if i % 3 < 2 and at_low > 0.0:
            middle = low + (high - low) * at_low / (at_low - at_high)
            # at least one rounding error inside the bracket, so that both ends move
            middle = min(max(middle, low + EPS * high), high - EPS * high)
        value = before_event(stepping, sought, stiff, at, middle)
        if value > 0.0:
            low, at_low = middle, value
        else:
            high, at_high = middle, value
    return high


@always_inlined
def choose_step(stepping, at, stride):
    """Try a step of slip of size `stride`.

    Returns:
        Whether it is accepted; the next `stride`; whether it is implicit; whether it ends slip; its size; the
        `Step`.
    """
    rtol, mu, scale, lasting = stepping.rtol, stepping.mu, stepping.scale, stepping.lasting
    a11, a12, a22, _, _ = stepping.tangent
    h = stride
    if stepping.table.grading > 0.0:
        h = graded(stepping, at, stride)
    stiff = rtol > 0.0 and h * settling(stepping.tangent, mu, at.v1, at.v2) > STIFF
    x1, x2 = stop_impulse(stepping.flat, a11, a12, a22, at.v1, at.v2)
    vanishes = not lasting and math.hypot(x1, x2) <= stepping.negligible * mu * max(at.p3, scale)
    if vanishes:
        stiff, h = False, 0.0
    step = trial_step(stepping, stiff, at, h)
    ends = step.least <= 0.0 and not lasting and not vanishes
    if rtol > 0.0 and not vanishes:
        tolerance = rtol * mu * max(at.p3 + h, scale)
        # the Jacobian of an implicit step holds only near the slip direction of its start
        if ends or (stiff and norm(step.u1 - at.v1, step.u2 - at.v2) > norm(at.v1, at.v2)):
            return False, 0.5 * stride, stiff, vanishes, h, step
        stride *= min(5.0, max(0.2, 0.9 * (tolerance / step.error) ** 0.2)) if step.error > 0.0 else 5.0
        return step.error <= tolerance, stride, stiff, vanishes, h, step
    if ends:
        vanishes = True
        h = locate(stepping, SLIP_ENDS, stiff, at, h)
        step = trial_step(stepping, stiff, at, h)
    return True, stride, stiff, vanishes, h, step


@always_inlined
def first_event(stepping, at, stiff, tied, h, step):
    """Return the first event of a step of size h, the step size up to there, and the `Step`.

    With `tied`, v₃ vanishes at the end of slip exactly, and an earlier zero is rounding.
    """
    event, counts = codes.NO_EVENT, stepping.counts
    for sought in (V3_ZERO, GOAL):  # each search starts from the event found before
        v3_end, work = gains(stepping, at, h, step)
        if sought == V3_ZERO:
            crossed = v3_end >= 0.0 if at.phase == codes.COMPRESSION else v3_end <= 0.0
        elif at.phase == codes.COMPRESSION:
            crossed = False
        else:
            crossed = at.left <= (
                h if counts == codes.IMPULSE else work if counts == codes.WORK else v3_end - at.v3
            )
        if crossed and h > 0.0 and not (tied and sought == V3_ZERO):
            h = locate(stepping, sought, stiff, at, h)
            event = codes.COMPRESSION_ENDS if at.phase == codes.COMPRESSION else codes.COMPRESSION_RESUMES
            if sought == GOAL:
                event = codes.LAW_MET
            step = trial_step(stepping, stiff, at, h)
    return event, h, step


@always_inlined
def slip_move(stepping, problem, at, rate, stride):
    """Take a step of slip up to the first event on it.

    Args:
        stepping, problem, at: The `Stepping`, the `Problem`, and the state `At` its start.
        rate: dv₃/dP₃ there.
        stride: Step size that is tried.

    Returns:
        Whether the step was accepted; the next `stride`; the `Move`; the state `At` its end; flags.
    """
    a11, a12, a22, b1, b2 = stepping.tangent
    rtol, mu = stepping.rtol, stepping.mu
    taken, stride, stiff, vanishes, h, step = choose_step(stepping, at, stride)
    if not taken:
        return False, stride, Move(codes.NO_EVENT, 0.0, 0.0, 0.0, rate, 0.0, 0.0), at, codes.NO_FLAG
    tied = vanishes and problem.s == 0.0 and problem.offset == 0.0
    event, h, step = first_event(stepping, at, stiff, tied, h, step)
    vanishes = vanishes and event == codes.NO_EVENT
    d1, d2, q1, q2, u1, u2, _, _ = step
    v3_end, work = gains(stepping, at, h, step)
    friction_work = 0.5 * (d1 * (at.v1 + u1) + d2 * (at.v2 + u2))
    friction_work += 0.5 * h * (b1 * d1 + b2 * d2) - b1 * q1 - b2 * q2
    if event in (codes.COMPRESSION_ENDS, codes.COMPRESSION_RESUMES):
        v3_end = 0.0
    x1, x2 = stop_impulse(stepping.flat, a11, a12, a22, u1, u2)
    # an impulse stops the remaining v_t, so that v = v⁻ + W P still holds; unless the cone allows it,
    # slip has not ended
    room = mu * (at.p3 + h) * ROOM
    if vanishes and (h == 0.0 or math.hypot(at.p1 + d1 + x1, at.p2 + d2 + x2) <= room):
        friction_work += 0.5 * (x1 * u1 + x2 * u2)
        d1, d2 = d1 + x1, d2 + x2
        u1 = u2 = 0.0
        v3_end = 0.0 if tied else v3_end + b1 * x1 + b2 * x2
        if at.phase == codes.COMPRESSION and v3_end >= 0.0:
            event = codes.COMPRESSION_ENDS
        elif at.phase == codes.RESTITUTION and v3_end < 0.0:
            event = codes.COMPRESSION_RESUMES
    # the error of P_t makes the slip direction uncertain as slip vanishes
    doubt, push = rtol * mu * (at.p3 + h), norm(b1, b2)
    flags = jams(rate + min(1.0, doubt * (a11 + a22) / at.speed) * mu * push)
    if rtol > 0.0:
        flags |= jams(v3_end - at.v3 + 2.0 * rtol * mu * max(at.p3 + h, stepping.scale) * push)
    speed = norm(u1, u2)
    rate = stepping.c - mu * (b1 * u1 + b2 * u2) / speed if speed > 0.0 else problem.s
    if abs(at.v1 * u2 - at.v2 * u1) > TURNED * at.speed * speed:
        flags |= codes.SLIP_TURNS
    after = At(u1, u2, v3_end, speed, at.p1 + d1, at.p2 + d2, at.p3 + h, at.phase, at.left)
    return True, stride, Move(event, h, work, friction_work, rate, 0.0, 0.0), after, flags
