"""The approach to v_t = 0, where the direction of slip settles on an invariant one. (theory.md, section 4)

Around the root of p the speed is a power times an analytic function, R ∝ tᵃ H(t), so the impulse left
until v_t = 0 is a convergent series: no speed at which "small" begins.
"""

from __future__ import annotations

from .delassus import EPS
from .jit import jit
from .slip import RECIPROCAL, TERMS, in_frame, polynomials


@jit
def nearby_root(p0, p1, p2, p3, p4):
    """Return the root of p that slip converges to if it is simple, stable and close, else 0. (4.1)"""
    if p1 >= 0.0:
        return 0.0
    t = -p0 / p1
    at = abs(t)
    if not (at * (abs(p2) + at * (abs(p3) + at * abs(p4))) < -0.3 * p1 and at < 0.4):
        return 0.0
    for _ in range(8):
        value = p0 + t * (p1 + t * (p2 + t * (p3 + t * p4)))
        slope = p1 + t * (2.0 * p2 + t * (3.0 * p3 + t * 4.0 * p4))
        step = value / slope
        t -= step
        if abs(step) <= 1e-9 * abs(t):
            break
    return t if t * p0 > 0.0 else 0.0


@jit
def close(series, a11, a12, a22, b1, b2, s1, s2, root):
    """Integrate from direction (s1, s2) to v_t = 0 along the invariant direction at half-angle tangent `root`.

    A and b as in `slip`. `series` is overwritten.

    Returns:
        whether the series has converged, the invariant direction (2), and per unit of
        the present speed the integrals of (1+t²)², 1−t⁴ and 2t(1+t²) in its axes. (4.4)
    """
    scale = 1.0 / (1.0 + root * root)
    cos, sin = (1.0 - root * root) * scale, 2.0 * root * scale
    d1, d2 = s1 * cos - s2 * sin, s2 * cos + s1 * sin
    al, ax, ap, bl, bp = in_frame(a11, a12, a22, b1, b2, d1, d2)
    p1, p2, p3, p4, m0, m1, m2, m3 = polynomials(al, ax, ap, bl, bp)
    if not (p1 < 0.0 and m0 < 0.0):
        return False, d1, d2, 0.0, 0.0, 0.0
    t = -root
    inv = 1.0 / p1
    exponent = 2.0 * m0 * inv
    q1, q2, q3 = p2 * inv * t, p3 * inv * t * t, p4 * inv * t * t * t
    two = 2.0 * inv * t
    c0 = two * (m1 - m0 * p2 * inv) - q1
    c1 = two * t * (m2 - m0 * p3 * inv) - q2
    c2 = two * t * t * (m3 - m0 * p4 * inv) - q3
    g0, g1, g2 = 1.0, 0.0, 0.0
    total = 1.0
    series[0] = 1.0
    for k in range(TERMS):
        new = (c0 * g0 + c1 * g1 + c2 * g2) * RECIPROCAL[k + 1]
        c0 -= q1
        c1 -= q2
        c2 -= q3
        g2, g1, g0 = g1, g0, new
        series[k + 1] = new
        total += new
    if not (abs(g0) + abs(g1) + abs(g2) <= EPS * total):
        return False, d1, d2, 0.0, 0.0, 0.0
    n0 = n1 = n2 = n3 = n4 = 0.0
    w0, w1, w2, w3 = 1.0 / exponent, 1.0 / (exponent + 1), 1.0 / (exponent + 2), 1.0 / (exponent + 3)
    for k in range(TERMS + 1):
        w4 = 1.0 / (exponent + (k + 4))
        term = series[k]
        n0 += term * w0
        n1 += term * w1
        n2 += term * w2
        n3 += term * w3
        n4 += term * w4
        w0, w1, w2, w3 = w1, w2, w3, w4
    t2 = t * t
    t4 = t2 * t2
    # R(t)/R(0) = G(t) π(t) y^a with G the series; r = R (1 + t²) at the start
    factor = -2.0 * inv / (total * (1.0 + q1 + q2 + q3) * (1.0 + t2))
    return (
        True,
        d1,
        d2,
        factor * (n0 + 2.0 * t2 * n2 + t4 * n4),
        factor * (n0 - t4 * n4),
        factor * 2.0 * t * (n1 + t2 * n3),
    )
