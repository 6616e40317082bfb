"""Controls: what is called for the generalized forces, and the checks of what it returns."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SimulationError
from ._kernels.workspace import SceneWorkspace

Array = NDArray[np.float64]
Control = Callable[[float, Array, Array], ArrayLike]
"""control(t, q, v) -> (nv,) generalized forces [N, N m]."""

GRID = 1e-9
"""A delay closer than this part of a period to a number of periods is that number of them."""


def asked(control: Control, t: float, q: Array, v: Array) -> Array:
    """Return the forces (nv,) of a control at a time and state, which it may change: they are its own.

    Raises:
        SimulationError: The control fails, or returns another shape or numbers that are not finite.
    """
    nv = len(v)
    try:
        tau = np.asarray(control(t, q, v), dtype=float)
    except Exception as error:
        raise SimulationError(
            f"control: {type(error).__name__} at t = {t:.6g} s: {error}", field="control"
        ) from error
    if tau.shape != (nv,):
        raise SimulationError(
            f"control: an array of shape {tau.shape} came back at t = {t:.6g} s; ({nv},) expected",
            field="control",
            value=tau,
        )
    if not math.isfinite(tau.dot(tau)):
        raise SimulationError(
            f"control: {tau.tolist()} came back at t = {t:.6g} s; numbers in it are not finite",
            field="control",
            value=tau,
        )
    return tau


class ContinuousControl:
    """Calls a control wherever kernels evaluate v̇.

    Attributes:
        work: The workspace, where the time and the state stand and the forces go.
    """

    work: SceneWorkspace

    def __init__(self, control: Control) -> None:
        self._control = control

    def __call__(self) -> None:
        """Take the control's forces."""
        work = self.work
        work.control_force[:] = asked(self._control, work.control_time, work.q.copy(), work.v.copy())


class SampledControl:
    """A control that is asked at the times t_k = k T.

    Its force acts from t_k + delay until the next one does; before the first one acts the force is zero.

    Args:
        control: Asked once for each time, in order.
        period: T [s].
        delay: [s].
    """

    def __init__(self, control: Control, period: float, delay: float) -> None:
        self._control = control
        self._period = period
        periods = delay / period
        whole = round(periods)  # so that times that are the same are so to the last bit
        self._delay = whole if abs(periods - whole) <= GRID else periods
        self._asked = self._acting = 0
        self._waiting: deque[Array] = deque()

    @property
    def next(self) -> float:
        """The time at which it is to be asked, or a force begins to act [s]."""
        time = self._asked * self._period
        return min(time, self._acts_at) if self._waiting else time

    @property
    def _acts_at(self) -> float:
        """The time from which the first force that waits acts [s]."""
        return (self._acting + self._delay) * self._period

    def at(self, t: float, q: Array, v: Array) -> Array | None:
        """Ask at a time if it is one to ask at; return the force (nv,) that acts from then on, if it changes.

        Raises:
            SimulationError: As of `asked`.
        """
        if t >= self._asked * self._period:
            self._waiting.append(asked(self._control, t, q.copy(), v.copy()).copy())
            self._asked += 1
        if self._waiting and t >= self._acts_at:
            self._acting += 1
            return self._waiting.popleft()
        return None
