"""Cylinders, cones and rings that stand on a rim, fall flat, rock and topple."""

from __future__ import annotations

import pickle
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinimpact
from pinimpact import Contact, InputError, Plane, Scene, SimulationError

from .scene_models import G, free_body, run, shaped_body

MASS, RADIUS, LENGTH = 2.0, 0.1, 0.3
MIDDLE = 0.5 * LENGTH
SCHEMES = ["event-driven", "auto", "time-stepping"]
FLOOR = Plane(name="floor")


def can(plane=FLOOR, rim_points=None, **coefficients):
    inertia = pin.Inertia.FromCylinder(MASS, RADIUS, LENGTH)
    robot = shaped_body(coal.Cylinder(RADIUS, LENGTH), inertia)
    contact = Contact(geometry="thing_0", plane=plane, rim_points=rim_points, **coefficients)
    return Scene(robot, contacts=contact)


def placed(rotation, height):
    return np.array([0.0, 0.0, height, *pin.Quaternion(rotation).coeffs()])


def leaning(angle, turn=0.0):
    """Return the configuration of a can on the floor, tilted about x after a turn about its axis."""
    height = RADIUS * np.sin(angle) + MIDDLE * np.cos(angle)
    return placed(pin.utils.rotate("x", angle) @ pin.utils.rotate("z", turn), height)


STANDING = placed(np.eye(3), MIDDLE)


def on_slope(angle, direction, friction):
    """Return a can that stands on a slope falling towards a direction [rad] in its axes, and the normal."""
    towards = np.array([np.cos(direction), np.sin(direction), 0.0])
    normal = np.sin(angle) * towards + [0.0, 0.0, np.cos(angle)]
    rotation = pin.exp3(angle * np.cross([0.0, 0.0, 1.0], towards))
    scene = can(Plane(normal=tuple(normal), name="slope"), friction=friction)
    return scene, np.append(MIDDLE * normal, pin.Quaternion(rotation).coeffs())


def turned(one, other):
    """Return the angle between two orientations."""
    between = pin.Quaternion(one[3:7]).inverse() * pin.Quaternion(other[3:7])
    return 2.0 * np.arcsin(np.linalg.norm(between.coeffs()[:3]))


