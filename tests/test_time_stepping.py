"""Time stepping: against closed forms, the event-driven scheme, and domino waves of another program."""

from __future__ import annotations

import itertools
import math

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import root

import pinimpact
from pinimpact import Contact, Event, JointPD, Plane, Scene, Shape, load_robot, simulate, solve_impact
from pinimpact._numeric.augmented_newton import Law, VelocityProblem
from pinimpact._numeric.tolerances import SOFTEST
from pinimpact.geometry._kernels.box_patch import box_patch
from pinimpact.geometry.convex_shape import box, capsule, sphere
from pinimpact.geometry.patch import patch
from pinimpact.scene._kernels.step_impulses import step_impulses

from .drawing import one_of_each
from .random_scenes import relative_energy_residual
from .scene_models import UP, G, ball, box_on, free_body, hull_mesh, pendulum, slider, unbounded

FLOOR = Plane()


def step(scene, q0, v0, duration, dt, **options):
    return simulate(scene, q0, v0, duration, scheme="time-stepping", dt=dt, **options)


def boxes(count, size, mass, floor=0.5, between=0.5, restitution=0.0, solid=None):
    """Return a scene of free boxes with contacts at the floor and between successive boxes.

    `mass` is one number, or one of each box; `solid` replaces the box by another geometry of the same shape.
    """
    model, shapes = pin.Model(), pin.GeometryModel()
    for k, own in enumerate(np.broadcast_to(mass, count).tolist()):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box_{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(own, *size), pin.SE3.Identity())
        model.addJointFrame(joint)
        shape = solid or coal.Box(*size)
        shapes.addGeometryObject(pin.GeometryObject(f"box_{k}_0", joint, pin.SE3.Identity(), shape))
    unbounded(model)
    contacts = [
        Contact(
            geometry=f"box_{k}_0", plane=FLOOR, friction=floor, restitution=restitution, name=f"floor {k}"
        )
        for k in range(count)
    ]
    contacts += [
        Contact(
            geometry=f"box_{k + 1}_0",
            plane=Shape(f"box_{k}_0"),
            friction=between,
            restitution=restitution,
            name=f"pair {k}",
        )
        for k in range(count - 1)
    ]
    return Scene(pin.RobotWrapper(model, shapes, shapes), contacts)


def test_impact_times_and_speeds_of_a_bouncing_ball():
    e, height = 0.5, 1.0
    scene = Scene(ball(), [Contact("center", FLOOR, radius=0.1, restitution=e)])
    trajectory = step(scene, [0, 0, 0.1 + height, *UP], np.zeros(6), 2.0, 1e-2)
    time, speed = math.sqrt(2 * height / G), math.sqrt(2 * G * height)
    for impact in trajectory.impacts[:3]:
        assert impact.time == pytest.approx(time, abs=1e-9)
        assert impact.v_after[2] == pytest.approx(e * speed, rel=1e-9)
        speed *= e
        time += 2 * speed / G
    assert trajectory.q[-1, 2] == pytest.approx(0.1, abs=1e-9)
    assert trajectory.mode_at(trajectory.sources[0], 1.9) == "stick" or trajectory.forces(
        trajectory.sources[0], 1.9
    )[2] == pytest.approx(2.0 * G, rel=1e-9)


@pytest.mark.parametrize("corners", [3, 4, 8])
def test_box_slides_to_rest_after_stopping_distance(corners):
    mu, speed = 0.5, 1.0
    model, contacts = box_on(corners, mu=mu)
    scene, q0 = Scene(model, contacts), [0, 0, 0.1, *UP]
    errors = []
    for dt in (4e-3, 2e-3):
        trajectory = step(scene, q0, [speed, 0, 0, 0, 0, 0], 0.4, dt)
        moved = np.linalg.norm(trajectory.q[-1, :2] - np.asarray(q0)[:2])
        errors.append(abs(moved - speed**2 / (2 * mu * G)))
        assert np.abs(trajectory.v[-1]).max() < 1e-9
        assert trajectory.energy.friction[-1] == pytest.approx(-trajectory.energy.kinetic[0], rel=1e-6)
    assert errors[0] < 0.5 * speed * 4e-3
    assert errors[1] < 0.5 * speed * 2e-3


def test_free_flight_is_of_second_order():
    scene = boxes(1, (0.1, 0.2, 0.3), 1.0)
    q0, v0 = [0, 0, 5, *UP], [0.5, -0.3, 0.2, 3.0, 2.0, 1.0]
    exact = simulate(scene, q0, v0, 0.2, rtol=1e-11, atol=1e-13)
    errors = [np.abs(step(scene, q0, v0, 0.2, dt).q[-1] - exact.q[-1]).max() for dt in (4e-3, 2e-3)]
    assert errors[1] < 1e-4
    assert 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.parametrize("dt", [0.2, 1e12])
def test_duration_shorter_than_dt_takes_one_step(dt):
    motion = step(Scene(ball()), [0, 0, 1.0, *UP], np.zeros(6), 0.1, dt)
    assert motion.t.tolist() == [0.0, 0.1]
    assert motion.q[-1, 2] == pytest.approx(1.0 - 0.5 * G * 0.1**2, rel=1e-12)


def test_driven_damped_joint_agrees_with_event_driven_scheme():
    model = pendulum()
    model.damping = np.array([0.2])
    scene = Scene(model, control=JointPD(kp=200.0, kd=5.0, q_ref=[1.0], limits=15.0))
    exact = simulate(scene, [0.0], [2.0], 0.5, rtol=1e-10, atol=1e-12)
    errors = []
    for dt in (2e-3, 1e-3):
        trajectory = step(scene, [0.0], [2.0], 0.5, dt)
        errors.append(np.abs(trajectory.q[-1] - exact.q[-1]).max())
        assert abs(trajectory.energy.residual[-1]) < 2.0 * dt  # the drive exchanges 20 J
    assert errors[1] < 1e-3
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize(("damping", "load"), one_of_each([500.0, 5000.0, 50000.0], [0.0, 3.0]))
def test_stiff_damping_by_a_function_is_stable(damping, load):
    """Steps of 1 ms are unstable above 2000 N s/m, beside a second mass that is not damped."""
    model, joint = pin.Model(), 0
    for k in range(2):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"mass {k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    unbounded(model)
    gains = np.array([damping, 0.0])
    scene = Scene(model, control=lambda t, q, v: load - gains * v)
    run = simulate(scene, [0.0, 0.0], [1.0, 1.0], 0.2, scheme="time-stepping", dt=1e-3)
    slow = load / damping
    way = slow * 0.2 + (1.0 - slow) * -np.expm1(-damping * 0.2) / damping
    assert run.q[-1] == pytest.approx([way, 0.2 + 0.02 * load], abs=2.5e-4)
    assert run.v[-1] == pytest.approx([slow, 1.0 + 0.2 * load], abs=1e-3)


@pytest.mark.parametrize("light", [0, 1])
def test_stiff_damping_of_joints_does_not_alternate(light):
    """If the link between two coaxial joints is light, only their difference is stiff. (theory.md, 16.1)"""
    model, joint, inertia = pin.Model(), 0, 1e-6
    model.gravity = pin.Motion.Zero()
    for k in range(2):
        joint = model.addJoint(joint, pin.JointModelRX(), pin.SE3.Identity(), f"joint {k}")
        own = (inertia if k == light else 1.0) * np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), own), pin.SE3.Identity())
    unbounded(model)
    model.damping = np.full(2, 0.1)
    v0 = np.array([300.0, -299.0] if light == 0 else [0.0, 300.0])
    run = step(Scene(model), np.zeros(2), v0, 0.1, 1e-3)
    # a light first link gives half of its momentum to the second one, which both dampers slow in series
    slow = np.exp(-0.05 * 0.1) * (1.0 + 0.5 * 300.0 * inertia) if light == 0 else 300.0 * inertia
    assert run.v[-1].sum() == pytest.approx(slow, abs=1e-5)
    relative = run.v[:, 0] - run.v[:, 1] if light == 0 else run.v[:, 1]
    assert (np.diff(np.abs(relative[:5])) < 0.0).all()
    assert np.abs(relative[5:]).max() < 1e-4
    assert relative_energy_residual(run) < 1e-9


