"""Stepping in normal impulse: the paper's Euler scheme, and Runge–Kutta methods in its place.

Slip is the differential equation dP_t/dP₃ = −μ v_t/|v_t| with v = v⁻ + W P. What follows the instant of
v_t = 0 has constant rates, so no method has anything to discretise there: one step takes it.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined, jit
from .codes import (
    COMPRESSION,
    COMPRESSION_ENDS,
    COMPRESSION_RESUMES,
    IMPULSE,
    IN_SLIP,
    LAW_MET,
    LAW_UNREACHABLE,
    LOCKED,
    LOCKS,
    NEAR_JUMP,
    NEVER,
    NO_EVENT,
    NO_IMPACT,
    NOT_CONVERGED,
    RESTITUTION,
    SEPARATED,
    SLIP_TURNS,
    UNSTOPPABLE,
    VELOCITY,
    WORK,
)
from .contact_problem import PROCEEDS, prepare
from .delassus import EPS
from .ending import finish, no_result, plain, without_impact
from .ledger import close_move, left_to_gain, new_ledger
from .moves import (
    State,
    frictionless_course,
    jams,
    leave_zero_slip,
    mode_flag,
    straight_move,
    tangential_velocity,
)
from .recording import record_move, record_point
from .stiff_step import STAGES, settling, stiff_step
from .tolerances import CLOSE_TO_JUMP, ROOM, ROUNDED

MAX_SCALES = 1000
"""An impact that slips for more than this many times the scale of its steps is given up."""

MAX_CHOSEN = 100_000
"""So is one that takes more than this many steps of chosen length."""


TURNED = 64.0 * EPS
"""Angle between two steps that is more than rounding."""

STIFF = 2.0
"""A step of chosen length is stiff if the direction of slip settles within it more often than this; explicit
steps bear little more than three times."""


SLIP_ENDS, V3_ZERO, GOAL = 0, 1, 2
"""What a step is bisected for."""


@inlined
def norm(x, y):
    """Return √(x² + y²); the slower function of the library only where squares would vanish."""
    square = x * x + y * y
    return math.sqrt(square) if square > 1e-280 else math.hypot(x, y)


@inlined
def slip_step(table, tangent, mu, v1, v2, h, k):
    """Take one step of slip from v_t over h.

    Args:
        table: The method.
        tangent: A₁₁, A₁₂, A₂₂, b₁, b₂.
        mu: Friction.
        v1: Tangential velocity at the start,
        v2: its second component.
        h: Increment of P₃.
        k: (m, 4) scratch for the stages.

    Returns:
        ΔP_t, ∫ΔP_t dP₃ over the step, the new v_t, the estimate of the error of ΔP_t, and the least
        v·v_t/|v_t|² of the stages and the new v_t: not positive where slip came to its end or turned back.
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
def trial_step(stiff, table, tangent, mu, v1, v2, h, k):
    """Take one step by `stiff_step` or by the table; arguments and values are those of `slip_step`."""
    if stiff:
        return stiff_step(tangent, mu, v1, v2, h, k)
    return slip_step(table, tangent, mu, v1, v2, h, k)


@inlined
def shorter(table, tangent, mu, v1, v2, scale, stride):
    """Return the step near v_t = 0 of a method that shortens them there.

    With ρ about the impulse that is left to v_t = 0, steps like ρ^{1 − 1/m} are not many more than before,
    and their errors (h/ρ)⁵ρ sum up to N⁻⁴ for m = 5. None is longer than 2ρ, so that the direction settles
    and does not swing.
    """
    a11, a12, a22, b1, b2 = tangent
    speed = norm(v1, v2)
    pull = mu / speed
    push = norm(b1 - pull * (a11 * v1 + a12 * v2), b2 - pull * (a12 * v1 + a22 * v2))
    rest = speed / (push + speed * settling(tangent, mu, v1, v2))
    return min(stride, table.grading * stride * (rest / scale) ** (1.0 - 1.0 / table.grading), 2.0 * rest)


