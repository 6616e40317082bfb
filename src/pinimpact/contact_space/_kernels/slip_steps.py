"""One step of slip in normal impulse, and where within it the first event is. (the paper's scheme)

Slip is the differential equation dP_t/dP₃ = −μ v_t/|v_t| with v = v⁻ + W P.
"""

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
"""Angle between two steps that is more than rounding."""

STIFF = 2.0
"""A step of chosen length is stiff if the direction of slip settles within it more often than this; explicit
steps bear little more than three times."""

SLIP_ENDS, V3_ZERO, GOAL = 0, 1, 2
"""What a step is bisected for."""


class Stepping(NamedTuple):
    """How an impact is stepped.

    Attributes:
        table: The Runge–Kutta method.
        tangent: A₁₁, A₁₂, A₂₂, b₁, b₂.
        c: W₃₃.
        mu: Friction.
        flat: Whether A is singular.
        lasting: Whether slip never ends.
        counts: What the law counts.
        rtol: See `solve_stepping`.
        scale: That of P₃.
        negligible: An impulse that ends slip, over that of friction, so small that slip is at its end.
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
    """Where an impact stands before a step.

    Attributes:
        v1, v2, v3, speed: Velocity, and |v_t|.
        p1, p2, p3: Impulse so far.
        phase: COMPRESSION or RESTITUTION.
        left: What the law has still to count.
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
        least: The least v·v_t/|v_t|² of the stages and the end: not positive where slip came to its end or
            turned back.
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
    """Take one step of slip from v_t over h.

    `tangent` is A₁₁, A₁₂, A₂₂, b₁, b₂, v_t = (v1, v2) the velocity at the start, h the increment of P₃, k (m,
    4) scratch for the stages of the method. Returns the numbers of a `Step`.
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
    """Return −A⁺v_t, the tangential impulse that ends slip; `flat` says that A is singular."""
    det, trace = a11 * a22 - a12 * a12, a11 + a22
    if det > 0.0 and not flat:
        return (a12 * v2 - a22 * v1) / det, (a12 * v1 - a11 * v2) / det
    if trace == 0.0:
        return 0.0, 0.0
    return -(a11 * v1 + a12 * v2) / (trace * trace), -(a12 * v1 + a22 * v2) / (trace * trace)


@inlined
def trial_step(stepping, stiff, at, h):
    """Return a step from where the impact stands, by `stiff_step` or by the table."""
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
def shorter(stepping, at, stride):
    """Return the step near v_t = 0 of a method that shortens them there.

    With ρ about the impulse that is left to v_t = 0, steps like ρ^{1 − 1/m} are not many more than before,
    and their errors (h/ρ)⁵ρ sum up to N⁻⁴ for m = 5. None is longer than 2ρ, so that the direction settles
    and does not swing.
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
    """Measure how far the end of a step over h lies before an event: positive before it."""
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
    """Bisect a step that crosses an event, with secants in between, and return its length to the event."""
    low, high = 0.0, h
    at_low = before_event(stepping, sought, stiff, at, low)
    at_high = before_event(stepping, sought, stiff, at, high)
    for i in range(200):
        if at_high == 0.0 or high - low <= EPS * high:
            break
        middle = 0.5 * (low + high)
        if i % 3 < 2 and at_low > 0.0:
            middle = low + (high - low) * at_low / (at_low - at_high)
            # a secant that ends beside the bracket's end steps in by a rounding, so that both ends move
            middle = min(max(middle, low + EPS * high), high - EPS * high)
        value = before_event(stepping, sought, stiff, at, middle)
        if value > 0.0:
            low, at_low = middle, value
        else:
            high, at_high = middle, value
    return high


@always_inlined
def choose_step(stepping, at, stride):
    """Try a step of slip.

    Returns whether it is taken; the next length; whether it is stiff, and ends slip; its length; the `Step`.
    """
    rtol, mu, scale, lasting = stepping.rtol, stepping.mu, stepping.scale, stepping.lasting
    a11, a12, a22, _, _ = stepping.tangent
    h = stride
    if stepping.table.grading > 0.0:
        h = shorter(stepping, at, stride)
    stiff = rtol > 0.0 and h * settling(stepping.tangent, mu, at.v1, at.v2) > STIFF
    x1, x2 = stop_impulse(stepping.flat, a11, a12, a22, at.v1, at.v2)
    vanishes = not lasting and math.hypot(x1, x2) <= stepping.negligible * mu * max(at.p3, scale)
    if vanishes:
        stiff, h = False, 0.0
    step = trial_step(stepping, stiff, at, h)
    ends = step.least <= 0.0 and not lasting and not vanishes
    if rtol > 0.0 and not vanishes:
        tolerance = rtol * mu * max(at.p3 + h, scale)
        # a stiff step takes the direction as settled around that of its start
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
    """Return the first event on a step of length h, its length up to there, and the step.

    It is `tied` if v₃ comes to zero with slip, and is not told before it by rounding.
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
    """Take a step of slip, up to the first event on it, from where dv₃/dP₃ is the rate.

    Returns whether it was taken; the length of the next one; the `Move`; where the impact then stands; flags.
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
    # what is left of v_t takes an impulse too, so that v = v⁻ + W P holds on; if that is more than the cone
    # of friction has room for, slip is not at its end
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
    # as far as the error of P_t so far lets the direction be known, which is lost as slip dies
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
