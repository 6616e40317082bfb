"""Tolerances of motions, each with its unit or what it is relative to, and the reason for its value."""

from __future__ import annotations

from ..._numeric.tolerances import COMPUTED, HALF_DIGITS, LITTLE, NOISE, SETTLED, UNDETERMINED
from ..._numeric.tolerances import ROUNDING as ROUNDING

# ---- defaults of options

RTOL, ATOL = 1e-8, 1e-10
"""Relative and absolute tolerance of steps."""

DT = 1e-3
"""Step size of time stepping [s]."""

# ---- accelerations and forces of the active set

NEGLIGIBLE = UNDETERMINED
"""What is taken as zero where forces are not unique. (11.10)"""

ROUNDED = COMPUTED
"""The same where forces are unique. (11.10)"""

LEAST_SIZE = LITTLE * 9.80665
"""Least sum of terms to which accelerations are compared [m/s²]: a thousandth of gravity."""

WEIGHTLESS = 1e-10
"""Force that is taken as zero, relative to the largest load of its row: weight, torques, forces. (11.13)"""

AT_BOUND = NEGLIGIBLE
"""Distance from a bound, relative to the bound, at which a drive effort or a friction force is at it."""

SINGULAR_STILL = 1e-7
"""Pivot, relative to the largest, that is taken as zero once a pivot has been below `RANK`. The larger value
keeps the rank from alternating in a motion close to a singular state: redundant rows contradict each other by
the errors of a step. Rows are scaled, see `solve_redundant`."""

FINEST = NOISE
"""The same where `SINGULAR_STILL` leaves residuals above `NEGLIGIBLE`, as for the sticking tip of an arm
within 10⁻⁴ rad of being stretched. Rounding is at 10⁻¹⁵."""

AMBIGUOUS = 0.1
"""Ratio of a pivot to `SINGULAR_STILL`, or its inverse, above which the tolerance is lowered below the pivot:
the order in which equal rows are eliminated changes its size by factors like this."""

UNDECIDED = 0.0
"""The same before it has been decided."""

DOUBTFUL = RTOL
"""Violation of force bounds, relative to the largest force, that the error of a step alone can cause."""

# ---- velocities

STILL = LITTLE
"""Speed, relative to the sticking speed, that is taken as zero: slip keeps its reference direction and does
not reverse, and the choice of modes has converged when it removes no more."""

DIFFERENT = 1e-5
"""Singular value of rows, relative to the largest, below which rows are redundant. It is `NEGLIGIBLE` if
this changes the impulses little."""

RESTING = 1e-4
"""Default resting speed, relative to √(g L): such a bounce rises by 5·10⁻⁹ of the robot size L."""

# ---- impacts without collision

SINGULAR = HALF_DIGITS
"""Fraction to which effects of forces cancel at a singularity. (13.3)"""

NEARLY_SINGULAR = 1e-4
"""The same, and s* − 1, where steps make no progress or the singularity has been passed (theory.md, 13.3);
also the sine of the tilt of a rim that is about to fall flat."""

# ---- steps and their events

PROGRESS = LITTLE
"""Change of time, relative to the time scale of the scene, or of velocities that a number of steps must
exceed to be progress."""

STALLED = 1e-8
"""Time that is no progress [s]; relative to the duration if that is below 1 s."""

LEAST_AHEAD = 1e-9
"""Shortest look-ahead, relative to a step, to choose modes that begin without a jump. (theory.md, 11.6)"""

ITERATED = 1e-2
"""Relative to the tolerance of a step, the residual of its implicit equations; also the least previous error
from which the step size control derives a trend."""

FIRST_STEP = LITTLE
"""Length of the first time step after a switch from the event-driven scheme, relative to the step size:
contacts that arrive without restitution stop in it, without moving far."""

STEPS_TOUCH = 1e-8
"""Gap, relative to the robot size, up to which approaching contacts take part in an impact of time stepping,
and overlap that may remain at the end of a step. It is the constraint drift of the midpoint rule in a step
of 1 ms, which would otherwise separate simultaneous impacts."""

STEPS_SLACK = 4.0
"""Closing of a gap within a time step in addition to its rate, in units of h² g. Overlap of this size can
arise within a step; it is removed at the end."""

STEPS_TOGETHER = 1e-2
"""Fraction of a step within which impacts are simultaneous: gaps are extrapolated from the midpoint."""

STEPS_LONGER = 2.0
"""Largest ratio of the lengths of a step and the one before whose mean impulses predict its own: after an
impact, the short remainder of a step stops a velocity, and a longer step would predict a multiple of that."""

STEPS_SHORTEST = 2.0**-10
"""Smallest fraction of a time step by repeated halving: flat shapes have no thickness that would end it, and
times must differ by more than rounding."""

STEPS_STILL = 1e-5
"""Speed, relative to the resting speed, that is taken as zero, so that slip is stick: the error of the
contact problem."""

STEPS_GAIN = 1e-4
"""Energy that contacts may add in a step, relative to the kinetic energies of v and of the impulses. The
change of the rows over a step adds some 10⁻⁶, but much more near singular postures. (theory.md, 16)"""

STEPS_LEFT = 10.0 * SETTLED
"""Change of a velocity in a step, relative to that by the impulses, up to which an island is at rest: a
larger one is motion that begins, and not an error of the contact problem."""

TURN = 1e-2
"""Angle [rad] below which its functions are computed as series whose next terms are below rounding."""

# ---- starts

START_ROUNDING = 2e-9
"""Overlap at the start [m] that is attributed to rounding. Time steps may leave more, see `STEPS_SLACK`; the
event-driven scheme does not start there."""

HELD_GAP = LITTLE
"""Largest gap of held contacts at the start, relative to the robot size; the gap is kept."""

# ---- derivatives

REMAINS = 1e-4
"""Residual of vanishing velocities after an event, relative to their changes, and jump of accelerations at an
event without a jump, that derivatives tolerate."""

LEAST_INTERVAL = HALF_DIGITS
"""Interval next to the beginning or end of slip, relative to a step, over which derivatives are constant but
for the event itself."""

STEPS_DRIFT = 1e-2
"""Change of a closed gap, relative to the change of the state, that is attributed to constraint drift, which
is of the order of h ω."""

STEPS_STABLE = 2.0
"""Largest `stiffness` of a time step: the explicit midpoint multiplies a velocity that a control damps by
1 + z + z²/2, which grows for z = −`stiffness` < −2."""
