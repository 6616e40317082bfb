"""Impacts and steps as actions of Crocoddyl's optimal control. (docs/derivatives.md, 8)"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from ..checks import above_zero, as_tuple, in_short
from ..errors import InputError, LawError, PinimpactError, UnstoppableApproachError
from ..robot.batch import impacts
from ..robot.contact import Contact
from ..robot.derivatives import impact_derivatives
from ..robot.robot_impact import impact
from ..scene.scene import Scene
from ..scene.sensitivities import check_supported
from ..scene.stepper import Stepper

try:
    import crocoddyl
except ImportError as error:
    raise InputError("crocoddyl: not installed; pip install 'pinimpact[crocoddyl]'", value=None) from error


class ActionModelImpact(crocoddyl.ActionModelAbstract):
    """An instantaneous impact with friction and restitution: x = (q, v) → (q, v⁺), without control.

    The costs are evaluated at the state before the impact, as in Crocoddyl's impulse dynamics. States and
    derivatives that do not exist are NaN. This includes v = 0, the default initial guess of solvers: give
    another one, for instance ``problem.rollout(us)``.

    Args:
        state: A `crocoddyl.StateMultibody`; its model is the robot.
        contacts: The contact that collides, or a sequence of the active contacts at this instant.
        costs: A `crocoddyl.CostModelSum` with nu = 0.

    Raises:
        InputError: No contact, or a Crocoddyl that was built for another version of Pinocchio.
    """

    def __init__(self, state: Any, contacts: Contact | Sequence[Contact], costs: Any) -> None:
        found = as_tuple("contacts", contacts, Contact, "a Contact")
        if not found or not all(isinstance(contact, Contact) for contact in found):
            raise InputError(f"contacts: {in_short(contacts)} given, Contacts expected", value=contacts)
        _check_gravity()
        super().__init__(state, 0, costs.nr)
        self.contacts, self.costs = found if len(found) > 1 else found[0], costs

    def createData(self) -> ActionData:
        """Return data for `calc` and `calcDiff`."""
        return ActionData(self)

    def calc(self, data: ActionData, x: Any, u: Any = None) -> None:
        """Set `xnext` and `cost`."""
        q, v = _observed(self.state.pinocchio, data, x)
        data.xnext = np.concatenate((q, self._after(data, q, v)))
        self.costs.calc(data.costs, x)
        data.cost = data.costs.cost

    def calcDiff(self, data: ActionData, x: Any, u: Any = None) -> None:
        """Set `Fx`, and `Lx` and `Lxx` of the costs."""
        (q, v), nv = _observed(self.state.pinocchio, data, x, True), self.state.nv
        data.Fx = np.vstack((np.eye(nv, 2 * nv), self._slopes(data, q, v)))
        self.costs.calcDiff(data.costs, x)
        data.Lx, data.Lxx = np.array(data.costs.Lx), np.array(data.costs.Lxx)

    def _after(self, data: ActionData, q: Any, v: Any) -> Any:
        """Return v⁺, NaN where it does not exist."""
        model = self.state.pinocchio
        if isinstance(self.contacts, Contact):
            return impacts(model, data.impact, q, v, self.contacts).v[0]
        try:
            return impact(model, data.impact, q, v, self.contacts).v
        except (UnstoppableApproachError, LawError):
            return np.full(model.nv, np.nan)

    def _slopes(self, data: ActionData, q: Any, v: Any) -> Any:
        """Return ∂v⁺/∂x (nv, 2 nv); NaN instead of an error, which in Crocoddyl would end the process."""
        model = self.state.pinocchio
        try:
            d = impact_derivatives(model, data.impact, q, v, self.contacts)
        except (UnstoppableApproachError, LawError):
            return np.full((model.nv, 2 * model.nv), np.nan)
        return np.hstack((d.dv_dq, d.dv_dv))


class ActionModelStep(crocoddyl.ActionModelAbstract):
    """A step of a scene under constant forces u, through all impacts and contact modes of the step.

    The costs are evaluated at the state before the step and u. States and derivatives that do not exist, such
    as those from a state below a surface, are NaN.

    Args:
        scene: The scene, without control.
        dt: Length of the step [s].
        costs: A `crocoddyl.CostModelSum` of the robot's state. Its nu is nv, or nv - 6 for a robot with a
            free base, to which u applies no force.
        **options: Further arguments of `Stepper`.

    Raises:
        InputError: Another nu, a scene whose steps have no derivatives, or a Crocoddyl that was built for
            another version of Pinocchio.
    """

    def __init__(self, scene: Scene, dt: float, costs: Any, **options: Any) -> None:
        nv = scene.model.nv
        nu, free = costs.nu, scene.model.nqs[1] == 7
        if nu != nv and not (free and nu == nv - 6):
            raise InputError(
                f"costs: nu = {nu} given, {f'{nv} or {nv - 6}' if free else nv} expected", value=costs
            )
        check_supported(scene)
        _check_gravity()
        super().__init__(costs.state, nu, costs.nr)
        self.scene, self.dt, self.costs, self.options = scene, above_zero("dt", dt), costs, options

    def createData(self) -> ActionData:
        """Return data for `calc` and `calcDiff`."""
        return ActionData(self)

    def calc(self, data: ActionData, x: Any, u: Any = None) -> None:
        """Set `xnext` and `cost`; without u, the cost of the state alone."""
        q, v = _observed(self.state.pinocchio, data, x)
        if u is None:
            self.costs.calc(data.costs, x)
            data.xnext = np.array(x)
        else:
            self.costs.calc(data.costs, x, u)
            try:
                data.xnext = np.concatenate(self._at(data, q, v).step(self._forces(u), self.dt))
            except PinimpactError:  # in Crocoddyl it would end the process
                data.xnext = np.full(len(x), np.nan)
        data.cost = data.costs.cost

    def calcDiff(self, data: ActionData, x: Any, u: Any = None) -> None:
        """Set `Fx`, `Fu` and the derivatives of the costs."""
        (q, v), nv = _observed(self.state.pinocchio, data, x, True), self.state.nv
        if u is None:
            self.costs.calcDiff(data.costs, x)
        else:
            self.costs.calcDiff(data.costs, x, u)
            try:
                by_x, by_tau = self._at(data, q, v).linearize(self._forces(u), self.dt)
                data.Fx, data.Fu = np.array(by_x), np.array(by_tau[:, nv - self.nu :])
            except PinimpactError:  # in Crocoddyl it would end the process
                data.Fx, data.Fu = np.full((2 * nv, 2 * nv), np.nan), np.full((2 * nv, self.nu), np.nan)
            data.Lu, data.Luu, data.Lxu = (np.array(getattr(data.costs, n)) for n in ("Lu", "Luu", "Lxu"))
        data.Lx, data.Lxx = np.array(data.costs.Lx), np.array(data.costs.Lxx)

    def _forces(self, u: Any) -> Any:
        return np.concatenate((np.zeros(self.state.nv - self.nu), u))

    def _at(self, data: ActionData, q: Any, v: Any) -> Stepper:
        """Return the stepper of the data, reset to a state."""
        if data.stepper is None:
            data.stepper = Stepper(self.scene, q, v, **self.options)
        else:
            data.stepper.reset(q, v)
        return data.stepper


class ActionData(crocoddyl.ActionDataAbstract):
    """Data of `ActionModelImpact` and `ActionModelStep`."""

    def __init__(self, model: ActionModelImpact | ActionModelStep) -> None:
        super().__init__(model)
        robot = model.state.pinocchio
        self.impact, self.pinocchio = robot.createData(), robot.createData()
        self.stepper: Stepper | None = None
        self.collector = crocoddyl.DataCollectorMultibody(self.pinocchio)
        self.costs = model.costs.createData(self.collector)
        self.costs.shareMemory(self)


def _observed(model: pin.Model, data: ActionData, x: Any, slopes: bool = False) -> tuple[Any, Any]:
    """Return q and v of a state; compute the kinematics for the costs, with derivatives if `slopes`."""
    q, v = np.array(x[: model.nq]), np.array(x[model.nq :])
    if slopes:
        pin.computeForwardKinematicsDerivatives(model, data.pinocchio, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, data.pinocchio, q)
    else:
        pin.forwardKinematics(model, data.pinocchio, q, v)
    pin.updateFramePlacements(model, data.pinocchio)
    return q, v


@cache
def _check_gravity() -> None:
    """Raise `InputError` if a body does not fall: this Crocoddyl was built for another Pinocchio."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    state = crocoddyl.StateMultibody(model)
    fall = crocoddyl.DifferentialActionModelFreeFwdDynamics(
        state, crocoddyl.ActuationModelFull(state), crocoddyl.CostModelSum(state)
    )
    data = fall.createData()
    fall.calc(data, np.zeros(2), np.zeros(1))
    if not np.isclose(data.xout[0], -9.81):
        raise InputError(
            f"crocoddyl: a body falls at {-data.xout[0]:g} m/s² instead of 9.81; this Crocoddyl was built "
            f"for another Pinocchio than {pin.__version__}; pip install 'pinimpact[crocoddyl]'",
            value=crocoddyl.__version__,
        )
