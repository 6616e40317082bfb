"""v̇ of a mode of contact and how it changes with the state. (docs/derivatives.md, 9)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..robot.derivatives import check_differentiable, check_joints
from ..robot.pinocchio_bridge import Call, call_addresses
from ._kernels.contact_forces import SLIP
from ._kernels.lie_charts import PLANAR, RIGID, ROTATION
from ._kernels.mode_slopes import slopes_along
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .forces import EvaluatedForces, set_closed

Array = NDArray[np.float64]


class Slip(NamedTuple):
    """The tangential motion of a contact that slips.

    Attributes:
        contact: Number of the contact.
        speed: |v_t| [m/s].
        direction: (2,) σ.
        rate: (2,) v̇_t [m/s²].
        by_q, by_v: (2, nv) ∂v_t/∂q and ∂v_t/∂q̇.
    """

    contact: int
    speed: float
    direction: Array
    rate: Array
    by_q: Array
    by_v: Array


class ModeSlopes(NamedTuple):
    """v̇ at a state in a mode, with δv̇ = `by_q` δq + `by_v` δv + `response` δλ + `by_friction` δμ.

    λ are the forces of what is closed, such that `rows_q` δq + `rows_v` δv = 0. (D23)

    Attributes:
        acceleration: (nv,) v̇.
        response: (nv, m) v̇ per unit of λ.
        rows_q, rows_v: (m, nv) of the velocities that vanish.
        inverse: (nv, nv) M⁻¹.
        slips: The contacts that slip.
        unique: Whether the motion determines λ.
    """

    acceleration: Array
    response: Array
    rows_q: Array
    rows_v: Array
    inverse: Array
    slips: tuple[Slip, ...]
    unique: bool


class SlopesWithin(NamedTuple):
    """The slopes of a mode at some times within a step, see `slopes_along`; `unique` as in `ModeSlopes`."""

    by_q: Array
    by_v: Array
    response: Array
    inverse: Array
    turning: Array
    by_friction: Array
    moved: Array
    unique: bool


class SlopesOfModes:
    """Differentiates the motion of a scene in any mode.

    Args:
        dynamics: Dynamics of the scene, of which states and modes are set here.
        model: Its model.
        friction: Numbers of the contacts by whose friction v̇ is differentiated.
        tau: (nv,) a constant generalized force.

    Attributes:
        turned: Which velocities are those of joints that turn.
        tau: (nv,) the constant force, which may be set.

    Raises:
        InputError: A contact whose kinematics are not differentiated.
        ModelError: Joints whose axes turn within the joint.
    """

    def __init__(
        self, dynamics: SceneDynamics, model: pin.Model, friction: Sequence[int], tau: Array
    ) -> None:
        for contact in dynamics.contacts:
            check_differentiable(contact)
        check_joints(model)
        self.dynamics, self.model = dynamics, model
        self._data, nv = model.createData(), model.nv
        self._parent = np.array(model.parents, dtype=np.int64)
        charts = dynamics.work.joint_charts
        turns = [
            np.arange(j, j + n) for kind, _, j, n in charts.tolist() if kind in (PLANAR, RIGID, ROTATION)
        ]
        self.turned = np.concatenate([np.zeros(0, dtype=np.int64), *turns])
        self._friction, self.tau = np.array(friction, dtype=np.int64), tau.copy()
        names = [contact.label for contact in dynamics.contacts]
        self._forces = EvaluatedForces(lambda: dynamics, names)
        self._total, self._smooth = np.zeros(nv), np.zeros((3, nv, nv))
        self._derive = Call(self._differentiate, ())  # by address from the kernel
        self._address = call_addresses([self._derive])

    def _differentiate(self) -> None:
        work = self.dynamics.work
        self._smooth[:] = pin.computeABADerivatives(self.model, self._data, work.q, work.v, self._total)

    def within(self, step: DenseStep, times: Array, moving: bool = True) -> SlopesWithin:
        """Return how v̇ changes with the state at some times within a step.

        Args:
            step: The step, with what is closed in it.
            times: (s,) [s].
            moving: Whether what slips has a speed, by which the direction of friction changes.
        """
        closed, work = step.closed, self.dynamics.work
        ends, known = np.zeros((2, 0, 2)), np.zeros(0)
        if closed is None:
            work.modes[:], work.sliding_friction[:], work.control_force[:] = 0, 0.0, self.tau
        else:
            count = len(set_closed(self.dynamics, closed))
            ends = np.zeros((2, count, 2)) if step.directions is None else step.directions
            known = closed.known
        unique = closed is None or closed.unique
        found = slopes_along(
            *(work, self._address, self._total, self._smooth, self._parent, self._friction),
            *(step.coefficients, step.q, step.v, step.start, step.h, times),
            *(ends, unique, known, closed is None, moving),
        )
        self.dynamics.check()
        return SlopesWithin(*(*found, unique))

    def speeds(self, step: DenseStep, t: float) -> Array:
        """Return the speeds of what slips at a time within a step."""
        self._forces.at(0, step, t)
        work = self.dynamics.work
        return np.asarray(np.hypot(*work.contact_velocity[work.active_mode == SLIP, :2].T))

    def at(self, step: DenseStep, t: float) -> ModeSlopes:
        """Return v̇ and the velocities that vanish at an end of a step."""
        found = self.within(step, np.array([t]), moving=False)
        work, nv = self.dynamics.work, self.model.nv
        acceleration, slips = self._data.ddq.copy(), []
        change = acceleration - work.acceleration
        for k in np.flatnonzero(work.active_mode == SLIP).tolist():
            J, G = work.contact_jacobian[k].copy(), found.moved[k]
            speed, rate = (
                float(np.hypot(*work.contact_velocity[k, :2])),
                work.contact_acceleration[k] + J @ change,
            )
            direction = work.slip_direction[k].copy()
            slips.append(Slip(int(work.active_index[k]), speed, direction, rate[:2], G[:2], J[:2]))
        rows = found.response[0], found.by_q[0, nv:], found.by_v[0, nv:], found.inverse[0]
        return ModeSlopes(acceleration, *rows, tuple(slips), found.unique)
