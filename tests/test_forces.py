"""Forces along a motion, against closed forms and the balance of momentum."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.geometry.surfaces import contact_axes

from .random_scenes import MODELS, draw
from .scene_models import UP, G, ball, free_body, pendulum, slider


def slope(angle):
    """Return a plane through the origin that descends towards x."""
    return Plane(normal=(np.sin(angle), 0.0, np.cos(angle)))


def along(angle):
    """Return the direction of descent."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


@pytest.mark.parametrize("friction", [0.9, 0.2])
def test_forces_of_point_mass_on_slope(friction):
    angle, mass = 0.5, 3.0
    plane = slope(angle)
    scene = Scene(slider(mass), [Contact("point", plane, name="foot", friction=friction)])
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 0.5)
    normal = mass * G * np.cos(angle)
    held = min(friction * normal, mass * G * np.sin(angle))
    expected = normal * np.array(plane.normal) - held * along(angle)
    times = [0.1, 0.25, 0.5]
    world = trajectory.forces_world("foot", times)
    assert np.abs(world - expected).max() <= 1e-9
    axes = contact_axes(plane.normal)
    assert np.abs(trajectory.forces("foot", times) - world @ axes.T).max() <= 1e-12
    assert trajectory.forces("foot", 0.25)[2] == pytest.approx(normal, abs=1e-9)
    assert trajectory.forces_unique(times).all()


def test_forces_of_ball_rolling_down_slope():
    """Friction on a uniform ball is 2/7 of its weight along the slope."""
    angle, mass, radius = 0.4, 2.0, 0.1
    plane = slope(angle)
    start = radius * np.array(plane.normal)
    scene = Scene(ball(mass, radius), [Contact("center", plane, name="ball", radius=radius, friction=0.6)])
    trajectory = simulate(scene, [*start, *UP], np.zeros(6), 1.0)
    expected = mass * G * (np.cos(angle) * np.array(plane.normal) - 2.0 / 7.0 * np.sin(angle) * along(angle))
    times = np.linspace(0.05, 1.0, 7)
    assert np.abs(trajectory.forces_world("ball", times) - expected).max() <= 1e-8
    position = trajectory.sample(times)[0][:, :3] - radius * np.array(plane.normal)
    assert np.abs(trajectory.center_of_pressure(["ball"], times) - position).max() <= 1e-9  # constraint drift


def test_forces_of_joint_limit_and_dry_friction():
    model = pendulum(2.0, 0.5)
    model.upperPositionLimit[0] = 0.7
    trajectory = simulate(Scene(model), [0.7], [0.0], 0.2, max_step=0.1)
    assert trajectory.joint_forces(0.1).shape == (1,)
    # gravity pulls the joint away from its limit until the sign of gravity changes
    model.gravity.linear = np.array([0.0, 0.0, G])
    trajectory = simulate(Scene(model), [0.7], [0.0], 0.2)
    torque = 2.0 * G * 0.5 * np.sin(0.7)
    assert trajectory.joint_forces([0.0, 0.1, 0.2])[:, 0] == pytest.approx(-torque, abs=1e-9)

    model = pendulum(2.0, 0.5)
    model.friction[:] = 20.0
    held = simulate(Scene(model), [0.7], [0.0], 0.2)
    assert held.joint_forces(0.1)[0] == pytest.approx(torque, abs=1e-9)
    model = pendulum(2.0, 0.5)
    model.friction[:] = 3.0
    sliding = simulate(Scene(model), [0.7], [0.0], 0.2)
    assert sliding.joint_forces(0.1)[0] == pytest.approx(3.0, abs=1e-12)  # it falls back: v < 0


def test_normal_forces_of_tripod_agree_with_statics():
    feet = [(0.3, 0.0, -0.2), (-0.2, 0.25, -0.2), (-0.15, -0.3, -0.2)]
    model = free_body(pin.Inertia(4.0, np.array([0.02, 0.01, 0.05]), 0.1 * np.eye(3)), feet)
    names = [f"tip{k}" for k in range(3)]
    contacts = [Contact(name, Plane(), name=name, friction=0.7) for name in names]
    trajectory = simulate(Scene(model, contacts), [0.0, 0.0, 0.2, *UP], np.zeros(6), 0.3)
    forces = np.array([trajectory.forces_world(name, 0.2) for name in names])
    assert np.abs(forces.sum(0) - [0.0, 0.0, 4.0 * G]).max() <= 1e-9
    # the three normal forces follow from statics alone
    points = np.array(feet)[:, :2]
    weights = np.linalg.solve(np.column_stack([points, np.ones(3)]).T, [0.02, 0.01, 1.0])
    assert np.abs(forces[:, 2] - 4.0 * G * weights).max() <= 1e-8
    assert not trajectory.forces_unique(0.2)  # sideways forces do not
    center = trajectory.center_of_pressure(names, 0.2)
    assert np.abs(center - [0.02, 0.01, 0.0]).max() <= 1e-9


