"""The direction in which slip resumes: the root of the secular equation. (theory.md, 5.2)"""

from __future__ import annotations

import math

from ..._compile.jit import inlined
from .delassus import jacobi_angle


@inlined
def resumed_direction(a11, a12, a22, b1, b2, mu):
    """Solve (λI + μA)σ = b, |σ| = 1, for λ ≥ 0, given that stick is impossible (‖A⁺b‖ > μ).

    |(λI + μA)⁻¹b| falls steadily with λ, and its inverse is concave: Newton from a lower bound climbs
    to the root without passing it.

    Returns:
        λ and the two components of the unit vector σ.
    """
    if a12 == 0.0:
        cos, sin, low, high = 1.0, 0.0, mu * a11, mu * a22
    else:
        t, cos, sin = jacobi_angle(a11, a22, a12)
        low, high = mu * (a11 - t * a12), mu * (a22 + t * a12)
    low, high = max(low, 0.0), max(high, 0.0)
    y1 = cos * b1 - sin * b2
    y2 = sin * b1 + cos * b2
    lam = max(0.0, abs(y1) - low, abs(y2) - high, math.hypot(y1, y2) - max(low, high))
    x1 = x2 = 0.0
    for _ in range(60):
        d1, d2 = lam + low, lam + high
        x1 = y1 / d1 if y1 != 0.0 else 0.0
        x2 = y2 / d2 if y2 != 0.0 else 0.0
        square = x1 * x1 + x2 * x2
        norm = math.sqrt(square)
        slope = (x1 * x1 / d1 if y1 != 0.0 else 0.0) + (x2 * x2 / d2 if y2 != 0.0 else 0.0)
        step = (norm - 1.0) * square / slope
        if not (lam + step > lam):
            break
        lam += step
    norm = math.hypot(x1, x2)
    x1, x2 = x1 / norm, x2 / norm
    return lam, cos * x1 + sin * x2, cos * x2 - sin * x1