@pytest.mark.parametrize("damping", [0.0, 1e-2])
@pytest.mark.parametrize("tilt_rate", [1.0, 10.0])
@pytest.mark.parametrize("rate", [300.0, 3000.0])
def test_steps_through_a_singular_gimbal_add_no_energy(rate, tilt_rate, damping):
    """Axes 1 and 3 are aligned at first, where only the light rings turn; soon the heavy rotor turns too."""
    model, joint = pin.Model(), 0
    model.gravity = pin.Motion.Zero()
    axes = pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRZ()
    for k, (axis, inertia) in enumerate(zip(axes, (1e-8, 1e-8, 1e-2), strict=True)):
        joint = model.addJoint(joint, axis, pin.SE3.Identity(), f"axis {k}")
        own = pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3))
        model.appendBodyToJoint(joint, own, pin.SE3.Identity())
    unbounded(model)
    model.damping = np.full(3, damping)
    run = step(Scene(model), np.zeros(3), np.array([rate, tilt_rate, -rate]), 0.02, 1e-3)
    assert run.energy.kinetic.max() < 1.02 * run.energy.kinetic[0]
    assert np.diff(run.energy.joints).max() < 0.01 * run.energy.kinetic[0]


def test_control_that_jumps_is_not_taken_for_stiff_damping():
    """Halving its steps would not change it; v alternates about zero after 0.1 s."""
    model, calls = slider(), []

    def brake(t, q, v):
        calls.append(t)
        return np.array([-10.0 * np.sign(v[0]), 0.0, G])

    scene = Scene(model, control=brake)
    run = simulate(scene, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.2, scheme="time-stepping", dt=1e-3)
    assert run.q[-1] == pytest.approx([0.05, 0.0, 0.0], abs=2e-3)
    assert len(calls) < 200 * 12


def test_dry_friction_holds_joint_up_to_its_bound():
    for torque, holds in ((0.9, True), (1.1, False)):
        model = pendulum()
        model.gravity = pin.Motion.Zero()
        model.friction = np.array([1.0])
        scene = Scene(model, control=lambda t, q, v, torque=torque: np.array([torque]))
        trajectory = step(scene, [0.0], [0.0], 0.5, 1e-3)
        moved = 0.0 if holds else 0.5 * (torque - 1.0) * 0.5**2
        assert trajectory.q[-1, 0] == pytest.approx(moved, abs=1e-6)


def test_joint_rebounds_from_limit_with_restitution():
    model = slider()
    model.gravity = pin.Motion.Zero()
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = 0.0, 10.0
    scene = Scene(model, limit_restitution=0.5)
    q0, v0 = np.zeros(model.nq), np.zeros(model.nv)
    q0[0], v0[0] = 0.1, -1.0
    trajectory = step(scene, q0, v0, 0.3, 7e-3)
    assert len(trajectory.impacts) == 1
    assert trajectory.impacts[0].time == pytest.approx(0.1, abs=1e-12)
    assert trajectory.q[-1, 0] == pytest.approx(0.5 * 0.2, abs=1e-9)


@pytest.mark.parametrize("gravity", [0.0, 10.0])
@pytest.mark.parametrize("apart", [0.001, 0.005, 0.007, 0.05])
def test_impact_at_the_end_of_a_step_rebounds(gravity, apart):
    """The gap closes after a whole number of steps, up to rounding."""
    model = slider()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    fall = 0.5 * gravity * apart**2  # fall until impact, which is after `apart` seconds at 1 m/s
    scene = Scene(model, [Contact("point", Plane(), restitution=0.5)])
    trajectory = step(scene, [0.0, 0.0, apart + fall], [0.0, 0.0, -1.0], apart + 2e-3, 1e-3)
    speed = 1.0 + gravity * apart
    (hit,) = trajectory.impacts
    assert hit.time == pytest.approx(apart, abs=1e-8)
    assert trajectory.v[-1, 2] == pytest.approx(0.5 * speed - gravity * 2e-3, abs=1e-7)


def linkage(lengths):
    """Return a closed linkage (a chain of rods, and a crank of 1 m at x = 2 m) and its held contact.

    The frame "knee" is at the end of the second rod.
    """
    model, joint, place = pin.Model(), 0, 0.0
    for k, length in enumerate((*lengths, 1.0)):
        joint, place = (joint, place) if k < len(lengths) else (0, 2.0)
        at = pin.SE3(np.eye(3), np.array([place, 0.0, 0.0]))
        joint, place = model.addJoint(joint, pin.JointModelRY(), at, f"j{k}"), length
        rod = pin.Inertia(length, np.array([length / 2, 0, 0]), length**3 / 12 * np.diag([1e-3, 1.0, 1.0]))
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    last = len(lengths)
    for name, k, length in (("knee", 2, lengths[1]), ("end", last, lengths[-1]), ("pin", last + 1, 1.0)):
        at = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, k, 0, at, pin.FrameType.OP_FRAME))
    unbounded(model)
    return model, Contact("end", Plane(body="pin"), name="loop")


@pytest.mark.parametrize("by_limit", [False, True])
def test_closed_loop_stays_closed_when_penetration_is_corrected(by_limit):
    model, loop = linkage([1.0, 2.0])  # a parallelogram
    along, stop = np.array([1.0, -1.0, 1.0]), np.arcsin(0.9)
    contacts = [] if by_limit else [Contact("knee", Plane((0.0, 0.0, -0.9)))]
    if by_limit:
        model.upperPositionLimit[2] = stop
    trajectory = step(Scene(model, contacts, held=[loop]), 0.4 * along, 1.5 * along, 0.6, 1e-3)
    assert trajectory.q[-1] == pytest.approx(stop * along, abs=1e-8)
    assert not trajectory.v[-1].any()


@pytest.mark.parametrize("end", [0.1, 0.101])
def test_derivative_of_closed_loop_when_penetration_is_corrected(end):
    """A five-bar linkage, after the step in which its knee hits the plane and after the next one."""
    model, loop = linkage([1.0, 1.3, 1.3])
    turn = np.arccos(1.0 / 1.3)
    q0 = np.array([0.4, turn - 0.4, -2.0 * turn, 0.4])
    rows = pinimpact.contact_matrices(model, model.createData(), q0, loop).jacobian
    along, v0 = np.array([[0.3, 0.7, -0.5, 0.4], [1.5, -1.0, 0.5, 1.0]]) @ (
        np.eye(4) - np.linalg.pinv(rows, rcond=1e-9) @ rows
    )
    scene = Scene(model, [Contact("knee", Plane((0.0, 0.0, -1.35)))], held=[loop])
    run = simulate(scene, q0, v0, end, scheme="time-stepping", sensitivities=("state",))
    (first, second) = (step(scene, q0, v0 + h * along, end, 1e-3) for h in (1e-5, -1e-5))
    slope = np.append(first.q[-1] - second.q[-1], first.v[-1] - second.v[-1]) / 2e-5
    found = run.sensitivity(end).state[:, 4:] @ along
    assert found[:4] == pytest.approx(slope[:4], abs=1e-9)
    assert found[4:] == pytest.approx(slope[4:], abs=1e-6)


