"""Checks of a motion: lack of progress, constraint drift, energy gained by friction, number of impacts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..contact_space.simultaneous import LAST
from ..errors import IrregularMotionError, SimulationError
from ..robot.pinocchio_bridge import kinetic_energy
from ._kernels.tolerances import PROGRESS, STALLED
from .dense_step import FRICTION, WHOLE, DenseStep
from .hybrid_state import HybridState
from .instant import Instant
from .options import Options

MAX_STALLED = 200
"""Number of steps without progress after which a simulation stops."""

BY_EVENTS = 0.5
"""Fraction of steps that end at events from which on events, and not a control, make the steps short."""

DRIFTED = 1e4
"""Largest constraint drift in a step, relative to the tolerance of positions: in random scenes the ratio is
below 2, and about 100 where a joint and a contact constrain nearly the same motion."""

GAINED = 10.0
"""Largest part of the kinetic energy that friction may add, relative to the relative error of velocities."""

ROLLING = 2.0
"""Friction of sticking and rolling contacts, relative to the weight plus the forces of controls. Acting over
the error of velocities it does work that grows with time without being a gain. A rolling point has two such
errors: of the velocity of the body, and of its rotation."""


def ended(instant: Instant, count: int) -> int:
    """Return how many of the last `count` steps have ended at an event."""
    return sum(step.end - step.start < WHOLE * step.h for step in instant.record.dense_steps[-count:])


class Progress:
    """Checks of a motion.

    Args:
        model: The model.
        options: Tolerances, and the largest number of impacts.
        instant: Holds the state, the record and the dynamics.
        sizes: Size [m] and time scale [s] of the scene.
        jumps: Whether there is a control that may be discontinuous.
    """

    def __init__(
        self, model: pin.Model, options: Options, instant: Instant, sizes: tuple[float, float], jumps: bool
    ) -> None:
        self._model, self._options, self._instant, self._jumps = model, options, instant, jumps
        self._state: HybridState = instant.state
        extent, self._time_scale = sizes
        self._speed, self._error = extent / self._time_scale, options.rtol * extent
        self._weight = float(np.linalg.norm(model.gravity.linear)) * pin.computeTotalMass(model)
        self._little = instant.dynamics.work.gain_tolerance = self._weight * self._error
        self._tolerance = self._error + options.atol

    def mark(self) -> None:
        """Restart the check of progress at the present state."""
        state = self._state
        state.marked = state.steps, state.t, state.v

    def stalled(self, scale: float) -> IrregularMotionError | None:
        """Return an error if the last `MAX_STALLED` steps made no progress, else None.

        Args:
            scale: Time to which `STALLED` is relative [s].
        """
        state, (steps, then, velocity) = self._state, self._state.marked
        count = state.steps - steps
        if count <= MAX_STALLED:
            return None
        covered, t = state.t - then, state.t
        dynamics = self._instant.dynamics
        moved, fastest = dynamics.fastest(state.v - velocity), dynamics.fastest(velocity)
        # at rest, velocities change only by errors, which are small relative to the scales of the scene
        stays = covered < PROGRESS * self._time_scale and moved <= PROGRESS * max(fastest, self._speed)
        if self._jumps and stays and ended(self._instant, count) < BY_EVENTS * count:
            return IrregularMotionError(
                f"control: it is discontinuous or too stiff at t = {t:.6g} s, where {count} steps "
                f"cover {covered:.2g} s; give dry friction as the model's friction, which also holds joints "
                "at rest, and sample a control that switches by period="
            )
        least = max(PROGRESS * fastest, self._instant.dynamics.error(velocity))
        if not (moved > least or covered > STALLED * scale):
            return IrregularMotionError(
                f"scene: {count} steps at t = {t:.6g} s without progress; the contact modes do not "
                "converge; a larger resting_speed may help"
            )
        self.mark()
        return None

    def check_drift(self) -> None:
        """Check that the constraint drift in a step is not far larger than the tolerance.

        Raises:
            IrregularMotionError: It is.
        """
        drift = self._instant.dynamics.work.drift_at_end
        if drift > DRIFTED * self._tolerance:
            raise IrregularMotionError(
                f"contacts: the constraint drift reaches {drift:.3g} m or m/s in a step at "
                f"t = {self._state.t:.6g} s, so that the conditions of their modes contradict each other"
            )

    def check_friction(self, step: DenseStep, until: float) -> None:
        """Check that friction adds no energy in a step up to a time [s]. (theory.md, 11.7)

        Raises:
            IrregularMotionError: It does.
        """
        state, work = self._state, self._instant.dynamics.work
        done = (step.work_at(until) - step.w)[FRICTION]
        gained, at_once = float((work.start_gain + done).max()), float(done.max())
        if not gained > self._little:
            return
        error = self._instant.dynamics.error(state.v)
        forces = float(np.abs(work.contact_force[:, :2]).sum() + np.abs(work.scalar_force).sum())
        pressed = self._weight + float((np.abs(work.control_force) / work.joint_metres).sum())
        state.pressed = max(state.pressed, pressed)
        little = state.pressed * self._error
        too_much = gained > little + pressed * ROLLING * error * until
        too_much |= at_once > little + forces * error * (until - step.start)
        kinetic = kinetic_energy(self._model, self._instant.data, state.q, state.v)
        if too_much and gained * self._instant.dynamics.fastest(state.v) > GAINED * error * kinetic:
            raise IrregularMotionError(
                f"scene: friction would add {gained:.3g} J at t = {state.t:.6g} s, so that the contact modes "
                "are wrong; a smaller rtol may help"
            )

    def count_impacts(self, before: int) -> None:
        """Count the present instant for `max_impacts`; `before` is the number of impacts recorded before it.

        Raises:
            SimulationError: There are too many instants with impacts.
        """
        state, impacts = self._state, self._instant.record.impacts
        if before == 0 or impacts[before - 1].time < state.t:
            self.mark()  # these are bounded by `max_impacts` and not by progress
            state.struck += 1
        if state.struck > self._options.max_impacts:
            last = ", ".join(f"{record.source!r} ({record.time:.9g} s)" for record in impacts[-LAST:])
            raise SimulationError(
                f"max_impacts: impacts at {state.struck} instants until t = {state.t:.6g} s, "
                f"the last at {last}; "
                "if they accumulate, a larger resting_speed or a smaller restitution ends them, "
                "otherwise raise max_impacts",
                value=self._options.max_impacts,
            )
