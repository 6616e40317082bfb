"""Derivatives of motions, against closed forms and fourth-order finite differences of `simulate`."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

import pinimpact
from pinimpact import (
    Boundary,
    Box,
    Contact,
    Event,
    JointPD,
    Plane,
    Scene,
    Shape,
    Sphere,
    Stepper,
    simulate,
)
from pinimpact.geometry._kernels.constants import KIND

from .drawing import one_of_each
from .robot_cases import FRAMES, load, q0_of
from .scene_models import unbounded
from .test_step_derivatives import box, corners

EXACT = {"rtol": 1e-12, "atol": 1e-14, "scheme": "event-driven"}
FREE = {"without": ("joint limits",)}


def point(*names):
    """Return a model of balls of 1 kg on translation joints, with frames at their centres."""
    model = pin.Model()
    for name in names:
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name} centre", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


def changed(scene, names, change):
    """Return the scene with coefficients `names` ("kind:label") increased by `change`."""
    contacts = []
    for contact in scene.contacts:
        new = {}
        for name, by in zip(names, change, strict=True):
            kind, _, label = name.partition(":")
            if label == contact.label:
                new[kind] = getattr(contact, kind) + by
        contacts.append(replace(contact, **new))
    return replace(scene, contacts=contacts)


def difference_quotient(scene, q0, v0, duration, towards, names=(), step=2e-5):
    """Return the directional derivative of the final state by finite differences of fourth order."""
    model = scene.model
    nv = model.nv

    def final(s):
        e = s * step * towards
        run = simulate(
            *(changed(scene, names, e[2 * nv :]), pin.integrate(model, q0, e[:nv]), v0 + e[nv : 2 * nv]),
            *(duration,),
            **EXACT,
        )
        return run, run.q[-1], run.v[-1]

    runs = [final(s) for s in (-2, -1, 0, 1, 2)]
    # integration errors at the end of slip may cause a tiny impact without collision, which is not a kink
    orders = [
        [record.source for record in run[0].impacts if abs(record.v_after - record.v_before).max() > 1e-9]
        for run in runs
    ]
    assert all(order == orders[2] for order in orders), "a kink"
    _, q, v = runs[2]
    a, b, _, c, d = (np.concatenate([pin.difference(model, q, x), y - v]) for _, x, y in runs)
    return (a - 8 * b + 8 * c - d) / (12 * step)


def check_sensitivity(scene, q0, v0, duration, seed, names=(), rtol=1e-10, tolerance=1e-6):
    """Compare the final sensitivity in a random direction with finite differences; return the trajectory."""
    n = 2 * scene.model.nv
    towards = np.random.default_rng(seed).normal(size=n + len(names))
    run = simulate(
        *(scene, q0, v0, duration),
        rtol=rtol,
        atol=1e-14,
        scheme="event-driven",
        sensitivities=("state", *names),
    )
    found = run.sensitivity(duration)
    moved = found.state @ towards[:n]
    moved += sum(by * e for by, e in zip(found.parameters.values(), towards[n:], strict=True))
    expected = difference_quotient(scene, q0, v0, duration, towards, names)
    assert np.linalg.norm(moved - expected) <= tolerance * np.linalg.norm(expected)
    return run


def panda(seed, above=0.05):
    """Return a Panda with damping and armature, q, v, and a contact of its hand `above` m over a plane."""
    model, data = load("panda")
    rng = np.random.default_rng(seed)
    model.damping, model.armature = rng.uniform(0, 2, 9), rng.uniform(0, 0.3, 9)
    q, v = q0_of("panda"), 0.5 * rng.normal(size=9)
    v[7:], v[3] = 0.0, -1.0
    pin.framesForwardKinematics(model, data, q)
    x, y, z = data.oMf[model.getFrameId(FRAMES["panda"])].translation
    normal = np.array([*0.02 * rng.normal(size=2), 1.0])
    plane = Plane(normal=normal, point=np.array([x, y, z - 0.02]) - above * normal / np.linalg.norm(normal))
    return model, q, v, Contact(FRAMES["panda"], plane, 0.4, 0.5, radius=0.02, name="hand")


def modes(run):
    """Return all pairs (source, mode) of a run."""
    return {(interval.source, interval.mode) for interval in run.modes}


# ---- closed forms


def test_bouncing_ball():
    # saltation matrix of (height, rate): [[−e, 0], [−(1 + e) g/v⁻, −e]]
    scene = Scene(point("ball"), [Contact("ball centre", Plane(), 0.0, 0.4, name="ball")])
    found = pinimpact.saltation_matrix(scene, "ball", np.zeros(3), [0.3, 0.0, -2.0])
    assert np.allclose(found[np.ix_([2, 5], [2, 5])], [[-0.4, 0.0], [1.4 * 9.81 / 2.0, -0.4]], rtol=1e-13)
    assert np.allclose(found[np.ix_([0, 3], [0, 3])], np.eye(2), atol=1e-15)


def test_derivatives_after_last_bounce_are_flagged():
    # rebound n, of speed eⁿ v, takes 2 eⁿ v/g; rebounds below the resting speed are omitted
    e, v, g = 0.5, 2.0, 9.81
    contact = Contact("ball centre", Plane(), 0.0, e, name="ball")
    scene = Scene(point("ball"), [contact], resting_speed=1e-3)
    run = simulate(scene, np.zeros(3), [0.0, 0.0, -v], 1.0, sensitivities="state")
    bounces = run.impacts[-1].time
    assert run.impacts[-1].resting
    assert bounces == pytest.approx(2 * e * v / ((1 - e) * g), rel=1e-3)
    assert run.sensitivity(0.9 * bounces).boundary == Boundary.NONE
    assert run.sensitivity(1.0).boundary == Boundary.LAST_BOUNCE
    plastic = Scene(point("ball"), [Contact("ball centre", Plane(), 0.0, name="ball")])
    run = simulate(plastic, np.zeros(3), [0.0, 0.0, -v], 1.0, sensitivities="state")
    assert run.sensitivity(1.0).boundary & Boundary.LAST_BOUNCE == 0


def test_elastic_balls_exchange_their_motions():
    # at e = 1 and without gravity x₂ = x₁ + v₁ t afterwards
    gravity = {"without": ("gravity",)}
    contact = Contact("a centre", Sphere(radius=0.1, body="b centre"), 0.0, 1.0, radius=0.1)
    scene = Scene(point("a", "b"), [contact], **gravity)
    run = simulate(scene, [-0.5, 0, 0, 0.3, 0, 0], [1.0, 0, 0, -0.5, 0, 0], 1.0, sensitivities="state")
    found = run.sensitivity(1.0)
    assert np.allclose(found.state[3, [0, 3, 6, 9]], [1.0, 0.0, 1.0, 0.0], atol=1e-12)
    assert np.allclose(found.state[0, [0, 3, 6, 9]], [0.0, 1.0, 0.0, 1.0], atol=1e-12)


def test_block_slides_to_rest():
    # the stopping distance is v²/(2μg), so ∂x/∂v = v/(μg) and ∂x/∂μ = −v²/(2μ²g)
    scene = Scene(point("block"), [Contact("block centre", Plane(), 0.2, name="block")])
    v = np.array([1.5, 0.0, 0.0])
    run = simulate(scene, np.zeros(3), v, 1.0, sensitivities=["state", "friction:block"])
    found = run.sensitivity(1.0)
    assert found.boundary == Boundary.CLOSED
    # for any direction the displacement is v|v|/(2μg)
    expected = np.diag([1.0, 0.5]) * 1.5 / (0.2 * 9.81)
    assert np.allclose(found.state[:2, 3:5], expected, atol=1e-9)
    assert np.allclose(found.parameters["friction:block"][:3], [-(1.5**2) / (0.08 * 9.81), 0, 0], rtol=1e-6)
    assert np.allclose(found.state[3:], 0.0, atol=1e-12)
    assert np.allclose(found.state[:3, :3], np.diag([1.0, 1.0, 0.0]), atol=1e-12)


def test_slip_ending_between_neighbouring_times():
    # slip ends between two neighbouring floating-point times, as if several feet stopped in succession
    scene = Scene(point("block"), [Contact("block centre", Plane(), 0.2, name="block")])
    run = simulate(scene, np.zeros(3), np.array([1.5, 0.0, 0.0]), 1.0, sensitivities="state")
    slopes, steps = run.sensitivities._slopes, run.sensitivities._steps
    last = [step for step in steps if step.closed is not None and step.closed.slips][-1]
    step = replace(last, start=np.nextafter(last.end, 0.0), h=math.ulp(last.end))
    assert np.linalg.norm(step.at(step.start)[1]) > 0.1
    assert np.isfinite(slopes.along(slopes.initial(), step, step.end)).all()


def test_slip_of_zero_speed_has_no_derivative():
    # as in a step between two impacts that is too short to change the velocity
    scene = Scene(point("block"), [Contact("block centre", Plane(), 0.2, name="block")])
    run = simulate(scene, np.zeros(3), np.array([1.5, 0.0, 0.0]), 0.5, sensitivities="state")
    slopes = run.sensitivities._slopes
    still = replace(run.sensitivities._steps[0], v=np.zeros(3))
    still.coefficients[:] = 0.0
    assert np.isnan(slopes.along(slopes.initial(), still, still.end)).all()
    assert slopes.saltation.boundary & Boundary.EVENTS_COINCIDE


@pytest.mark.parametrize(("slip", "friction"), one_of_each([0.0, 1e-10], [0.2, 5.0]))
@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_vertically_falling_robot_has_derivative_only_if_it_sticks(scheme, friction, slip):
    # the tangential velocity before the impact is zero up to rounding, or up to the error of steps
    model, _ = load("solo12")
    q = pin.integrate(model, q0_of("solo12"), np.array([0, 0, 0.05, 0.3, 0.2, 0.1] + [0.0] * 12))
    foot = Contact(FRAMES["solo12"], Plane(), friction, 0.3, radius=0.016, name="foot")
    q[2] += 0.02 - foot.gap(model, model.createData(), q)
    v = slip * np.eye(18)[0]
    run = simulate(Scene(model, [foot], **FREE), q, v, 0.08, scheme=scheme, sensitivities="state")
    (impact,) = run.impacts
    assert (impact.solution.segments[-1].mode == "stick") == (friction == 5.0)
    found = run.sensitivity(0.08)
    assert np.isnan(found.state).any() == (friction == 0.2)
    assert bool(found.boundary & Boundary.START_AT_REST) == (friction == 0.2)


def test_block_slides_up_slope_and_back():
    # the slope is too steep to stick
    slope, mu, speed = 0.5, 0.2, 1.0
    normal = (-np.sin(slope), 0.0, np.cos(slope))
    scene = Scene(point("block"), [Contact("block centre", Plane(normal=normal), mu, name="block")])
    up = np.array([np.cos(slope), 0.0, np.sin(slope)])
    run = simulate(scene, np.zeros(3), speed * up, 0.6, sensitivities="state")
    found = run.sensitivity(0.6).state
    rise, fall = 9.81 * np.sin(slope) * np.array([1 + mu / np.tan(slope), 1 - mu / np.tan(slope)])
    # v(t) = −fall (t − v₀/rise)
    assert np.isclose(up @ found[3:, 3:] @ up, fall / rise, rtol=1e-9)
    top = speed / rise
    assert np.isclose(up @ found[:3, 3:] @ up, top + fall / rise * (0.6 - top), rtol=1e-7)


def test_incipient_slip_at_start_has_one_sided_derivatives_only():
    # v(1) = g − f + v(0), against friction (g − f)(1 + v(0)/(g + f))
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerDryFrictionLimit[:], model.upperDryFrictionLimit[:] = -3.0, 3.0
    scene = Scene(model, [])
    step = Stepper(scene, [0.0], [0.0]).linearize([0.0], 0.1)
    assert step.boundary == Boundary.START_AT_REST
    assert np.abs(step.A - [[1.0, 0.1], [0.0, 1.0]]).max() < 1e-12
    assert step.B[:, 0] == pytest.approx([0.005, 0.1])
    moving = Stepper(scene, [0.0], [-0.1]).linearize([0.0], 0.1)
    assert moving.boundary == Boundary.NONE
    assert np.abs(moving.A - [[1.0, 0.1], [0.0, 1.0]]).max() < 1e-12


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_block_starts_to_slide_down_a_slope(friction):
    model, angle = pin.Model(), 0.5
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("block", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    plane = Plane(normal=(np.sin(angle), 0.0, np.cos(angle)))
    scene = Scene(model, [Contact("block", plane, friction=friction)])
    found = simulate(scene, np.zeros(3), np.zeros(3), 1.0, sensitivities="state").sensitivity(1.0)
    rest = Boundary.START_AT_REST if friction > 0.0 else Boundary.NONE
    assert found.boundary == Boundary.CLOSED | rest
    along = np.eye(3) - np.outer(plane.normal, plane.normal)  # variations that open the contact are projected
    assert found.state[:3, :3] == pytest.approx(along, abs=1e-9)
    down = along @ [0.0, 0.0, -1.0]
    assert found.state[:, 3:] @ down == pytest.approx(np.append(down, down), abs=1e-6)


def test_planar_block_sticks():
    # the model cannot move out of its plane, so the contact force has no such component
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("block centre", z, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    scene = Scene(model, [Contact("block centre", Plane(), 0.2, name="block")])
    run = simulate(scene, np.zeros(2), [1.5, 0.0], 1.0, sensitivities="state")
    assert ("block", "stick") in modes(run)
    expected = np.zeros((4, 4))
    expected[0, 0], expected[0, 2] = 1.0, 1.5 / (0.2 * 9.81)
    found = run.sensitivity(1.0).state
    assert np.allclose(found[:, [0, 2]], expected[:, [0, 2]], atol=1e-9)


# ---- robots


@pytest.mark.parametrize("law", pinimpact.LAWS)
def test_panda_rebounds(law):
    model, q, v, contact = panda(0)
    scene = Scene(model, [replace(contact, law=law)], **FREE)
    run = check_sensitivity(scene, q, v, 0.15, 0, ("friction:hand", "restitution:hand"))
    assert run.impacts


@pytest.mark.parametrize(("seed", "friction"), [(1, 0.2), (3, 0.2), (0, 1.5)])
def test_panda_lands_slips_and_sticks(seed, friction):
    model, q, v, contact = panda(seed)
    scene = Scene(model, [replace(contact, restitution=0.0, friction=friction)], **FREE)
    run = check_sensitivity(scene, q, v, 0.15, seed, ("friction:hand",))
    assert ("hand", "stick") in modes(run)


def test_contact_out_of_reach_has_no_effect():
    model, q, v, contact = panda(0)
    far = Contact("panda_link1", Plane((0.0, 0.0, -9.0)), friction=0.3, name="far")
    scene = Scene(model, [far, contact], **FREE)
    run = simulate(scene, q, v, 0.1, sensitivities=["friction:far", "restitution:hand"])
    found, alone = run.sensitivity(0.1), simulate(scene, q, v, 0.1, sensitivities=["restitution:hand"])
    assert not found.parameters["friction:far"].any()
    hand = found.parameters["restitution:hand"]
    assert hand.any()
    assert np.array_equal(hand, alone.sensitivity(0.1).parameters["restitution:hand"])


def test_saltation_at_impact_after_which_contact_stays_active():
    # flight, impact, contact: Ξ times the derivatives of the motion before and after
    model, q, v, contact = panda(0)
    scene = Scene(model, [replace(contact, restitution=0.0, friction=1.5)], **FREE)
    run = simulate(scene, q, v, 0.15, **EXACT, sensitivities=["state"])
    record = run.impacts[0]
    found = pinimpact.saltation_matrix(scene, "hand", record.q, record.v_before)
    before = run.sensitivity(record.time, "left").state
    assert np.allclose(found @ before, run.sensitivity(record.time).state, atol=1e-8)


def test_saltation_raises_if_another_contact_is_active():
    # the joint limit is active until the impact of the hand, so v̇ before the impact includes its force
    model, q, v, contact = panda(0)
    unbounded(model)
    model.lowerPositionLimit[3] = q[3] - 0.05
    scene = Scene(model, [contact])
    run = simulate(scene, q, v, 0.12, **EXACT, sensitivities="state")
    assert [record.source for record in run.impacts] == ["panda_joint4 lower", "hand"]
    record = run.impacts[1]
    with pytest.raises(pinimpact.InputError, match="'panda_joint4 lower' is active"):
        pinimpact.saltation_matrix(scene, "hand", record.q, record.v_before)
    towards = np.random.default_rng(0).normal(size=18)
    expected = difference_quotient(scene, q, v, 0.12, towards)
    assert np.linalg.norm(run.sensitivity(0.12).state @ towards - expected) < 1e-8 * np.linalg.norm(expected)


def test_box_slides_with_one_unloaded_corner():
    # the load distribution of four corners is not unique and affects friction; one corner is unloaded
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.3), pin.SE3.Identity())
    model.addJointFrame(joint)
    corners = [Contact("box", Plane(), 0.5, offset=(x, y, -0.15)) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    unbounded(model)
    scene = Scene(model, corners)
    q, v = np.array([0.0, 0.0, 0.15, 0.0, 0.0, 0.0, 1.0]), np.array([1.0, 0.7, 0.0, 0.0, 0.0, 3.0])
    run = simulate(scene, q, v, 0.05, **EXACT, sensitivities="state")
    normal = np.array([run.forces(contact.label, 0.05)[2] for contact in scene.contacts])
    assert normal.min() == 0.0 < np.sort(normal)[1]
    towards = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 0.3, -0.4, 0.0, 0.0, 0.0, 1.0])
    expected = difference_quotient(scene, q, v, 0.05, towards)
    moved = run.sensitivity(0.05).state @ towards
    assert np.linalg.norm(moved - expected) < 1e-7 * np.linalg.norm(expected)


def box_with_held_point(offset, tip):
    """Return a box whose point is held at the origin, the same box on a ball joint, and J of the box (6, 3).

    Both have a frame at the tip, and states (q, v) follow from (R, ω) of the box.
    """
    inertia, robots = pin.Inertia.FromBox(1.3, 0.6, 0.3, 0.2), []
    for kind, place in ((pin.JointModelFreeFlyer(), 0.0 * offset), (pin.JointModelSpherical(), -offset)):
        model, place = pin.Model(), pin.SE3(np.eye(3), place)
        joint = model.addJoint(0, kind, pin.SE3.Identity(), "box")
        model.appendBodyToJoint(joint, inertia, place)
        for name, where in (("tip", tip), ("hinge", offset)):
            there = place * pin.SE3(np.eye(3), where)
            model.addFrame(pin.Frame(name, joint, there, pin.FrameType.OP_FRAME))
        unbounded(model)
        robots.append(model)
    return *robots, np.vstack([pin.skew(offset), np.eye(3)])


@pytest.mark.parametrize("restitution", [0.0, 0.4])
@pytest.mark.parametrize("at_impact", [False, True])
def test_held_point_is_equivalent_to_ball_joint(restitution, at_impact):
    offset, tip = np.array([0.3, 0.1, 0.05]), np.array([-0.4, 0.1, -0.1])
    box, ball, moves = box_with_held_point(offset, tip)
    turned, rate = pin.exp3(np.array([0.1, -0.2, 0.3])), np.array([0.4, -1.5, 0.3])
    lowest = turned @ (tip - offset)
    floor = Plane(point=tuple(lowest - [0.0, 0.0, 0.0 if at_impact else 0.02]), normal=(0.1, 0.05, 1.0))
    hand = Contact("tip", floor, friction=0.3, restitution=restitution, name="tip")
    quaternion = pin.Quaternion(turned).coeffs()
    free = Scene(box, hand, held=Contact("hinge", Plane(), name="hinge"))
    start = np.append(-turned @ offset, quaternion), moves @ rate
    hinged, duration = Scene(ball, hand), 0.05
    runs = [
        simulate(*one, duration, **EXACT, sensitivities=["state", "friction:tip"])
        for one in ((free, *start), (hinged, quaternion, rate))
    ]
    by_box, by_ball = (run.sensitivity(duration) for run in runs)
    both = np.kron(np.eye(2), moves)
    assert np.abs(by_box.state @ both - both @ by_ball.state).max() < 1e-8
    difference = by_box.parameters["friction:tip"] - both @ by_ball.parameters["friction:tip"]
    assert np.abs(difference).max() < 1e-8
    found, expected = (
        pinimpact.saltation_matrix(scene, "tip", run.impacts[0].q, run.impacts[0].v_before)
        for scene, run in zip((free, hinged), runs, strict=True)
    )
    assert np.abs(found @ both - both @ expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize(("law", "sliding"), one_of_each(list(pinimpact.LAWS), [0.1, 0.3]))
def test_derivative_by_zero_restitution_is_limit_of_small_bounces(scheme, law, sliding):
    # impacts reduce the sliding speed by μ v (1 + e)/(1 − e), sliding friction by μ_s (g t − 2ev/(1 − e))
    block = Contact("block centre", Plane(), 0.2, law=law, sliding_friction=sliding, name="block")
    start, options = (np.array([0.0, 0.0, 0.05]), [1.2, 0.9, -0.9]), {"scheme": scheme, "dt": 1e-3}
    names = ["state", "restitution:block"]
    run = simulate(Scene(point("block"), block), *start, 0.25, sensitivities=names, **options)
    (impact,) = run.impacts
    found = run.sensitivity(0.25)
    slower = 2.0 * (sliding - 0.2) * -impact.v_before[2] * np.array([0.8, 0.6, 0.0])
    by_e = found.parameters["restitution:block"]
    assert np.allclose(
        by_e, [*((0.25 - impact.time) * slower), *slower], atol=1e-3 if "step" in scheme else 1e-9
    )
    alone = simulate(Scene(point("block"), block), *start, 0.25, sensitivities="state", **options)
    assert np.array_equal(found.state, alone.sensitivity(0.25).state)
    assert found.boundary == Boundary.BOUND


def test_sticking_impact_before_sliding_has_no_derivative_by_restitution():
    block = Contact("block centre", Plane(normal=(0.5, 0.0, 1.0)), 0.9, sliding_friction=0.2, name="block")
    names = ["state", "restitution:block"]
    run = simulate(Scene(point("block"), block), np.zeros(3), [0.0, 0.0, -1.0], 0.1, sensitivities=names)
    assert run.impacts[0].solution.segments[-1].mode == "stick"
    assert modes(run) == {("block", "slip")}
    found = run.sensitivity(0.1)
    assert np.isfinite(found.state).all()
    assert np.isnan(found.parameters["restitution:block"]).all()
    assert found.boundary & Boundary.EVENTS_COINCIDE


def test_saturated_drives_and_moving_belt():
    model, q, v, contact = panda(2)
    belt = replace(contact.plane, velocity=tuple(np.cross(contact.plane.normal, (0.0, 0.5, 0.0))))
    hand = replace(contact, plane=belt, restitution=0.0)
    scene = Scene(model, [hand], control=JointPD(100.0, 10.0, q + 0.3, limits=30.0), **FREE)
    run = check_sensitivity(scene, q, v, 0.2, 3)
    assert any(mode == "saturated" for _, mode in modes(run))


def with_jacobian(stiffness, damping, q_ref):
    """Return a PD control as a function with a derivative, for joints with one coordinate."""
    n = len(q_ref)

    def control(t, q, v):
        return stiffness * (q_ref - q) - damping * v

    control.jacobian = lambda t, q, v: np.hstack([-stiffness * np.eye(n), -damping * np.eye(n)])
    return control


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.0625, 0.15])
def test_sampled_control_of_point_mass(delay):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    k, d, period, duration = 30.0, 2.0, 0.0625, 0.73
    scene = Scene(model, control=with_jacobian(k, d, np.zeros(1)), period=period, delay=delay)
    found = simulate(scene, [0.1], [0.2], duration, sensitivities="state").sensitivity(duration)
    # linear: x' = v, v' = u/2, u = −k x − d v at the sample in use
    x, t, force, waiting = np.eye(2), 0.0, np.zeros((1, 2)), []
    samples = [period * i for i in range(12)]
    changes = sorted({*samples, *(sample + delay for sample in samples), duration})
    for time in [one for one in changes if one <= duration]:
        h = time - t
        x = np.array([[1.0, h], [0.0, 1.0]]) @ x + np.array([[0.5 * h * h], [h]]) @ force / 2.0
        t = time
        if any(abs(time - sample) < 1e-12 for sample in samples):
            waiting.append((time + delay, np.array([[-k, -d]]) @ x))
        if waiting and time >= waiting[0][0] - 1e-12:
            force = waiting.pop(0)[1]
    assert found.state == pytest.approx(x, abs=1e-13)
    again = replace(scene, control=JointPD(k, d, [0.0]))
    other = simulate(again, [0.1], [0.2], duration, sensitivities="state").sensitivity(duration)
    assert other.state == pytest.approx(x, abs=1e-13)


@pytest.mark.parametrize("period", [None, 0.013])
def test_panda_rebounds_under_control_function(period):
    model, q, v, hand = panda(5)
    control = with_jacobian(60.0, 5.0, q + 0.2)
    scene = Scene(model, [hand], control=control, period=period, delay=0.004 if period else 0.0, **FREE)
    run = check_sensitivity(scene, q, v, 0.16, 5, ("friction:hand", "restitution:hand"))
    assert run.impacts


@pytest.mark.parametrize("across", [0.0, 1.0])
def test_block_slips_and_sticks_under_sampled_control(across):
    # if the direction of slip changes, integration errors leave a small speed at its end
    model = point("block")
    model.gravity.linear[:] = 0.0, 0.0, -9.81
    block = Contact("block centre", Plane(), 0.3, name="block")

    def push(t, q, v):
        return np.array([4.0 * np.cos(20.0 * t) + 3.0 * q[0] - v[0], across * (0.5 - v[1]), 0.0])

    push.jacobian = lambda t, q, v: np.array([[3.0, 0, 0, -1, 0, 0], [0, 0, 0, 0, -across, 0], [0] * 6])
    scene = Scene(model, [block], control=push, period=0.05)
    q, v = np.zeros(3), np.array([0.3, 0.1 * across, 0.0])
    run = simulate(scene, q, v, 1.0, sensitivities="state", **(EXACT | {"rtol": 1e-10}))
    assert {mode for _, mode in modes(run)} >= {"stick", "slip"}
    found = run.sensitivity(1.0)
    assert not np.isnan(found.state).any()
    for towards in np.eye(6)[[0, 1, 3, 4] if across else [0, 3]]:  # along the plane
        expected = difference_quotient(scene, q, v, 1.0, towards, step=1e-6)
        assert np.abs(found.state @ towards - expected).max() <= 1e-6 * max(np.abs(expected).max(), 1.0)


@pytest.mark.parametrize("period", [None, 1e-3])
def test_quadruped_lands_and_trots(period):
    model, _ = load("solo12")
    q = q0_of("solo12")
    q[7:] = np.tile([0.0, 0.7, -1.4], 4)
    names = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    feet = [Contact(name, Plane(), 0.7, radius=0.016, name=name) for name in names]
    q = pinimpact.place_in_contact(model, model.createData(), q, feet)

    def control(t, at, v):
        target, phase = q[7:].copy(), np.sin(4.0 * np.pi * t)
        for leg in (0, 3) if phase > 0.0 else (1, 2):
            target[3 * leg : 3 * leg + 3] += abs(phase) * np.array([0.0, 0.35, -0.7])
        return np.concatenate([np.zeros(6), 12.0 * (target - at[7:]) - 0.3 * v[6:]])

    by_state = np.zeros((18, 36))
    by_state[6:, 6:18], by_state[6:, 24:] = -12.0 * np.eye(12), -0.3 * np.eye(12)
    control.jacobian = lambda t, q, v: by_state
    rng = np.random.default_rng(3)
    above = q + np.eye(19)[2] * 0.02
    q0 = pin.integrate(model, above, np.concatenate([np.zeros(3), 0.02 * rng.normal(size=15)]))
    scene, v0 = Scene(model, feet, control=control, period=period), 0.05 * rng.normal(size=18)
    run = simulate(scene, q0, v0, 0.3, sensitivities="state", **(EXACT | {"rtol": 1e-10}))
    towards, e = rng.normal(size=36), 1e-7
    left, right = (
        simulate(scene, pin.integrate(model, q0, s * towards[:18]), v0 + s * towards[18:], 0.3, **EXACT)
        for s in (-e, e)
    )
    moved = pin.difference(model, left.q[-1], right.q[-1]), right.v[-1] - left.v[-1]
    expected = np.concatenate(moved) / (2.0 * e)
    found = run.sensitivity(0.3).state @ towards
    assert np.linalg.norm(found - expected) <= 1e-6 * np.linalg.norm(expected)
    # impacts of feet occur while other feet slip or stick
    assert sum(record.group is not None for record in run.impacts) > 5
    assert {"stick", "slip"} <= {mode for _, mode in modes(run)}


def test_invalid_control_derivative_raises():
    model, q, v, _ = panda(5)
    control = with_jacobian(60.0, 5.0, q)
    control.jacobian = lambda t, q, v: np.zeros((9, 9))
    run = simulate(Scene(model, control=control, **FREE), q, v, 0.1, sensitivities="state")
    with pytest.raises(pinimpact.InputError, match=r"jacobian.*\(9, 18\)"):
        run.sensitivity(0.1)
    control.jacobian = lambda t, q, v: v["tip"]
    run = simulate(Scene(model, control=control, **FREE), q, v, 0.1, sensitivities="state")
    with pytest.raises(pinimpact.InputError, match=r"jacobian: IndexError at t = "):
        run.sensitivity(0.1)


def test_callback_that_is_switched_off_needs_no_derivative():
    model, q, v, _ = panda(5)
    kick = Event(lambda t, q, v: t - 0.005, lambda t, q, v: 2.0 * v, name="kick")
    scene = Scene(model, events=[kick], without=["user events", "joint limits"])
    run = simulate(scene, q, v, 0.01, sensitivities="state")
    expected = pinimpact.Stepper(replace(scene, events=[]), q, v).linearize(np.zeros(9), 0.01).A
    assert np.array_equal(pinimpact.Stepper(scene, q, v).linearize(np.zeros(9), 0.01).A, expected)
    np.testing.assert_allclose(run.sensitivity(0.01).state, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_dry_friction_in_joints(seed):
    model, q, v, contact = panda(seed)
    model.friction = np.random.default_rng(seed).uniform(0, 8, 9)
    run = check_sensitivity(
        Scene(model, [replace(contact, friction=0.2)], **FREE), q, v, 0.3, seed, ("friction:hand",)
    )
    assert any(mode == "stuck" for _, mode in modes(run))


@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_joint_limits(restitution):
    model, q, v, _ = panda(4)
    scene = Scene(model, limit_restitution=restitution)
    v[:] = 0.0
    v[1], v[3], v[5], v[6] = 2.0, 1.0, 1.5, -0.5
    q[7:] = 0.02
    run = check_sensitivity(scene, q, v, 0.7, 4)
    assert run.impacts


@pytest.mark.parametrize(
    ("seed", "friction", "restitution"),
    [(0, 0.3, 0.5), (1, 0.2, 0.0), pytest.param(2, 0.8, 0.3, marks=pytest.mark.exhaustive)],
)
def test_one_foot_of_quadruped(seed, friction, restitution):
    # a free-flying body with a spherical foot
    model, _ = load("solo12")
    rng = np.random.default_rng(seed)
    q = q0_of("solo12")
    q[2] += 0.05
    q = pin.integrate(model, q, np.array([0, 0, 0, 0.3, 0.2, 0.1, *np.zeros(12)]))
    v = np.array([0.5, 0.3, 0.0, *0.3 * rng.normal(size=15)])
    foot = Contact(FRAMES["solo12"], Plane(), friction, restitution, radius=0.016, name="foot")
    run = check_sensitivity(Scene(model, [foot], **FREE), q, v, 0.3, seed, ("friction:foot",))
    assert run.impacts


@pytest.mark.parametrize(("seed", "friction", "restitution"), [(0, 0.3, 0.5), (1, 0.2, 0.0), (2, 1.5, 0.0)])
def test_coin_bounces_and_rolls(seed, friction, restitution):
    # the lowest point moves along the rim
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "coin")
    inertia = pin.Inertia(1.0, np.array([0.0, 0.01, 0.0]), np.diag([3e-3, 3e-3, 6e-3]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("coin centre", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    plane = Plane(normal=(0.05, 0.1, 1.0))
    coin = Contact("coin centre", plane, friction, restitution, rim=0.1, radius=0.01, name="coin")
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.15, 1.2, 0.3, 0.2]))
    v = np.array([0.5, 0.3, 0.0, 0.5, 0.8, 6.0]) + 0.2 * np.random.default_rng(seed).normal(size=6)
    run = check_sensitivity(Scene(model, [coin]), q, v, 0.25, seed, ("friction:coin",), rtol=1e-12)
    assert run.impacts
    assert (("coin", "stick") in modes(run)) == (friction == 1.5)


BALL, BRICK = coal.Sphere(0.1), coal.Box(0.2, 0.3, 0.1)
SHAPES = {
    # the shape of a body, where it starts above a block, its velocity, friction, restitution, duration
    "ball bounces on edge": (BALL, [0.42, 0, 0.3], [0.0, 0.1, -1, 1, 2, 0.5], 0.3, 0.5, 0.25),
    "ball bounces on corner": (BALL, [0.43, 0.34, 0.3], [0.0, 0.1, -1, 1, 2, 0.5], 0.3, 0.5, 0.25),
    "brick bounces": (BRICK, [0.0, 0.0, 0.4], [0.3, 0.1, -1, 1, 2, 0.5], 0.3, 0.5, 0.12),
    "brick slides": (BRICK, [0.0, 0.0, 0.3], [0.3, 0.1, -1, 1, 2, 0.5], 0.3, 0.0, 0.1),
    "ball rolls over edge": (BALL, [0.3, 0.0, 0.22], [0.6, 0.1, -0.1, 0, 6, 0.5], 0.8, 0.0, 0.35),
    "ball flies off": (BALL, [0.3, 0.0, 0.21], [2.0, 0.1, -0.1, 0, 20, 0.5], 0.8, 0.0, 0.15),
    "ball slides over a side or an end": (
        BALL,
        [0.402, 0.29, 0.201],
        [0.0, 0.6, -1.0, 1, 2, 0.5],
        0.1,
        0.0,
        0.2,
    ),
}


def above_a_block(shape, turns):
    """Return a free body with a shape "a", and a block "b" that is fixed or turns about z."""
    model, shapes = pin.Model(), pin.GeometryModel()
    block = pin.JointModelRZ() if turns else pin.JointModelPX()
    inertia = pin.Inertia(1.0, np.array([0.02, 0.0, -0.01]), np.diag([0.03, 0.04, 0.05]))
    for name, kind, solid in (("a", pin.JointModelFreeFlyer(), shape), ("b", block, coal.Box(0.8, 0.6, 0.2))):
        joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"link {name}", joint, pin.SE3.Identity(), 0)
        frame = model.getFrameId(f"link {name}")
        shapes.addGeometryObject(pin.GeometryObject(name, joint, frame, pin.SE3.Identity(), solid))
    return pin.RobotWrapper(model, shapes)


@pytest.mark.parametrize(("kind", "turns"), one_of_each(list(SHAPES), [False, True]))
def test_convex_shapes_on_block(kind, turns):
    shape, x, v, friction, restitution, duration = SHAPES[kind]
    turned = pin.Quaternion(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1)).coeffs()
    q, v = np.array([*x, *turned, 0.0]), np.array([*v, 0.3])
    surface = Shape("b") if turns else Box((0.8, 0.6, 0.2))
    contact = Contact(geometry="a", plane=surface, friction=friction, restitution=restitution)
    run = check_sensitivity(Scene(above_a_block(shape, turns), contact), q, v, duration, 0, rtol=1e-12)
    features = {step.closed.constants[0, KIND] for step in run._segments if step.closed is not None}
    assert (len(features) > 1) == ("over" in kind)


def test_ball_joint_and_planar_joint():
    # joints whose tangent spaces do not commute
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(base, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    arm = model.addJoint(
        base, pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0, 0, 0.5])), "shoulder"
    )
    link = pin.Inertia(1.0, np.array([0.2, 0.1, 0.3]), np.diag([0.1, 0.2, 0.15]))
    model.appendBodyToJoint(arm, link, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
    model.addFrame(pin.Frame("tip", arm, tip, pin.FrameType.OP_FRAME))
    q = pin.integrate(model, pin.neutral(model), np.array([0.1, 0.2, 0.3, 1.6, 0.5, 0.2]))
    v = np.array([0.5, -0.3, 0.8, 1.0, 2.0, -0.5])
    run = check_sensitivity(Scene(model, [Contact("tip", Plane(point=(0, 0, 0.3)), 0.3, 0.0)]), q, v, 0.8, 0)
    assert run.impacts


# ---- steps


def test_linearize_step_of_free_motion():
    model, q, v, contact = panda(1)
    scene = Scene(model, [replace(contact, restitution=0.0, friction=0.2)], **FREE)
    stepper = Stepper(scene, q, v, rtol=1e-12, atol=1e-14)
    tau = np.random.default_rng(0).normal(size=9)
    stepper.step(tau, 0.02)
    q, v = stepper.q, stepper.v
    A, B = found = stepper.linearize(tau, 0.07)
    assert found.boundary == Boundary.NONE
    assert np.array_equal(stepper.q, q)
    rng = np.random.default_rng(1)
    dx, du = rng.normal(size=18), rng.normal(size=9)

    def after(h):
        other = Stepper(scene, pin.integrate(model, q, h * dx[:9]), v + h * dx[9:], rtol=1e-12, atol=1e-14)
        return np.concatenate(other.step(tau + h * du, 0.07))

    a, b, c, d = (after(k * 2e-5) for k in (-2, -1, 1, 2))
    expected = (a - 8 * b + 8 * c - d) / 24e-5
    assert np.linalg.norm(A @ dx + B @ du - expected) < 1e-6 * np.linalg.norm(expected)
    modes = stepper.copy()
    modes.step(tau, 0.07)
    assert modes.trajectory.impacts


def test_linearize_with_active_contact():
    # a variation that lifts the block is followed until it has landed again
    scene = Scene(point("block"), [Contact("block centre", Plane(), 0.5)])
    A, B = found = Stepper(scene, np.zeros(3), np.zeros(3)).linearize([1.0, 0.0, 0.0], 0.1)
    assert found.boundary == Boundary.CLOSED
    assert np.allclose(A, np.diag([1.0, 1.0, 0, 0, 0, 0]), atol=1e-12)
    assert np.allclose(B, 0.0, atol=1e-15)
    A, B = Stepper(scene, np.zeros(3), [1.0, 0.0, 0.0]).linearize(np.zeros(3), 0.1)
    expected = np.diag([1.0, 1.0 - 0.5 * 9.81 * 0.1, 0.0])
    expected[0, 2] = 0.5  # flight avoids twice this friction, landing adds it once
    assert np.allclose(A[3:, 3:], expected, atol=1e-9)
    bouncy = replace(scene, resting_speed=1e-7)
    lifted = simulate(bouncy, np.zeros(3), [1.0, 0.0, 1e-4], 0.1, **EXACT)
    assert np.isclose((lifted.v[-1, 0] - (1.0 - 0.5 * 9.81 * 0.1)) / 1e-4, 0.5, atol=1e-9)
    # B by a load along n: friction changes
    assert np.allclose(B[3, [0, 2]], [0.1, 0.05], atol=1e-12)


def test_linearize_box_sliding_on_four_corners():
    # friction depends on the normal forces, which are those of equally stiff contacts
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.4, 0.3, 0.2), pin.SE3.Identity())
    corners = [f"{x:+g} {y:+g}" for x in (-0.2, 0.2) for y in (-0.15, 0.15)]
    for corner in corners:
        place = pin.SE3(np.eye(3), np.array([*map(float, corner.split()), -0.1]))
        model.addFrame(pin.Frame(corner, joint, place, pin.FrameType.OP_FRAME))
    scene = Scene(model, [Contact(corner, Plane(), 0.3) for corner in corners])
    q, v = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]), np.array([1.0, 0.2, 0.0, 0.0, 0.0, 0.5])
    tau, rng = np.array([0.3, 0.1, 0.0, 0.0, 0.0, 0.05]), np.random.default_rng(0)
    A, B = Stepper(scene, q, v, **EXACT).linearize(tau, 0.05)
    along = np.array([1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0, 1])  # on the floor
    dx, du = along * rng.normal(size=12), rng.normal(size=6)

    def after(h):
        other = Stepper(scene, pin.integrate(model, q, h * dx[:6]), v + h * dx[6:], **EXACT)
        return other.step(tau + h * du, 0.05)

    steps = [after(k * 1e-4) for k in (-2, -1, 1, 2)]
    a, b, c, d = (np.concatenate([pin.difference(model, steps[0][0], x), y]) for x, y in steps)
    expected = (a - 8 * b + 8 * c - d) / 12e-4
    assert np.linalg.norm(A @ dx + B @ du - expected) < 1e-8 * np.linalg.norm(expected)


def same_steps(one, other, tau, dt):
    """Take a step in two steppers and compare the results."""
    for each in (one, other):
        each.step(tau, dt)
    assert np.array_equal(one.q, other.q)
    assert np.array_equal(one.v, other.v)
    found, expected = one.trajectory, other.trajectory
    assert len(found.impacts) == len(expected.impacts)
    assert found.modes == expected.modes
    assert found.statistics == expected.statistics
    return found


def test_linearize_does_not_change_the_motion():
    model, q, v, contact = panda(1)
    scene = Scene(model, [replace(contact, restitution=0.0, friction=0.2)], **FREE)
    tau = np.random.default_rng(0).normal(size=9)
    one, other = (Stepper(scene, q, v) for _ in range(2))
    for _ in range(4):
        one.linearize(-tau, 0.06)
        run = same_steps(one, other, tau, 0.03)
    assert run.impacts
    assert {("hand", "slip"), ("hand", "stick")} <= modes(run)


def test_linearize_that_raises_does_not_change_the_motion():
    # a callback in a time step
    ball = Contact("ball centre", Plane(), 0.0, 0.7, name="ball")
    kick = Event(lambda t, q, v: q[0] - 0.065, lambda t, q, v: v, jacobian=lambda t, q, v: None, name="kick")
    scene = Scene(point("ball"), [ball], events=[kick])
    given = [0.0, 0.0, 0.1], [0.1, 0.0, 0.0]
    one, other = (Stepper(scene, *given, scheme="time-stepping") for _ in range(2))
    for _ in range(2):
        for _ in range(2):
            with pytest.raises(pinimpact.InputError, match="'kick' ends a time step"):
                one.linearize(np.zeros(3), 0.7)
        run = same_steps(one, other, np.zeros(3), 0.3)
    assert run.impacts


def test_accumulating_bounces_have_derivative_only_after_rest():
    ball = Contact("ball centre", Plane(), 0.0, 0.7, name="ball")
    scene = Scene(point("ball"), [ball], resting_speed=1e-60)
    with pytest.warns(pinimpact.SteppedWarning):
        found = Stepper(scene, [0.0, 0.0, 0.1], np.zeros(3)).linearize(np.zeros(3), 1.0)
    assert np.isnan(found.A).all()
    assert found.boundary != Boundary.NONE


# ---- boundaries and errors


@pytest.mark.parametrize("friction", [0.2, 0.25])
def test_stick_threshold_is_flagged(friction):
    """A variation to one side makes the block or the joint slide."""
    block = Contact("block centre", Plane(normal=(0.2, 0.0, 1.0)), friction)
    mass = pin.Model()
    joint = mass.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    mass.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    mass.friction[:] = 9.81 * friction / 0.2
    model, level = box(), pin.neutral(box())
    level[2] = 0.15
    model.gravity.linear = np.array([-0.2 * 9.81, 0.0, -9.81])
    scenes = [
        (Scene(one, contacts), np.zeros(one.nq)) for one, contacts in ((point("block"), block), (mass, ()))
    ]
    for scene, q in [*scenes, (Scene(model, corners(friction, 0.0)), level)]:
        run = simulate(scene, q, np.zeros(scene.model.nv), 0.1, sensitivities="state")
        assert (Boundary.STICK_THRESHOLD in run.sensitivity(0.1).boundary) == (friction == 0.2)


def test_unloaded_contact_has_no_derivative_along_its_normal():
    """A ball moves along a wall: velocities away from the wall are free, those towards it are stopped."""
    wall = Contact("block centre", Plane(normal=(1.0, 0.0, 0.0)), 0.3)
    for scheme in ("event-driven", "time-stepping"):
        options = {"scheme": scheme, "sensitivities": ("state", "friction:block centre on plane")}
        run = simulate(Scene(point("block"), wall), np.zeros(3), np.array([0, 0.3, 0.2]), 0.1, **options)
        found = run.sensitivity(0.1)
        assert np.isnan(found.state[:, [0, 3]]).any(axis=0).all()
        assert np.isfinite(found.state[:, [1, 2, 4, 5]]).all()
        assert found.boundary & (Boundary.GRAZING | Boundary.EVENTS_COINCIDE)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("dry", [0.0, 5.0])
def test_joint_resting_on_lower_or_upper_limit_returns_to_it(scheme, sign, dry):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.3, 0.3
    model.gravity.linear, model.friction[:] = np.array([0.0, 0.0, sign * 9.81]), dry
    run = simulate(Scene(model), [0.3 * sign], [0.0], 0.1, scheme=scheme, sensitivities="state")
    found = run.sensitivity(0.1)
    assert np.allclose(found.state, 0.0, atol=1e-3)
    assert found.boundary == Boundary.CLOSED


def test_micrometre_arm_has_derivatives_of_metre_arm():
    """Errors of joint velocities (1 rad/s) must not count as errors of the tip velocity (1 µm/s)."""
    found = []
    for size in (1.0, 1e-6):
        model, joint = pin.Model(), 0
        for name, at in (("upper", 0.0), ("lower", 1.0)):
            place = pin.SE3(np.eye(3), size * np.array([at, 0, 0]))
            joint = model.addJoint(joint, pin.JointModelRY(), place, name)
            inertia = pin.Inertia(1.0, size * np.array([0.5, 0, 0]), size**2 * 0.1 * np.eye(3))
            model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), size * np.array([1.0, 0, 0]))
        model.addFrame(pin.Frame("tip", joint, place, pin.FrameType.OP_FRAME))
        model.gravity.linear = size * np.array([0, 0, -9.81])
        scene = Scene(model, Contact("tip", Plane((0, 0, -size)), 0.3, 0.5), **FREE)
        options = {"rtol": 1e-9, "atol": 1e-12 * size, "scheme": "event-driven", "sensitivities": "state"}
        run = simulate(scene, np.array([0.1, 0.3]), np.array([1.0, -0.5]), 0.3, **options)
        assert len(run.impacts) == 1
        found.append(run.sensitivity(0.3).state)
    assert np.isfinite(found).all()
    assert np.allclose(*found, rtol=1e-5)


def test_saltation_at_grazing_contact_is_nan():
    ball = Contact("ball centre", Plane(), 0.0, 0.5, name="ball")
    scene = Scene(point("ball"), [ball], resting_speed=1e-12)
    found = pinimpact.saltation_matrix(scene, "ball", np.zeros(3), [0.0, 0.0, -1e-9])
    assert np.isnan(found).all()


def test_unsupported_derivatives_raise():
    model, q, v, contact = panda(0)
    scene = Scene(model, [contact], **FREE)

    def refuses(words, scene=scene, names=("state",), kind=pinimpact.InputError, duration=0.1, **options):
        with pytest.raises(kind, match=words):
            simulate(scene, q, v, duration, sensitivities=names, **options).sensitivity(duration)

    refuses("control", replace(scene, control=lambda t, q, v: np.zeros(9)))
    kick = Event(lambda t, q, v: t - 0.05, lambda t, q, v: v, name="kick")
    refuses("callback of 'kick'.*jacobian=", replace(scene, events=[kick]))
    few = replace(kick, jacobian=lambda t, q, v: np.eye(9))
    refuses("jacobian: .*shape", replace(scene, events=[few]))
    failing = replace(kick, jacobian=lambda t, q, v: v["tip"])
    refuses(r"jacobian: IndexError at t = 0\.05 s: ", replace(scene, events=[failing]))
    refuses("expected", names=["mass"])
    refuses("sensitivities: True given, a name or a sequence", names=True)
    refuses("no contact 'foot'", names=["friction:foot"], kind=pinimpact.UnknownNameError)
    varying = replace(contact, restitution=lambda speed: 0.5)
    refuses("function", replace(scene, contacts=[varying]), ["restitution:hand"])
    crate = Contact(geometry="a", plane=Box((0.8, 0.6, 0.2)), name="crate")
    refuses("two shapes", Scene(above_a_block(BALL, False), crate), ["friction:crate"])
    with pytest.raises(pinimpact.InputError, match="sensitivities="):
        simulate(scene, q, v, 0.01).sensitivity(0.0)
    with pytest.raises(pinimpact.UnknownNameError, match="foot"):
        pinimpact.saltation_matrix(scene, "foot", q, v)
    with pytest.raises(pinimpact.InputError, match="nothing collides"):
        pinimpact.saltation_matrix(scene, "hand", q, v)
    sampled = replace(scene, control=lambda t, q, v: np.zeros(9), period=0.01)
    with pytest.raises(pinimpact.InputError, match="sampled"):
        pinimpact.saltation_matrix(sampled, "hand", q, v)


def test_contacts_closing_simultaneously_have_no_derivative():
    contacts = [Contact(f"{name} centre", Plane(), 0.3, 0.5) for name in "ab"]
    rod = pin.Model()
    joint = rod.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    rod.appendBodyToJoint(joint, pin.Inertia.FromCylinder(1.0, 0.05, 1.0), pin.SE3.Identity())
    for name, x in (("a", -0.5), ("b", 0.5)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        rod.addFrame(pin.Frame(f"{name} centre", joint, place, pin.FrameType.OP_FRAME))
    q, v = np.array([0, 0, 0.1, 0, 0, 0, 1.0]), np.zeros(6)
    run = simulate(Scene(rod, contacts), q, v, 0.3, sensitivities="state")
    assert np.isfinite(run.sensitivity(0.05).state).all()
    after = run.sensitivity(0.2)
    assert np.isnan(after.state).all()
    assert after.boundary & Boundary.EVENTS_COINCIDE


def test_uncoupled_balls_landing_simultaneously_have_derivatives():
    # each ball has the derivatives of a single ball
    contacts = [Contact(f"{name} centre", Plane(), 0.3, 0.5, name=name) for name in "ab"]
    q, v = np.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.1]), np.array([0.3, 0.1, 0.0, 0.0, 0.2, 0.0])
    run = simulate(Scene(point("a", "b"), contacts), q, v, 0.2, sensitivities=("state", "friction:b"))
    found = run.sensitivity(0.2)
    for name, contact, own in zip("ab", contacts, (slice(3), slice(3, 6)), strict=True):
        scene = Scene(point(name), [contact])
        alone = simulate(scene, q[own], v[own], 0.2, sensitivities=("state", f"friction:{name}")).sensitivity(
            0.2
        )
        rows = np.r_[np.arange(6)[own], 6 + np.arange(6)[own]]
        assert np.allclose(found.state[np.ix_(rows, rows)], alone.state, atol=1e-12)
        by = alone.parameters[f"friction:{name}"] if name == "b" else 0.0
        assert np.allclose(found.parameters["friction:b"][rows], by, atol=1e-12)
    assert not found.boundary


def test_events_without_callback_have_no_effect():
    model, q, v, contact = panda(0)
    plain = simulate(Scene(model, [contact], **FREE), q, v, 0.1, sensitivities="state")
    halfway = plain.at(0.03)[0][3]
    event = Event(lambda t, q, v: q[3] - halfway, name="halfway")
    scene = Scene(model, [contact], events=[event], **FREE)
    run = simulate(scene, q, v, 0.1, sensitivities="state")
    assert run.events
    assert np.allclose(run.sensitivity(0.1).state, plain.sensitivity(0.1).state, atol=1e-7)


def test_callback_sets_velocity():
    # the event and the new velocity depend on time and state
    model, q, v, contact = panda(0)
    matrix = 0.1 * np.random.default_rng(1).normal(size=(9, 9))
    threshold = q[3] + 0.1 * v[5] - 0.03

    def guard(t, q, v):
        return q[3] + 0.1 * v[5] - threshold + 0.5 * t

    def kick(t, q, v):
        return v + 0.2 * np.sin(q) + matrix @ v * (1.0 + t)

    def jacobian(t, q, v):
        by_v = np.eye(9) + matrix * (1.0 + t)
        of_guard = 1.0 * (np.arange(19) == 3) + 0.1 * (np.arange(19) == 14) + 0.5 * (np.arange(19) == 18)
        return np.vstack([np.hstack([np.diag(0.2 * np.cos(q)), by_v, (matrix @ v)[:, None]]), of_guard])

    kicks = [Event(guard, kick, name="kick", jacobian=jacobian)]
    run = check_sensitivity(Scene(model, [contact], events=kicks, **FREE), q, v, 0.15, 3)
    assert len(run.events) > 1
    assert run.impacts


def test_callback_accelerates_sliding_block():
    # at x = c, the velocity changes from u = √(v² − 2μgc) to k u
    mu, v, c, k, duration = 0.2, 1.5, 0.2, 1.3, 0.5
    row = np.eye(7)

    def jacobian(t, q, v):
        return np.vstack([k * row[3], k * row[4], row[5], row[0]])

    event = Event(lambda t, q, v: q[0] - c, lambda t, q, v: v * [k, k, 1.0], name="kick", jacobian=jacobian)
    scene = Scene(point("block"), [Contact("block centre", Plane(), mu, name="block")], events=[event])
    found = simulate(scene, np.zeros(3), [v, 0.0, 0.0], duration, sensitivities="state").sensitivity(duration)
    u = np.sqrt(v**2 - 2 * mu * 9.81 * c)
    assert np.isclose(found.state[3, 3], k * v / u + 1.0 - v / u, rtol=1e-7)
    assert np.isclose(found.state[3, 0], (k - 1.0) * mu * 9.81 / u, rtol=1e-7)


def test_slip_reverses_on_curved_path():
    # a spring pulls back a hand that slides along the floor
    model, q, _, contact = panda(0, above=0.005)
    hand = replace(contact, friction=0.2, restitution=0.0)
    at = pinimpact.contact_matrices(model, model.createData(), q, hand)
    v = np.linalg.pinv(at.jacobian) @ np.array([0.6, 0.1, -0.3])
    scene = Scene(model, [hand], control=JointPD(600.0, 1.0, q - 0.03), **FREE)
    run = check_sensitivity(scene, q, v, 0.3, 5, ("friction:hand",))
    directions = [step.directions[0, 0] for step in run._segments if step.directions is not None]
    assert any(a @ b < -0.5 for a, b in itertools.pairwise(directions))


def test_stopping_joint_releases_another():
    # dry friction: the force at the other joint jumps when the first one stops
    model, q, v, contact = panda(6)
    model.friction = np.random.default_rng(6).uniform(0, 8, 9)
    check_sensitivity(Scene(model, [replace(contact, friction=0.2, restitution=0.0)], **FREE), q, v, 0.15, 6)


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-11])
def test_sensitivities_at_rest_satisfy_tolerance(rtol):
    # a mass on a spring at rest: the motion takes two steps, its variations oscillate several times
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    k, duration = 900.0, 0.6
    scene = Scene(model, control=JointPD(k, 0.0, [0.0]))
    run = simulate(scene, [0.0], [0.0], duration, rtol=rtol, sensitivities="state")
    w = np.sqrt(k)
    c, s = np.cos(w * duration), np.sin(w * duration)
    found, exact = run.sensitivity(duration).state, np.array([[c, s / w], [-w * s, c]])
    scale = np.array([[1.0, 1.0 / w], [w, 1.0]])
    assert np.abs((found - exact) / scale).max() < 30 * rtol  # some thirty intervals


def test_two_joints_and_sliding_contact_stop_together():
    """Dry friction stops two joints and a sliding contact at the same time.

    The distribution of impulses is not unique, but the time at which the leg stops is.
    """
    model, joint, first, second = pin.Model(), 0, -0.5, 1.3
    for k, kind in enumerate((pin.JointModelPX, pin.JointModelRY, pin.JointModelRY)):
        place = pin.SE3(np.eye(3), np.array([float(k == 2), 0.0, 0.0]))
        joint = model.addJoint(joint, kind(), place, f"j{k}")
        inertia = pin.Inertia(1.0, np.array([0.5 * (k > 0), 0.0, 0.0]), 0.1 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    end = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", joint, 0, end, pin.FrameType.OP_FRAME))
    model.friction = np.array([0.0, 8.0, 8.0])
    height = -np.sin(first) - np.sin(first + second)
    floor = Contact("end", Plane((0.0, 0.0, height)), friction=0.3, name="end")
    scene = Scene(model, [floor], without=["joint limits"])
    q0, folds = np.array([0.0, first, second]), np.cos([first, first + second])
    fold = np.array([0.0, 1.0, -folds.sum() / folds[1]])

    def after(speed, **options):
        v0 = np.array([3.0, 0.0, 0.0]) + speed * fold
        return simulate(scene, q0, v0, 0.0252, **EXACT, **options)  # after the stop at 0.02515 s

    run, h = after(0.5, sensitivities="state"), 1e-4
    assert [mode.source for mode in run.modes if mode.mode == "stuck"] == ["j1", "j2"]
    low, high = (np.concatenate([one.q[-1], one.v[-1]]) for one in (after(0.5 - h), after(0.5 + h)))
    found = run.sensitivity(0.0252).state[:, 3:] @ fold
    np.testing.assert_allclose(found, (high - low) / (2.0 * h), rtol=0, atol=1e-5)


def leg_at_rest(first, second, height):
    """Return a scene of a slider with a leg of two hinges with dry friction, whose foot slides on a plane."""
    model, joint = pin.Model(), 0
    for k, kind in enumerate((pin.JointModelPX, pin.JointModelRY, pin.JointModelRY)):
        place = pin.SE3(np.eye(3), np.array([1.0 * (k == 2), 0.0, 0.0]))
        joint = model.addJoint(joint, kind(), place, f"joint {k}")
        lever = np.array([0.5 * (k > 0), 0.0, 0.0])
        model.appendBodyToJoint(joint, pin.Inertia(1.0, lever, 0.1 * np.eye(3)), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("foot", joint, 0, tip, pin.FrameType.OP_FRAME))
    unbounded(model)
    model.friction[:] = 0.0, 8.0, 8.0
    return Scene(model, Contact("foot", Plane(point=(0.0, 0.0, -height)), friction=0.3))


def test_derivative_includes_change_of_force_distribution():
    """Two dry hinges and a sliding foot share a load; friction depends on the share of the foot."""
    first, second, duration = -0.5, 1.3, 0.2
    height = np.sin(first) + np.sin(first + second)
    scene, v = leg_at_rest(first, second, height), np.array([3.0, 0.0, 0.0])

    def end(x, **options):
        def gap(y):
            return np.sin(first + x) + np.sin(first + x + y) - height

        q = np.array([0.0, first + x, brentq(gap, second - 0.1, second + 0.1, xtol=1e-15)])
        return simulate(scene, q, v, duration, rtol=1e-11, atol=1e-13, scheme="event-driven", **options)

    h = 1e-4
    ahead, behind = end(h), end(-h)
    expected = np.concatenate([ahead.q[-1] - behind.q[-1], ahead.v[-1] - behind.v[-1]]) / (2.0 * h)
    slope = -(np.cos(first) + np.cos(first + second)) / np.cos(first + second)
    found = end(0.0, sensitivities="state").sensitivity(duration)
    np.testing.assert_allclose(found.state @ [0.0, 1.0, slope, 0.0, 0.0, 0.0], expected, atol=1e-7)
    assert abs(expected[3]) > 1e-3


@pytest.mark.parametrize("across", [0.0, 0.3])
def test_pendulum_on_ball_joint_strikes_where_friction_moves_nothing(across):
    """Along its rod no impulse moves the tip; impacts of a motion are always at the same height of it."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "joint")
    middle, end = (pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.5, 1.0))
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 1.0, 0.1, 0.1), middle)
    model.addFrame(pin.Frame("tip", joint, 0, end, pin.FrameType.OP_FRAME))
    scene = Scene(model, [Contact("tip", Plane(), 0.3, 0.5, name="tip")])
    q = np.array(pin.Quaternion(pin.exp3(np.array([0.0, -0.5, 0.0]))).coeffs())
    run = check_sensitivity(scene, q, np.array([0.0, 2.0, across]), 0.25, 1)
    assert len(run.impacts) == 1
