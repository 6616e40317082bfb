"""The method "exact": slip by power series, everything else in closed form. (theory.md, sections 2 to 5)"""

from __future__ import annotations

import math

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
    NEVER,
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
from .delassus import ZERO, classify
from .laws import creates_energy, linear_event, restitution_goal
from .recording import mark, mark_stretch, note
from .resumed_slip import resumed_direction
from .slip_equations import TERMS, in_frame, polynomials
from .slip_series import works
from .turning_slip import NEAR, NO_FORCE, turn_on

SCRATCH = 2 * TERMS + 6
"""Floats of scratch space that an impact needs."""

MAX_STEPS = 1000
"""Bound on the moves of one impact; what the worst cases need is in docs/hard-cases.md."""

STRAIGHT = 2.0**-54
"""An angle that turns no double: slip this close to an invariant direction is straight."""

VANISHED = 2.0**-80
"""A speed from which the path cannot be told from the one that starts at v_t = 0. (theory.md, 3.4)"""

TOO_SHORT = 2.0**-300
"""Approach over slip at which an impact without jam sees no turn of the slip: laws agree, works underflow."""

NEAR_THRESHOLD = 1e-6
"""Relative distance of μ to the stick threshold within which NEAR_STICK_THRESHOLD is set."""


@inner
def canonical(w12, w13, w23, w11, w22, v1, v2):
    """Choose signs and order of the tangent axes so that mirrored problems are one problem.

    Returns:
        the signs of t₁ and t₂, whether they are then swapped, and whether that changes nothing.
    """
    sign1 = -1.0 if v1 < 0.0 or (v1 == 0.0 and w13 < 0.0) else 1.0
    sign2 = -1.0 if v2 < 0.0 or (v2 == 0.0 and w23 < 0.0) else 1.0
    if sign1 * sign2 * w12 < 0.0:
        if v1 == 0.0 and w13 == 0.0:
            sign1 = -1.0
        elif v2 == 0.0 and w23 == 0.0:
            sign2 = -1.0
    x1, x2, y1, y2 = abs(v1), abs(v2), sign1 * w13, sign2 * w23
    swapped = x2 > x1 or (x2 == x1 and (y2 > y1 or (y2 == y1 and w22 > w11)))
    return sign1, sign2, swapped, x2 == x1 and y2 == y1 and w22 == w11


@inner
def halves(exponent):
    """Return two powers of two whose product is 2^exponent, also where that one would overflow."""
    half = exponent // 2
    return math.ldexp(1.0, half), math.ldexp(1.0, exponent - half)


@inner
def failed(status, figure):
    """Return the answer of a problem that has none; `figure` is the number that the message gives."""
    nan = math.nan
    return status, 0, 0, nan, nan, nan, nan, nan, nan, nan, figure, 0, 0


