"""Slip that turns: to its next event, or as far as one series carries. (theory.md, 3.3 and 4.2)"""

from __future__ import annotations

import math

from ..._numeric.jit import inlined
from .codes import ENERGETIC, FALLS_BACK, LAW_MET, NEVER, NEWTON, NOTHING, POISSON, RESTITUTION, STOPS
from .invariant_direction import expand_node, nearby_root
from .slip_equations import expand, reach
from .slip_series import IMPULSE, VELOCITY, WORK, first_root, halley, point, seek, seek_near, works

NEAR = 1e-2
"""Relative distance to a jump of the impact map within which NEAR_JUMP is set."""

NO_FORCE = 2.0**-46
"""Where slip may turn into a direction without force, a force this small is rounding."""


@inlined
def turn_on(
    series, inverse, field, endless_slip, slip, turn, polynomial, rate, phase, law, goal, left, offset
):
    """Follow slip that turns, on one stretch on which its series converges and v₃ is monotone.

    Args:
        series, inverse: Scratch for the coefficients of the stretch and for 1/(a + k).
        field: μA/ω (3), b/ω (2), ω, 1/ω, μ, c, s and the stick ratio (2).
        endless_slip: Whether slip across the range of a singular A never stops.
        slip: Direction (2), speed and v₃ now.
        turn: p₀, the rate at which the direction turns.
        polynomial: p₁ … p₄, m₀ … m₃ and b∥, b⊥ in the present frame.
        rate: dv₃/dP₃ now.
        phase, law, goal, left: Of the restitution, as in `exact`.
        offset: v₃ at v_t = 0 where s = 0.

    Returns:
        the event (NEVER: none can come), whether a jump is near, x and the stretch, p₁ of the invariant
        direction, the first axis of the stretch (2), the coefficients of dv₃/dP₃ in t, and at the end ΔP₃,
        ΔP∥, ΔP⊥, v₃, the speed over the present one, and t.
    """
    f11, f12, f22, fb1, fb2, omega, per, mu, c, s, k1, k2 = field
    s1, s2, speed, v3 = slip
    t1, t2, t3, t4, m0, m1, m2, m3, bl, bp = polynomial
    event = NOTHING
    span = along = across = ratio = t = v3_end = 0.0
    jam0, jam1, jam2 = c - mu * bl, -2.0 * mu * bp, c + mu * bl
    scale = speed * per
    d1, d2, n1, x = s1, s2, 0.0, 0.0
    restoring = phase == RESTITUTION
    near_jump = node = expanded = event != NOTHING  # False, but no literal: see `codes`
    last, f = 0.0, (0.0,) * 12
    stretch = (node, series, inverse, f, scale, mu, c, bl, bp, v3, speed)

    # most often the next event is near: try for it at once
    kind, aim, guess = VELOCITY, goal if restoring else 0.0, 0.0
    bend = m0 - 0.5 * t1
    if law == POISSON and restoring:
        kind, aim = IMPULSE, left
        guess = halley(-left, scale, bend)
    elif law == ENERGETIC and restoring:
        kind, aim = WORK, left
        square = v3 * v3 + 2.0 * rate * left
        if square > 0.0:
            guess = halley(-2.0 * left / (v3 + math.sqrt(square)), scale, bend)
    elif rate > 0.0:
        guess = halley(v3 - aim, scale * rate, bend + 0.5 * turn * jam1 / jam0)
    if guess > 0.0 and guess * max(abs(turn), -t1) < 1.0:
        expanded = True
        last, f = expand(series, turn, t1, t2, t3, t4, m0, m1, m2, m3)
        stretch = (node, series, inverse, f, scale, mu, c, bl, bp, v3, speed)
        x = seek_near(stretch, kind, aim, guess, last)
        if x > 0.0:
            event = LAW_MET if restoring else STOPS

    if event == NOTHING:
        # go as far as the series converges and v₃ is monotone: into the invariant direction ahead ...
        root = nearby_root(turn, t1, t2, t3, t4)
        if root != 0.0:
            expanded = False
            node, e1, e2, n1, el, ep, f = expand_node(series, inverse, f11, f12, f22, fb1, fb2, s1, s2, root)
        if node and endless_slip and abs(f[3] * n1) <= NO_FORCE:
            f = f[:3] + (0.0,) + f[4:]  # noqa: RUF005 (numba)
        if node:
            t = first_root(jam0, jam1, jam2, root)
            if endless_slip and f[3] == 0.0 and abs(root - t) <= 1e-9 * abs(root):
                t = root  # dv₃/dP₃ tends to s
            peaks = t != root
            x = math.log(root * (1.0 + t * root) / (root - t)) if peaks else math.inf
            d1, d2, bl, bp = e1, e2, el * omega, ep * omega
            jam0, jam1, jam2 = c - mu * bl, -2.0 * mu * bp, c + mu * bl
        else:
            # ... or some way towards it
            if not expanded:
                last, f = expand(series, turn, t1, t2, t3, t4, m0, m1, m2, m3)
            whole = reach(last, f[0])
            x = first_root(jam0, jam1, jam2, f[0] * whole) / f[0]
            peaks = x < whole
        stretch = (node, series, inverse, f, scale, mu, c, bl, bp, v3, speed)
        endless = x == math.inf and f[3] <= 0.0
        if endless:
            span = math.inf
            if endless_slip and f[3] == 0.0:
                jam0 = s
            v3_end = math.inf if jam0 > 0.0 else -math.inf
            if jam0 == 0.0:
                v3_end = (k1 * d1 + k2 * d2) * speed * f[1] + offset
        else:
            span, along, across, dv3, ratio, t, _, _ = point(stretch, x)
            v3_end = v3 + dv3
            if x == math.inf and s == 0.0:
                v3_end = offset
        # what the velocity brings
        met = v3_end > goal or (v3_end == goal and x < math.inf)
        aim = goal if law == NEWTON and restoring and met else 0.0
        if restoring:
            if aim > 0.0:
                event = LAW_MET
            elif v3_end < 0.0:
                event = FALLS_BACK
            elif law == NEWTON and peaks and rate > 0.0 and goal - v3_end < NEAR * goal:
                near_jump = True
        elif v3_end > 0.0 or (v3_end == 0.0 and x < math.inf):
            event = STOPS
        if event != NOTHING:
            kind = VELOCITY
            x = seek(stretch, kind, aim, v3 - aim, v3_end - aim, x)
            endless = False
        # what the sum of impulse or work brings before that
        if restoring and law != NEWTON:
            kind, total = IMPULSE, math.inf
            if law == ENERGETIC:
                kind = WORK
                if not endless:
                    total, _ = works(stretch, x)
            elif not endless:
                total = span if event == NOTHING else point(stretch, x)[0]
            if total >= left:
                event = LAW_MET
                x = seek(stretch, kind, left, -left, total - left, x)
                endless = False
        if endless:
            event = NEVER

    if event != NOTHING and event != NEVER:
        span, along, across, dv3, ratio, t, _, _ = point(stretch, x)
        v3_end = v3 + dv3
    jam, end = (jam0, jam1, jam2), (span, along, across, v3_end, ratio, t)
    return event, near_jump, x, stretch, n1, d1, d2, jam, end
