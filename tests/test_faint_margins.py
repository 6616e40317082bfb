"""Motions with slip, loads or events near the tolerance: none may be missed, and none invented."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, InputError, Plane, Scene, simulate
from pinimpact.scene._kernels.contact_forces import STICK
from pinimpact.scene.integrator import Integrator
from pinimpact.scene.options import Options

from . import random_control, random_scenes
from .lawful import law_violation, unexplained_velocity_loss
from .scene_models import G, free_body, run, slider, unbounded

pytestmark = pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
"""Some impacts reach a bound of the solver, which does not affect these checks."""


@pytest.mark.parametrize("speed", [3e-7, 1e-5])
def test_frictionless_slider_never_stops(speed):
    """Below the sticking speed, too, a contact without friction keeps sliding at each selection of modes."""
    model = free_body(pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), [(0.0, 0.0, 0.0)])
    scene = Scene(model, [Contact("tip0", Plane(), friction=0.0)])
    q0 = pin.neutral(model)
    trajectory = run(scene, q0, [speed, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)
    assert trajectory.q[-1][0] == pytest.approx(speed, rel=1e-9)


def stretched_leg(bend):
    """Return a hanging leg with its foot on the floor and a slightly bent knee, and a finger of 10 g."""
    model = pin.Model()
    hip = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hip")
    rod = pin.Inertia(0.5, np.array([0.0, 0.0, -0.25]), 0.01 * np.eye(3))
    model.appendBodyToJoint(hip, rod, pin.SE3.Identity())
    knee = model.addJoint(hip, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])), "knee")
    model.appendBodyToJoint(knee, rod, pin.SE3.Identity())
    foot = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
    model.addFrame(pin.Frame("foot", knee, 0, foot, pin.FrameType.OP_FRAME))
    finger = model.addJoint(0, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])), "finger")
    model.appendBodyToJoint(finger, pin.Inertia(0.01, np.zeros(3), 1e-6 * np.eye(3)), pin.SE3.Identity())
    unbounded(model)
    model.lowerPositionLimit[2] = 0.0
    return model, np.array([-0.5 * bend, bend, 0.0])


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("bend", [1e-3, 1e-4, 2e-5, 1e-5])
def test_forces_of_nearly_stretched_leg_agree_with_statics(bend, tilt):
    """A motor stretches the knee and presses the foot down with 10⁵ N; the finger rests on its limit.

    Along the axes of the contact the small inertia that the foot feels is scaled to one; aslant it is not.
    """
    model, q = stretched_leg(bend)
    q[0] += tilt
    floor = Plane(point=(0.0, 0.0, -np.cos(0.5 * bend) * np.cos(tilt)))
    torque = np.array([0.0, -1.0, 0.0])
    scene = Scene(
        model, [Contact("foot", floor, friction=0.5)], control=lambda t, q, v: (1.0 + 0.1 * t) * torque
    )
    trajectory = simulate(scene, q, np.zeros(3), 0.1)
    assert np.abs(trajectory.v[-1]).max() < 1e-9
    assert trajectory.statistics["steps"] < 100
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId("foot")
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[[0, 2], :2]
    for t in (0.02, 0.07):
        load = pin.computeGeneralizedGravity(model, data, q) - (1.0 + 0.1 * t) * torque
        force = np.linalg.solve(jacobian.T, load[:2])
        assert force[1] > 0.5 / bend
        found = trajectory.forces("foot on plane", [t])[0]
        assert found[[0, 2]] == pytest.approx(force, rel=1e-4)


def test_force_margin_within_step_error_does_not_end_motion():
    """A foot begins to slip from rest; its direction is inaccurate in a long step, but not in a short one."""
    _, scene, q, v, rtol = random_scenes.draw(100000001001437)
    times = []

    def watch(t, _):
        times.append(t)
        assert len(times) < 3000

    trajectory = simulate(scene, q, v, 0.8, rtol=rtol, atol=1e-2 * rtol, progress=watch)
    assert trajectory.complete


SELDOM_LOST = [
    *((101000001000518, 0.375), (151000911, 0.885), (122000395, 0.954), (132000810, 0.589)),
    *((133000883, 0.683), (177000770, 0.91), (239000381, 0.953)),
]
"""Seeds and durations of motions of long tests."""


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize(
    ("seed", "duration"),
    [(101000001000931, 0.64), (111000026, 0.1525), (151000823, 0.43)]
    + [pytest.param(seed, duration, marks=pytest.mark.exhaustive) for seed, duration in SELDOM_LOST],
)
def test_slow_slip_above_step_error_is_kept(seed, duration):
    """Recorded cases: slip that has become slow, and slip that continues while other contacts begin to slip.

    Also slip beside a foot that separates; a slowly moving elbow; a joint limit that releases; joints whose
    modes do not settle; slower corners of the same sole; a corner that touches briefly; a jamming corner.
    """
    drawn = random_control.draw(seed)
    tolerances = {"rtol": drawn.rtol, "atol": 1e-2 * drawn.rtol}
    trajectory = simulate(drawn.scene, drawn.q, drawn.v, duration, **tolerances)
    assert unexplained_velocity_loss(drawn.scene, trajectory, drawn.rtol) == ""


@pytest.mark.exhaustive
def test_non_unique_forces_near_their_bounds_are_replaced():
    """The loads of two soles are not unique; soon the solution of least norm violates a friction cone."""
    drawn = random_control.draw(101000001001656)
    tolerances = {"rtol": drawn.rtol, "atol": 1e-2 * drawn.rtol}
    trajectory = simulate(drawn.scene, drawn.q, drawn.v, 1.0, **tolerances)
    assert not law_violation(drawn.scene, trajectory, drawn.rtol, 1)


@pytest.mark.exhaustive
def test_dry_friction_of_joint_moved_by_rounding_errors_only():
    """A tip sticks, and seven-digit angles of the URDF move the elbow by 10⁻⁷ rad/s.

    The elbow presses the tip onto the floor; with friction for upward motion the tip would slip.
    """
    drawn = random_control.draw(131000797)
    trajectory = simulate(drawn.scene, drawn.q, drawn.v, 1.0, rtol=drawn.rtol, atol=1e-2 * drawn.rtol)
    assert law_violation(drawn.scene, trajectory, drawn.rtol, 1) == ""
    finer = simulate(drawn.scene, drawn.q, drawn.v, 1.0, rtol=1e-10, atol=1e-12)
    assert trajectory.q[-1] == pytest.approx(finer.q[-1], abs=10 * drawn.rtol)


SPEED = 0.1
DRY = 2.0


def carriage_along_a_rod(lean, friction, aside=0.0):
    """Return a scene and start of a carriage on rails x, y, z and a rod through it with its tip on the floor.

    The tip is displaced by `lean`. Rail x has dry friction. A motor along the rod reverses after 0.5 s.
    """
    model, parent = pin.Model(), 0
    along = pin.JointModelPrismaticUnaligned(np.array([np.sin(lean), np.cos(lean), 0.0]))
    for name, joint, mass in (
        ("x", pin.JointModelPX(), 0.0),
        ("y", pin.JointModelPY(), 0.0),
        ("z", pin.JointModelPZ(), 1.0),
        ("rod", along, 0.1),
    ):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(parent, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction = np.array([DRY, 0.0, 0.0, 0.0])
    motor = np.array([0.0, 0.0, 0.0, 2.0 * SPEED])
    scene = Scene(model, [Contact("tip", Plane(), friction=friction)], control=lambda t, q, v: motor)
    return scene, np.array([SPEED * np.sin(lean) + aside, SPEED * np.cos(lean), 0.0, -SPEED])


def test_dry_friction_of_joint_dragged_by_sticking_tip():
    """The rod leans by 10⁻⁷; its tip moves rail x against friction until the carriage reverses."""
    lean = 1e-7
    scene, v = carriage_along_a_rod(lean, 0.5)
    trajectory = simulate(scene, np.zeros(4), v, 1.0, rtol=1e-8, atol=1e-10)
    times = np.array([0.0, 0.2, 0.45, 0.55, 0.8])
    turns = SPEED / (2.0 * SPEED + DRY * lean)
    rate = 2.0 * SPEED - DRY * lean * np.sign(times - turns)
    assert trajectory.sample(times)[1][:, 3] == pytest.approx(rate * (times - turns), abs=1e-9)
    aside = trajectory.forces_world("tip on plane", times)[:, 0]
    assert aside == pytest.approx(-DRY * np.sign(times - turns), abs=1e-6)


@pytest.mark.parametrize("lean", [1e-4, 1e-5, 1e-6])
def test_friction_of_tip_dragged_by_joint_at_rest(lean):
    """The tip cannot move rail x, and slips sideways by `lean` times the rod's motion until it reverses."""
    scene, v = carriage_along_a_rod(lean, 0.15, aside=0.01)
    trajectory = simulate(scene, np.zeros(4), v, 1.0, rtol=1e-8, atol=1e-10)
    times = np.array([0.1, 0.2, 0.45, 0.55, 0.8])
    # friction along x: the bound without the part that balances the motor
    left = np.sqrt((0.15 * 1.1 * G) ** 2 - (2.0 * SPEED) ** 2)
    aside = trajectory.forces_world("tip on plane", times)[:, 0]
    assert aside == pytest.approx(left * np.sign(0.5 - times), rel=1e-3 * lean / 1e-4)


