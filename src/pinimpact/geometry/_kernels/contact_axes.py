"""The contact axes t₁, t₂ of a normal."""

from __future__ import annotations

import math

from ..._compile.declared import declared
from ..._compile.jit import jit
from ..._numeric.tolerances import TINY


@declared(float, float, float)
@jit
def contact_axes(nx, ny, nz):
    """Return t₁ and t₂ (3 + 3 scalars) of the unit normal n: x and y after the smallest rotation z → n.

    With n = (s u, nz), |u| = 1: t₁ = x − (1 − nz) u₁ (u, 0) − nx z, and t₂ alike. For nz > 0 the factor
    is s²/(1 + nz), so nothing cancels near n = ±z. For n = −z: half a turn about x.
    """
    s = math.hypot(nx, ny)
    if s == 0.0:
        return (1.0, 0.0, 0.0, 0.0, 1.0 if nz > 0.0 else -1.0, 0.0)
    up = 2.0**600 if s < TINY else 1.0  # numbers that small have few digits, and so has their hypot
    u1, u2 = nx * up, ny * up
    r = math.hypot(u1, u2)
    u1, u2 = u1 / r, u2 / r
    f = s * (s / (1.0 + nz)) if nz > 0.0 else 1.0 - nz
    return 1.0 - f * u1 * u1, -f * u1 * u2, -nx, -f * u1 * u2, 1.0 - f * u2 * u2, -ny
