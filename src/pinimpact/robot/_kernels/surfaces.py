"""The kinds of surfaces: the one place where a kernel asks which it is."""

from __future__ import annotations

from ..._numeric.jit import inner
from . import surface_plane


@inner
def distance(k, x1, x2, x3):
    """Return the signed distance of x from the surface, and n (3); see `surface_plane` for all three."""
    return surface_plane.distance(k, x1, x2, x3)


@inner
def normal_rate(k, x1, x2, x3, v1, v2, v3):
    """Return the rate (3) of n when x moves at v."""
    return surface_plane.normal_rate(k, x1, x2, x3, v1, v2, v3)


@inner
def least_radius(k):
    """Return the least radius of curvature [m]."""
    return surface_plane.least_radius(k)