def test_derivative_ignores_contact_whose_impulse_is_rounding_error():
    """A weight on a crank lifts the coupler after its impact, while the held contact is loaded."""
    model, loop = linkage([1.0, 2.0])
    bob = model.addJoint(3, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.2])), "bob")
    weight = pin.Inertia(3.0, np.array([0.1, 0.0, 0.4]), 0.1 * np.eye(3))
    model.appendBodyToJoint(bob, weight, pin.SE3.Identity())
    unbounded(model)
    q0, v0, along = np.array([[0.4, -0.4, 0.4, 0.0], [1.5, -1.5, 1.5, 0.0], [1.0, -1.0, 1.0, 0.3]])
    scene = Scene(model, [Contact("knee", Plane((0.0, 0.0, -0.9)))], held=[loop])
    run = simulate(scene, q0, v0, 0.277, scheme="time-stepping", sensitivities=("state",))
    (first, second) = (step(scene, q0, v0 + h * along, 0.277, 1e-3).v[-1] for h in (1e-5, -1e-5))
    assert run.mode_at("knee on plane", 0.2765) == "free"
    found = run.sensitivity(0.277).state[4:, 4:] @ along
    assert found == pytest.approx((first - second) / 2e-5, abs=1e-5)


@pytest.mark.parametrize("apart", [1e-9, 1e-6, 5e-5])
@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_small_gap_at_start_of_step_rebounds(apart, dt):
    """Gaps are extrapolated from the midpoint of the step, so this gap appears closed at its start."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        joint, pin.Inertia(1.0, np.array([0.5, 0, 0]), 0.01 * np.eye(3)), pin.SE3.Identity()
    )
    tip = pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    unbounded(model)
    scene = Scene(model, [Contact("tip", Plane((0, 0, -0.3)), restitution=0.5)])
    trajectory = step(scene, [np.arcsin(0.5 - apart / 0.6)], [4.0], 1e-2, dt)
    reference = pinimpact.simulate(scene, [np.arcsin(0.5 - apart / 0.6)], [4.0], 1e-2)
    assert len(trajectory.impacts) == 1
    assert trajectory.v[-1] == pytest.approx(reference.v[-1], abs=1e-3)


@pytest.mark.parametrize("height", [0.12, 0.123, 0.126])
def test_tip_of_fast_spinning_body_rebounds_elastically(height):
    """The tip moves along a circle, 3.4° per step: a straight path from the midpoint would be too short."""
    inertia = pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
    model = free_body(inertia, [(0.1, 0.0, 0.0)])
    model.gravity.linear[:] = 0.0
    scene = Scene(model, Contact("tip0", FLOOR, friction=0.0, restitution=1.0))
    q, v = [0, 0, height, 0, 0, 0, 1], np.array([0, 0, -1.0, 0, 60.0, 0])
    trajectory = step(scene, q, v, 0.05, 1e-3)
    assert len(trajectory.impacts) == 1
    energies = [0.5 * one @ inertia.matrix() @ one for one in (v, trajectory.v[-1])]
    assert energies[1] == pytest.approx(energies[0], abs=1e-3)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize(
    ("solid", "speed"),
    one_of_each(
        [coal.Sphere(0.005), coal.Box(0.01, 0.01, 0.01), coal.Capsule(0.004, 0.01), None], [3.0, 30.0, 100.0]
    ),
)
def test_no_tunnelling_through_obstacles_thinner_than_a_step(solid, restitution, speed):
    """The obstacle is a plate of 2 mm or a ball of 1 cm; bodies move up to 10 cm in a step of 1 ms."""
    model = free_body(pin.Inertia.FromSphere(0.1, 0.005))
    model.gravity.linear[:] = 0.0
    shapes = pin.GeometryModel()
    if solid is None:
        contact = Contact("center", pinimpact.Sphere(radius=0.005), radius=0.005, restitution=restitution)
    else:
        shapes.addGeometryObject(pin.GeometryObject("bullet", 1, pin.SE3.Identity(), solid))
        plate = pinimpact.Box((0.002, 1.0, 1.0))
        contact = Contact(geometry="bullet", plane=plate, restitution=restitution)
    scene = Scene(pin.RobotWrapper(model, shapes, shapes), contact)
    for start in (0.1, 0.1037, 0.1071):
        q, v = [-start, 0, 0, 0, 0, 0, 1], [speed, 0, 0, 0, 0, 0]
        trajectory = step(scene, q, v, 0.3 / speed, 1e-3)
        # penetration is corrected within a step, at less than the resting speed
        assert trajectory.v[-1, 0] == pytest.approx(-restitution * speed, abs=1e-6)


def chain(links, pitch, length=0.05, mass=0.02):
    """Return a free planar chain of rods, inclined by `pitch`, whose lower end is at z = 0, and its ends."""
    model, joint = pin.Model(), 0
    inertia = mass * length**2 / 12.0 * np.diag([1e-2, 1.0, 1.0])
    rod = pin.Inertia(mass, np.array([0.5 * length, 0.0, 0.0]), inertia)
    tip = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    for k in range(links):
        hinge = pin.JointModelRY() if k else pin.JointModelFreeFlyer()
        joint = model.addJoint(joint, hinge, tip if k else pin.SE3.Identity(), f"link {k}")
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
        if k == 0:
            model.addFrame(pin.Frame("start", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        model.addFrame(pin.Frame(f"tip {k}", joint, tip, pin.FrameType.OP_FRAME))
    unbounded(model)
    q = pin.neutral(model)
    q[2], q[3:7] = links * length * np.sin(pitch), pin.Quaternion(pin.utils.rotate("y", pitch)).coeffs()
    return model, q, ["start", *(f"tip {k}" for k in range(links))]


@pytest.mark.parametrize(("links", "pitch", "lost"), [(1, 0.4, 0.04), (5, 0.2, 0.12), (10, 0.1, 0.25)])
def test_chain_that_lands_on_a_smooth_floor_keeps_its_momentum_along_it(links, pitch, lost):
    # links stop one after another at up to 60 rad/s; centrifugal forces change from step to step
    model, q, ends = chain(links, pitch)
    scene = Scene(model, [Contact(end, Plane(), friction=0.0) for end in ends])
    rotation = pin.Quaternion(q[3:7]).matrix()
    v, down = np.zeros(model.nv), 2.0
    v[:3] = rotation.T @ [0.0, 0.0, -down]
    errors, mass, data = [], pin.computeTotalMass(model), model.createData()
    for dt in (1e-3, 1e-4):
        run = simulate(scene, q, v, 0.2, scheme="time-stepping", dt=dt)
        pin.computeCentroidalMomentum(model, data, run.q[-1], run.v[-1])
        errors.append(abs(data.hg.linear[0]) / (mass * down))
        assert np.abs(run.energy.residual).max() < 10.0 * dt * run.energy.total[0]
    assert errors[0] < lost
    assert errors[1] < 0.2 * lost


@pytest.mark.parametrize("first", [1e-7, 1e-4])
def test_slow_onset_of_sliding_is_not_treated_as_rest(first):
    """After the short first step the speed (≥ 1 nm/s) is below the resting speed."""
    acceleration = 0.01
    model = slider()
    model.gravity.linear = np.array([acceleration + 0.2 * G, 0.0, -G])
    scene = Scene(model, Contact(model.frames[-1].name, FLOOR, friction=0.2))
    stepper = pinimpact.Stepper(scene, np.zeros(3), np.zeros(3), scheme="time-stepping", dt=1e-3)
    stepper.step(np.zeros(3), first)
    q, _ = stepper.step(np.zeros(3), 0.5)
    assert q[0] == pytest.approx(0.5 * acceleration * stepper.t**2, rel=1e-6)


@pytest.mark.parametrize(("friction", "sliding"), [(1.0, 0.0), (0.0, 1.0)])
def test_plastic_impact_uses_friction_not_sliding_friction(friction, sliding):
    model = slider()
    contact = Contact(model.frames[-1].name, FLOOR, friction=friction, sliding_friction=sliding)
    height, after = 0.2, 0.01
    fall = math.sqrt(2.0 * height / G)
    trajectory = step(Scene(model, contact), [0.0, 0.0, height], [3.0, 0.0, 0.0], fall + after, 1e-3)
    speed = 3.0 - friction * G * fall - sliding * G * after
    assert trajectory.v[-1] == pytest.approx([speed, 0.0, 0.0], abs=1e-9)


def test_locked_joint_keeps_its_velocity_in_plastic_impact():
    robot = load_robot("two_link_arm")
    q = np.array([-0.2, 0.3])
    tip = Contact(robot.model.frames[-1].name, Plane())
    height = tip.gap(robot.model, robot.data, q)
    tip = Contact(tip.frame, Plane((0.0, 0.0, height - 0.1)), friction=0.3)
    scene = Scene(robot, tip, locked=[robot.model.names[-1]])
    exact, trajectory = simulate(scene, q, [0.0, 0.0], 0.4), step(scene, q, [0.0, 0.0], 0.4, 1e-4)
    assert trajectory.impacts[0].v_after == pytest.approx(exact.impacts[0].v_after, abs=1e-3)
    assert trajectory.impacts[0].v_after[1] == trajectory.impacts[0].v_before[1]


def test_shapes_a_kilometre_apart_do_not_collide():
    model, shapes, here = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    for name in ("fallen", "bouncing"):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), here, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), here)
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(f"{name}_0", joint, here, coal.Capsule(0.1, 0.2)))
    unbounded(model)
    pair = Contact(geometry="bouncing_0", plane=Shape("fallen_0"), restitution=0.3)
    scene = Scene(
        pin.RobotWrapper(model, shapes, shapes),
        [pair, Contact("bouncing", FLOOR, restitution=0.9, radius=0.1)],
    )
    upside_down = 1.0, 0.0, 0.0, 0.0
    trajectory = step(scene, [5.0, 0.0, -1100.0, *upside_down, 0.0, 0.0, 1.0, *UP], np.zeros(12), 0.6, 1e-3)
    assert [impact.source for impact in trajectory.impacts] == ["bouncing on plane"]


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_push_of_a_held_body_is_an_impact_at_its_hinge(dt):
    """A velocity K at the centre of mass, at a distance of 1 m from the hinge, becomes a rotation."""
    inertia, hinge = pin.Inertia.FromSphere(1.0, 0.1), Contact("tip0", Plane(), name="hinge")

    def push(t, q, v):
        v[0] += 10.0
        return v

    events = [Event(lambda t, q, v: t - 0.1, callback=push, name="push")]
    scene = Scene(free_body(inertia, [(0.0, 0.0, 1.0)]), held=[hinge], events=events, without=["gravity"])
    start = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]
    trajectory = simulate(scene, start, np.zeros(6), 0.3, scheme="time-stepping", dt=dt)
    rate = 10.0 / (1.0 + 0.4 * 0.01)
    after = trajectory.at(0.1 + 1e-9)[1]
    assert after[[0, 4]] == pytest.approx([rate, -rate], rel=1e-6)
    assert trajectory.energy.impacts[-1] == pytest.approx(5.0 * rate, rel=1e-9)
    for q in trajectory.q:
        hinge_at = q[:3] + pin.Quaternion(q[3:]).matrix() @ [0.0, 0.0, 1.0]
        assert np.abs(hinge_at).max() < 40.0 * dt**2


def test_rod_with_held_end_rebounds():
    inertia = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.eye(3) / 12.0)
    hinge = Contact("tip0", Plane((0.0, 0.0, 0.5)))
    end = Contact("tip1", FLOOR, restitution=0.5)
    scene = Scene(free_body(inertia, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]), end, held=hinge)
    names = ["state"]
    trajectory = step(scene, [0, 0, 0.5, *UP], np.zeros(6), 0.5, 1e-3, sensitivities=names)
    hit = trajectory.impacts[0]
    fallen = math.sqrt(3.0 * G * 0.5)  # ω² I/2 = m g h/2, I = 1/3
    assert np.linalg.norm(hit.v_before[3:]) == pytest.approx(fallen, rel=1e-3)
    assert hit.v_after[3:] == pytest.approx(-0.5 * hit.v_before[3:], abs=1e-2 * fallen)
    assert np.isfinite(trajectory.sensitivity(0.5).state).all()


def test_aligned_stack_stands_with_equal_corner_forces():
    count, mass = 5, 1.0
    scene = boxes(count, (0.2, 0.2, 0.1), mass)
    q0 = np.tile([0, 0, 0.05, *UP], count)
    q0[2::7] += 0.1 * np.arange(count)
    trajectory = step(scene, q0, np.zeros(6 * count), 0.5, 5e-3)
    assert np.abs(trajectory.q - q0).max() < 1e-9
    assert not trajectory.notes
    corners = [trajectory.forces(f"floor 0 corner {k}", 0.4)[2] for k in (1, 2, 3, 4)]
    assert sum(corners) == pytest.approx(count * mass * G, rel=1e-9)
    assert np.ptp(corners) < 1e-3


def test_boxes_dropped_together_land_and_stand():
    count = 3
    scene = boxes(count, (0.2, 0.2, 0.1), 1.0)
    q0 = np.tile([0, 0, 0.05, *UP], count)
    q0[2::7] += 0.1 * np.arange(count) + 0.01 * (1 + np.arange(count))
    trajectory = step(scene, q0, np.zeros(6 * count), 0.4, 2e-3)
    np.testing.assert_allclose(trajectory.q[-1, 2::7], 0.05 + 0.1 * np.arange(count), atol=1e-8)
    assert np.abs(trajectory.v[-1]).max() < 1e-8


@pytest.mark.slow
def test_domino_times_agree_with_another_program():
    # Moreau–Jean steps of 1 ms with coal's patches and Pinocchio's ADMM: times of a lean of 0.3 rad
    wanted = [0.054, 0.144, 0.206, 0.253, 0.293]
    thick, wide, high, rate = 0.008, 0.024, 0.048, 6.0
    scene = boxes(5, (thick, wide, high), 0.01, floor=0.6, between=0.3)
    q0 = np.tile([0, 0, 0.5 * high, *UP], 5)
    q0[::7] = 0.028 * np.arange(5)
    v0 = np.zeros(30)
    v0[:6] = 0.5 * rate * high, 0, 0.5 * rate * thick, 0, rate, 0
    trajectory = step(scene, q0, v0, 0.32, 1e-3)
    leans = 2.0 * np.arctan2(trajectory.q[:, 4::7], trajectory.q[:, 6::7])
    times = trajectory.t[np.argmax(leans > 0.3, axis=0)]
    np.testing.assert_allclose(times, wanted, atol=2e-3)


def test_quadruped_landing_agrees_with_event_driven_scheme():
    robot = load_robot("solo12")
    feet = [f"{leg}_FOOT" for leg in ("FL", "FR", "HL", "HR")]
    floor = [Contact(foot, FLOOR, friction=0.6) for foot in feet]
    model = robot.model
    control = JointPD(kp=6.0, kd=0.3, q_ref=robot.q0, limits=5.0)
    scene = Scene(model, floor, control=control)
    q0 = pinimpact.place_in_contact(model, robot.data, robot.q0, floor)
    q0[2] += 0.01
    exact = simulate(scene, q0, np.zeros(model.nv), 0.15, rtol=1e-9)
    errors = [
        np.abs(step(scene, q0, np.zeros(model.nv), 0.15, dt).q[-1] - exact.q[-1]).max() for dt in (2e-3, 5e-4)
    ]
    assert errors[1] < 2e-3
    assert errors[1] < errors[0]


def test_terminal_event_ends_run_within_a_step():
    scene = Scene(ball(), [Contact("center", FLOOR, radius=0.1)])
    low = Event(lambda t, q, v: q[2] - 1.0, terminal=True, name="low")
    scene = Scene(ball(), scene.contacts, events=[low])
    trajectory = step(scene, [0, 0, 2.0, *UP], np.zeros(6), 2.0, 1e-2)
    assert trajectory.t[-1] == pytest.approx(math.sqrt(2.0 / G), abs=1e-9)
    assert trajectory.q[-1, 2] == pytest.approx(1.0, abs=1e-9)


def test_unknown_scheme_and_zero_dt_raise():
    scene = Scene(pendulum())
    with pytest.raises(pinimpact.UnknownNameError, match=r"^scheme: 'stepping'"):
        simulate(scene, [0.0], [0.0], 0.1, scheme="stepping")
    with pytest.raises(pinimpact.InputError, match=r"^dt: "):
        step(scene, [0.0], [0.0], 0.1, 0.0)


def test_patch_has_corners_and_gaps_of_overlapping_faces():
    lower, upper = box((2.0, 2.0, 2.0)), box((1.0, 3.0, 1.0))
    turn = pin.rpy.rpyToMatrix(0.0, 1e-4, 0.0)
    found = patch(upper.at(turn, np.array([0.7, 0.0, 1.5001])), lower.at(np.eye(3), np.zeros(3)), 0.01)
    assert found is not None
    # the edge of the lower box is below the tilted face of the upper one, whose normal is used
    np.testing.assert_allclose(found.normal, turn[:, 2], atol=1e-12)
    order = np.lexsort((found.others[:, 1], found.others[:, 0]))
    corners, gaps = found.others[order], found.gaps[order]
    np.testing.assert_allclose(corners[:, 0], [0.2, 0.2, 1.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(corners[:, 1], [-1.0, 1.0, -1.0, 1.0], atol=1e-12)
    middle = np.array([0.7, 0.0, 1.5001]) - 0.5 * turn[:, 2]  # of the upper box's lower face
    np.testing.assert_allclose(gaps, (middle - corners) @ turn[:, 2], atol=1e-14)


def near_boxes(rng, alike):
    """Return two boxes (axes, centre, half edges) that are 1 mm apart or overlap by up to 2 mm.

    `alike` scales the random rotation between them; with 0 they are parallel.
    """
    halves = rng.uniform(0.2, 1.0, (2, 3))
    turned = pin.exp3(rng.normal(size=3))
    other = turned @ pin.exp3(alike * rng.normal(size=3))
    direction, center = rng.normal(size=3), rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    shapes = [coal.Box(*(2.0 * half)) for half in halves]
    here, near, far = coal.Transform3s(other, center), 0.0, 6.0
    while far - near > 1e-12:
        middle = 0.5 * (near + far)
        there = coal.Transform3s(turned, center + middle * direction)
        apart = coal.distance(
            shapes[0], there, shapes[1], here, coal.DistanceRequest(), coal.DistanceResult()
        )
        near, far = (near, middle) if apart > 1e-3 else (middle, far)
    first = center + (far - rng.choice([0.0, 3e-3])) * direction
    return (turned, first, halves[0]), (other, center, halves[1])


def boxes_patch(one, other, within=1e-2):
    """Return the normal, the gaps, and the points on the first box of the kernel `box_patch`."""
    (a, half_a), (b, half_b) = (
        (np.concatenate([turn.T.ravel(), center]), half) for turn, center, half in (one, other)
    )
    normal, points, others, gaps = np.empty(3), np.empty((8, 3)), np.empty((8, 3)), np.empty(8)
    kinds, edges = np.zeros(8, dtype=np.int64), np.zeros((2, 3))
    count = box_patch(a, half_a, b, half_b, within, normal, points, others, gaps, kinds, edges)
    np.testing.assert_allclose(((points - others) @ normal)[:count], gaps[:count], atol=1e-14)
    return normal, gaps[:count], points[:count]


@pytest.mark.parametrize("alike", [0.0, 1e-4, 1.0])
def test_box_patch_kernel_agrees_with_coal_and_clipped_faces(alike):
    rng, found = np.random.default_rng(5), 0
    for _ in range(300):
        one, other = near_boxes(rng, alike)
        normal, gaps, points = boxes_patch(one, other)
        right = patch(*(box(2.0 * half).at(turn, center) for turn, center, half in (one, other)), 1e-2)
        assert right is not None
        # coal's normals are accurate to about 1e-7 for shapes that are apart
        np.testing.assert_allclose(normal, right.normal, atol=1e-5)
        order, known = np.lexsort(points.T.round(5)), np.lexsort(right.points.T.round(5))
        np.testing.assert_allclose(gaps[order], right.gaps[known], atol=1e-6)
        np.testing.assert_allclose(points[order], right.points[known], atol=1e-5)
        found += len(gaps)
        # exchanged boxes: the same points, except that the other of two parallel faces may define the normal
        turned, swapped, _ = boxes_patch(other, one)
        np.testing.assert_allclose(turned, -normal, atol=1e-3 * (alike > 0.0) + 1e-12)
        assert len(swapped) == len(gaps)
    assert found > (600 if alike < 1.0 else 300)


def test_patch_of_faces_with_coplanar_sides_has_four_corners():
    """Rounding errors of coplanar sides must not be taken for an intersection of edges."""
    rng, half = np.random.default_rng(3), np.array([0.3, 0.05, 0.025])
    for _ in range(200):
        turn, center = pin.exp3(rng.normal(size=3)), rng.normal(size=3)
        lower = np.array([rng.uniform(-0.2, 0.2), 0.0, -0.125])  # as wide as the upper one
        one, other = (turn, center, half), (turn, center + turn @ lower, np.array([0.05, 0.05, 0.1]))
        corners = np.array([[x, y, 0.1] for x in (-0.05, 0.05) for y in (-0.05, 0.05)])
        solids = (box(2.0 * size).at(axes, middle) for axes, middle, size in (one, other))
        for points in (boxes_patch(one, other)[2], patch(*solids, 1e-2).points):
            found = (points - other[1]) @ turn
            order = np.lexsort(found.T[::-1].round(5))
            np.testing.assert_allclose(found[order], corners, atol=1e-12)


def test_patch_of_tiny_box_on_large_one_has_its_corners():
    size, place = 1e-6 * np.array([1.0, 0.8, 0.6]), np.array([3e-6, 2e-6, 0.3e-6])
    floor = np.eye(3), np.array([0.0, 0.0, -5e3]), np.full(3, 5e3)
    brick = np.eye(3), place, 0.5 * size
    corners = place + 0.5 * size * [[x, y, -1] for x in (-1, 1) for y in (-1, 1)]
    for one, other in ((floor, brick), (brick, floor)):
        solids = (box(2.0 * half).at(axes, middle) for axes, middle, half in (one, other))
        for points in (boxes_patch(one, other, 1e-8)[2], patch(*solids, 1e-8).points):
            order = np.lexsort(points.T[::-1].round(7))
            np.testing.assert_allclose(points[order], corners, atol=1e-11)


BEYOND = {
    "ball": (sphere(0.05), 0.0),
    "standing capsule": (capsule(0.05, 0.05), 0.0),
    "lying capsule": (capsule(0.05, 0.05), 0.5 * math.pi),
}
"""Round shapes, and rotation about the edge of the box beneath them."""


@pytest.mark.parametrize("beyond", [1e-8, 1e-6, 6e-5, 1e-3])
@pytest.mark.parametrize("top", BEYOND)
def test_patch_of_round_shape_beyond_side_of_face_is_at_edge(top, beyond):
    """The normal may be that of the face within 1 mrad, although nothing is above it."""
    (shape, angle), rng = BEYOND[top], np.random.default_rng(6)
    turn, brick = pin.utils.rotate("y", angle), box((0.2, 0.2, 0.1))
    core = shape.vertices @ turn.T  # its lowest and then innermost point is above the outside of the edge
    tip = core[np.lexsort((core[:, 0], core[:, 2].round(12)))[0]]
    for apart in (1e-6, 1e-4):
        place = np.array([0.1 + beyond, 0.01, 0.05 + shape.radius + apart]) - tip
        axes, middle = pin.exp3(rng.normal(size=3)), rng.normal(size=3)
        solids = [shape.at(axes @ turn, middle + axes @ place), brick.at(axes, middle)]
        distance = math.hypot(beyond, shape.radius + apart)
        for sign, pair in ((1.0, solids), (-1.0, solids[::-1])):
            found = patch(*pair, 2e-3)
            assert found is not None
            np.testing.assert_allclose(found.gaps, [distance - shape.radius], atol=1e-14)
            normal = np.array([beyond, 0.0, shape.radius + apart]) / distance
            np.testing.assert_allclose(sign * axes.T @ found.normal, normal, atol=1e-11 / distance)


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
@pytest.mark.parametrize("brick_first", [True, False])
@pytest.mark.parametrize("height", [0.1, 0.13, 0.2])
def test_ball_above_a_gap_between_two_bricks_rests_on_their_edges(height, brick_first, dt):
    """Impacts move the bricks apart by micrometres: the ball is above neither, yet rests on their edges."""
    solids = {"left": coal.Box(0.2, 0.1, 0.1), "right": coal.Box(0.2, 0.1, 0.1), "ball": coal.Sphere(0.05)}
    model, shapes = pin.Model(), pin.GeometryModel()
    for name, solid in solids.items():
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        is_ball = name == "ball"
        own = pin.Inertia.FromSphere(1.0, 0.05) if is_ball else pin.Inertia.FromBox(1.0, 0.2, 0.1, 0.1)
        model.appendBodyToJoint(joint, own, pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3.Identity(), solid))
    unbounded(model)
    pairs = [("left", FLOOR), ("right", FLOOR), ("right", Shape("left"))]
    for name in ("left", "right"):
        pairs.append((name, Shape("ball")) if brick_first else ("ball", Shape(name)))
    contacts = [
        Contact(geometry=name, plane=other, friction=1.0, restitution=0.3, name=f"{k}")
        for k, (name, other) in enumerate(pairs)
    ]
    scene = Scene(model, contacts, geometry=shapes)
    q0 = np.array([-0.1, 0, 0.05, *UP, 0.1, 0, 0.05, *UP, 0, 0, 0.15 + height, *UP])
    run = step(scene, q0, np.zeros(18), 0.6, dt)
    np.testing.assert_allclose(run.q[-1, [2, 9, 16]], [0.05, 0.05, 0.15], atol=1e-5)
    energy = run.energy.kinetic + run.energy.potential
    # time steps do not resolve speeds below g dt
    assert np.diff(energy).max() < 0.5 * 3.0 * (G * dt) ** 2


def redundant_problem(rng):
    """Return mass matrix, Jacobian, free velocities and μ of one or two bodies with 4 to 8 contacts each."""
    bodies, points = rng.integers(1, 3), rng.integers(4, 9)
    m, nc = 6 * bodies, bodies * points
    mass = np.diag(np.tile([1.0, 1.0, 1.0, 0.02, 0.03, 0.04], bodies)) * rng.uniform(0.3, 3.0)
    jacobian = np.zeros((3 * nc, m))
    for i in range(nc):
        body = i % bodies
        x, y, z = rng.uniform(-1, 1), rng.uniform(-1, 1), -0.5
        rows = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        jacobian[3 * i : 3 * i + 3, 6 * body : 6 * body + 6] = rows
        if i == nc - 1 and bodies == 2:  # between the two bodies
            jacobian[3 * i : 3 * i + 3, :6] = -rows
    free = jacobian @ (rng.normal(size=m) - np.tile([0, 0, 1.0, 0, 0, 0], bodies))
    return mass, jacobian, free, rng.uniform(0.0, 1.0, nc)


def solved(mass, jacobian, free, mu, compliance, impulse, begin=None, course=None):
    """Solve one island; `impulse` and `course` are overwritten with results. Return the residual."""
    (n, m), none = jacobian.shape, np.empty(0)
    every = jacobian, np.tile(np.arange(m), (n, 1)), np.full(n, m)
    tree = np.zeros(m, dtype=np.int64)
    nc = len(mu)
    law = Law(mu, np.zeros((nc, 2)), np.zeros(nc), np.full(nc, np.inf), np.zeros(nc, dtype=bool), none, none)
    problem = VelocityProblem(mass, np.linalg.inv(mass), tree, *every, free, law, compliance)
    return step_impulses(
        *(problem, np.ones(len(mu), dtype=bool), tree, SOFTEST, 1e-11, 0.0),
        *(np.zeros(m) if begin is None else begin, np.zeros(m), impulse),
        np.empty((2, 0, n)) if course is None else course,
    )


@pytest.mark.parametrize("wrong", [1e30, 1e300, math.inf, math.nan])
def test_solver_recovers_from_useless_initial_velocity(wrong):
    """Where sliding has several solutions, any one may be returned; it must satisfy Coulomb's law."""
    rng, found = np.random.default_rng(11), 0
    for _ in range(20):
        mass, jacobian, free, mu = redundant_problem(rng)
        inverse, impulse = np.linalg.inv(mass), np.zeros(len(free))
        if solved(mass, jacobian, free, mu, np.ones(len(mu)), impulse) > 1e-7:
            continue
        found += 1
        assert solved(mass, jacobian, free, mu, np.ones(len(mu)), impulse, np.full(len(mass), wrong)) < 1e-5
        u, force = (free + jacobian @ inverse @ jacobian.T @ impulse).reshape(-1, 3), impulse.reshape(-1, 3)
        size, largest = np.abs(free).max(), np.abs(impulse).max()
        assert np.abs(u).max() < 3.0 * size
        assert u[:, 2].min() > -1e-4 * size
        assert np.minimum(u[:, 2] / size, force[:, 2] / max(largest, 1e-300)).max() < 1e-4
        assert (np.linalg.norm(force[:, :2], axis=1) - mu * force[:, 2]).max() <= 1e-9 * largest
    assert found > 10


