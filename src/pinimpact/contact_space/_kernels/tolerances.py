"""Tolerances of impacts.

Impacts at several contacts are scaled so that the largest velocity and the largest κ W₃₃ are one. Clock,
speeds, accelerations and forces are then of order one.
"""

from __future__ import annotations

from ..._numeric.tolerances import COMPUTED, HALF_DIGITS, LITTLE, NOISE

# ---- one contact

WELL_CONDITIONED = 1e-6
"""det W over (tr W)³ above which the small eigenvalues of W are accurate to nine digits without a factor. W
is regular above `ROUNDING`: det W ≤ λ_min (tr W)²/4."""

ROOT = 1e-9
"""Relative tolerance of a root: the error after one more step of Newton's method, and the change of v₃ up to
its extremum, are the square of this."""

HALLEY = 2.0 * ROOT ** (2.0 / 3.0)
"""Relative tolerance of a root by Halley's method, whose next error is the cube of this."""

CLOSE_TO_JUMP = 1e-2
"""Relative distance to a jump of the impact map within which NEAR_JUMP is set."""

NEAR_THRESHOLD = 1e-6
"""Relative distance of μ to the stick threshold within which NEAR_STICK_THRESHOLD is set."""

ROOM = 1.0 + COMPUTED
"""Tolerance of the friction cone for the impulse that sets v_t to zero: rounding."""

COINCIDENT = COMPUTED
"""Distance of two events relative to the total P₃, and relative distance of μ to the stick threshold, below
which rounding decides which derivatives apply."""

FLAT = HALF_DIGITS
"""Rate or velocity at an event, over its scale, below which v⁺ nearly jumps or has an unbounded slope; the
distance to the singularity is the square of this."""

THIN = HALF_DIGITS
"""Least eigenvalue of the tangential W, over its trace, below which derivatives of P_t along that direction,
whose error is a rounding error over this ratio, have fewer than half of their digits."""

NEAR_LIMIT = 1e-4
"""Relative distance of slopes to their one-sided limit from which the limit is extrapolated; its error is
about the square of this."""

TAIL = NOISE
"""Remaining angle of slip [rad], or angle times part of the path, below which its derivatives are those of
straight slip."""

# ---- many contacts, from event to event

NEGLIGIBLE = COMPUTED
"""Differences of forces, accelerations, pivots, tangential velocities and times of events that are taken as
zero: rounding of terms of order one, or of velocities and W of a robot. It is also the smallest step size,
and the friction bound, over the largest, below which friction is neglected."""

NUDGE = HALF_DIGITS
"""Initial approach speed of contacts that jam, relative to the speed of slip. (13.2)"""

LEAST_NUDGE = 0.1 * NUDGE
"""Least value of it, relative to the fastest slip."""

SLOW = 1e-10
"""Speed above which a contact is no longer held or sticking, and below which an approach is taken as rest."""

STOPS = HALF_DIGITS
"""Slip speed below which slip on a straight line to zero ends in one step of second order."""

SLIP_SPEED = NOISE
"""Initial speed of incipient slip: a perturbation of the size of rounding."""

AHEAD = 1e-6
"""Time ahead at which forces are compared, so that their first terms decide where all start at zero."""

UNTURNED = LITTLE
"""Largest such time, over the time in which slow slip turns."""

SAME = AHEAD
"""Difference of equal forces, over the largest, and relative distance of friction to its bound within which
it is at it: the change of forces within `AHEAD`."""

# ---- many contacts, by steps and all at once

FOUND = 1e-8
"""Tolerance of the residual of Coulomb's law, over the largest velocity."""

MISSED = 1e-6
"""Largest relative residual of velocities, impulses and energy of a propagation that is accepted; and the
largest speed of approach after a plastic impact, over the largest velocity, since forces may be large."""

AGREE = 0.1 * MISSED
"""Difference, over the largest velocity, below which plastic ends, or extrapolations to e = 0, are taken as
equal; and the largest default tolerance of a step."""

BY_STEPS, FINEST = 0.2 * AGREE, 2.0 * NOISE
"""Default accuracy of an integration by steps, and least tolerance of a step, over the largest velocity."""
