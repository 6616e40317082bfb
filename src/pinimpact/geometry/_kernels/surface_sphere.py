"""A sphere about the surface's point, n outwards; see `surface_plane` for the meaning of the functions."""

from __future__ import annotations

import math

from ..._compile.jit import inlined
from .constants import SIZE


@inlined
def distance(k, x1, x2, x3):
    """Return |x| − R and x/|x|; at the centre, where the normal is not unique, n is z."""
    away = math.sqrt(x1 * x1 + x2 * x2 + x3 * x3)
    if away == 0.0:
        return -k[SIZE], 0.0, 0.0, 1.0
    return away - k[SIZE], x1 / away, x2 / away, x3 / away


@inlined
def normal_rate(k, x1, x2, x3, v1, v2, v3):
    """Return (v − n n·v)/|x|."""
    away = math.sqrt(x1 * x1 + x2 * x2 + x3 * x3)
    if away == 0.0:
        return 0.0, 0.0, 0.0
    n1, n2, n3 = x1 / away, x2 / away, x3 / away
    rise = n1 * v1 + n2 * v2 + n3 * v3
    return (v1 - rise * n1) / away, (v2 - rise * n2) / away, (v3 - rise * n3) / away


@inlined
def least_radius(k):
    """Return R."""
    return k[SIZE]