def test_redundant_contacts_satisfy_coulombs_law():
    """Coulomb's law is checked contact by contact; at most one of 400 problems may remain unsolved."""
    rng, unsolved = np.random.default_rng(7), 0
    for _ in range(400):
        mass, jacobian, free, mu = redundant_problem(rng)
        inverse, impulse = np.linalg.inv(mass), np.zeros(len(free))
        residual = solved(mass, jacobian, free, mu, np.ones(len(mu)), impulse)
        if residual > 1e-7:
            unsolved += 1
            continue
        u = (free + jacobian @ inverse @ jacobian.T @ impulse).reshape(-1, 3)
        size, force, largest = np.abs(free).max(), impulse.reshape(-1, 3), np.abs(impulse).max()
        slip, pushed = np.linalg.norm(u[:, :2], axis=1), np.linalg.norm(force[:, :2], axis=1)
        assert u[:, 2].min() > -1e-6 * size
        assert force[:, 2].min() >= -1e-15 * largest
        assert np.minimum(u[:, 2] / size, force[:, 2] / max(largest, 1e-300)).max() < 1e-5
        assert (pushed <= mu * force[:, 2] * (1 + 1e-9) + 1e-12).all()
        # equals μ f_n |u_t| if friction opposes slip and is at its bound
        work = -(force[:, :2] * u[:, :2]).sum(axis=1)
        np.testing.assert_allclose(work, mu * force[:, 2] * slip, atol=1e-5 * size * largest)
    assert unsolved <= 1


