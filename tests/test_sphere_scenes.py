"""Motions in contact with spheres and past them, against closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Scene, Sphere

from .scene_models import UP, G, ball, pendulum, run, slider

DIRECTIONS = {
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
    "across": (0.6, 0.0, -0.8),
    "askew": (0.48, 0.6, 0.64),
}


def towards(up):
    """Return an orthonormal frame with rows (side, other side, up)."""
    up = np.array(up)
    side = np.cross(up, [0.3, 1.0, 0.2])
    side /= np.linalg.norm(side)
    return np.array([side, np.cross(up, side), up])


def weightless(model):
    model.gravity.linear = np.zeros(3)
    return model


@pytest.mark.parametrize("up", DIRECTIONS.values(), ids=DIRECTIONS)
def test_sliding_point_leaves_sphere_at_two_thirds_of_its_height(up):
    side, _, crown = towards(up)
    model, radius, start = slider(), 0.7, 0.05
    model.gravity.linear = -G * crown
    center = np.array([0.3, -0.2, 0.1])
    scene = Scene(model, [Contact("point", Sphere(center, radius))])
    q0 = center + radius * (np.sin(start) * side + np.cos(start) * crown)
    trajectory = run(scene, q0, np.zeros(3), 1.5)
    (slip,) = trajectory.modes
    assert (slip.mode, slip.start) == ("slip", 0.0)
    q, v = trajectory.at(slip.end)
    height = (q - center) @ crown / radius
    assert height == pytest.approx(2.0 / 3.0 * np.cos(start), abs=1e-8)
    assert v @ v == pytest.approx(2.0 * G * radius * (np.cos(start) - height), rel=1e-7)
    assert np.linalg.norm(q - center) == pytest.approx(radius, abs=1e-9)
    assert not trajectory.impacts
    # from there on it falls freely
    rest = trajectory.t[-1] - slip.end
    assert trajectory.q[-1] == pytest.approx(q + rest * v - 0.5 * G * rest**2 * crown, abs=1e-7)


def rolling(mu, up, start=0.05):
    """Release a solid ball near the top of a sphere; return the trajectory, and cos θ as a function of t."""
    side, _, crown = towards(up)
    r, R = 0.1, 0.4
    model = ball(2.0, r)
    model.gravity.linear = -G * crown
    scene = Scene(model, [Contact("center", Sphere(radius=R), friction=mu, radius=r, name="ball")])
    q0 = [*((R + r) * (np.sin(start) * side + np.cos(start) * crown)), *UP]
    trajectory = run(scene, q0, np.zeros(6), 1.2)
    return trajectory, lambda t: trajectory.at(t)[0][:3] @ crown / (R + r)


@pytest.mark.parametrize("up", DIRECTIONS.values(), ids=DIRECTIONS)
@pytest.mark.parametrize("mu", [0.2, 0.8, 3.0])
def test_ball_rolls_on_ball_until_friction_is_insufficient(mu, up):
    """While rolling, normal and tangential force over the weight are (17 c − 10 c₀)/7 and 2/7 √(1 − c²)."""
    trajectory, height = rolling(mu, up)
    stick, slip = trajectory.modes
    assert (stick.mode, slip.mode) == ("stick", "slip")
    assert slip.start == stick.end
    c, first = height(stick.end), np.cos(0.05)
    assert mu * (17.0 * c - 10.0 * first) == pytest.approx(2.0 * np.sqrt(1.0 - c * c), abs=1e-6)
    _, v = trajectory.at(stick.end)
    assert v[:3] @ v[:3] == pytest.approx(10.0 / 7.0 * G * 0.5 * (first - c), rel=1e-7)


def test_rolling_ball_leaves_ball_at_ten_seventeenths_of_its_height():
    errors = []
    for mu in (1e3, 1e5):
        trajectory, height = rolling(mu, (0.0, 0.0, 1.0))
        errors.append(abs(height(trajectory.modes[-1].end) - 10.0 / 17.0 * np.cos(0.05)))
    assert errors[0] < 1e-3
    assert errors[1] < 1e-5


def pressed(radius, force):
    """Return a control that presses a point towards the origin."""
    return lambda t, q, v: -force / np.linalg.norm(q) * q


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.1, 1.0, 0.05)])
def test_friction_stops_point_that_circles_sphere(axis):
    """m v̇ = −μ (F − m v²/R) gives v = V tanh(artanh(v₀/V) − μ V t/R), V² = F R/m, for two turns."""
    m, radius, force, mu = 2.0, 0.5, 9.0, 0.05
    side, ahead, _ = towards(np.array(axis) / np.linalg.norm(axis))
    fastest = np.sqrt(force * radius / m)
    begin = np.arctanh(0.9)
    scene = Scene(
        weightless(slider(m)),
        [Contact("point", Sphere(radius=radius), friction=mu)],
        control=pressed(radius, force),
    )
    stop = begin * radius / (mu * fastest)
    trajectory = run(scene, radius * side, 0.9 * fastest * ahead, stop + 0.5)
    slip, stick = trajectory.modes
    assert (slip.mode, stick.mode) == ("slip", "stick")
    assert slip.end == pytest.approx(stop, rel=1e-6)
    for t in np.linspace(0.0, stop, 7)[1:-1]:
        left = begin - mu * fastest * t / radius
        turned = np.log(np.cosh(begin) / np.cosh(left)) / mu
        q, v = trajectory.at(float(t))
        assert q == pytest.approx(radius * (np.cos(turned) * side + np.sin(turned) * ahead), abs=1e-6)
        assert np.linalg.norm(v) == pytest.approx(fastest * np.tanh(left), rel=1e-6)
    turned = np.log(np.cosh(begin)) / mu
    assert turned > 4.0 * np.pi
    assert trajectory.q[-1] == pytest.approx(
        radius * (np.cos(turned) * side + np.sin(turned) * ahead), abs=1e-6
    )


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
def test_spinning_sphere_drags_pressed_point(axis):
    """v = V tanh(μ V t/R) with V² = F R/m up to the speed of the surface; then the point sticks to it."""
    m, radius, force, mu, spin = 2.0, 0.5, 9.0, 0.4, 2.0
    side, ahead, axis = towards(axis)
    surface = Sphere(radius=radius, angular_velocity=spin * axis)
    scene = Scene(
        weightless(slider(m)), [Contact("point", surface, friction=mu)], control=pressed(radius, force)
    )
    trajectory = run(scene, radius * side, np.zeros(3), 6.0)
    slip, stick = trajectory.modes
    assert (slip.mode, stick.mode) == ("slip", "stick")
    fastest = np.sqrt(force * radius / m)
    caught = radius / (mu * fastest) * np.arctanh(spin * radius / fastest)
    assert slip.end == pytest.approx(caught, rel=1e-7)
    turned = np.log(np.cosh(mu * fastest * caught / radius)) / mu + spin * (6.0 - caught)
    around = np.cos(turned) * side + np.sin(turned) * ahead
    assert trajectory.q[-1] == pytest.approx(radius * around, abs=1e-6)
    assert trajectory.v[-1] == pytest.approx(spin * radius * np.cross(axis, around), abs=1e-6)
    # the work of the surface is the gain of kinetic energy plus the energy dissipated
    gained = 0.5 * m * (spin * radius) ** 2
    assert trajectory.energy.surface[-1] == pytest.approx(m * (spin * radius) ** 2, rel=1e-6)
    assert trajectory.energy.friction[-1] == pytest.approx(-gained, rel=1e-6)


def test_held_ball_rolls_around_another_through_its_lowest_point():
    r, R = 0.1, 0.4
    scene = Scene(ball(2.0, r), held=[Contact("center", Sphere(radius=R), radius=r)])
    q0 = [(R + r) * np.sin(1.0), 0.0, (R + r) * np.cos(1.0), *UP]
    trajectory = run(scene, q0, np.zeros(6), 4.0)
    places = trajectory.q[:, :3]
    assert np.abs(np.linalg.norm(places, axis=1) - (R + r)).max() < 1e-10
    assert places[:, 2].min() < -0.98 * (R + r)
    speeds = np.einsum("ij,ij->i", trajectory.v[:, :3], trajectory.v[:, :3])
    assert speeds == pytest.approx(10.0 / 7.0 * G * (q0[2] - places[:, 2]), abs=1e-6)
    assert np.abs(places[:, 1]).max() < 1e-9


@pytest.mark.parametrize(
    ("radius", "depth"), [(1.0, 1e-3), (1.0, 1e-6), (1.0, 1e-9), (1e-3, 1e-3), (1e-3, 1e-6)]
)
def test_grazing_flights_past_sphere(radius, depth):
    """A step is as long as the flight, so the impact is found by the bound of the gap's curvature only."""
    model = weightless(slider())
    center = np.array([5.0, 0.2, -0.1])
    contact = Contact("point", Sphere(center, radius), restitution=1.0)
    scene = Scene(model, [contact], resting_speed=1e-9)
    for sign in (1.0, -1.0):
        aside = radius * (1.0 + sign * depth)
        q0 = np.array([0.0, 0.2, aside - 0.1])
        trajectory = run(scene, q0, np.array([3.0, 0.0, 0.0]), 4.0)
        if sign > 0:
            assert not trajectory.impacts
            continue
        (hit,) = trajectory.impacts
        assert hit.time == pytest.approx(
            (5.0 - np.sqrt(radius**2 - aside**2)) / 3.0, rel=1e-12, abs=1e-14 / depth
        )
        n = (hit.q - center) / radius
        assert hit.v_after == pytest.approx(hit.v_before - 2.0 * hit.v_before @ n * n, abs=1e-11)


