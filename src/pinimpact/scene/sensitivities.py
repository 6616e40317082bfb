"""Derivatives of a motion by its initial state and by coefficients of contacts. (docs/derivatives.md, 9)

"Changes" (2nv, n) are as in `saltation`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..checks import as_tuple, in_short, near_matches
from ..contact_space.derivatives import Boundary
from ..errors import InputError, UnknownNameError
from ._kernels.contact_forces import SLIP, STICK
from ._kernels.tolerances import LEAST_INTERVAL
from .collocation import RULES, collocate
from .control_slopes import HeldForces, forces_by_state, jacobian_of
from .controls import JointPD
from .dense_step import WHOLE, DenseStep
from .dynamics import SceneDynamics
from .events import as_events
from .forces import ClosedSet
from .mode_slopes import SlopesWithin
from .records import EventRecord, ImpactRecord, Sensitivity
from .saltation import SLOWEST, Parameter, Saltation
from .scene import Scene
from .step_slopes import StepSlopes

STEEP = 0.4
"""An interval is halved if the ratio of the speeds of slip at its ends is below this number."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearization:
    """The derivatives of a step, see `Stepper.linearize`; unpacks as A, B.

    Attributes:
        A: (2nv, 2nv) of (q, v) at the end by that at the start.
        B: (2nv, nv) by the generalized force.
        boundary: Flags of `Boundary`; what has no derivative is NaN.
    """

    A: Array
    B: Array
    boundary: Boundary

    def __iter__(self) -> Iterator[Array]:
        return iter((self.A, self.B))


def check_supported(scene: Scene) -> None:
    """Check that the derivatives of a scene's motions are known.

    Raises:
        InputError: The derivative of the control, or of a callback of a user event, is not known.
    """
    what: str = ""
    value: Any = None
    acts = scene.control is not None and "control" not in scene.without
    compiled = isinstance(scene.control, JointPD) and scene.period is None
    if acts and not compiled and jacobian_of(scene) is None:
        what, value = (
            "the control, whose derivative is not known; give it an attribute jacobian, a function of t, q "
            "and v that returns the derivative (nv, 2 nv) of the forces by q and v",
            scene.control,
        )
    for event in as_events(scene.events) if "user events" not in scene.without else ():
        if event.callback is not None and event.jacobian is None:
            what, value = (
                f"the callback of {event.label!r}, whose derivative is not known; give jacobian=",
                event,
            )
    if what:
        raise InputError(f"sensitivities: not available with {what}", value=value)


def parse(scene: Scene, names: Any) -> tuple[str, ...]:
    """Return the checked names of sensitivities: "state", "friction:CONTACT", "restitution:CONTACT"."""
    names = as_tuple("sensitivities", names, str, "a name")
    check_supported(scene)
    for name in names:
        kind, _, label = str(name).partition(":")
        if name != "state" and kind not in ("friction", "restitution"):
            raise InputError(
                f'sensitivities: {in_short(name)} given; "state", "friction:CONTACT" or '
                '"restitution:CONTACT" with the name of a contact expected',
                value=name,
            )
        found = next((one for one in scene.contacts if one.label == label), None)
        if name != "state" and found is None:
            raise UnknownNameError(
                f"sensitivities: {name!r} given, but the scene has no contact {label!r}; "
                f"{near_matches(label, [one.label for one in scene.contacts])}",
                value=name,
            )
        if found is not None and found.pair is not None:
            raise InputError(
                f'sensitivities: {name!r} given, but contacts of two shapes support "state" only',
                value=name,
            )
        if found is not None and kind == "restitution" and callable(found.restitution):
            raise InputError(
                f"sensitivities: {name!r} given, but its restitution is a function; a number is expected",
                value=name,
            )
    return names


