"""Derivatives of slip along a move, by panels or in closed form. (derivatives.md, 2 and 3)"""

from __future__ import annotations

import math

from ..._compile.jit import always_inlined, inlined
from .invariant_direction import LEFT_TO
from .sensitivities import PATH, STOP, VT1, arrive, clear_rows, combine
from .slip_panels import HALF_ANGLE, INVARIANT, STRAIGHT, Slip, cross_panel, frame_polynomials
from .tolerances import TAIL

EFOLDS = 4.0
"""Largest change of ln r or ln g on a panel: r²/g changes by e¹², which twelve nodes integrate."""

NEAREST = 1.6
"""Largest length of a panel in L, over the distance of the next invariant direction."""


@inlined
def _integral(z, time):
    """Return ∫e^{zτ} dτ."""
    return math.expm1(z * time) / z if z != 0.0 else time


@inlined
def _nested(x, z, time):
    """Return ∫e^{xτ} (∫e^{zτ} dτ) dτ, by the formula with less cancellation."""
    grown, both = math.exp(x * time), _integral(x + z, time)
    if grown == 0.0 or abs(x) > abs(z):
        return ((grown * _integral(z, time) if grown > 0.0 else 0.0) - both) / x
    return (both - _integral(x, time)) / z


@inlined
def _cross_straight(units, slip, around, time, mu, k1, k2, values):
    """Propagate the sensitivities along straight slip over many e-folds, or to v_t = 0. (D11), (D33)

    Args:
        units, slip: The `Units`, and the `Slip` at the start.
        around: Accurate `Polynomials` of the direction of slip.
        time: τ; inf for slip to v_t = 0.
        mu, k1, k2: μ, and k of (1.4).
        values: Rows of sensitivities; are overwritten.

    Returns:
        The `Slip` at the end, and its impulse.
    """
    s1, s2, speed, turn = slip
    here, n0, _, _, _ = frame_polynomials(units, s1, s2, turn)
    p = around if time < math.inf else here
    f, rho, bend = p.m0, 0.5 * p.p1, 0.5 * n0
    grown, whole = math.exp(f * time), _integral(f, time)
    span, kl, kp = speed * whole, k1 * s1 + k2 * s2, speed * (k2 * s1 - k1 * s2)
    leaned = late = 0.0
    if bend != 0.0:  # f + g′ = −μA⊥ and f′ = −μA× vanish together where A is singular
        leaned, late = bend * _integral(f + rho, time), bend * _nested(f, rho, time)
    once, squared = _nested(f, f + rho, time), _nested(2.0 * f, rho, time)
    if grown == 0.0 or abs(f) > abs(rho):
        twice = (grown * late - bend * squared) / f
    else:
        twice = bend * (once - 0.5 * whole * whole) / rho
    path = speed * kl * bend * once + kp * _integral(2.0 * f + rho, time)
    across = speed * (speed * kl * twice + kp * squared)
    late *= speed
    half = 0.5 * kl * span * span
    if grown == 0.0:
        # row VT1 becomes that of P*; a shift along F shifts P* exactly, even if slip still turns (D5)
        x = -(1.0 - leaned * turn / f) / f, 0.0, kl * span
        y, along, aside = (-leaned / f, 0.0, path), (-span / f, 0.0, half), (-late / f, 0.0, across)
    else:
        kept, fresh = math.exp((f + rho) * time), speed * grown * _integral(rho, time)
        x, y = (s1, s2, kl * span), (leaned * s1 - kept * s2, leaned * s2 + kept * s1, path)
        along = span * s1, span * s2, half
        aside = late * s1 - fresh * s2, late * s2 + fresh * s1, across
    arrive(values, s1, s2, units.per, mu, x, y, (along, aside, along, aside, along))
    if grown == 0.0:
        combine(values, STOP, units.per, VT1, 0.0, VT1)
        clear_rows(values, PATH)
        return Slip(s1, s2, 0.0, 0.0), span
    return Slip(s1, s2, speed * grown, turn * math.exp(rho * time)), span


