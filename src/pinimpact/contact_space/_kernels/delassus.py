"""The Delassus matrix W = [[A, b], [bᵀ, c]]: its rank, its null space, and what stick makes of it."""

from __future__ import annotations

import math

from ..._numeric.jit import inner

EPS = 2.0**-52
ZERO = 32.0 * EPS
"""Eigenvalues of W within ZERO·‖W‖ of zero are zero."""

MOST_SPREAD = 2.0**27
"""ZERO times the spread is how far directions of the null space are off; never taken for more than 2⁻²⁰."""


@inner
def jacobi_angle(app, aqq, apq):
    """Return tangent, cosine and sine of the rotation that annihilates the off-diagonal apq ≠ 0."""
    theta = 0.5 * (aqq - app) / apq
    t = 1.0 / (abs(theta) + math.sqrt(1.0 + theta * theta)) if abs(theta) < 1e150 else 0.5 / abs(theta)
    if theta < 0.0:
        t = -t
    cos = 1.0 / math.sqrt(1.0 + t * t)
    sin = t * cos
    return t, cos, sin


@inner
def _rotate(app, aqq, apq, apr, aqr, vp, vq):
    """One Jacobi rotation that annihilates apq; vp and vq are the columns p, q of the eigenvectors."""
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


@inner
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


@inner
def _sort3(l1, l2, l3, x, y, z):
    if l1 > l2:
        l1, l2, x, y = l2, l1, y, x
    if l2 > l3:
        l2, l3, y, z = l3, l2, z, y
    if l1 > l2:
        l1, l2, x, y = l2, l1, y, x
    return l1, l2, l3, x, y, z


@inner
def classify(w11, w12, w13, w22, w23, w33):
    """Decide the rank of W and clean it.

    Returns:
        rank (−1: indefinite), the six entries of W with its zero eigenvalues removed, the stick ratio
        κ = A⁺b (2), s = c − bᵀA⁺b (exactly 0 where stick locks the normal direction), the smallest
        eigenvalue found, and the spread ‖W‖/λ of the smallest eigenvalue that counts. (theory.md, 6)
    """
    # elimination with the larger pivot first; det W ≤ λ_min (tr W)²/4 clears W without its eigenvalues
    trace = w11 + w22 + w33
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
            if pivot * other * s > 1e-12 * trace * trace * trace:
                kp = bp * inv - factor * ko
                k1, k2 = (kp, ko) if first else (ko, kp)
                return 3, w11, w12, w13, w22, w23, w33, k1, k2, s, 0.0, 1.0

    l1, l2, l3, x, y, z = eigen(w11, w12, w13, w22, w23, w33)
    l1, l2, l3, x, y, z = _sort3(l1, l2, l3, x, y, z)
    zero = ZERO * max(abs(l1), abs(l3))
    if l1 < -zero or not (l3 >= 0.0):
        return -1, w11, w12, w13, w22, w23, w33, 0.0, 0.0, 0.0, l1, 1.0
    if l1 > zero:
        # κ = −(w₁, w₂)/w₃ and s = 1/w₃ with w = W⁻¹e₃, summed over the eigenvectors
        g1, g2, g3 = x[2] / l1, y[2] / l2, z[2] / l3
        q3 = g1 * x[2] + g2 * y[2] + g3 * z[2]
        k1 = -(g1 * x[0] + g2 * y[0] + g3 * z[0]) / q3
        k2 = -(g1 * x[1] + g2 * y[1] + g3 * z[1]) / q3
        return 3, w11, w12, w13, w22, w23, w33, k1, k2, 1.0 / q3, l1, l3 / l1
    if l2 > zero:
        spread = min(l3 / l2, MOST_SPREAD)
        w11 -= l1 * x[0] * x[0]
        w12 -= l1 * x[0] * x[1]
        w13 -= l1 * x[0] * x[2]
        w22 -= l1 * x[1] * x[1]
        w23 -= l1 * x[1] * x[2]
        w33 -= l1 * x[2] * x[2]
        if abs(x[2]) > ZERO * spread:
            return 2, w11, w12, w13, w22, w23, w33, -x[0] / x[2], -x[1] / x[2], 0.0, l1, spread
        # the null direction is tangential: A has rank one along d, and b is parallel to d
        norm = math.hypot(x[0], x[1])
        d1, d2 = x[1] / norm, -x[0] / norm
        alpha = d1 * (w11 * d1 + w12 * d2) + d2 * (w12 * d1 + w22 * d2)
        beta = w13 * d1 + w23 * d2
        s = w33 - beta * beta / alpha
        return (
            2,
            alpha * d1 * d1,
            alpha * d1 * d2,
            beta * d1,
            alpha * d2 * d2,
            beta * d2,
            w33,
            beta / alpha * d1,
            beta / alpha * d2,
            s,
            l1,
            spread,
        )
    if l3 > 0.0:
        tangential = z[0] * z[0] + z[1] * z[1]
        if tangential <= ZERO * ZERO:
            return 1, 0.0, 0.0, 0.0, 0.0, 0.0, l3 * z[2] * z[2], 0.0, 0.0, l3 * z[2] * z[2], l1, 1.0
        z3 = z[2] if abs(z[2]) > ZERO else 0.0
        return (
            1,
            l3 * z[0] * z[0],
            l3 * z[0] * z[1],
            l3 * z[0] * z3,
            l3 * z[1] * z[1],
            l3 * z[1] * z3,
            l3 * z3 * z3,
            z3 / tangential * z[0],
            z3 / tangential * z[1],
            0.0,
            l1,
            1.0,
        )
    return 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, l1, 1.0
