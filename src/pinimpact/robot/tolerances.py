"""Tolerances of robots and their contacts, with their units; relative ones have none."""

from __future__ import annotations

from .._numeric.tolerances import HALF_DIGITS
from ..contact_space._kernels.tolerances import MISSED

AGREEMENT = HALF_DIGITS
"""Relative difference up to which results agree. Another layout differs by as much as the numbers themselves;
rounding is far below, since the links of the check have well-conditioned inertias."""

HELD_TOLERANCE = MISSED
"""Tolerance of the velocity of a held point: before an impact relative to the sum of what joints contribute
to it and to what collides, at the start of a motion to 1 m/s and the largest velocity."""

SLACK = 1e-4
"""Distance [rad or m] beyond a bound without a warning, for rounded descriptions and compliant stops."""

ROUNDED_INERTIA = 1e-2
"""Part of the largest principal moment by which it may exceed the sum of the others: in rounded descriptions
of thin plates, which have equality, it does."""
