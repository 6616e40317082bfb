"""When a motion makes no progress, gains energy from friction or has too many impacts."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ..contact_space.simultaneous import LAST
from ..errors import IrregularMotionError, SimulationError
from ..robot.pinocchio_bridge import kinetic_energy
from ._kernels.tolerances import PROGRESS, STALLED
from .dense_step import DenseStep
from .hybrid_state import HybridState
from .instant import Instant
from .options import Options

MAX_STALLED = 200
"""Steps without progress after which a simulation gives up."""

WHOLE = 0.999
"""Part of a step that is covered if no event ends it: the end of a run rounds its length."""

BY_EVENTS = 0.5
"""Part of the steps that end at an event from which it is events that make steps short, and no control."""

RUBBING = slice(1, 3)
"""Which of the works are those of friction, in joints and in contacts: it takes energy."""

DRIFTED = 1e4
"""By how much closed contacts may drift in a step, in parts of the tolerance of its length: in random scenes
it is less than two of them, some hundred where a joint and a contact hold nearly the same motion."""

GAINED = 10.0
"""Factor on the relative error of velocities: the part of the kinetic energy that friction may give."""

ROLLING = 2.0
"""Friction of what sticks and rolls, in parts of the weight and of what controls and drives press with: over
the error of velocities it does work that grows with time and is no gain. A point that rolls has two of them,
that of the body and that by its turning. In one step, friction may give what its own impulse does over that
error."""


def ended(instant: Instant, count: int) -> int:
    """Return how many of the last steps, a number of them, have ended at an event."""
    return sum(step.end - step.start < WHOLE * step.h for step in instant.record.dense_steps[-count:])


class Progress:
    """Watches over a motion, of a size [m] and time scale [s]; `jumps` if it has a control that may jump."""

    def __init__(
        self, model: pin.Model, options: Options, instant: Instant, sizes: tuple[float, float], jumps: bool
    ) -> None:
        self._model, self._options, self._instant, self._jumps = model, options, instant, jumps
        self._state: HybridState = instant.state
        extent, self._time_scale = sizes
        self._speed = extent / self._time_scale
        self._weight = float(np.linalg.norm(model.gravity.linear)) * pin.computeTotalMass(model)
        self._little = self._weight * options.rtol * extent
        self._tolerance = options.rtol * extent + options.atol

    def mark(self) -> None:
        """Note that there is progress."""
        state = self._state
        state.marked = state.steps, state.t, state.v

    def stalled(self, scale: float) -> IrregularMotionError | None:
        """Return why not to continue where steps make no progress, or None; `STALLED` is a part of scale."""
        state, (steps, then, velocity) = self._state, self._state.marked
        count = state.steps - steps
        if count <= MAX_STALLED:
            return None
        covered, t = state.t - then, state.t
        dynamics = self._instant.dynamics
        moved, fastest = dynamics.fastest(state.v - velocity), dynamics.fastest(velocity)
        # at rest velocities change by errors alone, which are small beside those of the scene's scales
        stays = covered < PROGRESS * self._time_scale and moved <= PROGRESS * max(fastest, self._speed)
        if self._jumps and stays and ended(self._instant, count) < BY_EVENTS * count:
            return IrregularMotionError(
                f"control: it jumps again and again, or is too stiff, at t = {t:.6g} s, "
                f"where {count} steps cover {covered:.2g} s; "
                "give dry friction as the model's friction, which also holds joints at rest, and sample a "
                "control that switches, with period="
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
        """Refuse a step in which what is closed drifts by far more than the error of a step.

        Raises:
            IrregularMotionError: See above.
        """
        drift = self._instant.dynamics.work.drift_at_end
        if drift > DRIFTED * self._tolerance:
            raise IrregularMotionError(
                f"contacts: the constraint drift reaches {drift:.3g} m or m/s in a step at "
                f"t = {self._state.t:.6g} s, so that the conditions of their modes contradict each other"
            )

    def check_friction(self, step: DenseStep, until: float) -> None:
        """Refuse a step until whose event friction has given energy.

        Raises:
            IrregularMotionError: See above.
        """
        state, work = self._state, self._instant.dynamics.work
        joints, contacts = state.works[RUBBING].tolist()
        least_joints, least_contacts = state.rubbed
        state.rubbed = least_joints, least_contacts = min(joints, least_joints), min(contacts, least_contacts)
        by_joints, by_contacts = step.work_at(until)[RUBBING].tolist()
        gained = max(by_joints - least_joints, by_contacts - least_contacts)
        at_once = max(by_joints - joints, by_contacts - contacts)
        if not gained > self._little:
            return
        error = self._instant.dynamics.error(state.v)
        forces = float(np.abs(work.contact_force[:, :2]).sum() + np.abs(work.scalar_force).sum())
        rounding = 4.0 * math.ulp(max(abs(by_joints), abs(by_contacts)))  # of sums that grow step by step
        pressed = self._weight + float((np.abs(work.control_force) / work.joint_metres).sum())
        too_much = gained > self._little + pressed * ROLLING * error * until + rounding
        too_much |= at_once > self._little + forces * error * (until - step.start) + rounding
        kinetic = kinetic_energy(self._model, self._instant.data, state.q, state.v)
        if too_much and gained * self._instant.dynamics.fastest(state.v) > GAINED * error * kinetic:
            raise IrregularMotionError(
                f"scene: friction would give {gained:.3g} J at t = {state.t:.6g} s, so that the modes of "
                "contact are none; a smaller rtol may help"
            )

    def count_impacts(self, before: int) -> None:
        """Count the instant at which the impacts from a number on have taken place.

        Raises:
            SimulationError: There are too many.
        """
        state, impacts = self._state, self._instant.record.impacts
        self.mark()  # `max_impacts` watches over impacts
        state.struck += before == 0 or impacts[before - 1].time < state.t
        if state.struck > self._options.max_impacts:
            last = ", ".join(f"{record.source!r} ({record.time:.9g} s)" for record in impacts[-LAST:])
            raise SimulationError(
                f"max_impacts: impacts at {state.struck} instants until t = {state.t:.6g} s, "
                f"the last at {last}; "
                "if they accumulate, a larger resting_speed or a smaller restitution ends them, "
                "otherwise raise max_impacts",
                value=self._options.max_impacts,
            )
