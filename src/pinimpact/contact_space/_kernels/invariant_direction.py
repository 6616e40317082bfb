"""Slip that converges to an invariant direction, as one series around that direction. (theory.md, section 4)

Around the root of p the speed is a power of the remaining angle times an analytic function,
R ∝ yᵃ H(y) with y = t/t₀ = e^{−L}. All that is left of the slip, down to v_t = 0 (a > 0) or out to
infinity (a < 0), is one convergent series: there is no speed at which "small" would begin.
"""

from __future__ import annotations

import math

from ..._numeric.jit import inner
from .delassus import EPS
from .slip_equations import RECIPROCAL, TERMS, Shape, along_slip, in_frame, polynomials


@inner
def nearby_root(p0, polynomials):
    """Return the root of p that slip converges to, if it is simple, stable and close, else 0. (4.1)"""
    p1, p2, p3, p4, _, _, _, _ = polynomials
    if p1 >= 0.0:
        return 0.0
    t = -p0 / p1
    at = abs(t)
    if not (at * (abs(p2) + at * (abs(p3) + at * abs(p4))) < -0.3 * p1 and at < 0.5):
        return 0.0
    for _ in range(8):
        value = p0 + t * (p1 + t * (p2 + t * (p3 + t * p4)))
        slope = p1 + t * (2.0 * p2 + t * (3.0 * p3 + t * 4.0 * p4))
        step = value / slope
        t -= step
        if abs(step) <= 1e-9 * abs(t):
            return t if t * p0 > 0.0 else 0.0
    return 0.0


@inner
def expand_around_root(coefficients, reciprocals, weak, a11, a12, a22, b1, b2, s1, s2, root):
    """Expand around the invariant direction at half-angle tangent `root` from the direction (s1, s2).

    Args:
        coefficients: Receives the coefficients of G(y) = H/π. (4.3)
        reciprocals: Receives 1/(a + k), and 0 where that is close to a pole.
        weak, a11 … b2: As in `along_slip`.

    Returns:
        whether the series converges up to the present direction; the invariant direction (2);
        p₁ and b∥/ω, b⊥/ω there; the size of the terms of m₀; and the `Shape`.
    """
    scale = 1.0 / (1.0 + root * root)
    cos, sin = (1.0 - root * root) * scale, 2.0 * root * scale
    d1, d2 = s1 * cos - s2 * sin, s2 * cos + s1 * sin
    al, ax, ap, bl, bp = in_frame(a11, a12, a22, b1, b2, d1, d2)
    p1, p2, p3, p4, m0, m1, m2, m3 = polynomials(al, ax, ap, bl, bp)
    terms = 1.0
    if weak > 0:
        m0, terms = along_slip(weak, a11, a12, a22, b1, b2, d1, d2, al, bl, 0.0, 0.0)
    t = -root
    inv = 1.0 / p1
    exponent = 2.0 * m0 * inv
    q1, q2, q3 = p2 * inv * t, p3 * inv * t * t, p4 * inv * t * t * t
    two = 2.0 * inv * t
    w0 = two * (m1 - m0 * p2 * inv) - q1
    w1 = two * t * (m2 - m0 * p3 * inv) - 2.0 * q2
    w2 = two * t * t * (m3 - m0 * p4 * inv) - 3.0 * q3
    c0, c1, c2 = w0, w1 + q2, w2 + 2.0 * q3
    g0, g1, g2 = 1.0, 0.0, 0.0
    total = 1.0
    coefficients[0] = 1.0
    for k in range(TERMS):
        share = RECIPROCAL[k + 1]
        rest = (c1 * g1 + c2 * g2) * share
        new = (c0 * share) * g0 + rest
        c0 -= q1
        c1 -= q2
        c2 -= q3
        g2, g1, g0 = g1, g0, new
        coefficients[k + 1] = new
        total += new
    good = p1 < 0.0 and total < math.inf and abs(g0) + abs(g1) + abs(g2) <= EPS * total
    if good:
        for k in range(TERMS + 5):
            z = exponent + k
            reciprocals[k] = 1.0 / z if abs(z) >= 0.5 else 0.0
    speed = 1.0 / (total * (1.0 + q1 + q2 + q3) * (1.0 + t * t))
    return (
        good,
        d1,
        d2,
        p1,
        bl,
        bp,
        terms,
        Shape(t, speed, -2.0 * inv * speed, exponent, q1, q2, q3, w0, w1, w2, 0.0, 0.0),
    )
