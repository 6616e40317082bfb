"""Tolerances of robots and their contacts, with their units; relative ones have none."""

from __future__ import annotations

AGREEMENT = 1e-6
"""Relative difference up to which results agree. Another layout differs by as much as the numbers themselves;
rounding is far below, since the links of the check have well-conditioned inertias."""

CLEARLY_POSITIVE = 1e-10
"""Smallest effective inertia of a joint, relative to its inertia, that is not rounding."""

NORMALIZED = 1e-8
"""Tolerance of the length of a quaternion or (cos, sin) pair, whose square is rounding."""

LEAST_RISE = 1e-12
"""Lower bound of 1 + a₃·n: next to n = −a₃ the carried axes are arbitrary, but finite."""

COUPLED = 1e-12
"""Ratio of an off-diagonal block of W to the diagonal ones below which two contacts are not coupled."""

TIE = 4e-12
"""Tolerance for equal gaps of tips, relative to 1 m and the largest coordinate."""

FLAT = 1e-12
"""Sine of the angle between a rim and its plane below which it lies flat."""

TOUCHING = 1e-12
"""Tolerance of a closed gap, relative to the robot's size and its coordinates."""

SETTLED = 1e-7
"""Step length at which the search of a configuration ends [rad or m]: its square is rounding."""

REDUNDANT = 1e-9
"""Singular value of gradients of gaps, relative to the largest, below which they are redundant."""

LEAST_RANGE = 1e-12
"""Range of a joint whose limits coincide [rad or m]; the solver of least squares needs one."""

HELD_TOLERANCE = 1e-6
"""Tolerance of the velocity of a held point before the impact, relative to the sum of the joints'
contributions."""

PULL = 1e-12
"""Smallest pull that is reported, relative to the impulse of the impact."""

SLACK = 1e-4
"""Distance [rad or m] beyond a bound without a warning, for rounded descriptions and compliant stops."""