@inlined
def before_event(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, h, k):
    """Measure how far the end of a step over h lies before an event: positive before it."""
    if sought == GOAL and counts == IMPULSE:
        return left - h
    d1, d2, q1, q2, _, _, _, least = trial_step(stiff, table, tangent, mu, v1, v2, h, k)
    if sought == SLIP_ENDS:
        return least
    b1, b2 = tangent[3], tangent[4]
    if sought == GOAL and counts == WORK:
        return left - (h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2)
    dv3 = c * h + b1 * d1 + b2 * d2
    if sought == GOAL:
        return left - dv3
    return v3 + dv3 if phase == RESTITUTION else -v3 - dv3


@inlined
def locate(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, h, k):
    """Bisect a step that crosses an event, with secants in between, and return its length to the event."""
    low, high = 0.0, h
    at_low = before_event(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, low, k)
    at_high = before_event(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, high, k)
    for i in range(200):
        if at_high == 0.0 or high - low <= EPS * high:
            break
        middle = 0.5 * (low + high)
        if i % 3 < 2 and at_low > 0.0:
            middle = low + (high - low) * at_low / (at_low - at_high)
            # a secant that ends beside the bracket's end steps in by a rounding, so that both ends move
            middle = min(max(middle, low + EPS * high), high - EPS * high)
        value = before_event(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, middle, k)
        if value > 0.0:
            low, at_low = middle, value
        else:
            high, at_high = middle, value
    return high


@inlined
def stop_impulse(flat, a11, a12, a22, v1, v2):
    """Return −A⁺v_t, the tangential impulse that ends slip; `flat` says that A is singular."""
    det, trace = a11 * a22 - a12 * a12, a11 + a22
    if det > 0.0 and not flat:
        return (a12 * v2 - a22 * v1) / det, (a12 * v1 - a11 * v2) / det
    if trace == 0.0:
        return 0.0, 0.0
    return -(a11 * v1 + a12 * v2) / (trace * trace), -(a12 * v1 + a22 * v2) / (trace * trace)