def tilt(q):
    return np.arccos(min(pin.Quaternion(q[3:7]).matrix()[2, 2], 1.0))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_can_stands_for_a_minute(scheme):
    trajectory = run(can(friction=0.5, restitution=0.3), STANDING, np.zeros(6), 60.0, scheme=scheme)
    assert np.abs(trajectory.q[-1] - STANDING).max() <= 1e-9
    assert trajectory.statistics["steps"] <= 10
    every = trajectory.contacts
    weight = sum(trajectory.forces_world(one.label, [30.0])[0] for one in every if one.of_rim)
    assert weight == pytest.approx([0.0, 0.0, MASS * G], abs=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_can_that_lands_flat_bounces_like_a_ball(scheme):
    e, drop = 0.5, 0.2
    scene = can(friction=0.5, restitution=e)
    start = placed(np.eye(3), MIDDLE + drop)
    trajectory = run(scene, start, np.zeros(6), np.sqrt(2 * drop / G) * (1 + 2 * e + e * e), scheme=scheme)
    top = MIDDLE + e**4 * drop
    assert trajectory.q[-1, 2] == pytest.approx(top, abs=2e-9 if scheme != "time-stepping" else 1e-4)
    assert tilt(trajectory.q[-1]) <= 1e-7


def flat_cans(count, **coefficients):
    """Return a scene of free cans in a row."""
    model, shapes, contacts = pin.Model(), pin.GeometryModel(), []
    for k in range(count):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"can {k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromCylinder(MASS, RADIUS, LENGTH), pin.SE3.Identity())
        model.addJointFrame(joint)
        solid = coal.Cylinder(RADIUS, LENGTH)
        shapes.addGeometryObject(pin.GeometryObject(f"can {k}", joint, pin.SE3.Identity(), solid))
        contacts.append(Contact(geometry=f"can {k}", plane=FLOOR, **coefficients))
    return Scene(pin.RobotWrapper(model, shapes), contacts=contacts)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("scheme", ["auto", "time-stepping"])
def test_many_cans_land_flat_together(scheme):
    count, e, drop = 8, 0.5, 0.2
    start = np.concatenate([[0.5 * k, 0, MIDDLE + drop, 0, 0, 0, 1] for k in range(count)])
    scene, falls = flat_cans(count, friction=0.5, restitution=e), np.sqrt(2 * drop / G)
    trajectory = run(scene, start, np.zeros(6 * count), falls * (1 + e), 1e-3, scheme=scheme)
    assert trajectory.q[-1, 2::7] == pytest.approx(np.full(count, MIDDLE + e**2 * drop), abs=1e-3)
    assert max(tilt(q) for q in trajectory.q[-1].reshape(count, 7)) <= 1e-6
    moving = np.tile([0.0, 0, -1.0, 0, 0, 0], count)
    standing = start - np.tile([0, 0, drop, 0, 0, 0, 0], count)
    trajectory = run(scene, standing, moving, 1e-3, 1e-3, scheme=scheme)
    assert trajectory.v[-1, 2::6] == pytest.approx(np.full(count, e - 1e-3 * G), abs=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("direction", [0.0, 0.1, np.pi / 16])
def test_can_slides_down_a_slope_without_tipping(direction, scheme):
    angle, mu, duration = 0.3, 0.2, 0.3
    scene, start = on_slope(angle, direction, mu)
    trajectory = run(scene, start, np.zeros(6), duration, scheme=scheme)
    way = 0.5 * G * (np.sin(angle) - mu * np.cos(angle)) * duration**2
    assert np.linalg.norm(trajectory.q[-1, :3] - start[:3]) == pytest.approx(way, rel=1e-10)
    assert trajectory.q[-1, 3:] == pytest.approx(start[3:], abs=1e-10)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_spin_about_the_axis_decays_as_that_of_a_ring(scheme):
    """Each point of the circle bears the same load, so the torque is μ m g ρ."""
    mu, spin = 0.3, 20.0
    trajectory = run(can(friction=mu), STANDING, np.array([0, 0, 0, 0, 0, spin]), 0.2, scheme=scheme)
    left = spin - mu * G * RADIUS * 0.2 / (0.5 * RADIUS**2)
    assert trajectory.v[-1, 5] == pytest.approx(left, rel=1e-10 if scheme != "time-stepping" else 1e-3)
    assert np.abs(trajectory.v[-1, :5]).max() <= 1e-9


@pytest.mark.parametrize("direction", [0.0, np.pi / 16])
@pytest.mark.parametrize("scheme", ["event-driven", "auto"])
def test_can_tips_on_a_slope_as_a_circle_does(scheme, direction):
    """It tips where its weight leaves the circle, tan θ = 2 ρ / l, also halfway between two points of it."""
    critical, duration = np.arctan2(RADIUS, MIDDLE), 0.1
    about_rim = MASS * ((3 * RADIUS**2 + LENGTH**2) / 12 + RADIUS**2 + MIDDLE**2)
    for part in (0.999, 1.001, 1.02):
        scene, start = on_slope(part * critical, direction, 2.0)
        # where the polygon tips and the circle does not, each event may change the height by the tolerance
        audit = 20.0 if part < 1.0 else 1e-2
        trajectory = run(scene, start, np.zeros(6), duration, audit, scheme=scheme)
        angle = turned(trajectory.q[-1], start)
        torque = MASS * G * np.hypot(RADIUS, MIDDLE) * np.sin((part - 1.0) * critical)
        # the polygon has taken the first part of the motion
        assert angle == pytest.approx(max(0.5 * torque / about_rim * duration**2, 0.0), rel=0.05, abs=3e-5)


def test_can_that_begins_to_tip_in_time_steps_is_held_by_its_circle():
    scene, start = on_slope(0.999 * np.arctan2(RADIUS, MIDDLE), np.pi / 16, 2.0)
    angles = []
    for dt in (1e-3, 1e-4):
        q = run(scene, start, np.zeros(6), 0.05, scheme="time-stepping", dt=dt).q[-1]
        angles.append(turned(q, start))
    assert angles[1] <= 0.2 * angles[0] <= 2e-3


def rocked(scene, q0):
    """Return the ratio of the angular speeds after and before the can falls flat."""
    trajectory = run(scene, q0, np.zeros(6), 0.12)
    impacts = [one for one in trajectory.impacts if np.linalg.norm(one.v_before[3:]) > 0.1]
    return np.linalg.norm(impacts[-1].v_after[3:]) / np.linalg.norm(impacts[0].v_before[3:])


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.2])
def test_rocking_can_is_the_limit_of_many_rim_points(turn):
    few, many = (rocked(can(friction=3.0, rim_points=n), leaning(0.1)) for n in (48, 96))
    limit = many + (many - few) / 3.0
    assert rocked(can(friction=3.0), leaning(0.1, turn)) == pytest.approx(limit, rel=2e-3)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("e", [0.0, 0.4])