def landing(rtol):
    """Return the motion of a quadruped with dry joints that lands with a sideways speed, slips and sticks."""
    model = MODELS["solo12"].copy()
    q = pin.neutral(model)
    q[7:] = np.tile([0.1, 0.7, -1.4], 4)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    feet = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    q[2] -= min(data.oMf[model.getFrameId(foot)].translation[2] for foot in feet) - 0.01
    contacts = [Contact(foot, Plane(), name=foot, friction=0.5) for foot in feet]
    model.friction[6:] = 0.4
    v = np.zeros(model.nv)
    v[:2] = 0.6, 0.3
    scene = Scene(model, contacts, without=["joint limits"])
    return model, feet, simulate(scene, q, v, 0.25, rtol=rtol, atol=1e-2 * rtol)


def momentum(model, data, q, v):
    """Return linear momentum, and angular momentum about the origin of the world."""
    pin.computeCentroidalMomentum(model, data, q, v)
    linear, angular = data.hg.linear.copy(), data.hg.angular.copy()
    return np.array([*linear, *(angular + np.cross(data.com[0], linear))])


def test_forces_of_landing_satisfy_momentum_balance():
    """Integrate the forces by Gauss quadrature over each step of a motion with slip, stick and lift-off."""
    model, feet, trajectory = landing(1e-10)
    data = model.createData()
    x, weights = np.polynomial.legendre.leggauss(8)
    weight = pin.computeTotalMass(model) * np.array([0.0, 0.0, -G])
    modes = {(interval.source, interval.mode) for interval in trajectory.modes}
    assert {("FL_FOOT", "slip"), ("HR_FOOT", "stick")} & modes
    worst = checked = 0
    for start, end in zip(trajectory.t[:-1], trajectory.t[1:], strict=True):
        if end - start < 1e-7:
            continue
        times = 0.5 * (start + end) + 0.5 * (end - start) * x
        total = np.zeros(6)
        for time, w in zip(times, weights, strict=True):
            q, _ = trajectory.at(time)
            pin.framesForwardKinematics(model, data, q)
            force, moment = weight.copy(), np.cross(pin.centerOfMass(model, data, q), weight)
            for foot in feet:
                push = trajectory.forces_world(foot, time)
                force += push
                moment += np.cross(data.oMf[model.getFrameId(foot)].translation, push)
            total += 0.5 * (end - start) * w * np.array([*force, *moment])
        after = momentum(model, data, *trajectory.at(end, "left"))
        before = momentum(model, data, *trajectory.at(start, "right"))
        worst = max(worst, np.abs(after - before - total).max())
        checked += 1
    assert checked > 20
    assert worst <= 1e-9


def test_forces_of_landing_satisfy_coulombs_law():
    _, feet, trajectory = landing(1e-8)
    for time in np.linspace(0.0, trajectory.t[-1], 400):
        for foot in feet:
            force, mode = trajectory.forces(foot, time), trajectory.mode_at(foot, time)
            tangent = np.hypot(force[0], force[1])
            near = 1e-6 * (1.0 + abs(force[2]))
            if mode == "free":
                assert not force.any()
                continue
            assert force[2] >= -near
            if mode == "slip":
                assert tangent == pytest.approx(0.5 * force[2], abs=near)
    power = np.diff(trajectory.energy.friction)
    assert power.max() <= 1e-9


@pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
@pytest.mark.parametrize("seed", range(1000020, 1000040))
def test_forces_of_random_motions_satisfy_coulombs_law(seed):
    """Check random times of uncontrolled robots, also where forces are not unique."""
    _, scene, q, v, rtol = draw(seed)
    trajectory = simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol)
    times = np.random.default_rng(seed).uniform(0.0, 1.0, 50)
    for contact in scene.contacts:
        forces = trajectory.forces(contact.label, times)
        near = 1e-10 * (1.0 + np.abs(forces).max())
        assert forces[:, 2].min() >= -near
        tangent = np.hypot(forces[:, 0], forces[:, 1])
        assert (tangent - contact.friction * forces[:, 2]).max() <= near
        closed = [trajectory.mode_at(contact.label, time) != "free" for time in times]
        assert not forces[~np.array(closed)].any()
    taken = np.diff(trajectory.energy.friction)
    assert taken.max() <= 10.0 * rtol * trajectory.energy.kinetic.max()
    assert np.diff(trajectory.energy.joints).max() <= 1e-12


