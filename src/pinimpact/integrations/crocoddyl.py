"""Impacts as actions of Crocoddyl's optimal control. (docs/derivatives.md, 8)"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from ..checks import as_tuple
from ..errors import InputError, LawError, UnstoppableApproachError
from ..robot.batch import impacts
from ..robot.contact import Contact
from ..robot.derivatives import impact_derivatives

try:
    import crocoddyl
except ImportError as error:
    raise InputError(
        "crocoddyl: not installed; pip install 'pinimpact[crocoddyl]'", field="crocoddyl", value=None
    ) from error


class ActionModelImpact(crocoddyl.ActionModelAbstract):
    """An instantaneous impact with friction and restitution: x = (q, v) → (q, v⁺), without control.

    The costs are those of the state before the impact, as of Crocoddyl's own impulse dynamics. Where v⁺ does
    not exist or has no derivative it is NaN. This includes v = 0, the first guess of solvers by default: give
    them another one, for instance ``problem.rollout(us)``.

    Args:
        state: A `crocoddyl.StateMultibody`; its model is the robot.
        contacts: The contact that collides, or a sequence with that one.
        costs: A `crocoddyl.CostModelSum` with nu = 0.

    Raises:
        InputError: Several contacts; a Crocoddyl that was built for another version of Pinocchio.
    """

    def __init__(self, state: Any, contacts: Contact | Sequence[Contact], costs: Any) -> None:
        found = as_tuple("contacts", contacts, Contact, "a Contact")
        if len(found) != 1 or not isinstance(found[0], Contact):
            raise InputError(
                f"contacts: {len(found)} given, one Contact expected; derivatives are those of one contact",
                field="contacts",
                value=contacts,
            )
        _check_gravity()
        super().__init__(state, 0, costs.nr)
        self.contact, self.costs = found[0], costs

    def createData(self) -> ActionDataImpact:
        """Return data for `calc` and `calcDiff`."""
        return ActionDataImpact(self)

    def calc(self, data: ActionDataImpact, x: Any, u: Any = None) -> None:
        """Set `xnext` and `cost`."""
        model = self.state.pinocchio
        q, v = np.array(x[: model.nq]), np.array(x[model.nq :])
        v = impacts(model, data.impact, q, v, self.contact).v[0]
        data.xnext = np.concatenate((q, v))
        pin.forwardKinematics(model, data.pinocchio, q, np.array(x[model.nq :]))
        pin.updateFramePlacements(model, data.pinocchio)
        self.costs.calc(data.costs, x)
        data.cost = data.costs.cost

    def calcDiff(self, data: ActionDataImpact, x: Any, u: Any = None) -> None:
        """Set `Fx`, and `Lx` and `Lxx` of the costs."""
        model = self.state.pinocchio
        q, v = np.array(x[: model.nq]), np.array(x[model.nq :])
        nv = model.nv
        data.Fx = np.vstack((np.eye(nv, 2 * nv), self._slopes(data, q, v)))
        pin.computeForwardKinematicsDerivatives(model, data.pinocchio, q, v, np.zeros(nv))
        pin.computeJointJacobians(model, data.pinocchio, q)
        pin.updateFramePlacements(model, data.pinocchio)
        self.costs.calcDiff(data.costs, x)
        data.Lx, data.Lxx = np.array(data.costs.Lx), np.array(data.costs.Lxx)

    def _slopes(self, data: ActionDataImpact, q: Any, v: Any) -> Any:
        """Return ∂v⁺/∂x. An error that passes through Crocoddyl ends the process, so NaN stands for it."""
        model = self.state.pinocchio
        try:
            d = impact_derivatives(model, data.impact, q, v, self.contact)
        except (UnstoppableApproachError, LawError):
            return np.full((model.nv, 2 * model.nv), np.nan)
        return np.hstack((d.dv_dq, d.dv_dv))


class ActionDataImpact(crocoddyl.ActionDataAbstract):
    """Data of `ActionModelImpact`."""

    def __init__(self, model: ActionModelImpact) -> None:
        super().__init__(model)
        robot = model.state.pinocchio
        self.impact, self.pinocchio = robot.createData(), robot.createData()
        self.collector = crocoddyl.DataCollectorMultibody(self.pinocchio)
        self.costs = model.costs.createData(self.collector)
        self.costs.shareMemory(self)


@cache
def _check_gravity() -> None:
    """Raise `InputError` if a body does not fall: with a Pinocchio for which this Crocoddyl was not built."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    state = crocoddyl.StateMultibody(model)
    fall = crocoddyl.DifferentialActionModelFreeFwdDynamics(
        state, crocoddyl.ActuationModelFull(state), crocoddyl.CostModelSum(state)
    )
    data = fall.createData()
    fall.calc(data, np.zeros(2), np.zeros(1))
    if abs(data.xout[0] + 9.81) > 1e-6:
        raise InputError(
            f"crocoddyl: a body falls at {-data.xout[0]:g} m/s² instead of 9.81; this Crocoddyl was built "
            f"for another Pinocchio than {pin.__version__}; pip install 'pinimpact[crocoddyl]'",
            field="crocoddyl",
            value=crocoddyl.__version__,
        )
