"""A line through the surface's point, with a radius; see `surface_plane` for the meaning of the functions."""

from __future__ import annotations

from ..._compile.jit import inlined
from . import surface_sphere
from .constants import LINE_AXIS
from .surface_sphere import least_radius as least_radius


@inlined
def across(k, x1, x2, x3):
    """Return the component (3) of a vector perpendicular to the line."""
    e1, e2, e3 = k[LINE_AXIS], k[LINE_AXIS + 1], k[LINE_AXIS + 2]
    f = e1 * x1 + e2 * x2 + e3 * x3
    return x1 - f * e1, x2 - f * e2, x3 - f * e3


@inlined
def distance(k, x1, x2, x3):
    """Return |y| − R and y/|y|, with y the part of x across the line; on the line itself n is z."""
    y1, y2, y3 = across(k, x1, x2, x3)
    return surface_sphere.distance(k, y1, y2, y3)


@inlined
def normal_rate(k, x1, x2, x3, v1, v2, v3):
    """Return (w − n n·w)/|y|, with w the part of v across the line."""
    y1, y2, y3 = across(k, x1, x2, x3)
    w1, w2, w3 = across(k, v1, v2, v3)
    return surface_sphere.normal_rate(k, y1, y2, y3, w1, w2, w3)
