"""Turning slip as one series, on which v₃ is monotone: its state at any x, its works, its events.

The series is one in x = 2t/p(0) (`slip_equations`), or one around the invariant direction ahead, with
x = L (`invariant_direction`); here the two are one thing. (theory.md, 3.3 and 4.2)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._numeric.jit import inlined, inner
from .codes import IMPULSE, VELOCITY, WORK
from .slip_equations import TERMS, Shape, moments, within_reach

SETTLED = 38.0
"""e^{−SETTLED} is below rounding."""

_GAUSS = np.polynomial.legendre.leggauss(12)
_ABSCISSAE = 0.5 * (_GAUSS[0] + 1.0)
_WEIGHTS = 0.5 * _GAUSS[1]


class SlipSeries(NamedTuple):
    """Slip that turns, from x = 0 on.

    Attributes:
        around_invariant: Which of the two series it is.
        coefficients: Its coefficients.
        reciprocals: 1/(a + k), for the series around an invariant direction.
        shape: Its constants.
        scale: The speed at x = 0 over ω.
        mu, c: Friction, and W₃₃.
        bl, bp: b∥ and b⊥ in its axes.
        v3, speed: At x = 0.
    """

    around_invariant: bool
    coefficients: NDArray[np.float64]
    reciprocals: NDArray[np.float64]
    shape: Shape
    scale: float
    mu: float
    c: float
    bl: float
    bp: float
    v3: float
    speed: float


@inner
def first_root(k0, k1, k2, end):
    """Return the first root of k₀ + k₁t + k₂t² strictly between 0 and `end`, or `end` itself."""
    square = k1 * k1 - 4.0 * k0 * k2
    if square < 0.0:
        return end
    q = -0.5 * (k1 + math.copysign(math.sqrt(square), k1))
    near = abs(end)
    # v₃ has an extremum there: one this close to the present point changes it by less than its rounding
    least = 1e-9 * near
    found = end
    if q != 0.0:
        t = k0 / q
        if t * end > 0.0 and least < abs(t) < near:
            found, near = t, abs(t)
    if k2 != 0.0:
        t = q / k2
        if t * end > 0.0 and least < abs(t) < near:
            found = t
    return found


@inner
def halley(f, slope, bend):
    """Return the step of Halley's iteration, or Newton's where the curvature forbids it."""
    step = -f / slope
    damp = 1.0 + 0.5 * bend * step
    return step / damp if damp > 0.5 else step


@inner
def settled(step, x, f, slope):
    """Whether a step of Halley's leaves rounding; next to an extremum it is short far from the root too."""
    return abs(step) <= 2e-6 * x and abs(f) <= 4e-6 * x * abs(slope)


@inner
def invariant_moments(coefficients, reciprocals, exponent, span):
    """Return y, yᵃG(y) and the integrals of yᵃ⁺ʲG over (0, L) for j = 0 … 4. (4.4)"""
    if span == math.inf:
        y, power, drop, part = 0.0, 0.0, 1.0, 1.0
    else:
        drop = -math.expm1(-span)
        part = -math.expm1(-exponent * span)
        y, power = 1.0 - drop, 1.0 - part
    rising = power
    # fill_k = (1 − y^{a+k})/(a+k); its numerator is summed without cancellation
    fill0 = part * reciprocals[0]
    part += rising * drop
    fill1 = part * reciprocals[1]
    rising *= y
    part += rising * drop
    fill2 = part * reciprocals[2]
    rising *= y
    part += rising * drop
    fill3 = part * reciprocals[3]
    value = n0 = n1 = n2 = n3 = n4 = 0.0
    for k in range(TERMS + 1):
        rising *= y
        part += rising * drop
        fill4 = part * reciprocals[k + 4]
        term = coefficients[k]
        value += term * power
        power *= y
        n0 += term * fill0
        n1 += term * fill1
        n2 += term * fill2
        n3 += term * fill3
        n4 += term * fill4
        fill0, fill1, fill2, fill3 = fill1, fill2, fill3, fill4
    if exponent < 0.5:
        # the one k at which a + k is close to zero was left out
        k = min(int(0.5 - exponent), TERMS + 4)
        if k > 0 and reciprocals[k] != 0.0:
            k -= 1
        z = exponent + k
        if reciprocals[k] == 0.0:
            fill0 = span if z == 0.0 else (1.0 / z if span == math.inf else -math.expm1(-z * span) / z)
            n0 += coefficients[k] * fill0 if k <= TERMS else 0.0
            n1 += coefficients[k - 1] * fill0 if 1 <= k <= TERMS + 1 else 0.0
            n2 += coefficients[k - 2] * fill0 if 2 <= k <= TERMS + 2 else 0.0
            n3 += coefficients[k - 3] * fill0 if 3 <= k <= TERMS + 3 else 0.0
            n4 += coefficients[k - 4] * fill0 if 4 <= k <= TERMS + 4 else 0.0
    return y, value, n0, n1, n2, n3, n4