def test_schemes_agree_on_a_can_that_rocks_to_rest(e):
    scene, start = can(friction=0.5, restitution=e), leaning(0.1)
    ends = [run(scene, start, np.zeros(6), 1.0, 1e-4, scheme=scheme).q[-1] for scheme in SCHEMES]
    assert ends[1] == pytest.approx(ends[0], abs=1e-6)
    assert ends[2] == pytest.approx(ends[0], abs=1e-3)
    assert all(abs(q[2] - MIDDLE) <= 1e-8 and tilt(q) <= 1e-6 for q in ends)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_ring_topples_flat_and_stays_on_the_floor(scheme):
    """It topples about its lowest point, θ̈ = −(4 g/5 ρ) cos θ, at small θ; with spin it keeps rolling."""
    rho, theta = 0.2, 0.02
    robot = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([0.25, 0.25, 0.5]) * rho**2))
    scene = Scene(robot, contacts=Contact("center", FLOOR, friction=0.8, rim=rho, name="rim"))
    q0 = placed(pin.utils.rotate("y", theta), rho * np.sin(theta))
    trajectory = run(scene, q0, np.zeros(6), 0.5, scheme=scheme)
    topples = np.sqrt(2.0 * theta * 5.0 * rho / (4.0 * G))
    first = min(mode.start for mode in trajectory.modes if mode.source != "rim")
    assert first == pytest.approx(topples, rel=1e-4 if scheme != "time-stepping" else 0.1)
    assert trajectory.q[-1, 2] == pytest.approx(0.0, abs=1e-9)
    steps = {"dt": 1e-4} if scheme == "time-stepping" else {}
    spun = run(scene, q0, np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0]), 0.1, scheme=scheme, **steps)
    assert spun.q[:, 2].min() > 0.0


@pytest.mark.parametrize("scheme", SCHEMES)
def test_coin_that_spins_on_its_edge_falls(scheme):
    """Both rims of a thin coin touch in turn; without friction its centre stays above one point."""
    inertia = pin.Inertia.FromCylinder(0.01, 0.02, 0.002)
    robot = shaped_body(coal.Cylinder(0.02, 0.002), inertia)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR))
    angle = 1.2
    q0 = placed(pin.utils.rotate("x", angle), 0.02 * np.sin(angle) + 0.001 * np.cos(angle))
    audit = 1e-3 if scheme == "time-stepping" else 1e-6
    trajectory = run(scene, q0, np.array([0, 0, 0, 0, 5.0, 1.0]), 0.4, audit, scheme=scheme)
    assert np.abs(trajectory.q[:, :2]).max() <= 1e-9
    heights = [
        min(one.gap(scene.model, scene.model.createData(), q) for one in scene.contacts[:1])
        for q in trajectory.q
    ]
    # in time steps the points of the circle replace the lowest point as it turns by more than a quarter
    assert min(heights) >= -(1e-4 if scheme == "time-stepping" else 1e-9)


