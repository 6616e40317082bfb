"""Motions are invariant under changes of the units of length, mass and time."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, Sphere
from pinimpact.scene.joint_metres import gyration, metres_per_unit
from tests.scene_models import UP, unbounded
from tests.test_time_stepping import boxes

SCHEMES = "event-driven", "time-stepping"


def along(*xyz):
    return pin.SE3(np.eye(3), np.array(xyz, dtype=float))


def pendulum(length, gravity=0.0):
    """Return a pendulum with a point mass of 1 kg."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        joint, pin.Inertia(1.0, np.array([length, 0, 0]), np.zeros((3, 3))), pin.SE3.Identity()
    )
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    unbounded(model)
    return model


def arm_and_ball(m, kg, s):
    """Return a scene of an arm with limits and dry friction, and a ball; q, v and units of q and v.

    There are contacts of the tip with floor and ball, and of the ball with the floor.
    """
    model, joint = pin.Model(), 0
    model.gravity.linear = np.array([0.0, 0.0, -9.81]) * m / s**2
    for k, kind in enumerate((pin.JointModelRY, pin.JointModelRX, pin.JointModelRY)):
        joint = model.addJoint(joint, kind(), along(0.0, 0.0, -0.3 * m * (k > 0)), f"j{k}")
        inertia = np.diag([0.01, 0.011, 0.003]) * kg * m * m
        lever = np.array([0.01, 0.02, -0.15]) * m
        model.appendBodyToJoint(joint, pin.Inertia((1.0 + 0.3 * k) * kg, lever, inertia), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, along(0.0, 0.0, -0.3 * m), pin.FrameType.OP_FRAME))
    ball = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia.FromSphere(0.5 * kg, 0.1 * m), pin.SE3.Identity())
    model.addFrame(pin.Frame("center", ball, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    model.lowerPositionLimit[:3], model.upperPositionLimit[:3] = [-0.6, -0.4, -0.5], [0.7, 0.5, 0.4]
    model.friction = np.array([0.05, 0.05, 0.02] + 6 * [0.0]) * kg * (m / s) ** 2
    floor, moving = Plane((0.0, 0.0, -0.86 * m)), Sphere((0.0, 0.0, 0.0), 0.1 * m, body="center")
    contacts = [
        Contact("tip", floor, friction=0.3, restitution=0.4),
        Contact("center", floor, radius=0.1 * m, friction=0.5, restitution=0.6),
        Contact("tip", moving, friction=0.2, restitution=0.5),
    ]
    by_q, by_v = np.ones(10), np.ones(9) / s
    by_q[3:6] *= m
    by_v[3:6] *= m
    q0 = np.array([0.5, 0.2, -0.3, -0.25, 0.02, -0.7, *UP]) * by_q
    v0 = np.array([-1.0, 0.5, 2.0, 0.8, 0.1, 0.0, 0.0, 1.0, 0.0]) * by_v
    return Scene(model, contacts, limit_restitution=0.5), q0, v0, by_q, by_v


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("units", [(1000.0, 1000.0, 1000.0), (100.0, 1.0, 10.0)])
def test_motion_in_other_units(scheme, units):
    found = []
    for m, kg, s in ((1.0, 1.0, 1.0), units):
        scene, q0, v0, by_q, by_v = arm_and_ball(m, kg, s)
        steps = {"dt": 2e-3 * s} if scheme == "time-stepping" else {}
        trajectory = pinimpact.simulate(scene, q0, v0, 0.7 * s, scheme=scheme, **steps)
        hits = [(hit.source, hit.resting) for hit in trajectory.impacts]
        found.append((hits, trajectory.q[-1] / by_q, trajectory.v[-1] / by_v))
    (hits, q, v), (others, q_other, v_other) = found
    assert len(hits) > 5
    assert hits == others
    assert q_other == pytest.approx(q, abs=1e-7)
    assert v_other == pytest.approx(v, abs=1e-6)


def pile(m, kg, s):
    """Return a scene of three tilted boxes above each other, q, v and units of q and v."""
    scene = boxes(3, 0.2 * m * np.array([1.0, 0.8, 0.5]), kg, restitution=0.2)
    scene.model.gravity.linear = np.array([0.0, 0.0, -9.81]) * m / s**2
    by_q, by_v = np.tile([m, m, m, 1, 1, 1, 1], 3), np.tile([m / s] * 3 + [1.0 / s] * 3, 3)
    turns = [pin.exp3(np.array(turn)) for turn in ((0.1, 0.0, 0.0), (0.0, -0.05, 0.3), (-0.1, 0.1, 0.0))]
    q0 = [[0.02 * k, 0, 0.08 + 0.15 * k, *pin.Quaternion(turn).coeffs()] for k, turn in enumerate(turns)]
    return scene, np.ravel(q0) * by_q, np.zeros(18), by_q, by_v


@pytest.mark.parametrize("made", [arm_and_ball, pile])
@pytest.mark.parametrize("units", [(2.0**-10, 1.0, 1.0), (2.0**10, 2.0**-30, 2.0**5)])
def test_time_steps_are_identical_in_units_that_are_powers_of_two(made, units):
    """Therefore no norm or tolerance adds quantities of different units."""
    found = []
    for m, kg, s in ((1.0, 1.0, 1.0), units):
        scene, q0, v0, by_q, by_v = made(m, kg, s)
        run = pinimpact.simulate(scene, q0, v0, 0.4 * s, scheme="time-stepping", dt=2e-3 * s)
        found.append((run.q[-1] / by_q, run.v[-1] / by_v, len(run.impacts)))
    for there, here in zip(*found, strict=True):
        np.testing.assert_array_equal(there, here)


@pytest.mark.parametrize(
    ("scheme", "alone"), [("event-driven", True), ("event-driven", False), ("time-stepping", True)]
)
@pytest.mark.parametrize("length", [0.01, 1.0, 100.0])
def test_slow_bounce_at_joint_limit_is_independent_of_size(scheme, length, alone):
    """Under the same gravity, motions with lengths scaled by L and times by √L are similar."""
    model = pendulum(length)
    model.upperPositionLimit[0] = 0.1
    contacts = []
    if not alone:  # the tip reaches the floor at the same time
        model.addFrame(pin.Frame("tip", 1, 0, along(length, 0.0, 0.0), pin.FrameType.OP_FRAME))
        contacts = [Contact("tip", Plane((0.0, 0.0, -length * math.sin(0.1))), restitution=0.5)]
    s = math.sqrt(length)
    # speeds of the tip over √L; the resting speed is 3.1e-4, and rebounds have half of the speed
    for speed in (2e-3, 4e-4):
        scene = Scene(model, contacts, limit_restitution=0.5)
        start = [0.1 - 2.5e-3 * speed], [speed / s]
        steps = {"dt": 1e-3 * s} if scheme == "time-stepping" else {}
        trajectory = pinimpact.simulate(scene, *start, 4e-3 * s, scheme=scheme, **steps)
        v = trajectory.v[-1, 0] * s
        assert v == pytest.approx(-0.5 * speed if speed > 1e-3 else 0.0, abs=1e-12)


@pytest.mark.parametrize("length", [0.01, 1.0, 100.0])
def test_sticking_speed_of_joint_is_relative_to_its_radius_of_gyration(length):
    model = pendulum(length)
    model.friction = np.array([1e-9 * length**2])  # deceleration is negligible
    stick = 1e-5 * math.sqrt(9.80665 * length)
    for speed in (0.5 * stick, 2.0 * stick):
        trajectory = pinimpact.simulate(Scene(model), [0.0], [speed / length], 1e-3 * math.sqrt(length))
        assert (trajectory.v[-1, 0] < 1e-30) == (speed < stick)


@pytest.mark.parametrize("spin", [0.0, 1e3])
def test_slow_impact_next_to_fast_small_wheel(spin):
    """The approach at 5 µm/s is above the error of 10 nm/s due to a wheel of 1 mm with 1 m/s at its rim."""
    model = pin.Model()
    for kind, radius in ((pin.JointModelPZ(), 0.1), (pin.JointModelRZ(), 1e-3)):
        joint = model.addJoint(0, kind, pin.SE3.Identity(), kind.shortname())
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    scene = Scene(model, [Contact("tip", Plane())])
    trajectory = pinimpact.simulate(scene, [0.0, 0.0], [-5e-6, spin], 1e-3)
    assert [hit.source for hit in trajectory.impacts] == ["tip on plane"]


def test_slow_rotation_of_distant_mass_is_not_rest_in_time_steps():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia.FromSphere(1.0, 1.0), pin.SE3.Identity())
    turn = model.addJoint(slide, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(turn, pin.Inertia(1.0, np.array([100.0, 0, 0]), np.eye(3)), pin.SE3.Identity())
    unbounded(model)
    model.lowerPositionLimit[0] = 0.0  # supports the weight
    trajectory = pinimpact.simulate(
        Scene(model), [0.0, 0.0], [0.0, 1e-8], 1.0, scheme="time-stepping", dt=1e-2
    )
    assert trajectory.q[-1, 1] == pytest.approx(1e-8, rel=1e-9)  # 1 µm on a circle of 100 m


def test_metres_per_unit_of_prismatic_and_revolute_joints():
    model, joint = pin.Model(), 0
    helix, slant = pin.JointModelHZ(0.2), pin.JointModelPrismaticUnaligned(1.0, 2.0, 2.0)
    rod = pin.Inertia(3.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, 0.25, 0.25]))  # length 1 m, along x
    for kind in (pin.JointModelPX(), helix, slant, pin.JointModelRX(), pin.JointModelRZ()):
        joint = model.addJoint(joint, kind, along(0.0, 0.0, 0.0), f"j{joint}")
    model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    radii = gyration(model)
    assert radii[4] == pytest.approx(math.sqrt(1.0 / 3.0), rel=1e-14)
    assert radii[3] == pytest.approx(math.sqrt(1.0 / 3.0), rel=1e-14)  # for an angle of the next joint
    assert metres_per_unit(model, radii, 7.0)[:3] == pytest.approx([1.0, math.hypot(0.2, radii[1]), 1.0])
    assert metres_per_unit(model, np.zeros(5), 7.0)[3:] == pytest.approx([7.0, 7.0])


def test_radii_of_gyration_bound_those_at_any_configuration():
    """Compare with √(M_ii/m) at random configurations of an arm, where equality holds for the last joint."""
    model = pin.buildSampleModelManipulator()
    radii, data = gyration(model), model.createData()
    masses = [pin.computeSubtreeMasses(model, data) or data.mass[j] for j in range(1, model.njoints)]
    rng, largest = np.random.default_rng(1), np.zeros(model.nv)
    for _ in range(200):
        moments = np.diag(pin.crba(model, data, rng.uniform(-3.0, 3.0, model.nq)))
        largest = np.maximum(largest, np.sqrt(moments / np.array(masses)))
    assert (radii >= (1.0 - 1e-12) * largest).all()
    assert radii[-1] == pytest.approx(largest[-1], rel=1e-12)
    assert (radii <= 2.0 * largest).all()
