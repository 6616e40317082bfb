"""Degenerate motions of boxes by the default scheme and by time stepping.

Faces lie on faces, so load distributions are not unique, and forces start slip and rotation from rest.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from pinimpact import Boundary, Box, Contact, JointPD, Plane, Scene, Shape, Sphere, Stepper, impact, simulate

from .scene_models import UP, G, shaped_body, unbounded
from .test_time_stepping import boxes

SIZE, MU = (0.2, 0.2, 0.1), 0.4
FLAT = [0.0, 0.0, 0.05, *UP]


def pushed(scene, q0, force, v0=None, gravity=(0.0, 0.0, -G)):
    """Return a scene with constant generalized forces and the given gravity, and its initial state."""
    scene.model.gravity.linear[:] = gravity
    force = np.array(force, dtype=float)
    scene = dataclasses.replace(scene, control=lambda t, q, v: force)
    return scene, np.array(q0), np.zeros(scene.model.nv) if v0 is None else np.array(v0, dtype=float)


def on_the_floor(force, v0=None, **options):
    return pushed(boxes(1, SIZE, 1.0, floor=MU), FLAT, force, v0, **options)


def stacked(force, v0=None):
    scene = boxes(2, SIZE, 1.0, floor=MU, between=MU)
    return pushed(scene, [*FLAT, 0.0, 0.0, 0.15, *UP], force, v0)


def side_by_side(force, v0=None):
    scene = boxes(2, SIZE, 1.0, floor=MU, between=MU)
    return pushed(scene, [*FLAT, 0.2, 0.0, 0.05, *UP], force, v0)


def between_planes(normals, points, q0, force, v0=None):
    scene = boxes(1, SIZE, 1.0)
    contacts = [
        Contact(geometry="box_0_0", plane=Plane(normal=n, point=p), friction=MU, name=f"plane {k}")
        for k, (n, p) in enumerate(zip(normals, points, strict=True))
    ]
    return pushed(dataclasses.replace(scene, contacts=contacts), q0, force, v0)


def in_a_corner(force):
    return between_planes([(0, 0, 1), (-1, 0, 0)], [(0, 0, 0), (0.1, 0, 0)], FLAT, force)


def in_a_groove(force, v0=None):
    # the box stands on an edge, with its faces on the sides of the groove
    turn = pin.Quaternion(pin.exp3(np.array([np.pi / 4, 0.0, 0.0]))).coeffs()
    center = np.array([0.0, 0.1 - 0.05, 0.1 + 0.05]) / np.sqrt(2.0)
    normals = [np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0), np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0)]
    return between_planes(normals, np.zeros((2, 3)), [*center, *turn], force, v0)


def slope(degrees, about):
    return tuple(pin.exp3(np.deg2rad(degrees) * np.array(about)) @ [0.0, 0.0, -G])


MOTIONS = {
    "slides and spins": on_the_floor(np.zeros(6), [1, 0.3, 0, 0, 0, 3]),
    "spins": on_the_floor(np.zeros(6), [0, 0, 0, 0, 0, 8]),
    "rests on a slope": on_the_floor(np.zeros(6), gravity=slope(21.0, (0.6, 0.8, 0.0))),
    "slides down a slope": on_the_floor(np.zeros(6), gravity=slope(25.0, (0.6, 0.8, 0.0))),
    "is pushed too little": on_the_floor([3.9, 0, 0, 0, 0, 0]),
    "is pushed": on_the_floor([4.1, 0, 0, 0, 0, 0]),
    "is pushed aside": on_the_floor([8, 0, 0, 0, 0, 0.64]),
    "is twisted": on_the_floor([0, 0, 0, 0, 0, 0.8]),
    "is lifted at an edge": on_the_floor([0, 0, 0, 0, 0.6, 0]),
    "lower box pulled, upper one keeps up": stacked([9.0, *np.zeros(11)]),
    "lower box pulled out": stacked([20.0, *np.zeros(11)]),
    "upper box pulled": stacked([*np.zeros(6), 5.0, *np.zeros(5)]),
    "upper box spins": stacked(np.zeros(12), [*np.zeros(11), 5.0]),
    "a box pushes another": side_by_side([9.0, *np.zeros(11)]),
    "a box pushes another off its middle": side_by_side([12.0, 0, 0, 0, 0, 0.6, *np.zeros(6)]),
    "two boxes press and shear": side_by_side([12, 0, 0, 0, 0, 0, -6, 3, 0, 0, 0, 0]),
    "is pressed into a corner": in_a_corner([6, 0, 0, 0, 0, 0]),
    "is drawn up a wall": in_a_corner([6, 0, 12, 0, 0, 0]),
    "is pushed along a wall": in_a_corner([6, 6, 0, 0, 0, 0]),
    "slides along a groove": in_a_groove(np.zeros(6), [1, 0, 0, 0, 0, 0]),
    "is pushed along a groove": in_a_groove([8, 0, 0, 0, 0, 0]),
    "is turned in a groove": in_a_groove([0, 0, 0, 0.8, 0, 0]),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_default_scheme_and_time_stepping_agree(name):
    scene, q0, v0 = MOTIONS[name]
    located = simulate(scene, q0, v0, 0.25)
    assert located.complete
    coarse, fine = (simulate(scene, q0, v0, 0.25, scheme="time-stepping", dt=dt).q[-1] for dt in (1e-3, 5e-4))
    # steps are of first order at changes of contact, and load distributions depend on compliances
    error = 3.0 * np.abs(coarse - fine).max() + 3e-4 * np.abs(located.q[-1] - q0).max() + 1e-9
    assert located.q[-1] == pytest.approx(2.0 * fine - coarse, abs=error)


def rod(tilt, height, **coefficients):
    """Return a scene of a rod of 1 m and 1 kg with its lower end at `height` above a floor, and q."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1 / 12, 1 / 12, 1e-3]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    end = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
    model.addFrame(pin.Frame("end", joint, 0, end, pin.FrameType.OP_FRAME))
    unbounded(model)
    turn = pin.Quaternion(pin.exp3(np.array([0.0, tilt, 0.0]))).coeffs()
    place = [0.0, 0.0, 0.5 * np.cos(tilt) + height, *turn]
    return Scene(model, [Contact("end", Plane(), name="end", **coefficients)]), np.array(place)