def leaning_plates(rng, tilt, count=12):
    """Return mass matrix, Jacobian, free velocities and μ of plates in a row that fall on each other.

    Each plate has two points on the floor and two on the next plate, at its left and right sides.
    """
    thick, wide, high = size = np.array([0.008, 0.024, 0.048])
    squares = size**2
    mass = np.diag(np.tile(np.r_[[0.01] * 3, (squares.sum() - squares) * 0.01 / 12.0], count))
    rows, mu, v = [], [], np.zeros((count, 6))

    def at(point, axes):
        return axes @ np.hstack([np.eye(3), -pin.skew(point)])

    for k in range(count):
        turned = pin.utils.rotate("y", tilt * (1.0 - k / count))
        across = np.array([turned[:, 2], [0.0, 1.0, 0.0], -turned[:, 0]])
        for side in (-0.5 * wide, 0.5 * wide):
            rows.append(np.zeros((3, count, 6)))
            rows[-1][:, k] = at(turned @ [0.5 * thick, side, -0.5 * high], np.eye(3))
            mu.append(0.6)
        for side in (-0.5 * wide, 0.5 * wide) if k + 1 < count else ():
            rows.append(np.zeros((3, count, 6)))
            rows[-1][:, k] = at(turned @ [0.5 * thick, side, 0.5 * high * rng.uniform(0.6, 1.0)], across)
            rows[-1][:, k + 1] = -at(np.array([-0.5 * thick, side, 0.35 * high]), across)
            mu.append(0.3)
        v[k, 4] = 6.0 * (1.0 - k / count) * rng.uniform(0.5, 1.5)
        v[k, 0] = 0.5 * high * v[k, 4]
        v[k] += 1e-3 * rng.normal(size=6)
        v[k, 2] -= 0.01
    jacobian = np.vstack(rows).reshape(-1, 6 * count)
    return mass, jacobian, jacobian @ v.ravel(), np.array(mu)


