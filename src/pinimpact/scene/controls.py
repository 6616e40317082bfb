"""Controls: functions and drives that return generalized forces, and checks of these forces."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array, Bools, Integers
from ..checks import finite_array, float_array, in_short, real_numbers
from ..display import short_repr
from ..errors import InputError, SimulationError
from ..robot.names import joint_of_velocity
from ._kernels.tolerances import ROUNDING
from ._kernels.workspace import SceneWorkspace

Control = Callable[[float, Array, Array], ArrayLike]
"""control(t, q, v) -> (nv,) generalized forces [N, N m]."""


def asked(control: Control, t: float, q: Array, v: Array) -> Array:
    """Return the forces (nv,) of a control at a time and state. The control may change q and v: pass copies.

    Raises:
        SimulationError: The control fails, or returns an array of another shape or of values not finite.
    """
    nv = len(v)
    try:
        returned = control(t, q, v)
    except Exception as error:
        raise SimulationError(f"control: {type(error).__name__} at t = {t:.6g} s: {error}") from error
    try:
        tau = real_numbers("control", returned, f"an array of {nv} real numbers")
    except InputError as error:
        raise SimulationError(
            f"control: {in_short(returned)} returned at t = {t:.6g} s; an array of {nv} real numbers is "
            "expected",
            value=returned,
        ) from error
    if tau.shape != (nv,):
        raise SimulationError(
            f"control: an array of shape {tau.shape} returned at t = {t:.6g} s; ({nv},) expected", value=tau
        )
    if not np.isfinite(tau).all():
        raise SimulationError(
            f"control: {tau.tolist()} returned at t = {t:.6g} s; numbers in it are not finite", value=tau
        )
    return tau


@dataclass(frozen=True, eq=False, repr=False)
class JointPD:
    """Joint PD control: τ = kp (q_ref − q) − kd v, limited to ±limits.

    It is part of the compiled dynamics. Reaching or leaving a limit is an event, at its exact time. It acts
    on joints with one coordinate; revolute joints without bounds (continuous in a URDF) have two, (cos, sin),
    and need a function. A free base has no actuator.

    Attributes:
        kp: Stiffness ≥ 0 [N m/rad or N/m]: a number for all joints, or (nv,), with zeros for no control.
        kd: Damping ≥ 0 [N m s/rad or N s/m], likewise.
        q_ref: (nq,) reference configuration.
        limits: Effort limit > 0 of each joint [N m or N]: a number, or (nv,), infinite for no limit; None for
            no limits.
    """

    kp: ArrayLike
    kd: ArrayLike
    q_ref: ArrayLike
    limits: ArrayLike | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("kp", "kd", "q_ref", "limits"):  # the caller may change its arrays later
            object.__setattr__(self, name, copy(getattr(self, name)))

    def drives(self, model: pin.Model) -> Drives:
        """Return the drives of a robot.

        Raises:
            InputError: Numbers of the wrong shape or range; gains for a joint with several coordinates.
        """
        nv = model.nv
        single, coordinate = np.zeros(nv, dtype=np.bool_), np.zeros(nv, dtype=np.int64)
        floating = np.zeros(nv, dtype=np.bool_)
        for nq, n, i, j in zip(model.nqs, model.nvs, model.idx_qs, model.idx_vs, strict=True):
            single[j : j + n] = nq == n == 1
            floating[j : j + n] = n == 6
            coordinate[j : j + n] = i
        kp = _gains("kp", self.kp, floating)
        kd = _gains("kd", self.kd, floating)
        limits = _gains("limits", np.inf if self.limits is None else self.limits, floating)
        velocity = np.flatnonzero((kp > 0.0) | (kd > 0.0))
        for j in velocity[~single[velocity]].tolist():
            joint = joint_of_velocity(model, j)
            raise InputError(
                f"control: the joint {joint!r} does not have exactly one coordinate, so a JointPD "
                "cannot drive it; give kp and kd as (nv,) with zeros there, or a function",
                value=joint,
            )
        for j in velocity[~(limits[velocity] > 0.0)].tolist():
            raise InputError(
                f"limits: {limits[j]} given for the joint {joint_of_velocity(model, j)!r}, an effort > 0 "
                "expected",
                value=limits[j],
            )
        q_ref = finite_array("q_ref", self.q_ref, (model.nq,))
        return Drives(velocity, coordinate, kp, kd, q_ref[coordinate], limits)


@dataclass(frozen=True, eq=False)
class Drives:
    """The drives of a `JointPD` for one robot; they can be sampled as a control.

    Attributes:
        velocity: (n,) indices of the driven velocities.
        coordinate: (nv,) index in q of the coordinate of each velocity.
        stiffness, damping, reference, limit: (nv,) as in `JointPD`.
    """

    velocity: Integers
    coordinate: Integers
    stiffness: Array
    damping: Array
    reference: Array
    limit: Array

    def __call__(self, t: float, q: Array, v: Array) -> Array:
        """Return the forces (nv,) at a state."""
        law, forces = self._law(q, v), np.zeros(len(v))
        driven = self.velocity
        forces[driven] = np.clip(law[driven], -self.limit[driven], self.limit[driven])
        return forces

    def _law(self, q: Array, v: Array) -> Array:
        """Return the forces (nv,) without limits."""
        return self.stiffness * (self.reference - q[self.coordinate]) - self.damping * v

    def jacobian(self, t: float, q: Array, v: Array) -> Array:
        """Return the derivative (nv, 2 nv) of the forces by q and v, zero for drives at their limits."""
        law, follows = self._law(q, v), np.zeros(len(v))
        follows[self.velocity] = np.abs(law[self.velocity]) < self.limit[self.velocity]
        return np.hstack([np.diag(-follows * self.stiffness), np.diag(-follows * self.damping)])


@lru_cache(maxsize=64)
def no_drives(nv: int) -> Drives:
    """Return the drives of a robot that has none."""
    none, zero = np.zeros(nv, dtype=np.int64), np.zeros(nv)
    return Drives(none[:0], none, zero, zero, zero, zero)


def _gains(name: str, value: ArrayLike, floating: Bools) -> Array:
    """Return numbers ≥ 0 (nv,); a single one is that of all velocities but those of a free base."""
    single = np.ndim(value) == 0
    numbers = float_array(name, value, (1,) if single else floating.shape)
    if single:
        numbers = np.where(floating, 0.0, numbers)
    wrong = ~(numbers >= 0.0) | ((name != "limits") & np.isinf(numbers))
    if wrong.any():
        found = float(numbers[wrong][0])
        raise InputError(f"{name}: {found} given, numbers ≥ 0 expected", value=value)
    return numbers


class ContinuousControl:
    """Call a control whenever kernels evaluate v̇.

    Attributes:
        work: The workspace, which holds the time and the state and receives the forces.
    """

    work: SceneWorkspace

    def __init__(self, control: Control) -> None:
        self._control = control

    def __call__(self) -> None:
        """Evaluate the control, and write its forces to the workspace."""
        work = self.work
        work.control_force[:] = asked(self._control, work.control_time, work.q.copy(), work.v.copy())


class SampledControl:
    """A control that is evaluated at the times t_k = k T.

    Its force acts from t_k + delay until the next one acts; before the first one acts the force is zero.

    Args:
        control: The control, evaluated once for each time, in order.
        period: Sampling period T [s].
        delay: Delay of the forces [s].

    Attributes:
        forces: Forces (nv,) that have acted.
        acts_at: Time from which each of them acts [s].
        asked_at: Times at which the control has been evaluated [s].
    """

    def __init__(self, control: Control, period: float, delay: float) -> None:
        self._control = control
        self._period = period
        periods = delay / period
        whole = round(periods)  # equal times are then equal to the last bit
        self._delay = whole if abs(periods - whole) <= ROUNDING else periods
        self._asked = self._acting = 0
        self._waiting: deque[Array] = deque()
        self.forces: list[Array] = []
        self.acts_at: list[float] = []
        self.asked_at: list[float] = []

    @property
    def next(self) -> float:
        """The next time at which the control is to be evaluated or a force begins to act [s]."""
        time = self._asked * self._period
        return min(time, self._acts_at) if self._waiting else time

    @property
    def _acts_at(self) -> float:
        """The time from which the first of the delayed forces acts [s]."""
        return (self._acting + self._delay) * self._period

    def at(self, t: float, q: Array, v: Array) -> Array | None:
        """Evaluate the control if it is due at t [s]; return the force (nv,) that begins to act, or None.

        Raises:
            SimulationError: See `asked`.
        """
        if t >= self._asked * self._period:
            self._waiting.append(asked(self._control, t, q.copy(), v.copy()).copy())
            self._asked += 1
            self.asked_at.append(t)
        if self._waiting and t >= self._acts_at:
            self._acting += 1
            self.acts_at.append(t)
            self.forces.append(self._waiting.popleft())
            return self.forces[-1]
        return None