@inlined
def _next_panel(around, root, left):
    """Return the length of the next panel around an invariant direction, and the size of the remaining turn.

    Args:
        around: `Polynomials` of the invariant direction.
        root: Half-angle tangent to it.
        left: Remaining L.
    """
    at = abs(root)
    others = at * (abs(around.p2) + at * (abs(around.p3) + at * abs(around.p4))) / abs(around.p1)
    size = EFOLDS / max(1.0, abs(2.0 * around.m0 / around.p1))
    far = -math.log(min(others, LEFT_TO)) if others > 0.0 else math.inf
    size = min(size, NEAREST * far if left > 0.0 else far / NEAREST)
    return math.copysign(min(size, abs(left)), left), at + others


@inlined
def _turn_to(units, slip, root):
    """Return p₀ computed from the root of p; an error of their ratio would grow like 1/p."""
    p, _, _, _, _ = frame_polynomials(units, slip.s1, slip.s2, slip.turn)
    return -root * (p.p1 + root * (p.p2 + root * (p.p3 + root * p.p4)))


@always_inlined
def cross_move(units, slip, length, root, span, fast, mu, k1, k2, works, values):
    """Propagate the sensitivities through a `Move` of slip; return ∫∫σ dP₃ dP₃ (2) over it.

    Args:
        length, root: Of the `Move`.
        span: Its normal impulse times ω.
        fast: The slip speed at its end.
        units, slip, mu, k1, k2, works, values: As for `cross_panel`.
    """
    i1 = i2 = m1 = m2 = left = size = 0.0
    kind, first = int(STRAIGHT), slip.speed  # int(): numba 0.61 cannot unify its literals
    p, _, _, _, _ = frame_polynomials(units, slip.s1, slip.s2, slip.turn)
    if root != 0.0:
        kind, left = int(INVARIANT), length
        scale = 1.0 / (1.0 + root * root)
        c, s = (1.0 - root * root) * scale, 2.0 * root * scale
        p, _, _, _, _ = frame_polynomials(
            units, slip.s1 * c - slip.s2 * s, slip.s2 * c + slip.s1 * s, slip.turn
        )
    elif length != 0.0:
        kind, left, size = int(HALF_ANGLE), length, length
    elif fast > 0.0:
        gained = p.m0 * span / slip.speed
        left = math.log1p(gained) if gained > -0.5 else math.log(fast / slip.speed)
        left = left / p.m0 if p.m0 != 0.0 else span / slip.speed
        steepest = max(abs(p.m0), 0.5 * abs(p.p1))
        size = EFOLDS / steepest if steepest > 0.0 else left
    rho = 0.5 * p.p1
    while abs(left) > 0.0:
        step, whole, form = min(size, left), 0.0, kind
        closed = kind == STRAIGHT and abs(rho) * left > EFOLDS
        part = step = left if closed else step
        if kind == INVARIANT:
            step, turning = _next_panel(p, root, left)
            slip = Slip(slip.s1, slip.s2, slip.speed, _turn_to(units, slip, root))
            if 2.0 * turning * (slip.speed if left == math.inf else first) <= TAIL * first:
                if left == math.inf:
                    break
                rest = left if left > 0.0 else max(left, math.log(turning / TAIL))
                closed = abs(rest) > EFOLDS
                step = rest if closed else math.copysign(min(abs(step), abs(rest)), left)
                form, part = int(STRAIGHT), -step / rho
            else:
                z = math.exp(-step)
                # L in the axes of the panel
                whole, part = root, step + math.log1p(root * root * z) - math.log1p(root * root)
            root *= math.exp(-step)
        left -= step
        if closed:
            slip, gained = _cross_straight(units, slip, p, part, mu, k1, k2, values)
            j1, j2 = gained * slip.s1, gained * slip.s2
            n1, n2 = 0.5 * gained * j1, 0.5 * gained * j2
        else:
            slip, gained, j1, j2, n1, n2 = cross_panel(
                units, slip, form, part, whole, mu, k1, k2, works, values
            )
        m1, m2 = m1 + gained * i1 + n1, m2 + gained * i2 + n2
        i1, i2 = i1 + j1, i2 + j2
    if fast == 0.0:
        slip, gained = _cross_straight(units, slip, p, math.inf, mu, k1, k2, values)
        m1 += gained * (i1 + 0.5 * gained * slip.s1)
        m2 += gained * (i2 + 0.5 * gained * slip.s2)
    return m1, m2
