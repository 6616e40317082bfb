"""Tolerances of the solvers. Problems are scaled so that residuals are of order one at the start."""

from __future__ import annotations

EPS = 2.0**-52

TINY = 1e-300
"""Least divisor, to avoid division by zero."""

EXACT, ROUNDOFF, NOISE, ROUNDING, COMPUTED = 1e-15, 1e-14, 1e-13, 1e-12, 1e-11
"""Rounding errors relative to the largest of similar quantities (sizes, times, speeds, matrix entries):
after a few operations (a residual at which Newton's method does not start); after some fifty (one at which it
stops, the inverse inertia of a row that no force moves); after some hundred (residuals of equations of order
one); after some thousand; and of results of M⁻¹ and W of a robot, including their condition (pivots,
forces)."""

LITTLE = 1e-3
"""Ratio of two quantities below which the smaller one does not matter."""

HALF_DIGITS = 2.0**-26
"""Relative error of results that may have lost half of their digits; its square is `EPS`."""

# ---- pivots

UNDETERMINED = 1e-9
"""Acceleration or inverse inertia, relative to the sum of its terms, that is taken as zero where forces are
not unique: the condition of the load sharing amplifies rounding errors. (11.10)"""

RANK = 1e-10
"""Pivot or singular value, relative to the largest, that is taken as zero. For Newton's equations at a
solution, whose entries are accurate to rounding, it is `COMPUTED`."""

# ---- Coulomb's law

USABLE = 1e-10
"""Residual up to which forces are accepted if it does not decrease further; at `COMPUTED` iterations stop."""

SMALL = 1e-5
"""Small compliance, relative to the largest diagonal entry of W: the error of the extrapolation to zero is
its square, 10⁻¹⁰."""

LARGE = 0.1
"""Compliance, relative to the same, from whose solution those of small ones are continued. Where there are
two at small compliances, one is left; at `SOFTEST` the start of Newton's method could still choose."""

# ---- Coulomb's law in the velocities

SOFTEST = 3e-3
"""Largest r of (16.3), relative to the largest diagonal entry of W. Larger values require more iterations,
smaller ones more steps of Newton's method in each."""

SETTLED = 1e-9
"""Change of velocities by f⁺ − f, relative to u_free, at which the iteration ends if rounding allows it."""

STALLED = 1e-5
"""The same, at which it ends if `PATIENCE` iterations have not halved the change."""