def test_modes_of_very_slow_tip_and_joint_at_rest_settle():
    scene, v = carriage_along_a_rod(1e-7, 0.15, aside=0.01)
    assert simulate(scene, np.zeros(4), v, 1.0, rtol=1e-8, atol=1e-10).complete


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize(
    ("seed", "duration"),
    [
        # a held joint beside a slipping foot: it could stay held, or move with a growing force
        (162000955, 0.47),
        # slip could begin, but would not continue in its initial direction
        (184000256, 0.5),
        # two corners slip near where forces cease to exist, a thousand times the loads
        pytest.param(187000590, 0.993, marks=pytest.mark.exhaustive),
        # sliding corners that jam until one of them, which approaches, has come to rest
        pytest.param(192000238, 0.892, marks=pytest.mark.exhaustive),
        # a corner about to jam, and a joint that seems to reverse in steps beyond that instant
        pytest.param(204000405, 0.9187, marks=pytest.mark.exhaustive),
        # a tip at incipient slip and a joint at rest: rounding lets only one have zero velocity
        (188000342, 0.56),
        # one to three joints at incipient slip beside a tip with nearly the same rows
        (228000205, 0.38),
        (224000380, 0.47),
        (217000296, 0.44),
        # a joint held until another turns; if that one rests, it moves in the other direction
        (232000015, 0.485),
        (235000952, 0.765),
        # joints that only rounding moves
        (235000084, 0.955),
        # a foot's corner that jams at a velocity below the tolerance
        pytest.param(216000018, 0.503, marks=pytest.mark.exhaustive),
    ],
)
def test_nearly_equal_modes_are_not_selected_repeatedly(seed, duration):
    drawn = random_control.draw(seed)
    times = []

    def watch(t, _):
        times.append(t)
        assert len(times) < 6000

    trajectory = simulate(
        drawn.scene, drawn.q, drawn.v, duration, rtol=drawn.rtol, atol=1e-2 * drawn.rtol, progress=watch
    )
    assert trajectory.complete
    assert law_violation(drawn.scene, trajectory, drawn.rtol, 1) == ""


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
def test_slip_that_begins_as_joint_limit_releases_continues():
    """The last admissible load distribution has two bounds: a limit releases as a contact begins to slip.

    Time steps cross this event, at which the unloaded limit would leave and enter the active set repeatedly.
    """
    _, scene, q, v, rtol = random_scenes.draw(201000584)
    trajectory = simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol)
    x, y, normal = trajectory.forces("panda_link6 on plane", np.linspace(0.7785, 0.78, 50)).T
    assert (np.hypot(x, y) <= (1.0 + 1e-6) * 0.4 * normal).all()


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("seed", [205000540, 227000657])
def test_step_across_singularity_of_forces_is_rejected(seed):
    """A foot slides while the slip of another changes direction: in a long step both would seem to jam."""
    _, scene, q, v, rtol = random_scenes.draw(seed)
    trajectory = simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol)
    assert random_control.violation_in(trajectory, rtol) == ""