@jit
def solve_into(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, scratch, trace, path):
    """Solve one impact.

    Args:
        w11 … w33: Upper triangle of W, row by row.
        v1, v2, v3: Pre-impact velocity.
        mu, e, law: Friction, restitution and the code of its law.
        scratch: SCRATCH floats.
        trace: (m, 6) rows mode, phase, P₃ at start and end, normal work, friction work; m = 0: not wanted.
        path: (m, 6) rows P₃, v₁, v₂, v₃, P₁, P₂; m = 0: not wanted.

    Returns:
        status, flags, iterations, v⁺ (3), P (3), compression impulse, the figure of a failure's message,
        rows of the trace, rows of the path.
    """
    largest_w = max(max(abs(w11), abs(w22), abs(w33)), max(abs(w12), abs(w13), abs(w23)))
    largest_v = max(abs(v1), abs(v2), abs(v3))
    finite = largest_w < math.inf and largest_v < math.inf and v1 + v2 == v1 + v2
    finite = finite and w12 == w12 and w13 == w13 and w23 == w23 and w11 == w11 and w22 == w22 and w33 == w33
    if not (finite and v1 == v1 and v2 == v2 and v3 == v3 and 0.0 <= mu < math.inf and 0.0 <= e <= 1.0):
        return failed(INVALID_NUMBERS, 0.0)

    # scaling by powers of two and mirroring are exact: problems that differ by them get the same bits
    scale_w, scale_v = math.frexp(largest_w)[1], math.frexp(largest_v)[1]
    in1, in2, in3 = v1, v2, v3
    sign1, sign2, swapped, diagonal = canonical(w12, w13, w23, w11, w22, v1, v2)
    fw1, fw2 = halves(-scale_w)
    fv1, fv2 = halves(-scale_v)
    w11, w22, w33 = w11 * fw1 * fw2, w22 * fw1 * fw2, w33 * fw1 * fw2
    w12, w13, w23 = sign1 * sign2 * w12 * fw1 * fw2, sign1 * w13 * fw1 * fw2, sign2 * w23 * fw1 * fw2
    v1, v2, v3 = sign1 * v1 * fv1 * fv2, sign2 * v2 * fv1 * fv2, v3 * fv1 * fv2
    if swapped:
        v1, v2, w11, w22, w13, w23 = v2, v1, w22, w11, w23, w13

    rank, a11, a12, b1, a22, b2, c, k1, k2, s, least, spread = classify(w11, w12, w13, w22, w23, w33)
    if rank < 0:
        return failed(INDEFINITE_DELASSUS, math.ldexp(least, scale_w))
    flags = SINGULAR_DELASSUS if rank < 3 else 0

    # where A is singular nothing acts across its range: v_t either has a part there for good, or none
    flat = planar = crosses = rank < 3 and (s > 0.0 or rank == 1) and a11 + a22 > 0.0
    if planar:
        norm = math.hypot(a12, a22) if a22 > a11 else math.hypot(a11, a12)
        d1, d2 = (a12 / norm, a22 / norm) if a22 > a11 else (a11 / norm, a12 / norm)
        along = d1 * v1 + d2 * v2
        planar = abs(d1 * v2 - d2 * v1) <= ZERO * spread * (abs(v1) + abs(v2))
        crosses = not planar
        if planar:
            v1, v2 = d1 * along, d2 * along
    speed = math.sqrt(v1 * v1 + v2 * v2)
    if speed < 1e-140:
        speed = math.hypot(v1, v2)
    s1, s2 = 1.0, 0.0
    if speed > 0.0:
        s1, s2 = v1 / speed, v2 / speed
    if v3 > 0.0 or (v3 == 0.0 and not (speed > 0.0 and c < mu * (b1 * s1 + b2 * s2))):
        return NO_IMPACT, 0, 0, in1, in2, in3, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0
    if c <= 0.0:
        return failed(UNSTOPPABLE, math.ldexp(v3, scale_v))
    if v3 == 0.0:
        flags |= IMPACT_WITHOUT_COLLISION
    elif law == ENERGETIC and v3 > -TOO_SHORT * speed and c > mu * (b1 * s1 + b2 * s2):
        law = POISSON

    # s = 0 ties v₃ to v_t for good: v₃ = k·v_t + offset (theory.md, 6)
    offset = 0.0
    endless_slip = crosses or s == 0.0  # may turn into a direction in which nothing acts
    if s == 0.0:
        offset = v3 - k1 * v1 - k2 * v2
        if abs(offset) <= ZERO * spread * (abs(v3) + abs(k1 * v1) + abs(k2 * v2)):
            offset = 0.0

    # the slip equations in units in which their coefficients are of order one
    largest = max(max(abs(b1), abs(b2)), mu * max(a11, a22))
    omega = math.ldexp(1.0, math.frexp(largest)[1]) if mu > 0.0 else 1.0
    per = 1.0 / omega
    muo = mu * per
    f11, f12, f22, fb1, fb2 = muo * a11, muo * a12, muo * a22, per * b1, per * b2

    series, inverse = scratch[: TERMS + 1], scratch[TERMS + 1 :]
    work_wanted = law == ENERGETIC or trace.shape[0] > 0
    path_wanted = path.shape[0] > 0
    approach, start1, start2 = v3, v1, v2
    p1 = p2 = p3 = 0.0
    phase = COMPRESSION
    phase_start = compressed = restored = 0.0
    compression_work = restitution_work = 0.0
    goal = 0.0
    turn = 0.0  # p(0) in the present frame, carried along to keep its relative accuracy
    fresh = True
    t1 = m0 = 0.0
    settled = False  # from here on everything is linear
    mode, rate, gain, dp1, dp2 = SLIP, c, 0.0, 0.0, 0.0
    rows = points = 0
    if path_wanted:
        points = mark(path, points, p3, v1, v2, v3, p1, p2)
    status = SEPARATED
    iterations = 0

    while True:
        iterations += 1
        if iterations > MAX_STEPS:
            return failed(NOT_CONVERGED, 0.0)

        # ---- how everything changes from here ----
        straight = True
        ends_slip = False
        until = math.inf
        if settled:
            pass
        elif mu == 0.0:
            settled = True
        elif speed <= VANISHED:
            settled = True
            speed = turn = 0.0
            if (
                s > 0.0
                and abs(k1 * start1) + abs(k2 * start2) + s * p3 < abs(b1 * p1) + abs(b2 * p2) + c * p3
            ):
                # the identity of theory.md, 6 knows v₃ better than the sum over the path
                v3 = approach - k1 * start1 - k2 * start2 + s * p3
            stick_ratio = math.sqrt(k1 * k1 + k2 * k2)
            excess = stick_ratio - mu
            if abs(excess) <= NEAR_THRESHOLD * mu:
                flags |= NEAR_STICK_THRESHOLD
            if excess <= 0.0:
                flags |= STICKS
                mode, rate = STICK, s
                dp1, dp2, gain = -k1, -k2, 0.0
                if s == 0.0:
                    flags |= LOCKS
                    v3 = offset
            else:
                flags |= SLIP_RESUMED
                mode = RESUMED
                if flat:
                    s1, s2 = k1 / stick_ratio, k2 / stick_ratio
                    gain = (a11 + a22) * excess
                else:
                    gain, s1, s2 = resumed_direction(a11, a12, a22, b1, b2, mu)
                rate = c - mu * (b1 * s1 + b2 * s2)
                dp1, dp2 = -mu * s1, -mu * s2
        else:
            al, ax, ap, bl, bp = in_frame(f11, f12, f22, fb1, fb2, s1, s2)
            if fresh:
                turn = 0.0 if planar else bp - ax
                fresh = False
            t1, t2, t3, t4, m0, m1, m2, m3 = polynomials(al, ax, ap, bl, bp)
            bl *= omega
            bp *= omega
            rate = c - mu * bl
            if endless_slip and abs(m0) <= NO_FORCE:
                m0, rate = 0.0, s
            if rate < 0.0:
                flags |= JAM
            bend = abs(turn) + abs(t1) + abs(t2) + abs(t3) + abs(t4)
            unbent = bend <= 0.25 * STRAIGHT * abs(m0)
            straight = unbent or (abs(turn) <= STRAIGHT * abs(t1) and abs(turn * t2) <= 0.1 * t1 * t1)
            if straight:
                gain = omega * m0
                dp1, dp2 = -mu * s1, -mu * s2
                if m0 < 0.0:
                    until, ends_slip = -speed / gain, True
                if t1 > 0.0 and turn != 0.0 and not unbent:
                    # leaving an unstable direction: straight until the angle is one that doubles can tell
                    tau = 2.0 / t1 * math.log(2.0 * STRAIGHT * t1 / abs(turn))
                    leave = speed * per * (math.expm1(m0 * tau) / m0 if m0 != 0.0 else tau)
                    if leave < until:
                        until, ends_slip = leave, False

        event = NOTHING
        span = work = friction_work = 0.0
        left = goal - v3
        if law == POISSON:
            left = goal - restored
        elif law == ENERGETIC:
            left = goal - restitution_work

        # ---- a straight move, in closed form ----
        if straight:
            span, event = linear_event(phase, law, left, v3, rate)
            # v₃ = k·v_t: on a straight line the two vanish together
            together = s == 0.0 and offset == 0.0 and event == STOPS and ends_slip
            if until < span or together:
                span, event = until, NOTHING
            if span == math.inf:
                if phase == COMPRESSION:
                    return failed(UNSTOPPABLE, math.ldexp(v3, scale_v))
                if flags & LOCKS:
                    status = LOCKED
                    break
                return failed(LAW_UNREACHABLE, math.ldexp(left, scale_v))
            v3_end = v3 + rate * span
            speed_end = speed + gain * span
            if span == until and ends_slip:
                speed_end = 0.0
                if s == 0.0:
                    v3_end = offset
            work = 0.5 * (v3 + v3_end) * span
            friction_work = -0.5 * mu * (speed + speed_end) * span if mode != STICK else 0.0
            if turn != 0.0 and speed > 0.0 and speed_end > 0.0:
                tau = math.log(speed_end / speed) / m0 if m0 != 0.0 else omega * span / speed
                turn *= math.exp(0.5 * t1 * tau)
            p1 += dp1 * span
            p2 += dp2 * span
            p3 += span
            v3, speed = v3_end, speed_end

        else:
            flags |= SLIP_TURNS
            field = (f11, f12, f22, fb1, fb2, omega, per, mu, c, s, k1, k2)
            polynomial = (t1, t2, t3, t4, m0, m1, m2, m3, bl, bp)
            slip = (s1, s2, speed, v3)
            event, near_jump, x, stretch, n1, d1, d2, jam, end = turn_on(
                series,
                inverse,
                field,
                endless_slip,
                slip,
                turn,
                polynomial,
                rate,
                phase,
                law,
                goal,
                left,
                offset,
            )
            if event == NEVER:
                never = LAW_UNREACHABLE if phase == RESTITUTION else UNSTOPPABLE
                return failed(never, math.ldexp(v3, scale_v))
            if near_jump:
                flags |= NEAR_JUMP
            span, along, across, v3_end, ratio, t = end
            if work_wanted:
                work, friction_work = works(stretch, x)
            if path_wanted:
                points = mark_stretch(path, points, stretch, x, d1, d2, p1, p2, p3)
            p1 += d1 * along - d2 * across
            p2 += d2 * along + d1 * across
            p3 += span
            v3 = v3_end
            chord = 1.0 + t * t
            rate = (jam[0] + t * (jam[1] + t * jam[2])) / chord
            if rate < 0.0:
                flags |= JAM
            cos, sin = (1.0 - t * t) / chord, 2.0 * t / chord
            s1, s2 = d1 * cos - d2 * sin, d2 * cos + d1 * sin
            norm = 1.0 / math.sqrt(s1 * s1 + s2 * s2)
            s1 *= norm
            s2 *= norm
            speed *= ratio
            f = stretch[3]
            if stretch[0]:
                y = t / f[0]
                turn = n1 * t * (1.0 + y * (f[4] + y * (f[5] + y * f[6]))) / (chord * chord)
            else:
                turn *= (1.0 + x * (f[4] + x * (f[5] + x * (f[6] + x * f[10])))) / (chord * chord)

        # ---- the ledger of the normal direction, and what the event brings ----
        if trace.shape[0] > 0:
            rows = note(trace, rows, mode, phase, p3 - span, p3, work, friction_work)
        if phase == COMPRESSION:
            compression_work += work
        else:
            restitution_work += work
            restored += span
        if event == STOPS:
            v3 = 0.0
            compressed += p3 - phase_start
            phase = RESTITUTION
            goal = restitution_goal(law, e, compressed, compression_work, approach)
            if goal == 0.0:
                event = LAW_MET
        elif event == FALLS_BACK:
            v3 = 0.0
            flags |= SECOND_COMPRESSION
            phase = COMPRESSION
            phase_start = p3
            if law != NEWTON and left - (span if law == POISSON else work) < NEAR * goal:
                flags |= NEAR_JUMP
        if path_wanted:
            points = mark(path, points, p3, s1 * speed, s2 * speed, v3, p1, p2)
        if event == LAW_MET:
            if law == NEWTON:
                v3 = goal
                # dv₃/dP₃ is on its way to a jam; a goal just higher would have been missed
                fall = mu * (s1 * b2 - s2 * b1) * omega * turn
                if not straight and speed * rate * rate < 2.0 * NEAR * goal * fall:
                    flags |= NEAR_JUMP
            if rate < 0.0 and v3 < -NEAR * p3 * rate:
                flags |= NEAR_JUMP
            break

    if mu == 0.0:
        v1, v2 = start1 + b1 * p3, start2 + b2 * p3
    else:
        v1, v2 = s1 * speed, s2 * speed
    if v3 <= 0.0:
        v3 = 0.0
        status = LOCKED if flags & LOCKS else ENDED_AT_REST

    if diagonal:
        v1 = v2 = 0.5 * (v1 + v2)
        p1 = p2 = 0.5 * (p1 + p2)

    if creates_energy(start1, start2, approach, v1, v2, v3, p1, p2, p3):
        flags |= ENERGY_CREATED

    if swapped:
        v1, v2, p1, p2 = v2, v1, p2, p1
    scale_p = scale_v - scale_w
    fv1, fv2 = halves(scale_v)
    fp1, fp2 = halves(scale_p)
    # adding zero turns −0 into 0
    v1, v2, v3 = sign1 * v1 * fv1 * fv2 + 0.0, sign2 * v2 * fv1 * fv2 + 0.0, v3 * fv1 * fv2
    p1, p2, p3 = sign1 * p1 * fp1 * fp2 + 0.0, sign2 * p2 * fp1 * fp2 + 0.0, p3 * fp1 * fp2
    compressed = compressed * fp1 * fp2
    if not (abs(v1) + abs(v2) + abs(v3) + abs(p1) + abs(p2) + abs(p3) < math.inf):
        return failed(OUT_OF_RANGE, 0.0)
    for i in range(rows):
        trace[i, 2] = math.ldexp(trace[i, 2], scale_p)
        trace[i, 3] = math.ldexp(trace[i, 3], scale_p)
        trace[i, 4] = math.ldexp(trace[i, 4], scale_p + scale_v)
        trace[i, 5] = math.ldexp(trace[i, 5], scale_p + scale_v)
    for i in range(points):
        x1, x2, y1, y2 = path[i, 1], path[i, 2], path[i, 4], path[i, 5]
        if mu == 0.0:
            x1, x2 = start1 + b1 * path[i, 0], start2 + b2 * path[i, 0]
        if swapped:
            x1, x2, y1, y2 = x2, x1, y2, y1
        path[i, 0] = math.ldexp(path[i, 0], scale_p)
        path[i, 1] = math.ldexp(sign1 * x1, scale_v)
        path[i, 2] = math.ldexp(sign2 * x2, scale_v)
        path[i, 3] = math.ldexp(path[i, 3], scale_v)
        path[i, 4] = math.ldexp(sign1 * y1, scale_p)
        path[i, 5] = math.ldexp(sign2 * y2, scale_p)
    return status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, 0.0, rows, points
