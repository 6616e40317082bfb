"""Tolerances of motions. Each says what it is a part of, or its unit, and why it has its size."""

from __future__ import annotations

from ..._numeric.tolerances import COMPUTED, HALF_DIGITS, LITTLE, NOISE, SETTLED
from ..._numeric.tolerances import ROUNDING as ROUNDING

# ---- defaults of options

RTOL, ATOL = 1e-8, 1e-10
"""Tolerances of steps, relative and absolute."""

DT = 1e-3
"""Length of time steps [s]."""

# ---- accelerations and forces of what is closed

NEGLIGIBLE = 1e-9
"""Part of what makes up an acceleration, or an inverse inertia, below which it is none, where forces may be
shared in several ways: their error is larger than rounding by the condition of the shares."""

ROUNDED = COMPUTED
"""The same where forces are unique. (11.10)"""

LEAST_SIZE = LITTLE * 9.80665
"""What makes up an acceleration counts as this at the least [m/s²]: a thousandth of gravity."""

WEIGHTLESS = 1e-10
"""Part of the robot's weight below which a force is none."""

AT_BOUND = NEGLIGIBLE
"""Part of a bound within which what is limited is at it: efforts of drives, friction that holds."""

SINGULAR_STILL = 1e-7
"""Part of the largest pivot below which one is zero where pivots have been below `RANK`, lest a motion along
the edge goes to and fro."""

FINEST = NOISE
"""The same where that misses accelerations by more than `NEGLIGIBLE`: a leg of 1 kg, stretched but for
10⁻⁵ rad, bears a load, beside the stop of a finger of 10 g. Rounding is at 10⁻¹⁵."""

DOUBTFUL = RTOL
"""Part of the largest force by which others may miss their bounds for the error of a step alone."""

# ---- velocities

STILL = LITTLE
"""Part of the speed of sticking below which a speed is none: slip has no direction of its own, does not
reverse, and what modes stop of it changes nothing."""

DIFFERENT = 1e-5
"""Part of the largest by which rows of velocities differ at least from each other, else they are the same;
where what the difference asks for is little, it is `NEGLIGIBLE`."""

RESTING = 1e-4
"""The default resting speed, in parts of √(g L): such a bounce rises 5·10⁻⁹ of the robot's size L."""

# ---- impacts without collision

SINGULAR = HALF_DIGITS
"""Forces whose effects cancel to this part are those of a singularity."""

NEARLY_SINGULAR = 1e-4
"""How near a singularity is where it has let no step be short enough, or has been passed: the part to which
the effects of forces cancel, or friction is too small, and the sine of the tilt of a rim."""

NUDGE = HALF_DIGITS
"""Part of the speed of slip at which contacts that jam are let approach; it grows to what it can."""

LEAST_NUDGE = 0.1 * NUDGE
"""Part of the fastest slip that this is at least."""

# ---- steps and their events

PROGRESS = LITTLE
"""Part of the scene's time scale, or of velocities, that a number of steps has to change."""

STALLED = 1e-8
"""Time [s] that is no progress, or that part of a duration below 1 s."""

LEAST_AHEAD = 1e-9
"""How far to look ahead for modes that begin without a jump at the least, in parts of a step."""

ITERATED = 1e-2
"""Part of the tolerance of a step to which its implicit equations are solved. Less than that says nothing of
the trend of its error, by which the next step grows."""

FIRST_STEP = LITTLE
"""Part of a time step that the first one of a crossing takes: what arrives without restitution is stopped in
it, where it is."""

STEPS_TOUCH = 1e-8
"""Part of the robot's size within which what approaches takes part in an impact in time steps, and up to
which overlap at the end of one is left: the drift of the midpoint rule in a step of a millisecond, which
would otherwise put impacts of one instant one after another."""

STEPS_SLACK = 4.0
"""What gaps may close by within a time step beside their rates, in parts of h² g. Within a step nothing keeps
what closes from overlapping by as much; its end takes it away."""

STEPS_TOGETHER = 1e-2
"""Part of a step within which what closes collides together: gaps are extrapolated from the midpoint."""

STEPS_SHORTEST = 2.0**-10
"""Part of a time step below which it is not halved: flat shapes that may pass through each other have no
thickness, and times are to differ by more than rounding."""

STEPS_STILL = 1e-5
"""Part of the resting speed up to which velocities are none and slip is stick: what the contact problem
leaves at rest."""

STEPS_GAIN = 1e-4
"""Part of the kinetic energy of a step and its impulses that contacts may add to it, against their surfaces:
what rows that bend miss is some 1e-6, and all of it next to singular postures."""

STEPS_LEFT = 10.0 * SETTLED
"""Part of what impulses change of velocities that the contact problem leaves at rest: what changes by more
has begun to move, however little that is after a short step."""

TURN = 1e-2
"""Angle [rad] below which functions of it are series, whose next terms are below rounding."""

# ---- starts

START_ROUNDING = 2e-9
"""A start that is this far [m] below a surface or beyond a limit is one at it, but for rounding. Time
steps may leave more, see `STEPS_SLACK`; the event-driven scheme does not start there."""

HELD_GAP = LITTLE
"""Held contacts start within this part of the robot's size from their surfaces; what gap is left is kept."""

# ---- derivatives

REMAINS = 1e-4
"""Part of the changes of velocities that vanish that an event may leave of them, and by which accelerations
may differ at one that does not change them."""

LEAST_INTERVAL = HALF_DIGITS
"""Part of a step next to where slip begins or ends in which nothing changes but by the event itself."""

STEPS_DRIFT = 1e-2
"""Part of a change by which that of a closed gap may be more than zero: constraint drift, some h ω."""
