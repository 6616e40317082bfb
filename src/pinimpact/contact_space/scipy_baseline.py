"""What one would write by hand with scipy.integrate.solve_ivp and its events; for comparison only.

It shares no code with the other methods. Its threshold on |v_t| is the customary makeshift.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ..errors import LawError
from ..status import Flag, Status
from .inputs import Array, Inputs
from .laws import LAWS

STANDSTILL = 10.0
"""Speed of slip, over rtol·|v⁻|, that is taken as zero."""

MOST_RATES = 100_000
"""Evaluations after which an integration is given up: it chatters around v_t = 0."""

FOREVER = 1e6
"""Impulse, over |v₃ᵒ|/c, at which an impact is given up."""

MOVES = 20


class _ChatterError(Exception):
    """The integration does not get past v_t = 0."""


def _resumed_direction(A: Array, b: Array, mu: float) -> Array:
    """Find the σ in which slip resumes: (λI + μA)σ = b with |σ| = 1 and λ > 0."""

    def direction(lam: float) -> Array:
        return np.asarray(np.linalg.lstsq(lam * np.eye(2) + mu * A, b, rcond=None)[0], dtype=np.float64)

    lam = brentq(lambda x: np.linalg.norm(direction(x)) - 1.0, 0.0, np.linalg.norm(b), xtol=1e-15)
    sigma = direction(lam)
    return sigma / np.linalg.norm(sigma)


def solve_with_scipy(inputs: Inputs, trace: Array, path: Array, rtol: float) -> tuple[Any, ...]:
    """Solve one impact with scipy; arguments `trace` and `path` and the result as the kernels have them."""
    w11, w12, w13, w22, w23, w33, *velocity, mu, e, code, _, _ = inputs
    if not np.isfinite(inputs[:13]).all() or not (mu >= 0.0 and 0.0 <= e <= 1.0):
        return _failed(Status.INVALID_NUMBERS)
    W = np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]])
    least = np.linalg.eigvalsh(W)[0]
    if least < -32.0 * np.finfo(float).eps * np.linalg.norm(W, 2):
        return _failed(Status.INDEFINITE_DELASSUS, least)
    A, b, c, law = W[:2, :2], W[:2, 2], w33, LAWS[code]
    start = np.array(velocity)
    size = np.linalg.norm(start)
    standstill = STANDSTILL * rtol * size
    stick = np.linalg.lstsq(A, b, rcond=None)[0]

    def pull(v: Array) -> Array:
        """Return dP/dP₃."""
        speed = np.hypot(v[0], v[1])
        if speed > standstill:
            return np.array([-mu * v[0] / speed, -mu * v[1] / speed, 1.0])
        if np.linalg.norm(stick) <= mu:
            return np.array([-stick[0], -stick[1], 1.0])
        sigma = _resumed_direction(A, b, mu)
        return np.array([-mu * sigma[0], -mu * sigma[1], 1.0])

    if start[2] > 0.0 or (start[2] == 0.0 and W[2] @ pull(start) >= 0.0):
        return (Status.NO_IMPACT, 0, 0, *start, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0)
    if c <= 0.0:
        return _failed(Status.UNSTOPPABLE, start[2])

    # y = (P, normal work, friction work); v follows from P, but for the v_t that is set to zero
    shift = np.zeros(3)
    y = np.zeros(5)
    compressing, flags, calls, rows, points = True, 0, 0, 0, 0
    compressed = restored = compression_work = restitution_work = goal = 0.0
    scale = max(-start[2] / c, np.hypot(start[0], start[1]) / (c + mu * np.trace(A)))
    for _ in range(MOVES):
        v = start + shift + W @ y[:3]
        slipping = mu > 0.0 and np.hypot(v[0], v[1]) > standstill
        if not slipping and mu > 0.0:
            flags |= Flag.STICK if np.linalg.norm(stick) <= mu else Flag.SLIP_RESUMED
        fixed = None if slipping else pull(v)

        def rates(_: float, y: Array, fixed: Array | None = fixed) -> Array:
            nonlocal calls
            calls += 1
            if calls > MOST_RATES:
                raise _ChatterError
            v = start + shift + W @ y[:3]
            dP = pull(v) if fixed is None else fixed
            return np.array([*dP, v[2], v[:2] @ dP[:2]])

        def turns(_: float, y: Array) -> float:
            return float(start[2] + shift[2] + W[2] @ y[:3])

        def stops(_: float, y: Array) -> float:
            v = start + shift + W @ y[:3]
            return float(np.hypot(v[0], v[1]) - standstill)

        def law_met(_: float, y: Array, goal: float = goal, worked: float = restitution_work - y[3]) -> float:
            return turns(_, y) - goal if law == "newton" else worked + y[3] - goal

        events: list[Callable[..., float]] = [turns]
        turns.direction = 1.0 if compressing else -1.0  # type: ignore[attr-defined]
        end = y[2] + FOREVER * scale
        if slipping:
            stops.direction = -1.0  # type: ignore[attr-defined]
            events.append(stops)
        if not compressing and law == "poisson":
            end = y[2] + goal - restored
        elif not compressing:
            law_met.direction = 1.0  # type: ignore[attr-defined]
            events.append(law_met)
        for event in events:
            event.terminal = True  # type: ignore[attr-defined]
        try:
            done = solve_ivp(rates, (y[2], end), y, rtol=rtol, atol=1e-3 * rtol * scale * size, events=events)
        except _ChatterError:
            return _failed(Status.NOT_CONVERGED)
        before, y = y, done.y[:, -1]
        hit = [len(times) > 0 for times in done.t_events]
        rows = _record_move(
            trace, rows, not slipping and bool(flags & Flag.STICK), not compressing, before, y
        )
        for state in done.y.T if len(path) else ():
            if points < len(path):
                path[points] = (state[2], *(start + shift + W @ state[:3]), *state[:2])
                points += 1
        work = y[3] - before[3]
        if compressing:
            compression_work += work
            compressed += y[2] - before[2]
        else:
            restitution_work += work
            restored += y[2] - before[2]
        if slipping and hit[1]:
            v = start + shift + W @ y[:3]
            shift[:2] -= v[:2]
        elif hit[0] and compressing:
            compressing = False
            goals = {
                "poisson": e * compressed,
                "energetic": -e * e * compression_work,
                "newton": -e * start[2],
            }
            if law not in goals:
                raise LawError(f'law: "solve_ivp" does not support {law!r}', field="law", value=law)
            goal = goals[law]
            if e == 0.0:
                break
        elif hit[0]:
            compressing = True
            flags |= Flag.SECOND_COMPRESSION
        elif compressing:
            return _failed(Status.UNSTOPPABLE, v[2])
        else:
            break
    else:
        return _failed(Status.NOT_CONVERGED)
    v = start + shift + W @ y[:3]
    status = Status.SEPARATED if v[2] > 1e-12 * size else Status.ENDED_AT_REST
    return (status, int(flags), calls, *v, *y[:3], compressed, 0.0, rows, points)


def _record_move(trace: Array, rows: int, sticks: bool, restores: bool, before: Array, after: Array) -> int:
    if rows < len(trace):
        trace[rows] = (sticks, restores, before[2], after[2], after[3] - before[3], after[4] - before[4])
        return rows + 1
    return rows


def _failed(status: Status, figure: float = 0.0) -> tuple[Any, ...]:
    return (status, 0, 0, *[np.nan] * 7, figure, 0, 0)