@pytest.mark.parametrize(("restitution", "spin"), [(0.0, 0.0), (0.3, 0.0), (0.0, 3.0), (0.3, 3.0)])
def test_forces_on_falling_rod_converge(restitution, spin):
    """The end moves along a curve; a normal velocity left by rebound or landing must not persist."""
    scene, q0 = rod(0.3, 0.01, friction=0.1, restitution=restitution)
    v0, errors = np.array([0.0, 0.0, 0.0, 0.0, spin, 0.0]), []
    exact = simulate(scene, q0, v0, 0.35, scheme="event-driven")
    for dt in (2e-3, 1e-3, 5e-4):
        run = simulate(scene, q0, v0, 0.35, scheme="time-stepping", dt=dt)
        t = dt * np.arange(
            (exact.impacts[-1].time + 0.02) // dt + 0.5, 0.35 / dt
        )  # forces are means over steps
        ratio = run.forces("end", t)[:, 2] / exact.forces("end", t)[:, 2]
        errors.append(np.abs(ratio - 1.0).max())
        assert abs(run.energy.residual).max() < 1e-3 * exact.energy.kinetic.max()
    assert errors[0] < 1e-2
    assert errors[2] < 4e-3


@pytest.mark.parametrize("part", [0.1, 0.35, 0.6, 0.85])
def test_landing_rod_is_stopped_by_one_impact(part):
    """The direction of slip changes in an oblique landing, so one impact differs from two successive ones."""
    dt, v0 = 1e-5, np.array([0.5, 1.0, -2.0, 3.0, 4.0, 0.0])
    scene, q0 = rod(0.6, 0.0, friction=0.3)
    data, end = scene.model.createData(), scene.model.getFrameId("end")
    law = dataclasses.replace(scene.contacts[0], law="energetic")
    landed = impact(scene.model, data, q0, v0, [law], simultaneous="together").v
    pin.forwardKinematics(scene.model, data, q0, v0)
    speed = -pin.getFrameVelocity(scene.model, data, end, pin.LOCAL_WORLD_ALIGNED).linear[2]
    q0[2] += (2.0 + part) * dt * speed
    scene.model.gravity.linear[:] = 0.0
    run = simulate(scene, q0, v0, 6.0 * dt, scheme="time-stepping", dt=dt)
    assert run.v[-1] == pytest.approx(landed, abs=1e-3)


