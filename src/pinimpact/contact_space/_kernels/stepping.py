"""Stepping in normal impulse: the paper's Euler scheme, and Runge–Kutta methods in its place.

Slip is the differential equation dP_t/dP₃ = −μ v_t/|v_t| with v = v⁻ + W P. What follows the instant of
v_t = 0 has constant rates, so no method has anything to discretise there: one step takes it.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner, jit
from .codes import (
    COMPRESSION,
    ENDED_AT_REST,
    ENERGETIC,
    ENERGY_CREATED,
    FALLS_BACK,
    IMPACT_WITHOUT_COLLISION,
    INDEFINITE_DELASSUS,
    INVALID_NUMBERS,
    JAM,
    LAW_MET,
    LAW_UNREACHABLE,
    LOCKED,
    LOCKS,
    NEAR_JUMP,
    NEAR_STICK_THRESHOLD,
    NEWTON,
    NO_IMPACT,
    NOT_CONVERGED,
    NOTHING,
    OUT_OF_RANGE,
    POISSON,
    RESTITUTION,
    RESUMED,
    SECOND_COMPRESSION,
    SEPARATED,
    SINGULAR_DELASSUS,
    SLIP,
    SLIP_RESUMED,
    SLIP_TURNS,
    STICK,
    STICKS,
    STOPS,
    UNSTOPPABLE,
)
from .delassus import EPS, ZERO, classify
from .laws import creates_energy, linear_event, restitution_goal
from .path import NEAR, NEAR_THRESHOLD, failed
from .recording import mark, note
from .resumed_slip import resumed_direction

MAX_SCALES = 1000
"""An impact that slips for more than this many times the scale of its steps is given up."""

MAX_CHOSEN = 100_000
"""So is one that takes more than this many steps of chosen length."""

ROOM = 1.0 + 1e-9
"""How far the impulse that sets v_t to zero may leave the cone of friction, for rounding."""

TURNED = 64.0 * EPS
"""Angle between two steps that is more than rounding."""

SLIP_ENDS, V3_ZERO, LAW = 0, 1, 2


@inner
def norm(x, y):
    """Return √(x² + y²); the slower function of the library only where squares would vanish."""
    square = x * x + y * y
    return math.sqrt(square) if square > 1e-280 else math.hypot(x, y)


@inner
def slip_step(table, tangent, mu, v1, v2, h, k):
    """Take one step of slip from v_t over h.

    Args:
        table: The method.
        tangent: A₁₁, A₁₂, A₂₂, b₁, b₂.
        mu: Friction.
        v1: Tangential velocity at the start,
        v2: its second component.
        h: Increment of P₃.
        k: (m, 2) scratch for the stages.

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


@inner
def gauge(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, h, k):
    """Measure how far the end of a step over h lies before an event: positive before it."""
    if kind == LAW and law == POISSON:
        return left - h
    d1, d2, q1, q2, _, _, _, least = slip_step(table, tangent, mu, v1, v2, h, k)
    if kind == SLIP_ENDS:
        return least
    b1, b2 = tangent[3], tangent[4]
    if kind == LAW and law == ENERGETIC:
        return left - (h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2)
    dv3 = c * h + b1 * d1 + b2 * d2
    if kind == LAW:
        return left - dv3
    return v3 + dv3 if phase == RESTITUTION else -v3 - dv3


@inner
def locate(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, h, k):
    """Bisect a step that crosses an event, with secants in between, and return its length to the event."""
    low, high = 0.0, h
    at_low = gauge(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, low, k)
    at_high = gauge(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, high, k)
    for i in range(200):
        if at_high == 0.0 or high - low <= EPS * high:
            break
        middle = 0.5 * (low + high)
        if i % 3 < 2 and at_low > 0.0:
            middle = low + (high - low) * at_low / (at_low - at_high)
            # a secant that ends beside the bracket's end steps in by a rounding, so that both ends move
            middle = min(max(middle, low + EPS * high), high - EPS * high)
        value = gauge(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, middle, k)
        if value > 0.0:
            low, at_low = middle, value
        else:
            high, at_high = middle, value
    return high


@inner
def stop_impulse(a11, a12, a22, v1, v2):
    """Return −A⁺v_t, the tangential impulse that ends slip."""
    det, trace = a11 * a22 - a12 * a12, a11 + a22
    if det > ZERO * trace * trace:
        return (a12 * v2 - a22 * v1) / det, (a12 * v1 - a11 * v2) / det
    if trace == 0.0:
        return 0.0, 0.0
    return -(a11 * v1 + a12 * v2) / (trace * trace), -(a12 * v1 + a22 * v2) / (trace * trace)


