"""Tolerances of robots and their contacts, with their units; relative ones have none."""

from __future__ import annotations

from .._numeric.tolerances import HALF_DIGITS
from ..contact_space._kernels.tolerances import MISSED

AGREEMENT = HALF_DIGITS
"""Relative difference up to which results agree. Numbers of another memory layout differ by their own size;
rounding is far below, since the links of the check have well-conditioned inertias."""

HELD_TOLERANCE = MISSED
"""Tolerance of the velocity of a held point, relative to `ContactGeometry.velocity_scale` before an impact,
and to 1 m/s and the sum of its terms at the start of a motion."""

SLACK = 1e-4
"""Distance [rad or m] beyond a bound without a warning, for rounded descriptions and compliant stops."""

ROUNDED_INERTIA = 1e-2
"""Excess of the largest principal moment over the sum of the others, relative to the largest, without a
warning: a thin plate has equality, and descriptions are rounded."""

LOST_DIGITS = 1e3
"""Error of accelerations by articulated bodies over that of elimination with M, up to which they are used:
three of about ten digits."""