@pytest.mark.parametrize("short", [1e-6, 1e-9])
def test_intermediate_short_steps_have_little_effect(short):
    """Impulses of a step are the warm start of the next one, unless that is a million times longer."""
    scene, q0 = rod(0.3, 0.01, friction=0.1)
    ends = []
    for between in ((short,), ()):
        stepper = Stepper(scene, q0, np.array([0.0, 0, 0, 0, 3.0, 0]), scheme="time-stepping", dt=1e-3)
        for h in 240 * (1e-3, *between):
            stepper.step(np.zeros(6), h)
        stepper.step(np.zeros(6), 0.25 - stepper.t)
        ends.append(np.concatenate([stepper.q, stepper.v]))
        assert abs(stepper.trajectory.energy.residual).max() < 2e-4
    assert ends[0] == pytest.approx(ends[1], abs=1e-2)


@pytest.mark.parametrize("gravity", [0.0, G])
@pytest.mark.parametrize("speed", [1.0, 3.0, 5.0])
def test_pressed_point_stays_on_sphere(gravity, speed):
    """The contact force on a point that circles a sphere is the pressing force minus m v²/R.

    At midpoints the gap is h² v²/2R, more than gravity could close in a step.
    """
    radius, press, duration = 0.1, 300.0, 0.2
    model, joint = pin.Model(), 0
    for kind in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ()):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"axis {joint}")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.01), pin.SE3.Identity())
    model.addFrame(pin.Frame("point", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.gravity.linear[:] = 0.0, 0.0, -gravity
    contact = Contact("point", Sphere((0, 0, 0), radius), name="ball")

    def control(t, q, v):
        return -press * q / np.linalg.norm(q) + np.array([0.0, 0.0, gravity])

    scene, errors = Scene(model, contact, control=control), []
    for dt in (1e-3, 5e-4):
        run = simulate(scene, [radius, 0, 0], [0, speed, 0], duration, scheme="time-stepping", dt=dt)
        assert not run.impacts
        forces = np.linalg.norm(run.forces("ball", np.linspace(0.01, 0.19, 181)), axis=1)
        np.testing.assert_allclose(forces, press - speed**2 / radius, rtol=0.02)
        turned = np.unwrap(np.arctan2(run.q[:, 1], run.q[:, 0]))[-1]
        errors.append(
            [turned - speed * duration / radius, np.abs(np.linalg.norm(run.q, axis=1) - radius).max()]
        )
    rough, fine = np.abs(errors)
    assert rough[0] < 0.03
    assert (fine < 0.3 * rough).all()  # second order


def test_ball_rolling_over_sphere_is_of_second_order():
    """Both the surface at the contact point and the axes of the velocity rotate."""
    ball = shaped_body(coal.Sphere(0.1), pin.Inertia.FromSphere(1.0, 0.1), name="ball")
    scene = Scene(ball, Contact(geometry="ball", plane=Sphere(radius=1.0), friction=0.3))
    q0 = np.array([1.1 * np.sin(0.3), 0.0, 1.1 * np.cos(0.3), *UP])
    exact = simulate(scene, q0, np.zeros(6), 0.5, scheme="event-driven", rtol=1e-10, atol=1e-12)
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):  # longer steps would be halved because of the fast rotation
        run = simulate(scene, q0, np.zeros(6), 0.5, scheme="time-stepping", dt=dt)
        errors.append(np.abs(pin.difference(scene.model, run.q[-1], exact.q[-1])).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.15)
    assert errors[-1] < 1e-4  # rad


def test_disc_rolls_in_circle_by_time_stepping():
    """Steady precession: with k along the axle and d to the lowest point, d(L)/dt = Ω × L is the torque."""
    mass, radius, tilt, track, thin = 1.0, 0.1, 1.2, 0.3, 1e-4
    k = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    d, up = np.array([np.cos(tilt), 0.0, -np.sin(tilt)]), np.array([0.0, 0.0, 1.0])
    across, along, circle = 0.25 * mass * radius**2, 0.5 * mass * radius**2, track - radius * np.cos(tilt)

    def turning(rate):
        return rate * (up - track / radius * k)  # no slip: v + ω × a d = 0

    def unbalanced(rate):
        spin = turning(rate)
        momentum = across * spin + (along - across) * (spin @ k) * k
        force = mass * np.array([-(rate**2) * circle, 0.0, G])
        return (rate * np.cross(up, momentum) - np.cross(radius * d, force))[1]

    rate = brentq(unbalanced, 1.0, 5.0)
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "disc")
    model.appendBodyToJoint(
        joint, pin.Inertia(mass, np.zeros(3), np.diag([across, across, along])), pin.SE3.Identity()
    )
    model.addJointFrame(joint)
    raised = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * thin]))  # origin: centre of the lower face
    shapes.addGeometryObject(pin.GeometryObject("disc", joint, raised, coal.Cylinder(radius, thin)))
    unbounded(model)
    scene = Scene(model, Contact(geometry="disc", plane=Plane(), friction=0.8), geometry=shapes)
    axes = np.column_stack([d, np.cross(k, d), k])
    height = radius * np.sin(tilt)
    q0 = np.array([circle, 0.0, height, *pin.Quaternion(axes).coeffs()])
    v0 = np.concatenate([axes.T @ [0.0, rate * circle, 0.0], axes.T @ turning(rate)])
    for dt, error in ((2e-3, 2e-3), (5e-4, 1.3e-4)):
        run = simulate(scene, q0, v0, 1.5, scheme="time-stepping", dt=dt)
        angle = rate * 1.5
        place = [circle * np.cos(angle), circle * np.sin(angle), height]
        assert np.abs(run.q[-1][:3] - place).max() < error
        assert pin.Quaternion(run.q[-1][3:]).matrix()[2, 2] == pytest.approx(np.cos(tilt), abs=error)


