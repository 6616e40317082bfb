"""Direct access to Pinocchio's memory against its documented calls, and the fallback by copies.

The random states depend on the names of the tests.
"""

from __future__ import annotations

import gc
import inspect
import os
import subprocess
import sys
import weakref
from functools import partial

import numba
import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.robot import pinocchio_bridge as bridge
from pinimpact.robot import tree_numbers
from pinimpact.robot._kernels.python_calls import call, raise_kept_error
from pinimpact.robot.forest import crba

from . import robot_cases as cases
from . import test_contacts_matrices, test_impact_physics, test_simulation
from .scene_models import UP, ball, pendulum

FLOOR = Plane()


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


@pytest.fixture(params=["in place", "copied"])
def way(request, monkeypatch):
    """Access to Pinocchio's results, in place or by copies."""
    if request.param == "copied":
        monkeypatch.setattr(bridge, "trusted", lambda *_: False)
    return request.param


@pytest.fixture
def other_version(monkeypatch):
    """Simulate a version of Pinocchio whose forward dynamics do not fill the Jacobians."""

    def aba(model, data, *arguments):
        found = pin.aba(model, data, *arguments)
        data.J[:] = 0.0
        return found

    class Other:
        """Pinocchio with another `aba`."""

        def __getattr__(self, name):
            return aba if name == "aba" else getattr(pin, name)

    monkeypatch.setattr(bridge, "pin", Other())
    monkeypatch.setattr(bridge, "_verdicts", {})
    monkeypatch.setattr(bridge, "_warned", False)


def moved(model, rng):
    q, v = cases.random_state(model, rng)
    return q, v, rng.normal(size=model.nv)


@pytest.mark.parametrize("name", ["panda", "kinova", "solo12", "talos", "double_pendulum"])
def test_the_arrays_hold_what_documented_calls_give(name, way, rng):
    model = cases.load(name)[0]
    robot = bridge.robot_dynamics(model)
    arrays = (robot.placements, robot.velocities, robot.minverse)
    for _ in range(2):
        q, v, tau = moved(model, rng)
        robot.q[:], robot.v[:], robot.tau[:] = q, v, tau
        for step in (robot.forward_dynamics, robot.inverse_mass):
            step.function(*step.arguments)
        data = model.createData()
        mass = cases.mass_by_rnea(model, q)
        expected = np.linalg.solve(mass, tau - pin.rnea(model, data, q, v, np.zeros(model.nv)))
        scale = 1e-13 * np.linalg.cond(mass)
        assert robot.acceleration == pytest.approx(expected, abs=scale * np.abs(expected).max())
        assert np.abs(robot.minverse @ mass - np.eye(model.nv)).max() < scale
        pin.forwardKinematics(model, data, q, v, robot.acceleration)
        jacobian = pin.computeJointJacobians(model, model.createData(), q).reshape(6, -1)
        assert np.abs(robot.joint_jacobian - jacobian).max() < 1e-13
        for i in range(model.njoints):
            placement = data.oMi[i]
            R, p = robot.placements[i, :9].reshape(3, 3).T, robot.placements[i, 9:]
            assert np.abs(R - placement.rotation).max() < 1e-14
            assert np.abs(p - placement.translation).max() < 1e-14
            v_world, a_world = placement.act(data.v[i]).vector, placement.act(data.a[i]).vector
            assert np.abs(robot.velocities[i] - v_world).max() < 1e-12 * (1 + np.abs(v_world).max())
            a_world = a_world - model.gravity.vector
            assert np.abs(robot.accelerations[i] - a_world).max() < 1e-11 * (1 + np.abs(a_world).max())
        step = robot.forward_kinematics
        step.function(*step.arguments)
        assert np.abs(robot.local_velocities - [motion.vector for motion in data.v]).max() < 1e-12
        assert arrays == (robot.placements, robot.velocities, robot.minverse)  # kernels hold them
    assert robot.joint_jacobian.flags.f_contiguous
    assert robot.minverse.flags.c_contiguous