def test_forces_are_saved_and_pickled(tmp_path):
    _, feet, trajectory = landing(1e-8)
    path = tmp_path / "landing.npz"
    trajectory.save(path)
    copies = [pinimpact.Trajectory.load(path), pickle.loads(pickle.dumps(trajectory))]
    times = np.linspace(0.0, trajectory.t[-1], 200)
    largest = max(np.abs(trajectory.forces(foot, times)).max() for foot in feet)
    for copy in copies:
        for foot in feet:
            difference = copy.forces(foot, times) - trajectory.forces(foot, times)
            assert np.median(np.abs(difference)) <= 1e-9 * largest
            assert np.abs(difference).max() <= 1e-3 * largest
        assert np.abs(copy.joint_forces(times) - trajectory.joint_forces(times)).max() <= 1e-3 * largest
        assert (copy.forces_unique(times) == trajectory.forces_unique(times)).all()


def test_invalid_requests_of_forces_raise():
    scene = Scene(slider(), [Contact("point", Plane(), name="foot", friction=0.5)])
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 0.1)
    with pytest.raises(pinimpact.UnknownNameError, match=r"no contact is called 'fot'.*'foot'"):
        trajectory.forces("fot", 0.0)
    free = simulate(Scene(slider()), np.zeros(3), np.zeros(3), 0.1)
    with pytest.raises(pinimpact.UnknownNameError, match="no contact is called 'foot'; there are none"):
        free.forces("foot", 0.0)
    bounded = slider()
    bounded.lowerPositionLimit[2], bounded.upperPositionLimit[2] = 0.0, 1.0
    held = simulate(Scene(bounded, []), np.zeros(3), np.zeros(3), 0.1)
    (name,) = (one for one in held.sources if one.endswith(" lower"))
    with pytest.raises(pinimpact.UnknownNameError, match="joint_forces"):  # they are not zero
        held.forces(name, 0.05)
    with pytest.raises(pinimpact.InputError, match="lies outside the trajectory"):
        trajectory.forces("foot", 0.2)
    with pytest.raises(pinimpact.InputError, match='"left" or "right"'):
        trajectory.forces("foot", 0.0, side="after")
    assert trajectory.forces("foot", []).shape == (0, 3)
    assert trajectory.center_of_pressure("foot", []).shape == (0, 3)
    assert trajectory.joint_forces([]).shape == (0, 3)
    assert trajectory.forces_unique([]).dtype == np.bool_
    with pytest.raises(pinimpact.InputError, match=r"t: 9\.0 lies outside"):
        trajectory.at(np.float64(9.0))


def test_open_contact_has_zero_force():
    scene = Scene(slider(), [Contact("point", Plane(), name="foot", restitution=0.5)])
    trajectory = simulate(scene, [0.0, 0.0, 1.0], np.zeros(3), 0.3)
    assert not trajectory.forces("foot", [0.0, 0.1, 0.3]).any()
    assert np.isnan(trajectory.center_of_pressure(["foot"], 0.1)).all()
    assert not trajectory.joint_forces(0.1).any()


CORNERS = [(0.3, 0.0, -0.2), (-0.2, 0.25, -0.2), (-0.15, -0.3, -0.2), (0.1, 0.1, -0.2)]


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize(
    ("feet", "mu", "speed", "unique"),
    [
        (3, 0.0, 0.0, True),
        (4, 0.0, 0.0, False),
        (3, 0.7, 0.0, False),  # sideways forces on three feet
        (3, 0.7, 5.0, True),
        (4, 0.7, 5.0, False),  # one of the four has no force
        (1, 0.7, 0.0, True),
    ],
)
def test_both_schemes_report_where_forces_are_unique(scheme, feet, mu, speed, unique, tmp_path):
    """Three normal forces follow from statics; of more forces, or forces along the floor, only sums do."""
    if feet == 1:
        model, q0 = slider(), np.zeros(3)
        contacts = [Contact("point", Plane(), friction=mu)]
    else:
        model = free_body(pin.Inertia(4.0, np.array([0.02, 0.01, 0.05]), 0.1 * np.eye(3)), CORNERS)
        contacts, q0 = [Contact(f"tip{k}", Plane(), friction=mu) for k in range(feet)], [0.0, 0.0, 0.2, *UP]
    trajectory = simulate(Scene(model, contacts), q0, speed * np.eye(model.nv)[0], 0.3, scheme=scheme)
    trajectory.save(tmp_path / "motion.npz")
    copies = pickle.loads(pickle.dumps(trajectory)), pinimpact.Trajectory.load(tmp_path / "motion.npz")
    for run in (trajectory, *copies):
        assert run.forces_unique([0.1, 0.2, 0.3]).tolist() == [unique] * 3
        assert run.forces_unique(0.2) == unique


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_forces_of_a_limit_and_a_contact_that_bear_one_load_are_not_unique(scheme):
    def unique(contacts, held=()):
        model = slider()
        model.lowerPositionLimit[2], model.upperPositionLimit[2] = 0.0, 1.0
        scene = Scene(model, contacts, held=held)
        return simulate(scene, np.zeros(3), np.zeros(3), 0.1, scheme=scheme).forces_unique(0.05)

    foot = Contact("point", Plane(), friction=0.5)
    assert unique([])
    assert not unique([foot])
    assert not unique([], held=[foot])