@jit
def solve_stepping(
    w11,
    w12,
    w13,
    w22,
    w23,
    w33,
    v1,
    v2,
    v3,
    mu,
    e,
    law,
    velocity_scale,
    factor,
    table,
    steps,
    rtol,
    trace,
    path,
):
    """Solve one impact by steps in P₃.

    Beside the numbers of the problem, as `solve_into` has them, it takes:
        table: The Runge–Kutta method.
        steps: Steps over the scale |v₃ᵒ|/c, or where that is zero over the impulse that would end slip.
        rtol: 0 for steps of that length; else they are chosen so that the error of P_t in one step stays
            within rtol·μ·P₃, and slip ends where an impulse of that size would end it.
        trace: (m, 6) rows mode, phase, P₃ at start and end, normal work, friction work; m = 0: not wanted.
        path: (m, 6) rows P₃, v₁, v₂, v₃, P₁, P₂; m = 0: not wanted.

    Returns:
        the values of an `Result`; its path has one point for each step and one more, as far as there is room.
    """
    begins, figure, flags, view, problem = prepare(
        w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor
    )
    if begins == NO_IMPACT:
        return plain(without_impact(flags, v1, v2, v3))
    if begins != PROCEEDS:
        return plain(no_result(begins, figure))

    a11, a12, a22, b1, b2, c = problem.a11, problem.a12, problem.a22, problem.b1, problem.b2, problem.c
    counts, v1, v2, v3, speed = problem.counts, problem.v1, problem.v2, problem.v3, problem.speed
    along = b1 * problem.s1 + b2 * problem.s2
    scale = -v3 / c
    if v3 == 0.0:
        braking = mu * (a11 * v1 * v1 + 2.0 * a12 * v1 * v2 + a22 * v2 * v2) / (speed * speed) - along
        scale = speed / braking
    lasting = problem.flat and not problem.planar  # slip across the range of A never ends

    tangent = (a11, a12, a22, b1, b2)
    k = np.empty((max(len(table.b), STAGES), 4))
    stride = scale / steps
    # an impulse that ends slip, over that of friction, so small that slip is at its end
    negligible = rtol if rtol > 0.0 else ROUNDED if table.grading > 0.0 else 0.0
    most = MAX_CHOSEN if rtol > 0.0 else MAX_SCALES * steps
    ledger = new_ledger()
    course = frictionless_course(problem)
    p1 = p2 = p3 = 0.0
    mode, rate = IN_SLIP, c - mu * along
    state = State(problem.s1, problem.s2, speed, v3, 0.0, 0.0, 0.0, 0.0)
    settled = mu == 0.0  # from here on all rates are constant
    status, rows, iterations = SEPARATED, 0, 0
    points = record_point(path, 0, p3, v1, v2, v3, p1, p2)

    while True:
        iterations += 1
        if iterations > most:
            return plain(no_result(NOT_CONVERGED, 0.0))
        event = NO_EVENT
        if not settled and v1 == 0.0 and v2 == 0.0:
            settled = True
            course, state, new_flags = leave_zero_slip(problem, State(1.0, 0.0, 0.0, v3, 0.0, p1, p2, p3))
            flags |= new_flags
            mode, v3 = course.mode, state.v3
        left = left_to_gain(ledger, counts, v3)

        if settled:
            move, state = straight_move(problem, 1.0, course, state, ledger.phase, left)
            event, h, work, friction_work, rate, _, _ = move
            if event == NEVER:
                if ledger.phase == COMPRESSION:
                    return plain(no_result(UNSTOPPABLE, math.ldexp(v3, view.scale_v)))
                if flags & LOCKS:
                    status = LOCKED
                    break
                return plain(no_result(LAW_UNREACHABLE, math.ldexp(left, view.scale_v)))
            v1, v2 = tangential_velocity(problem, state)
            v3, p1, p2, p3 = state.v3, state.p1, state.p2, state.p3
        else:
            phase = ledger.phase
            h = stride
            if table.grading > 0.0:
                h = shorter(table, tangent, mu, v1, v2, scale, stride)
            stiff = rtol > 0.0 and h * settling(tangent, mu, v1, v2) > STIFF
            x1, x2 = stop_impulse(problem.flat, a11, a12, a22, v1, v2)
            vanishes = not lasting and math.hypot(x1, x2) <= negligible * mu * max(p3, scale)
            if vanishes:
                stiff, h = False, 0.0
            d1, d2, q1, q2, u1, u2, error, least = trial_step(stiff, table, tangent, mu, v1, v2, h, k)
            ends = least <= 0.0 and not lasting and not vanishes
            if rtol > 0.0 and not vanishes:
                tolerance = rtol * mu * max(p3 + h, scale)
                # a stiff step takes the direction as settled around that of its start
                if ends or (stiff and norm(u1 - v1, u2 - v2) > norm(v1, v2)):
                    stride *= 0.5
                    continue
                stride *= min(5.0, max(0.2, 0.9 * (tolerance / error) ** 0.2)) if error > 0.0 else 5.0
                if error > tolerance:
                    continue
            elif ends:
                vanishes = True
                h = locate(SLIP_ENDS, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, h, k)
                d1, d2, q1, q2, u1, u2, _, _ = trial_step(stiff, table, tangent, mu, v1, v2, h, k)
            v3_end = v3 + c * h + b1 * d1 + b2 * d2
            work = h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2
            # v₃ = κ·v_t comes to zero with slip, and is not told before it by rounding
            tied = vanishes and problem.s == 0.0 and problem.offset == 0.0
            # of the events on this step the first: each search starts from the event found before
            for sought in (V3_ZERO, GOAL):
                if sought == V3_ZERO:
                    crossed = v3_end >= 0.0 if phase == COMPRESSION else v3_end <= 0.0
                elif phase == COMPRESSION:
                    crossed = False
                else:
                    crossed = left <= (h if counts == IMPULSE else work if counts == WORK else v3_end - v3)
                if crossed and h > 0.0 and not (tied and sought == V3_ZERO):
                    h = locate(sought, phase, counts, left, stiff, table, tangent, c, mu, v1, v2, v3, h, k)
                    vanishes = False
                    event = COMPRESSION_ENDS if phase == COMPRESSION else COMPRESSION_RESUMES
                    if sought == GOAL:
                        event = LAW_MET
                    d1, d2, q1, q2, u1, u2, _, _ = trial_step(stiff, table, tangent, mu, v1, v2, h, k)
                    v3_end = v3 + c * h + b1 * d1 + b2 * d2
                    work = h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2
            friction_work = 0.5 * (d1 * (v1 + u1) + d2 * (v2 + u2))
            friction_work += 0.5 * h * (b1 * d1 + b2 * d2) - b1 * q1 - b2 * q2
            if event in (COMPRESSION_ENDS, COMPRESSION_RESUMES):
                v3_end = 0.0
            if vanishes:
                # what is left of v_t takes an impulse too, so that v = v⁻ + W P holds on; if that is more
                # than the cone of friction has room for, slip is not at its end
                x1, x2 = stop_impulse(problem.flat, a11, a12, a22, u1, u2)
                room = mu * (p3 + h) * ROOM
                vanishes = h == 0.0 or math.hypot(p1 + d1 + x1, p2 + d2 + x2) <= room
            if vanishes:
                friction_work += 0.5 * (x1 * u1 + x2 * u2)
                d1, d2 = d1 + x1, d2 + x2
                u1 = u2 = 0.0
                v3_end = 0.0 if tied else v3_end + b1 * x1 + b2 * x2
                if phase == COMPRESSION and v3_end >= 0.0:
                    event = COMPRESSION_ENDS
                elif phase == RESTITUTION and v3_end < 0.0:
                    event = COMPRESSION_RESUMES
            # as far as the error of P_t so far lets the direction be known, which is lost as slip dies
            doubt, push = rtol * mu * (p3 + h), norm(b1, b2)
            flags |= jams(rate + min(1.0, doubt * (a11 + a22) / speed) * mu * push)
            if rtol > 0.0:
                flags |= jams(v3_end - v3 + 2.0 * rtol * mu * max(p3 + h, scale) * push)
            before, speed = speed, norm(u1, u2)
            rate = c - mu * (b1 * u1 + b2 * u2) / speed if speed > 0.0 else problem.s
            if abs(v1 * u2 - v2 * u1) > TURNED * before * speed:
                flags |= SLIP_TURNS
            p1 += d1
            p2 += d2
            p3 += h
            v1, v2, v3 = u1, u2, v3_end

        flags |= mode_flag(mode, h, p3)
        rows = record_move(trace, rows, mode, ledger.phase, p3 - h, p3, work, friction_work)
        points = record_point(path, points, p3, v1, v2, v3, p1, p2)
        ledger, event, new_flags = close_move(ledger, problem, event, h, work, rate, left, p3)
        flags |= new_flags
        if event == LAW_MET:
            break

    if status != LOCKED:
        if counts == VELOCITY:
            v3 = ledger.goal
        if rate < 0.0 and v3 < -CLOSE_TO_JUMP * p3 * rate:
            flags |= NEAR_JUMP
    velocity, impulse = (v1, v2, v3), (p1, p2, p3)
    result = finish(
        view,
        problem,
        status,
        flags,
        iterations,
        velocity,
        impulse,
        ledger.compressed,
        trace,
        rows,
        path,
        points,
    )
    return plain(result)