def test_arrays_outlive_the_model_without_leaks(way):
    model = cases.load("panda")[0]
    robot, gone = bridge.robot_dynamics(model), weakref.ref(model)
    del model
    gc.collect()
    step = robot.forward_dynamics
    step.function(*step.arguments)
    assert np.isfinite(robot.acceleration).all()
    del robot, step
    gc.collect()
    assert gone() is None


def test_impacts_are_the_same_either_way(rng, monkeypatch):
    for name, frame in cases.FRAMES.items():
        model, data = cases.load(name)
        body = model.frames[1].name
        for carrier in (None, body):
            q, v = cases.random_state(model, rng)
            contact = cases.random_contact(frame, rng, cases.random_plane(rng, carrier))
            v = cases.approaching(model, data, q, v, contact)
            hit = pinimpact.impact(model, data, q, v, contact)
            with monkeypatch.context() as patch:
                patch.setattr(bridge, "trusted", lambda *_: False)
                other = pinimpact.impact(model, model.createData(), q, v, contact)
                many = pinimpact.impacts(model, model.createData(), [q], [v], contact)
            assert np.abs(other.v - hit.v).max() < 1e-9 * np.abs(v).max()
            assert np.abs(many.v[0] - other.v).max() == 0.0


def test_scene_with_either_access(way):
    e, height = 0.5, 0.5
    scene = Scene(ball(), [Contact("center", FLOOR, friction=0.3, restitution=e, radius=0.1)])
    trajectory = simulate(scene, [0, 0, 0.1 + height, *UP], np.zeros(6), 1.5)
    assert trajectory.impacts[0].time == pytest.approx(np.sqrt(2 * height / 9.81), rel=1e-12)
    zeno = np.sqrt(2 * height / 9.81) * (1 + e) / (1 - e)
    assert trajectory.modes[0].start == pytest.approx(zeno, abs=2e-3)
    assert trajectory.q[-1, 2] == pytest.approx(0.1, abs=1e-13)
    assert trajectory.energy.residual[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    "test",
    [
        test_simulation.test_belt_accelerates_block_with_work_of_surface,
        partial(test_simulation.test_sliding_ball_starts_to_roll, 0.7),
        test_simulation.test_joint_limit_rebounds_and_supports_load,
        test_simulation.test_dry_friction_stops_and_holds_joint,
        test_simulation.test_held_tip_is_equivalent_to_hinge,
        *(
            partial(
                test_contacts_matrices.test_gap_and_jacobian_are_those_of_the_moving_points,
                body=body,
                surface=cases.random_plane,
            )
            for body in (None, "panda_link2")
        ),
        partial(
            test_contacts_matrices.test_mass_and_delassus_by_inverse_dynamics_and_dense_algebra, name="solo12"
        ),
        test_contacts_matrices.test_mimic_joints,
        partial(test_impact_physics.test_energy_by_pinocchio_is_the_ledger, "panda", "poisson"),
        partial(test_impact_physics.test_momentum_changes_by_the_impulse, "kinova"),
        test_impact_physics.test_roles_of_the_two_bodies_can_be_exchanged,
        test_impact_physics.test_many_states_at_once,
    ],
    ids=lambda test: getattr(test, "func", test).__name__,
)
def test_what_holds_of_robots_and_scenes_holds_with_copies(test, rng, monkeypatch):
    monkeypatch.setattr(bridge, "trusted", lambda *_: False)
    asked = inspect.signature(test).parameters
    test(**({"rng": rng} if "rng" in asked else {}))