def test_solver_returns_to_larger_compliances_where_smaller_ones_fail():
    """The direct method, which takes a thousand times as long, would leave no course."""
    for seed in range(16):
        tilt = (0.3, 0.6, 0.9)[seed % 3]
        mass, jacobian, free, mu = leaning_plates(np.random.default_rng(seed), tilt)
        impulse, course = np.zeros(len(free)), np.zeros((2, 60, len(free)))
        assert solved(mass, jacobian, free, mu, np.ones(len(mu)), impulse, course=course) < 1e-5
        assert course[0].any()


def test_few_iterations_for_ill_conditioned_delassus_matrix():
    """The eigenvalues of W are 2 and 0.006; with r = 0.003 the change decreases to a third per iteration."""
    mass, mu, impulse = np.diag([1.0, 1.0, 1.0 / 0.003]), np.zeros(2), np.zeros(6)
    jacobian, course = np.zeros((6, 3)), np.zeros((2, 40, 6))
    jacobian[2], jacobian[5] = (0.0, 1.0, 1.0), (0.0, 1.0, -1.0)
    residual = solved(mass, jacobian, jacobian @ [0.0, -1.0, -0.001], mu, np.ones(2), impulse, course=course)
    assert residual < 1e-10
    np.testing.assert_allclose(impulse[2::3], [2.0 / 3.0, 1.0 / 3.0], rtol=1e-8)
    assert 5 < course[0].any(axis=1).sum() < 12


