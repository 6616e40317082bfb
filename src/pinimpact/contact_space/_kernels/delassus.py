"""Rank and null space of the Delassus matrix W = [[A, b], [bᵀ, c]], and its Schur complement in stick.

(theory.md, section 6)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.jit import inlined

EPS = 2.0**-52
ZERO = 32.0 * EPS
"""Eigenvalues of W within ZERO ‖W‖ of zero are taken as zero."""

NOISE = 2.0 * EPS
"""Rounding error of a component of a null vector that is exactly zero, over the spread."""

MOST_SPREAD = 2.0**27
"""Largest spread: directions of the null space are uncertain by ZERO times the spread, 2⁻²⁰ at most."""


@inlined
def jacobi_angle(app, aqq, apq):
    """Return tangent, cosine and sine of the rotation that annihilates the off-diagonal apq ≠ 0."""
    theta = 0.5 * (aqq - app) / apq
    t = 1.0 / (abs(theta) + math.sqrt(1.0 + theta * theta)) if abs(theta) < 1e150 else 0.5 / abs(theta)
    if theta < 0.0:
        t = -t
    cos = 1.0 / math.sqrt(1.0 + t * t)
    sin = t * cos
    return t, cos, sin


@inlined
def _rotate(app, aqq, apq, apr, aqr, vp, vq):
    """Apply the Jacobi rotation that annihilates apq; vp and vq are the columns p, q of the eigenvectors."""
    if apq == 0.0:
        return app, aqq, apr, aqr, vp, vq
    t, cos, sin = jacobi_angle(app, aqq, apq)
    return (
        app - t * apq,
        aqq + t * apq,
        cos * apr - sin * aqr,
        sin * apr + cos * aqr,
        (cos * vp[0] - sin * vq[0], cos * vp[1] - sin * vq[1], cos * vp[2] - sin * vq[2]),
        (sin * vp[0] + cos * vq[0], sin * vp[1] + cos * vq[1], sin * vp[2] + cos * vq[2]),
    )


@inlined
def eigen(w11, w12, w13, w22, w23, w33):
    """Return eigenvalues (λ₁, λ₂, λ₃), unsorted, and their eigenvectors, by cyclic Jacobi rotations."""
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for _ in range(12):
        if w12 == 0.0 and w13 == 0.0 and w23 == 0.0:
            break
        w11, w22, w13, w23, x, y = _rotate(w11, w22, w12, w13, w23, x, y)
        w12 = 0.0
        w11, w33, w12, w23, x, z = _rotate(w11, w33, w13, w12, w23, x, z)
        w13 = 0.0
        w22, w33, w12, w13, y, z = _rotate(w22, w33, w23, w12, w13, y, z)
        w23 = 0.0
    return w11, w22, w33, x, y, z


@inlined
def _sort3(l1, l2, l3, x, y, z):
    if l1 > l2:
        l1, l2, x, y = l2, l1, y, x
    if l2 > l3:
        l2, l3, y, z = l3, l2, z, y
    if l1 > l2:
        l1, l2, x, y = l2, l1, y, x
    return l1, l2, l3, x, y, z


GRADED = 2.0**-10
"""Ratio of the least to the largest diagonal entry of W below which W is scaled by (6.2)."""

CORRELATED = 2.0**-10
"""|wᵢⱼ|/√(wᵢᵢwⱼⱼ) above which an entry of a small row cannot be rounding."""

LEANING = 2.0**-6
"""Normal component of a null vector below which the tangent axes are rotated to it, (6.3)."""


class Delassus(NamedTuple):
    """Classification of W. (theory.md, 6)

    Attributes:
        rank: Rank of W; −1: indefinite.
        w11 … w33: W with eigenvalues that are taken as zero removed.
        k1, k2: Stick ratio k = A⁺b.
        s: c − bᵀA⁺b; exactly 0 if stick locks the normal direction.
        least: The smallest eigenvalue.
        spread: ‖W‖/λ, with λ the smallest eigenvalue that is not taken as zero.
        n1, n2, n3: Null vector for rank 2; for rank 1 n₃ is the tangential part of the range, and v₃ = k·v_t
            + η holds to rounding over n₃; else (0, 0, 1).
        doubt: Whether rounding decides that the null vector is tangential, normal, or neither.
    """

    rank: np.int64
    w11: float
    w12: float
    w13: float
    w22: float
    w23: float
    w33: float
    k1: float
    k2: float
    s: float
    least: float
    spread: float
    n1: float
    n2: float
    n3: float
    doubt: bool


REGULAR, NOWHERE, ALONG_NORMAL = np.int64(3), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@inlined
def _found(rank, w, stick, least, spread, null, doubt):
    """Return a `Delassus` from W (6), k with s (3), and the null vector (3)."""
    return Delassus(*(rank, *w, *stick, least, spread, *null, doubt))


@inlined
def eliminate(w11, w12, w13, w22, w23, w33):
    """Return det W, k (2) and s by elimination, the larger pivot first; zeros if a pivot is not positive."""
    first = w11 >= w22
    pivot, other, bp, bo = (w11, w22, w13, w23) if first else (w22, w11, w23, w13)
    if pivot > 0.0:
        inv = 1.0 / pivot
        factor = w12 * inv
        other -= factor * w12
        bo -= factor * bp
        if other > 0.0:
            ko = bo / other
            s = (w33 - bp * bp * inv) - bo * ko
            kp = bp * inv - factor * ko
            k1, k2 = (kp, ko) if first else (ko, kp)
            return pivot * other * s, k1, k2, s
    return 0.0, 0.0, 0.0, 0.0


@inlined
def _rank_two(w11, w12, w13, w22, w23, w33, n, least, spread, noise):
    """Return the `Delassus` of a W of rank two.

    Args:
        w11 … w33: W without its zero eigenvalue.
        n: Unit null vector, known to ZERO `spread`.
        least, spread: As in `Delassus`.
        noise: Bound on the rounding of components of n, over the spread.
    """
    n1, n2, n3 = n
    norm = math.hypot(n1, n2)
    uncertain = ZERO * spread
    two = np.int64(2)
    # the rounding of the null vector is that of W times trace²/(sum of the principal minors), in any axes
    minors = w11 * w22 - w12 * w12 + w11 * w33 - w13 * w13 + w22 * w33 - w23 * w23
    trace = w11 + w22 + w33
    part = min(norm, abs(n3)) * minors
    doubt = noise * trace * trace < part < 2.0 * ZERO * trace * trace
    if norm <= uncertain:
        # no mobility along the normal
        return _found(two, (w11, w12, 0.0, w22, 0.0, 0.0), NOWHERE, least, spread, ALONG_NORMAL, doubt)
    if abs(n3) > uncertain:
        stick = -n1 / n3, -n2 / n3, 0.0
        return _found(two, (w11, w12, w13, w22, w23, w33), stick, least, spread, n, doubt)
    # the null direction is tangential: A has rank one along d, and b is parallel to d
    d1, d2 = n2 / norm, -n1 / norm
    alpha = d1 * (w11 * d1 + w12 * d2) + d2 * (w12 * d1 + w22 * d2)
    beta = w13 * d1 + w23 * d2
    ratio = beta / alpha
    w = alpha * d1 * d1, alpha * d1 * d2, beta * d1, alpha * d2 * d2, beta * d2, w33
    stick = ratio * d1, ratio * d2, w33 - beta * ratio
    return _found(two, w, stick, least, spread, (n1, n2, 0.0), doubt)


@inlined
def _spread(w11, w12, w13, w22, w23, w33):
    """Return λ₃/λ₂ of a W whose least eigenvalue is zero; inf if λ₂ is rounding."""
    half = 0.5 * (w11 + w22 + w33)
    product = w11 * w22 - w12 * w12 + w11 * w33 - w13 * w13 + w22 * w33 - w23 * w23
    largest = half + math.sqrt(max(0.0, half * half - product))
    return largest * largest / product if product > 0.0 else math.inf


@inlined
def _unit_of(x):
    """Return a power of two near 1/√x."""
    return math.ldexp(1.0, -((math.frexp(x)[1] + 1) // 2))


@inlined
def _graded(w11, w12, w13, w22, w23, w33):
    """Classify a W with a small row after scaling its diagonal to order one. (6.2)

    Return whether that is conclusive, and the `Delassus` if so.
    """
    u1, u2, u3 = _unit_of(w11), _unit_of(w22), _unit_of(w33)
    g11, g22, g33 = w11 * u1 * u1, w22 * u2 * u2, w33 * u3 * u3
    g12, g13, g23 = w12 * u1 * u2, w13 * u1 * u3, w23 * u2 * u3
    l1, l2, l3, x, y, z = eigen(g11, g12, g13, g22, g23, g33)
    l1, l2, l3, x, y, z = _sort3(l1, l2, l3, x, y, z)
    zero = ZERO * l3
    largest = max(max(abs(g12), abs(g13)), abs(g23))
    if abs(l1) <= zero and l2 > CORRELATED:
        n1, n2, n3 = x[0] * u1, x[1] * u2, x[2] * u3
        norm = math.sqrt(n1 * n1 + n2 * n2 + n3 * n3)
        n = (n1 / norm, n2 / norm, n3 / norm)
        c11, c12, c13 = l1 * x[0] * x[0], l1 * x[0] * x[1], l1 * x[0] * x[2]
        c22, c23, c33 = l1 * x[1] * x[1], l1 * x[1] * x[2], l1 * x[2] * x[2]
        cleared = (
            *(w11 - c11 / u1 / u1, w12 - c12 / u1 / u2, w13 - c13 / u1 / u3),
            *(w22 - c22 / u2 / u2, w23 - c23 / u2 / u3, w33 - c33 / u3 / u3),
        )
        return True, _rank_two(*cleared, n, 0.0, min(l3 / l2, _spread(*cleared)), 0.0)
    det, k1, k2, s = eliminate(w11, w12, w13, w22, w23, w33)
    regular = l1 > CORRELATED and det > 0.0 and largest > CORRELATED
    return regular, _found(
        REGULAR, (w11, w12, w13, w22, w23, w33), (k1, k2, s), 0.0, 1.0, ALONG_NORMAL, False
    )


@inlined
def nearly_singular(w11, w12, w13, w22, w23, w33):
    """Return the `Delassus` of a W with a small determinant, by its eigenvalues. (theory.md, 6)"""
    smallest, largest = min(w11, w22, w33), max(w11, w22, w33)
    if ZERO * ZERO * largest < smallest < GRADED * largest:
        decided, found = _graded(w11, w12, w13, w22, w23, w33)
        if decided:
            return found

    l1, l2, l3, x, y, z = eigen(w11, w12, w13, w22, w23, w33)
    l1, l2, l3, x, y, z = _sort3(l1, l2, l3, x, y, z)
    zero = ZERO * max(abs(l1), abs(l3))
    if l1 < -zero:
        return _found(np.int64(-1), (w11, w12, w13, w22, w23, w33), NOWHERE, l1, 1.0, ALONG_NORMAL, False)
    if l1 > zero:
        # k = −(w₁, w₂)/w₃ and s = 1/w₃ with w = W⁻¹e₃, summed over the eigenvectors
        g1, g2, g3 = x[2] / l1, y[2] / l2, z[2] / l3
        q3 = g1 * x[2] + g2 * y[2] + g3 * z[2]
        k1 = -(g1 * x[0] + g2 * y[0] + g3 * z[0]) / q3
        k2 = -(g1 * x[1] + g2 * y[1] + g3 * z[1]) / q3
        return _found(
            REGULAR, (w11, w12, w13, w22, w23, w33), (k1, k2, 1.0 / q3), l1, l3 / l1, ALONG_NORMAL, False
        )
    if l2 > zero + max(l1, 0.0):  # otherwise rounding would decide between their directions
        w11 -= l1 * x[0] * x[0]
        w12 -= l1 * x[0] * x[1]
        w13 -= l1 * x[0] * x[2]
        w22 -= l1 * x[1] * x[1]
        w23 -= l1 * x[1] * x[2]
        w33 -= l1 * x[2] * x[2]
        return _rank_two(w11, w12, w13, w22, w23, w33, x, l1, min(l3 / l2, MOST_SPREAD), NOISE)
    if l3 > 0.0:
        tangential = z[0] * z[0] + z[1] * z[1]
        if tangential <= ZERO * ZERO:
            c = l3 * z[2] * z[2]
            return _found(np.int64(1), (*NOWHERE, 0.0, 0.0, c), (0.0, 0.0, c), l1, 1.0, ALONG_NORMAL, False)
        z3 = z[2] if abs(z[2]) > ZERO else 0.0
        x1, x2, x3 = l3 * z[0], l3 * z[1], l3 * z3
        w = x1 * z[0], x1 * z[1], x1 * z3, x2 * z[1], x2 * z3, x3 * z3
        stick = z3 / tangential * z[0], z3 / tangential * z[1], 0.0
        return _found(np.int64(1), w, stick, l1, 1.0, (0.0, 0.0, math.sqrt(tangential)), False)
    return _found(np.int64(0), (*NOWHERE, *NOWHERE), NOWHERE, l1, 1.0, ALONG_NORMAL, False)


@inlined
def clear(w11, w12, w13, w22, w23, w33, least):
    """Return whether W is regular by det W > `least` (tr W)³, and its `Delassus` if so."""
    trace = w11 + w22 + w33
    det, k1, k2, s = eliminate(w11, w12, w13, w22, w23, w33)
    regular = det > 0.0 and det > least * trace * trace * trace
    return regular, _found(
        REGULAR, (w11, w12, w13, w22, w23, w33), (k1, k2, s), 0.0, 1.0, ALONG_NORMAL, False
    )


FORMED = 4.0 * EPS
"""Entries of a factor within FORMED times its scale are taken as zero; rounding errors are up to 0.2 ε."""

FORMED_NOISE = 0.5 * EPS
"""Rounding error of an entry that is exactly zero, over the scale."""

UNKNOWN = 8.0
"""The scale of a factor over its norm, if the scale is unknown."""


@inlined
def triangle(x, y, z):
    """Return the lower triangle C, CCᵀ = XXᵀ, of X (3, 3) with rows x, y, z: c₁₁ … c₃₃ row by row.

    Gram–Schmidt makes c₂₂ and c₃₃ accurate to rounding of y and z. Entries below a zero diagonal entry are
    zero.
    """
    c11 = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    i1 = 1.0 / c11 if c11 > 0.0 else 0.0
    p1, p2, p3 = x[0] * i1, x[1] * i1, x[2] * i1
    c21 = p1 * y[0] + p2 * y[1] + p3 * y[2]
    y1, y2, y3 = y[0] - c21 * p1, y[1] - c21 * p2, y[2] - c21 * p3
    c22 = math.sqrt(y1 * y1 + y2 * y2 + y3 * y3)
    i2 = 1.0 / c22 if c22 > 0.0 else 0.0
    q1, q2, q3 = y1 * i2, y2 * i2, y3 * i2
    c31 = p1 * z[0] + p2 * z[1] + p3 * z[2]
    z1, z2, z3 = z[0] - c31 * p1, z[1] - c31 * p2, z[2] - c31 * p3
    c32 = q1 * z1 + q2 * z2 + q3 * z3
    z1, z2, z3 = z1 - c32 * q1, z2 - c32 * q2, z3 - c32 * q3
    return c11, c21, c22, c31, c32, math.sqrt(z1 * z1 + z2 * z2 + z3 * z3)


@inlined
def weak_axis(x, y):
    """Return the unit tangential direction e (2) in which the rows x and y (3) of t₁ and t₂ are smallest."""
    xx = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
    yy = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    xy = x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    if xy == 0.0:
        return (0.0, 1.0) if yy <= xx else (1.0, 0.0)
    t, cos, sin = jacobi_angle(xx, yy, xy)
    return (sin, cos) if yy + t * xy <= xx - t * xy else (cos, -sin)


@inlined
def of_factor(x, y, z, formed):
    """Classify W = XXᵀ by its factor, which has accurate small singular values. (6.5)

    Args:
        x, y, z: Rows (3) of X.
        formed: Scale of X: size of the terms that its entries are the sums of; 0 if unknown.

    Returns:
        The `Delassus`, in tangent axes of which the second is that in which X is smallest; this axis e (2);
        and the remaining angle to it, which is below rounding.
    """
    e1, e2 = weak_axis(x, y)
    strong = (e2 * x[0] - e1 * y[0], e2 * x[1] - e1 * y[1], e2 * x[2] - e1 * y[2])
    weak = (e1 * x[0] + e2 * y[0], e1 * x[1] + e2 * y[1], e1 * x[2] + e2 * y[2])
    c11, c21, c22, c31, c32, c33 = triangle(strong, weak, z)
    normal = math.sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
    size = math.sqrt(c11 * c11 + c22 * c22 + normal * normal)
    formed = max(formed if formed > 0.0 else UNKNOWN * size, size)
    zero, noise = FORMED * formed, FORMED_NOISE * formed
    k1 = k2 = s = area = 0.0
    n3 = 1.0
    d1 = d2 = d3 = 0.0  # a third column that corrects the rows for the null vector n ∝ (−k, 1)
    # rounding decides whether the contact can wedge
    doubt = noise < c22 < 2.0 * zero or noise < normal < 2.0 * zero
    rest = 0.0
    if c11 <= zero or c22 <= zero:
        c22 = 0.0
    else:  # with orthogonal rows, errors of the large one do not reach the small one
        rest = c21 / c11
    if normal <= zero:  # no mobility along the normal
        c31 = c32 = c33 = 0.0
        area = c11 * c22
    elif c11 <= zero:  # mobility along the normal only
        c11 = c31 = c32 = 0.0
        c33 = normal
    else:
        if c22 <= zero:  # no mobility along e
            if abs(c31) <= zero:
                c31 = 0.0
            c33, c32 = math.hypot(c32, c33), 0.0
        else:
            k2 = c32 / c22
        k1 = c31 / c11
        n3 = 1.0 / math.sqrt(1.0 + k1 * k1 + k2 * k2)
        least = c33 * n3
        # locked, or an impulse 10¹⁴ times the usual one
        doubt = doubt or (c22 > 0.0 and noise < least < 2.0 * zero)
        if least <= zero:
            d1, d2, d3 = k1 * n3 * least, k2 * n3 * least, (k1 * k1 + k2 * k2) * n3 * least
            c33 = 0.0
        m1, m2, m3, m4 = c11 * c22, c11 * c32, c22 * c31, c11 * c33
        if c22 == 0.0 or c33 == 0.0:
            area = math.sqrt(m1 * m1 + m2 * m2 + m3 * m3 + m4 * m4)
    s = c33 * c33
    rank = np.int64(c11 > 0.0) + np.int64(c22 > 0.0) + np.int64(c33 > 0.0)
    spread = 1.0
    if size > 0.0:
        spread = max(formed / UNKNOWN * (size / area if area > 0.0 else 1.0 / size), 1.0)
    w = (
        *(c11 * c11 + d1 * d1, d1 * d2, c11 * c31 + d1 * d3, c22 * c22 + d2 * d2, c22 * c32 + d2 * d3),
        c31 * c31 + c32 * c32 + c33 * c33 + d3 * d3,
    )
    return _found(rank, w, (k1, k2, s), 0.0, spread, (0.0, 0.0, n3), doubt), e1, e2, rest
