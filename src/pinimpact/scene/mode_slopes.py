"""Derivatives of v̇ in given contact modes by the state. (docs/derivatives.md, 9)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..robot.derivatives import check_joints
from ..robot.pinocchio_bridge import Call, call_addresses
from ._kernels.contact_forces import SLIP
from ._kernels.lie_charts import PLANAR, RIGID, ROTATION
from ._kernels.mode_slopes import constraints_at, gap_rows, slopes_along, speeds_along
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .forces import set_closed


class Slip(NamedTuple):
    """The tangential motion of a slipping contact.

    Attributes:
        contact: Number of the contact.
        direction: (2,) direction of slip σ.
        rate: (2,) v̇_t [m/s²].
        rows: (2, 2nv) ∂v_t/∂(q, q̇).
    """

    contact: int
    direction: Array
    rate: Array
    rows: Array


class ModeSlopes(NamedTuple):
    """v̇ at a state, and the constraints of its contact modes. (D23)

    Attributes:
        acceleration: (nv,) v̇.
        response: (nv, m) v̇ per unit of the constraint forces λ.
        rows: (m, 2nv) derivatives of the velocities that vanish: `rows` δ(q, v) = 0.
        inverse: (nv, nv) M⁻¹.
        slips: The slipping contacts.
        at_bound: Whether friction of a sticking contact or joint is at its bound.
    """

    acceleration: Array
    response: Array
    rows: Array
    inverse: Array
    slips: tuple[Slip, ...]
    at_bound: bool


class SlopesWithin(NamedTuple):
    """Derivatives of v̇ at some times within a step, as returned by the kernel `slopes_along`.

    Attributes:
        yields: Whether the motion depends on the force of a sticking contact at its friction cone.
        unique: Whether the motion determines the constraint forces λ.
    """

    by_state: Array
    response: Array
    inverse: Array
    by_friction: Array
    turning: Array
    yields: bool
    unique: bool


class SlopesOfModes:
    """Differentiates the smooth motion of a scene in any contact modes.

    Args:
        dynamics: The dynamics, whose states and modes are overwritten.
        model: Its model.
        friction: Contacts by whose coefficients of friction v̇ is differentiated; −1 for a zero column.
        tau: (nv,) constant generalized force.

    Attributes:
        turned: Indices of the velocities of joints that rotate.
        tau: (nv,) the generalized force, which may be changed in place.

    Raises:
        InputError: A contact whose kinematics are not differentiated.
        ModelError: Joints whose axes turn within the joint.
    """

    def __init__(
        self, dynamics: SceneDynamics, model: pin.Model, friction: Sequence[int], tau: Array
    ) -> None:
        check_joints(model)
        self.dynamics, self.model = dynamics, model
        nv = model.nv
        self._parent = np.array(model.parents, dtype=np.int64)
        charts = dynamics.work.joint_charts
        turns = [
            np.arange(j, j + n) for kind, _, j, n in charts.tolist() if kind in (PLANAR, RIGID, ROTATION)
        ]
        self.turned = np.concatenate([np.zeros(0, dtype=np.int64), *turns])
        self._friction, self.tau = np.array(friction, dtype=np.int64), tau.copy()
        self._acceleration, self._smooth = np.zeros(nv), np.zeros((2, nv, nv))
        given = model, model.createData(), dynamics.work.q, dynamics.work.v, self._acceleration
        self._derive = Call(_differentiate, (self._smooth, given))  # called by address from the kernel
        self._address = call_addresses([self._derive])

    def within(self, step: DenseStep, times: Array) -> SlopesWithin:
        """Return the derivatives of v̇ at times (s,) [s] within a step."""
        ends, unique = self._set(step)
        found = slopes_along(
            *(
                self.dynamics.work,
                self._address,
                self._acceleration,
                self._smooth,
                self._parent,
                self._friction,
            ),
            *(step.coefficients, step.q, step.v, step.start, step.h, times),
            *(ends, unique, step.closed is None),
        )
        self.dynamics.check()
        return SlopesWithin(*(*found, unique))

    def _set(self, step: DenseStep) -> tuple[Array, bool]:
        """Set the modes of a step.

        Returns:
            Directions of slip (2, k, 2) at its ends; whether the motion determines the forces.
        """
        closed, work = step.closed, self.dynamics.work
        if closed is None:
            work.modes[:], work.sliding_friction[:], work.control_force[:] = 0, 0.0, self.tau
            return np.zeros((2, 0, 2)), True
        set_closed(self.dynamics, closed)
        ends = np.zeros((2, len(closed.joints), 2)) if step.directions is None else step.directions
        return ends, closed.unique

    def speeds(self, step: DenseStep, times: Array) -> Array:
        """Return the speeds of slip (s, k) of the active contacts at times (s,) in a step; 0 if sticking."""
        ends, unique = self._set(step)
        moving = step.coefficients, step.q, step.v, step.start, step.h
        found = speeds_along(self.dynamics.work, *moving, times, ends, unique)
        self.dynamics.check()
        return np.asarray(found)

    def at(self, step: DenseStep, t: float) -> ModeSlopes:
        """Return v̇ and the constraints at an end of a step."""
        (ends, unique), work = self._set(step), self.dynamics.work
        moving = step.coefficients, step.q, step.v, step.start, step.h
        acceleration, response, rows, inverse, moved, at_bound = constraints_at(
            work, self._parent, *moving, t, ends, unique, step.closed is None
        )
        self.dynamics.check()
        slips = []
        if step.closed is not None and step.closed.slips:
            change = work.solution @ work.force_response
            for k in np.flatnonzero(work.active_mode == SLIP).tolist():
                J, G = work.contact_jacobian[k].copy(), moved[k]
                rate, direction = work.contact_acceleration[k] + J @ change, work.slip_direction[k].copy()
                slips.append(Slip(int(work.active_index[k]), direction, rate[:2], np.hstack([G[:2], J[:2]])))
        return ModeSlopes(acceleration, response, rows, inverse, tuple(slips), at_bound)

    def gaps(self, mode: ModeSlopes) -> tuple[Integers, Bools, Bools]:
        """Return the present constraints that are rates of gaps (k,), and which bear a load; see the kernel.

        The third array (m,) has the constraints without those of contacts and limits that bear none.
        """
        found = gap_rows(self.dynamics.work, mode.acceleration)
        return found[0], found[1], found[2]

    def by_friction(self, step: DenseStep) -> Array:
        """Return the derivatives (nv, n) of v̇ by the coefficients of friction at the start of a step."""
        return self.within(step, np.array([step.start])).by_friction[0]


def _differentiate(smooth: Array, given: tuple[Any, ...]) -> None:
    """Overwrite `smooth` (2, nv, nv) with ∂(M v̇ + h)/∂q and ∂(M v̇ + h)/∂v of a model, data, state and v̇."""
    smooth[0], smooth[1], _ = pin.computeRNEADerivatives(*given)