def test_box_meshes_move_as_boxes():
    """Patches of boxes are computed by a kernel, others by polygons of their faces."""
    size = np.array([0.1, 0.2, 0.05])
    mesh = hull_mesh(0.5 * size * np.array(list(itertools.product((-1.0, 1.0), repeat=3))))
    turned = [pin.Quaternion(pin.exp3(np.array([0.05, 0.1, angle]))).coeffs() for angle in (0.2, 0.3)]
    q0 = np.concatenate([[0, 0, 0.08, *turned[0]], [0.01, 0.02, 0.17, *turned[1]]])
    ends = [
        step(boxes(2, size, 1.0, solid=solid), q0, np.zeros(12), 0.3, 1e-3).q[-1] for solid in (None, mesh)
    ]
    assert np.abs(ends[0] - q0).max() > 0.03
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-10)


def compliant_residual(f, W, free, mu, given, part):
    """Return the residual of Coulomb's law for impulses `f` with contact compliances `part * given`."""
    z = (f - (free + W @ f + part * given * f) / given).reshape(-1, 3)
    push, pull = np.maximum(z[:, 2], 0.0), np.linalg.norm(z[:, :2], axis=1)
    share = np.minimum(1.0, mu * push / np.maximum(pull, 1e-300))
    return f - np.column_stack([z[:, :2] * share[:, None], push]).ravel()


def test_impulses_are_limit_of_small_compliances_when_sliding():
    rng, pairs = np.random.default_rng(3), []
    for _ in range(120):
        mass, jacobian, free, mu = redundant_problem(rng)
        W, x = jacobian @ np.linalg.inv(mass) @ jacobian.T, np.zeros(len(free))
        c = rng.uniform(0.5, 2.0, len(mu))
        if len(free) > 18 or solved(mass, jacobian, free, mu, c, x) > 1e-7 or not x.any():
            continue
        given, errors = np.repeat(c, 3) / c.max() * np.diag(W).max(), []
        for part in (1e-4, 1e-5):
            found = root(compliant_residual, x, args=(W, free, mu, given, part), tol=1e-13).x
            if np.abs(compliant_residual(found, W, free, mu, given, part)).max() < 1e-8:
                errors.append(np.abs(found - x).max() / np.abs(x).max())
        if len(errors) == 2:
            pairs.append((errors[1], errors[1] / errors[0]))
    error, ratio = np.array(pairs).T
    assert len(error) > 25
    assert np.quantile(error, 0.9) < 1e-3  # of first order in the compliances
    assert np.quantile(ratio, 0.9) < 0.15


