"""Detection of user events: sign changes of their guards along a motion."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..arrays import Array
from ..checks import finite_array, real_number
from ..errors import SimulationError
from .dense_step import DenseStep
from .events import Event
from .hybrid_state import HybridState
from .records import EventRecord


@dataclass(frozen=True, slots=True)
class Interruption:
    """A user event that changes or ends the motion.

    Attributes:
        time: Time of the event [s].
        velocity: (nv,) velocity after the event, or None if it is unchanged.
        ended_by: Name of the event if it ends the run, else None.
    """

    time: float
    velocity: Array | None
    ended_by: str | None


class EventWatch:
    """The user events of one run.

    Args:
        events: The events.
        every: Longest time between evaluations of a guard [s].
        state: State of the motion, which stores the signs of the guards.
        records: List to which the records of events are appended.
    """

    def __init__(
        self, events: Sequence[Event], every: float, state: HybridState, records: list[EventRecord]
    ) -> None:
        self._events, self._every = tuple(events), every
        self._state, self._records = state, records
        if not state.signs:
            state.signs, state.counts = (0.0,) * len(self._events), (0,) * len(self._events)

    def __bool__(self) -> bool:
        return bool(self._events)

    def at_instant(self, t: float, q: Array, v: Array) -> Interruption | None:
        """Update the signs of the guards after the impacts of an instant, and trigger the events there.

        Each event happens at most once per instant, so repeated calls end. A guard that is left at zero has
        no sign until the motion gives it one.

        Returns:
            The first event that changes or ends the motion, or None.
        """
        state = self._state
        for i, event in enumerate(self._events):
            sign, before = _sign(self._value(i, t, q.copy(), v.copy())), state.signs[i]
            happened = t == state.instant and i in state.happened
            if happened and before == 0.0:
                continue
            counts = _counts(event, before, sign) and not happened
            state.signs = _with(state.signs, i, sign or before)
            if counts:
                interruption = self._happen(i, t, q, v)
                if interruption is not None:
                    return interruption
        return None

    def within(self, step: DenseStep, end: float) -> Interruption | None:
        """Trigger the events in a step up to `end` [s]; return the first that changes or ends the motion."""
        start = step.start
        while True:
            pieces = max(2, math.ceil((end - start) / self._every))
            times = [start + k * ((end - start) / pieces) for k in range(1, pieces)] + [end]
            first = self._first(step, start, times)
            if first is None:
                return None
            start, i = first
            interruption = self._happen(i, start, *step.at(start))
            if interruption is not None:
                return interruption

    def _first(self, step: DenseStep, start: float, times: list[float]) -> tuple[float, int] | None:
        """Return the time and number of the first event in a step, or None; update the signs up to it.

        Args:
            step: The step.
            start: Time from which to search [s].
            times: Times at which the guards are evaluated, in ascending order [s].
        """
        found, which = math.inf, -1
        changed = list(self._state.signs)
        for i, event in enumerate(self._events):
            before = start
            for time in times:
                sign = _sign(self._value(i, time, *step.at(time)))
                if _counts(event, changed[i], sign):
                    crossing = self._locate(i, step, before, time, changed[i])
                    if crossing < found:
                        found, which = crossing, i
                    break
                if sign:
                    before, changed[i] = time, sign
        if which < 0:
            self._state.signs = tuple(changed)
            return None
        signs = list(self._state.signs)
        for i, event in enumerate(self._events):
            sign = _sign(self._value(i, found, *step.at(found)))
            if sign and not _counts(event, signs[i], sign):  # other events are detected from there on
                signs[i] = sign
        signs[which] = -changed[which]
        self._state.signs = tuple(signs)
        return found, which

    def _locate(self, i: int, step: DenseStep, a: float, b: float, sign: float) -> float:
        """Return the time in [a, b] at which guard i leaves the given sign, see `crossing`."""

        def value(t: float) -> float:
            return sign * self._value(i, t, *step.at(t))

        return crossing(value, a, b, step.h)

    def _value(self, i: int, t: float, q: Array, v: Array) -> float:
        event = self._events[i]
        try:
            value = real_number("guard", event.guard(t, q, v))
        except Exception as error:
            raise _failure(event, "guard", t, error) from error
        if math.isnan(value):
            raise SimulationError(
                f"events: {value} returned by the guard of {event.label!r} at t = {t:.6g} s; a "
                "number expected",
                value=value,
            )
        return value

    def _happen(self, i: int, t: float, q: Array, v: Array) -> Interruption | None:
        event, state = self._events[i], self._state
        before: frozenset[int] = state.happened if t == state.instant else frozenset()
        state.instant, state.happened = t, before | {i}
        state.counts = _with(state.counts, i, state.counts[i] + 1)
        velocity = _called_back(event, t, q, v)
        after = v.copy() if velocity is None else velocity
        if velocity is not None and self._value(i, t, q, velocity) == self._value(i, t, q, v):
            state.signs = _with(state.signs, i, 0.0)  # the new velocity decides to which side the guard goes
        self._records.append(EventRecord(t, event.label, q.copy(), v.copy(), after))
        ends = 0 < int(event.terminal) <= state.counts[i]
        if velocity is None and not ends:
            return None
        return Interruption(t, velocity, event.label if ends else None)


def _with(values: tuple[Any, ...], i: int, value: Any) -> tuple[Any, ...]:
    """Return values with the i-th replaced."""
    return *values[:i], value, *values[i + 1 :]


def _called_back(event: Event, t: float, q: Array, v: Array) -> Array | None:
    """Call the callback of an event; return the velocity (nv,) that it sets, or None."""
    if event.callback is None:
        return None
    try:
        velocity = event.callback(t, q.copy(), v.copy())
        return None if velocity is None else finite_array("velocity", velocity, v.shape).copy()
    except Exception as error:
        raise _failure(event, "callback", t, error) from error


def _sign(value: float) -> float:
    return float((value > 0.0) - (value < 0.0))


def _counts(event: Event, before: float, after: float) -> bool:
    """Whether a change from one sign to another triggers the event; zero has no sign."""
    return before * after < 0.0 and after * event.direction >= 0.0


def _failure(event: Event, what: str, t: float, error: Exception) -> SimulationError:
    return SimulationError(
        f"events: {type(error).__name__} in the {what} of {event.label!r} at t = {t:.6g} s: {error}"
    )


def crossing(value: Callable[[float], float], a: float, b: float, h: float) -> float:
    """Return where a function changes from positive to nonpositive between a and b, by Ridders' method.

    The root is bracketed to the rounding of b and of the step size h; its upper end is returned. If the
    function is not positive at a, a is returned.
    """
    fa, fb = value(a), value(b)
    if not fa > 0.0:
        return a
    while True:
        middle = 0.5 * (a + b)
        if b - a <= sys.float_info.epsilon * (abs(b) + h) or not a < middle < b or fb == 0.0:
            return b
        fm = value(middle)
        guess = middle + (middle - a) * fm / math.sqrt(fm * fm - fa * fb)
        for t, f in ((middle, fm), (guess, None)):
            if a < t < b:
                f = value(t) if f is None else f
                if f > 0.0:
                    a, fa = t, f
                else:
                    b, fb = t, f