def test_another_version_is_found_out_said_once_and_answered_alike(other_version, rng):
    scene = Scene(cases.load("panda")[0], without=["joint limits", "gravity"])
    q, v = cases.random_state(scene.model, rng)
    with pytest.warns(pinimpact.PinocchioLayoutWarning, match=r"joint_jacobian after aba"):
        trajectory = simulate(scene, q, v, 0.01)
    simulate(Scene(cases.load("ur5")[0]), np.zeros(6), np.ones(6), 0.01)  # no second warning
    assert trajectory.energy.residual[-1] == pytest.approx(0.0, abs=1e-6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bridge, "pin", pin)
        patch.setattr(bridge, "_verdicts", {})
        other = simulate(Scene(cases.load("panda")[0], without=["joint limits", "gravity"]), q, v, 0.01)
    assert np.abs(trajectory.q[-1] - other.q[-1]).max() < 1e-9


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_checks_in_other_units_of_length(unit):
    """The lengths of a model in metres are scaled."""
    model = cases.load("panda")[0].copy()
    model.gravity.linear = unit * model.gravity.linear
    for place in model.jointPlacements:
        place.translation *= unit
    assert bridge._disagreement_of_dynamics(model) is None
    assert tree_numbers.disagreement_of_tree(model) is None


def test_other_memory_layout_is_detected(monkeypatch):
    model = cases.load("panda")[0]
    monkeypatch.setattr(bridge, "_verdicts", {})
    monkeypatch.setattr(bridge, "_warned", False)
    rows = bridge.rows
    monkeypatch.setattr(bridge, "rows", lambda *args: rows(*(list(one)[::-1] for one in args[:2]), args[2]))
    with pytest.warns(pinimpact.PinocchioLayoutWarning, match=r"data\.oMi in memory"):
        assert type(bridge.robot_dynamics(model)) is bridge._Copied


def test_model_is_checked_once_and_again_after_joints_are_added(monkeypatch):
    checked = []
    monkeypatch.setattr(bridge, "_verdicts", {})
    known = tree_numbers.disagreement_of_tree

    def disagreement_of_tree(model):
        checked.append(model.njoints)
        return known(model)

    monkeypatch.setattr(tree_numbers, "disagreement_of_tree", disagreement_of_tree)
    model = cases.load("ur5")[0]
    contact = Contact("tool0", FLOOR)

    def ask():
        q = pin.neutral(model)
        pinimpact.impact(model, model.createData(), q, np.zeros(model.nv), contact)

    for _ in range(3):
        ask()
    assert checked == [7]
    model.addJoint(6, pin.JointModelRX(), pin.SE3.Identity(), "more")
    model.appendBodyToJoint(7, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    ask()
    assert checked == [7, 8]


# ---- errors in calls from kernels


@numba.njit
def calls(function, arguments):
    """Call a function by address from compiled code."""
    return call(function, arguments)


def called(function, *arguments):
    """Call a Python function from a kernel, and raise its error."""
    step = bridge.Call(function, arguments)
    addresses = bridge.call_addresses([step])
    assert calls(*addresses) or raise_kept_error() or pytest.fail("an error was lost")


def test_error_in_call_from_kernel_is_raised_with_its_traceback():
    def fail(value):
        raise LookupError(value)

    def interrupt():
        raise KeyboardInterrupt

    called(list, (1, 2))
    raise_kept_error()  # no error
    with pytest.raises(LookupError, match="lost") as caught:
        called(fail, "lost")
    assert caught.traceback[-1].name == "fail"
    raise_kept_error()  # no error any more
    with pytest.raises(KeyboardInterrupt):
        called(interrupt)
    model = cases.load("panda")[0]
    with pytest.raises(ValueError, match="size"):
        called(pin.aba, model, model.createData(), np.zeros(2), np.zeros(9), np.zeros(9))


def test_kept_errors_are_released():
    class LostError(Exception):
        """Error of Python, to which there are weak references."""

    def fail():
        error = LostError()
        seen.append(weakref.ref(error))
        raise error

    seen = []
    step = bridge.Call(fail, ())
    addresses = bridge.call_addresses([step])
    for _ in range(2):  # the first error is never raised
        assert not calls(*addresses)
    with pytest.raises(LostError):
        raise_kept_error()
    gc.collect()
    assert [error() for error in seen] == [None, None]


def test_error_inside_pinocchio_is_raised(monkeypatch):
    def broken(*_):
        raise MemoryError("no room")

    known = bridge.robot_dynamics

    def robot_dynamics(model):
        robot = known(model)
        robot.forward_dynamics = bridge.Call(broken, ())
        return robot

    monkeypatch.setattr("pinimpact.scene.layout.robot_dynamics", robot_dynamics)
    with pytest.raises(MemoryError, match="no room"):
        simulate(Scene(pendulum()), [1.0], [0.0], 1.0)


def test_error_of_progress_function_is_not_attributed_to_control():
    def progress(t, duration):
        raise ZeroDivisionError("progress")

    with pytest.raises(ZeroDivisionError, match=r"^progress$"):
        simulate(Scene(pendulum()), [1.0], [0.0], 1.0, progress=progress)


def test_interrupt_in_control_ends_the_run_with_a_partial_trajectory():
    def control(t, q, v):
        if t > 0.5:
            raise KeyboardInterrupt
        return np.zeros(1)

    trajectory = simulate(Scene(pendulum(), control=control), [1.0], [0.0], 1.0, max_step=0.1)
    assert not trajectory.complete
    assert "Interrupted" in trajectory.termination
    assert 0.3 <= trajectory.duration <= 0.5


def test_error_of_control_is_the_cause_of_the_raised_one():
    with pytest.raises(pinimpact.SimulationError, match=r"control: KeyError at t = 0 s") as caught:
        simulate(Scene(pendulum(), control=lambda *_: {}["torque"]), [1.0], [0.0], 1.0)
    assert isinstance(caught.value.__cause__, KeyError)


def test_massless_joint_is_named_in_scenes_and_impacts():
    model = pendulum()
    model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "bare")
    q, v = np.zeros(2), np.zeros(2)
    message = r"joint 'bare' \(velocity 1\) moves no inertia"
    with pytest.raises(pinimpact.ModelError, match=message):
        pinimpact.impact(model, model.createData(), q, v, Contact("tip", FLOOR))
    with pytest.raises(pinimpact.ModelError, match=message):
        simulate(Scene(model, [Contact("tip", Plane(point=(0, 0, -2.0)))]), q, v, 1.0)


