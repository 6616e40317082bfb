"""Sticking, incipient slip, reversal and return to rest, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Event, Plane, Scene, simulate

from .scene_models import (
    G,
    box_on,
    box_on_a_slope,
    boxes_on_a_belt,
    free_body,
    rough_joint,
    slider,
    unbounded,
)
from .stick_slip import Swing, stick_slip


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize(
    ("a", "b", "t_c"), [(0.1, 1.0, 10.0), (0.1, 1.0, 5.0), (0.02, 0.3, 8.0), (1.0, 2.0, 4.0)]
)
def test_dry_friction_holds_then_releases_continuously(a, b, t_c, rtol):
    k = 2.0 * a / b**2
    scene = Scene(rough_joint(0.5), control=lambda t, q, v: np.array([-k * (t - t_c) - 0.5]))
    start = [a - a * t_c**2 / b**2]
    trajectory = simulate(scene, [0.0], start, t_c + 10.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.v[-1, 0] == pytest.approx(-0.5 * k * 100.0, rel=1e2 * rtol)
    (stuck,) = [interval for interval in trajectory.modes if interval.mode == "stuck"]
    assert stuck.start == pytest.approx(t_c - b, abs=1e3 * rtol)
    assert stuck.end == pytest.approx(t_c, abs=1e-8)


def test_sticking_tip_sets_dry_joint_in_motion():
    """The joint is pushed forwards, but moves backwards until dry friction and the push stop it."""
    model, parent = pin.Model(), 0
    for kind in (pin.JointModelPZ(), pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), kind.shortname())
    model.appendBodyToJoint(3, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.appendBodyToJoint(4, pin.Inertia(1e-12, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", 4, 0, place, pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction = np.array([0.0, 0.0, 0.0, 0.01])
    scene = Scene(model, [Contact("tip", Plane(), friction=0.5)], control=lambda t, q, v: [0, 0, 0, 0.02])
    speed = 9e-6  # below the resting speed at the start of a motion
    trajectory = simulate(scene, np.zeros(4), [0.0, 0.0, speed, 0.0], 1e-3)
    inertia = 1e-3 + 0.1**2
    rate = -0.1 * speed / inertia  # an impulse at the tip conserves I ω − ℓ m v
    turned = -rate * inertia / (0.02 + 0.01)
    for t in (0.3 * turned, 0.9 * turned, 2.0 * turned, 1e-3):
        push = 0.03 if t < turned else 0.01
        v = trajectory.at(t)[1]
        assert v[3] == pytest.approx(push * (t - turned) / inertia, rel=1e-7)
        assert v[2] == pytest.approx(-0.1 * v[3], rel=1e-7)


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
def test_stick_slip_under_oscillating_force(rtol):
    load = Swing(0.3, 10.0, 0.0, 0.25)
    x, _, slips = stick_slip(load, 0.5, 20.0)
    assert slips == 32
    scene = Scene(
        slider(),
        [Contact("point", Plane(), friction=0.5 / G)],
        control=lambda t, q, v: np.array([load.force(t), 0.0, 0.0]),
    )
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 20.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.q[-1, 0] == pytest.approx(x, rel=1e3 * rtol)
    assert sum(interval.mode == "slip" for interval in trajectory.modes) == 32


@pytest.mark.parametrize("corners", [3, 4, 8, 16])
@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
def test_box_on_corners_slips_at_friction_limit(corners, rtol):
    model, contacts = box_on(corners)
    scene = Scene(model, contacts, control=lambda t, q, v: np.array([5.0 * t, 0, 0, 0, 0.5 * t, 0]))
    trajectory = simulate(scene, [0, 0, 0.1, 0, 0, 0, 1.0], np.zeros(6), 2.0, rtol=rtol, atol=1e-2 * rtol)
    late = 2.0 - 0.5 * G / 5.0
    assert trajectory.v[-1, 0] == pytest.approx(2.5 * late**2, rel=1e3 * rtol)
    assert trajectory.q[-1, 0] == pytest.approx(2.5 * late**3 / 3.0, rel=1e3 * rtol)


@pytest.mark.parametrize("corners", [3, 4])
@pytest.mark.parametrize("inertia", [1e-6, 1e-8])
def test_friction_limit_of_box_does_not_depend_on_light_finger(corners, inertia):
    """A light finger, uncoupled from the box, would accelerate at 5·10⁷ rad/s² without its joint limit."""
    model, contacts = box_on(corners)
    finger = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "finger")
    body = pin.Inertia(1e-3, np.zeros(3), inertia * np.eye(3))
    model.appendBodyToJoint(finger, body, pin.SE3.Identity())
    unbounded(model)
    model.upperPositionLimit[7] = 0.0
    scene = Scene(model, contacts, control=lambda t, q, v: np.array([5.0 * t, 0, 0, 0, 0.5 * t, 0, 50.0]))
    trajectory = simulate(scene, [0, 0, 0.1, 0, 0, 0, 1.0, 0.0], np.zeros(7), 2.0)
    late = 2.0 - 0.5 * G / 5.0
    assert [m.end for m in trajectory.modes if m.mode == "stick"] == pytest.approx(
        [0.5 * G / 5.0] * corners, abs=2e-5
    )
    assert trajectory.v[-1, 0] == pytest.approx(2.5 * late**2, rel=1e-5)
    assert trajectory.q[-1, 0] == pytest.approx(2.5 * late**3 / 3.0, rel=1e-5)
    times = 2.0 - late + np.array([1e-4, 1e-3, 1e-2])
    friction = sum(trajectory.forces(contact.label, times)[:, :2] for contact in contacts)
    assert np.linalg.norm(friction, axis=1) == pytest.approx(0.5 * G, rel=1e-5)


@pytest.mark.parametrize("numbering", [(0, 1, 2, 3), (1, 3, 0, 2)])
def test_friction_does_not_drive_box_rotating_about_corner(numbering):
    """The motion depends on the load distribution of four corners; only for some of them the corner moves."""
    turn = 0.5 * math.pi * (np.arange(4) + 0.6 / math.pi)
    points = np.column_stack([0.2 * np.cos(turn), 0.2 * np.sin(turn), np.full(4, -0.1)])
    model = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2), points)
    scene = Scene(model, [Contact(f"tip{k}", Plane(), friction=0.4) for k in numbering])
    tilt = pin.Quaternion(pin.exp3(np.array([-0.126657, 0.064093, 0.065197]))).coeffs()
    speed = np.array([1.058919, -0.55601, -0.188803, 1.021386, 0.323351, 0.331532])
    trajectory = simulate(scene, [0, 0, 0.4, *tilt], speed, 1.0)
    assert trajectory.statistics["steps"] < 500  # 60,000 per 0.1 s if it were driven back and forth
    assert trajectory.q[-1, 2] == pytest.approx(0.1, abs=1e-9)
    assert np.abs(trajectory.v[-1]).max() < 1e-9
    times = trajectory.modes[-1].start + np.linspace(-0.01, 0.0, 50)
    supports = sum(trajectory.forces(f"tip{k} on plane", times) for k in range(4))
    assert supports[:, 2] == pytest.approx(G, abs=1e-6)


@pytest.mark.parametrize("corners", [3, 4])
def test_box_on_corners_moves_like_point_mass(corners):
    load = Swing(5.5, 3.0, 0.4, 1.0)
    x, _, slips = stick_slip(load, 0.5 * G, 10.0)
    assert slips > 3
    model, contacts = box_on(corners)
    scene = Scene(
        model, contacts, control=lambda t, q, v: np.array([load.force(t), 0, 0, 0, 0.1 * load.force(t), 0])
    )
    trajectory = simulate(scene, [0, 0, 0.1, 0, 0, 0, 1.0], np.zeros(6), 10.0)
    assert trajectory.q[-1, 0] == pytest.approx(x, abs=1e-6)


@pytest.mark.parametrize("mus", [(0.5, 0.5), (0.5, 0.4), (0.3, 0.3)])
def test_two_boxes_on_a_belt(mus):
    scene = boxes_on_a_belt(mus, 1.0)
    trajectory = simulate(scene, np.zeros(6), np.zeros(6), 2.0)
    for k, mu in enumerate(mus):
        assert trajectory.q[-1, 3 * k] == pytest.approx(2.0 - 0.5 / (mu * G), abs=1e-7)
    assert not any("jam" in note.text for note in trajectory.notes)


@pytest.mark.parametrize("excess", [0.0, 1e-6, 1e-4, 2e-4, 5e-4, -1e-4])
def test_box_near_friction_angle(excess):
    slope = math.atan(0.546)
    mu = math.tan(slope) * (1.0 + excess)
    scene, q0 = box_on_a_slope(slope, mu, 0.1)
    trajectory = simulate(scene, q0, np.zeros(6), 1.0)
    assert trajectory.statistics["steps"] < 500
    moved = float(np.linalg.norm(trajectory.q[-1, :3] - q0[:3]))
    assert moved == pytest.approx(0.5 * max(0.0, -excess) * G * math.sin(slope), abs=1e-8)
    assert not any("jam" in note.text for note in trajectory.notes)


@pytest.mark.parametrize("beyond", [-1e-9, 1e-10, 1e-9])
def test_ladder_on_a_smooth_wall_at_its_steepest_angle(beyond):
    """A ladder of 1 m and 1 kg slides if the tangent of its angle to the wall exceeds 2 μ."""
    mu = 0.4
    angle = math.atan(2.0 * mu) + beyond
    model = free_body(
        pin.Inertia(1.0, np.zeros(3), np.diag([1 / 12, 1 / 12, 1e-3])), [(0, 0, -0.5), (0, 0, 0.5)]
    )
    contacts = [Contact("tip0", Plane(), friction=mu), Contact("tip1", Plane(normal=(1.0, 0.0, 0.0)))]
    sine, cosine = math.sin(angle), math.cos(angle)
    q = np.array([0.5 * sine, 0.0, 0.5 * cosine, *pin.Quaternion(pin.utils.rotate("y", -angle)).coeffs()])
    trajectory = simulate(
        Scene(model, contacts), q, np.zeros(6), 0.01, rtol=1e-11, atol=1e-14, scheme="event-driven"
    )
    excess = G * (0.5 * sine - mu * cosine) / (1 / 3 - 0.5 * mu * sine * cosine)
    assert trajectory.v[-1, 4] == pytest.approx(-max(excess, 0.0) * 0.01, rel=1e-3, abs=1e-14)
    assert not trajectory.notes


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_plate_tips_when_load_leaves_its_support(friction):
    """With the load near an edge, forces of least norm unload one corner before the plate tips."""
    half, width, mass, side = 0.3, 0.2, 2.0, 0.5
    corners = [(x, y, 0.0) for x in (-half, half) for y in (-width, width)]
    plate = free_body(pin.Inertia(mass, np.array([0.0, 0.0, 0.02]), np.diag([0.03, 0.05, 0.08])), corners)

    def control(t, q, v):  # moves the centre of pressure to (t half, side width)
        return mass * G * np.array([0.0, 0.0, 0.0, -side * width, t * half, 0.0])

    def reaches(t, q, v):
        return t - 0.8

    contacts = [Contact(f"tip{k}", Plane(), friction=friction) for k in range(4)]
    scene = Scene(plate, contacts, control=control, events=[Event(reaches, lambda t, q, v: v)])
    trajectory = simulate(scene, [0, 0, 0, 0, 0, 0, 1], np.zeros(6), 1.05, rtol=1e-6)
    lifted = [m.end for m in trajectory.modes if m.end < 1.05]
    assert lifted == pytest.approx([1.0, 1.0], abs=1e-5)
    times = np.linspace(0.81, 0.99, 10)
    assert min(trajectory.forces(f"tip{k} on plane", times)[:, 2].min() for k in range(4)) > -1e-6


def test_limit_and_dry_friction_hold_joint_together():
    """The load determines the sum of both forces; the joint leaves when this exceeds its dry friction."""
    model = rough_joint(0.5)
    model.lowerPositionLimit, model.upperPositionLimit = np.array([0.0]), np.array([10.0])
    scene = Scene(model, control=lambda t, q, v: np.array([2.0 * t - 2.0]))
    trajectory = simulate(scene, [0.0], [0.0], 2.0)
    assert trajectory.notes == ()
    assert [m.end for m in trajectory.modes] == pytest.approx([1.25, 1.25], abs=1e-8)
    assert trajectory.q[-1, 0] == pytest.approx(0.75**3 / 3.0, abs=1e-8)
    np.testing.assert_allclose(trajectory.joint_forces([0.3, 1.2])[:, 0], [1.4, -0.4], atol=1e-12)


def test_slow_slip_continues_while_many_joints_come_to_rest():
    model = slider(1.0)
    for k in range(12):
        index = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"slide{k}")
        model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    unbounded(model)
    model.friction = np.array([0.0] * 3 + [1.0] * 12)
    mu, rest = 0.05, 0.1 + 1e-5
    v0 = np.array([mu * G * rest, 0.0, 0.0, *(0.1 + 1e-7 * np.arange(12))])
    scene = Scene(model, [Contact("point", Plane(), friction=mu)])
    trajectory = simulate(scene, np.zeros(model.nq), v0, 0.2)
    (slip,) = [m for m in trajectory.modes if m.mode == "slip"]
    assert slip.end == pytest.approx(rest, abs=1e-10)


@pytest.mark.parametrize("stop", [0.002, 0.003, 0.004, 0.005, 0.01])
def test_slip_that_reverses_twice_within_a_step_ends(stop):
    """Slip of velocity −k(t − t₁)(t − t₂) ends at t₁, and restarts when the acceleration changes sign."""
    friction, k, back = 0.2, 10.0, 2.0 * stop
    hold = friction * G

    def speed(t):
        return -k * (t - stop) * (t - back)

    def control(t, q, v):
        return np.array([-k * (2.0 * t - stop - back) - hold, 0.0, 0.0])

    scene = Scene(slider(1.0), [Contact("point", Plane(), friction=friction)], control=control)
    trajectory = simulate(scene, np.zeros(3), [speed(0.0), 0.0, 0.0], 2.0 * back, rtol=1e-6, atol=1e-8)
    assert trajectory.v[-1, 0] == pytest.approx(speed(2.0 * back) - speed(1.5 * stop), abs=1e-12)


@pytest.mark.parametrize("rtol", [1e-7, 1e-9])
def test_slip_with_tiny_reversal_has_ended(rtol):
    """Friction stops a pushed point mass just before the end of the run.

    A reversal would be far below the sticking speed, but above integration errors.
    """
    brake, speed, beyond = 0.01, 1e-3, 1e-6
    contact = Contact("point", Plane(), friction=0.3)
    scene = Scene(slider(), [contact], control=lambda t, q, v: [0.3 * G - brake, 0.0, 0.0])
    assert brake * beyond < 1e-4 * scene.rest
    end = speed / brake + beyond
    trajectory = simulate(scene, np.zeros(3), [speed, 0.0, 0.0], end, rtol=rtol, atol=1e-2 * rtol)
    assert abs(trajectory.v[-1, 0]) <= 1e-12
    assert trajectory.q[-1, 0] == pytest.approx(0.5 * speed**2 / brake, rel=1e-11)


@pytest.mark.parametrize("arm", [1e-7, 1e-6, 1e-5])
@pytest.mark.parametrize("torque", [-10.0, 10.0])
def test_contact_and_joint_with_nearly_dependent_rows_come_to_rest(arm, torque):
    """A disc rotates on a prismatic joint, its tip slightly below the axis; both are close to slip."""
    model, parent = pin.Model(), 0
    for name, joint in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), name)
    model.appendBodyToJoint(parent, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -arm]))
    model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction = np.array([10.0, 0.0, 0.0])
    floor = Contact("tip", Plane(), friction=0.5, restitution=0.0)
    scene = Scene(model, [floor], control=lambda t, q, v: [0.0, 0.0, torque], resting_speed=1e-4)
    for rtol in (1e-4, 1e-6):
        trajectory = simulate(
            scene, [0.0, arm, 0.0], [-0.3 * arm, 0.0, -0.3], 0.02, rtol=rtol, atol=1e-2 * rtol
        )
        # up to friction times the short lever arm
        assert trajectory.v[-1, 2] == pytest.approx(-0.3 + 0.02 * torque, abs=0.2 * arm)
        assert abs(trajectory.v[-1, 0]) <= 0.3 * arm
