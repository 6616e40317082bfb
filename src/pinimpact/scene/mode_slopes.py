"""v̇ of a mode of contact and how it changes with the state. (docs/derivatives.md, 9)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..robot.derivatives import check_differentiable, check_joints
from ._kernels.contact_forces import SLIP
from ._kernels.lie_charts import PLANAR, RIGID, ROTATION
from ._kernels.mode_slopes import closed_slopes
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .forces import ClosedSet, EvaluatedForces

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
        by_q, by_v: (nv, nv).
        response: (nv, m) v̇ per unit of λ.
        rows_q, rows_v: (m, nv) of the velocities that vanish.
        inverse: (nv, nv) M⁻¹.
        turning: (k, k) N with d(δq)/dt = δv − N δq, where joints turn. (D22)
        by_friction: (nv, k) for the contacts asked for.
        slips: The contacts that slip.
        unique: Whether the motion determines λ.
    """

    acceleration: Array
    by_q: Array
    by_v: Array
    response: Array
    rows_q: Array
    rows_v: Array
    inverse: Array
    turning: Array
    by_friction: Array
    slips: tuple[Slip, ...]
    unique: bool


class SlopesOfModes:
    """Differentiates the motion of a scene in any mode.

    Args:
        dynamics: Dynamics of the scene, of which states and modes are set here.
        model: Its model.
        friction: Numbers of the contacts by whose friction v̇ is differentiated.
        tau: (nv,) a constant generalized force.

    Attributes:
        turned: (nv,) which velocities are those of joints that turn.
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
        self._data = model.createData()
        self._parent = np.array(model.parents, dtype=np.int64)
        self._scratch = np.empty((model.njoints, 6))
        self.turned = np.zeros(model.nv, dtype=bool)
        for kind, _, j, n in dynamics.work.joint_charts.tolist():
            self.turned[j : j + n] = kind in (PLANAR, RIGID, ROTATION)
        self._friction, self.tau = list(friction), tau.copy()
        names = [contact.label for contact in dynamics.contacts]
        self._forces = EvaluatedForces(lambda: dynamics, names)

    def at(self, step: DenseStep, t: float, moving: bool = True) -> ModeSlopes:
        """Return v̇ and its derivatives at a time within a step.

        Args:
            step: The step, with what is closed in it.
            t: The time [s].
            moving: Whether what slips has a speed, by which the direction of friction changes.
        """
        work = self.dynamics.work
        closed = step.closed
        q, v = step.at(t)
        if closed is None:
            work.sliding_friction[:] = 0.0
            work.control_force[:] = self.tau
            self.dynamics.set_saturation(q, v)
            self.dynamics.free_motion_at(t, q, v, ())
            return self._flight(q, v)
        self._forces.at(0, step, t)
        return self._constrained(closed, q, v, moving)

    def _smooth(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array, Array, Array]:
        """Return v̇, ∂v̇/∂q, ∂v̇/∂v and M⁻¹ under a generalized force, with damping and drives."""
        work, data = self.dynamics.work, self._data
        found = pin.computeABADerivatives(self.model, data, q, v, tau)
        by_q, by_v, inverse = (part.copy() for part in found)
        by_v -= inverse * work.damping
        for j in work.drive_velocity.tolist():
            if work.drive_side[j] == 0:
                by_q[:, j] -= inverse[:, j] * work.drive_stiffness[j]
                by_v[:, j] -= inverse[:, j] * work.drive_damping[j]
        return data.ddq.copy(), by_q, by_v, inverse

    def _flight(self, q: Array, v: Array) -> ModeSlopes:
        nv = len(v)
        none = np.zeros((0, nv))
        acceleration, by_q, by_v, inverse = self._smooth(q, v, self.dynamics.work.tau)
        unmoved = np.zeros((nv, len(self._friction)))
        rows = none.T, none, none, inverse, self._turning(v), unmoved
        return ModeSlopes(acceleration, by_q, by_v, *rows, (), True)

    def _constrained(self, closed: ClosedSet, q: Array, v: Array, moving: bool) -> ModeSlopes:
        work, nv = self.dynamics.work, len(v)
        jacobian, force = work.contact_jacobian, work.contact_force
        tau = work.tau + force.ravel() @ jacobian.reshape(-1, nv)
        tau[work.scalar_velocity] += work.scalar_force
        free = work.acceleration.copy()
        acceleration, by_q, by_v, inverse = self._smooth(q, v, tau)
        count = len(jacobian)
        axes, moved, forces = np.empty((count, 3, 3)), np.empty((count, 3, nv)), np.empty((nv, nv))
        closed_slopes(work, self._parent, self._scratch, axes, moved, forces)
        by_friction = np.zeros((nv, len(self._friction)))
        rows_q, rows_v, pushes, slips = [], [], [], []
        for k, (i, mode) in enumerate(
            zip(work.active_index.tolist(), work.active_mode.tolist(), strict=True)
        ):
            J, G = jacobian[k].copy(), moved[k]
            if mode != SLIP:
                rows_q.append(G)
                rows_v.append(J)
                pushes.append(J)
                continue
            mu, direction = work.active_friction[k], work.slip_direction[k].copy()
            normal, speed = force[k, 2], float(np.hypot(*work.contact_velocity[k, :2]))
            rate = work.contact_acceleration[k] + J @ (acceleration - free)
            slips.append(Slip(i, speed, direction, rate[:2], G[:2], J[:2]))
            rows_q.append(G[2:])
            rows_v.append(J[2:])
            pushes.append(J[2:] - mu * direction @ J[:2])
            across = np.array([-direction[1], direction[0]])
            if moving and mu > 0.0:
                turn = across / speed
                push = -mu * normal * (across @ J[:2])
                forces += np.outer(push, turn @ G[:2])
                by_v += np.outer(inverse @ push, turn @ J[:2])
            for column, contact in enumerate(self._friction):
                if contact == i:
                    by_friction[:, column] = -normal * (inverse @ (direction @ J[:2]))
        if len(work.scalar_velocity):
            units = np.eye(nv)[work.scalar_velocity]
            rows_q.append(np.zeros_like(units))
            rows_v.append(units)
            pushes.append(units)
        none = np.zeros((0, nv))
        response = inverse @ np.vstack([none, *pushes]).T
        return ModeSlopes(
            *(acceleration, by_q + inverse @ forces, by_v, response, np.vstack([none, *rows_q])),
            *(np.vstack([none, *rows_v]), inverse, self._turning(v), by_friction, tuple(slips)),
            closed.unique,
        )

    def _turning(self, v: Array) -> Array:
        """Return N for the joints that turn. (D22)"""
        found = np.zeros((self.turned.sum(),) * 2)
        at = 0
        for kind, _, j, n in self.dynamics.work.joint_charts.tolist():
            own = v[j : j + n]
            if kind == RIGID:
                block = pin.Motion(own).action
            elif kind == ROTATION:
                block = pin.skew(own)
            elif kind == PLANAR:
                block = np.array([[0.0, -own[2], own[1]], [own[2], 0.0, -own[0]], [0.0, 0.0, 0.0]])
            else:
                continue
            found[at : at + n, at : at + n] = block
            at += n
        return found
