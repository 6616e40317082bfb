"""Event-driven integration, with time steps where events cannot be located. (theory.md, section 16)"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import IrregularMotionError, SteppedWarning
from ._kernels.contact_forces import FREE, HELD, SLIP
from ._kernels.lie_charts import magnitudes
from ._kernels.tolerances import FIRST_STEP
from .crowds import cost_of_step
from .effects import LARGE
from .event_watch import EventWatch
from .hybrid_state import HybridState
from .integrator import Integrator
from .progress import BY_EVENTS, ended
from .recorder import Mark
from .records import SteppedInterval
from .smooth_steps import Outcome
from .time_stepping import TimeStepping

CHUNK = 8
"""Number of time steps after which the solutions of two step sizes are compared."""

SOON = 2.0
"""If the event-driven scheme fails again within this multiple of the last interval of time steps, the next
interval is twice as long."""

MOST_PARTS = 16
"""Largest number of parts into which time steps are divided to satisfy the tolerance."""

SHORTER = 16
"""Divisor of `dt` for the step size of a first interval; intervals that follow soon double it, up to `dt`."""

STEPS_PER_SCALE = 50.0
"""Least number of time steps per time scale of the scene; it limits `dt` in small scenes."""

ACCUMULATING, BRIEF, RARE = 200, 0.01, 0.05
"""Events accumulate if this number of steps is shorter than `BRIEF` times `dt` on average, and half of them
end at events. If fewer do, but this part at least, the time per event is what counts: after each event, stiff
joints may take many steps to settle."""

EARLY, LOOKED_AT, SOME, CHEAP = 10, 50, 0.1, 0.1
"""Time steps take over if event-driven steps cover less time than time steps `dt` would at the same cost, see
`cost_of_step`, and `SOME` of them end at events. As many steps are looked at as cost `LOOKED_AT` time steps,
at most that number; `EARLY` ones if they cover less by the factor `BRIEF` and cost no less than time steps.
Where a step costs less than `CHEAP` time steps, as with four contacts, only the accumulation of events
counts."""


class Alternating(TimeStepping):
    """A motion integrated by the event-driven scheme, with intervals of time steps; see `Integrator`."""

    def _prepare(self) -> None:
        state, dt = self.state, self.options.dt
        self._longest = min(dt, self.time_scale / STEPS_PER_SCALE)
        if state.coarse == 0.0:
            state.coarse = dt
        self._set_crossing(state.crossing)
        if state.crossing:
            self._prepare_steps()

    def _set_crossing(self, crossing: bool) -> None:
        """Set whether the motion advances by time steps."""
        self.state.crossing, self._dt = crossing, self.state.coarse
        self.instant.impacts.refuses = not crossing

    def begin(self, tau: Array | None = None) -> None:
        """Process the start and begin the motion; see `Integrator.begin`."""
        try:
            Integrator.begin(self, tau)
        except IrregularMotionError as error:
            self._cross(error)

    def hold_force(self, tau: Array, left: float) -> Outcome | None:
        """Replace the constant generalized force; see `Integrator.hold_force`."""
        if self.state.crossing:
            return TimeStepping.hold_force(self, tau, left)
        try:
            return Integrator.hold_force(self, tau, left)
        except IrregularMotionError as error:
            self._cross(error)
            return None

    def _settle_contacts(self, arriving: Any = None) -> None:
        (TimeStepping if self.state.crossing else Integrator)._settle_contacts(self, arriving)

    def _settle_and_begin(self, arriving: Any = None) -> None:
        (TimeStepping if self.state.crossing else Integrator)._settle_and_begin(self, arriving)

    def _last_sampled(self) -> tuple[Mark, HybridState]:
        """Return the end of the step whose event raised an error, or else the last consistent state.

        With user events it is the latter, so that the step is repeated: some may have happened within it.
        """
        (lengths, present), state = self.reached
        rows, (steps, samples, *others) = self.record.samples, lengths
        if self.events or len(rows) <= samples or rows[samples][0] <= state.t:
            return self.reached
        t, q, v, works, impact_energy = rows[samples]
        changed = state.copy(t=t, q=q, v=v, works=works, impact_energy=impact_energy)
        return Mark((steps + 1, samples + 1, *others), present), changed

    def _return_to(self, reached: tuple[Mark, HybridState]) -> None:
        """Return to an earlier record and state."""
        mark, state = reached
        self.record.cut(mark)
        self.state.assign(state)

    def _report_violation(self, text: str) -> None:
        raise IrregularMotionError(f"scene: {text[0].lower() + text[1:]}")

    # ---- crossing

    def _step(self, h: float, stop: float, scale: float, begun: Outcome | None = None) -> float:
        """Take one event-driven step or several time steps; return the step size to try next [s]."""
        state = self.state
        if not state.crossing:
            try:
                length = Integrator._step(self, h, stop, scale, begun)
                self._watch_events()
                return length
            except IrregularMotionError as error:
                self._cross(error)
        entering, state.entering = state.entering, False
        length, entry = FIRST_STEP * self._longest if entering else CHUNK * state.coarse, self.mark()
        try:
            self._step_until(min(stop, state.until, state.t + length))
        except IrregularMotionError:  # near a locked posture (theory.md, 13.4) only longer steps leave it
            if not entering and state.coarse >= self._longest:
                raise
            self._return_to(entry)
            state.coarse *= 1.0 if entering else 2.0
            state.until = max(state.until, state.t + CHUNK * state.coarse)
            return state.coarse
        if state.t < state.until or state.ended_by is not None:
            return state.coarse
        return self._hand_back()

    def _watch_events(self) -> None:
        """Check that event-driven steps are not much more expensive than time steps.

        Raises:
            IrregularMotionError: Events accumulate, or many contacts are active and steps are short for it.
        """
        steps, active = self.record.dense_steps, self.work.active_contacts
        taken, cost = len(steps) - self.state.events_since, cost_of_step(active)
        costly = cost > CHEAP
        rules = [(ACCUMULATING, BRIEF, RARE)]
        if costly:
            enough = max(min(LOOKED_AT, int(LOOKED_AT / cost)), 1)
            rules = [(enough, cost, SOME), *[(EARLY, BRIEF * cost, SOME)] * (cost >= 1.0)]
        for count, share, least in rules:
            if taken < count:
                continue
            covered = steps[-1].end - steps[-count].start
            if covered >= share * count * self._longest:  # regular steps
                continue
            # the lowest point of a nearly flat rim runs around it, which nothing damps
            events = count if self.rims and self.rims.active() else ended(self.instant, count)
            most = share * (count if costly else min(count, events / BY_EVENTS)) * self._longest
            if covered < most and events >= least * count:
                raise IrregularMotionError(
                    f"scene: {count} steps cover {covered:.3g} s, with active contacts: {active}"
                )

    def _cross(self, error: IrregularMotionError) -> None:
        """Return to the last consistent state, and change to time steps because of an error."""
        self._return_to(self._last_sampled())
        state = self.state
        if not self.record.stepping_warned:
            self.record.stepping_warned = True
            warnings.warn(
                f"t = {state.t:.6g} s: time steps are taken, since events cannot be located here: "
                f"{error}. `trajectory.stepped` lists all such intervals.",
                SteppedWarning,
                stacklevel=2,
            )
        soon = state.t - state.handed_back <= SOON * state.interval
        lasts = bool(self.shapes) or self.work.active_contacts > LARGE  # aligned faces stay so for a while
        if soon or lasts:
            state.coarse = self._longest if lasts else min(2.0 * state.coarse, self._longest)
            state.interval = max(2.0 * state.interval * soon, CHUNK * state.coarse)
        else:
            state.coarse = self._longest / SHORTER
            state.interval = CHUNK * state.coarse
        state.until = state.t + state.interval
        if not (state.stepped and state.stepped[-1].end == state.t):
            state.stepped += (SteppedInterval(state.t, state.t, state.coarse, str(error), 0.0),)
        self._set_crossing(True)
        state.entering = True
        state.islands = state.resting_forces = state.warm_start = None
        self.shapes.clear()
        self._prepare_steps()
        self.work.sliding_friction[:] = 0.0
        self._faces.place(state.q, state.v, 0.0, touching=self._touching)
        gaps, rates = self.dynamics.gaps_at(state.q, state.v).T
        # the first step stops the contacts that arrive without restitution
        if (self._impacts.always & (gaps <= self._touching) & (rates < -self.work.resting_speed)).any():
            self._collide()
        self._trigger_events()

    def _step_until(self, end: float) -> None:
        """Take time steps until a time [s], with a step size that satisfies the tolerance if possible.

        The required step size follows from the difference of two solutions, by the first order of the method.
        Once the error of an interval is unknown, only one solution is computed.
        """
        state, start, begun = self.state, self.mark(), self.state.t
        if math.isnan(state.stepped[-1].error):
            self._run(end, state.coarse)
            state.stepped = (*state.stepped[:-1], replace(state.stepped[-1], end=state.t))
            return
        self._unlocated = False
        q_coarse, v_coarse, impacts_coarse = self._try(start, end, state.coarse)
        q, v, impacts = self._try(start, end, 0.5 * state.coarse)
        error, parts = math.nan, 2
        if impacts_coarse == impacts and not self._unlocated:
            by_position = np.abs(pin.difference(self.model, q_coarse, q))
            errors = np.maximum(by_position, 0.5 * state.coarse * np.abs(v_coarse - v))
            sizes = np.empty(len(v))
            magnitudes(self.work.joint_charts, q, sizes)
            allowed = self.work.atol + self.work.rtol * np.maximum(self.extent, sizes)
            error = float(errors.max(initial=0.0))
            wanted = 2 * math.ceil((errors / allowed).max(initial=0.0))
            if 2 < wanted <= MOST_PARTS:
                error, parts = 2.0 * error / wanted, wanted
        if self.events or parts > 2:
            self._return_to(start)
            self._run(end, state.coarse / parts)
        last = state.stepped[-1]
        dt, added = min(last.dt, state.coarse / parts), error * (state.t - begun) / (end - begun)
        now = SteppedInterval(last.start, state.t, dt, last.reason, last.error + added)
        state.stepped = (*state.stepped[:-1], now)

    def _try(self, start: tuple[Mark, HybridState], end: float, dt: float) -> tuple[Array, Array, list[str]]:
        """Take time steps of size dt [s] from a state until a time [s], without user events.

        Returns:
            q (nq,) and v (nv,) at the end, and the names of the contacts and limits that collided, in order.
        """
        self._return_to(start)
        impacts = len(self.record.impacts)
        watch, self.events = self.events, EventWatch((), math.inf, self.state, [])
        try:
            self._run(end, dt)
        finally:
            self.events = watch
        return self.state.q, self.state.v, [impact.source for impact in self.record.impacts[impacts:]]

    def _run(self, end: float, dt: float) -> None:
        """Take time steps of size dt [s] until a time [s], or until an event ends the motion."""
        self._dt = dt
        self.state.pushed = self._no_change  # impulses of steps of another size do not predict these
        self._rest.wake_all()
        while self.state.t < end and self.state.ended_by is None:
            TimeStepping._step(self, dt, end, 1.0)

    def _hand_back(self) -> float:
        """Change back to the event-driven scheme, or stay with time steps if it fails.

        Returns:
            The step size to try next [s].
        """
        state, work = self.state, self.work
        state.handed_back = state.t
        self.reached = self.mark()
        self._set_crossing(False)
        try:
            filled = self.shapes.restart(state.q, state.v, self._touching)
            gaps, rates = self.dynamics.gaps_at(state.q, state.v).T
            near = (gaps <= self._touching) & (rates <= work.resting_speed)
            pairs = np.array([c.pair is not None for c in self.dynamics.contacts], dtype=bool)
            near[: work.contacts] &= ~pairs & (work.bilateral == 0)
            near[filled] = True
            work.modes[: len(near)] = np.where(near, SLIP, FREE)
            work.modes[np.flatnonzero(work.bilateral)] = HELD
            Integrator._settle_contacts(self)
            self.instant.correct_constraint_drift()
            self._begin_motion()
            self._rest_on_edges()
        except IrregularMotionError as error:
            self._cross(error)
            return state.coarse
        self._sample()
        self.progress.mark()
        state.cut_short, state.events_since = False, len(self.record.dense_steps)
        work.end_gain[:] = 0.0
        return self.dynamics.first_length()
