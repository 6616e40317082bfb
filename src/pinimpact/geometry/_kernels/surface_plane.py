"""A plane: its normal is the third of the axes in the constants; see `contact_kinematics`."""

from __future__ import annotations

import math

from ..._compile.jit import inlined
from .constants import AXES

# functions of each surface kernel; x is relative to the point of the surface, in the axes of its carrier


@inlined
def distance(k, x1, x2, x3):
    """Return the signed distance of x and its gradient n (3), the unit normal of the surface closest to x."""
    n1, n2, n3 = k[AXES + 6], k[AXES + 7], k[AXES + 8]
    return n1 * x1 + n2 * x2 + n3 * x3, n1, n2, n3


@inlined
def normal_rate(k, x1, x2, x3, v1, v2, v3):
    """Return the rate (3) of n when x moves at v: the second derivative of the distance, times v."""
    return 0.0, 0.0, 0.0


@inlined
def least_radius(k):
    """Return the least radius of curvature [m] of the surface, which bulges towards n or is flat."""
    return math.inf
