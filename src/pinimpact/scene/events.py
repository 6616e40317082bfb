"""User events: sign changes of a guard, a function of time and state."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import in_short
from ..display import short_repr
from ..errors import InputError

Guard = Callable[[float, Array, Array], float]
"""guard(t, q, v) -> number; its sign changes are the events."""
Callback = Callable[[float, Array, Array], ArrayLike | None]
"""callback(t, q, v) -> (nv,) velocity after the event, or None to keep it."""
Jacobian = Callable[[float, Array, Array], ArrayLike]
"""jacobian(t, q, v) -> (nv + 1, 2 nv + 1) of the velocity after the event and the guard, by q, v and t."""


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
        jacobian: jacobian(t, q, v), for derivatives of motions: (nv + 1, 2 nv + 1) of the velocity that the
            callback sets, and last of the guard, by q in the tangent space, v and t.

    Raises:
        InputError: A guard, callback or jacobian that cannot be called, a direction that is not a number, or
            a terminal that is neither a truth value nor a number above zero.
    """

    guard: Guard
    callback: Callback | None = None
    terminal: bool | int = False
    direction: float = 0
    name: str | None = None
    jacobian: Jacobian | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for field in ("guard", "callback", "jacobian"):
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
    return InputError(f"events: {field}={in_short(value)} given; {expected}", value=value)


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
                    f"events: {in_short(item)} is neither an Event nor a function of (t, q, v)", value=item
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
                value=label,
            )
    return tuple(found)
