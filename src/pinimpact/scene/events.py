"""Events of a user's own: a guard, a function of time and state, changes its sign."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array, in_short, real_number
from ..display import short_repr
from ..errors import InputError, SimulationError
from .crossing import crossing
from .dense_step import DenseStep
from .records import EventRecord

Array = NDArray[np.float64]
Guard = Callable[[float, Array, Array], float]
"""guard(t, q, v) -> a number whose sign counts; truth values have none."""
Callback = Callable[[float, Array, Array], ArrayLike | None]
"""callback(t, q, v) -> (nv,) velocity after the event, or None to keep it."""


@dataclass(frozen=True, eq=False, repr=False)
class Event:
    """A user event: it occurs when a function of time and state changes sign.

    The guard is evaluated at the start, middle and end of each step, and at least once per quarter of
    `Scene.time_scale`; the change of sign is then located within the step to rounding. Two changes of sign
    between evaluations can be missed; `max_step=` shortens the steps. If an impact changes the sign of the
    guard, the event occurs after the impact. Zero has no sign: a guard that is zero at the start, or touches
    zero without changing sign, causes no event.

    Attributes:
        guard: guard(t, q, v) -> number, with q (nq,) and v (nv,).
        callback: callback(t, q, v), called at the event; it returns None, or the velocity (nv,)
            after the event. Contacts that then approach collide.
        terminal: Whether the event ends the run, after the callback; a number n: at the n-th event.
        direction: 1: changes from negative to positive only; -1: from positive to negative only; 0: both.
        name: Name in the trajectory; None for the name of the guard.

    Raises:
        InputError: A guard or callback that cannot be called, a direction that is not a number, or a
            terminal that is neither a truth value nor a number above zero.
    """

    guard: Guard
    callback: Callback | None = None
    terminal: bool | int = False
    direction: float = 0
    name: str | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for field in ("guard", "callback"):
            function = getattr(self, field)
            if not callable(function) and (field == "guard" or function is not None):
                raise _refused(field, function, "a function of (t, q, v) expected")
        if not isinstance(self.terminal, (bool, int, np.integer, np.bool_)) or self.terminal < 0:
            raise _refused(
                "terminal", self.terminal, "True, False or how often the event may happen expected"
            )
        plain = isinstance(self.direction, (int, float, np.number)) and not isinstance(self.direction, bool)
        if not plain or self.direction not in (-1, 0, 1):
            raise _refused("direction", self.direction, "1 (rising), -1 (falling) or 0 (both) expected")
        if not isinstance(self.name, (str, type(None))):
            raise _refused("name", self.name, "text expected")

    @property
    def label(self) -> str:
        """The name, or that of the guard."""
        return self.name or str(getattr(self.guard, "__name__", "event"))


def _refused(field: str, value: Any, expected: str) -> InputError:
    return InputError(f"events: {field}={in_short(value)} given; {expected}", field="events", value=value)


def as_events(events: Any) -> tuple[Event, ...]:
    """Return events from events or plain guards, which may carry scipy's ``terminal`` and ``direction``.

    Raises:
        InputError: One that is neither, or two of one name.
    """
    if not isinstance(events, Iterable):
        events = (events,)
    found = []
    for item in events:
        if not isinstance(item, Event):
            if not callable(item):
                raise InputError(
                    f"events: {in_short(item)} is neither an Event nor a function of (t, q, v)",
                    field="events",
                    value=item,
                )
            item = Event(
                item, terminal=getattr(item, "terminal", False), direction=getattr(item, "direction", 0)
            )
        found.append(item)
    labels = [event.label for event in found]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(
                f"events: {labels.count(label)} events are called {label!r}; give each its own name=",
                field="events",
                value=label,
            )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Interruption:
    """An event that changes or ends the motion.

    Attributes:
        time: When [s].
        velocity: (nv,) after the event, or None for no change.
        ended_by: Name of the event if it ends the run, else None.
    """

    time: float
    velocity: Array | None
    ended_by: str | None


class EventWatch:
    """The events of one run: what sign each guard had, and what has happened.

    Args:
        events: The events.
        every: The time after which guards are evaluated again at the latest [s].

    Attributes:
        records: The events that have happened, in order.
    """

    def __init__(self, events: Sequence[Event], every: float) -> None:
        self.records: list[EventRecord] = []
        self._events, self._every = tuple(events), every
        self._signs = [0.0] * len(self._events)
        self._times = [0] * len(self._events)
        self._instant = -math.inf
        self._happened: set[int] = set()

    def values(self) -> tuple[Any, ...]:
        """Return the state of the watch, to be pickled or given to `take_over`."""
        lists = self.records.copy(), self._signs.copy(), self._times.copy()
        return *lists, self._instant, self._happened.copy()

    def take_over(self, values: tuple[Any, ...]) -> None:
        """Continue from the `values` of another run of the same scene."""
        records, signs, times, self._instant, happened = values
        self.records, self._signs, self._times = records.copy(), signs.copy(), times.copy()
        self._happened = happened.copy()

    def __bool__(self) -> bool:
        return bool(self._events)

    def at_instant(self, t: float, q: Array, v: Array) -> Interruption | None:
        """Take the signs at an instant, after its impacts; let events happen whose guards have changed there.

        At one instant each event happens once, so this comes to an end however often it is called.
        """
        for i, event in enumerate(self._events):
            sign = _sign(self._value(i, t, q.copy(), v.copy()))
            counts = _counts(event, self._signs[i], sign) and not (t == self._instant and i in self._happened)
            self._signs[i] = sign or self._signs[i]
            if counts:
                interruption = self._happen(i, t, q, v)
                if interruption is not None:
                    return interruption
        return None

    def within(self, step: DenseStep, end: float) -> Interruption | None:
        """Let the events happen that a step meets until `end`, up to one that interrupts it."""
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
        """Return when the first guard changes its sign, and which; take over the signs until then."""
        found, which = math.inf, -1
        changed = list(self._signs)
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
            self._signs = changed
            return None
        for i, event in enumerate(self._events):
            sign = _sign(self._value(i, found, *step.at(found)))
            if sign and not _counts(event, self._signs[i], sign):  # what counts happens from there on
                self._signs[i] = sign
        self._signs[which] = -changed[which]
        return found, which

    def _locate(self, i: int, step: DenseStep, a: float, b: float, sign: float) -> float:
        """Return where a guard of this sign until a has the other one, to rounding and not before.

        By Ridders' method. The time is a where something there has changed the sign.
        """

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
                field="events",
                value=value,
            )
        return value

    def _happen(self, i: int, t: float, q: Array, v: Array) -> Interruption | None:
        event = self._events[i]
        if t != self._instant:
            self._instant = t
            self._happened.clear()
        self._happened.add(i)
        self._times[i] += 1
        velocity = _called_back(event, t, q, v)
        after = v.copy() if velocity is None else velocity
        self.records.append(EventRecord(t, event.label, q.copy(), v.copy(), after))
        ends = 0 < int(event.terminal) <= self._times[i]
        if velocity is None and not ends:
            return None
        return Interruption(t, velocity, event.label if ends else None)


def _called_back(event: Event, t: float, q: Array, v: Array) -> Array | None:
    """Return the velocity that the callback asks for, or None."""
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
    """Whether a change from one sign to another is the event; zeros are no signs."""
    return before * after < 0.0 and after * event.direction >= 0.0


def _failure(event: Event, what: str, t: float, error: Exception) -> SimulationError:
    return SimulationError(
        f"events: {type(error).__name__} in the {what} of {event.label!r} at t = {t:.6g} s: {error}",
        field="events",
    )
