"""Derivatives of motions through impacts at several contacts against difference quotients of `simulate`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Boundary, Contact, Plane, Scene, Stepper, simulate

from .robot_cases import load, q0_of
from .test_sensitivities import FREE, check_sensitivity, modes
from .test_step_derivatives import two_boxes

pytestmark = pytest.mark.filterwarnings("ignore::pinimpact.JointLimitWarning")


def groups(run):
    """Return the sources of each impact at several contacts."""
    found = {}
    for record in run.impacts:
        if record.group is not None:
            found.setdefault(record.time, set()).add(record.source)
    return list(found.values())


def landing(mu, e, v, dry=0.0):
    """Return a scene of a tilted solo12 whose two feet land one after the other, and q and v."""
    model, data = load("solo12")
    model.friction = np.r_[np.zeros(6), dry * np.ones(12)]
    model.damping, model.armature = (
        np.r_[np.zeros(6), 0.05 * np.ones(12)],
        np.r_[np.zeros(6), 0.01 * np.ones(12)],
    )
    common = {"law": "energetic", "radius": 0.016}
    feet = [
        Contact("FL_FOOT", Plane(), mu, 0.0, name="first", **common),
        Contact("HR_FOOT", Plane(), 0.5, e, name="second", **common),
    ]
    q = pin.integrate(model, q0_of("solo12"), np.r_[0, 0, 0, 0.05, 0.04, 0, np.zeros(12)])
    q = np.array(pinimpact.place_in_contact(model, data, q, feet[:1]))
    q[2] += 0.005
    swing = np.random.default_rng(3).normal(size=12)
    return Scene(model, feet, **FREE), q, np.r_[v, 0, 0, 0, 0.05 * swing]


def test_foot_lands_while_another_sticks():
    scene, q, v = landing(2.0, 0.0, [0.0, 0.0, -0.3])
    run = check_sensitivity(scene, q, v, 0.03, 1, ("friction:second",))
    assert {"first", "second"} in groups(run)
    assert {("first", "stick"), ("second", "stick")} <= modes(run)


def test_foot_bounces_while_another_slides():
    scene, q, v = landing(0.05, 0.4, [0.5, 0.1, -0.3])
    run = check_sensitivity(scene, q, v, 0.018, 2, ("friction:first", "restitution:second"))
    assert {"first", "second"} in groups(run)
    assert ("first", "slip") in modes(run)


def test_joints_with_dry_friction_take_part():
    scene, q, v = landing(2.0, 0.0, [0.5, 0.1, -0.3], dry=0.3)
    run = check_sensitivity(scene, q, v, 0.03, 3)
    assert groups(run)
    assert any(mode == "stuck" for _, mode in modes(run))


@pytest.mark.parametrize("e", [0.0, 0.4])
def test_three_feet(e):
    # rebounds below the resting speed are removed, with their effect on sliding contacts
    model, _ = load("solo12")
    q = q0_of("solo12")
    q[2] += 0.05
    q = pin.integrate(model, q, np.array([0, 0, 0, 0.15, 0.1, 0.1, *np.zeros(12)]))
    v = np.array([0.5, 0.3, -0.5, *0.3 * np.random.default_rng(3).normal(size=15)])
    feet = [
        Contact(f"{leg}_FOOT", Plane(), mu, bounce, "energetic", radius=0.016, name=leg)
        for leg, mu, bounce in (("FL", 0.8, 0.0), ("HR", 0.5, e), ("FR", 0.5, e))
    ]
    run = check_sensitivity(Scene(model, feet, **FREE), q, v, 0.12, 1, ("friction:HR",))
    assert groups(run)


def arm():
    """Return an arm of three links whose elbow has a lower limit."""
    model, parent = pin.Model(), 0
    for i, lower in enumerate((-10.0, -0.3, -10.0)):
        kind = pin.JointModelRY() if i < 2 else pin.JointModelRX()
        at = pin.SE3(np.eye(3), np.array([0.5 * (i > 0), 0.0, 0.0]))
        most, bounds = np.array([100.0]), (np.array([lower]), np.array([10.0]))
        parent = model.addJoint(parent, kind, at, f"j{i}", most, most, *bounds)
        link = pin.Inertia(1.0, np.array([0.25, 0.02 * i, 0.01]), np.diag([0.01, 0.03, 0.03]))
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.5, 0.1, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize(("e", "dry"), [(0.5, 0.0), (0.0, 0.0), (0.5, 0.5)])
def test_joint_limit_takes_part(e, dry):
    # the tip lands while the elbow is at its limit, or the elbow reaches it while the tip is on the floor
    model = arm()
    model.friction[:] = dry
    tip = Contact("tip", Plane(point=(0, 0, -0.45)), 0.3, e, "energetic", name="tip")
    run = check_sensitivity(
        Scene(model, [tip], limit_restitution=0.0), *np.array([[-0.2, -0.25, 0.05], [0.3, -0.2, 0.1]]), 0.5, 0
    )
    assert {"tip", "j1 lower"} in groups(run)


def test_sliding_contact_has_restitution():
    # the elbow strikes its limit while the tip slides on the floor; then the tip bounces
    tip = Contact("tip", Plane(point=(0, 0, -0.45)), 0.1, 0.4, "energetic", name="tip")
    scene = Scene(arm(), [tip], limit_restitution=0.5)
    start = np.array([[0.2, -0.05, 0.05], [1.3, -1.0, 0.1]])
    run = check_sensitivity(scene, *start, 0.209, 3, ("friction:tip", "restitution:tip"))
    assert {"tip", "j1 lower"} in groups(run)
    assert ("tip", "slip") in modes(run)


def test_two_joint_limits():
    # without contacts the stiffnesses of limits are the inverses of their W
    model = arm()
    model.lowerPositionLimit[0] = -0.5
    start = np.array([[-0.2, -0.29, 0.05], [-3.0, -0.3, 2.0]])
    run = check_sensitivity(Scene(model, [], limit_restitution=0.5), *start, 0.116, 2)
    assert {"j1 lower", "j0 lower"} in groups(run)


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_joint_limit_with_locked_joint(e):
    scene = Scene(arm(), [], limit_restitution=e, locked=["j2"])
    run = check_sensitivity(scene, *np.array([[-0.2, -0.25, 0.05], [0.3, -0.2, 0.0]]), 0.1, 1)
    assert run.impacts[0].source == "j1 lower"


@pytest.mark.parametrize(("mu", "e"), [(1.0, 0.3), (0.1, 0.0)])
def test_planar_biped(mu, e):
    # W is singular, and the impact of one foot makes the other one separate
    model = pin.Model()
    upright = pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0), np.zeros(3))
    base = model.addJoint(0, pin.JointModelPlanar(), upright, "base")
    model.appendBodyToJoint(base, pin.Inertia(5.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    for side in "lr":
        parent, height = base, -0.1
        for name, mass, inertia in (("hip", 1.0, 0.02), ("knee", 0.5, 0.01)):
            at = pin.SE3(np.eye(3), np.array([0.0, height, 0.0]))
            parent, height = model.addJoint(parent, pin.JointModelRZ(), at, side + name), -0.4
            link = pin.Inertia(mass, np.array([0.0, -0.2, 0.0]), inertia * np.eye(3))
            model.appendBodyToJoint(parent, link, pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([0.0, -0.4, 0.0]))
        model.addFrame(pin.Frame(side, parent, 0, tip, pin.FrameType.OP_FRAME))
    feet = [
        Contact(name, Plane(), *of, "energetic", name=name) for name, *of in (("l", mu, 0.0), ("r", 0.5, e))
    ]
    q, data = np.array([0, 1, 1, 0, 0.3, -0.2, -0.25, -0.1]), model.createData()
    v = np.array([0.3, -0.2, 0.1, 0.2, 0.1, -0.3, 0.2])
    q[1] -= min(foot.gap(model, data, q) for foot in feet) - 0.02
    run = check_sensitivity(Scene(model, feet), q, v, 0.15, 0, ("friction:r",))
    assert len(run.impacts) >= 2


def test_linearize_through_impact():
    scene, q, v = landing(2.0, 0.0, [0.0, 0.0, -0.3])
    exact = {"rtol": 1e-12, "atol": 1e-14}
    stepper, tau = Stepper(scene, q, v, **exact), 0.1 * np.r_[np.zeros(6), np.ones(12)]
    stepper.step(tau, 0.0125)  # one foot has landed
    q, v = stepper.q, stepper.v
    A, B = found = stepper.linearize(tau, 0.01)
    assert found.boundary in (Boundary.NONE, Boundary.CLOSED)
    rng = np.random.default_rng(1)
    dx, du = rng.normal(size=36), rng.normal(size=18)
    # changes of the state that do not move the foot, nor its velocity
    foot = pinimpact.contact_matrices(scene.model, scene.model.createData(), q, scene.contacts[1]).jacobian
    dx[:18] = 0.0
    dx[18:] -= np.linalg.pinv(foot) @ foot @ dx[18:]

    def after(h):
        other = Stepper(scene, q, v + h * dx[18:], **exact)
        return np.concatenate(other.step(tau + h * du, 0.01))

    a, b, c, d = (after(k * 2e-5) for k in (-2, -1, 1, 2))
    middle = after(0.0)[: len(q)]
    a, b, c, d = (np.r_[pin.difference(scene.model, middle, x[:19]), x[19:]] for x in (a, b, c, d))
    expected = (a - 8 * b + 8 * c - d) / 24e-5
    assert np.linalg.norm(A @ dx + B @ du - expected) < 1e-6 * np.linalg.norm(expected)
    run = simulate(scene, q, v, 0.01)
    assert groups(run)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("what", ["edges", "corner on face"])
def test_box_strikes_standing_box(what, restitution):
    # the contact of the boxes and the ball below the lower one take part
    places, turns = {
        "edges": ([(0, 0, 0.2), (0.07, 0.03, 0.45)], [(0, 0.8, 0.1), (0.8, 0, 0)]),
        "corner on face": ([(0, 0, 0.2), (0.02, 0.01, 0.43)], [(0, 0, 0.1), (0.5, 0.6, 0.1)]),
    }[what]
    scene, q = two_boxes(places, turns, restitution)
    ball = Contact("box 0", Plane((0, 0, 0.17)), friction=0.5, restitution=0.2, radius=0.03, name="ball")
    scene = replace(scene, contacts=[*scene.contacts, ball])
    v, model = np.array([0.0] * 6 + [0.3, 0.1, -2.9, 0.1, 0.2, 0.3]), scene.model
    options = {"scheme": "event-driven", "rtol": 1e-11, "atol": 1e-13}
    run = simulate(scene, q, v, 0.03, sensitivities="state", **options)
    assert {impact.source for impact in run.impacts} == {"box 1 on box 0", "ball"}
    direction = np.zeros(24)
    direction[[*range(6, 12), *range(18, 24)]] = np.random.default_rng(0).normal(size=12)
    ends = []
    for s in (-2, -1, 1, 2):
        e = 1e-5 * s * direction
        end = simulate(scene, pin.integrate(model, q, e[:12]), v + e[12:], 0.03, **options)
        ends.append(np.concatenate([pin.difference(model, run.q[-1], end.q[-1]), end.v[-1]]))
    a, b, c, d = ends
    expected = (a - 8 * b + 8 * c - d) / 12e-5
    assert np.allclose(run.sensitivity(0.03).state @ direction, expected, atol=1e-8 * np.abs(expected).max())
