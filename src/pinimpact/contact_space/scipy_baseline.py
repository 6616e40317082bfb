"""A straightforward solver with scipy.integrate.solve_ivp and its events; for comparison only.

It shares no code with the other methods, and takes |v_t| below a threshold as zero, as is common practice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from .._numeric.tolerances import LITTLE
from ..errors import LawError
from ..status import Flag, Status
from .inputs import Array, Inputs
from .laws import LAWS

STANDSTILL = 10.0
"""Slip speed, over rtol·|v⁻|, below which it is taken as zero."""

MOST_RATES = 100_000
"""Largest number of evaluations of an integration, which may chatter around v_t = 0."""

FOREVER = 1e6
"""Largest P₃ of an impact, over its scale."""

MOVES = 20
"""Largest number of integrations of an impact."""


class _ChatterError(Exception):
    """The integration does not get past v_t = 0."""


class _UnstoppableError(Exception):
    """No normal impulse ends the approach."""


def _resumed_direction(A: Array, b: Array, mu: float) -> Array:
    """Return the direction σ of resumed slip: (λI + μA)σ = b with |σ| = 1 and λ > 0. (5.2)"""

    def direction(lam: float) -> Array:
        return np.asarray(np.linalg.lstsq(lam * np.eye(2) + mu * A, b, rcond=None)[0], dtype=np.float64)

    lam = brentq(
        lambda x: np.linalg.norm(direction(x)) - 1.0, 0.0, np.linalg.norm(b), xtol=np.finfo(float).tiny
    )
    sigma = direction(lam)
    return sigma / np.linalg.norm(sigma)


class _Motion:
    """The contact during an impact.

    Attributes:
        y: (5,) state: P, normal work, friction work.
        compressing, slipping: Phase and mode.
        flags, calls: Flags so far, and number of evaluations of the rates.
    """

    def __init__(self, inputs: Inputs, rtol: float) -> None:
        w11, w12, w13, w22, w23, w33, *velocity, mu, e, code, _, _ = inputs
        self.W = np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]])
        self.A, self.b, self.c, self.mu, self.e = self.W[:2, :2], self.W[:2, 2], w33, mu, e
        self.law, self.start, self.rtol = LAWS[code], np.array(velocity), rtol
        self.size = float(np.linalg.norm(self.start))
        self._standstill = STANDSTILL * rtol * self.size
        self._stick = np.linalg.lstsq(self.A, self.b, rcond=None)[0]
        self._shift = np.zeros(3)  # correction that sets a small v_t to zero
        self.y, self.compressing, self.slipping, self.flags, self.calls = np.zeros(5), True, True, 0, 0
        # P₃ and normal work, of compression and of restitution
        self.compressed, self._restored, self._goal = np.zeros(2), np.zeros(2), 0.0

    def velocity(self, y: Array) -> Array:
        """Return v (3,)."""
        return np.asarray(self.start + self._shift + self.W @ y[:3])

    def pull(self, v: Array) -> Array:
        """Return dP/dP₃."""
        speed = np.hypot(v[0], v[1])
        if speed > self._standstill:
            return np.array([-self.mu * v[0] / speed, -self.mu * v[1] / speed, 1.0])
        if np.linalg.norm(self._stick) <= self.mu:
            return np.array([-self._stick[0], -self._stick[1], 1.0])
        sigma = _resumed_direction(self.A, self.b, self.mu)
        return np.array([-self.mu * sigma[0], -self.mu * sigma[1], 1.0])

    def begin_move(self) -> None:
        """Set the mode, slip or not."""
        v = self.velocity(self.y)
        self.slipping = bool(self.mu > 0.0 and np.hypot(v[0], v[1]) > self._standstill)
        if not self.slipping and self.mu > 0.0:
            self.flags |= Flag.STICK if np.linalg.norm(self._stick) <= self.mu else Flag.SLIP_RESUMED

    def integrate(self) -> Any:
        """Integrate to the next event of the present phase and mode; return the result of `solve_ivp`."""
        fixed = None if self.slipping else self.pull(self.velocity(self.y))

        def rates(_: float, y: Array) -> Array:
            self.calls += 1
            if self.calls > MOST_RATES:
                raise _ChatterError
            v = self.velocity(y)
            dP = self.pull(v) if fixed is None else fixed
            return np.array([*dP, v[2], v[:2] @ dP[:2]])

        events, end = self._events()
        tolerances = {"rtol": self.rtol, "atol": LITTLE * self.rtol * self.scale * self.size}
        return solve_ivp(rates, (self.y[2], end), self.y, **tolerances, events=events)

    @property
    def scale(self) -> float:
        """The scale of P₃."""
        slip = np.hypot(self.start[0], self.start[1]) / (self.c + self.mu * np.trace(self.A))
        return float(max(-self.start[2] / self.c, slip))

    def _events(self) -> tuple[list[Callable[..., float]], float]:
        """Return v₃ = 0, then the end of slip and the goal of restitution if they apply, and the last P₃."""
        worked = self._restored[1] - self.y[3]

        def turns(_: float, y: Array) -> float:
            return float(self.velocity(y)[2])

        def stops(_: float, y: Array) -> float:
            v = self.velocity(y)
            return float(np.hypot(v[0], v[1]) - self._standstill)

        def law_met(_: float, y: Array) -> float:
            gained = turns(_, y) if self.law == "newton" else float(worked + y[3])
            return gained - self._goal

        end = self.y[2] + FOREVER * self.scale
        events: list[tuple[Callable[..., float], float]] = [(turns, 1.0 if self.compressing else -1.0)]
        if self.slipping:
            events.append((stops, -1.0))
        if not self.compressing and self.law == "poisson":
            end = self.y[2] + self._goal - self._restored[0]
        elif not self.compressing:
            events.append((law_met, 1.0))
        for event, direction in events:
            event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
        return [event for event, _ in events], end

    def take(self, y: Array, hit: Sequence[bool]) -> bool:
        """Set the state y (5,) and process the events that `hit` marks; return whether the impact continues.

        Raises:
            LawError: A law that is not supported here.
            _UnstoppableError: Compression does not end.
        """
        phase = self.compressed if self.compressing else self._restored
        phase += y[2:4] - self.y[2:4]
        self.y = y
        if self.slipping and hit[1]:
            self._shift[:2] -= self.velocity(y)[:2]
        elif hit[0] and self.compressing:
            self.compressing = False
            goals = {
                "poisson": self.e * self.compressed[0],
                "energetic": -self.e * self.e * self.compressed[1],
                "newton": -self.e * self.start[2],
            }
            if self.law not in goals:
                message = f'law: "solve_ivp" does not support {self.law!r}'
                raise LawError(message, field="law", value=self.law)
            self._goal = float(goals[self.law])
            return self.e > 0.0
        elif hit[0]:
            self.compressing = True
            self.flags |= Flag.SECOND_COMPRESSION
        elif self.compressing:
            raise _UnstoppableError
        else:
            return False
        return True


def solve_with_scipy(inputs: Inputs, trace: Array, path: Array, rtol: float) -> tuple[Any, ...]:
    """Solve an impact with SciPy; arguments and result as for a `methods.Run`."""
    if not np.isfinite(inputs[:13]).all() or not (inputs[9] >= 0.0 and 0.0 <= inputs[10] <= 1.0):
        return _failed(Status.INVALID_NUMBERS)
    motion = _Motion(inputs, rtol)
    start, W = motion.start, motion.W
    least = np.linalg.eigvalsh(W)[0]
    if least < -32.0 * np.finfo(float).eps * np.linalg.norm(W, 2):
        return _failed(Status.INDEFINITE_DELASSUS, least)
    if start[2] > 0.0 or (start[2] == 0.0 and W[2] @ motion.pull(start) >= 0.0):
        return (Status.NO_IMPACT, 0, 0, *start, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0)
    if motion.c <= 0.0:
        return _failed(Status.UNSTOPPABLE, start[2])
    rows, points = 0, 0
    for _ in range(MOVES):
        motion.begin_move()
        before, restores = motion.y, not motion.compressing
        try:
            done = motion.integrate()
            if rows < len(trace):
                after, sticks = done.y[:, -1], not motion.slipping and bool(motion.flags & Flag.STICK)
                trace[rows] = (sticks, restores, before[2], after[2], *(after[3:] - before[3:]))
                rows += 1
            for y in done.y.T[: len(path) - points]:
                path[points] = (y[2], *motion.velocity(y), *y[:2])
                points += 1
            if not motion.take(done.y[:, -1], [len(times) > 0 for times in done.t_events]):
                break
        except _ChatterError:
            return _failed(Status.NOT_CONVERGED)
        except _UnstoppableError:
            return _failed(Status.UNSTOPPABLE, motion.velocity(before)[2])
    else:
        return _failed(Status.NOT_CONVERGED)
    v = motion.velocity(motion.y)
    status = Status.SEPARATED if v[2] > motion.rtol * motion.size else Status.ENDED_AT_REST
    numbers = *v, *motion.y[:3], motion.compressed[0], 0.0
    return (status, int(motion.flags), motion.calls, *numbers, rows, points)


def _failed(status: Status, figure: float = 0.0) -> tuple[Any, ...]:
    return (status, 0, 0, *[np.nan] * 7, figure, 0, 0)
