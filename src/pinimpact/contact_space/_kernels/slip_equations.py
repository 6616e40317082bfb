"""Power series of slip in the half-angle of its direction. (theory.md, section 3)

In the axes (σ, σ⊥) of the present slip direction, t is the tangent of half the angle of slip, and
v_t = R (1 − t², 2t). With dt/ds = p(t)/2, dR/ds = m(t) R, dP₃/ds = R (1 + t²)² and polynomials p, m of
degrees four and three, all quantities are integrals of S = R p(0)/p(t), whose power series in x = 2t/p(0)
satisfies a recurrence of four terms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.jit import inlined
from .delassus import EPS

TERMS = 32
"""Largest number of terms of a series after the first."""

VANISHING = 2.0**-57
"""A series whose coefficients decay is truncated after consecutive terms of this relative size."""

RECIPROCAL = np.array([0.0] + [1.0 / k for k in range(1, 2 * TERMS)])


class Polynomials(NamedTuple):
    """Coefficients of p and m in the axes (σ, σ⊥), without p₀, which is `State.turn`. (3.6), (3.7)"""

    p1: float
    p2: float
    p3: float
    p4: float
    m0: float
    m1: float
    m2: float
    m3: float


class Shape(NamedTuple):
    """Constants of a series of turning slip; those with (4) are of one around an invariant direction.

    Attributes:
        h: t/x, or t/y (4).
        factor, unit: Factors of speed and impulse.
        exponent: a of (4.2).
        start, sign: y at x = 0 (4), and 1 for approach, −1 for departure: y is proportional to e^{−sign x}.
        q1, q2, q3, q4: Coefficients of p̂, or of π (4).
        w0, w1, w2, w3: Coefficients of w in (3.9), or of the factor of G in (4.3).
    """

    h: float
    factor: float
    unit: float
    exponent: float
    start: float
    sign: float
    q1: float
    q2: float
    q3: float
    w0: float
    w1: float
    w2: float
    q4: float
    w3: float


@inlined
def in_frame(a11, a12, a22, b1, b2, s1, s2):
    """Return A and b in the axes (σ, σ⊥): A∥, A×, A⊥, b∥, b⊥."""
    u1, u2 = a11 * s1 + a12 * s2, a12 * s1 + a22 * s2
    return (
        s1 * u1 + s2 * u2,
        s1 * u2 - s2 * u1,
        s1 * (a22 * s1 - a12 * s2) - s2 * (a12 * s1 - a11 * s2),
        s1 * b1 + s2 * b2,
        s1 * b2 - s2 * b1,
    )


@inlined
def polynomials(al, ax, ap, bl, bp):
    """Return the coefficients of (3.6), (3.7); `al`, `ax`, `ap` are those of μA."""
    return Polynomials(
        -2.0 * (bl + ap - al),
        6.0 * ax,
        -2.0 * (bl - ap + al),
        -bp - ax,
        bl - al,
        bp - 3.0 * ax,
        bl + al - 2.0 * ap,
        bp + ax,
    )


@inlined
def along_slip(weak, a11, a12, a22, b1, b2, s1, s2, al, ax, bl, bp, turn, doubt):
    """Return m₀ = σᵀ(b − μAσ), and the size of the terms that it is the sum of. (3.7), (6.4)

    Creep along a weak axis w of A, as of a nearly planar mechanism, makes b∥ − A∥ cancel; (6.4) does not.

    Args:
        weak: The weak axis, 1 or 2.
        a11 … b2: μA/ω and b/ω.
        s1, s2: σ.
        al, ax, bl, bp: A∥, A×, b∥ and b⊥.
        turn: p₀.
        doubt: Size of the terms that p₀ is the sum of; 0 if it is taken from the state.
    """
    rest, terms = b1 - (a11 * s1 + a12 * s2), abs(b1) + abs(a11 * s1) + abs(a12 * s2)
    part, turned, cross = s1, -turn * s2, s2
    if weak == 2:
        rest, terms = b2 - (a12 * s1 + a22 * s2), abs(b2) + abs(a12 * s1) + abs(a22 * s2)
        part, turned, cross = s2, turn * s1, s1
    terms += abs(turned) + abs(doubt * cross) + abs(bl - al)  # the last for the rounding of w·σ
    others = abs(bl) + abs(al) + 2.0 * abs(ax) + abs(bp)  # the last two for the rounding of σ
    if terms < abs(part) * others:
        return (rest - turned) / part, terms / abs(part)
    return bl - al, others


@inlined
def expand(coefficients, p0, polynomials, near):
    """Expand S(x)/S(0). (3.10), (3.11)

    Args:
        coefficients: (TERMS + 1,) is overwritten with the coefficients.
        p0, polynomials: p₀ and the `Polynomials`.
        near: The x at which the series is truncated as terms vanish; inf for all `TERMS`.

    Returns:
        The number of coefficients after the first, the size of the last ones, and the `Shape`.
    """
    p1, p2, p3, p4, m0, m1, m2, m3 = polynomials
    h = 0.5 * p0
    h2 = h * h
    q1, q2, q3, q4 = 0.5 * p1, 0.5 * p2 * h, 0.5 * p3 * h2, 0.5 * p4 * h2 * h
    w0, w1, w2, w3 = m0 - q1, (m1 - p2) * h, (m2 - 1.5 * p3) * h2, (m3 - 2.0 * p4) * h2 * h
    # factors of S_k, S_{k-1}, S_{k-2}, S_{k-3}, each decreasing by q with k
    c0, c1, c2, c3 = w0, w1 + q2, w2 + 2.0 * q3, w3 + 3.0 * q4
    s0, s1, s2, s3 = 1.0, 0.0, 0.0, 0.0
    coefficients[0] = 1.0
    count, last = TERMS, 0.0
    # other roots of p are so far that terms continue to decay after four that vanish
    far = near * (abs(q1) + near * (abs(q2) + near * (abs(q3) + near * abs(q4)))) <= 0.5
    vanishing = VANISHING if far else -1.0
    fourth, power = near * near * (near * near), 1.0
    for k in range(TERMS):
        share = RECIPROCAL[k + 1]
        new = (c0 * share) * s0 + ((c1 * share) * s1 + ((c2 * share) * s2 + (c3 * share) * s3))
        c0 -= q1
        c1 -= q2
        c2 -= q3
        c3 -= q4
        s3, s2, s1 = s2, s1, s0
        s0 = new
        coefficients[k + 1] = new
        if k & 3 == 3:
            power *= fourth
            last = max(max(abs(s0), abs(s1)), max(abs(s2), abs(s3)))
            if last * power <= vanishing:
                count = k + 1
                break
    return count, last, Shape(h, 1.0, 1.0, 0.0, 1.0, 1.0, q1, q2, q3, w0, w1, w2, q4, w3)


@inlined
def reach(last, shape):
    """Return the largest x: the last term is below rounding, |t| ≤ 1, and p̂ > 0. (3.11)"""
    end = 1.0 / abs(shape.h)
    if last > 0.0:
        end = min(end, math.exp(math.log(0.5 * EPS / last) * (1.0 / TERMS)))
    # S may be regular at the root of p to which slip converges, and converge beyond it
    while 1.0 + end * (shape.q1 + end * (shape.q2 + end * (shape.q3 + end * shape.q4))) <= 0.0:
        end *= 0.5
    return end


@inlined
def moments(coefficients, x):
    """Return S(x) and ∫₀ˣ S xʲ dx for j = 0 … 4."""
    power = 1.0
    value = n0 = n1 = n2 = n3 = n4 = 0.0
    for k in range(len(coefficients)):
        term = coefficients[k] * power
        power *= x
        value += term
        n0 += term * RECIPROCAL[k + 1]
        n1 += term * RECIPROCAL[k + 2]
        n2 += term * RECIPROCAL[k + 3]
        n3 += term * RECIPROCAL[k + 4]
        n4 += term * RECIPROCAL[k + 5]
    x2 = x * x
    return value, n0 * x, n1 * x2, n2 * x2 * x, n3 * x2 * x2, n4 * x2 * x2 * x