def test_unloaded_contact_does_not_hold():
    """Dry friction of the other joints supports the arm; the first joint begins to move with the tip."""
    drawn = random_control.draw(176000622)
    trajectory = simulate(drawn.scene, drawn.q, drawn.v, 0.91, rtol=drawn.rtol, atol=1e-2 * drawn.rtol)
    assert law_violation(drawn.scene, trajectory, drawn.rtol, 1) == ""


ON_A_CORNER = """
0.051030458432607034 0.0027786600730432282 0.9416270013066014 -0.0055847311518376725 -0.1183241695083063
0.014179200043318348 0.9928580724223695 -0.047725579089455045 -0.011367994084233066 -0.31808346312226465
1.1394804972898898 -0.584684914556696 -0.0007861237680982408 0.03678541591285784 0.045385405222532156
-0.31079382310207065 1.1386584189097635 -0.5908281412951742 -0.036117160715664065 -0.01488970809409922
-0.05196619961329165 0.2571099387654329 0.13701712791543913 -0.031127140877716845 -0.5074559501508041
0.010033100550841672 -0.0006224734351350492 0.12497379288709239 -6.18530806804599e-16
-0.29865238714717535 -0.12520053809908266 -0.0407502734253794 -0.6110489923303465 0.04484080958589341
0.04529841519094332 0.11524852480759057 -0.012764213313947496 -0.03074443914532945 -0.07121153930635814
"""
TURNING = """
-0.3992054799458161 0.02668907881613954 0.05642294587818054 -0.03194643266174307 -0.4808655373581894
-0.009391715144122117 -7.246108810335677e-29 -4.9665874025773896e-29 -0.0023535947808114364
0.055817573695074174 0.4282271915616919 0.005232275740924509 -6.401706171108954e-14
1.2086445364324835e-29 1.441941939079212e-29 0.045233719633261844 0.4340775088825513 0.0511264723644171
3.448379950702062e-29 0.09943693898204173 0.010808818728659549 0.005106836998984675
-2.0737246166461274e-30 5.0416765029072365e-30 5.7657291250394795e-31 -1.057926711848315e-29
-6.610283150518517e-30 -4.6676352720548343e-29 1.0798245580032332e-29 -1.549908968294704e-29
-2.2436093914794564e-29 -8.272034808360399e-30 0.0001726533536401412 4.299437791288634e-30
1.478258603675187e-29 3.89621212005054e-29 6.67787565096329e-31 -1.2819238768512713e-30
"""
"""Configuration and velocity of seed 10000103 when a sole begins to rotate about a corner."""


