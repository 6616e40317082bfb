"""Impacts as actions of Crocoddyl: derivatives against difference quotients, a solve through an impact."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, InputError, Plane, Scene, load_robot, simulate

crocoddyl = pytest.importorskip("crocoddyl", reason="Crocoddyl is not installed")
actions = pytest.importorskip("pinimpact.integrations.crocoddyl")


@pytest.fixture(scope="module")
def leg():
    """Return model, q, v and contact of a two-link leg on a rail, whose foot falls onto a plane."""
    model = pin.Model()
    inertia = pin.Inertia(1.0, np.array([0.0, 0.0, -0.1]), np.diag([0.01, 0.01, 0.002]))
    joint = 0
    for kind, place, name in (
        (pin.JointModelPZ(), pin.SE3.Identity(), "rail"),
        (pin.JointModelPX(), pin.SE3.Identity(), "slide"),
        (pin.JointModelRY(), pin.SE3.Identity(), "hip"),
        (pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.2])), "knee"),
    ):
        joint = model.addJoint(joint, kind, place, name)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("foot", joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.2])), pin.OP_FRAME))
    q = np.array([0.4, 0.0, 0.6, -1.1])
    v = np.array([-1.5, 0.4, 0.3, -0.2])
    return model, q, v, Contact("foot", Plane(), friction=0.4, restitution=0.4)


def _costs(state, foot):
    costs = crocoddyl.CostModelSum(state, 0)
    costs.addCost(
        "state", crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelState(state, state.zero(), 0)), 0.5
    )
    reach = crocoddyl.ResidualModelFrameTranslation(
        state, state.pinocchio.getFrameId(foot), np.array([0.1, 0.2, 0.3]), 0
    )
    costs.addCost("foot", crocoddyl.CostModelResidual(state, reach), 3.0)
    return costs


def _errors(action, x):
    """Return the errors of Fx and Lx against forward differences, relative to their largest entries."""
    data, differences = action.createData(), crocoddyl.ActionModelNumDiff(action)
    differences.disturbance = 1e-7
    other, none = differences.createData(), np.zeros(0)
    for model, of in ((action, data), (differences, other)):
        model.calc(of, x, none)
        model.calcDiff(of, x, none)
    np.testing.assert_array_equal(data.xnext, other.xnext)
    scale = np.abs(data.Fx).max(), np.abs(data.Lx).max()
    return np.abs(data.Fx - other.Fx).max() / scale[0], np.abs(data.Lx - other.Lx).max() / scale[1]


@pytest.mark.parametrize("robot", ["leg", "solo12"])
def test_derivatives_against_difference_quotients(robot, leg):
    model, q, v, contact = leg
    if robot == "solo12":
        found = load_robot("solo12")
        model = found.model
        foot = next(f.name for f in model.frames if f.name.endswith("FOOT"))
        q = pin.integrate(model, found.q0, np.r_[0, 0, 0, 0.1, 0.2, -0.1, np.linspace(-0.3, 0.3, 12)])
        v = np.linspace(-0.5, 0.5, model.nv)
        v[2] = -2.0
        contact = Contact(foot, Plane(), friction=0.4, restitution=0.3)
    state = crocoddyl.StateMultibody(model)
    action = actions.ActionModelImpact(state, [contact], _costs(state, contact.frame))
    of_state, of_cost = _errors(action, np.r_[q, v])
    assert of_state < 2e-6
    assert of_cost < 2e-6


@pytest.mark.parametrize(("friction", "restitution"), [(0.1, 0.4), (0.8, 0.1)])
def test_solve_through_impact_needs_no_more_iterations_than_with_differences(leg, friction, restitution):
    """The slip stops and resumes, or the foot sticks; of other problems, rounding changes the iterations."""
    model, q, v, contact = leg
    contact = replace(contact, friction=friction, restitution=restitution)
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)
    target = np.r_[0.6, 0.3, 0.5, -1.0, np.zeros(4)]
    running, ending = crocoddyl.CostModelSum(state), crocoddyl.CostModelSum(state)
    effort = crocoddyl.ResidualModelControl(state, model.nv)
    running.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1e-4)
    there = crocoddyl.ResidualModelState(state, target, model.nv)
    ending.addCost("there", crocoddyl.CostModelResidual(state, there), 10.0)

    def moves(costs, dt):
        flight = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
        return crocoddyl.IntegratedActionModelEuler(flight, dt)

    impact = actions.ActionModelImpact(state, contact, crocoddyl.CostModelSum(state, 0))
    ends = []
    for action in (impact, crocoddyl.ActionModelNumDiff(impact)):
        running_models = [moves(running, 0.02)] * 10 + [action] + [moves(running, 0.02)] * 15
        problem = crocoddyl.ShootingProblem(np.r_[q, v], running_models, moves(ending, 0.0))
        solver = crocoddyl.SolverFDDP(problem)
        controls = problem.quasiStatic([np.r_[q, v]] * problem.T)
        assert solver.solve(problem.rollout(controls), controls, 150)
        ends.append((solver.iter, solver.cost))
    assert ends[0][0] <= ends[1][0]
    assert ends[0][1] == pytest.approx(ends[1][1], rel=1e-4)


@pytest.mark.parametrize("height", [0.6, 0.346])
def test_derivatives_of_steps_against_difference_quotients(leg, height):
    """The steps are in flight, and with an impact."""
    model, q, v, contact = leg
    state = crocoddyl.StateMultibody(model)
    costs = crocoddyl.CostModelSum(state, model.nv)
    target = crocoddyl.ResidualModelState(state, state.zero(), model.nv)
    costs.addCost("state", crocoddyl.CostModelResidual(state, target), 0.5)
    effort = crocoddyl.ResidualModelControl(state, model.nv)
    costs.addCost("effort", crocoddyl.CostModelResidual(state, effort), 0.1)
    scene = Scene(model, [contact])
    action = actions.ActionModelStep(scene, 0.01, costs, rtol=1e-11, atol=1e-13)
    bent = q.copy()
    bent[0] = height
    x, u = np.r_[bent, v], np.array([0.3, -0.2, 0.5, 0.1])
    data, differences = action.createData(), crocoddyl.ActionModelNumDiff(action)
    differences.disturbance = 1e-7
    other = differences.createData()
    for which, of in ((action, data), (differences, other)):
        which.calc(of, x, u)
        which.calcDiff(of, x, u)
    impacts = simulate(scene, bent, v, 0.01).impacts
    assert bool(impacts) == (height < 0.5)
    for name in ("Fx", "Fu", "Lx", "Lu"):
        exact, found = getattr(data, name), getattr(other, name)
        assert np.abs(exact - found).max() < 3e-6 * max(np.abs(exact).max(), 1.0), name


def test_step_from_below_the_surface_is_nan(leg):
    model, q, v, contact = leg
    state = crocoddyl.StateMultibody(model)
    action = actions.ActionModelStep(Scene(model, [contact]), 0.01, crocoddyl.CostModelSum(state, model.nv))
    data = action.createData()
    action.calc(data, np.r_[q - [9.0, 0, 0, 0], v], np.zeros(4))
    action.calcDiff(data, np.r_[q - [9.0, 0, 0, 0], v], np.zeros(4))
    assert np.isnan(data.xnext).all()
    assert np.isnan(data.Fx).all()


def test_derivatives_of_step_with_impacts_of_two_feet_are_nan():
    """The order of impacts depends on the state, so there are none; an error would end the process."""
    model, joint = pin.Model(), 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPZ(), "z")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    for name, x in (("left", -0.2), ("right", 0.2)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, joint, place, pin.FrameType.OP_FRAME))
    scene = Scene(model, [Contact(name, Plane(), 0.3, 0.5) for name in ("left", "right")])
    state = crocoddyl.StateMultibody(model)
    action = actions.ActionModelStep(scene, 0.02, crocoddyl.CostModelSum(state, 2))
    x, u = np.array([0.0, 0.01, 0.3, -1.0]), np.zeros(2)
    problem = crocoddyl.ShootingProblem(x, [action], action)
    problem.calc([x, x], [u])
    problem.calcDiff([x, x], [u])
    found = problem.runningDatas[0]
    assert np.isfinite(found.xnext).all()
    assert np.isnan(found.Fx).all()


def test_derivatives_of_impact_at_two_feet_against_difference_quotients():
    model = load_robot("solo12").model
    q = pin.neutral(model)
    q[7:] = np.tile([0.1, 0.7, -1.4], 4)
    v = 0.3 * np.random.default_rng(2).normal(size=18) - np.eye(18)[2]
    feet = [Contact(name, Plane(), 0.5, 0.3) for name in ("FL_FOOT", "HR_FOOT")]
    state = crocoddyl.StateMultibody(model)
    action = actions.ActionModelImpact(state, feet, _costs(state, "FL_FOOT"))
    by_x, by_costs = _errors(action, np.concatenate([q, v]))
    assert by_x < 1e-5
    assert by_costs < 1e-5


def test_bad_input_is_named(leg):
    model, q, v, contact = leg
    state = crocoddyl.StateMultibody(model)
    none = crocoddyl.CostModelSum(state, 0)
    with pytest.raises(InputError, match=r"contacts: .*Contacts expected"):
        actions.ActionModelImpact(state, [], none)
    with pytest.raises(InputError, match="costs: nu = 0 given, 4 expected"):
        actions.ActionModelStep(Scene(model, [contact]), 0.01, none)
    action = actions.ActionModelImpact(state, contact, none)
    data = action.createData()
    action.calcDiff(data, np.r_[q, 0.0 * v])  # grazing
    assert np.isnan(data.Fx[4:]).any()