def test_scene_without_joints_raises():
    with pytest.raises(pinimpact.ModelError, match="no joints"):
        simulate(Scene(pin.Model()), np.zeros(0), np.zeros(0), 1.0)


def two_arms(order):
    """Return a body with two arms of two joints, which are added in the given order."""
    model, index = pin.Model(), {"": 0}
    for name in order:
        joint, above = pin.JointModelRY(), index[name[:-1]]
        index[name] = model.addJoint(above, joint, pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.2])), name)
        model.appendBodyToJoint(index[name], pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.5), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.1, 0.0, -0.4]))
    model.addFrame(pin.Frame("tip", index["all"], 0, tip, pin.FrameType.OP_FRAME))
    return model


def test_joint_order_that_makes_the_mass_matrix_indefinite_raises():
    model, right = pin.Model(), pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.2]))
    kinds = pin.JointModelSpherical(), pin.JointModelRX(), pin.JointModelRX(), pin.JointModelPlanar()
    for k, (parent, joint) in enumerate(zip((0, 0, 2, 1), kinds, strict=True)):
        index = model.addJoint(parent, joint, right, f"joint{k}")
        body = pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.1]))
        model.appendBodyToJoint(index, pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.5), body)
    q = pin.neutral(model)
    mass = pin.crba(model, model.createData(), q)
    assert np.linalg.eigvalsh(mass, "U")[0] < 0.0  # although all bodies have inertia
    with pytest.raises(pinimpact.ModelError, match="'joint3' apart from the other joints below 'joint0'"):
        simulate(Scene(model), q, np.zeros(model.nv), 1.0)