def test_non_unique_impulses_are_shared_by_compliance():
    # a body on n points in a line: impulses are inversely proportional to the compliances
    n = 5
    x = np.linspace(-1.0, 1.0, n)
    jacobian = np.zeros((3 * n, 3))
    jacobian[::3, 0] = 1.0
    jacobian[2::3, 1], jacobian[2::3, 2] = 1.0, x
    mass = np.diag([2.0, 2.0, 1.0])
    for compliance in (np.ones(n), np.array([1.0, 2.0, 4.0, 2.0, 1.0])):
        impulse = np.zeros(3 * n)
        solved(mass, jacobian, jacobian @ [0.0, -1.0, 0.0], np.full(n, 0.3), compliance, impulse)
        np.testing.assert_allclose(impulse[2::3], 2.0 / compliance / (1.0 / compliance).sum(), rtol=1e-9)


def test_impact_errors_are_at_most_those_of_the_steps(tmp_path):
    """Compare with the same impacts at full accuracy; a step h has a relative error of (h g / v)²."""
    scene = boxes(3, (0.1, 0.1, 0.1), 1.0, restitution=0.1)
    q = []
    for k in range(3):
        tilt = pin.Quaternion(pin.exp3(np.array([0.05 * (k + 1), 0.01, 0.1 * k])))
        q += [0.003 * k, 0.0, 0.07 + 0.11 * k, *tilt.coeffs()]
    dt, coarse = 1e-3, 0
    motion = step(scene, np.array(q), np.zeros(18), 0.3, dt)
    motion.save(tmp_path / "boxes.npz")
    again = pinimpact.Trajectory.load(tmp_path / "boxes.npz").impacts
    for impact, loaded in zip(motion.impacts, again, strict=True):
        if impact.group is None or "adaptive steps" not in " ".join(impact.group[0].solution.notes):
            continue
        group, place = impact.group
        exact = solve_impact(group.problem, simultaneous="propagate")
        fastest = np.abs(group.problem.velocity).max()
        error = np.abs(group.solution.velocity - exact.velocity).max() / fastest
        assert error <= max((dt * G / fastest) ** 2, 1e-7)
        coarse += error > 1e-7
        # the recorded solution is the one used in the motion
        length = np.linalg.norm(group.solution.impulse[place])
        assert length == pytest.approx(np.linalg.norm(impact.impulse_world), rel=1e-9, abs=1e-12)
        np.testing.assert_array_equal(loaded.group[0].solution.velocity, group.solution.velocity)
    assert coarse > 1


def test_work_of_dry_friction_in_hinge_is_moment_times_angle():
    """Contact rows are in metres, but the work in a hinge is N m times rad."""
    moment, model = 0.3, pendulum(mass=2.0, length=0.4)
    model.gravity.linear[:] = 0.0
    model.friction[:] = moment
    motion = step(Scene(model), np.array([0.2]), np.array([3.0]), 0.1, 1e-3)
    turned = motion.q[:, 0] - 0.2
    np.testing.assert_allclose(motion.energy.joints, -moment * turned, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(motion.energy.residual, 0.0, atol=1e-12)
    assert motion.v[-1, 0] > 0.0


def box_above_floor(kind, friction):
    """Return a scene of a box above the floor.

    Its joint is a free-flyer (`kind` "free"), or a translation and a spherical joint, so that its linear
    velocity is in world axes.
    """
    model, shapes, here, size = pin.Model(), pin.GeometryModel(), pin.SE3.Identity(), (0.1, 0.2, 0.5)
    if kind == "free":
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), here, "box")
    else:
        joint = model.addJoint(0, pin.JointModelTranslation(), here, "place")
        joint = model.addJoint(joint, pin.JointModelSpherical(), here, "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *size), here)
    model.addJointFrame(joint)
    shapes.addGeometryObject(pin.GeometryObject("box_0", joint, here, coal.Box(*size)))
    unbounded(model)
    contact = Contact(geometry="box_0", plane=FLOOR, friction=friction)
    return Scene(pin.RobotWrapper(model, shapes, shapes), contact)


@pytest.mark.parametrize("dt", [2e-3, 5e-4])
def test_frictionless_box_falls_over_without_horizontal_motion(dt):
    """All forces are vertical, so the centre of the box moves along a vertical line until the box rests."""
    tilted = pin.Quaternion(pin.rpy.rpyToMatrix(0.3, 0.5, 0.2)).coeffs()
    motion = step(box_above_floor("free", 0.0), [0, 0, 0.4, *tilted], np.zeros(6), 1.0, dt)
    assert np.abs(motion.q[:, :2]).max() < 1e-13
    assert motion.q[-1, 2] == pytest.approx(0.05, abs=1e-6) or motion.q[-1, 2] == pytest.approx(0.1, abs=1e-6)


def test_box_motion_does_not_depend_on_axes_of_velocity():
    tilted = pin.Quaternion(pin.rpy.rpyToMatrix(0.3, 0.5, 0.2)).coeffs()
    ends = [
        step(box_above_floor(kind, 0.4), [0, 0, 0.4, *tilted], np.zeros(6), 0.45, 1e-3).q[-1]
        for kind in ("free", "in world axes")
    ]
    np.testing.assert_allclose(*ends, atol=1e-8)  # [m] and of the quaternion


@pytest.mark.parametrize("spin", [0.0, 30.0, 180.0])
def test_fast_spin_does_not_affect_accuracy_of_flight_and_rolling(spin):
    """The linear velocity of the ball is in axes that rotate with it."""
    radius, t = 0.028, 0.5
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(0.17, radius), pin.SE3.Identity())
    model.addJointFrame(joint)
    ball = pin.GeometryObject("ball_0", joint, pin.SE3.Identity(), coal.Sphere(radius))
    shapes.addGeometryObject(ball)
    unbounded(model)
    contacts = [Contact(geometry="ball_0", plane=FLOOR, friction=0.2)]
    scene = Scene(model, contacts, geometry=shapes)
    flight = simulate(scene, [0, 0, 9, *UP], [1.5, 0, 0, 0, spin, 0], t, scheme="time-stepping")
    np.testing.assert_allclose(flight.q[-1, :3], [1.5 * t, 0, 9 - 0.5 * 9.81 * t**2], atol=1e-11)
    speed = spin * radius
    rolling = simulate(scene, [0, 0, radius, *UP], [speed, 0, 0, 0, spin, 0], t, scheme="time-stepping")
    np.testing.assert_allclose(rolling.q[-1, :3], [speed * t, 0, radius], atol=1e-8)
    for run in (flight, rolling):
        assert np.abs(run.energy.residual).max() < 1e-10 * max(run.energy.kinetic.max(), 1e-3)


@pytest.mark.parametrize("speed", [1.0, 100.0, 1000.0])
def test_slow_ball_does_not_bounce_early_beside_a_fast_one(speed):
    """Contacts collide together if they would close within a hundredth of a step, each at its own speed."""
    model, contacts, e = pin.Model(), [], 0.5
    for k in range(3):
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), f"z{k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"ball{k}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        contacts.append(Contact(f"ball{k}", FLOOR, restitution=e, name=f"ball{k}"))
    unbounded(model)
    # a fast ball and a slow one arrive in the first step, another slow one 4 mm later
    heights, speeds = np.array([0.9998e-3 * speed, 8e-4, 5e-3]), np.array([speed, 1.0, 1.0])
    run_ = simulate(Scene(model, contacts), heights, -speeds, 8e-3, scheme="time-stepping")
    falls = (np.sqrt(speeds**2 + 2.0 * 9.81 * heights) - speeds) / 9.81
    after = e * (speeds + 9.81 * falls)
    rest = 8e-3 - falls
    assert {impact.source: impact.time for impact in run_.impacts} == pytest.approx(
        {f"ball{k}": falls[k] for k in range(3)}, abs=1e-9
    )
    assert run_.q[-1] == pytest.approx(after * rest - 0.5 * 9.81 * rest**2, abs=1e-9)