def test_non_unique_incipient_slip_does_not_move_held_joint():
    """Some load distributions would let a corner slip sideways and move a joint that others hold."""
    drawn = random_control.draw(10000103)
    q, v = (np.array([float(x) for x in text.split()]) for text in (ON_A_CORNER, TURNING))
    times = []

    def watch(t, _):
        times.append(t)
        assert len(times) < 100

    trajectory = simulate(drawn.scene, q, v, 1e-3, rtol=drawn.rtol, atol=1e-2 * drawn.rtol, progress=watch)
    assert trajectory.complete
    assert law_violation(drawn.scene, trajectory, drawn.rtol, 1) == ""


def test_stretched_leg_with_velocity_error_in_an_impact():
    """An arm on the shank of a leg hits its joint limit, while the foot of the leg sticks on a slope.

    The foot cannot move along the stretched leg, so no impulse removes its velocity error of 5·10⁻¹⁰ m/s.
    Compare with the leg with two bilateral rows: friction across the leg, and the limit.
    """
    model, bend = pin.Model(), 1e-9
    end = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
    hip = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hip")
    knee = model.addJoint(hip, pin.JointModelRY(), end, "knee")
    arm = model.addJoint(knee, pin.JointModelRY(), pin.SE3.Identity(), "arm")
    for joint, centre in ((hip, -0.25), (knee, -0.25), (arm, 0.2)):
        rod = pin.Inertia(0.5, np.array([0.0, 0.0, centre]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    model.addFrame(pin.Frame("foot", knee, 0, end, pin.FrameType.OP_FRAME))
    unbounded(model)
    model.lowerPositionLimit[arm - 1] = 0.0
    slope = Plane(point=(0.0, 0.0, -1.0), normal=(-np.sin(0.3), 0.0, np.cos(0.3)))
    scene = Scene(model, [Contact("foot", slope, friction=0.8)])
    q, v = np.array([-0.5 * bend, bend, 0.0]), np.array([1.0, -2.0, -1e-5])

    integrator = Integrator(scene, q, v, Options(1e-6, 1e-8))
    integrator.work.modes[0], integrator.work.certain_speed = STICK, 1e-6
    foot, stop = 0, 1
    after = integrator.instant.impacts.resolve_group(q, v, stop, [foot, stop]).v

    data = model.createData()
    jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("foot"), pin.LOCAL_WORLD_ALIGNED)
    assert -1e-9 < jacobian[2] @ v < 0.0
    rows = np.array([jacobian[0], [0.0, 0.0, 1.0]])
    mass = np.triu(pin.crba(model, data, q))
    response = np.linalg.solve(mass + np.triu(mass, 1).T, rows.T)
    expected = v - response @ np.linalg.solve(rows @ response, rows @ v)
    assert np.abs(expected - v).max() > 4e-6
    assert after == pytest.approx(expected, abs=1e-8)


def points(masses, kinds):
    """Return point masses, each on sliding joints of the given kinds, with the frames ``point0`` …"""
    model = pin.Model()
    for k, mass in enumerate(masses):
        joint = 0
        for kind in kinds:
            joint = model.addJoint(joint, kind(), pin.SE3.Identity(), f"{k}{kind.__name__[-1]}")
        inertia = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"point{k}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


@pytest.mark.parametrize("mass", [10.0, 1e5, 1e8, 1e10])
def test_body_leaves_platform_of_any_mass_where_it_is_no_longer_pressed(mass):
    """A platform at z = A sin ωt carries 1 kg, which leaves it where Aω² sin ωt = g, and then flies."""
    amplitude, pace = 0.02, 30.0
    model = points([mass, 1.0], [pin.JointModelPZ])
    contact = Contact("point1", Plane(body="point0"), name="load")

    def drive(t, q, v):
        pressed = q[1] - q[0] <= 1e-9
        acceleration = -amplitude * pace**2 * math.sin(pace * t)
        return np.array([mass * (G + acceleration) + pressed * max(G + acceleration, 0.0), 0.0])

    leaves = math.asin(G / (amplitude * pace**2)) / pace
    speed, later = amplitude * pace, leaves + 0.05
    trajectory = simulate(Scene(model, [contact], control=drive), [0.0, 0.0], [speed, speed], later)
    (interval,) = trajectory.modes
    assert interval.end == pytest.approx(leaves, abs=1e-7)
    height = amplitude * math.sin(pace * leaves) + speed * math.cos(pace * leaves) * 0.05 - 0.5 * G * 0.05**2
    assert trajectory.q[-1, 1] == pytest.approx(height, abs=1e-8)


@pytest.mark.parametrize("force", [1.0, 1e-3, 1e-6, 1e-9])
def test_without_gravity_a_body_leaves_a_wall_at_any_force(force):
    """The force F (0.2, −cos t) on 1 kg: it slips from cos t = 0.4 on, and leaves the wall at t = π/2."""
    model = slider()
    model.gravity.linear = np.zeros(3)
    scene = Scene(
        model,
        [Contact("point", Plane(), friction=0.5)],
        control=lambda t, q, v: force * np.array([0.2, 0.0, -math.cos(t)]),
    )
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 2.5, rtol=1e-11, atol=1e-11 * force)
    stick, slip = trajectory.modes
    # a part of 10⁻⁴ m/s² · 10⁻⁹ is taken as zero
    assert (stick.mode, slip.mode) == ("stick", "slip")
    assert stick.end == pytest.approx(math.acos(0.4), abs=1e-9 + 3e-13 / force)
    assert slip.end == pytest.approx(0.5 * math.pi, abs=1e-9 + 3e-13 / force)
    rise = math.cos(2.5) + 2.5 - 0.5 * math.pi
    assert trajectory.q[-1, 2] == pytest.approx(force * rise, rel=1e-6)


