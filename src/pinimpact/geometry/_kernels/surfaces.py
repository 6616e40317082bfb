"""Selection of surface functions by kind; see `surface_plane` for their meaning."""

from __future__ import annotations

from ..._compile.jit import inlined
from . import surface_line, surface_plane, surface_sphere
from .constants import KIND, LINE, SPHERE


@inlined
def distance(k, x1, x2, x3):
    """Return the signed distance of x from the surface, and n (3)."""
    if k[KIND] == SPHERE:
        return surface_sphere.distance(k, x1, x2, x3)
    if k[KIND] == LINE:
        return surface_line.distance(k, x1, x2, x3)
    return surface_plane.distance(k, x1, x2, x3)


@inlined
def normal_rate(k, x1, x2, x3, v1, v2, v3):
    """Return the rate (3) of n when x moves at v."""
    if k[KIND] == SPHERE:
        return surface_sphere.normal_rate(k, x1, x2, x3, v1, v2, v3)
    if k[KIND] == LINE:
        return surface_line.normal_rate(k, x1, x2, x3, v1, v2, v3)
    return surface_plane.normal_rate(k, x1, x2, x3, v1, v2, v3)


@inlined
def least_radius(k):
    """Return the least radius of curvature [m]."""
    if k[KIND] == SPHERE:
        return surface_sphere.least_radius(k)
    if k[KIND] == LINE:
        return surface_line.least_radius(k)
    return surface_plane.least_radius(k)
