"""`place_in_contact` against a general optimizer and closed forms; starts within rounding errors."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

import pinimpact

from . import robot_cases

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


def test_displacement_of_arm_is_minimal():
    """Compare with scipy's SLSQP for the same problem."""
    robot = pinimpact.load_robot("panda")
    model, data = robot.model, robot.data
    hand = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane(point=(0, 0, 0.6), normal=(0.1, 0.3, 1)))
    assert abs(hand.gap(model, data, robot.q0)) > 0.05
    q = pinimpact.place_in_contact(model, data, robot.q0, hand)
    assert abs(hand.gap(model, data, q)) < 1e-11
    best = minimize(
        lambda x: float(np.sum((x - robot.q0) ** 2)),
        robot.q0,
        constraints={"type": "eq", "fun": lambda x: hand.gap(model, data, x)},
        bounds=list(zip(model.lowerPositionLimit, model.upperPositionLimit, strict=True)),
        tol=1e-12,
    )
    assert np.linalg.norm(q - robot.q0) == pytest.approx(np.sqrt(best.fun), rel=1e-6)
    np.testing.assert_allclose(q, best.x, atol=1e-5)


@pytest.mark.parametrize(("slope", "height", "count"), [(0.0, 1.5, 4), (0.2, 1.5, 4), (0.0, 100.0, 3)])
def test_quadruped_on_its_feet(slope, height, count):
    robot = pinimpact.load_robot("solo12")
    ground = pinimpact.Plane(normal=(np.sin(slope), 0, np.cos(slope)))
    feet = [pinimpact.Contact(foot, ground, radius=0.01) for foot in FEET[:count]]
    q0 = robot.q0.copy()
    q0[:3] += 0.4, -0.2, height
    q0[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0)).coeffs()
    q = pinimpact.place_in_contact(robot, robot.data, q0, feet)
    assert max(abs(foot.gap(robot, robot.data, q)) for foot in feet) < 1e-11
    assert pin.isNormalized(robot.model, q)
    # optimality: the gradient of the distance is a combination of the normal rows
    x = pin.difference(robot.model, q0, q)
    closer = pin.dDifference(robot.model, q0, q, pin.ArgumentPosition.ARG1).T @ x
    rows = [
        pin.computeFrameJacobian(
            robot.model, robot.data, q, robot.model.getFrameId(foot), pin.LOCAL_WORLD_ALIGNED
        )[:3].T
        @ ground.normal
        for foot in FEET[:count]
    ]
    along = closer - np.linalg.lstsq(np.array(rows).T, closer, rcond=None)[0] @ np.array(rows)
    assert np.linalg.norm(along) < 1e-7 * np.linalg.norm(closer)


