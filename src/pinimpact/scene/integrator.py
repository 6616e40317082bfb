"""The integrator of a motion: smooth steps up to the next event, and what changes there."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..errors import InputError, IrregularMotionError
from ..robot.names import coordinate_names
from ._kernels import smooth_motion, step_dop853, step_radau, stiff_drives
from ._kernels.events.consequences import ARRIVAL
from ._kernels.events.registry import EVENTS, force_bound, gap, saturation
from ._kernels.tolerances import NEARLY_SINGULAR, ROUNDING
from .controls import Control, JointPD, SampledControl
from .dense_step import WORKS, DenseStep
from .event_watch import EventWatch, Interruption
from .events import as_events
from .forces import ClosedSet, EvaluatedForces
from .hybrid_state import HybridState
from .instant import Arriving, Instant
from .mode_intervals import drive_name
from .options import Options
from .progress import Progress
from .recorder import Mark
from .scene import Scene
from .shape_watch import Meeting
from .start import state_at
from .switched_off import altered_model
from .trajectory import Trajectory

Report = Callable[[float, float], None]
"""report(t, duration), called after every step."""

HIGH_ORDER = 10
"""Steps for which a low order is not tried again where it has not been accurate enough."""

SEEN_EVERY = 0.25
"""The part of the scene's time scale after which functions of the user's own are asked again: a smooth force
that comes after a long time without one is seen, unless it is over within some hundredth of that scale."""

BEYOND = 1.3
"""No step is taken beyond so many times a bounce that has just begun, or what is left of a slip."""


def _continued(
    kind: type[Integrator], made_of: tuple[Any, ...], state: HybridState, record: tuple[Any, ...]
) -> Integrator:
    """Return an integrator that continues from a state and a record."""
    scene, q0, v0, options = made_of
    integrator = kind(scene, q0, v0, options, state)
    integrator.record.take(record)
    integrator.reached = integrator.mark()
    return integrator


UNCHANGED = 0.1
"""Part of the error of a longer step above which it has not fallen with the length; by the order of the
methods it falls to less in a step of half that length."""


class Integrator:
    """A motion under way, from q0 (nq,) and v0 (nv,) or continued from a state.

    Attributes:
        state: The present state.
        record: What there is to tell of the motion.
        instant: What changes the state at one instant.
        dynamics, work: The dynamics, and their workspace.
        reached: How far the record was consistent last, and the state then.
    """

    def __init__(
        self, scene: Scene, q0: ArrayLike, v0: ArrayLike, options: Options, state: HybridState | None = None
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"scene: {type(scene).__name__} given; a Scene is expected", value=scene)
        self._made_of = scene, q0, v0, options
        self.scene, self.options, without = scene, options.checked(), scene.without
        model = self.model = altered_model(scene.model, without)
        layout = scene.layout()
        self.data = layout.data_for(self, model)
        self.state = state_at(model, self.data, q0, v0) if state is None else state.kept(memory=None)
        self.instant = Instant(scene, model, self.data, self.state, state is None, self.options.dt)
        self.record, self.dynamics = self.instant.record, self.instant.dynamics
        self.shapes = self.instant.shapes
        work = self.work = self.dynamics.work
        work.rtol, work.atol = self.options.rtol, self.options.atol
        self.drift_tolerance = self.shapes.tolerance = max(work.touching_gap, work.atol)
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
        self.max_step = longest if self.options.max_step is None else self.options.max_step
        self._prepare()
        if state is not None:
            self._continue_with(state)
            return
        self.progress.mark()
        self._sample()
        self.reached = self.mark()

    def _prepare(self) -> None:
        """Prepare what the scheme needs."""

    def _continue_with(self, state: HybridState) -> None:
        """Take over what kernels have changed in place in another motion."""
        if state.memory is not None:
            values, directions = state.memory
            self.work.set_values(values)
            self.shapes.continue_with(directions)

    def value(self) -> HybridState:
        """Return the whole state as a value, for a copy of the motion, a file, or a comparison."""
        directions = self.shapes.directions
        return self.state.kept(memory=(self.work.values(), None if directions is None else directions.copy()))

    def copy(self) -> Integrator:
        """Return an independent motion in the same state."""
        make, arguments = self.__reduce__()
        return make(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the scene, the state and the record; workspaces and addresses are rebuilt."""
        return _continued, (type(self), self._made_of, self.value(), self.record.values())

    def mark(self) -> tuple[Mark, HybridState]:
        """Return how far the record has come, and the state; an interrupt or a refusal falls back to it."""
        return self.record.mark(), self.state.kept()

    def begin(self, tau: Array | None = None) -> None:
        """Let what happens at the start happen, and begin to move, under a constant force (nv,) if given."""
        if self.sampled is not None:
            tau = self.sampled.at(self.state.t, self.state.q, self.state.v)
        if tau is not None:
            self.work.control_force[:] = tau
        if self.state.overlap is not None:
            raise IrregularMotionError(self.state.overlap, field="q0")
        self.instant.settle(starting=True)
        self._let_events_happen()
        self._begin_motion()
        self.state.length = self.dynamics.first_length()

    def advance(self, until: float, report: Report | None = None) -> None:
        """Move on to a time [s], or until an event ends the motion; `report` is called after every step."""
        state, sampled = self.state, self.sampled
        while state.t < until and state.ended_by is None:
            stop = until
            if sampled is not None and sampled.next < until - ROUNDING * until:
                stop = sampled.next
            self.progress.mark()
            while state.t < stop and state.ended_by is None:
                state.length = self._step(state.length, stop, min(1.0, until))
                self.reached = self.mark()
                if report is not None:
                    report(state.t, until)
            if sampled is not None and stop < until and state.ended_by is None:
                tau = sampled.at(state.t, state.q, state.v)
                if tau is not None:
                    self.hold_force(tau)

    def hold_force(self, tau: Array) -> None:
        """Let a constant force (nv,) act from now on in place of the one that did."""
        if tau.tobytes() == self.work.control_force.tobytes():
            return
        self.work.control_force[:] = tau
        self._begin_motion()
        if not smooth_motion.modes_continue(self.work):
            self._settle_and_begin()

    def resume(self) -> None:
        """Go on where an event may have ended the motion; `max_impacts` counts from here."""
        self.state.struck = 0
        if self.state.ended_by is not None:
            self.state.ended_by = None
            self._settle_and_begin()

    def trajectory(self, termination: str, complete: bool) -> Trajectory:
        """Return the motion until now, as far as it is consistent."""
        (mark, state), made_of = self.reached, self._made_of
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
            forces=EvaluatedForces(lambda: Integrator(*made_of).dynamics, contacts),
            contacts=(*self.scene.contacts, *self.scene.held),
            coordinates=coordinate_names(self.model),
            stepped=state.stepped,
        )

    def _sample(self) -> None:
        state = self.state
        self.record.samples.append((state.t, state.q, state.v, state.works, state.impact_energy))

    def _begin_motion(self) -> None:
        """Begin a smooth motion at the present state."""
        state, work = self.state, self.work
        if state.touching:
            self.shapes.review()
        self.dynamics.set_saturation(state.q, state.v)
        state.bounce = BEYOND * self.dynamics.begin(state.t, state.q, state.v)
        work.force_bound_ignored = bool(work.force_bound_ignored) and self.dynamics.forces_doubtful
        unique = work.forces_unique
        if state.forces_unique and not unique:
            self.instant.note("The contact forces are not unique; those of equally stiff contacts are used.")
        state.forces_unique = unique
        state.closed = ClosedSet.of(work, self.shapes.swapped())

    def _step(self, h: float, stop: float, scale: float) -> float:
        """Take one accepted step, or a part of it up to an event; return the length to try next.

        The length to try is h; it ends at `stop` at the latest. `progress.STALLED` is a part of `scale` [s].
        """
        state, work, t = self.state, self.work, self.state.t
        found = self.progress.stalled(scale) or self._compute(h, stop - t)
        if isinstance(found, IrregularMotionError):
            return self._jam_or_refuse(found)
        trial, natural, directions = found
        state.steps += 1
        if self.dynamics.constrained:
            self.progress.check_drift()
        start = t, trial, state.q, state.v, state.works
        step = DenseStep(*start, work.dense_coefficients.copy(), work.joint_charts, state.closed, directions)
        self.progress.check_friction(step, min(work.event_time, step.end))
        self.record.dense_steps.append(step)
        time = work.event_time
        arriving = self._arriving() if time <= step.end else None
        meeting = None
        if self.shapes:
            meeting = self.shapes.within(step, min(time, step.end))
            if meeting is not None:
                time, arriving = meeting.time, None
        if self.events:
            interruption = self.events.within(step, min(time, step.end))
            if interruption is not None:
                self._interrupt(step, interruption, arriving if interruption.time == time else None)
                return natural
        if meeting is not None:
            self._end_at_meeting(step, meeting)
            return natural
        if time <= step.end:
            self._end_at_event(step, time, arriving)
            return natural
        state.cut_short = trial == stop - t
        self._complete(step, stop if state.cut_short else step.end)
        longer = trial * work.growth
        return max(longer, natural) if state.cut_short else longer

    def _compute(self, h: float, left: float) -> tuple[float, float, Array | None] | IrregularMotionError:
        """Compute a step whose error is small enough, from a length to try, h, and no longer than `left` [s].

        Returns:
            Its length, the length to go on with if it ends early, and the directions of slip; or why no step
            is short enough.
        """
        state, work, t = self.state, self.work, self.state.t
        ends = BEYOND * work.slip_ends if self._continuous is None else math.inf  # refusals tell of its jumps
        natural, h, before = h, min(h, self.max_step, state.bounce, ends), math.inf
        while True:
            trial = left if h > 0.9 * left else h
            if t + trial <= t:
                self.instant.rims.refuse_flat()
                return IrregularMotionError(
                    f"rtol: the step size fell to {trial:.3g} s at t = {t:.6g} s; the motion is not "
                    "smooth (a discontinuous control, forces beyond bounds?), or the tolerance is too small",
                    value=work.rtol,
                )
            method, work.method = self._method(trial), 0
            if method is step_dop853 and state.cut_short and trial == left:
                work.method = bisect_right(state.low_orders_from, state.steps)
            error = method.attempt(work, t, trial, work.rtol, work.atol)
            if error > 1.0:
                self.dynamics.check()
                state.rejected += 1
                if work.method > 0:
                    higher, later = state.low_orders_from[: work.method - 1], state.steps + HIGH_ORDER
                    state.low_orders_from = (*higher, later, later)[:2]
                else:
                    natural = h = trial * (0.2 if math.isinf(error) else max(0.2, 0.9 * error**-0.125))
                    # what settles within the step misses as much in one a little shorter; directions of slip
                    # may settle in no time, and implicit steps have them as unknowns
                    if error > UNCHANGED * before and work.drive_rate > 0.0:
                        natural = h = min(h, stiff_drives.STIFF / work.drive_rate)
                    before = error
                continue
            if not self.instant.rims.jump(work.q0, work.q1):
                slips = state.closed is not None and state.closed.slips
                directions = np.array([work.start_directions, work.end_directions]) if slips else None
                self.dynamics.finish(t, trial, error, method is step_dop853)
                if work.event_time >= t:
                    return trial, natural, directions
            state.rejected += 1
            h = 0.5 * trial

    def _method(self, h: float) -> ModuleType:
        """Return the method for a step of a length [s]."""
        work = self.work
        stiff = h * work.slip_stiffness > step_radau.STIFF or h * work.drive_rate > stiff_drives.STIFF
        return step_radau if stiff else step_dop853

    def _complete(self, step: DenseStep, end: float) -> None:
        """Let a step end where it does, without an event; go on from there."""
        state, work = self.state, self.work
        state.works = state.works + step.coefficients[0, -WORKS:]
        state.t = step.end = end
        state.q, state.v = work.q0.copy(), work.v0.copy()
        if work.force_bound_ignored and work.end_margin >= 0.0:
            work.force_bound_ignored = False
        state.bounce = math.inf
        if self.dynamics.constrained and (
            work.drift_at_end > self.drift_tolerance or work.force_bound_ignored
        ):
            if work.force_bound_ignored:
                self._note_beyond(-work.end_margin)
                self._settle()
            else:
                self.instant.correct_constraint_drift()
            self._begin_motion()
        self._sample()

    def _note_beyond(self, excess: float) -> None:
        """Tell of forces beyond their bounds, by more than the tolerance leaves unknown, once."""
        unknown = self.work.rtol * np.abs(self.work.solution).max(initial=0.0)
        if self.work.forces_unique and excess > unknown and not self.state.forces_beyond:
            self.state.forces_beyond = True
            beyond = f"Contact forces exceed the bounds of the contact modes by {excess:.3g} N or N m"
            if math.isinf(excess):
                beyond = "Slip in these contact modes has a negative normal acceleration"
            self._report_beyond(f"{beyond}, and no other modes were found")

    def _report_beyond(self, text: str) -> None:
        """Note that forces are not those of Coulomb's law."""
        self.instant.note(f"{text}: the motion may be wrong here; near Painlevé's paradox there may be none.")

    def _arriving(self) -> int | None:
        """Return the contact or, past those, the limit that arrives at the event last found, or None."""
        event = EVENTS[self.work.event_kind]
        if event.CONSEQUENCE != ARRIVAL:
            return None
        return self.work.event_index + (0 if event is gap else self.work.contacts)

    def _jam_or_refuse(self, refusal: IrregularMotionError) -> float:
        """Resolve the jam of slip whose forces grow until no step is short enough; return the length to try.

        Raises the refusal where it is none.
        """
        if not self.instant.resolve_jam(NEARLY_SINGULAR):
            raise refusal
        self.progress.mark()
        self._settle_and_begin()
        self._sample()
        return self.dynamics.first_length()

    def _cut(self, step: DenseStep, t: float) -> None:
        """Let a step end at a time in it."""
        state = self.state
        step.end = state.t = t
        state.q, state.v = step.at(t)
        state.works = step.work_at(t)
        self._sample()

    def _correct_drift(self) -> None:
        """Bring closed contacts back onto their surfaces, if they are off by more than the tolerance."""
        if self.work.drift_at_end > self.drift_tolerance:
            self.instant.correct_constraint_drift()

    def _interrupt(self, step: DenseStep, interruption: Interruption, arriving: int | None) -> None:
        """End a step at an event of the user's."""
        state = self.state
        self._cut(step, interruption.time)
        self._restart_after(interruption)
        if state.ended_by is None:
            self._settle_and_begin(arriving)
        if interruption.velocity is not None:
            self._sample()

    def _restart_after(self, interruption: Interruption) -> None:
        """Take over the velocity that an event has set, and whether it ends the run."""
        if interruption.velocity is not None:
            self.instant.change_velocity(interruption.velocity)
        self.state.ended_by = interruption.ended_by

    def _let_events_happen(self) -> None:
        """Let the events happen whose guards an instant has taken to the other sign."""
        state = self.state
        while self.events and state.ended_by is None:
            interruption = self.events.at_instant(state.t, state.q, state.v)
            if interruption is None:
                return
            self._restart_after(interruption)
            if state.ended_by is None:
                self._settle_contacts()

    def _end_at_event(self, step: DenseStep, t: float, arriving: int | None) -> None:
        """End a step at an event and deal with it: something arrives, or else modes change."""
        self._cut(step, t)
        self._correct_drift()
        if EVENTS[self.work.event_kind] is saturation and t == self.work.event_time:
            self.dynamics.change_side(self.work.event_index)
        bounded = arriving is None and EVENTS[self.work.event_kind] is force_bound
        if arriving is None:
            self.instant.resolve_jam(leaving=bounded)
        self._settle_and_begin(arriving)
        # forces that a correction has brought back into their bounds leave them again soon
        if bounded and self.work.force_bound_ignored:
            self.instant.set_modes_ahead(step)
            self._begin_motion()  # with the forces by which the modes were found, if those ahead are the same
        self._sample()

    def _end_at_meeting(self, step: DenseStep, meeting: Meeting) -> None:
        """End a step where two shapes touch, or touch elsewhere."""
        self._cut(step, meeting.time)
        self._correct_drift()
        self._settle_and_begin(self.shapes.meet(meeting, step) or None)
        self._sample()

    def _settle_and_begin(self, arriving: Arriving = None) -> None:
        """Let this instant settle, and begin the smooth motion after it."""
        self._settle(arriving)
        self._begin_motion()

    def _settle(self, arriving: Arriving = None) -> None:
        """Let impacts, modes and the user's events of this instant settle."""
        self._settle_contacts(arriving)
        self._let_events_happen()

    def _settle_contacts(self, arriving: Arriving = None) -> None:
        """Let impacts and modes of this instant settle, at no more instants than may have impacts."""
        before = len(self.record.impacts)
        self.instant.settle(arriving)
        if self.instant.resolve_jam():
            self.instant.settle()
        if len(self.record.impacts) > before:
            self.progress.count_impacts(before)
