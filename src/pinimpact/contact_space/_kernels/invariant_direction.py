"""Series of slip that approaches an invariant direction or departs from one. (theory.md, section 4)

Around a root of p the speed is a power of the angle to it times an analytic function, R ∝ yᵃ H(y). One
convergent series describes the whole approach, to v_t = 0 (a > 0) or to infinite speed (a < 0), and the
departure from any angle, so no threshold of a small speed is needed.
"""

from __future__ import annotations

import math

from ..._compile.jit import inlined
from ..._numeric.tolerances import TINY
from .delassus import EPS
from .slip_equations import RECIPROCAL, TERMS, VANISHING, Shape, along_slip, in_frame, polynomials
from .tolerances import ROOT

NEARBY = 0.3
"""Largest influence of the other roots of p for a series around one. (4.1)"""

LEFT_TO = 0.5
"""Largest influence of the other roots in a series of a departure, which starts within a fifth of that."""


@inlined
def nearby_root(p0, polynomials):
    """Return the root of p that slip approaches or departs from, if it is simple and close, else 0. (4.1)"""
    p1, p2, p3, p4, _, _, _, _ = polynomials
    if p1 == 0.0:
        return 0.0
    t = -p0 / p1
    at = abs(t)
    bound, widest = (-NEARBY * p1, 0.5) if p1 < 0.0 else (0.2 * LEFT_TO * p1, 0.25)
    if not (at * (abs(p2) + at * (abs(p3) + at * abs(p4))) < bound and at < widest):
        return 0.0
    for _ in range(8):
        value = p0 + t * (p1 + t * (p2 + t * (p3 + t * p4)))
        slope = p1 + t * (2.0 * p2 + t * (3.0 * p3 + t * 4.0 * p4))
        step = value / slope
        t -= step
        if abs(step) <= ROOT * abs(t):
            return t if t * p0 * p1 < 0.0 else 0.0
    return 0.0


@inlined
def expand_around_root(coefficients, reciprocals, weak, a11, a12, a22, b1, b2, s1, s2, root, leaving):
    """Expand G(y) = H/π of (4.3) around an invariant direction.

    Args:
        coefficients: (TERMS + 1,) is overwritten with the coefficients of G.
        reciprocals: (TERMS + 5,) is overwritten with 1/(a + k), or 0 for |a + k| < 1/2.
        weak, a11 … b2: As for `along_slip`.
        s1, s2: The present slip direction.
        root: Half-angle tangent from there to the invariant direction.
        leaving: Whether slip departs from the invariant direction.

    Returns:
        Whether the series converges up to the present direction; the number of coefficients after the first;
        the y up to which it converges; the invariant direction (2); p₁, b∥/ω and b⊥/ω there; the size of the
        terms of m₀; and the `Shape`.
    """
    scale = 1.0 / (1.0 + root * root)
    cos, sin = (1.0 - root * root) * scale, 2.0 * root * scale
    d1, d2 = s1 * cos - s2 * sin, s2 * cos + s1 * sin
    al, ax, ap, bl, bp = in_frame(a11, a12, a22, b1, b2, d1, d2)
    p1, p2, p3, p4, m0, m1, m2, m3 = polynomials(al, ax, ap, bl, bp)
    terms = 1.0
    if weak > 0:
        m0, terms = along_slip(weak, a11, a12, a22, b1, b2, d1, d2, al, ax, bl, bp, 0.0, 0.0)
    t, start, sign = -root, 1.0, 1.0
    good = p1 < 0.0
    if leaving:
        others = abs(p2) + 0.5 * abs(p3) + 0.25 * abs(p4)
        far = 0.5 if 0.5 * others <= LEFT_TO * p1 else LEFT_TO * p1 / others
        t = math.copysign(far, t)
        start, sign = -root / t, -1.0
        good = p1 > 0.0
    inv = 1.0 / p1
    exponent = 2.0 * m0 * inv
    q1, q2, q3 = p2 * inv * t, p3 * inv * t * t, p4 * inv * t * t * t
    two = 2.0 * inv * t
    w0 = two * (m1 - m0 * p2 * inv) - q1
    w1 = two * t * (m2 - m0 * p3 * inv) - 2.0 * q2
    w2 = two * t * t * (m3 - m0 * p4 * inv) - 3.0 * q3
    c0, c1, c2 = w0, w1 + q2, w2 + 2.0 * q3
    g0, g1, g2 = 1.0, 0.0, 0.0
    total, here, power = 1.0, 1.0, 1.0
    coefficients[0] = 1.0
    count, last = TERMS, 0.0
    for k in range(TERMS):
        share = RECIPROCAL[k + 1]
        new = (c0 * share) * g0 + ((c1 * share) * g1 + (c2 * share) * g2)
        if abs(new) < TINY:
            new = 0.0
        c0 -= q1
        c1 -= q2
        c2 -= q3
        g2, g1, g0 = g1, g0, new
        coefficients[k + 1] = new
        total += new
        power *= start
        here += new * power
        last = abs(g0) + abs(g1) + abs(g2)
        if last <= VANISHING * min(here, total):  # the next ones are smaller, by (4.1)
            count = k + 1
            break
    most = 1.0
    if leaving and last > EPS * here:
        most = math.exp(math.log(EPS * here / last) * (1.0 / TERMS))
    good = good and total < math.inf and (start < 0.75 * most if leaving else last <= EPS * total)
    if good:
        for k in range(count + 5):
            z = exponent + k
            reciprocals[k] = 1.0 / z if abs(z) >= 0.5 else 0.0
    # 1/(H(1 + t²)) at x = 0
    speed = 1.0 / (here * (1.0 + start * (q1 + start * (q2 + start * q3))) * (1.0 + root * root))
    shape = Shape(t, speed, -2.0 * inv * speed, exponent, start, sign, q1, q2, q3, w0, w1, w2, 0.0, 0.0)
    return good, count, most, d1, d2, p1, bl, bp, terms, shape
