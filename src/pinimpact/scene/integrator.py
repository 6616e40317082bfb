"""The integrator of a motion: smooth steps up to the next event, and what changes there."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array, real_number
from ..errors import InputError, IrregularMotionError, PinimpactError, SimulationError
from ..robot.data_cache import checked_configuration, data_cache
from ..robot.forest import potential_energy
from ..robot.names import coordinate_names
from ..robot.pinocchio_bridge import kinetic_energy
from ._kernels import smooth_motion, step_dop853, step_drives, step_radau
from ._kernels.events.consequences import ARRIVAL
from ._kernels.events.registry import EVENTS, force_bound, gap, saturation
from ._kernels.slip import CERTAIN
from .controls import Control, JointPD, SampledControl
from .dense_step import WORKS, DenseStep
from .dynamics import SceneDynamics
from .events import EventWatch, Interruption, as_events
from .forces import ClosedSet, EvaluatedForces, directions_within
from .mode_intervals import drive_name
from .records import Energy, ImpactRecord, ModeInterval, SteppedInterval
from .scene import Scene
from .shape_watch import Meeting
from .simulation_state import Arriving, SimulationState
from .trajectory import Trajectory

Array = NDArray[np.float64]
Progress = Callable[[float, float], None]
"""progress(t, duration), called after every step."""

DIRECTED = 1e-3
"""Part of the speed of sticking below which slip has no direction but the one last known."""

MAX_STALLED = 200
"""Steps without progress after which a simulation gives up."""

JUMPING, FEW = 1e-3, 0.1
"""So many steps that cover less than this part of the scene's time scale, this part of them refused before,
are those of a control that jumps again and again."""

RUBBING = slice(1, 3)
"""Which of the works are those of friction, in joints and in contacts: it takes energy."""

GAINED = 10.0
"""Factor on rtol: the part of the kinetic energy that friction may give by the errors of steps."""

ROLLING = 0.25
"""Friction of what sticks and rolls, in parts of the weight: over the error of velocities it does work that
grows with time and is no gain. With none of it rolling balls are refused, with all of it a gain of 0.4 % of
the energy is not seen."""

NEARLY_SINGULAR = 1e-4
"""The part to which the effects of forces cancel where their growth lets no step be short enough."""

FALSE_ALARM = 0.2
"""Part of a step to try next where forces have left their bounds only by its error."""

HIGH_ORDER = 10
"""Steps for which the order stays high where a low one has not been accurate enough."""

SEEN_EVERY = 0.25
"""The part of the scene's time scale after which functions of the user's own are asked again: a smooth force
that comes after a long time without one is seen, unless it is over within some hundredth of that scale."""

LARGEST_RTOL = 0.1
"""The largest relative tolerance of a step: beyond it the error estimate says nothing."""

STALLED = 1e-8
"""Time [s] that is no progress, or that part of a duration below 1 s."""

ACCELERATED = 1e-3
"""The part of the velocity whose change is progress: near a jam forces grow and do much in no time."""


PLAIN = (
    *("w", "steps", "rejected", "last_progress", "forces_were_unique", "forces_beyond", "rubbed"),
    *("bounce", "ended_by", "_length", "_cut_short", "_low_order_from", "_struck", "_consistent", "_closed"),
)
"""Attributes of a motion that are replaced and never changed in place, so that copies share them."""

ROUNDING = 1e-15
"""A sample of a control closer to the end of a run than this part of its time is at the end."""


def check_numbers(**numbers: float) -> None:
    """Refuse what is not above zero, not finite where it is a time to cover, or too large for a tolerance.

    Raises:
        InputError: A number out of its range, or none.
    """
    for name, value in numbers.items():
        number = real_number(name, value)
        if not number > 0.0 or (name in ("duration", "dt", "atol") and not math.isfinite(number)):
            raise InputError(f"{name}: {number!r} given, a number > 0 expected", field=name, value=value)
        if name == "rtol" and number > LARGEST_RTOL:
            raise InputError(
                f"rtol: {number!r} given, a number up to {LARGEST_RTOL} expected", field=name, value=value
            )
        if name == "max_impacts" and number != math.inf and number != int(number):
            raise InputError(
                f"max_impacts: {number!r} given, a whole number expected", field=name, value=value
            )


def _dynamics_of(*made_of: Any) -> SceneDynamics:
    """Return the dynamics of a motion of its own."""
    return Integrator(*made_of).dynamics


LAST = 5
"""How many of the last impacts are named where there are too many."""


def _continued(kind: type[Integrator], made_of: tuple[Any, ...], values: dict[str, Any]) -> Integrator:
    """Return an integrator that continues from the values of another one made of the same arguments."""
    integrator = kind(*made_of)
    integrator._take_over(values)
    return integrator


def _sources(impacts: list[ImpactRecord]) -> str:
    return ", ".join(f"{record.source!r} ({record.time:.9g} s)" for record in impacts[-LAST:])


class Integrator:
    """A motion under way, and what there is to tell of it; arguments as in `simulate`.

    Attributes:
        state: The present state.
        ended_by: Name of the event that has ended it, or None.
    """

    def __init__(
        self,
        scene: Scene,
        q0: ArrayLike,
        v0: ArrayLike,
        rtol: float,
        atol: float,
        max_step: float | None,
        max_impacts: int,
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(
                f"scene: {type(scene).__name__} given; a Scene is expected", field="scene", value=scene
            )
        self._made_of = scene, q0, v0, rtol, atol, max_step, max_impacts
        check_numbers(rtol=rtol, atol=atol, max_impacts=max_impacts)
        # one type of each number, for kernels are compiled by type
        rtol, atol = float(rtol), float(atol)
        without = scene.without
        model = scene.model
        if "gravity" in without or "rotor inertia" in without:
            model = model.copy()
            if "gravity" in without:
                model.gravity = pin.Motion.Zero()
            if "rotor inertia" in without:
                model.armature = np.zeros(model.nv)
        self.model = model
        layout = scene.layout()
        self.data = layout.data_for(self, model)
        try:
            q = checked_configuration(data_cache(model, self.data), model, q0).copy()
        except InputError as error:
            raise InputError(f"q0: {str(error).removeprefix('q: ')}", field="q0", value=q0) from None
        v = finite_array("v0", v0, (model.nv,)).copy()
        self.state = SimulationState(scene, model, self.data, q, v)
        self.dynamics = self.state.dynamics
        self.work = self.dynamics.work
        self.work.rtol, self.work.atol = rtol, atol
        self.rtol, self.atol = rtol, atol
        self.drift_tolerance = self.state.shapes.tolerance = max(self.work.touching_gap, atol)
        self.switched_off = scene.plan().switched_off if without else ()
        names = (drive_name(model, j) for j in self.work.drive_velocity.tolist())
        self.sources = (*layout.sources, *names)
        self.max_impacts = max_impacts
        self.w = np.zeros(WORKS)
        self.rubbed = self.w[RUBBING]
        self._weight = float(np.linalg.norm(model.gravity.linear)) * pin.computeTotalMass(model)
        self.dense_steps: list[DenseStep] = []
        self.samples: list[tuple[float, Array, Array, Array, float]] = []
        self.steps = self.rejected = 0
        self._mark_progress()
        self.forces_were_unique = True
        self.forces_beyond = False
        self.bounce = math.inf
        self._closed: ClosedSet | None = None
        seen_every = SEEN_EVERY * scene.time_scale
        self.events = EventWatch(as_events(scene.events) if "user events" not in without else (), seen_every)
        self.ended_by: str | None = None
        self._sampled = None
        self._continuous: Control | None = None
        if scene.control is not None and "control" not in without:
            if scene.period is not None:
                control = scene.control.drives(model) if isinstance(scene.control, JointPD) else scene.control
                self._sampled = SampledControl(control, scene.period, scene.delay)
            elif not isinstance(scene.control, JointPD):
                self._continuous = scene.control
        if max_step is None:
            max_step = math.inf if self._continuous is None else seen_every
        check_numbers(max_step=max_step)
        self.max_step = float(max_step)
        self._length = 0.0
        self._cut_short, self._low_order_from = False, 0
        self._struck = 0  # instants with impacts
        self._sample()
        self._consistent = self._lengths()

    def begin(self, tau: Array | None = None) -> None:
        """Let what happens at the start happen, and begin to move, under a constant force (nv,) if given."""
        if self._sampled is not None:
            tau = self._sampled.at(self.state.t, self.state.q, self.state.v)
        if tau is not None:
            self.work.control_force[:] = tau
        self.state.settle(starting=True)
        self._let_events_happen()
        self._begin_motion()
        self._length = self.dynamics.first_length(self.rtol, self.atol)

    def advance(self, until: float, progress: Progress | None = None) -> None:
        """Move on to a time, or until an event ends the motion.

        Args:
            until: The time [s].
            progress: Called with the time reached and `until`, after every step.
        """
        state, sampled = self.state, self._sampled
        while state.t < until and self.ended_by is None:
            stop = until
            if sampled is not None and sampled.next < until - ROUNDING * until:
                stop = sampled.next
            self._mark_progress()
            while state.t < stop and self.ended_by is None:
                self._length = self._step(self._length, stop, min(1.0, until))
                self._consistent = self._lengths()
                if progress is not None:
                    progress(state.t, until)
            if sampled is not None and stop < until and self.ended_by is None:
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
        self._struck = 0
        if self.ended_by is not None:
            self.ended_by = None
            self._settle_and_begin()

    def copy(self) -> Integrator:
        """Return an independent motion in the same state."""
        return _continued(type(self), self._arguments(), self._values())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the scene and the values reached; workspaces and addresses are rebuilt."""
        return _continued, (type(self), self._arguments(), self._values())

    def _arguments(self) -> tuple[Any, ...]:
        """Return the arguments of which another one of the same kind is made."""
        return self._made_of

    def _values(self) -> dict[str, Any]:
        """Return all that the motion has reached, for `_continued`."""
        return {
            "state": self.state.values(),
            "work": self.work.values(),
            "events": self.events.values(),
            "steps": (self.dense_steps.copy(), self.samples.copy()),
            "plain": {name: getattr(self, name) for name in PLAIN},
        }

    def _take_over(self, values: dict[str, Any]) -> None:
        """Continue from the values of another one."""
        self.state.take_over(values["state"])
        self.work.take_over(values["work"])
        self.events.take_over(values["events"])
        self.dense_steps, self.samples = (list(part) for part in values["steps"])
        for name, value in values["plain"].items():
            setattr(self, name, value)

    def stop(self, error: PinimpactError) -> NoReturn:
        """Raise what stops the motion, with what there is of it until then."""
        partial = self.trajectory(f"Stopped: {error}", False)
        if isinstance(error, SimulationError):
            error.partial = partial
            raise error
        reached = partial.t[-1]
        raise SimulationError(
            f"{error.field}: the simulation stops at t = {reached:.6g} s: {type(error).__name__}: {error}",
            partial=partial,
            field=error.field,
            value=error.value,
        ) from error

    def _lengths(self) -> tuple[Any, ...]:
        """How much of the run is consistent now; an interrupt falls back to it."""
        state = self.state
        return (
            len(self.dense_steps),
            len(self.samples),
            len(state.impacts),
            len(self.events.records),
            len(state.modes.ended),
            dict(state.modes.present),
            len(state.notes),
        )

    def trajectory(self, termination: str, complete: bool) -> Trajectory:
        """Return the motion until now, as far as it is consistent."""
        dense_steps, samples, impacts, events, intervals, present, notes = self._consistent
        rows = self.samples[:samples]
        t = np.array([row[0] for row in rows])
        q = np.array([row[1] for row in rows])
        v = np.array([row[2] for row in rows])
        w = np.array([row[3] for row in rows])
        kinetic, potential = np.empty((2, len(rows)))
        for k, (_, at, moving, *_) in enumerate(rows):
            kinetic[k] = kinetic_energy(self.model, self.data, at, moving)
            potential[k] = potential_energy(self.model, self.data, at)
        impacts_work = np.array([row[4] for row in rows])
        energy = Energy(kinetic, potential, w[:, 0], w[:, 1], w[:, 2], w[:, 3], impacts_work)
        modes = self.state.modes.ended[:intervals] + [
            ModeInterval(source, mode, start, float(t[-1])) for source, (mode, start) in present.items()
        ]
        return Trajectory(
            self.dense_steps[:dense_steps],
            self.work.joint_charts,
            (t, q, v),
            self.state.impacts[:impacts],
            self.events.records[:events],
            modes,
            energy,
            self.state.notes[:notes],
            termination,
            complete,
            self.switched_off,
            {"steps": self.steps, "rejected": self.rejected, "evaluations": self.work.evaluations},
            self.sources,
            EvaluatedForces(partial(_dynamics_of, *self._made_of), self.state.names[: self.work.contacts]),
            (*self._made_of[0].contacts, *self._made_of[0].held),
            coordinate_names(self.model),
            self._stepped(),
        )

    def _stepped(self) -> Sequence[SteppedInterval]:
        """Return the intervals that time stepping has crossed."""
        return ()

    def _sample(self) -> None:
        state = self.state
        self.samples.append((state.t, state.q, state.v, self.w, state.impact_energy))

    def _begin_motion(self) -> None:
        """Begin a smooth motion at the present state."""
        state, work = self.state, self.work
        state.review_shapes()
        error = state.error(state.v)
        work.certain_speed = min(CERTAIN * error, work.stick_speed)
        work.direction_speed = min(CERTAIN * error, DIRECTED * work.stick_speed)
        self.dynamics.set_saturation(state.q, state.v)
        # no step is taken far beyond the end of a bounce
        self.bounce = 1.3 * self.dynamics.begin(state.t, state.q, state.v)
        work.force_bound_ignored = bool(work.force_bound_ignored) and self.dynamics.forces_doubtful
        unique = work.forces_unique
        if self.forces_were_unique and not unique:
            state.note("The contact forces are not unique; those of equally stiff contacts are used.")
        self.forces_were_unique = unique
        self._closed = ClosedSet.of(work, state.shapes.swapped())

    def _step(self, h: float, stop: float, scale: float) -> float:
        """Take one accepted step, or a part of it up to an event; return the length to try next.

        Args:
            h: The length to try.
            stop: The time at which it ends at the latest.
            scale: The time of which `STALLED` is a part [s].
        """
        state, work, t = self.state, self.work, self.state.t
        if self.steps - self.last_progress[0] > MAX_STALLED:
            refusal = self._check_progress(scale)
            if refusal is not None:
                return self._jam_or_refuse(refusal)
        left = stop - t
        natural = h
        h = min(h, self.max_step, self.bounce)
        while True:
            trial = left if h > 0.9 * left else h
            if t + trial <= t:
                state.refuse_flat_rims()
                refusal = IrregularMotionError(
                    f"rtol: the step size fell to {trial:.3g} s at t = {t:.6g} s; the motion is not "
                    "smooth (a discontinuous control, forces beyond bounds?), or the tolerance is too small",
                    field="rtol",
                    value=self.rtol,
                )
                return self._jam_or_refuse(refusal)
            method: ModuleType = step_dop853
            if trial * work.slip_stiffness > step_radau.STIFF:
                method = step_radau
            elif trial * work.drive_rate > step_drives.STIFF:
                method = step_drives
            cut_short = self._cut_short and trial == left
            work.low_order = cut_short and method is step_dop853 and self.steps >= self._low_order_from
            error = method.attempt(work, t, trial, self.rtol, self.atol)
            self.dynamics.check()
            if error > 1.0:
                self.rejected += 1
                if work.low_order:
                    self._low_order_from = self.steps + HIGH_ORDER
                    continue
                natural = h = trial * (0.2 if math.isinf(error) else max(0.2, 0.9 * error**-0.125))
                continue
            if state.rims_jump(work.q0, work.q1):
                self.rejected += 1
                h = 0.5 * trial
                continue
            directions = directions_within(work) if self._closed is not None and self._closed.slips else None
            self.dynamics.finish(t, trial, error, method is step_dop853)
            if work.event_time >= t:
                break
            self.rejected += 1
            h = 0.5 * trial
        self.steps += 1
        step = self.dynamics.dense_step(t, trial, state.q, state.v, self.w)
        step.closed, step.directions = self._closed, directions
        self._check_friction(step, min(work.event_time, step.end))
        self.dense_steps.append(step)
        time, arriving = work.event_time, self._arriving()
        meeting = None
        if state.shapes:
            meeting = state.shapes.within(step, min(time, step.end))
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
            confirmed = self._end_at_event(step, time, arriving)
            return natural if confirmed else FALSE_ALARM * trial
        self.w = self.w + step.coefficients[0, -WORKS:]
        state.t = step.end = stop if trial == left else step.end
        state.q, state.v = work.q0.copy(), work.v0.copy()
        if work.force_bound_ignored and work.end_margin >= 0.0:
            work.force_bound_ignored = False
        if self.dynamics.constrained and (
            work.drift_at_end > self.drift_tolerance or work.force_bound_ignored
        ):
            if work.force_bound_ignored:
                self._note_beyond(-work.end_margin)
                self._settle()
            else:
                state.correct_constraint_drift()
            self._begin_motion()
        else:
            self.bounce = math.inf
            work.certain_speed = min(CERTAIN * state.error(state.v), work.stick_speed)
        self._sample()
        longer = trial * work.growth
        self._cut_short = trial == left
        return max(longer, natural) if self._cut_short else longer

    def _note_beyond(self, excess: float) -> None:
        """Tell of forces beyond their bounds, by more than the tolerance leaves unknown, once."""
        unknown = self.rtol * np.abs(self.work.solution).max(initial=0.0)
        if self.work.forces_unique and excess > unknown and not self.forces_beyond:
            self.forces_beyond = True
            beyond = f"Contact forces exceed the bounds of the contact modes by {excess:.3g} N or N m"
            if math.isinf(excess):
                beyond = "Slip in these contact modes has a negative normal acceleration"
            self.state.note(
                f"{beyond}, and no other modes were found: the motion may be wrong here; near Painlevé's "
                "paradox there may be none."
            )

    def _arriving(self) -> int | None:
        """Return the contact or, past those, the limit that arrives at the event last found, or None."""
        event = EVENTS[self.work.event_kind]
        if event.CONSEQUENCE != ARRIVAL:
            return None
        return self.work.event_index + (0 if event is gap else self.work.contacts)

    def _mark_progress(self) -> None:
        self.last_progress = self.steps, self.state.t, self.state.v, self.rejected

    def _check_friction(self, step: DenseStep, until: float) -> None:
        """Refuse a step until whose event friction has given energy.

        Raises:
            IrregularMotionError: See above.
        """
        works = step.work_at(until)[RUBBING]
        self.rubbed = np.minimum(self.rubbed, self.w[RUBBING])
        gained = float((works - self.rubbed).max())
        state = self.state
        drift = self.rtol * self._made_of[0].extent + ROLLING * state.error(state.v) * until
        rounding = 4.0 * np.spacing(np.abs(works).max())  # of sums that grow step by step
        explained = self._weight * drift + rounding
        if gained > explained and gained > GAINED * self.rtol * kinetic_energy(
            self.model, self.data, state.q, state.v
        ):
            raise IrregularMotionError(
                f"scene: friction would give {gained:.3g} J at t = {state.t:.6g} s, so that the modes of "
                "contact are none; a smaller rtol may help",
                field="scene",
            )

    def _check_progress(self, scale: float) -> IrregularMotionError | None:
        """Return why not to continue where steps make no progress, or None.

        Args:
            scale: The time of which `STALLED` is a part [s].
        """
        steps, then, velocity, rejected = self.last_progress
        state, count = self.state, self.steps - steps
        covered, t = state.t - then, state.t
        refused = self.rejected - rejected > FEW * count
        if self._continuous is not None and refused and covered < JUMPING * self._made_of[0].time_scale:
            return IrregularMotionError(
                f"control: it jumps again and again at t = {t:.6g} s, "
                f"where {count} steps cover {covered:.2g} s; "
                "give dry friction as the model's friction, which also holds joints at rest, and sample a "
                "control that switches, with period=",
                field="control",
            )
        least = max(ACCELERATED * np.abs(velocity).max(), state.error(velocity))
        if not (np.abs(state.v - velocity).max() > least or covered > STALLED * scale):
            return IrregularMotionError(
                f"scene: {count} steps at t = {t:.6g} s without progress; the contact modes do not "
                "converge; a larger resting_speed may help",
                field="scene",
            )
        self._mark_progress()
        return None

    def _jam_or_refuse(self, refusal: IrregularMotionError) -> float:
        """Resolve the jam of slip whose forces grow until no step is short enough, or refuse to continue.

        Returns:
            The length to try next.

        Raises:
            IrregularMotionError: It is none.
        """
        if not self.state.resolve_jam(NEARLY_SINGULAR):
            raise refusal
        self._mark_progress()
        self._settle_and_begin()
        self._sample()
        return self.dynamics.first_length(self.rtol, self.atol)

    def _interrupt(self, step: DenseStep, interruption: Interruption, arriving: int | None) -> None:
        """End a step at an event of the user's."""
        state = self.state
        step.end = state.t = interruption.time
        state.q, state.v = step.at(state.t)
        self.w = step.work_at(state.t)
        self._sample()
        self._restart_after(interruption)
        if self.ended_by is None:
            self._settle_and_begin(arriving)
        if interruption.velocity is not None:
            self._sample()

    def _restart_after(self, interruption: Interruption) -> None:
        """Take over the velocity that an event has set, and whether it ends the run."""
        if interruption.velocity is not None:
            self.state.change_velocity(interruption.velocity)
        self.ended_by = interruption.ended_by

    def _let_events_happen(self) -> None:
        """Let the events happen whose guards an instant has taken to the other sign."""
        while self.events and self.ended_by is None:
            interruption = self.events.at_instant(self.state.t, self.state.q, self.state.v)
            if interruption is None:
                return
            self._restart_after(interruption)
            if self.ended_by is None:
                self._settle_contacts()

    def _end_at_event(self, step: DenseStep, t: float, arriving: int | None) -> bool:
        """End a step at an event and deal with it: something arrives, or else modes change.

        Returns:
            Whether it was one: forces that have left their bounds along the step, but are well within them at
            the same modes found again, have been off by the error of the step.
        """
        state = self.state
        step.end = state.t = t
        state.q, state.v = step.at(t)
        self.w = step.work_at(t)
        self._sample()
        if self.work.drift_at_end > self.drift_tolerance:
            state.correct_constraint_drift()
        if EVENTS[self.work.event_kind] is saturation and t == self.work.event_time:
            self.dynamics.change_side(self.work.event_index)
        bounded = arriving is None and EVENTS[self.work.event_kind] is force_bound
        modes, impacts = self.work.modes.copy(), len(state.impacts)
        if arriving is None:
            state.resolve_jam(leaving=bounded)
        self._settle_and_begin(arriving)
        # forces that a correction has brought back into their bounds leave them again soon
        if bounded and self.work.force_bound_ignored:
            state.set_modes_ahead(step)
            self._begin_motion()  # with the forces by which the modes were found, if those ahead are the same
        self._sample()
        same = len(state.impacts) == impacts and bool((self.work.modes == modes).all())
        return not (bounded and same and not self.work.force_bound_ignored)

    def _end_at_meeting(self, step: DenseStep, meeting: Meeting) -> None:
        """End a step where two shapes touch, or touch elsewhere."""
        state = self.state
        step.end = state.t = meeting.time
        state.q, state.v = step.at(state.t)
        self.w = step.work_at(state.t)
        self._sample()
        if self.work.drift_at_end > self.drift_tolerance:
            state.correct_constraint_drift()
        self._settle_and_begin(state.shapes_meet(meeting, step))
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
        impacts = self.state.impacts
        before = len(impacts)
        self.state.settle(arriving)
        if self.state.resolve_jam():
            self.state.settle()
        if len(impacts) > before:
            self._count_impacts(before)

    def _count_impacts(self, before: int) -> None:
        """Count the instant at which the impacts from a number on have taken place.

        Raises:
            SimulationError: There are too many.
        """
        impacts = self.state.impacts
        self._mark_progress()  # `max_impacts` watches over impacts
        self._struck += before == 0 or impacts[before - 1].time < self.state.t
        if self._struck > self.max_impacts:
            raise SimulationError(
                f"max_impacts: impacts at {self._struck} instants until t = {self.state.t:.6g} s, "
                f"the last at {_sources(impacts)}; "
                "if they accumulate, a larger resting_speed or a smaller restitution ends them, "
                "otherwise raise max_impacts",
                field="max_impacts",
                value=self.max_impacts,
            )
