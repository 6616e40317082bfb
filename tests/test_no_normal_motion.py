"""Robots that cannot move along the normal of a contact, in any orientation: it does no work on them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from pinimpact import Contact, JointPD, Plane, Scene, Sphere, simulate

from .scene_models import G, unbounded

TURNS = [pin.exp3(axis) for axis in 2.0 * np.random.default_rng(3).normal(size=(6, 3))]
"""In these orientations the normal row of the contact Jacobian is a rounding error, and not exactly zero."""


def damped(joint, turn, far, lever=1.0):
    """Return a damped point mass, with the frame ``tip``, on a joint that moves it at right angles to z."""
    model = pin.Model()
    base = pin.SE3(turn, turn @ np.array([far, 0.0, 0.0]))
    index = model.addJoint(0, joint(), base, "joint")
    place = np.array([lever, 0.0, 0.0])
    model.appendBodyToJoint(index, pin.Inertia(1.0, place, np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", index, 0, pin.SE3(np.eye(3), place), pin.FrameType.OP_FRAME))
    unbounded(model)
    model.damping = np.array([0.5])
    model.gravity.linear = turn @ np.array([0.0, 0.0, -G])
    return model


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("joint", [pin.JointModelPY, pin.JointModelRZ])
@pytest.mark.parametrize("round_surface", [False, True])
@pytest.mark.parametrize("far", [0.0, 30.0])
def test_touching_surface_does_not_slow_a_joint_that_moves_along_it(joint, round_surface, far, scheme):
    """v = v₀ exp(−d t/I): without motion along the normal there is no normal force."""
    for turn in TURNS:
        tip, normal = turn @ np.array([far + 1.0, 0.0, 0.0]), turn[:, 2]
        surface = Sphere(tip - 0.3 * normal, 0.3) if round_surface else Plane(tip, normal)
        scene = Scene(damped(joint, turn, far), [Contact("tip", surface, friction=0.8)])
        trajectory = simulate(scene, [0.0], [-1.0], 0.2, scheme=scheme)
        assert trajectory.v[-1, 0] == pytest.approx(-np.exp(-0.1), rel=1e-6)
        assert not trajectory.impacts


def test_arm_with_a_lift_slides_along_a_tilted_plane_as_along_a_level_one():
    """The lift carries the whole normal force, so friction slows the turning arm by μ m g r."""
    mu, lever = 0.3, 0.5
    for turn in TURNS:
        model = pin.Model()
        lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3(turn, np.zeros(3)), "lift")
        arm = model.addJoint(lift, pin.JointModelRZ(), pin.SE3.Identity(), "arm")
        place = pin.SE3(np.eye(3), np.array([lever, 0.0, 0.0]))
        model.appendBodyToJoint(arm, pin.Inertia.FromSphere(2.0, 0.1), place)
        model.addFrame(pin.Frame("tip", arm, 0, place, pin.FrameType.OP_FRAME))
        unbounded(model)
        model.gravity.linear = turn @ np.array([0.0, 0.0, -G])
        plane = Plane(normal=turn[:, 2])
        trajectory = simulate(Scene(model, [Contact("tip", plane, mu)]), [0.0, 0.0], [0.0, 3.0], 0.2)
        inertia = 2.0 * lever**2 + 0.4 * 2.0 * 0.1**2
        assert trajectory.v[-1] == pytest.approx([0.0, 3.0 - 0.2 * mu * 2.0 * G * lever / inertia], abs=1e-8)


def gantry(turn, joints, friction=0.0, upper=(np.inf, np.inf)):
    """Return two slides in series with 1 kg each, dry friction on the first, and the frame ``tip``."""
    model, parent = pin.Model(), 0
    for joint, name in zip(joints, "ab", strict=True):
        base = pin.SE3(turn, np.zeros(3)) if parent == 0 else pin.SE3.Identity()
        parent = model.addJoint(parent, joint(), base, name)
        body = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        model.addJointFrame(parent)
    model.addFrame(pin.Frame("tip", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction, model.upperPositionLimit = np.array([friction, 0.0]), np.array(upper)
    model.gravity.linear = turn @ np.array([0.0, 0.0, -G])
    return model


@pytest.mark.parametrize("mu", [0.0, 0.8])
@pytest.mark.parametrize("both", [False, True])
def test_end_stop_reverses_one_slide_of_a_gantry_that_touches_its_table(both, mu):
    """The stops act along the slides, and the table has no normal force, so there is no friction either."""
    for turn in TURNS:
        table = Contact("tip", Plane(normal=turn[:, 2]), friction=mu, restitution=0.9)
        model = gantry(turn, (pin.JointModelPX, pin.JointModelPY), upper=(0.1, 0.1 if both else np.inf))
        scene = Scene(model, [table], limit_restitution=0.5)
        trajectory = simulate(scene, [0.0, 0.0], [1.0, 1.0], 0.15, scheme="event-driven")
        assert trajectory.v[-1] == pytest.approx([-0.5, -0.5 if both else 1.0], abs=1e-9)
        assert {impact.source for impact in trajectory.impacts} == (
            {"a upper", "b upper"} if both else {"a upper"}
        )


@pytest.mark.parametrize("mu", [0.0, 0.8])
def test_dry_friction_stops_one_slide_of_a_gantry_that_touches_its_table(mu):
    """a slows by f/(m₁ + m₂) and rests; b keeps its velocity."""
    for turn in TURNS:
        table = Contact("tip", Plane(normal=turn[:, 2]), friction=mu)
        model = gantry(turn, (pin.JointModelPX, pin.JointModelPY), friction=2.0)
        trajectory = simulate(Scene(model, [table]), [0.0, 0.0], [0.4, 1.0], 0.5, scheme="event-driven")
        assert trajectory.q[-1] == pytest.approx([0.08, 0.5], abs=1e-9)
        assert trajectory.v[-1] == pytest.approx([0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize("mu", [0.0, 0.8])
def test_slide_held_by_dry_friction_and_by_a_wall_rests(mu):
    """Both hold the same joint, and rounding errors of gravity are all that acts on it."""
    for turn in TURNS:
        model = gantry(turn, (pin.JointModelPX, pin.JointModelPX), friction=0.25)
        wall = Contact("a", Plane(normal=-turn[:, 0]), friction=mu)
        trajectory = simulate(Scene(model, [wall]), [0.0, 0.0], [0.0, 1.0], 0.5, scheme="event-driven")
        assert trajectory.q[-1] == pytest.approx([0.0, 0.5], abs=1e-9)


@pytest.mark.parametrize("spin", [0.0, 3.0, -7.0])
def test_spring_swings_an_arm_that_glides_over_its_turning_base(spin):
    """Slip reverses along the same line at the turning points; dry friction shortens each swing by 2 f/k.

    Base and arm have the inertia 1 about one axis, so that their relative motion has the frequency √(2k).
    """
    k, f = 200.0, 2.0
    half = np.pi / np.sqrt(2.0 * k)
    for turn in TURNS:
        model, joint, origin = pin.Model(), pin.JointModelRZ(), pin.SE3.Identity()
        base = model.addJoint(0, joint, pin.SE3(turn, turn @ np.array([0.2, 0.1, 0.3])), "base")
        model.appendBodyToJoint(base, pin.Inertia(1.0, np.zeros(3), np.eye(3)), origin)
        model.addJointFrame(base)
        arm = model.addJoint(base, joint, origin, "arm")
        model.appendBodyToJoint(arm, pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3))), origin)
        tip = pin.SE3(np.eye(3), np.array([1.0, 0.3, 0.0]))
        model.addFrame(pin.Frame("tip", arm, 0, tip, pin.FrameType.OP_FRAME))
        unbounded(model)
        model.friction, model.gravity.linear = np.array([0.0, f]), turn @ np.array([0.0, 0.0, -G])
        spring = JointPD([0.0, k], [0.0, 0.0], [0.0, 0.0])
        scene = Scene(model, [Contact("tip", Plane(body="base"), friction=0.8)], control=spring)
        trajectory = simulate(scene, [0.1, 0.3], [spin, 0.0], 3.2 * half, scheme="event-driven", rtol=1e-9)
        assert trajectory.at(3.0 * half)[0][1] == pytest.approx(-(0.3 - 6.0 * f / k), abs=1e-8)
        assert np.abs(trajectory.energy.impacts).max() < 1e-9


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_derivatives_of_a_damped_joint_that_moves_along_a_surface(scheme):
    """δv = exp(−d t/I) δv₀ and δq = δq₀ + I/d (1 − exp(−d t/I)) δv₀, without contact forces."""
    left = np.exp(-0.1)
    for turn in TURNS:
        model = damped(pin.JointModelRZ, turn, 0.0)
        scene = Scene(model, [Contact("tip", Plane(turn[:, 0], turn[:, 2]), friction=0.8, name="tip")])
        trajectory = simulate(scene, [0.0], [-1.0], 0.2, scheme=scheme, sensitivities="state")
        expected = np.array([[1.0, 2.0 * (1.0 - left)], [0.0, left]])
        np.testing.assert_allclose(trajectory.sensitivity(0.2).state, expected, atol=1e-6)
        assert not trajectory.forces("tip", [0.05, 0.1]).any()


def test_held_bodies_that_fall_together_load_no_contact():
    """In a tilted world the only loads of the time steps are rounding errors of gaps."""
    turn = pin.exp3(np.array([0.3, 0.5, -0.2]))
    model, base = pin.Model(), pin.SE3(turn, np.zeros(3))
    model.gravity.linear = turn @ np.array([0.0, 0.0, -G])
    first = model.addJoint(0, pin.JointModelPZ(), base, "first")
    arm = model.addJoint(first, pin.JointModelRZ(), pin.SE3.Identity(), "arm")
    second = model.addJoint(0, pin.JointModelPZ(), base, "second")
    for joint, mass, lever in ((first, 1.0, 0.0), (arm, 0.5, 0.3), (second, 2.0, 0.0)):
        body = pin.Inertia(mass, np.array([lever, 0.0, 0.0]), np.zeros((3, 3)))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([0.4, 0.2, 0.0]))
    model.addFrame(pin.Frame("hand", arm, 0, place, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("cart", second, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    held = [Contact("hand", Plane((0.4, 0.2, 0.0), (1.0, 0.0, 0.0), body="cart"))]
    trajectory = simulate(Scene(model, [], held=held), np.zeros(3), np.zeros(3), 0.3, scheme="time-stepping")
    assert trajectory.v[-1] == pytest.approx([-0.3 * G, 0.0, -0.3 * G], abs=1e-12)
    assert not trajectory.notes


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-3])
@pytest.mark.parametrize("mu", [0.0, 0.3, 1.5])
def test_spring_moves_an_arm_at_rest_off_the_top_of_a_sphere(mu, unit):
    """The tip leaves the sphere without a force, so the arm swings freely, and back to its start. (11.14)"""
    start, k, radius = 0.3, 20.0, 0.3 * unit
    top = unit * np.array([np.cos(start), np.sin(start), 0.0])
    for turn in [np.eye(3), *TURNS]:
        model = damped(pin.JointModelRZ, turn, 0.0, unit)
        model.damping = np.zeros(1)
        model.gravity.linear *= unit
        surface = Sphere(turn @ (top - np.array([0.0, 0.0, radius])), radius)
        spring = JointPD([k * unit**2], [0.0], [0.0])
        scene = Scene(model, [Contact("tip", surface, friction=mu, name="tip")], control=spring)
        trajectory = simulate(scene, [start], [0.0], 2.0, scheme="event-driven")
        assert trajectory.q[-1, 0] == pytest.approx(start * np.cos(2.0 * np.sqrt(k)), abs=1e-7)
        assert not trajectory.impacts


@pytest.mark.parametrize("mu", [0.0, 0.3])
@pytest.mark.parametrize("torque", [1.0, 50.0])
@pytest.mark.parametrize("course", [lambda t: 1.0, lambda t: 10.0 * t, lambda t: max(0.0, t - 0.1)])
@pytest.mark.parametrize("start", [0.0, -1e-8, -1e-5])
def test_torque_moves_a_pendulum_that_hangs_down_to_the_floor(start, course, mu, torque):
    """The tip rises to both sides of its lowest point, so the floor does not act: θ̈ = τ − g sin θ. (11.14)"""
    at_times = {"rtol": 1e-10, "atol": 1e-12, "max_step": 0.01}
    for turn in [np.eye(3), *TURNS]:
        model = damped(pin.JointModelRZ, turn, 0.0)
        model.damping = np.zeros(1)
        model.gravity.linear = turn @ np.array([G, 0.0, 0.0])
        tip, up = turn @ np.array([1.0, 0.0, 0.0]), turn @ np.array([-1.0, 0.0, 0.0])
        floor = Contact("tip", Plane(tip, up), friction=mu)
        scene = Scene(model, [floor], control=lambda t, q, v: np.array([torque * course(t)]))
        trajectory = simulate(scene, [start], [0.0], 0.3, scheme="event-driven")
        swing = solve_ivp(
            lambda t, y: (y[1], torque * course(t) - G * np.sin(y[0])), (0.0, 0.3), (start, 0.0), **at_times
        )
        assert trajectory.q[-1, 0] == pytest.approx(swing.y[0, -1], abs=1e-7)
        assert not trajectory.impacts


@pytest.mark.parametrize("mu", [0.0, 0.8])
@pytest.mark.parametrize("course", [lambda t: 1.0, lambda t: np.sin(20.0 * t)])
def test_stretched_arm_leaves_the_wall_at_its_full_reach(course, mu):
    """No posture reaches beyond the wall, so the motion is that of the arm alone, for any torques. (11.14)"""
    for turn, torque in zip(TURNS, np.random.default_rng(5).normal(size=(6, 2)), strict=True):
        model, parent, reach = pin.Model(), 0, (0.4, 0.7)
        for k in range(2):
            base = pin.SE3(turn, np.ones(3)) if k == 0 else pin.SE3(np.eye(3), np.array([reach[0], 0, 0]))
            parent = model.addJoint(parent, pin.JointModelRZ(), base, f"joint {k}")
            body = pin.Inertia(1.0, np.array([0.5 * reach[k], 0.1, 0.0]), 0.01 * np.eye(3))
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([reach[1], 0.0, 0.0]))
        model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
        unbounded(model)
        wall = Contact("tip", Plane(np.ones(3) + turn[:, 0] * sum(reach), -turn[:, 0]), friction=mu)
        scene = Scene(model, [wall], control=lambda t, q, v, torque=torque: torque * course(t))
        trajectory = simulate(scene, np.zeros(2), np.zeros(2), 0.2, scheme="event-driven")
        data = model.createData()

        def alone(t, x, model=model, data=data, torque=torque):
            return np.concatenate([x[2:], pin.aba(model, data, x[:2], x[2:], torque * course(t))])

        expected = solve_ivp(alone, (0.0, 0.2), np.zeros(4), rtol=1e-10, atol=1e-12, max_step=0.01)
        assert np.concatenate([trajectory.q[-1], trajectory.v[-1]]) == pytest.approx(
            expected.y[:, -1], abs=1e-7
        )
        assert not trajectory.impacts


@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_pendulum_that_touches_the_floor_at_its_lowest_point_swings_through(scheme, e, mu):
    """Nothing slows it: the tip meets the floor in one point, at zero normal velocity."""
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    tip = np.array([0.0, 0.0, -1.0])
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, tip, np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", hinge, 0, pin.SE3(np.eye(3), tip), pin.FrameType.OP_FRAME))
    unbounded(model)
    model.gravity.linear[:] = 0.0
    scene = Scene(model, [Contact("tip", Plane(tip, (0.0, 0.0, 1.0)), friction=mu, restitution=e)])
    steps = [{}] if scheme == "event-driven" else [{"dt": 1e-3}, {"dt": 3e-4}]
    for start in np.linspace(0.05, 0.0513, 14).tolist():  # steps begin anywhere about the lowest point
        for options in steps:
            trajectory = simulate(scene, [-start], [1.0], 0.12, scheme=scheme, **options)
            assert trajectory.v[-1, 0] == pytest.approx(1.0, abs=1e-7)