def test_without_gravity_a_pressed_box_does_not_seem_to_gain_energy():
    """Rounding errors of the forces on four corners do work on those of the velocities."""
    corners = [(x, y, -0.05) for x in (-0.05, 0.05) for y in (-0.05, 0.05)]
    model = free_body(pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.1), corners)
    model.gravity.linear = np.zeros(3)
    contacts = [Contact(f"tip{k}", Plane(), friction=0.3) for k in range(4)]
    scene = Scene(
        model, contacts, control=lambda t, q, v: np.array([0.0, 0.0, -2.0 * math.cos(3.0 * t), 0, 0, 0])
    )
    q = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0])
    trajectory = simulate(scene, q, np.zeros(6), 1.0, scheme="event-driven")
    leaves = math.pi / 6.0
    assert [interval.end for interval in trajectory.modes] == [pytest.approx(leaves, abs=1e-9)] * 4
    rise = 2.0 / 9.0 * math.cos(3.0) + 2.0 / 3.0 * (1.0 - leaves)
    assert trajectory.q[-1, 2] - 0.05 == pytest.approx(rise, abs=1e-9)


@pytest.mark.parametrize("mass", [1e6, 1e9])
@pytest.mark.parametrize("swing", [1.02, 1.0002])
def test_short_flights_do_not_depend_on_a_heavy_body_elsewhere(swing, mass):
    """1 kg on the floor is pushed up by swing · m g sin ωt; 1 kg and a heavy body beside it do not matter."""

    def motion(masses):
        model = points(masses, [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ])
        contacts = [Contact(f"point{k}", Plane(), friction=0.3) for k in range(len(masses))]
        push = np.zeros(model.nv)

        def control(t, q, v):
            push[[0, 2]] = 2.5, swing * G * math.sin(50.0 * t)
            return push

        trajectory = simulate(Scene(model, contacts, control=control), 0.0 * push, 0.0 * push, 0.5)
        changes = [(i.start, i.end) for i in trajectory.modes if i.source == "point0 on plane"]
        return trajectory.q[-1, 0], np.array(changes)

    alone, changes = motion([1.0])
    beside, others = motion([1.0, mass])
    assert len(changes) > 10
    assert others == pytest.approx(changes, abs=1e-6)
    assert beside == pytest.approx(alone, abs=1e-9)


