"""Tolerances of the solvers. Their problems are scaled: residuals are of order one at the start."""

from __future__ import annotations

EPS = 2.0**-52

TINY = 1e-300
"""A divisor in the place of zero: what it divides is zero then, or as good as infinite."""

EXACT, ROUNDOFF, NOISE, ROUNDING, COMPUTED = 1e-15, 1e-14, 1e-13, 1e-12, 1e-11
"""Part of the largest of what belongs together (sizes, times, speeds, entries of a matrix) that is rounding:
of a few operations (a residual at which Newton's method does not start); of some fifty (one at which it
stops, the inverse inertia of a row that nothing moves); of some hundred (residuals of equations of order
one); of some thousand; and of numbers that come from M⁻¹ and W of a robot, with their condition (pivots,
forces)."""

LITTLE = 1e-3
"""Part of something beside which something else is little, so that it does not matter how much it is."""

HALF_DIGITS = 2.0**-26
"""The same where numbers have been through what may cost half of their digits; its square is `EPS`."""

# ---- pivots

RANK = 1e-10
"""A pivot or singular value below this part of the largest is taken as zero. For Newton's equations at a
solution, whose entries are known to rounding, one below `COMPUTED` is."""

# ---- Coulomb's law by multipliers and Newton's method

COMPLIANCE = 1e-9
"""Added to the diagonal, so that it is definite, relative to the forces of the previous iteration; it does
not change the fixed point."""

NEAR = 1e-2
"""Residual below which Newton's method is tried."""

USABLE = 1e-10
"""Residual of forces that is accepted if it does not decrease further; at `COMPUTED` the iteration stops."""

SMALL = 1e-5
"""A compliance that is small relative to the largest of W: extrapolation leaves an error of its square,
10⁻¹⁰."""

# ---- Coulomb's law in the velocities

SOFTEST = 3e-3
"""The largest r, relative to the largest of W: larger values take more iterations, smaller ones longer
iterations."""

SETTLED = 1e-9
"""Part of u_free by which f⁺ − f may change velocities at the end, if rounding allows it."""

STALLED = 1e-5
"""The same, below which the iteration ends if `PATIENCE` iterations have not halved it."""