def test_joints_not_in_depth_first_order_raise_since_crba_would_be_wrong():
    wrong, right = two_arms(("a", "al", "ar", "all", "arr")), two_arms(("a", "al", "all", "ar", "arr"))
    q, v = np.array([0.3, -0.5, 0.2, 0.4, -0.1]), np.array([-1.0, 0.5, 0.2, -0.7, 0.3])
    message = "'all' apart from the other joints below 'al'"
    contact = Contact("tip", FLOOR, friction=0.5, restitution=0.5)
    for ask in (
        lambda: pinimpact.impact(wrong, wrong.createData(), q, v, contact),
        lambda: pinimpact.impacts(wrong, wrong.createData(), q[None], v[None], contact),
        lambda: pinimpact.contact_matrices(wrong, wrong.createData(), q, contact),
        lambda: simulate(Scene(wrong), q, v, 1.0),
    ):
        with pytest.raises(pinimpact.ModelError, match=message):
            ask()
    for model in (wrong, right):  # M by RNEA does not depend on the order of joints
        data, still = model.createData(), np.zeros(5)
        weight = pin.rnea(model, data, q, still, still).copy()
        exact = np.column_stack([pin.rnea(model, data, q, still, unit) - weight for unit in np.eye(5)])
        crba = np.triu(pin.crba(model, data, q))
        assert np.allclose(crba, np.triu(exact), rtol=1e-12) == (model is right)
    assert pinimpact.impact(right, right.createData(), q, v, contact).v.shape == (5,)


def test_impacts_in_a_scene_do_not_change_arrays_of_kernels(monkeypatch):
    robots, compared = [], []
    known = bridge.robot_dynamics

    def robot_dynamics(model):
        robots.append(known(model))
        return robots[-1]

    def impact(*arguments, **options):
        names = ("joint_jacobian", "placements", "minverse")
        before = [getattr(robots[-1], name).copy() for name in names]
        hit = pinimpact.impact(*arguments, **options)
        compared.append(
            [np.array_equal(a, getattr(robots[-1], b)) for a, b in zip(before, names, strict=True)]
        )
        return hit

    monkeypatch.setattr("pinimpact.scene.layout.robot_dynamics", robot_dynamics)
    monkeypatch.setattr("pinimpact.scene.scene_impacts.impact", impact)
    floor = Plane(point=(0, 0, -0.9))
    simulate(Scene(pendulum(), [Contact("tip", floor, restitution=0.5)]), [1.0], [0.0], 0.5)
    assert compared
    assert all(compared)


SCRIPT = """
import numpy as np
from pinimpact.robot import pinocchio_bridge as bridge
from pinimpact.robot._kernels.python_calls import call, raise_kept_error
from pinimpact.robot.forest import crba
import pinocchio as pin
model = pin.buildSampleModelManipulator()
robot = bridge.robot_dynamics(model)
robot.tau[:] = 1.0
assert call(*bridge.call_addresses([robot.forward_dynamics]))
other = pin.aba(model, model.createData(), robot.q, robot.v, robot.tau)
assert np.allclose(robot.acceleration, other, rtol=1e-10)
try:
    call(*bridge.call_addresses([bridge.Call(int, ("x",))]))
except ValueError:
    raise_kept_error()
    print("passed on")
"""


def test_calls_without_compiler():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False
    )
    assert (run.stdout, run.stderr) == ("passed on\n", "")


@pytest.mark.parametrize("name", ["ur5", "solo12"])
def test_mass_matrix_of_crba_is_symmetric_and_has_the_kinetic_energy(name, rng):
    model, data = cases.load(name)
    model.armature = rng.uniform(0.1, 1.0, model.nv)
    q, v = cases.random_state(model, rng)
    mass = crba(model, data, q)
    assert np.array_equal(mass, mass.T)
    energy = bridge.kinetic_energy(model, data, q, v)
    assert energy == pytest.approx(cases.kinetic_energy(model, q, v), rel=1e-12)
