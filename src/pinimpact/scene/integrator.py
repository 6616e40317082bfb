"""Event-driven integration: smooth steps up to the next event, then impacts and new contact modes.

The methods are in theory.md, sections 8 to 12; docs/architecture.md describes the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..errors import InputError, IrregularMotionError
from ..robot.names import coordinate_names
from ._kernels import smooth_motion
from ._kernels.events.consequences import ARRIVAL
from ._kernels.events.registry import EVENTS, force_bound, gap, saturation
from ._kernels.tolerances import NEARLY_SINGULAR, ROUNDING
from .controls import Control, JointPD, SampledControl
from .dense_step import FRICTION, DenseStep
from .event_watch import EventWatch, Interruption
from .events import as_events
from .forces import ClosedSet, EvaluatedForces
from .hybrid_state import HybridState
from .instant import Arriving, Instant
from .mode_intervals import drive_name
from .options import Options
from .progress import Progress
from .recorder import Mark
from .rims import Tilting
from .scene import Scene
from .shape_watch import Meeting
from .smooth_steps import Outcome, SmoothSteps
from .start import state_at
from .step_uniqueness import StepUniqueness, step_tolerances
from .switched_off import altered_model
from .trajectory import Trajectory

Report = Callable[[float, float], None]
"""report(t, duration), called after every step."""

SEEN_EVERY = 0.25
"""Longest interval between evaluations of user functions, relative to the scene's time scale: a smooth force
that sets in after a long rest is detected, unless it lasts less than about a hundredth of that scale."""


def _restore(
    kind: type[Integrator], arguments: tuple[Any, ...], state: HybridState, record: tuple[Any, ...]
) -> Integrator:
    """Return an integrator that continues from a state and a record."""
    scene, q0, v0, options = arguments
    integrator = kind(scene, q0, v0, options, state)
    integrator.record.restore(record)
    integrator.reached = integrator.mark()
    return integrator


class Integrator:
    """A motion that starts at q0 (nq,) and v0 (nv,), or continues from a state.

    Attributes:
        state: The present state.
        record: The record of the motion so far.
        instant: Resolves impacts and sets contact modes at one instant.
        smooth: Computes steps of smooth motion.
        dynamics, work: The smooth dynamics, and the workspace of their kernels.
        reached: Length of the record and state at the last time at which both were consistent.
    """

    def __init__(
        self, scene: Scene, q0: ArrayLike, v0: ArrayLike, options: Options, state: HybridState | None = None
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"scene: {type(scene).__name__} given; a Scene is expected", value=scene)
        scene = scene.fixed()
        self._arguments = scene, q0, v0, options
        self.scene, self.options, without = scene, options.checked(), scene.without
        model = self.model = altered_model(scene.model, without)
        layout = scene.layout()
        self.data = layout.data_for(self, model)
        self.state = state_at(model, self.data, q0, v0) if state is None else state.copy(memory=None)
        self.instant = Instant(scene, model, self.data, self.state, state is None, self.options.dt)
        self.record, self.dynamics = self.instant.record, self.instant.dynamics
        self.shapes, self.rims = self.instant.shapes, self.instant.rims
        work = self.work = self.dynamics.work
        work.rtol, work.atol = self.options.rtol, self.options.atol
        work.drift_tolerance = self.shapes.tolerance = max(work.touching_gap, work.atol)
        self.switched_off = scene.plan().switched_off if without else ()
        names = (drive_name(model, j) for j in work.drive_velocity.tolist())
        self.sources = (*layout.sources, *names)
        self.extent, self.time_scale = layout.extent, scene.time_scale
        seen_every = SEEN_EVERY * self.time_scale
        guards = as_events(scene.events) if "user events" not in without else ()
        self.events = EventWatch(guards, seen_every, self.state, self.record.events)
        self.sampled = None
        self._continuous: Control | None = None
        if scene.control is not None and "control" not in without:
            if scene.period is not None:
                control = scene.control.drives(model) if isinstance(scene.control, JointPD) else scene.control
                self.sampled = SampledControl(control, scene.period, scene.delay)
            elif not isinstance(scene.control, JointPD):
                self._continuous = scene.control
        sizes = self.extent, self.time_scale
        self.progress = Progress(model, self.options, self.instant, sizes, self._continuous is not None)
        longest = math.inf if self._continuous is None else seen_every
        longest = longest if self.options.max_step is None else self.options.max_step
        self.smooth = SmoothSteps(self.instant, longest, self._continuous is not None)
        self._prepare()
        if state is not None:
            self._continue_with(state)
            return
        self.progress.mark()
        self._sample()
        self.reached = self.mark()

    def _prepare(self) -> None:
        """Initialize data of the scheme; subclasses override this."""

    def _continue_with(self, state: HybridState) -> None:
        """Restore the workspace of the kernels from `state.memory`."""
        if state.memory is not None:
            values, directions = state.memory
            self.dynamics.set_values(values)
            self.shapes.continue_with(directions)

    def value(self) -> HybridState:
        """Return the complete state, including the workspace, for copies, pickling and comparison."""
        directions = self.shapes.directions
        apart = None if directions is None else directions.copy()
        return self.state.copy(memory=(self.dynamics.values(), apart))

    def set_value(self, value: HybridState) -> None:
        """Restore the result of `value`, of this motion or another one of the same scene."""
        self.state.assign(value.copy(memory=None))
        self._prepare()
        self._continue_with(value)

    def copy(self, spare: Integrator | None = None) -> Integrator:
        """Return an independent motion in the same state; `spare`, one of the same scene, is overwritten."""
        if spare is None:
            make, arguments = self.__reduce__()
            return make(*arguments)
        spare.record.restore(self.record.values())
        spare.set_value(self.value())
        spare.reached = spare.mark()
        return spare

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the scene, the state and the record; workspaces and addresses are rebuilt."""
        return _restore, (type(self), self._arguments, self.value(), self.record.values())

    def mark(self) -> tuple[Mark, HybridState]:
        """Return the length of the record and the state, to return to after an interrupt or an error."""
        return self.record.mark(), self.state.copy()

    def begin(self, tau: Array | None = None) -> None:
        """Process the impacts and events at the start and begin the smooth motion.

        Args:
            tau: (nv,) constant generalized force, or None.
        """
        if self.sampled is not None:
            tau = self.sampled.at(self.state.t, self.state.q, self.state.v)
        if tau is not None:
            self.work.control_force[:] = tau
        if self.state.overlap is not None:
            raise IrregularMotionError(self.state.overlap, field="q0")
        self.instant.settle(starting=True)
        self._trigger_events()
        self._begin_motion()
        self._rest_on_edges()
        self.state.length = self.dynamics.first_length()

    def advance(self, until: float, report: Report | None = None, tau: Array | None = None) -> None:
        """Advance to a time, or until an event ends the motion.

        Args:
            until: The time [s].
            report: Called after every step.
            tau: (nv,) constant generalized force from the present time on; None: it remains the same.
        """
        state, sampled = self.state, self.sampled
        while state.t < until and state.ended_by is None:
            stop = until
            if sampled is not None and sampled.next < until - ROUNDING * until:
                stop = sampled.next
            begun = None if tau is None else self.hold_force(tau, stop - state.t)
            self.progress.mark()
            while state.t < stop and state.ended_by is None:
                if begun is None or not self._completes(begun, stop):
                    state.length = self._step(state.length, stop, min(1.0, until), begun)
                self.reached, begun = self.mark(), None
                if report is not None:
                    report(state.t, until)
            tau = None
            if sampled is not None and stop < until and state.ended_by is None:
                tau = sampled.at(state.t, state.q, state.v)

    def hold_force(self, tau: Array, left: float) -> Outcome | None:
        """Replace the constant generalized force from the present time on.

        Args:
            tau: (nv,) the force.
            left: Time until it changes again [s].

        Returns:
            A step of this length, if one was computed in the same call.
        """
        continues, outcome = self.smooth.replace_force(tau, left)
        if not continues:
            self._begin_motion()
            if not smooth_motion.modes_continue(self.work):
                self._settle_and_begin()
        return outcome

    def resume(self) -> None:
        """Continue a motion that an event may have ended, and restart the count for `max_impacts`."""
        self.state.struck = 0
        if self.state.ended_by is not None:
            self.state.ended_by = None
            self._settle_and_begin()

    def trajectory(self, termination: str, complete: bool) -> Trajectory:
        """Return the trajectory up to the last consistent state."""
        (mark, state), arguments = self.reached, self._arguments
        contacts = self.instant.names[: self.work.contacts]
        return self.record.trajectory(
            mark,
            joints=self.work.joint_charts,
            termination=termination,
            complete=complete,
            switched_off=self.switched_off,
            statistics={
                "steps": state.steps,
                "rejected": state.rejected,
                "evaluations": self.work.evaluations,
            },
            sources=self.sources,
            forces=EvaluatedForces(
                lambda: Integrator(*arguments).dynamics, self._step_uniqueness(), contacts
            ),
            contacts=(*self.scene.contacts, *self.scene.held),
            coordinates=coordinate_names(self.model),
            stepped=state.stepped,
        )

    def _step_uniqueness(self) -> StepUniqueness:
        return StepUniqueness(self.model, *step_tolerances(self.work, self.extent))

    def _sample(self) -> None:
        state = self.state
        self.record.samples.append((state.t, state.q, state.v, state.works, state.impact_energy))

    def _begin_motion(self) -> None:
        """Evaluate the smooth dynamics at the present state, from which the next step starts."""
        state, work = self.state, self.work
        if state.touching:
            self.shapes.review()
        self.dynamics.set_saturation(state.q, state.v)
        state.bounce = self.dynamics.begin(state.t, state.q, state.v)
        doubtful = self.dynamics.doubtful_margin
        if work.force_margin > doubtful:
            work.least_margin = 0.0
        elif work.least_margin < 0.0:  # forces at their bounds may leave them later
            yields = not work.forces_unique and work.force_margin >= -doubtful
            work.least_margin = -2.0 * doubtful if yields else -math.inf
        unique = work.forces_unique
        if state.forces_unique and not unique:
            self.instant.note("The contact forces are not unique; those of equally stiff contacts are used.")
        state.forces_unique = unique
        state.closed = ClosedSet.of(work, self.shapes.swapped())

    def _rest_on_edges(self) -> None:
        """Begin the motion anew if edges or corners that meet at rest carry a force. (theory.md, 15.3)"""
        state, n = self.state, self.work.nv
        if self.shapes:
            meeting = self.shapes.rest(state.q, state.v, self.work.stage_rates[0, n : 2 * n])
            if meeting:
                self._settle_and_begin(meeting)

    def _step(self, h: float, stop: float, scale: float, begun: Outcome | None = None) -> float:
        """Take one accepted step, or its part up to the first event.

        Args:
            h: Step size to try [s].
            stop: Latest end of the step [s].
            scale: Time to which the limit `STALLED` of progress is relative [s].
            begun: The step, if it is computed already.

        Returns:
            The step size to try next [s].
        """
        state, work, t = self.state, self.work, self.state.t
        outcome = begun or self.progress.stalled(scale) or self.smooth.compute(h, stop - t)
        if isinstance(outcome, IrregularMotionError):
            return self._resolve_jam_or_raise(outcome)
        step, natural, time, *_ = outcome
        state.steps += 1
        regular = work.regular
        if not regular:
            self.progress.check_drift()
            self.progress.check_friction(step, min(time, step.end))
        self.record.dense_steps.append(step)
        arriving = self._arriving() if time <= step.end else None
        meeting = None
        if self.shapes:
            meeting = self.shapes.within(step, min(time, step.end))
            if meeting is not None:
                time, arriving = meeting.time, None
        tilting = self.rims.tilting(step, min(time, step.end)) if state.flat else None
        if tilting is not None:
            time, arriving, meeting = tilting.time, None, None
        if self.events:
            interruption = self.events.within(step, min(time, step.end))
            if interruption is not None:
                self._interrupt(step, interruption)
                return natural
        if tilting is not None:
            self._end_at_tilting(step, tilting)
            return natural
        if meeting is not None:
            self._end_at_meeting(step, meeting)
            return natural
        if time <= step.end:
            self._end_at_event(step, time, arriving)
            return natural
        self._advance_over(outcome, stop)
        if not regular:
            self._check_end()
        fallen = self.rims.fallen() if self.rims else []
        if fallen:
            self._settle_and_begin(fallen)
        self._sample()
        return state.length

    def _completes(self, outcome: Outcome, stop: float) -> bool:
        """Accept a step in which nothing happens, and return whether it was one; others are for `_step`."""
        step, _, time, *_ = outcome
        if time <= step.end or not self.work.regular or self.shapes or self.events or self.rims:
            return False
        self.state.steps += 1
        self.record.dense_steps.append(step)
        self._advance_over(outcome, stop)
        self._sample()
        return True

    def _advance_over(self, outcome: Outcome, stop: float) -> None:
        """Advance the state to the end of a step without an event, and set the step size to try next."""
        state, (step, natural, _, state.q, state.v) = self.state, outcome
        state.works, state.bounce = step.work_at(step.end), math.inf
        state.length, state.cut_short = step.h * self.work.growth, step.h == stop - state.t
        if state.cut_short:
            state.length, step.end = max(state.length, natural), stop
        state.t = step.end

    def _check_end(self) -> None:
        """Choose modes again if forces are beyond their bounds after a step; correct constraint drift."""
        work = self.work
        beyond = work.least_margin < 0.0 and not work.end_margin >= 0.0
        if beyond:
            self._note_violated_bounds(-work.end_margin)
            self._settle()
            self._begin_motion()
            return
        work.least_margin = 0.0
        if work.drift_at_end > work.drift_tolerance:
            self.instant.correct_constraint_drift()
            self._begin_motion()

    def _note_violated_bounds(self, excess: float) -> None:
        """Note once that forces exceed their bounds by more than the tolerance."""
        tolerance = self.work.rtol * np.abs(self.work.solution).max(initial=0.0)
        if self.work.forces_unique and excess > tolerance and not self.state.forces_beyond:
            self.state.forces_beyond = True
            beyond = f"Contact forces exceed the bounds of the contact modes by {excess:.3g} N or N m"
            if math.isinf(excess):
                beyond = "Slip in these contact modes has a negative normal acceleration"
            self._report_violation(f"{beyond}, and no other modes were found")

    def _report_violation(self, text: str) -> None:
        """Note that the forces violate Coulomb's law."""
        self.instant.note(f"{text}. The motion may be wrong; near Painlevé's paradox no solution may exist.")

    def _arriving(self) -> int | None:
        """Return the number of the contact or limit whose gap closes at the event last located, or None."""
        event = EVENTS[self.work.event_kind]
        if event.CONSEQUENCE != ARRIVAL:
            return None
        return self.work.event_index + (0 if event is gap else self.work.contacts)

    def _resolve_jam_or_raise(self, error: IrregularMotionError) -> float:
        """Resolve an impact without collision near a singularity; return the step size to try next [s].

        Raises:
            IrregularMotionError: `error`, if there is no such impact.
        """
        if not self.instant.resolve_jam(NEARLY_SINGULAR):
            raise error
        self.progress.mark()
        self._settle_and_begin()
        self._sample()
        return self.dynamics.first_length()

    def _cut(self, step: DenseStep, t: float) -> None:
        """End a step at a time t [s] within it, and advance the state to there."""
        state = self.state
        step.end = state.t = t
        state.q, state.v = step.at(t)
        state.works = step.work_at(t)
        work = self.work
        work.end_gain[:] = np.maximum(work.start_gain + (state.works - step.w)[FRICTION], 0.0)
        self._sample()

    def _correct_drift(self) -> None:
        """Correct constraint drift if it exceeds the tolerance. (theory.md, 12)"""
        if self.work.drift_at_end > self.work.drift_tolerance:
            self.instant.correct_constraint_drift()

    def _interrupt(self, step: DenseStep, interruption: Interruption) -> None:
        """End a step at a user event."""
        state = self.state
        self._cut(step, interruption.time)
        self._restart_after(interruption)
        if state.ended_by is None:
            self._settle_and_begin()
        if interruption.velocity is not None:
            self._sample()

    def _restart_after(self, interruption: Interruption) -> None:
        """Apply the velocity that a user event has set, and whether it ends the motion."""
        if interruption.velocity is not None:
            self.instant.change_velocity(interruption.velocity)
        self.state.ended_by = interruption.ended_by

    def _trigger_events(self) -> None:
        """Trigger the user events whose guards have changed sign at this instant."""
        state = self.state
        while self.events and state.ended_by is None:
            interruption = self.events.at_instant(state.t, state.q, state.v)
            if interruption is None:
                return
            self._restart_after(interruption)
            if state.ended_by is None:
                self._settle_contacts()

    def _end_at_event(self, step: DenseStep, t: float, arriving: int | None) -> None:
        """End a step at an event: a gap closes (`arriving`), or the modes change."""
        self._cut(step, t)
        self._correct_drift()
        if EVENTS[self.work.event_kind] is saturation and t == self.work.event_time:
            self.dynamics.change_side(self.work.event_index)
        bounded = arriving is None and EVENTS[self.work.event_kind] is force_bound
        if arriving is None:
            self.instant.resolve_jam(leaving=bounded)
        self._settle_and_begin(arriving)
        # the drift correction may have moved the forces back inside their bounds, which they leave again soon
        if bounded and self.work.least_margin < 0.0:
            self.instant.set_modes_ahead(step)
            self._begin_motion()
        self._sample()

    def _end_at_meeting(self, step: DenseStep, meeting: Meeting) -> None:
        """End a step where the points of contact of two shapes change."""
        self._cut(step, meeting.time)
        self._correct_drift()
        self._settle_and_begin(self.shapes.meet(meeting, step) or None)
        self._sample()

    def _end_at_tilting(self, step: DenseStep, tilting: Tilting) -> None:
        """End a step where a rim that lies flat begins to tilt."""
        self._cut(step, tilting.time)
        self._correct_drift()
        self._settle_and_begin(self.rims.stand_up(tilting.rim))
        self._sample()

    def _settle_and_begin(self, arriving: Arriving = None) -> None:
        """Resolve this instant, then begin the smooth motion after it."""
        self._settle(arriving)
        self._begin_motion()

    def _settle(self, arriving: Arriving = None) -> None:
        """Resolve the impacts, contact modes and user events of this instant."""
        self._settle_contacts(arriving)
        self._trigger_events()

    def _settle_contacts(self, arriving: Arriving = None) -> None:
        """Resolve the impacts and contact modes of this instant, and count it for `max_impacts`."""
        before = len(self.record.impacts)
        self.instant.settle(arriving)
        if len(self.record.impacts) > before:
            self.progress.count_impacts(before)
