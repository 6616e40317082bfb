"""One stretch of turning slip, on which v₃ is monotone: its state at any x, its works, its events.

A stretch is a power series in x = 2t/p(0) (slip.py), or one around the invariant direction ahead, with
x = L (node.py); here the two are one thing. (theory.md, 3.3 and 4.2)
"""

from __future__ import annotations

import math

import numpy as np

from .jit import jit
from .slip import TERMS, moments, within_reach

VELOCITY, IMPULSE, WORK = 0, 1, 2

_GAUSS = np.polynomial.legendre.leggauss(12)
_NODES = 0.5 * (_GAUSS[0] + 1.0)
_WEIGHTS = 0.5 * _GAUSS[1]


@jit
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


@jit
def halley(f, slope, bend):
    """Return the step of Halley's iteration, or Newton's where the curvature forbids it."""
    step = -f / slope
    damp = 1.0 + 0.5 * bend * step
    return step / damp if damp > 0.5 else step


@jit
def node_moments(series, inverse, exponent, span):
    """Return yᵃ, y, yᵃG(y) and the integrals of yᵃ⁺ʲG over (0, L) for j = 0 … 4. (4.4)"""
    if span == math.inf:
        y, power, drop, part = 0.0, 0.0, 1.0, 1.0
    else:
        drop = -math.expm1(-span)
        part = -math.expm1(-exponent * span)
        y, power = 1.0 - drop, 1.0 - part
    start = rising = power
    # fill_k = (1 − y^{a+k})/(a+k); its numerator is summed without cancellation
    fill0 = part * inverse[0]
    part += rising * drop
    fill1 = part * inverse[1]
    rising *= y
    part += rising * drop
    fill2 = part * inverse[2]
    rising *= y
    part += rising * drop
    fill3 = part * inverse[3]
    value = n0 = n1 = n2 = n3 = n4 = 0.0
    for k in range(TERMS + 1):
        rising *= y
        part += rising * drop
        fill4 = part * inverse[k + 4]
        term = series[k]
        value += term * power
        power *= y
        n0 += term * fill0
        n1 += term * fill1
        n2 += term * fill2
        n3 += term * fill3
        n4 += term * fill4
        fill0, fill1, fill2, fill3 = fill1, fill2, fill3, fill4
    if exponent <= 0.5:
        # the one k at which a + k is close to zero was left out
        k = int(0.5 - exponent)
        z = exponent + k
        if abs(z) <= 0.5:
            fill0 = span if z == 0.0 else (1.0 / z if span == math.inf else -math.expm1(-z * span) / z)
            n0 += series[k] * fill0 if k <= TERMS else 0.0
            n1 += series[k - 1] * fill0 if 1 <= k <= TERMS + 1 else 0.0
            n2 += series[k - 2] * fill0 if 2 <= k <= TERMS + 2 else 0.0
            n3 += series[k - 3] * fill0 if 3 <= k <= TERMS + 3 else 0.0
            n4 += series[k - 4] * fill0 if 4 <= k <= TERMS + 4 else 0.0
    return start, y, value, n0, n1, n2, n3, n4


@jit
def point(node, series, inverse, x, f, scale, mu, c, bl, bp):
    """Return the state at x. (3.12), (4.5)

    Args:
        node: Which of the two series it is.
        f: Its constants, as `slip_constants` or `expand_node` gives them.
        scale: Speed at x = 0 over ω.

    Returns:
        ΔP₃, ΔP∥, ΔP⊥, Δv₃, the speed over that at x = 0, t, dP₃/dx and its logarithmic derivative.
    """
    h, factor, unit, exponent, q1, q2, q3, w0, w1, w2, q4, w3 = f
    if node:
        power, y, value, n0, n1, n2, n3, n4 = node_moments(series, inverse, exponent, x)
        t = h * y
        fall = 1.0 + y * (q1 + y * (q2 + y * q3))
        tt = t * t
        bend = -exponent - y * (w0 + y * (w1 + y * w2)) / fall - 4.0 * tt / (1.0 + tt)
    else:
        value, n0, n1, n2, n3, n4 = moments(series, x)
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
    return (
        normal,
        along,
        across,
        c * normal + bl * along + bp * across,
        factor * value * fall * chord,
        t,
        unit * value * chord * chord,
        bend,
    )