@jit
def solve_stepping(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, table, steps, rtol, trace, path):
    """Solve one impact by steps in P₃.

    Beside the twelve numbers of the problem it takes:
        table: The Runge–Kutta method.
        steps: Steps over the scale |v₃ᵒ|/c, or where that is zero over the impulse that would end slip.
        rtol: 0 for steps of that length; else they are chosen so that the error of P_t in one step stays
            within rtol·μ·P₃, and slip ends where an impulse of that size would end it.
        trace: (m, 6) rows mode, phase, P₃ at start and end, normal work, friction work; m = 0: not wanted.
        path: (m, 6) rows P₃, v₁, v₂, v₃, P₁, P₂; m = 0: not wanted.

    Returns:
        status, flags, iterations, v⁺ (3), P (3), compression impulse, the figure of a failure's message,
        rows of the trace, rows of the path (one for each iteration and one more, as far as there is room).
    """
    for x in (w11, w12, w13, w22, w23, w33, v1, v2, v3):
        if not math.isfinite(x):
            return failed(INVALID_NUMBERS, 0.0)
    if not (0.0 <= mu < math.inf and 0.0 <= e <= 1.0):
        return failed(INVALID_NUMBERS, 0.0)
    rank, a11, a12, b1, a22, b2, c, k1, k2, s, least, spread = classify(w11, w12, w13, w22, w23, w33)
    if rank < 0:
        return failed(INDEFINITE_DELASSUS, least)
    flags = SINGULAR_DELASSUS if rank < 3 else 0

    start1, start2, approach = v1, v2, v3
    speed = math.hypot(v1, v2)
    along = (b1 * v1 + b2 * v2) / speed if speed > 0.0 else 0.0
    if v3 > 0.0 or (v3 == 0.0 and not c < mu * along):
        return NO_IMPACT, 0, 0, v1, v2, v3, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0
    if c <= 0.0:
        return failed(UNSTOPPABLE, v3)
    scale = -v3 / c
    if v3 == 0.0:
        flags |= IMPACT_WITHOUT_COLLISION
        braking = mu * (a11 * v1 * v1 + 2.0 * a12 * v1 * v2 + a22 * v2 * v2) / (speed * speed) - along
        scale = speed / braking

    # s = 0 ties v₃ to v_t for good: v₃ = k·v_t + offset (theory.md, 4.3)
    offset = 0.0
    if s == 0.0:
        offset = v3 - k1 * v1 - k2 * v2
        if abs(offset) <= ZERO * spread * (abs(v3) + abs(k1 * v1) + abs(k2 * v2)):
            offset = 0.0

    # where A is singular, slip across its range never ends
    x1, x2 = stop_impulse(a11, a12, a22, v1, v2)
    lasting = math.hypot(v1 + a11 * x1 + a12 * x2, v2 + a12 * x1 + a22 * x2) > ZERO * speed

    tangent = (a11, a12, a22, b1, b2)
    k = np.empty((len(table.b), 2))
    stride = scale / steps
    most = MAX_CHOSEN if rtol > 0.0 else MAX_SCALES * steps
    p1 = p2 = p3 = 0.0
    phase = COMPRESSION
    phase_start = compressed = restored = 0.0
    compression_work = restitution_work = goal = 0.0
    mode, rate, dp1, dp2, dv1, dv2 = SLIP, c - mu * along, 0.0, 0.0, b1, b2
    settled = mu == 0.0  # from here on all rates are constant
    rows = 0
    points = mark(path, 0, p3, v1, v2, v3, p1, p2)
    iterations = 0

    while True:
        iterations += 1
        if iterations > most:
            return failed(NOT_CONVERGED, 0.0)
        event = NOTHING
        left = goal - v3
        if law == POISSON:
            left = goal - restored
        elif law == ENERGETIC:
            left = goal - restitution_work

        if not settled and v1 == 0.0 and v2 == 0.0:
            settled = True
            ratio = math.hypot(k1, k2)
            if abs(ratio - mu) <= NEAR_THRESHOLD * mu:
                flags |= NEAR_STICK_THRESHOLD
            if ratio <= mu:
                flags |= STICKS
                mode, rate, dp1, dp2, dv1, dv2 = STICK, s, -k1, -k2, 0.0, 0.0
                if s == 0.0:
                    flags |= LOCKS
                    v3 = offset
            else:
                flags |= SLIP_RESUMED
                mode = RESUMED
                gain, s1, s2 = resumed_direction(a11, a12, a22, b1, b2, mu)
                rate = c - mu * (b1 * s1 + b2 * s2)
                dp1, dp2, dv1, dv2 = -mu * s1, -mu * s2, gain * s1, gain * s2

        if settled:
            h, event = linear_event(phase, law, left, v3, rate)
            if h == math.inf:
                if phase == COMPRESSION:
                    return failed(UNSTOPPABLE, v3)
                if flags & LOCKS:
                    break
                return failed(LAW_UNREACHABLE, left)
            v3_end = 0.0 if event in (STOPS, FALLS_BACK) else v3 + rate * h
            work = 0.5 * h * (v3 + v3_end)
            u1, u2 = v1 + dv1 * h, v2 + dv2 * h
            d1, d2 = dp1 * h, dp2 * h
            friction_work = 0.5 * (d1 * (v1 + u1) + d2 * (v2 + u2))
        else:
            h = stride
            vanishes = False
            d1, d2, q1, q2, u1, u2, error, least = slip_step(table, tangent, mu, v1, v2, h, k)
            ends = least <= 0.0 and not lasting
            if rtol > 0.0:
                tolerance = rtol * mu * max(p3 + h, scale)
                if ends:
                    x1, x2 = stop_impulse(a11, a12, a22, v1, v2)
                    if math.hypot(x1, x2) > tolerance:
                        stride *= 0.5
                        continue
                    vanishes = True
                    h = 0.0
                else:
                    stride *= min(5.0, max(0.2, 0.9 * (tolerance / error) ** 0.2)) if error > 0.0 else 5.0
                    if error > tolerance:
                        continue
            elif ends:
                vanishes = True
                h = locate(SLIP_ENDS, phase, law, left, table, tangent, c, mu, v1, v2, v3, h, k)
            if vanishes:
                d1, d2, q1, q2, u1, u2, _, _ = slip_step(table, tangent, mu, v1, v2, h, k)
            v3_end = v3 + c * h + b1 * d1 + b2 * d2
            work = h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2
            # of the events on this step the first: each search starts from the event found before
            for kind in (V3_ZERO, LAW):
                if kind == V3_ZERO:
                    crossed = v3_end >= 0.0 if phase == COMPRESSION else v3_end <= 0.0
                elif phase == COMPRESSION:
                    crossed = False
                else:
                    crossed = left <= (h if law == POISSON else work if law == ENERGETIC else v3_end - v3)
                if crossed and h > 0.0:
                    h = locate(kind, phase, law, left, table, tangent, c, mu, v1, v2, v3, h, k)
                    vanishes = False
                    event = LAW_MET if kind == LAW else STOPS if phase == COMPRESSION else FALLS_BACK
                    d1, d2, q1, q2, u1, u2, _, _ = slip_step(table, tangent, mu, v1, v2, h, k)
                    v3_end = v3 + c * h + b1 * d1 + b2 * d2
                    work = h * v3 + 0.5 * c * h * h + b1 * q1 + b2 * q2
            friction_work = 0.5 * (d1 * (v1 + u1) + d2 * (v2 + u2))
            friction_work += 0.5 * h * (b1 * d1 + b2 * d2) - b1 * q1 - b2 * q2
            if event in (STOPS, FALLS_BACK):
                v3_end = 0.0
            if vanishes:
                # what is left of v_t takes an impulse too, so that v = v⁻ + W P holds on; if that is more
                # than the cone of friction has room for, slip is not at its end
                x1, x2 = stop_impulse(a11, a12, a22, u1, u2)
                room = mu * (p3 + h) * ROOM
                vanishes = rtol > 0.0 or math.hypot(p1 + d1 + x1, p2 + d2 + x2) <= room
            if vanishes:
                friction_work += 0.5 * (x1 * u1 + x2 * u2)
                d1, d2 = d1 + x1, d2 + x2
                u1 = u2 = 0.0
                v3_end += b1 * x1 + b2 * x2
                if phase == COMPRESSION and v3_end >= 0.0:
                    event = STOPS
                elif phase == RESTITUTION and v3_end < 0.0:
                    event = FALLS_BACK
            if rate < 0.0:
                flags |= JAM
            before, speed = speed, norm(u1, u2)
            rate = c - mu * (b1 * u1 + b2 * u2) / speed if speed > 0.0 else s
            if abs(v1 * u2 - v2 * u1) > TURNED * before * speed:
                flags |= SLIP_TURNS

        rows = note(trace, rows, mode, phase, p3, p3 + h, work, friction_work)
        p1 += d1
        p2 += d2
        p3 += h
        v1, v2, v3 = u1, u2, v3_end
        points = mark(path, points, p3, v1, v2, v3, p1, p2)
        if phase == COMPRESSION:
            compression_work += work
        else:
            restitution_work += work
            restored += h
        if event == STOPS:
            compressed += p3 - phase_start
            phase = RESTITUTION
            goal = restitution_goal(law, e, compressed, compression_work, approach)
            if e == 0.0:
                break
        elif event == FALLS_BACK:
            flags |= SECOND_COMPRESSION
            phase = COMPRESSION
            phase_start = p3
            if law != NEWTON and left - (h if law == POISSON else work) < NEAR * goal:
                flags |= NEAR_JUMP
        elif event == LAW_MET:
            if law == NEWTON:
                v3 = goal
            if rate < 0.0 and v3 < -NEAR * p3 * rate:
                flags |= NEAR_JUMP
            break

    status = SEPARATED
    if v3 <= 0.0:
        v3 = 0.0
        status = LOCKED if flags & LOCKS else ENDED_AT_REST
    if creates_energy(start1, start2, approach, v1, v2, v3, p1, p2, p3):
        flags |= ENERGY_CREATED
    if not math.isfinite(v1 + v2 + v3 + p1 + p2 + p3):
        return failed(OUT_OF_RANGE, 0.0)
    return status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, 0.0, rows, points