@pytest.mark.parametrize("kind", [pin.JointModelRZ, pin.JointModelPX])
@pytest.mark.parametrize("far", [1e6, 1e9, 1e15])
def test_bounces_do_not_depend_on_the_coordinate_of_a_body_without_contact(kind, far):
    """A shaft turned by `far` radians, and a body at `far` metres, do not round the gaps of others."""
    model = points([1.0], [pin.JointModelPZ])
    other = model.addJoint(0, kind(), pin.SE3.Identity(), "other")
    model.appendBodyToJoint(other, pin.Inertia.FromSphere(1.0, 1.0), pin.SE3.Identity())
    unbounded(model)
    scene = Scene(model, [Contact("point0", Plane(), restitution=0.9, name="ball")])
    trajectory = simulate(scene, [0.1, far], [0.0, 0.0], 3.0, scheme="event-driven")
    fall, e = math.sqrt(0.2 / G), 0.9
    times = [fall + 2.0 * fall * e * (1.0 - e**k) / (1.0 - e) for k in range(len(trajectory.impacts))]
    assert [impact.time for impact in trajectory.impacts] == pytest.approx(times, abs=1e-9)
    assert trajectory.q[-1, 0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_moving_held_contact_raises_beside_a_fast_shaft(scheme):
    model = points([1.0], [pin.JointModelPX, pin.JointModelPZ])
    shaft = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "shaft")
    model.appendBodyToJoint(shaft, pin.Inertia.FromSphere(1.0, 1.0), pin.SE3.Identity())
    unbounded(model)
    scene = Scene(model, held=[Contact("point0", Plane(), name="clamp")])
    with pytest.raises(InputError, match=r"'clamp' moves at 0\.5 m/s"):
        simulate(scene, np.zeros(3), [0.5, 0.0, 1e6], 0.1, scheme=scheme)


def test_forces_at_rest_do_not_depend_on_rounding_errors():
    """A foot whose joints have dry friction may bear a load or none: the same at all times at rest. (11.3)"""
    drawn = random_control.draw(82000000000099)
    trajectory = simulate(drawn.scene, drawn.q, drawn.v, 0.8, rtol=drawn.rtol, atol=1e-2 * drawn.rtol)
    forces = trajectory.forces("FR_FOOT on plane", np.linspace(0.79, 0.8, 200))
    assert np.abs(trajectory.v[trajectory.t > 0.79]).max() < 1e-9
    assert np.abs(forces - forces[0]).max() < 1e-6
    assert (np.linalg.norm(forces[:, :2], axis=1) <= 0.8 * forces[:, 2]).all()