GRASP, STIFFNESS, DAMPING, GOAL = 0.3, 300.0, 20.0, 0.35


def pushed_by_finger():
    """Return a scene of a box on the floor that a finger pushes with a face of four corners."""
    model, shapes, here = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    for name, kind, size, mass in (
        ("box", pin.JointModelFreeFlyer(), SIZE, 1.0),
        ("finger", pin.JointModelPX(), (0.1, 0.04, 0.04), 0.5),
    ):
        place = here if name == "box" else pin.SE3(np.eye(3), np.array([-0.25, 0.0, 0.06]))
        joint = model.addJoint(0, kind, place, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, *size), here)
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(name, joint, here, coal.Box(*size)))
    unbounded(model)
    contacts = [
        Contact(geometry="box", plane=Plane(), friction=MU, name="floor"),
        Contact(geometry="finger", plane=Shape("box"), friction=GRASP, name="push"),
    ]
    control = JointPD([0.0] * 6 + [STIFFNESS], [0.0] * 6 + [DAMPING], [0, 0, 0, *UP, GOAL])
    return Scene(model, contacts, geometry=shapes, control=control)


@functools.cache
def push(rtol=None):
    """Return the motion, by the default scheme with a tolerance, else by time steps."""
    how = {"rtol": rtol, "atol": 1e-2 * rtol} if rtol else {"scheme": "time-stepping", "dt": 1e-4}
    return simulate(pushed_by_finger(), [*FLAT, 0.0], np.zeros(7), 0.4, **how)