@inlined
def point(series, x):
    """Return the state at x. (3.12), (4.5)

    Returns:
        ΔP₃, ΔP∥, ΔP⊥, Δv₃, the speed over that at x = 0, t, dP₃/dx and its logarithmic derivative.
    """
    around_invariant, coefficients, reciprocals, shape, scale, mu, c, bl, bp, _, _ = series
    h, factor, unit, exponent, q1, q2, q3, w0, w1, w2, q4, w3 = shape
    if around_invariant:
        y, value, n0, n1, n2, n3, n4 = invariant_moments(coefficients, reciprocals, exponent, x)
        t = h * y
        fall = 1.0 + y * (q1 + y * (q2 + y * q3))
        tt = t * t
        bend = -exponent - y * (w0 + y * (w1 + y * w2)) / fall - 4.0 * tt / (1.0 + tt)
    else:
        value, n0, n1, n2, n3, n4 = moments(coefficients, x)
        t = h * x
        tt = t * t
        fall = 1.0 + x * (q1 + x * (q2 + x * (q3 + x * q4)))
        bend = (w0 + x * (w1 + x * (w2 + x * w3))) / fall + 4.0 * h * t / (1.0 + tt)
    hh = h * h
    h4 = hh * hh
    unit *= scale
    chord = 1.0 + tt
    normal = unit * (n0 + 2.0 * hh * n2 + h4 * n4)
    along = -mu * unit * (n0 - h4 * n4)
    across = -2.0 * mu * unit * h * (n1 + hh * n3)
    dv3 = c * normal + bl * along + bp * across
    return normal, along, across, dv3, factor * value * fall * chord, t, unit * value * chord * chord, bend


@inlined
def works(series, x):
    """Integrate the normal work and the friction work over (0, x) by Gauss quadrature. (3.14)"""
    mu, v3, speed = series.mu, series.v3, series.speed
    exponent = series.shape.exponent
    normal_work = friction_work = 0.0
    low, end = 0.0, x
    if series.around_invariant:
        # from here on the direction is settled or nothing is left: the rest is straight
        end = min(x, SETTLED / max(1.0, exponent))
    while low < end:
        width = end - low
        if series.around_invariant:
            # the integrand is analytic down to x ≈ −1, and falls or grows like e^{−2ax}
            width = min(width, 1.25 * (low + 1.0), 5.0 / max(1e-3, abs(exponent)))
        for i in range(_ABSCISSAE.size):
            _, _, _, dv3, ratio, _, slope, _ = point(series, low + width * _ABSCISSAE[i])
            share = _WEIGHTS[i] * width * slope
            normal_work += share * (v3 + dv3)
            friction_work -= share * mu * speed * ratio
        low = low + width if low + width > low else end
    if end < x:
        here, there = point(series, end), point(series, x)
        span = there[0] - here[0]
        normal_work += span * (v3 + 0.5 * (here[3] + there[3]))
        friction_work -= 0.5 * mu * speed * span * (here[4] + there[4])
    return normal_work, friction_work


@inlined
def measure(series, counts, aim, x):
    """Return a quantity less its aim at x, its slope, and the logarithmic derivative of that."""
    mu, c, bl, bp, v3 = series.mu, series.c, series.bl, series.bp, series.v3
    normal, _, _, dv3, _, t, slope, bend = point(series, x)
    if counts == IMPULSE:
        return normal - aim, slope, bend
    chord = 1.0 + t * t
    rate = (c - mu * bl + t * (-2.0 * mu * bp + t * (c + mu * bl))) / chord
    if counts == WORK:
        now = v3 + dv3
        return works(series, x)[0] - aim, slope * now, bend + slope * rate / now
    turn = (-2.0 * mu * bp + 2.0 * t * (c + mu * bl - rate)) / chord
    return (
        (v3 - aim) + dv3,
        slope * rate,
        bend + (-t if series.around_invariant else series.shape.h) * turn / rate,
    )


@inner
def seek(series, counts, aim, f_low, f_high, high):
    """Find where a monotone quantity (velocity v₃, impulse ΔP₃ or normal work) meets `aim` in (0, high).

    Halley's iteration inside a bracket.

    Args:
        f_low, f_high: The quantity less its aim at 0 and at `high`; of opposite signs, or the second is zero.

    Returns:
        x.
    """
    if f_high == 0.0:
        return high
    low, top = 0.0, high
    x = 0.5
    if counts == WORK:
        # with v₃ taken as linear; it may rise from zero, and the root be smaller than `high` by any factor
        v3 = series.v3
        slope = point(series, 0.0)[6]
        rise = measure(series, VELOCITY, 0.0, 0.0)[1] / slope
        x = -2.0 * f_low / (slope * (v3 + math.sqrt(max(0.0, v3 * v3 - 2.0 * rise * f_low))))
        end = high if high < math.inf else 0.5
        if not (x < end):
            x = end
    elif math.isfinite(f_high) and high < math.inf:
        x = high * (f_low / (f_low - f_high))
    for _ in range(100):
        now, slope, bend = measure(series, counts, aim, x)
        if now == 0.0:
            return x
        if (now > 0.0) == (f_high > 0.0):
            top = x
        else:
            low = x
        step = halley(now, slope, bend)
        new = x + step
        if not (low < new < top):
            if top - low <= 2.0**-52 * top:
                return x
            new = 0.5 * (low + top) if top < math.inf else 2.0 * x + 1.0
        elif new > 2.0 * x + 2.0:
            new = 2.0 * x + 2.0
        elif settled(step, x, now, slope):
            return new
        x = new
    return x


@inner
def seek_near(series, counts, aim, x, last):
    """Try to find an event by Halley's iteration from the guess x, without a bracket.

    Returns:
        x, or 0 where the iteration leaves the reach of the series, or v₃ is not monotone up to x.
    """
    mu, c, bl, bp, v3, h = series.mu, series.c, series.bl, series.bp, series.v3, series.shape.h
    for _ in range(8):
        if not (x > 0.0 and within_reach(x, last, h)):
            return 0.0
        now, slope, bend = measure(series, counts, aim, x)
        step = halley(now, slope, bend)
        converged = settled(step, x, now, slope)
        x += step
        if converged:
            end = h * x
            monotone = first_root(c - mu * bl, -2.0 * mu * bp, c + mu * bl, end) == end
            falls = counts != VELOCITY and v3 + point(series, x)[3] < 0.0
            return x if monotone and not falls else 0.0
    return 0.0
