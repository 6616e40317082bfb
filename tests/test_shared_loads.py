"""Non-unique load distributions: the limit of small equal compliances, by both schemes."""

from __future__ import annotations

import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from pinimpact import Contact, Plane, Scene, Shape, simulate

from .scene_models import UP, G, unbounded

SIZE, MU, T = (0.2, 0.2, 0.1), 0.4, 0.25
CORNERS = np.array([(x, y, -0.05) for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
INERTIA = (SIZE[0] ** 2 + SIZE[1] ** 2) / 12.0


def box(push):
    """Return a scene of a box of 1 kg on a floor, pushed by a force along its x axis and a torque."""
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *SIZE), pin.SE3.Identity())
    model.addJointFrame(joint)
    shapes.addGeometryObject(pin.GeometryObject("box_0", joint, pin.SE3.Identity(), coal.Box(*SIZE)))
    unbounded(model)
    contact = Contact(geometry="box_0", plane=Plane(), friction=MU)
    force = np.array([push[0], 0, 0, 0, 0, push[1]])
    return Scene(model, [contact], geometry=shapes, control=lambda t, q, v: force)


def on_springs(push, start):
    """Return x, y, angle, and their rates at T of that box on four equal stiff springs.

    Loads N balance weight and the moments of friction about the two horizontal axes. Compressions of equal
    springs below a rigid flat box satisfy N₁ − N₂ − N₃ + N₄ = 0.
    """

    def rates(t, y):
        c, s = np.cos(y[2]), np.sin(y[2])
        arms = CORNERS[:, :2] @ np.array([[c, s], [-s, c]])
        slip = y[3:5] + y[5] * np.column_stack([-arms[:, 1], arms[:, 0]])
        drag = -MU * slip / np.linalg.norm(slip, axis=1)[:, None]  # per newton of load
        height = -CORNERS[0, 2]
        loads = np.linalg.solve(
            [
                np.ones(4),
                arms[:, 0] + height * drag[:, 0],  # about y
                arms[:, 1] + height * drag[:, 1],  # about x
                [1.0, -1.0, -1.0, 1.0],
            ],
            [G, 0.0, 0.0, 0.0],
        )
        assert loads.min() > 0.0
        force = loads @ drag + push[0] * np.array([c, s])
        torque = loads @ (arms[:, 0] * drag[:, 1] - arms[:, 1] * drag[:, 0]) + push[1]
        return [*y[3:], *force, torque / INERTIA]

    return solve_ivp(rates, (0.0, T), [0, 0, 0, *start], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(
    ("push", "start"),
    [
        ((0.0, 0.0), (1.5, 0.3, 3.0)),
        ((0.0, 0.0), (1.5, 0.0, 10.0)),
        ((1.0, 0.2), (0.8, -0.8, -5.0)),
        ((8.0, 0.6), (0.01, 0.0, 0.3)),
    ],
)
def test_box_slides_and_rotates_as_on_four_stiff_springs(push, start):
    wanted = on_springs(push, start)
    scene, q0 = box(push), np.array([0, 0, 0.05, *UP])
    v0 = np.array([*start[:2], 0, 0, 0, start[2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        located = simulate(scene, q0, v0, T, scheme="event-driven", rtol=1e-10)
        assert pose(located) == pytest.approx(wanted, abs=1e-7)
        off = [
            np.abs(pose(simulate(scene, q0, v0, T, scheme="time-stepping", dt=dt)) - wanted).max()
            for dt in (1e-3, 2.5e-4)
        ]
    assert off[0] < 2e-2
    assert off[1] < 0.6 * off[0]


def pose(run):
    """Return x, y, angle and their rates at the end, in world axes."""
    q, v = run.q[-1], run.v[-1]
    turned = pin.XYZQUATToSE3(q).rotation
    velocity = turned @ v[:3]
    return np.array([*q[:2], np.arctan2(turned[1, 0], turned[0, 0]), *velocity[:2], v[5]])


@pytest.mark.parametrize(("scheme", "known"), [("event-driven", 1e-9), ("time-stepping", 3e-3)])
def test_pusher_supports_sliding_box_up_to_its_friction_limit(scheme, known):
    """A pusher of 1 kg on a rail pushes a box of 2 kg while friction of the box decelerates both.

    On equal springs the box sinks until the floor bears its weight, sliding down the pusher. Friction there
    is at its limit μ' m' a and supports part of the weight: (m + m') a = μ (m g − μ' m' a).
    """
    mu, between, shapes, model = 0.4, 0.3, pin.GeometryModel(), pin.Model()
    for name, kind, mass, size, x in (
        ("pusher", pin.JointModelPX(), 1.0, 0.1, -0.15),
        ("box", pin.JointModelFreeFlyer(), 2.0, 0.2, 0.0),
    ):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.1])) if name == "pusher" else pin.SE3.Identity()
        joint = model.addJoint(0, kind, place, name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, size, size, size), pin.SE3.Identity())
        shape = coal.Box(size, size, size)
        shapes.addGeometryObject(pin.GeometryObject(f"{name}_0", joint, pin.SE3.Identity(), shape))
    unbounded(model)
    contacts = [
        Contact(geometry="box_0", plane=Plane(), friction=mu),
        Contact(geometry="pusher_0", plane=Shape("box_0"), friction=between),
    ]
    v0, t = np.array([0.3, 0.3, 0, 0, 0, 0, 0]), 0.08
    run = simulate(
        Scene(model, contacts, geometry=shapes), [0.0, 0, 0, 0.1, *UP], v0, t, scheme=scheme, dt=1e-3
    )
    slowed = mu * 2.0 * G / (3.0 + mu * between) * t
    assert run.v[-1][:2] == pytest.approx(0.3 - slowed, abs=known * slowed)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("speed", [0.0, 2.0])
