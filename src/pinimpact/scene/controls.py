"""Controls: what is called for the generalized forces, and the checks of what it returns."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SimulationError
from ._kernels.workspace import SceneWorkspace

Array = NDArray[np.float64]
Control = Callable[[float, Array, Array], ArrayLike]
"""control(t, q, v) -> (nv,) generalized forces [N, N m]."""


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
