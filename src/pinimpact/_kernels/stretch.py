"""One stretch of turning slip, on which v₃ is monotone: its state at any x, its works, its events.

(theory.md, 3.3)
"""

from __future__ import annotations

import math

import numpy as np

from .jit import jit
from .slip import advance

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
def point(series, x, h, scale, mu, c, bl, bp):
    """Return S, t, ΔP₃, ΔP∥, ΔP⊥ and Δv₃ at x; `scale` is the speed at x = 0 over ω. (3.12)"""
    value, t, i0, i1, i2 = advance(series, x, h)
    normal, along, across = scale * i0, -mu * scale * i1, -mu * scale * i2
    return value, t, normal, along, across, c * normal + bl * along + bp * across


@jit
def works(series, x, h, scale, mu, c, bl, bp, v3, speed, q1, q2, q3, q4):
    """Integrate the normal work and the friction work over (0, x) by Gauss quadrature. (3.14)"""
    normal_work = friction_work = 0.0
    for i in range(_NODES.size):
        y = x * _NODES[i]
        value, t, _, _, _, dv3 = point(series, y, h, scale, mu, c, bl, bp)
        chord = 1.0 + t * t
        rate = _WEIGHTS[i] * scale * value * chord * chord
        normal_work += rate * (v3 + dv3)
        friction_work -= rate * mu * speed * value * chord * (1.0 + y * (q1 + y * (q2 + y * (q3 + y * q4))))
    return normal_work * x, friction_work * x


@jit
def seek(kind, goal, f_low, f_high, high, series, h, scale, mu, c, bl, bp, v3, speed, q, w):
    """Find where a monotone quantity (velocity v₃, impulse ΔP₃ or normal work) meets `goal` in (0, high).

    Halley's iteration inside a bracket; the work, whose curvature costs as much as itself, takes Newton's.

    Args:
        f_low, f_high: The quantity less its goal at 0 and at `high`; of opposite signs.
        q, w: The coefficients of p/p(0) and of the logarithmic derivative of S. (3.9)

    Returns:
        x.
    """
    q1, q2, q3, q4 = q
    w0, w1, w2, w3 = w
    low, top = 0.0, high
    x = high if kind == WORK else high * (f_low / (f_low - f_high))
    k0, k1, k2 = c - mu * bl, -2.0 * mu * bp, c + mu * bl
    for _ in range(60):
        value, t, normal, _, _, dv3 = point(series, x, h, scale, mu, c, bl, bp)
        chord = 1.0 + t * t
        slope = scale * value * chord
        bend = (w0 + x * (w1 + x * (w2 + x * w3))) / (1.0 + x * (q1 + x * (q2 + x * (q3 + x * q4))))
        if kind == VELOCITY:
            rate = k0 + t * (k1 + t * k2)
            f = (v3 - goal) + dv3
            slope *= rate
            bend += h * (2.0 * t / chord + (k1 + 2.0 * t * k2) / rate)
        elif kind == IMPULSE:
            f = normal - goal
            slope *= chord
            bend += h * 4.0 * t / chord
        else:
            work, _ = works(series, x, h, scale, mu, c, bl, bp, v3, speed, q1, q2, q3, q4)
            f = work - goal
            slope *= chord * (v3 + dv3)
            bend = 0.0
        if f == 0.0:
            return x
        if (f > 0.0) == (f_high > 0.0):
            top = x
        else:
            low = x
        step = -f / slope
        halley = 1.0 + 0.5 * bend * step
        if halley > 0.5:
            step /= halley
        new = x + step
        if not (low < new < top):
            if top - low <= 2.0**-52 * top:
                return x
            new = 0.5 * (low + top)
        elif abs(step) <= 2e-6 * x and (kind != WORK or abs(step) <= 1e-9 * x):
            return new
        x = new
    return x
