"""Motions whose events are located where that goes, and crossed by time stepping where it does not.

(theory.md, section 16)
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..errors import IrregularMotionError, SteppedWarning
from ._kernels.contact_forces import FREE, HELD, SLIP
from .effects import CROWD
from .events import EventWatch
from .integrator import RUBBING, Integrator
from .records import SteppedInterval
from .scene import Scene
from .time_stepping import TimeStepping

Array = NDArray[np.float64]

CHUNK = 8
"""Steps after which two lengths of steps are compared."""

FIRST = 1e-4
"""Part of a step that the first one takes: what arrives without restitution is stopped in it, where it is."""

MOST_PARTS = 16
"""Parts of a step down to which they are shortened where that keeps to the tolerance."""

SHORTER = 16
"""Part of `dt` with which a crossing begins; intervals that follow each other soon double it, up to `dt`."""

STEPS_PER_SCALE = 50.0
"""Steps at least in the time scale of the scene, for scenes so small that `dt` would be too long."""

ACCUMULATING, BRIEF = 200, 0.01
"""So many steps that last a smaller part of `dt` on average are accumulating events, if half end at one."""

WHOLE = 0.999
"""Part of a step that is covered if no event ends it: the end of a run rounds its length."""

LOOKED_AT = 50
"""Steps over which it is watched: if they are shorter than `dt` on average, time steps take over."""


OWN = (
    "_crossing",
    "_prepared",
    "_entering",
    "_until",
    "_interval",
    "_coarse",
    "_handed_back",
    "_begun_at",
    "_unsolved",
)
"""Attributes that are replaced and never changed in place, so that copies share them."""


class _Reached(NamedTuple):
    """What a motion has reached where it is consistent, to return to."""

    lengths: tuple[Any, ...]
    state: tuple[Any, ...]
    events: tuple[Any, ...]


class Alternating(TimeStepping):
    """A motion by the event-driven scheme, with intervals in time steps; see `Integrator`.

    Args:
        scene, q0, v0, rtol, atol, max_step, max_impacts: As of `simulate`.
        dt: The longest length of time steps [s].
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
        dt: float,
    ) -> None:
        self._crossed: list[SteppedInterval] = []
        self._crossing = self._prepared = self._entering = False
        self._until, self._interval, self._coarse, self._handed_back = 0.0, 0.0, dt, -math.inf
        self._begun_at = 0  # the step at which events began to be located again
        self._longest, self._unsolved = dt, 0.0
        Integrator.__init__(self, scene, q0, v0, rtol, atol, max_step, max_impacts)
        self.state.crowds_refused = True
        self._longest = min(dt, scene.time_scale / STEPS_PER_SCALE)

    def _arguments(self) -> tuple[Any, ...]:
        return *self._made_of, self._longest

    def _values(self) -> dict[str, Any]:
        values = TimeStepping._values(self) if self._prepared else Integrator._values(self)
        own = {name: getattr(self, name) for name in OWN}
        return values | {"own": own, "crossed": self._crossed.copy()}

    def _take_over(self, values: dict[str, Any]) -> None:
        if "stepping" in values:
            self._prepare(self._longest)
        (TimeStepping if "stepping" in values else Integrator)._take_over(self, values)
        self._crossed = values["crossed"].copy()
        for name, value in values["own"].items():
            setattr(self, name, value)
        self.state.crowds_refused = not self._crossing
        self._lengths()

    def begin(self, tau: Array | None = None) -> None:
        """Let what happens at the start happen, and begin to move; see `Integrator.begin`."""
        try:
            Integrator.begin(self, tau)
        except IrregularMotionError as error:
            self._cross(error)

    def hold_force(self, tau: Array) -> None:
        """Let a constant force (nv,) act from now on."""
        if self._crossing:
            TimeStepping.hold_force(self, tau)
            return
        try:
            Integrator.hold_force(self, tau)
        except IrregularMotionError as error:
            self._cross(error)

    def _stepped(self) -> Sequence[SteppedInterval]:
        return self._crossed

    def _settle_contacts(self, arriving: Any = None) -> None:
        (TimeStepping if self._crossing else Integrator)._settle_contacts(self, arriving)

    def _settle_and_begin(self, arriving: Any = None) -> None:
        (TimeStepping if self._crossing else Integrator)._settle_and_begin(self, arriving)

    def _lengths(self) -> tuple[Any, ...]:
        state, lengths = self.state, super()._lengths()
        self._reached = _Reached(
            lengths,
            (
                *(state.t, state.q, state.v, state.impact_energy),
                *(self.w, self._struck, self.ended_by, self._unsolved),
            ),
            self.events.values() if self.events else (),
        )
        return lengths

    def _last_sampled(self) -> _Reached:
        """Return the end of the step whose event is refused, or else the last consistent state.

        Events of the user's may have happened within that step, so that with them it is repeated.
        """
        reached, (steps, samples, *others) = self._reached, self._reached.lengths
        if self.events or len(self.samples) <= samples or self.samples[samples][0] <= reached.state[0]:
            return reached
        t, q, v, w, impact_energy = self.samples[samples]
        return _Reached(
            (steps + 1, samples + 1, *others), (t, q, v, impact_energy, w, *reached.state[5:]), reached.events
        )

    def _return_to(self, reached: _Reached) -> None:
        """Return to what was consistent."""
        state = self.state
        steps, samples, impacts, events, intervals, present, notes = reached.lengths
        for rows, length in (
            (self.dense_steps, steps),
            (self.samples, samples),
            (state.impacts, impacts),
            (self.events.records, events),
            (state.modes.ended, intervals),
            (state.notes, notes),
        ):
            del rows[length:]
        state.modes.return_to(present)
        state.t, state.q, state.v, state.impact_energy, *own = reached.state
        self.w, self._struck, self.ended_by, self._unsolved = own
        if self.events:
            self.events.take_over(reached.events)

    # ---- crossing

    def _step(self, h: float, stop: float, scale: float) -> float:
        """Take a step of the event-driven scheme, or some time steps; return the length to try next."""
        if not self._crossing:
            try:
                length = Integrator._step(self, h, stop, scale)
                self._watch_events()
                return length
            except IrregularMotionError as error:
                self._cross(error)
        entering, self._entering = self._entering, False
        length, begun = FIRST * self._longest if entering else CHUNK * self._coarse, self._lengths_reached()
        try:
            self._step_until(min(stop, self._until, self.state.t + length))
        except IrregularMotionError:  # where nothing moves a contact only longer steps leave that posture
            if not entering and self._coarse >= self._longest:
                raise
            self._return_to(begun)
            self._coarse *= 1.0 if entering else 2.0
            self._until = max(self._until, self.state.t + CHUNK * self._coarse)
            return self._coarse
        if self.state.t < self._until or self.ended_by is not None:
            return self._coarse
        return self._hand_back()

    def _watch_events(self) -> None:
        """Refuse to go on where events accumulate, or with many closed contacts are closer than time steps.

        Raises:
            IrregularMotionError: See above.
        """
        closed, steps = self.work.active_contacts, self.dense_steps
        crowded = closed > CROWD
        count, part = (LOOKED_AT, 1.0) if crowded else (ACCUMULATING, BRIEF)
        if len(steps) - self._begun_at < count:
            return
        start = steps[-count].start
        covered = steps[-1].end - start
        if covered >= part * count * self._longest:
            return
        ended = sum(step.end - step.start < WHOLE * step.h for step in steps[-count:])
        if crowded or ended > 0.5 * count:
            raise IrregularMotionError(
                f"scene: {count} steps cover {covered:.3g} s, with active contacts: {closed}", field="scene"
            )

    def _cross(self, refusal: IrregularMotionError) -> None:
        """Return to the last consistent state, and cross what comes by time steps."""
        self._return_to(self._last_sampled())
        state = self.state
        if not self._prepared:
            self._prepared = True
            warnings.warn(
                f"t = {state.t:.6g} s: events cannot be located here, and time steps are taken: "
                f"{refusal} trajectory.stepped lists all such intervals.",
                SteppedWarning,
                stacklevel=2,
            )
        soon = state.t - self._handed_back <= self._interval
        lasts = bool(state.shapes) or self.work.active_contacts > CROWD  # aligned faces stay so for a while
        if soon or lasts:
            self._coarse = self._longest if lasts else min(2.0 * self._coarse, self._longest)
            self._interval = max(2.0 * self._interval * soon, CHUNK * self._coarse)
        else:
            self._coarse = self._longest / SHORTER
            self._interval = CHUNK * self._coarse
        self._until = state.t + self._interval
        if not (self._crossed and self._crossed[-1].end == state.t):
            self._crossed.append(SteppedInterval(state.t, state.t, self._coarse, str(refusal), 0.0))
        self._crossing = self._entering = True
        state.crowds_refused = False
        state.shapes.clear()
        self._prepare(self._longest)
        self.work.sliding_friction[:] = 0.0
        self._faces.place(state.q, state.v, 0.0, touching=self._touching)
        gaps, rates = self.dynamics.gaps_at(state.q, state.v).T
        # what arrives here without restitution is stopped by the first step
        if (self._bounces & (gaps <= self._touching) & (rates < -self.work.resting_speed)).any():
            self._collide()
        self._let_events_happen()

    def _step_until(self, end: float) -> None:
        """Take time steps until a time, whose length keeps to the tolerance where that can be.

        Steps of two lengths are compared; of first order, they tell the length that keeps to it.
        """
        start, begun = self._lengths_reached(), self.state.t
        coarse = self._try(start, end, self._coarse)
        fine = self._try(start, end, 0.5 * self._coarse)
        error, parts = math.nan, 2
        if coarse.order == fine.order:
            by_position = np.abs(pin.difference(self.model, coarse.q, fine.q)).max(initial=0.0)
            by_velocity = 0.5 * self._coarse * np.abs(coarse.v - fine.v).max(initial=0.0)
            error = float(max(by_position, by_velocity))
            allowed = self.atol + self.rtol * max(self._made_of[0].extent, np.abs(fine.q).max(initial=0.0))
            wanted = 2 * math.ceil(error / allowed)
            if 2 < wanted <= MOST_PARTS:
                error, parts = 2.0 * error / wanted, wanted
        if self.events or parts > 2:
            self._return_to(start)
            self._run(end, self._coarse / parts)
        last = self._crossed[-1]
        self._crossed[-1] = SteppedInterval(
            last.start,
            self.state.t,
            min(last.dt, self._coarse / parts),
            last.reason,
            last.error + error * (self.state.t - begun) / (end - begun),
        )

    def _lengths_reached(self) -> _Reached:
        self._consistent = self._lengths()
        return self._reached

    def _try(self, start: _Reached, end: float, dt: float) -> _Tried:
        """Take time steps from a state on until a time, without events of the user's; return the end."""
        self._return_to(start)
        watch, self.events = self.events, EventWatch((), math.inf)
        try:
            self._run(end, dt)
        finally:
            self.events = watch
        order = [impact.source for impact in self.state.impacts[start.lengths[2] :]]
        return _Tried(self.state.q, self.state.v, order)

    def _run(self, end: float, dt: float) -> None:
        """Take time steps until a time, or until an event ends the motion."""
        self._dt = dt
        self._pushed[:] = 0.0  # impulses in steps of another length are no start for these
        self._rest.wake_all()
        while self.state.t < end and self.ended_by is None:
            TimeStepping._step(self, dt, end, 1.0)

    def _hand_back(self) -> float:
        """Go on by the event-driven scheme; return the length to try, or that of time steps if it refuses."""
        self._consistent = self._lengths()
        state, work = self.state, self.work
        self._crossing, self._handed_back = False, state.t
        state.crowds_refused = True
        try:
            filled = state.shapes.restart(state.q, self._touching)
            gaps, rates = state.dynamics.gaps_at(state.q, state.v).T
            near = (gaps <= self._touching) & (rates <= work.resting_speed)
            pairs = np.array([c.pair is not None for c in self.dynamics.contacts], dtype=bool)
            near[: work.contacts] &= ~pairs & (work.bilateral == 0)
            near[filled] = True
            work.modes[: len(near)] = np.where(near, SLIP, FREE)
            work.modes[np.flatnonzero(work.bilateral)] = HELD
            Integrator._settle_contacts(self)
            state.correct_constraint_drift()
            self._begin_motion()
        except IrregularMotionError as error:
            self._cross(error)
            return self._coarse
        self._sample()
        self._mark_progress()
        self._cut_short, self._begun_at = False, len(self.dense_steps)
        self.rubbed = self.w[RUBBING]
        return self.dynamics.first_length(self.rtol, self.atol)


class _Tried(NamedTuple):
    """Where time steps of one length have led, and what has collided on the way."""

    q: Array
    v: Array
    order: list[str]