@pytest.mark.parametrize(
    ("joint", "far"),
    [
        (pin.JointModelPlanar(), 20.0),
        (pin.JointModelPlanar(), 70.0),
        (pin.JointModelFreeFlyer(), 30.0),
        (pin.JointModelFreeFlyer(), 200.0),
    ],
)
def test_displacement_of_far_base_is_minimal(joint, far):
    """Compare with scipy's SLSQP, which starts at the base moved without rotation."""
    model = pin.Model()
    base = model.addJoint(0, joint, pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
    model.addFrame(pin.Frame("tip", base, 0, tip, pin.FrameType.OP_FRAME))
    data, start = model.createData(), pin.neutral(model)
    start[0] = far
    wall = pinimpact.Contact("tip", pinimpact.Plane(normal=(1, 0, 0)))
    moved = pin.difference(model, start, pinimpact.place_in_contact(model, data, start, wall))
    best = minimize(
        lambda x: float(x @ x),
        np.concatenate([[-far - 0.1], np.zeros(model.nv - 1)]),
        jac=lambda x: 2.0 * x,
        constraints={"type": "eq", "fun": lambda x: wall.gap(model, data, pin.integrate(model, start, x))},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    assert abs(wall.gap(model, data, pin.integrate(model, start, moved))) < 1e-12 * far
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(best.x), rel=1e-9)


def test_joint_limits_are_satisfied():
    """Without its limits the elbow moves further; with them the shoulder moves too."""
    robot = pinimpact.load_robot("two_link_arm")
    model = robot.model.copy()
    table = pinimpact.Contact("tip", pinimpact.Plane(point=(0, 0, 0.5)))
    data = model.createData()
    free = pinimpact.place_in_contact(model, data, robot.q0, table)
    model.lowerPositionLimit = np.array([-1.0, -0.02])
    model.upperPositionLimit = np.array([1.0, 0.02])
    q = pinimpact.place_in_contact(model, data, robot.q0, table)
    assert abs(free[1]) > 0.05
    assert abs(q[1]) == pytest.approx(0.02, abs=1e-12)
    assert abs(table.gap(model, data, q)) < 1e-11


@pytest.mark.parametrize(("height", "left"), [(5.0, 3.0), (-5.0, 3.0), (0.5, None)])
def test_surface_out_of_reach_raises_with_the_remaining_gap(height, left):
    """Two links of 1 m reach 2 m; a plane parallel to that of the arm's motion is out of reach too."""
    robot = pinimpact.load_robot("two_link_arm")
    normal, left = ((0, 0, 1), left) if left else ((0, 1, 0), height)
    plane = pinimpact.Plane(point=height * np.array(normal), normal=normal)
    with pytest.raises(
        pinimpact.InputError, match=rf"'tip on plane' cannot .*: a gap of {left:g} m remains"
    ) as caught:
        pinimpact.place_in_contact(robot, robot.data, robot.q0, pinimpact.Contact("tip", plane))
    assert caught.value.field == "contacts"
    assert caught.value.value == pytest.approx(left, rel=1e-5)


def test_incompatible_contacts_raise():
    robot = pinimpact.load_robot("two_link_arm")
    low = pinimpact.Contact("tip", pinimpact.Plane(), name="low")
    high = pinimpact.Contact("tip", pinimpact.Plane(point=(0, 0, 0.5)), name="high")
    with pytest.raises(pinimpact.InputError, match=r"2 contacts .* a gap of 0\.25 m remains at '(low|high)'"):
        pinimpact.place_in_contact(robot, robot.data, robot.q0, [low, high])
    with pytest.raises(pinimpact.InputError, match="none given"):
        pinimpact.place_in_contact(robot, robot.data, robot.q0, [])


@pytest.mark.parametrize("name", ["panda", "kinova", "solo12", "talos", "double_pendulum_continuous"])
def test_robots_reach_surfaces_within_their_reach(name):
    """The plane or sphere is at a position of the frame at another random configuration."""
    rng = np.random.default_rng(7)
    model, data = robot_cases.load(name)
    low, high = np.maximum(model.lowerPositionLimit, -2), np.minimum(model.upperPositionLimit, 2)
    for surface in ("plane", "sphere"):
        there, start = (pin.randomConfiguration(model, low, np.maximum(low, high)) for _ in range(2))
        frame = model.getFrameId(robot_cases.FRAMES[name])
        pin.framesForwardKinematics(model, data, there)
        place = data.oMf[frame].translation.copy()
        if surface == "plane":
            contact = pinimpact.Contact(frame, pinimpact.Plane(point=place, normal=rng.normal(size=3)))
        else:
            contact = pinimpact.Contact(frame, pinimpact.Sphere(center=place, radius=0.02), radius=0.01)
        q = pinimpact.place_in_contact(model, data, start, contact)
        assert abs(contact.gap(model, data, q)) < 1e-10
        for joint in range(1, model.njoints):
            if model.nqs[joint] == 1:
                i = model.idx_qs[joint]
                assert model.lowerPositionLimit[i] <= q[i] <= model.upperPositionLimit[i]


# ---- initial states within rounding errors of contact


def standing(shift):
    robot = pinimpact.load_robot("solo12")
    feet = [pinimpact.Contact(foot, pinimpact.Plane(), friction=0.8, radius=0.01) for foot in FEET]
    q = pinimpact.place_in_contact(robot, robot.data, robot.q0, feet)
    q[2] += shift
    hold = pinimpact.JointPD(kp=20.0, kd=0.5, q_ref=q)
    return robot, pinimpact.Scene(robot, feet, control=hold), q


def test_start_within_rounding_below_plane_rests_on_it():
    robot, scene, q = standing(-1e-9)
    assert scene.contacts[0].gap(robot, robot.data, q) < -9e-10
    trajectory = pinimpact.simulate(scene, q, np.zeros(robot.nv), 0.05)
    gaps = [contact.gap(robot, robot.data, trajectory.q[0]) for contact in scene.contacts]
    assert np.abs(gaps).max() < 1e-12
    assert np.abs(trajectory.q[0] - q).max() < 1e-8
    assert {trajectory.mode_at(contact.label, 0.02) for contact in scene.contacts} == {"stick"}
    assert not trajectory.impacts


def test_start_further_below_plane_raises():
    robot, scene, q = standing(-1e-8)
    with pytest.raises(pinimpact.InputError, match=r"starts 1e-08 m below its surface"):
        pinimpact.simulate(scene, q, np.zeros(robot.nv), 0.05, scheme="event-driven")


def test_start_within_rounding_beyond_joint_limit_is_moved_to_it():
    robot = pinimpact.load_robot("panda")
    q = robot.q0.copy()
    q[3] = robot.model.upperPositionLimit[3] + 5e-10
    scene = pinimpact.Scene(robot, control=lambda t, q, v: pin.rnea(robot.model, robot.data, q, v, 0 * v))
    trajectory = pinimpact.simulate(scene, q, np.zeros(9), 0.01)
    assert trajectory.q[0, 3] == robot.model.upperPositionLimit[3]
    q[3] += 1e-8
    with pytest.raises(pinimpact.InputError, match="beyond its limit"):
        pinimpact.simulate(scene, q, np.zeros(9), 0.01, scheme="event-driven")