@pytest.mark.parametrize("seed", [0, 1, 3, 6])
def test_disc_that_rocks_past_flat_keeps_its_energy_in_any_axes(seed):
    """Its lowest point runs around the rim within some 1e-10 s; without friction no force does work."""
    turn = np.eye(3)
    if seed > 0:
        turn = pin.Quaternion(np.random.default_rng(seed).normal(size=4)).normalized().matrix()
    robot = shaped_body(coal.Cylinder(RADIUS, 0.02), pin.Inertia.FromCylinder(1.0, RADIUS, 0.02))
    robot.model.gravity.linear = turn @ [0.0, 0.0, -G]
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=Plane(normal=tuple(turn[:, 2]))))
    lean = pin.utils.rotate("y", 2e-9)
    q0 = np.array([*(turn @ [0.0, 0.0, 0.3]), *pin.Quaternion(turn @ lean).coeffs()])
    v0 = np.array([0.0, 0.0, 0.0, *(lean.T @ np.array([10.0, 0.0, 3.0]) / np.sqrt(0.1))])
    trajectory = pinimpact.simulate(scene, q0, v0, 0.4, scheme="event-driven", rtol=1e-9, atol=1e-11)
    assert len(trajectory.impacts) == 2
    since = trajectory.impacts[-1].time
    energy = trajectory.energy
    total = (energy.kinetic + energy.potential)[trajectory.t > since]
    assert np.ptp(total) <= 1e-6 * total[0]
    # the height of a symmetric top on its rim, with the constants of its motion just after the impact
    q, v = trajectory.at(since)
    height = _height_of_top(turn, q, v, 0.4 - since)
    assert (turn.T @ trajectory.q[-1, :3])[2] == pytest.approx(height, abs=1e-5)


def _height_of_top(turn, q, v, duration):
    """Return the height of the disc of 1 kg after a time on its rim, without friction."""
    inertia = pin.Inertia.FromCylinder(1.0, RADIUS, 0.02).inertia
    about, along = inertia[0, 0], inertia[2, 2]
    rotation = turn.T @ pin.Quaternion(q[3:7]).matrix()
    omega, axis = rotation @ v[3:], rotation[:, 2] * np.sign(rotation[2, 2])
    angle = np.arccos(axis[2])
    momentum = (about * (omega - (omega @ axis) * axis) + along * (omega @ axis) * axis)[2]
    spin = along * (omega @ axis)
    rate = -np.cross(omega, axis)[2] / np.sin(angle)

    def slope(t, y):
        s, c = np.sin(y[0]), np.cos(y[0])
        z_1, z_2 = RADIUS * c - 0.01 * s, -0.01 * c - RADIUS * s
        leads = (momentum - spin * c) / (about * s)
        force = G * z_1 + leads * spin - about * leads**2 * c / s
        return [y[1], (-force - z_1 * z_2 * y[1] ** 2) / (about + z_1**2)]

    angle = solve_ivp(slope, (0.0, duration), [angle, rate], "DOP853", rtol=1e-11, atol=1e-13).y[0, -1]
    return 0.01 * np.cos(angle) + RADIUS * np.sin(angle)


def test_spinning_can_that_falls_flat_touches_at_all_points():
    """Its gaps differ by the tolerance when it lies down, and the largest is above it."""
    robot = shaped_body(coal.Cylinder(RADIUS, 0.2), pin.Inertia.FromCylinder(1.0, RADIUS, 0.2))
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR))
    q0, v0 = placed(np.eye(3), 0.7500000000000001), np.zeros(6)  # a bounce earlier, the last digits decide
    v0[[0, 4, 5]] = 0.31622776601683794, 9.486832980505138, 31.622776601683793
    trajectory = pinimpact.simulate(scene, q0, v0, 0.52)
    assert len({one.source for one in trajectory.modes if one.end == trajectory.t[-1]}) == 16