@pytest.mark.parametrize("length", [1.0, 1000.0])
@pytest.mark.parametrize("by_stop", [False, True])
def test_contact_and_held_joint_share_load_like_equal_springs(scheme, speed, length, by_stop):
    """An arm on a rail: dry friction or a joint limit holds its hinge; its end slides or rests on a floor.

    A force F at the end and a torque τ at the hinge balance the weight, F L + τ = m g L/2. Equal springs
    minimize F² + (τ/ρ)², where ρ is the radius of gyration about the hinge, in any unit of length.
    """
    model = pin.Model()
    rail = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    hinge = model.addJoint(rail, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    arm = pin.Inertia(1.0, np.array([0.5 * length, 0.0, 0.0]), 0.1 * length**2 * np.eye(3))
    model.appendBodyToJoint(hinge, arm, pin.SE3.Identity())
    end = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", hinge, 0, end, pin.FrameType.OP_FRAME))
    unbounded(model)
    if by_stop:
        model.upperPositionLimit[1] = 0.0
    else:
        model.friction = np.array([0.0, 30.0 * length**2])
    model.gravity.linear[:] = 0.0, 0.0, -G * length
    start, t = np.array([speed * length, 0.0]), 0.1
    scene = Scene(model, [Contact("end", Plane(), friction=MU, name="end")])
    run = simulate(scene, np.zeros(2), start, t, scheme=scheme, atol=1e-10 * length)
    square = 0.1 + 0.25  # (ρ/L)²
    force = 0.5 * G / (1.0 + square)
    assert run.forces("end", 0.5 * t)[2] / length == pytest.approx(force, rel=3e-5)
    assert run.joint_forces([0.5 * t])[0, 1] / length**2 == pytest.approx(-force * square, rel=3e-5)
    gone = speed * t - (0.5 * MU * force * t**2 if speed else 0.0)
    assert run.q[-1, 0] / length == pytest.approx(gone, abs=1e-7)


@pytest.mark.parametrize(("scheme", "known"), [("event-driven", 1e-9), ("time-stepping", 1e-6)])
def test_joint_shares_load_up_to_its_dry_friction(scheme, known):
    """The end of an arm of 1 kg and 1 m slides on a floor, pressed onto it by 10 N per metre of displacement.

    At equal stiffness its hinge would bear more than its bound τ: N = m g/2 − τ + k x, and ẍ = −μ N/m.
    """
    bound, stiffness, t, start = 1.0, 10.0, 0.2, 2.0
    model = pin.Model()
    rail = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    hinge = model.addJoint(rail, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        hinge, pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity()
    )
    end = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", hinge, 0, end, pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction = np.array([0.0, bound])

    def press(_, q, v):
        return np.array([0.0, stiffness * q[0]])

    press.jacobian = lambda _, q, v: np.array([[0.0, 0, 0, 0], [stiffness, 0, 0, 0]])
    scene = Scene(model, [Contact("end", Plane(), friction=MU, name="end")], control=press)
    run = simulate(scene, [0.0, 0.0], [start, 0.0], t, scheme=scheme, sensitivities="state")
    pace, middle = np.sqrt(MU * stiffness), (bound - 0.5 * G) / stiffness
    gone = middle + start / pace * np.sin(pace * t) - middle * np.cos(pace * t)
    assert run.q[-1, 0] == pytest.approx(gone, abs=known)
    assert run.joint_forces([0.1, t])[:, 1] == pytest.approx(-bound, rel=1e-6)
    if scheme == "event-driven":
        found = run.sensitivity(t).state[[0, 2], 2]
        assert found == pytest.approx([np.sin(pace * t) / pace, np.cos(pace * t)], abs=1e-8)


@pytest.mark.parametrize(("gap", "loads"), [(5e-11, (1 / 3, 1 / 3, 1 / 3)), (2e-9, (0.5, 0.0, 0.5))])
@pytest.mark.parametrize("falls", [False, True])
def test_support_whose_gap_is_within_the_tolerance_of_positions_carries(gap, loads, falls):
    """A beam on three supports; the gap of the middle one remains, since the others keep the beam up."""
    model, ends = pin.Model(), (("left", -0.5), ("middle", 0.0), ("right", 0.5))
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    beam = model.addJoint(lift, pin.JointModelRY(), pin.SE3.Identity(), "beam")
    model.appendBodyToJoint(beam, pin.Inertia.FromBox(2.0, 1.0, 0.1, 0.1), pin.SE3.Identity())
    for name, x in ends:
        at = pin.SE3(np.eye(3), np.array([x, 0.0, gap if name == "middle" else 0.0]))
        model.addFrame(pin.Frame(name, beam, at, pin.FrameType.OP_FRAME))
    unbounded(model)
    scene = Scene(model, [Contact(name, plane=Plane(), restitution=0.0) for name, _ in ends])
    run = simulate(scene, [1e-3 if falls else 0.0, 0.0], np.zeros(2), 0.1)
    forces = [float(run.forces(contact.label, [run.t[-1]])[0, 2]) for contact in scene.contacts]
    assert forces == pytest.approx(2.0 * G * np.array(loads), rel=1e-9, abs=1e-9)