def test_falling_ball_strikes_ball_off_its_top():
    r, R, aside, drop = 0.1, 0.3, 0.17, 1.0
    scene = Scene(
        ball(2.0, r), [Contact("center", Sphere(radius=R), friction=0.1, restitution=0.5, radius=r)]
    )
    height = np.sqrt((R + r) ** 2 - aside**2)
    trajectory = run(scene, [aside, 0, height + drop, *UP], np.zeros(6), 1.0)
    (hit,) = trajectory.impacts
    assert hit.time == pytest.approx(np.sqrt(2.0 * drop / G), rel=1e-12)
    n = np.array([aside, 0.0, height]) / (R + r)
    assert hit.v_after[:3] @ n == pytest.approx(-0.5 * hit.v_before[:3] @ n, rel=1e-9)


def test_collision_of_two_free_balls():
    """The sphere is on one of the balls; both rotate, so the sphere rotates with its body."""
    model = pin.Model()
    for name, m in (("a", 2.0), ("b", 5.0)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(m, 0.2), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_center", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    weightless(model)
    contact = Contact("a_center", Sphere(radius=0.2, body="b_center"), restitution=0.5, radius=0.2)
    scene = Scene(model, [contact])
    q0 = np.array([0, 0, 0, *UP, 1.0, 0.1, -0.05, *UP])
    v0 = np.array([1.0, 0, 0, 3.0, -2.0, 1.0, 0, 0, 0, -1.0, 4.0, 2.0])
    trajectory = run(scene, q0, v0, 2.0)
    (hit,) = trajectory.impacts
    ahead = 1.0 - np.sqrt(0.16 - 0.1**2 - 0.05**2)
    assert hit.time == pytest.approx(ahead, rel=1e-9)
    n = (hit.q[:3] - hit.q[7:10]) / 0.4

    def linear(q, v):
        return [pin.Quaternion(q[k + 3 : k + 7]).matrix() @ v[j : j + 3] for k, j in ((0, 0), (7, 6))]

    before, after = linear(hit.q, hit.v_before), linear(hit.q, hit.v_after)
    assert 2.0 * after[0] + 5.0 * after[1] == pytest.approx([2.0, 0.0, 0.0], abs=1e-8)
    assert (after[0] - after[1]) @ n == pytest.approx(-0.5 * (before[0] - before[1]) @ n, rel=1e-9)
    assert after[0] - before[0] == pytest.approx(((after[0] - before[0]) @ n) * n, abs=1e-9)


def test_huge_sphere_is_a_floor():
    """A ball bounces and slides on a plane and on a sphere with a radius of 10⁵ km."""
    ends = []
    for surface in (pinimpact.Plane(), Sphere((0.0, 0.0, -1e8), 1e8)):
        contact = Contact("center", surface, friction=0.3, restitution=0.5, radius=0.1)
        scene = Scene(ball(), [contact], resting_speed=1e-3)
        ends.append(run(scene, [0, 0, 0.4, *UP], [1.0, 0.5, 0, 0, 0, 0], 2.0))
    flat, round_ = ends
    assert len(flat.impacts) == len(round_.impacts) > 5
    assert [m.mode for m in flat.modes] == [m.mode for m in round_.modes]
    assert round_.q[-1] == pytest.approx(flat.q[-1], abs=1e-5)


def test_moving_spheres():
    """A translating sphere raises an error, a rotating one does not."""
    rising = Contact("center", Sphere(radius=0.5, velocity=(0, 0, 1.0)), radius=0.1)
    with pytest.raises(pinimpact.InputError, match=r"contacts: the sphere of .* moves at 1 m/s"):
        Scene(ball(), [rising])
    spinning = Contact("center", Sphere(radius=0.5, angular_velocity=(1, 2, 3)), radius=0.1)
    assert "moves at center on sphere" in Scene(ball(), [spinning]).plan()["moving surfaces"].reason


def test_sphere_out_of_reach_is_not_monitored():
    """A rod of 1 m reaches spheres of 0.5 m with centres up to 1.5 m away."""
    for distance, reached in ((1.5 + 1e-9, False), (1.5 - 1e-9, True)):
        center = distance * np.array([0.6, 0.0, -0.8])
        scene = Scene(pendulum(), [Contact("tip", Sphere(center, 0.5))])
        assert scene.plan().unreachable == (() if reached else ("tip on sphere",))


def test_start_inside_sphere_raises():
    scene = Scene(slider(), [Contact("point", Sphere(radius=1.0))])
    with pytest.raises(
        pinimpact.InputError, match=r"q0: the contact 'point on sphere' .* starts 0\.1 m below"
    ):
        pinimpact.simulate(scene, [0.0, 0.0, 0.9], np.zeros(3), 1.0)