def test_cone_stands_on_its_base_and_cannot_on_its_apex():
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([0.004, 0.004, 0.003]))
    robot = shaped_body(coal.Cone(0.1, 0.3), inertia)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR, friction=0.5))
    trajectory = run(scene, STANDING, np.zeros(6), 1.0)
    assert trajectory.q[-1] == pytest.approx(STANDING, abs=1e-12)
    upside_down = placed(pin.utils.rotate("x", np.pi - 0.01), MIDDLE)
    trajectory = run(scene, upside_down, np.zeros(6), 2.0)
    assert {mode.source for mode in trajectory.modes} >= {"thing_0 apex on floor", "thing_0 rim on floor"}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_can_stands_on_a_turning_lift(scheme):
    """The plate rises at a constant acceleration and turns; the can rises and turns with it."""
    model = pin.Model()
    drive = pin.JointModelComposite(2)
    drive.addJoint(pin.JointModelPZ())
    drive.addJoint(pin.JointModelRZ())
    plate = model.addJoint(0, drive, pin.SE3.Identity(), "plate")
    model.appendBodyToJoint(plate, pin.Inertia(1e3, np.zeros(3), np.eye(3) * 1e3), pin.SE3.Identity())
    model.addFrame(pin.Frame("plate", plate, pin.SE3.Identity(), pin.FrameType.BODY))
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(free, pin.Inertia.FromCylinder(MASS, RADIUS, LENGTH), pin.SE3.Identity())
    model.addJointFrame(free)
    shapes, solid = pin.GeometryModel(), coal.Cylinder(RADIUS, LENGTH)
    shapes.addGeometryObject(pin.GeometryObject("can", free, pin.SE3.Identity(), solid))
    contact = Contact(geometry="can", plane=Plane(body="plate", name="top"), friction=0.8)
    scene = Scene(pin.RobotWrapper(model, shapes), contacts=contact)
    turn, lift, away, duration = 2.0, 3.0, 0.2, 0.5
    q0 = np.array([0.0, 0.0, away, 0.0, MIDDLE, 0, 0, 0, 1.0])
    v0 = np.array([0.0, turn, 0, away * turn, 0, 0, 0, turn])
    stepper = pinimpact.Stepper(scene, q0, v0, scheme=scheme)
    for _ in range(500):
        q, _ = stepper.step(np.array([(1e3 + MASS) * (G + lift), 0, 0, 0, 0, 0, 0, 0]), duration / 500)
    angle, height = turn * duration, 0.5 * lift * duration**2
    assert q[0] == pytest.approx(height, rel=1e-6)
    place = [away * np.cos(angle), away * np.sin(angle), MIDDLE + height]
    assert q[2:5] == pytest.approx(place, abs=1e-4)
    assert tilt(q[2:]) <= 1e-8