@pytest.mark.parametrize("rtol", [1e-5, 1e-7])
def test_finger_that_slows_down_does_not_pull_a_box(rtol):
    """Face contact and floor share friction in many ways; the motion is that of equal compliances."""
    scene, located = pushed_by_finger(), push(rtol)
    labels = [contact.label for contact in scene.contacts if contact.label.startswith("push")]
    times = np.linspace(0.0, 0.4, 401)
    normal = np.array([located.forces(label, times)[:, 2] for label in labels])
    assert normal.min() > -1e-8 * G
    assert located.q[-1] == pytest.approx(push(1e-9).q[-1], abs=10.0 * rtol)
    assert located.q[-1] == pytest.approx(push().q[-1], abs=5e-4)


def forces_of_compliances(finger, speed, compliance):
    """Return forces (4, 2) on the box in its plane of symmetry, at its corners and at those of the finger.

    They are normal and tangential forces for relative accelerations −`compliance` times the forces, within
    Coulomb's law. All combinations of open, sticking and yielding contacts are tried.
    """
    lengths, height = np.array(SIZE), np.array([-0.01, 0.03])
    inertia = (lengths[0] ** 2 + lengths[2] ** 2) / 12.0
    drive = STIFFNESS * (GOAL - finger) - DAMPING * speed
    # unknowns: accelerations of the box (x, z, pitch) and of the finger, then four pairs (normal, tangential)
    ends = 0.5 * lengths[0] * np.array([-1.0, 1.0])
    for floor in itertools.product((True, False), repeat=2):
        for states in itertools.product(("open", "sticks", 1.0, -1.0), repeat=2):
            A, b = np.zeros((12, 12)), np.zeros(12)
            A[0, 0], A[1, 1], A[2, 2], A[3, 3], b[1], b[3] = 1.0, 1.0, inertia, 0.5, -G, drive
            for i, closed in enumerate(floor):
                n, t = 4 + 2 * i, 5 + 2 * i
                A[1, n], A[0, t], A[2, n], A[2, t] = -2.0, -2.0, 2.0 * ends[i], lengths[2]
                A[t, [t, n]] = 1.0, MU
                A[n, n] = compliance if closed else 1.0
                A[n, [1, 2]] = closed * np.array([1.0, -ends[i]])
            for i, state in enumerate(states):
                n, t = 8 + 2 * i, 9 + 2 * i
                A[0, n], A[1, t], A[3, n] = -2.0, -2.0, 2.0
                A[2, n], A[2, t] = -2.0 * height[i], -lengths[0]
                A[n, n] = A[t, t] = compliance if state == "sticks" else 1.0
                if state != "open":
                    A[n, [0, 2, 3, n]] = 1.0, height[i], -1.0, compliance
                    A[t, [1, 2]] = (state == "sticks") * np.array([1.0, 0.5 * lengths[0]])
                    A[t, n] = 0.0 if state == "sticks" else state * GRASP
            x = np.linalg.solve(A, b)
            forces, slip = x[4:].reshape(4, 2), x[1] + 0.5 * lengths[0] * x[2]
            opening = np.array([*(x[1] - ends * x[2]), *(x[0] + height * x[2] - x[3])])
            closed = np.array([*floor, *(state != "open" for state in states)])
            valid = (forces[closed, 0] >= 0.0).all() and (opening[~closed] >= 0.0).all()
            for state, (normal, tangential) in zip(states, forces[2:], strict=True):
                valid &= state != "sticks" or abs(tangential) <= GRASP * normal
                valid &= isinstance(state, str) or state * slip >= 0.0
            if valid:
                return forces
    raise AssertionError("no forces satisfy Coulomb's law")


def test_shared_forces_of_a_push_are_those_of_small_compliances():
    located = push(1e-9)
    for t in (0.06, 0.09, 0.1, 0.107):
        q, v = located.at(t)
        expected = forces_of_compliances(q[7], v[6], 1e-6)
        normals = [located.forces(f"floor corner {k}", t)[2] for k in (1, 2, 3, 4)]
        normals += [located.forces(label, t)[2] for label in ("push", "push 2", "push 3", "push 4")]
        assert sorted(normals) == pytest.approx(sorted(np.repeat(expected[:, 0], 2)), abs=1e-4)