class MotionSlopes:
    """Propagates changes along a motion of a scene.

    Args:
        scene, dynamics, model: As in `Saltation`; states and modes of the dynamics are overwritten.
        parameters: Names of coefficients, see `parse`.
        tau: (nv,) constant generalized force by which the motion is differentiated too, or None.
        rtol: Relative tolerance of each interval.

    Attributes:
        parameters: Names of the parameters with columns; contacts that cannot reach their surface have none.
    """

    def __init__(
        self,
        scene: Scene,
        dynamics: SceneDynamics,
        model: pin.Model,
        parameters: Sequence[str],
        tau: Array | None,
        rtol: float,
    ) -> None:
        self._rtol = rtol
        labels = [contact.label for contact in dynamics.contacts]
        self.parameters = [name for name in parameters if name.partition(":")[2] in labels]
        split = [name.partition(":") for name in self.parameters]
        found = [Parameter(kind, labels.index(label)) for kind, _, label in split]
        nv = model.nv
        self.saltation = Saltation(scene, dynamics, model, found, np.zeros(nv) if tau is None else tau)
        self._nv = nv
        self._given = 0 if tau is None else nv
        self._count = len(found)
        self._control = None if scene.period is not None else jacobian_of(scene)
        self._of_steps = dynamics, model, found, scene if self._control is not None else None
        self.force = np.zeros((nv, 2 * nv + self._given + self._count))
        self.force[:, 2 * nv : 2 * nv + self._given] = np.eye(nv, self._given)

    @cached_property
    def steps(self) -> StepSlopes:
        """Propagates changes through time steps."""
        return StepSlopes(*self._of_steps)

    def initial(self) -> Array:
        """Return the changes (2nv, n) at the start: by the state, the force if given, and the parameters."""
        return np.eye(2 * self._nv, 2 * self._nv + self._given + self._count)

    def along(self, x: Array, step: DenseStep, until: float) -> Array:
        """Return changes x (2nv, n) at the start of a step as changes at a time [s] within it."""
        for start, end in self._intervals(step, until):
            x = self._across(x, step, start, end)
        return x

    def _across(self, x: Array, step: DenseStep, start: float, end: float) -> Array:
        """Return changes x (2nv, n) at the end of an interval, which is halved until the tolerance is met."""
        if np.isnan(x[0, 0]) and np.isnan(x).all():
            return x
        h = end - start
        shortest = h <= _shortest(step)
        for rule in RULES:
            nodes = self._slopes_within(step, start + h * rule.nodes)
            if nodes.yields:
                self.saltation.boundary |= Boundary.STICK_THRESHOLD
                return np.full_like(x, np.nan)
            if np.isfinite(nodes.by_state).all():
                found, error = collocate(
                    rule, nodes, h, x, self.saltation.slopes.turned, self.force, self._given
                )
                if error <= self._rtol or shortest:
                    return found
        if shortest:  # the speed of slip vanishes in it
            self.saltation.boundary |= Boundary.EVENTS_COINCIDE
            return np.full_like(x, np.nan)
        middle = start + 0.5 * h
        return self._across(self._across(x, step, start, middle), step, middle, end)

    def _slopes_within(self, step: DenseStep, times: Array) -> SlopesWithin:
        """Return the slopes of the motion at some times [s], including those of a control."""
        nodes = self.saltation.slopes.within(step, times)
        if self._control is not None:
            for t, inverse, by_state in zip(times.tolist(), nodes.inverse, nodes.by_state, strict=True):
                by_state[: self._nv] += inverse @ forces_by_state(self._control, t, *step.at(t))
        return nodes

    def _intervals(self, step: DenseStep, until: float) -> list[tuple[float, float]]:
        """Return intervals of a step up to a time [s] in which the speed of slip changes little. (`STEEP`)"""
        if until <= step.start:
            return []
        closed = step.closed
        if closed is None or not closed.slips:
            return [(step.start, until)]
        shortest = _shortest(step)
        found: list[tuple[float, float]] = []
        speeds = self.saltation.slopes.speeds

        def split(start: float, at_start: Array, end: float, at_end: Array) -> None:
            low, high = np.minimum(at_start, at_end), np.maximum(at_start, at_end)
            if (low >= STEEP * high).all():
                found.append((start, end))
            elif end - start > shortest:
                middle = 0.5 * (start + end)
                (between,) = speeds(step, np.array([middle]))
                split(start, at_start, middle, between)
                split(middle, between, end, at_end)

        at_start, at_end = speeds(step, np.array([step.start, until]))
        split(step.start, at_start, until, at_end)
        return found


def _shortest(step: DenseStep) -> float:
    """Return the size of an interval that is not halved further [s]; its midpoint must be representable."""
    return max(LEAST_INTERVAL * (step.end - step.start), 2.0 * math.ulp(step.end))