def random_motion(seed):
    """Return scene, configuration and velocity of a cylinder, cone or ring near a plane, often flat on it."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["cylinder", "cone", "ring"])
    mass, rho = 10 ** rng.uniform(-1, 1), 0.1 * 10 ** rng.uniform(-0.5, 0.3)
    length = float(rho * rng.choice([0.05, 2.0, 8.0]))
    slope, azimuth = float(rng.choice([0.0, rng.uniform(0.0, 0.4)])), rng.uniform(0.0, 2.0 * np.pi)
    towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    normal = np.sin(slope) * towards + [0.0, 0.0, np.cos(slope)]
    given = {
        "plane": Plane(normal=tuple(normal), name="floor"),
        "friction": float(rng.choice([0.0, rng.uniform(0.0, 1.2)])),
        "restitution": float(rng.choice([0.0, rng.uniform(0.0, 0.9)])),
        "law": str(rng.choice(["poisson", "newton", "energetic"])),
    }
    if kind == "ring":
        robot = free_body(pin.Inertia(mass, np.zeros(3), np.diag([0.5, 0.5, 1.0]) * mass * rho**2))
        contact, foot = Contact("center", rim=rho, **given), 0.0
    else:
        shape = coal.Cylinder(rho, length) if kind == "cylinder" else coal.Cone(rho, length)
        foot = 0.5 * length
        inertia = pin.Inertia.FromCylinder(mass, rho, length)
        if kind == "cone":
            inertia = inertia.se3Action(pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * foot])))
        robot, contact = shaped_body(shape, inertia), Contact(geometry="thing_0", **given)
    tilted = float(rng.choice([0.0, 10 ** rng.uniform(-9, -1), rng.uniform(0.0, 1.5)]))
    height = rho * np.sin(tilted) + foot * np.cos(tilted) + rng.choice([0.0, rng.uniform(0.0, 0.2)])
    axis = np.array([np.cos(2.0 * azimuth), np.sin(2.0 * azimuth), 0.0])
    rotation = pin.exp3(slope * np.cross([0.0, 0.0, 1.0], towards)) @ pin.exp3(tilted * axis)
    v = np.array([*rng.normal(size=2), 0.0, 0.0, 0.0, 3.0 * rng.normal()]) * rng.choice([0.0, 1.0])
    v[:3] = pin.exp3(tilted * axis).T @ v[:3]
    return Scene(robot, contacts=contact), np.append(height * normal, pin.Quaternion(rotation).coeffs()), v


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("seed", range(24))
def test_random_motions_complete_and_obey_laws(seed):
    scene, q0, v0 = random_motion(seed)
    trajectory = run(scene, q0, v0, 0.5, 1e-4)
    every, data = [one for one in scene.contacts if one.of_rim is None], scene.model.createData()
    for q in trajectory.q[:: max(1, len(trajectory.q) // 100)]:
        assert min(one.gap(scene.model, data, q) for one in every) >= -1e-7


@pytest.mark.parametrize("law", ["poisson", "newton", "energetic"])
def test_impact_of_a_flat_can_is_that_of_its_points(law):
    scene = can(friction=0.3, restitution=0.5, law=law)
    robot = shaped_body(coal.Cylinder(RADIUS, LENGTH), pin.Inertia.FromCylinder(MASS, RADIUS, LENGTH))
    shape = Contact(geometry="thing_0", plane=FLOOR, friction=0.3, restitution=0.5, law=law)
    v = np.array([0.3, 0.1, -1.0, 0.2, -0.1, 2.0])
    hit = pinimpact.impact(robot, robot.data, STANDING, v, shape)
    lower = next(one for one in scene.contacts if one.rim and one.offset[2] < 0.0)
    points = [one for one in scene.contacts if one.of_rim == lower.label]
    assert len(points) == 16
    assert hit.v == pytest.approx(pinimpact.impact(robot, robot.data, STANDING, v, points).v, abs=1e-12)
    straight = pinimpact.impact(robot, robot.data, STANDING, np.array([0, 0, -1.0, 0, 0, 0]), shape)
    assert straight.v == pytest.approx([0, 0, 0.5, 0, 0, 0], abs=1e-12)
    with pytest.raises(InputError, match="lies flat"):
        pinimpact.impact(robot, robot.data, STANDING, v, lower)
    hits = pinimpact.impacts(robot.model, robot.data, [STANDING, leaning(0.1)], v, lower)
    assert np.isnan(hits.v).all(axis=1).tolist() == [True, False]


def test_sliding_can_has_the_derivatives_of_a_sliding_point():
    """x = v² / (2 μ g) at rest."""
    mu, speed = 0.2, 0.7
    scene = can(friction=mu)
    start = np.array([speed, 0, 0, 0, 0, 0])
    trajectory = pinimpact.simulate(scene, STANDING, start, 0.5, sensitivities=("state",))
    assert trajectory.q[-1, 0] == pytest.approx(speed**2 / (2.0 * mu * G), rel=1e-9)
    x = trajectory.sensitivity(0.5).state
    assert x[0, [0, 6]] == pytest.approx([1.0, speed / (mu * G)], rel=1e-8)
    assert x[1, [1, 7]] == pytest.approx([1.0, 0.5 * speed / (mu * G)], rel=1e-8)  # the direction turns
    flat = pinimpact.simulate(scene, leaning(0.1), np.zeros(6), 0.2, sensitivities=("state",))
    assert np.isnan(flat.sensitivity(0.2).state).any()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rocking_can_is_copied_and_pickled(scheme):
    stepper = pinimpact.Stepper(can(friction=0.5, restitution=0.3), leaning(0.1), np.zeros(6), scheme=scheme)
    for _ in range(8):
        stepper.step(np.zeros(6), 0.05)
        twins = stepper.copy(), pickle.loads(pickle.dumps(stepper))
        ends = [one.step(np.zeros(6), 0.05) for one in (*twins, stepper.copy())]
        assert all(np.array_equal(ends[0][0], q) and np.array_equal(ends[0][1], v) for q, v in ends)


def test_scene_of_changed_contacts_keeps_the_points():
    scene = can(friction=0.5)
    other = replace(scene, contacts=[replace(one, friction=0.1) for one in scene.contacts])
    assert len(other.contacts) == len(scene.contacts) == 2 * 17
    speed = run(other, STANDING, np.array([1.0, 0, 0, 0, 0, 0]), 0.1).v[-1, 0]
    assert speed == pytest.approx(1.0 - 0.1 * G * 0.1, rel=1e-9)


def test_held_rim_cannot_lie_flat():
    robot = free_body(pin.Inertia.FromCylinder(MASS, RADIUS, LENGTH))
    held = Contact("center", FLOOR, rim=RADIUS, name="held")
    scene = Scene(robot, held=[held])
    with pytest.raises((SimulationError, InputError), match="lies flat"):
        pinimpact.simulate(scene, placed(np.eye(3), 0.0), np.zeros(6), 0.1)
