"""Joints stiffened by control during an impact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, InputError, Plane, Scene, UnknownNameError, impact, studies
from pinimpact.studies.stiff_joints import stiff_joints

ROUNDING = 1e-10
"""Relative; mass matrices of the arms here have condition numbers up to 10⁵."""


@pytest.fixture(scope="module")
def panda():
    return pinimpact.load_robot("panda").model


def sliders(first, second):
    """Return a model of two masses on prismatic joints in line, the second on the first."""
    model, joint = pin.Model(), 0
    for name, mass in (("first", first), ("second", second)):
        joint = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("tip", joint, pin.SE3.Identity(), 0)
    return model


def approaching(model, contact, rng):
    """Return a random configuration and an approaching velocity."""
    q, v = pin.randomConfiguration(model), rng.normal(size=model.nv)
    data = model.createData()
    return q, v if pinimpact.contact_matrices(model, data, q, contact).velocity(v)[2] < 0 else -v


def states(model, contact, count, **options):
    """Yield random approaching states with their contact matrices, and the random generator."""
    pin.seed(3)
    rng, data = np.random.default_rng(3), model.createData()
    for _ in range(count):
        q, v = approaching(model, contact, rng)
        free = pinimpact.contact_matrices(model, data, q, contact, **options)
        yield q, v, free, rng


def added(mass, s):
    """Return the matrix K of stiffening that is added to the mass matrix."""
    return np.diag(s / (1.0 - s) * np.diag(mass))


def test_pendulum():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    rod = pin.Inertia(3.0, np.array([0.5, 0, 0]), np.diag([0, 0.25, 0.25]))
    model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    model.addBodyFrame("tip", joint, pin.SE3(np.eye(3), np.array([1.0, 0, 0])), 0)
    contact = Contact("tip", Plane(), 0.0, 0.5)
    for s in (0.0, 0.25, 0.9, 1.0 - 1e-9):
        hit = impact(model, model.createData(), np.zeros(1), np.array([2.0]), contact, stiffening=s)
        # inertia 1 kg m² about the hinge, the tip falls at 2 m/s; the rebound is independent of inertia
        assert hit.v[0] == pytest.approx(-1.0, rel=1e-12)
        assert hit.impulse_world[2] == pytest.approx(3.0 / (1.0 - s), rel=1e-9)


@pytest.mark.parametrize("s", [0.0, 0.3, 0.999, 1.0])
def test_two_masses(s):
    a, b = 2.0, 0.5
    model = sliders(a, b)
    contact = Contact("tip", Plane(), 0.0, 0.0)
    stiffening = {"second": s}
    matrices = pinimpact.contact_matrices(model, model.createData(), np.zeros(2), contact, (), (), stiffening)
    # closed form; its limits are 1/b for a free joint and 1/(a + b) for a locked one
    w = (a - b + b / (1.0 - s)) / ((a + b) * b / (1.0 - s) - b * b) if s < 1.0 else 1.0 / (a + b)
    assert matrices.delassus[2, 2] == pytest.approx(w, rel=1e-14)
    hit = impact(
        model, model.createData(), np.zeros(2), np.array([-1.0, 0.0]), contact, stiffening=stiffening
    )
    assert hit.impulse_world[2] == pytest.approx(1.0 / w, rel=1e-14)
    # change of momentum of both masses, whose only external impulse is that of the contact
    assert a * (hit.v[0] + 1.0) + b * (hit.v.sum() + 1.0) == pytest.approx(1.0 / w, rel=1e-13)


def test_zero_is_the_plain_impact_and_one_is_locked(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.5)
    data, locked = panda.createData(), ["panda_joint2", "panda_joint4"]
    for q, v, _, _ in states(panda, contact, 20):
        plain = impact(panda, data, q, v, contact)
        for free in (None, 0, 0.0):
            assert np.array_equal(impact(panda, data, q, v, contact, stiffening=free).v, plain.v)
        recorded = impact(panda, data, q, v, contact, record=True)
        nothing = impact(panda, data, q, v, contact, record=True, stiffening=dict.fromkeys(locked, 0))
        assert np.array_equal(nothing.v, recorded.v)
        of_locked = impact(panda, data, q, v, contact, locked=locked)
        whole = impact(panda, data, q, v, contact, stiffening=dict.fromkeys(locked, 1.0))
        assert np.array_equal(whole.v, of_locked.v)
        assert np.array_equal(whole.impulse_world, of_locked.impulse_world)
        nearly = pinimpact.contact_matrices(
            panda, data, q, contact, stiffening=dict.fromkeys(locked, 1.0 - 1e-12)
        )
        limit = pinimpact.contact_matrices(panda, data, q, contact, locked=locked)
        assert np.allclose(nearly.delassus, limit.delassus, rtol=0, atol=1e-8 * limit.delassus.max())


def test_arm_with_all_joints_locked_cannot_stop_approach(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.5)
    q, v, _, _ = next(states(panda, contact, 1))
    with pytest.raises(pinimpact.UnstoppableApproachError):
        impact(panda, panda.createData(), q, v, contact, stiffening=1.0)


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_stiffening_equals_rotor_inertia(panda, law):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.5, law=law)
    for q, v, free, rng in states(panda, contact, 10):
        s = rng.uniform(0.0, 0.95, panda.nv)
        with_rotors = panda.copy()
        with_rotors.armature = np.diag(added(free.mass, s)).copy()
        expected = impact(with_rotors, with_rotors.createData(), q, v, contact)
        by_joint = dict(zip(list(panda.names)[1:], s.tolist(), strict=True))
        hit = impact(panda, panda.createData(), q, v, contact, stiffening=by_joint)
        assert np.allclose(hit.v, expected.v, rtol=0, atol=ROUNDING * np.abs(expected.v).max())
        assert np.allclose(hit.impulse_world, expected.impulse_world, rtol=1e-8)
        assert hit.solution.status == expected.solution.status


def test_balance_of_momentum_and_energy(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.7, law="energetic")
    data = panda.createData()
    for q, v, free, _ in states(panda, contact, 20):
        hit = impact(panda, data, q, v, contact, stiffening={"panda_joint4": 0.6})
        s = np.where(np.arange(panda.nv) == 3, 0.6, 0.0)
        K = added(free.mass, s)
        control = free.mass @ (hit.v - v) - free.jacobian.T @ hit.solution.impulse
        scale = np.abs(free.jacobian.T @ hit.solution.impulse).max()
        assert np.allclose(control, -K @ (hit.v - v), rtol=0, atol=ROUNDING * scale)
        reactions = hit.joint_reactions(panda, data, q, v)[4]  # about the axis z of joint 4
        assert reactions[5] == pytest.approx(control[3], rel=1e-8)
        energy = [0.5 * x @ (free.mass + K) @ x for x in (v, hit.v)]
        assert hit.solution.work.total == pytest.approx(energy[1] - energy[0], abs=ROUNDING * energy[0])
        assert energy[1] <= energy[0] * (1.0 + ROUNDING)


def test_equal_stiffening_of_all_joints_reduces_coupling(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.5)
    for q, v, free, _ in states(panda, contact, 5):
        s = 0.9
        loose = (1.0 - s) * free.mass + s * np.diag(np.diag(free.mass))
        response = np.linalg.solve(loose, free.jacobian.T)
        problem = pinimpact.ImpactProblem(free.jacobian @ response, free.velocity(v), 0.4, 0.5)
        impulse = pinimpact.solve_impact(problem).impulse
        hit = impact(panda, panda.createData(), q, v, contact, stiffening=s)
        assert np.allclose(
            hit.solution.impulse, impulse / (1.0 - s), rtol=0, atol=1e-9 * np.abs(impulse).max()
        )
        assert np.allclose(hit.v, v + response @ impulse, rtol=0, atol=ROUNDING * np.abs(hit.v).max())


def test_rounding_errors_of_stiff_arm_are_relative_to_its_matrix(panda):
    contact = Contact("panda_hand_tcp", Plane())
    for q, _, free, _ in states(panda, contact, 5):
        stiff = pinimpact.contact_matrices(panda, panda.createData(), q, contact, stiffening=1.0 - 1e-12)
        assert np.allclose(
            stiff.factor @ stiff.factor.T, stiff.delassus, rtol=0, atol=1e-12 * stiff.delassus.max()
        )
        sizes = [one.factor_scale / np.linalg.norm(one.factor) for one in (free, stiff)]
        assert sizes[1] < 10.0 * sizes[0]


def test_derivatives_have_no_stiffening(panda):
    with pytest.raises(TypeError, match="stiffening"):
        pinimpact.impact_derivatives(
            panda,
            panda.createData(),
            pin.neutral(panda),
            np.ones(9),
            Contact("panda_hand_tcp", Plane()),
            stiffening=0.5,
        )


def test_more_stiffening_makes_the_contact_harder(panda):
    contact = Contact("panda_hand_tcp", Plane())
    data = panda.createData()
    for q, _, free, _ in states(panda, contact, 5):
        before = free.delassus
        for s in (0.2, 0.5, 0.9, 1.0):
            now = pinimpact.contact_matrices(panda, data, q, contact, stiffening=s).delassus
            assert np.array_equal(now, now.T)
            assert np.linalg.eigvalsh(before - now)[0] > 0.0
            before = now


def test_stiffening_with_batches_several_contacts_and_held_contacts(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.4, 0.5)
    anchor = Contact("panda_link5", Plane())
    data, stiffening = panda.createData(), {"panda_joint1": 0.5, "panda_joint6": 0.8}
    s = np.zeros(panda.nv)
    s[[0, 5]] = 0.5, 0.8
    qs, vs = [], []
    for q, v, free, _ in states(panda, contact, 4):
        qs.append(q)
        vs.append(v)
        many = impact(panda, data, q, v, [contact], stiffening=stiffening)
        expected = np.linalg.solve(free.mass + added(free.mass, s), free.jacobian.T)
        assert np.allclose(many.v, v + expected @ many.solution.impulse[0], rtol=0, atol=1e-8)
        G = pinimpact.contact_matrices(panda, data, q, anchor).jacobian
        inverse = np.linalg.inv(free.mass + added(free.mass, s))
        inverse -= inverse @ G.T @ np.linalg.solve(G @ inverse @ G.T, G @ inverse)
        held = pinimpact.contact_matrices(panda, data, q, contact, held=[anchor], stiffening=stiffening)
        assert np.allclose(held.response, inverse @ free.jacobian.T, rtol=0, atol=1e-8)
    hits = pinimpact.impacts(panda, data, np.array(qs), np.array(vs), contact, stiffening=stiffening)
    for i, (q, v) in enumerate(zip(qs, vs, strict=True)):
        alone = impact(panda, data, q, v, contact, stiffening=stiffening)
        assert np.allclose(hits.v[i], alone.v, rtol=0, atol=1e-12)
        assert np.array_equal(hits[i].v, alone.v)


def test_floating_base_stays_free():
    model = pinimpact.load_robot("solo12").model
    contact = Contact("FR_FOOT", Plane(), 0.5, 0.0)
    data = model.createData()
    joints = list(model.names)[2:]
    for q, v, _, _ in states(model, contact, 3):
        all_joints = impact(model, data, q, v, contact, stiffening=1.0)
        assert np.array_equal(all_joints.v[6:], v[6:])  # joint velocities of one rigid body do not change
        assert not np.allclose(all_joints.v[:6], v[:6])
        by_joint = impact(model, data, q, v, contact, stiffening=dict.fromkeys(joints, 1.0))
        assert np.array_equal(by_joint.v, all_joints.v)
    with pytest.raises(InputError, match=r"joint 'root_joint' has 6 velocities.*only be locked"):
        impact(model, data, q, v, contact, stiffening={"root_joint": 0.5})
    body = pin.Model()
    body.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    with pytest.raises(InputError, match="the model has no such joint"):
        pinimpact.contact_matrices(
            body, body.createData(), pin.neutral(body), Contact("body", Plane()), stiffening=0.1
        )


@pytest.mark.parametrize(
    ("stiffening", "error", "match"),
    [
        (-0.1, InputError, "stiffening: -0.1 is not between 0 and 1"),
        (1.5, InputError, "1.5 is not between 0 and 1"),
        (np.nan, InputError, "nan is not finite"),
        (np.ones(9), InputError, "a number is expected"),
        ("firm", InputError, "a real number is expected"),
        ({"panda_joint1": 2}, InputError, r"stiffening\['panda_joint1'\]: 2.0 is not between 0 and 1"),
        ({"panda_joint8": 0.5}, UnknownNameError, "no joint is called 'panda_joint8'; did you mean"),
        ({10: 0.5}, UnknownNameError, "there is no joint 10; this model's joints are 1 to 9"),
    ],
)
def test_invalid_stiffening_raises(panda, stiffening, error, match):
    contact = Contact("panda_hand_tcp", Plane())
    q, v = pin.neutral(panda), np.ones(panda.nv)
    with pytest.raises(error, match=match):
        impact(panda, panda.createData(), q, v, contact, stiffening=stiffening)
    with pytest.raises(error, match=match):
        pinimpact.impacts(panda, panda.createData(), q, v, contact, stiffening=stiffening)
    with pytest.raises(error, match=match):
        impact(panda, panda.createData(), q, v, [contact], stiffening=stiffening)


FREE = {"friction": (0, 2), "restitution": (0, 1), "stiffening": (0, 1)}


def strikes(model, contact, count, rng):
    """Return configurations within the joint limits and approaching velocities of random impacts."""
    data = model.createData()
    q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit, (count, model.nq))
    v = rng.normal(size=(count, model.nv))
    for row, rates in zip(q, v, strict=True):
        if pinimpact.contact_matrices(model, data, row, contact).velocity(rates)[2] > 0:
            rates *= -1
    return q, v


@pytest.fixture(scope="module")
def arm(panda):
    contact = Contact("panda_hand_tcp", Plane(), 0.3, 0.4, name="tip")
    q, v = strikes(panda, contact, 40, np.random.default_rng(0))
    return Scene(panda, [contact]), q, v


def test_derivatives_for_fits_agree_with_difference_quotients(arm):
    scene, q, _ = arm
    scene = replace(scene, locked=["panda_joint3"])
    data, names = scene.model.createData(), ["stiffening", "stiffening:panda_joint4"]

    def matrices(x):
        by_joint = dict.fromkeys(list(scene.model.names)[1:], x[0]) | {"panda_joint4": x[1]}
        given = scene.contacts[0], (), scene.locked, by_joint
        return [pinimpact.contact_matrices(scene.model, data, row, *given) for row in q[:5]]

    x, h = np.array([0.3, 0.7]), 1e-6
    stiff = stiff_joints(names, scene, matrices(x), np.broadcast_to(np.eye(scene.model.nv), (5, 9, 9)))
    W, to_velocities, W_slopes, slopes = stiff.matrices(x)
    now = matrices(x)
    assert np.allclose(W, [one.delassus for one in now], rtol=1e-10)
    assert np.allclose(to_velocities, [one.response for one in now], rtol=0, atol=1e-10 * W.max())
    for p, step in enumerate(h * np.eye(2)):
        for of_fit, name in ((W_slopes, "delassus"), (slopes, "response")):
            above, below = ([getattr(one, name) for one in matrices(x + sign * step)] for sign in (1, -1))
            quotient = (np.array(above) - below) / (2 * h)  # with errors of h² and of rounding over h
            assert np.allclose(of_fit[p], quotient, rtol=0, atol=1e-7 * np.abs(quotient).max())


def test_fits_recover_stiffening_friction_and_restitution(arm):
    scene, q, v = arm
    after = pinimpact.impacts(
        scene.model, scene.model.createData(), q, v, scene.contacts[0], stiffening=0.6
    ).v
    exact = studies.identify((q, v, after), scene, free=FREE)
    assert np.allclose(exact.x, [0.3, 0.4, 0.6], rtol=0, atol=1e-6)
    noise = 0.01 * np.random.default_rng(1).normal(size=after.shape)
    for covariance in (None, 1e-4 * np.eye(9)):
        fit = studies.identify((q, v, after + noise), scene, free=FREE, covariance=covariance)
        low, high = fit.interval(0.999).T
        assert (low <= [0.3, 0.4, 0.6]).all()
        assert (high >= [0.3, 0.4, 0.6]).all()
        assert fit.standard_errors.max() < 0.03
        assert not fit.unidentified
    with pytest.raises(InputError, match=r"a scene has no stiffening; use impact\(…, stiffening=0.6"):
        exact.apply(scene)


def test_fits_recover_stiffening_of_single_joints(arm):
    scene, q, v = arm
    by_joint = dict.fromkeys(list(scene.model.names)[1:], 0.2) | {"panda_joint2": 0.9}
    data = scene.model.createData()
    after = pinimpact.impacts(scene.model, data, q, v, scene.contacts[0], stiffening=by_joint).v
    free = {"stiffening": (0, 1), "stiffening:panda_joint2": (0, 1)}
    fit = studies.identify((q, v, after), scene, free=free)
    assert np.allclose(fit.x, [0.2, 0.9], rtol=0, atol=1e-6)


@pytest.mark.parametrize("by_group", [pytest.param(False, marks=pytest.mark.exhaustive), True])
def test_intervals_contain_the_true_stiffening(arm, by_group):
    scene, q, v = arm
    data, contact, repetitions = scene.model.createData(), scene.contacts[0], 30
    group = np.repeat(np.arange(10), 4) if by_group else np.arange(40)
    inside, after = np.zeros(3), np.empty_like(v)
    for k in range(repetitions):
        rng = np.random.default_rng(k)
        s = 0.4 + 0.05 * by_group * rng.normal(size=10)
        if by_group or k == 0:
            for one, rows in zip(s, np.arange(40).reshape(10, 4), strict=True):
                hits = pinimpact.impacts(scene.model, data, q[rows], v[rows], contact, stiffening=float(one))
                after[rows] = hits.v
        noisy = after + 0.01 * rng.normal(size=v.shape)
        low, high = studies.identify((q, v, noisy), scene, free=FREE, group=group).interval().T
        inside += (low <= [0.3, 0.4, 0.4]) & (high >= [0.3, 0.4, 0.4])
    # fewer than 25 of 30 have a probability of 0.3 % at 95 %
    assert inside.min() >= 25


def test_stiffening_of_single_joint_is_not_identifiable():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addBodyFrame("tip", joint, pin.SE3(np.eye(3), np.array([1.0, 0, 0])), 0)
    rng = np.random.default_rng(0)
    before = rng.uniform(1.0, 2.0, (20, 1))
    after = -0.5 * before + 0.01 * rng.normal(size=(20, 1))
    scene = Scene(model, [Contact("tip", Plane(), 0.0, 0.5)])
    fit = studies.identify((np.zeros((20, 1)), before, after), scene, free={"stiffening": (0, 0.9)})
    assert fit.unidentified[0].startswith("stiffening is not determined")


def test_invalid_fits_of_stiffening_raise(arm):
    scene, q, v = arm
    free = {"stiffening": (0, 1)}
    for scene_of, given, error, match in (
        (
            None,
            free,
            InputError,
            r"free: stiffening is a parameter of robot joints; give \(q, v_before, v_after\)",
        ),
        (scene, {"stiffening": (0, 2)}, InputError, "two rising numbers from 0 to 1 are expected"),
        (scene, {"stiffening": (-1, 1)}, InputError, "two rising numbers from 0 to 1 are expected"),
        (scene, {"stiffening:panda_joint8": (0, 1)}, UnknownNameError, "is not a joint with one velocity"),
        (replace(scene, held=[Contact("panda_link3", Plane())]), free, InputError, "with held contacts"),
    ):
        states = (np.eye(3)[None], np.ones((1, 3)), np.ones((1, 3))) if scene_of is None else (q, v, v)
        with pytest.raises(error, match=match):
            studies.identify(states, scene_of, free=given)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    body = Scene(model, [Contact("universe", Plane(body=None), name="tip")])
    with pytest.raises(InputError, match="no joint of the robot has one velocity"):
        studies.identify(
            (np.tile(pin.neutral(model), (3, 1)), np.ones((3, 6)), np.ones((3, 6))), body, free=free
        )