class Sensitivities:
    """Derivatives along a simulated motion, computed on demand.

    Args:
        slopes: Propagates the changes.
        names: What to differentiate by, see `parse`.
        steps, impacts, events: The motion.
        held: Forces of a sampled control.
    """

    def __init__(
        self,
        slopes: MotionSlopes,
        names: Sequence[str],
        steps: Sequence[DenseStep],
        impacts: Sequence[ImpactRecord],
        events: Sequence[EventRecord],
        held: HeldForces | None = None,
    ) -> None:
        self._slopes, self._names, self._steps = slopes, names, steps
        self._impacts, self._events, self._held = impacts, events, held
        self._starts: list[tuple[Array, Boundary]] = []

    def changes(self, number: int, t: float) -> tuple[Array, Boundary]:
        """Return the changes (2nv, n) at a time [s] in a step, given by number, and flags."""
        x, boundary = self._at_start(number)
        return self._until(x, boundary, number, t)

    def _until(self, x: Array, boundary: Boundary, number: int, t: float) -> tuple[Array, Boundary]:
        """Return changes x at the start of a step, given by number, as changes at a time [s], and flags."""
        slopes, step = self._slopes, self._steps[number]
        slopes.saltation.boundary = boundary
        self._hold(number)
        if step.taken is None:
            return slopes.along(x, step, t), slopes.saltation.boundary
        if t >= step.end:
            self._refuse([one for one in self._events if step.start < one.time <= step.end])
        slopes.steps.boundary = boundary
        return slopes.steps.at(x, step, t, slopes.force), slopes.steps.boundary

    def _hold(self, number: int) -> None:
        """Set the force of a sampled control, and its changes, to those in a step, given by number."""
        if self._held is not None:
            now = self._held.at(self._steps[number].start)
            slopes = self._slopes
            none = 0.0, np.zeros_like(slopes.force)
            slopes.saltation.slopes.tau[:], slopes.force = none if now is None else now

    def _at_start(self, number: int) -> tuple[Array, Boundary]:
        saltation, steps = self._slopes.saltation, self._steps
        while len(self._starts) <= number:
            k = len(self._starts)
            now = steps[k].start
            struck, called = self._struck(k), self._at(k, self._events)
            if any(one.taken is not None for one in steps[max(k - 1, 0) : k + 1]):
                self._starts.append(self._through_time_step(k, struck, called))
                continue
            if k == 0:
                x, saltation.boundary = self._slopes.initial(), Boundary.NONE
                if self._held is not None:  # evaluated before the events at the start
                    v = struck[0].v_before if struck else steps[0].v
                    self._held.ask(now, steps[0].q, v, x)
                    self._hold(0)
                x = saltation.start(x, steps[0], struck, called, self._slopes.force)
                self._flag_touching(struck, saltation.modes(steps[0]))
            else:
                before = steps[k - 1]
                x, saltation.boundary = self._starts[-1]
                self._hold(k - 1)
                x = self._slopes.along(x, before, before.end)
                if self._held is None or not self._held.begins(now):
                    stuck = k if struck or called else self._next_stick(k)
                    x = saltation.cross(x, before, steps[stuck], struck, called)
                    self._starts += [(x, saltation.boundary)] * (stuck - k)
                elif struck or called:  # the order of the force and the event is undetermined
                    saltation.boundary |= Boundary.EVENTS_COINCIDE
                    x = np.full_like(x, np.nan)
                if self._held is not None:
                    self._held.ask(now, steps[k].q, steps[k].v, x)
            self._starts.append((x, saltation.boundary))
        return self._starts[number]

    def _struck(self, k: int) -> list[ImpactRecord]:
        """Return the impacts at the start of step k, without those at its end if it has no length."""
        reached = self._steps[k - 1].taken if k > 0 else None
        whole = reached is not None and not reached.arriving and self._steps[k].taken is not None
        return [] if whole else self._at(k, self._impacts)

    def _at(self, k: int, records: Sequence[Any]) -> list[Any]:
        """Return the records of events or impacts at the start of step k; ends of time steps are rounded."""
        now, before = self._steps[k].start, self._steps[max(k - 1, 0)]
        since = before.start if k > 0 and before.taken is not None else math.nan
        return [one for one in records if since < one.time <= now or one.time == now]

    def _refuse(self, called: Sequence[EventRecord]) -> None:
        """Raise an error for user events in time steps, since they cut these."""
        if called:
            raise InputError(
                f"sensitivities: the event {called[0].name!r} ends a time step at t = "
                f"{called[0].time:.6g} s, where they are not available"
            )

    def _through_time_step(
        self, k: int, struck: Sequence[ImpactRecord], called: Sequence[EventRecord]
    ) -> tuple[Array, Boundary]:
        """Return changes at the start of step k, and flags, if it or the step before is a time step."""
        slopes, (step, before) = self._slopes, (self._steps[k], self._steps[max(k - 1, 0)])
        taken, reached = step.taken, before.taken if k > 0 else None
        x, boundary = self._starts[-1] if k > 0 else (slopes.initial(), Boundary.NONE)
        self._refuse(called)
        if self._held is not None and k == 0:  # evaluated before the events at the start
            self._held.ask(step.start, step.q, struck[0].v_before if struck else step.v, x)
        self._hold(max(k - 1, 0))
        saltation, steps = slopes.saltation, slopes.steps
        saltation.boundary = steps.boundary = boundary
        if reached is not None:
            x = steps.through(x, before, slopes.force)
        elif k > 0:
            x = slopes.along(x, before, before.end)
        boundary = saltation.boundary | steps.boundary
        if struck:
            if reached is None:  # several contacts may touch where time steps begin with an impact
                x, boundary = np.full_like(x, np.nan), boundary | Boundary.EVENTS_COINCIDE
            else:
                saltation.boundary = boundary
                later = saltation.modes(step) if taken is None else steps.modes(taken)
                given = struck, steps.modes(reached), reached.struck, later
                x[: 2 * len(step.v)] = saltation.strike(x[: 2 * len(step.v)], *given)
                boundary = saltation.boundary
        if taken is None:
            saltation.boundary = boundary
            x = saltation.start(x[: 2 * len(step.v)], step, (), (), slopes.force)
            boundary = saltation.boundary
        elif reached is None:
            steps.boundary = boundary
            x = steps.begin(np.concatenate([x, np.zeros((len(step.v) + 1, x.shape[1]))]), step)
            saltation.boundary = steps.boundary
            if k == 0:
                self._flag_touching(struck, steps.modes(taken))
            elif before.end < before.start + WHOLE * before.h:  # cut by an event
                saltation.boundary |= Boundary.EVENTS_COINCIDE
            boundary = saltation.boundary
        if self._held is not None:
            self._held.ask(step.start, step.q, step.v, x[: 2 * len(step.v)])
        return x, boundary

    def _flag_touching(self, struck: Sequence[ImpactRecord], modes: Integers) -> None:
        """Flag what touches at the start of the motion; see `Saltation.flag_touching`."""
        step = self._steps[0]
        v = struck[0].v_before if struck else step.v
        self._slopes.saltation.flag_touching(step.q, v, modes, struck)

    def _next_stick(self, k: int) -> int:
        """Return the step from which on contacts stick whose slip ends, within errors, before step k; else k.

        Where slip ends, errors of steps leave a speed with which the contact keeps sliding for a moment.
        """
        steps, saltation = self._steps, self._slopes.saltation
        closed, begun = steps[k - 1].closed, steps[k].start
        if not isinstance(closed, ClosedSet) or closed is steps[k].closed or not closed.slips:
            return k
        slow = SLOWEST * saltation.slopes.dynamics.error(steps[k].v)

        def slowed(step: DenseStep) -> Integers:
            speeds = saltation.slopes.speeds(step, np.array([step.end]))[0]
            contacts = np.flatnonzero(closed.modes)[: len(speeds)]
            return contacts[(closed.modes[contacts] == SLIP) & (speeds <= slow)]

        ends = slowed(steps[k - 1])
        if len(ends) == 0:
            return k
        times = [*(one.time for one in self._impacts), *(one.time for one in self._events)]
        times += [] if self._held is None else self._held.times
        for m in range(k, len(steps)):
            now = steps[m].closed
            happens = any(begun < time <= steps[m].start for time in times)
            if happens or not isinstance(now, ClosedSet):
                break
            if (now.modes[ends] == STICK).any():
                return m
            if not np.array_equal(now.modes, closed.modes) or not np.isin(ends, slowed(steps[m])).any():
                break
        return k

    def at(self, number: int, t: float) -> Sensitivity:
        """Return the sensitivity at a time in the step of a number."""
        x, boundary = self.changes(number, t)
        n = len(x)
        by_each = {name: np.zeros(n) for name in self._names if name != "state"}
        by_each |= {name: x[:, n + k].copy() for k, name in enumerate(self._slopes.parameters)}
        return Sensitivity(x[:, :n].copy() if "state" in self._names else None, by_each, boundary)