@pytest.mark.parametrize(("start", "yields"), [(0.06, False), (0.095, True)])
def test_derivatives_of_a_push_are_those_of_differences_or_none(start, yields):
    scene = pushed_by_finger()
    q, v = push(1e-11).at(start)
    options = {"rtol": 1e-12, "atol": 1e-14}
    found = simulate(scene, q, v, 0.008, **options, sensitivities=("state",)).sensitivity(0.008)
    assert (Boundary.STICK_THRESHOLD in found.boundary) == yields
    if yields:  # a sticking contact at its cone shares the load of sliding ones
        assert np.isnan(found.state).all()
        return
    together, step = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 1e-4
    for change in (np.array([*together, *np.zeros(7)]), np.array([*np.zeros(7), *together])):
        ends = []
        for side in (step, -step):
            moved = pin.integrate(scene.model, q, side * change[:7])
            run = simulate(scene, moved, v + side * change[7:], 0.008, **options)
            ends.append((run.q[-1], run.v[-1]))
        (q1, v1), (q0, v0) = ends
        slope = np.concatenate([pin.difference(scene.model, q0, q1), v1 - v0]) / (2.0 * step)
        assert found.state @ change == pytest.approx(slope, abs=1e-7)


def test_boxes_that_slide_side_by_side_share_their_load_as_in_time_steps():
    """They rub on a slope with different friction and on each other, everywhere at the bound of friction."""
    axes = pin.exp3(0.55 * np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)) @ pin.exp3(np.array([0.0, 0.0, 0.7]))
    slope_plane, scene = Plane(normal=tuple(axes[:, 2])), boxes(2, SIZE, 1.0)
    contacts = [
        Contact(geometry=f"box_{k}_0", plane=slope_plane, friction=mu, name=f"floor {k}")
        for k, mu in enumerate((0.5, 0.1))
    ]
    contacts.append(Contact(geometry="box_1_0", plane=Shape("box_0_0"), friction=0.3, name="pair"))
    scene = dataclasses.replace(scene, contacts=contacts)
    turn, q0 = pin.Quaternion(axes).coeffs(), []
    for place in ([0.0, 0.0, 0.05], [0.0, 0.2, 0.05]):
        q0 += [*(axes @ place), *turn]
    located = simulate(scene, q0, np.zeros(12), 0.3)
    stepped = simulate(scene, q0, np.zeros(12), 0.3, scheme="time-stepping", dt=1e-3)
    assert located.q[-1] == pytest.approx(stepped.q[-1], abs=3.5e-5)  # of 0.11 m
    for label in [contact.label for contact in scene.contacts if contact.label.startswith("floor")]:
        for t in (0.0505, 0.1505, 0.2505):
            assert located.forces(label, t) == pytest.approx(stepped.forces(label, t), abs=0.1)


@pytest.mark.parametrize("dt", [1e-3, 7e-4, 2.3e-4])
def test_flat_landing_with_restitution_on_one_of_two_floors(dt):
    """The contacts without restitution must not slow down the impact of the others before it."""
    scene = boxes(1, SIZE, 1.0)
    floors = [
        Contact(
            geometry="box_0_0",
            plane=Box(size=(1, 1, 0.2), center=(side, 0, -0.1), name=name),
            friction=0.3,
            restitution=e,
        )
        for side, name, e in ((-0.5, "clay", 0.0), (0.5, "rubber", 0.5))
    ]
    scene = dataclasses.replace(scene, contacts=floors)
    start = [0, 0, 0.35, *UP], np.zeros(6), 0.26
    exact = simulate(scene, *start, scheme="event-driven")
    found = simulate(scene, *start, scheme="time-stepping", dt=dt)
    assert abs(exact.v[-1, 4]) > 1.0
    assert np.abs(found.v[-1] - exact.v[-1]).max() < 1e-3
    assert found.energy.total[-1] == pytest.approx(exact.energy.total[-1], abs=1e-4)