@jit
def works(node, series, inverse, x, f, scale, mu, c, bl, bp, v3, speed):
    """Integrate the normal work and the friction work over (0, x) by Gauss quadrature. (3.14)"""
    normal_work = friction_work = 0.0
    panels, end = 1, x
    if node:
        # beyond this the direction is settled and the rest is straight
        end = min(x, 38.0)
        panels = 1 + int(end * max(1.0, 0.5 * abs(f[3])))
    width = end / panels
    for j in range(panels):
        for i in range(_NODES.size):
            normal, along, across, dv3, ratio, t, slope, _ = point(
                node, series, inverse, (j + _NODES[i]) * width, f, scale, mu, c, bl, bp
            )
            rate = _WEIGHTS[i] * width * slope
            normal_work += rate * (v3 + dv3)
            friction_work -= rate * mu * speed * ratio
    if end < x:
        a = point(node, series, inverse, end, f, scale, mu, c, bl, bp)
        b = point(node, series, inverse, x, f, scale, mu, c, bl, bp)
        normal_work += (b[0] - a[0]) * (v3 + 0.5 * (a[3] + b[3]))
        friction_work -= 0.5 * mu * speed * (b[0] - a[0]) * (a[4] + b[4])
    return normal_work, friction_work


@jit
def seek(kind, goal, f_low, f_high, high, node, series, inverse, f, scale, mu, c, bl, bp, v3, speed):
    """Find where a monotone quantity (velocity v₃, impulse ΔP₃ or normal work) meets `goal` in (0, high).

    Halley's iteration inside a bracket; the work, whose curvature costs as much as itself, takes Newton's.

    Args:
        f_low, f_high: The quantity less its goal at 0 and at `high`; of opposite signs.

    Returns:
        x.
    """
    low, top = 0.0, high
    if math.isfinite(f_high) and high < math.inf:
        x = high if kind == WORK else high * (f_low / (f_low - f_high))
    else:
        x = 0.5
    k0, k1, k2 = c - mu * bl, -2.0 * mu * bp, c + mu * bl
    for _ in range(100):
        normal, _, _, dv3, _, t, slope, bend = point(node, series, inverse, x, f, scale, mu, c, bl, bp)
        if kind == VELOCITY:
            chord = 1.0 + t * t
            rate = (k0 + t * (k1 + t * k2)) / chord
            turn = -t if node else f[0]
            now = (v3 - goal) + dv3
            bend += turn * ((k1 + 2.0 * t * k2) / chord - 2.0 * t * rate / chord) / rate
            slope *= rate
        elif kind == IMPULSE:
            now = normal - goal
        else:
            work, _ = works(node, series, inverse, x, f, scale, mu, c, bl, bp, v3, speed)
            now = work - goal
            slope *= v3 + dv3
            bend = 0.0
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
        elif abs(step) <= 2e-6 * x and (kind != WORK or abs(step) <= 1e-9 * x):
            return new
        x = new
    return x


@jit
def seek_near(kind, goal, x, last, series, inverse, f, scale, mu, c, bl, bp, v3):
    """Try to find an event by Halley's iteration from the guess x, without a bracket.

    Returns:
        x, or 0 where the iteration leaves the reach of the series, or v₃ is not monotone up to x.
    """
    k0, k1, k2 = c - mu * bl, -2.0 * mu * bp, c + mu * bl
    for _ in range(8):
        if not (x > 0.0 and within_reach(x, last, f[0])):
            return 0.0
        normal, _, _, dv3, _, t, slope, bend = point(False, series, inverse, x, f, scale, mu, c, bl, bp)
        now = normal - goal
        if kind == VELOCITY:
            chord = 1.0 + t * t
            rate = (k0 + t * (k1 + t * k2)) / chord
            now = (v3 - goal) + dv3
            bend += f[0] * ((k1 + 2.0 * t * k2) / chord - 2.0 * t * rate / chord) / rate
            slope *= rate
        step = halley(now, slope, bend)
        x += step
        if abs(step) <= 2e-6 * x:
            return x if first_root(k0, k1, k2, f[0] * x) == f[0] * x else 0.0
    return 0.0
