"""Impacts on spheres against impacts on tangent planes, and against closed forms for balls."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.robot._kernels import contact_kinematics, robot_impact

from . import robot_cases as cases
from .scene_models import ball


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def tangent_plane(model, data, q, contact):
    """Return the contact with its sphere replaced by the tangent plane at the point nearest to the tip."""
    seen = pinimpact.contact_matrices(model, data, q, contact)
    sphere = contact.plane
    body = pin.SE3.Identity() if sphere.body is None else data.oMf[model.getFrameId(sphere.body)]
    foot = body.actInv(seen.point - seen.gap * seen.axes[2])
    velocity = sphere.velocity + np.cross(sphere.angular_velocity, foot - sphere.center)
    normal = body.rotation.T @ seen.axes[2]
    plane = pinimpact.Plane(foot, normal, velocity, sphere.angular_velocity, sphere.body)
    return dataclasses.replace(contact, plane=plane)


@pytest.mark.parametrize(("name", "body"), [("panda", None), ("panda", "panda_link2"), ("solo12", None)])
def test_an_instant_tells_a_sphere_from_its_tangent_plane_by_nothing(name, body, rng):
    model, data = cases.load(name)
    for _ in range(10):
        q, v = cases.random_state(model, rng)
        rates = {"velocity": 0.1 * rng.normal(size=3), "angular_velocity": rng.normal(size=3)}
        contact = cases.random_contact(cases.FRAMES[name], rng, cases.random_sphere(rng, body, **rates))
        flat = tangent_plane(model, data, q, contact)
        v = cases.approaching(model, data, q, v, contact)
        one, other = (pinimpact.impact(model, data, q, v, each) for each in (contact, flat))
        scale = np.abs(one.v).max()
        assert np.abs(one.v - other.v).max() < 1e-10 * scale
        assert np.abs(one.impulse_world - other.impulse_world).max() < 1e-10 * np.abs(one.impulse_world).max()
        many = pinimpact.impacts(model, data, np.tile(q, (2, 1)), np.tile(v, (2, 1)), contact)
        assert np.abs(many.v - one.v).max() < 1e-13 * scale


def test_a_foot_held_on_a_sphere_is_held_on_its_tangent_plane(rng):
    model, data = cases.load("solo12")
    q, v = cases.random_state(model, rng)
    struck = cases.random_contact("FL_FOOT", rng)
    held = pinimpact.Contact("HR_FOOT", cases.random_sphere(rng), radius=0.02)
    flat = tangent_plane(model, data, q, held)
    one, other = (pinimpact.contact_matrices(model, data, q, struck, [anchor]) for anchor in (held, flat))
    assert np.abs(one.delassus - other.delassus).max() < 1e-12 * np.abs(other.delassus).max()
    assert np.abs(one.held[0].velocity(v) - other.held[0].velocity(v)).max() < 1e-12


@pytest.mark.parametrize("friction", [0.0, 0.05, 2.0])
def test_ball_falls_on_ball_off_its_top(friction):
    m, r, R, e = 2.0, 0.1, 0.3, 0.6
    model = ball(m, r)
    offset, speed, spin = 0.17, 3.0, np.array([2.0, -5.0, 1.0])
    n = np.array([offset, 0.0, np.sqrt((R + r) ** 2 - offset**2)]) / (R + r)
    contact = pinimpact.Contact(
        "center", pinimpact.Sphere((1, 2, 3), R), friction=friction, restitution=e, radius=r
    )
    q = pin.neutral(model)
    q[:3] = np.array([1, 2, 3]) + (R + r) * n
    v = np.array([0, 0, -speed, *spin])
    hit = pinimpact.impact(model, model.createData(), q, v, contact)
    # the Delassus matrix of a solid ball is diag(7/2, 7/2, 1)/m, so slip keeps its direction
    at_contact = v[:3] - r * np.cross(spin, n)
    approach = at_contact @ n
    slip = at_contact - approach * n
    push = -(1.0 + e) * m * approach
    stop = 2.0 / 7.0 * m * np.linalg.norm(slip)
    impulse = push * n - slip / np.linalg.norm(slip) * min(friction * push, stop)
    assert hit.impulse_world == pytest.approx(impulse, abs=1e-12)
    assert hit.v[:3] == pytest.approx(v[:3] + impulse / m, abs=1e-12)
    assert hit.v[3:] == pytest.approx(spin - np.cross(r * n, impulse) / (0.4 * m * r * r), abs=1e-11)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_two_free_balls(friction, rng):
    """Linear and angular momentum are conserved, and the laws of restitution and friction are satisfied."""
    radii, masses, e = (0.1, 0.25), (2.0, 5.0), 0.7
    model = pin.Model()
    for name, m, r in zip("ab", masses, radii, strict=True):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(m, r), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_center", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    q, v = cases.random_state(model, rng)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    q[:3] = q[7:10] + sum(radii) * n
    turns = [pin.Quaternion(q[k : k + 4]).matrix() for k in (3, 10)]
    v[:3] -= turns[0].T @ (10.0 * n)  # it approaches
    sphere = pinimpact.Sphere(radius=radii[1], body="b_center")
    contact = pinimpact.Contact("a_center", sphere, friction=friction, restitution=e, radius=radii[0])
    hit = pinimpact.impact(model, model.createData(), q, v, contact)
    assert contact.gap(model, model.createData(), q) == pytest.approx(0.0, abs=1e-14)

    def motion(v):
        """Return slip, momentum and angular momentum about the origin, in world axes."""
        linear = [turns[k] @ v[6 * k : 6 * k + 3] for k in range(2)]
        spins = [turns[k] @ v[6 * k + 3 : 6 * k + 6] for k in range(2)]
        momentum = sum(m * x for m, x in zip(masses, linear, strict=True))
        moment = sum(
            np.cross(q[7 * k : 7 * k + 3], masses[k] * linear[k]) + 0.4 * masses[k] * radii[k] ** 2 * spins[k]
            for k in range(2)
        )
        slip = linear[0] - linear[1] - np.cross(spins[0], radii[0] * n) - np.cross(spins[1], radii[1] * n)
        return slip, momentum, moment

    (before, *kept), (after, *left) = motion(v), motion(hit.v)
    for one, other in zip(kept, left, strict=True):
        assert one == pytest.approx(other, abs=1e-11)
    assert after @ n == pytest.approx(-e * before @ n, rel=1e-12)
    reduced = 1.0 / (1.0 / masses[0] + 1.0 / masses[1])
    push = -(1.0 + e) * reduced * before @ n
    assert hit.impulse_world @ n == pytest.approx(push, rel=1e-12)
    slip = before - (before @ n) * n
    stop = 2.0 / 7.0 * reduced * np.linalg.norm(slip)
    drag = np.linalg.norm(hit.impulse_world - push * n)
    assert drag == pytest.approx(min(friction * push, stop), abs=1e-12)


def test_no_kernel_is_compiled_anew_for_another_surface_or_carrier(rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    kinds = [
        surface(rng, body)
        for surface in (cases.random_plane, cases.random_sphere)
        for body in (None, "panda_link2")
    ]
    compiled = []
    for surface in kinds:
        contact = cases.random_contact("panda_hand_tcp", rng, surface)
        contact.gap(model, data, q)
        pinimpact.impact(model, data, q, cases.approaching(model, data, q, v, contact), contact)
        kernels = (contact_kinematics.locate, contact_kinematics.jacobian, robot_impact.robot_impact)
        compiled.append([len(getattr(kernel, "overloads", ())) for kernel in kernels])
    assert compiled[1:] == compiled[:1] * 3


def test_default_name_contains_kind_of_surface():
    labels = [
        pinimpact.Contact("tip", surface).label
        for surface in (
            pinimpact.Plane(),
            pinimpact.Sphere(radius=1.0),
            pinimpact.Sphere(radius=1, body="hand"),
        )
    ]
    assert labels == ["tip on plane", "tip on sphere", "tip on hand"]
