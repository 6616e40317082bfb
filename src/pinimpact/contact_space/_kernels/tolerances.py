"""Tolerances of impacts. Each says what it is a part of, or its unit, and why it has its size.

Impacts at many contacts are scaled: the largest velocity is one, and the largest κ W₃₃. Their clock, speeds,
accelerations and forces are then of order one.
"""

from __future__ import annotations

from ..._numeric.tolerances import COMPUTED, HALF_DIGITS, LITTLE, NOISE

# ---- one contact

WELL_CONDITIONED = 1e-6
"""det W over (tr W)³ above which what is small in W has nine digits or more without a factor; W is regular
above `ROUNDING`: det W ≤ λ_min (tr W)²/4."""

ROOT = 1e-9
"""Part of a root by which another number differs from it and is it: at an extremum of v₃ the square of that
counts, and Newton's method leaves its square."""

HALLEY = 2.0 * ROOT ** (2.0 / 3.0)
"""The same for Halley's method, which leaves its cube."""

CLOSE_TO_JUMP = 1e-2
"""Relative distance to a jump of the impact map within which NEAR_JUMP is set."""

NEAR_THRESHOLD = 1e-6
"""Relative distance of μ to the stick threshold within which NEAR_STICK_THRESHOLD is set."""

ROOM = 1.0 + COMPUTED
"""How far the impulse that sets v_t to zero may leave the cone of friction, for rounding."""

COINCIDENT = COMPUTED
"""Distance of two events, over all of P₃, and of μ from the stick threshold, over μ, up to which rounding
decides what derivatives hold."""

FLAT = HALF_DIGITS
"""Of a rate or velocity over its scale at an event: below it v⁺ jumps or has a slope without bound nearby. It
is the root of how far that is."""

NEAR_LIMIT = 1e-4
"""Distance of slopes from their limit to one side, over their size, from which on the limit is known, to
about the square of that."""

TAIL = NOISE
"""Angle, or part of the path times angle, by which slip still turns where its derivatives are those of
straight slip."""

# ---- many contacts, from event to event

NEGLIGIBLE = COMPUTED
"""Part by which forces, accelerations, pivots, tangential velocities and times of events may differ and
be one: they are sums of terms of order one, or come from velocities and W of a robot with their
rounding. Shorter steps are not taken. And part of the largest bound below which friction does not matter."""

SLOW = 1e-10
"""A speed, in parts of the largest, at which what was held is not; and of an approach that is rest."""

STOPS = HALF_DIGITS
"""A slip below this speed that runs straight at zero is taken there in one step, of second order."""

SLIP_SPEED = NOISE
"""The speed at which a slip begins, in parts of the largest velocity: a perturbation of rounding's size."""

AHEAD = 1e-6
"""How far ahead forces are compared, in the clock: where all begin at zero their first terms decide."""

UNTURNED = LITTLE
"""How far ahead that is at most, in the unit of the clock in which slow slip turns slowly."""

SAME = AHEAD
"""Part of the largest force by which forces that hold the same differ; and of a bound within which friction
is at it: what `AHEAD` lets forces change."""

OPTIMAL = COMPUTED**2
"""Gap of the convex programs of friction, of order one, whose solution is then right to its root: they go on
to the last step that double precision allows."""

# ---- many contacts, by steps and all at once

FOUND = 1e-8
"""What Coulomb's law may be missed by where it is met well enough, in parts of the largest velocity."""

MISSED = 1e-6
"""Part of velocities, impulses and works that may be missed or gained, before waves count as lost; and of the
largest velocity that an approach may keep after a plastic impact, where forces are large."""

AGREE = 0.1 * MISSED
"""Part of the largest velocity to which plastic ends and extrapolations to e = 0 agree that are taken for the
same, and that a step may miss at the most; unless less is asked."""

BY_STEPS, FINEST = 0.2 * AGREE, 2.0 * NOISE
"""Part of the largest velocity that an integration by steps may miss, unless another is asked; and what a
step may miss at least."""
