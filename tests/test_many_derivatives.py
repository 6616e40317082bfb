"""Derivatives of impacts at several contacts against closed forms, identities and difference quotients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import (
    Boundary,
    Contact,
    ImpactProblem,
    Plane,
    Sphere,
    impact,
    impact_derivatives,
    solve_impact,
)

from .robot_cases import load, q0_of, random_state, two_arms
from .scene_models import box_on
from .test_impact_derivatives import MOVING, Decaying, slope
from .test_landings import landing_by_steps

FEET = ("FL_FOOT", "HL_FOOT", "FR_FOOT", "HR_FOOT")


def chain(count, e, stiffness=None):
    """Return a model of balls of 1 kg in a row, contacts of neighbours, and a configuration in contact."""
    model = pin.Model()
    for i in range(count):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"ball {i}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"centre {i}", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    contacts = [
        Contact(
            *(f"centre {i}", Sphere(radius=0.1, body=f"centre {i + 1}"), 0.0, e, "energetic"),
            radius=0.1,
            stiffness=1.0 if stiffness is None else stiffness[i],
        )
        for i in range(count - 1)
    ]
    return model, contacts, 0.2 * np.arange(count)


def quadruped(seed):
    """Return solo12 in a random state of falling."""
    model, data = load("solo12")
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, q0_of("solo12"), 0.2 * rng.normal(size=18))
    v = rng.normal(size=18)
    v[2] -= 1.0
    return model, data, q, v


def blocks(d):
    """Return the derivatives of v⁺ and P by name, (rows, columns)."""
    names = "dq", "dv", "dfriction", "drestitution"
    size = d.dP_dq.size // d.dP_dq.shape[-1]
    return {
        name: np.vstack([getattr(d, f"dv_{name}"), getattr(d, f"dP_{name}").reshape(size, -1)])
        for name in names
    }


def differences(model, data, q, v, contacts, step=2e-4, **options):
    """Return the same as `blocks` by difference quotients of fourth order."""
    n = len(contacts)

    def after(q, v, contacts=contacts):
        hit = impact(model, data, q, v, contacts, **options)
        return np.concatenate([hit.v, hit.impulses_world.ravel()])

    def changed(name, e):
        return [replace(c, **{name: getattr(c, name) + x}) for c, x in zip(contacts, e, strict=True)]

    nv = model.nv
    found = {"dq": slope(lambda e: after(pin.integrate(model, q, e), v), nv, step)}
    found["dv"] = slope(lambda e: after(q, v + e), nv, step)
    for name in ("friction", "restitution"):
        if not any(callable(getattr(c, name)) for c in contacts):
            found[f"d{name}"] = slope(lambda e, name=name: after(q, v, changed(name, e)), n, step)
    return found


def agree(d, expected, tolerance=1e-8):
    """Return whether all derivatives agree within a tolerance relative to their norm."""
    found = blocks(d)
    return all(
        np.linalg.norm(found[name] - value) <= tolerance * max(np.linalg.norm(value), 1.0)
        for name, value in expected.items()
    )


SLOPE = Plane(normal=(0.1, -0.1, 0.9), **MOVING)
CONTACTS = {
    "floor and slope": [
        Contact(FEET[0], Plane(), 0.5, 0.3, "energetic"),
        Contact(FEET[1], SLOPE, 0.4, 0.5, "energetic", radius=0.016),
    ],
    "on the robot itself": [
        Contact(FEET[0], SLOPE, 0.5, 0.3, "energetic", radius=0.016),
        Contact(FEET[1], Plane(), 0.4, 0.5, "energetic", stiffness=3.0),
        Contact(
            *(FEET[2], Sphere((0.2, 0.1, -0.1), radius=0.2, body="HR_LOWER_LEG", **MOVING), 0.3, 0.4),
            law="energetic",
            radius=0.01,
        ),
    ],
    "e of the approach": [
        Contact(FEET[0], Plane(), 0.5, Decaying(), "energetic"),
        Contact(FEET[1], Plane(), 0.4, 0.5, "energetic", radius=0.016),
    ],
}


@pytest.mark.parametrize("kind", CONTACTS)
def test_robots_against_differences(kind):
    contacts, (model, data, q, v) = CONTACTS[kind], quadruped(0)
    d = impact_derivatives(model, data, q, v, contacts)
    assert d.boundary == Boundary.NONE
    assert np.array_equal(d.v, impact(model, data, q, v, contacts).v)
    assert agree(d, differences(model, data, q, v, contacts))


def test_locked_joints_and_held_contacts():
    model, data, q, v = quadruped(1)
    contacts, locked = CONTACTS["floor and slope"], ["FR_KFE", "HR_HAA"]
    d = impact_derivatives(model, data, q, v, contacts, locked=locked)
    assert agree(d, differences(model, data, q, v, contacts, locked=locked))
    # at each q the velocity is projected so that the held foot is at rest
    hold = Contact(FEET[3], Plane())

    def standing(q):
        rows = pinimpact.contact_matrices(model, data, q, hold).jacobian
        return v - np.linalg.pinv(rows) @ rows @ v

    d = impact_derivatives(model, data, q, standing(q), contacts, held=[hold])
    move = np.random.default_rng(2).normal(size=18)

    def after(e):
        at = pin.integrate(model, q, e[0] * move)
        return impact(model, data, at, standing(at), contacts, held=[hold]).v

    expected = slope(after, 1, 2e-4)[:, 0]
    turned = slope(lambda e: standing(pin.integrate(model, q, e[0] * move)), 1, 2e-4)[:, 0]
    assert np.linalg.norm(d.dv_dq @ move + d.dv_dv @ turned - expected) < 1e-8 * np.linalg.norm(expected)


def test_one_contact_in_a_list():
    model, data, q, v = quadruped(3)
    contact = CONTACTS["floor and slope"][1]
    many, one = (impact_derivatives(model, data, q, v, c) for c in ([contact], contact))
    expected = {"dq": (one.dv_dq, one.dP_dq), "dv": (one.dv_dv, one.dP_dv)}
    for name in ("dfriction", "drestitution"):
        expected[name] = tuple(getattr(one, f"{of}_{name}")[:, None] for of in ("dv", "dP"))
    assert agree(many, {name: np.vstack(rows) for name, rows in expected.items()}, 1e-9)


def test_decoupled_impacts_of_two_robots():
    model, data = two_arms()
    rng = np.random.default_rng(4)
    contacts = [Contact(tip, Plane(), 0.3, 0.5, "energetic") for tip in ("tool0", "other_tool0")]
    while True:
        q, v = random_state(model, rng)
        singles = [impact_derivatives(model, data, q, v, contact) for contact in contacts]
        if all(one.dP_dv.any() for one in singles):
            break
    d = impact_derivatives(model, data, q, v, contacts)
    by_both = sum(one.dv_dv - np.eye(model.nv) for one in singles)
    assert np.allclose(d.dv_dv - np.eye(model.nv), by_both, rtol=1e-9, atol=1e-9)
    assert np.allclose(d.dv_dq, sum(one.dv_dq for one in singles), rtol=1e-9, atol=1e-9)
    for k, one in enumerate(singles):
        assert np.allclose(d.dP_dv[k], one.dP_dv, rtol=1e-9, atol=1e-9)
        assert np.allclose(d.dP_dfriction[k, :, k], one.dP_dfriction, rtol=1e-9, atol=1e-9)
        assert np.allclose(d.dP_dfriction[k, :, 1 - k], 0.0, atol=1e-9)


def test_order_of_contacts_does_not_matter():
    model, data, q, v = quadruped(5)
    contacts = CONTACTS["on the robot itself"]
    one = impact_derivatives(model, data, q, v, contacts)
    other = impact_derivatives(model, data, q, v, contacts[::-1])
    assert np.allclose(one.dv_dq, other.dv_dq, rtol=1e-9, atol=1e-9)
    assert np.allclose(one.dv_drestitution, other.dv_drestitution[:, ::-1], rtol=1e-9, atol=1e-9)
    assert np.allclose(one.dP_dv, other.dP_dv[::-1], rtol=1e-9, atol=1e-9)


# ---- closed forms and identities


@pytest.mark.parametrize(
    ("policy", "law"), [("propagate", "energetic"), ("sequence", "newton"), ("together", "poisson")]
)
def test_two_balls_swap_their_velocities(policy, law):
    model, (contact,), q = chain(2, 1.0)
    contacts = [replace(contact, law=law)]
    d = impact_derivatives(model, model.createData(), q, [1.0, -0.5], contacts, simultaneous=policy)
    assert np.allclose(d.dv_dv, [[0.0, 1.0], [1.0, 0.0]], atol=1e-9)
    assert np.allclose(d.dv_dq, 0.0, atol=1e-9)
    # v₁⁺ = (1 − e)/2 v₁ + (1 + e)/2 v₂, and vice versa
    assert np.allclose(d.dv_drestitution[:, 0], [-0.75, 0.75], atol=1e-8)
    assert d.boundary & Boundary.BOUND


def test_row_of_balls_conserves_momentum_and_energy():
    v = np.array([1.0, 0.3, 0.0, -0.2])
    model, contacts, q = chain(4, 1.0, (1.0, 100.0, 1e4))
    d = impact_derivatives(model, model.createData(), q, v, contacts)
    assert np.allclose(d.dv_dv.sum(axis=0), 1.0, atol=1e-9)
    assert np.allclose(d.v @ d.dv_dv, v, atol=1e-8)
    assert np.allclose(d.dv_dv @ v, d.v, atol=1e-9)


def test_sequence_of_elastic_impacts_sorts_velocities():
    model, contacts, q = chain(3, 1.0)
    v = np.array([3.0, 1.0, -2.0])
    d = impact_derivatives(model, model.createData(), q, v, contacts, simultaneous="sequence")
    assert np.allclose(d.dv_dv, np.eye(3)[np.argsort(v)], atol=1e-9)


def test_impulses_are_homogeneous_in_velocities():
    # of degree 1 if no surface moves, in all regimes
    for seed in range(6):
        model, data, q, v = quadruped([6, seed])
        contacts = [Contact(name, Plane(), 0.4, 0.3, "energetic") for name in FEET]
        d = impact_derivatives(model, data, q, v, contacts)
        hit = impact(model, data, q, v, contacts)
        assert np.allclose(d.dP_dv @ v, hit.impulses_world, atol=1e-8)
        assert np.allclose(d.dv_dv @ v, hit.v, atol=1e-8)


# ---- redundant contacts, bounds of coefficients, contacts at rest


@pytest.mark.parametrize(("mu", "e"), [(0.3, 0.0), (0.0, 0.4)])
def test_corners_of_a_box(mu, e):
    model, contacts = box_on(4, mu=mu)
    contacts = [replace(contact, restitution=e, law="energetic") for contact in contacts]
    q, v = np.array([0, 0, 0.1, 0, 0, 0, 1.0]), np.array([0.3, 0.2, -1.0, 0.3, 0.2, 0.1])
    data = model.createData()
    d = impact_derivatives(model, data, q, v, contacts)
    assert d.boundary == Boundary.RANK | Boundary.BOUND
    by_q = slope(lambda s: impact(model, data, pin.integrate(model, q, s), v, contacts).v, 6)
    by_v = slope(lambda s: impact(model, data, q, v + s, contacts).v, 6)
    assert np.allclose(d.dv_dq, by_q, atol=1e-8)
    assert np.allclose(d.dv_dv, by_v, atol=1e-8)


def test_derivatives_by_motion_of_foot_at_rest_are_nan():
    model, data, q, v = quadruped(7)
    strikes, rests = CONTACTS["floor and slope"][0], Contact(FEET[3], Plane(), 0.6, 0.0, "energetic")
    rows = pinimpact.contact_matrices(model, data, q, rests).jacobian
    v = v - np.linalg.pinv(rows) @ (rows @ v)
    d = impact_derivatives(model, data, q, v, [strikes, rests])
    assert d.boundary & Boundary.GRAZING
    moves = np.abs(rows).max(axis=0) > 1e-9
    assert np.isnan(d.dv_dv[:, moves]).all()
    still = slope(lambda e: impact(model, data, q, v + e, [strikes, rests]).v, 18, 1e-4)[:, ~moves]
    assert still.shape[1] == 9
    assert np.allclose(d.dv_dv[:, ~moves], still, atol=1e-8)
    assert np.isfinite(d.dv_dfriction).all()


@pytest.mark.parametrize(("side", "ball"), [(1, 2), (-1, 3)])
def test_one_sided_derivatives_of_balls_at_rest(side, ball):
    model, contacts, q = chain(4, 0.5, (1.0, 2.0, 1.0))
    data, v = model.createData(), np.array([1.0, 0.0, 0.0, 0.0])
    both = impact_derivatives(model, data, q, v, contacts)
    assert np.isnan(both.dv_dv[:, 2:]).all()
    d = impact_derivatives(model, data, q, v, contacts, side=side)
    h = 1e-4 * side
    a, b, c = (impact(model, data, q, v + s * np.eye(4)[ball], contacts).v for s in (0.0, h, 2 * h))
    assert np.allclose(d.dv_dv[:, ball], (-3 * a + 4 * b - c) / (2 * h), atol=1e-5)
    assert d.boundary & Boundary.GRAZING
    assert np.array_equal(d.dv_dv[:, :2], both.dv_dv[:, :2])


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=() if seed % 3 == 0 else pytest.mark.exhaustive) for seed in range(30)]
)
def test_finite_derivatives_are_correct_on_both_sides(seed):
    # with balls at rest, ties and symmetries
    rng = np.random.default_rng([8, seed])
    model, contacts, q = chain(4, float(rng.choice([0.0, 0.5, 1.0])), rng.choice([1.0, 2.0], 3))
    data, v = model.createData(), rng.integers(-1, 3, 4).astype(float)
    d = impact_derivatives(model, data, q, v, contacts)

    def after(k, s):
        return impact(model, data, q, v + s * np.eye(4)[k], contacts).v

    for k in np.flatnonzero(np.isfinite(d.dv_dv).all(axis=0)):
        for h in (1e-5, -1e-5):  # one-sided quotients of second order
            by_side = (-3 * after(k, 0.0) + 4 * after(k, h) - after(k, 2 * h)) / (2 * h)
            assert np.allclose(by_side, d.dv_dv[:, k], atol=1e-5)


def test_bad_input():
    model, data, q, v = quadruped(0)
    with pytest.raises(pinimpact.InputError, match="no contact given"):
        impact_derivatives(model, data, q, v, [])
    with pytest.raises(pinimpact.InputError, match="not a Contact"):
        impact_derivatives(model, data, q, v, ["FL_FOOT"])
    with pytest.raises(pinimpact.UnknownNameError, match="policy"):
        impact_derivatives(model, data, q, v, CONTACTS["floor and slope"], simultaneous="at once")
    with pytest.raises(pinimpact.InputError, match="side: 2 given"):
        impact_derivatives(model, data, q, v, CONTACTS["floor and slope"], side=2)
    varying = replace(CONTACTS["floor and slope"][0], restitution=lambda speed: 0.5)
    with pytest.raises(pinimpact.InputError, match="slope"):
        impact_derivatives(model, data, q, v, [varying])


@pytest.mark.parametrize("slower", [1e-3, 1e-6, 1e-9, 1e-13])
def test_slow_impact_beside_uncoupled_fast_one_has_the_derivatives_of_a_single_contact(slower):
    # differences with steps and tolerances of the fast impact were wrong, or NaN
    w = np.array([[1.0, 0.1, 0.2], [0.1, 1.2, -0.1], [0.2, -0.1, 0.8]])
    fast, slow = np.array([-0.7, 0.2, -1.0]), np.array([0.3, 0.2, -1.0])
    single = solve_impact(ImpactProblem(w, slow, 0.4, 0.6, "energetic"), derivatives=True).derivatives
    both = np.kron(np.eye(2), w)
    problem = ImpactProblem(both, np.vstack([fast, slower * slow]), 0.4, 0.6, "energetic")
    found = solve_impact(problem, derivatives=True).derivatives
    for of in ("dv", "dP"):
        pairs = [
            (getattr(found, f"{of}_dv")[1, :, 1], getattr(single, f"{of}_dv")),
            (getattr(found, f"{of}_ddelassus")[1, :, 3:, 3:] / slower, getattr(single, f"{of}_ddelassus")),
            (getattr(found, f"{of}_dfriction")[1, :, 1] / slower, getattr(single, f"{of}_dfriction")),
            (getattr(found, f"{of}_drestitution")[1, :, 1] / slower, getattr(single, f"{of}_drestitution")),
        ]
        for own, expected in pairs:
            assert own == pytest.approx(expected, abs=1e-9)
        assert not getattr(found, f"{of}_dfriction")[0, :, 1].any()
        assert not getattr(found, f"{of}_dv")[1, :, 0].any()


def corners(seed, count, rows):
    """Return a random problem at `count` contacts with J (3 count, rows), and J."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(3 * count, rows))
    velocity = (jacobian @ rng.normal(size=rows)).reshape(count, 3)
    friction, restitution = rng.uniform(0.1, 0.9, count), rng.uniform(0.2, 0.9, count)
    return ImpactProblem(jacobian @ jacobian.T, velocity, friction, restitution, "energetic"), jacobian


def test_decoupled_contacts_have_the_derivatives_of_single_contacts():
    rng, delassus, singles = np.random.default_rng(4), np.zeros((6, 6)), []
    velocity, friction, restitution = [[0.4, 0.2, -1.0], [-0.3, 0.5, -0.8]], [0.3, 0.6], [0.5, 0.7]
    for k in range(2):
        root = rng.normal(size=(3, 3))
        delassus[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = root @ root.T + 0.3 * np.eye(3)
        block = delassus[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        one = ImpactProblem(block, velocity[k], friction[k], restitution[k], "energetic")
        singles.append(solve_impact(one, derivatives=True).derivatives)
    both = ImpactProblem(delassus, velocity, friction, restitution, "energetic")
    found = solve_impact(both, derivatives=True).derivatives
    assert found.boundary == Boundary.NONE
    for k, one in enumerate(singles):
        rows = slice(3 * k, 3 * k + 3)
        for letter in "vP":
            of, of_one = (
                {
                    name: getattr(which, f"d{letter}_d{name}")
                    for name in ("v", "delassus", "friction", "restitution")
                }
                for which in (found, one)
            )
            np.testing.assert_allclose(of["v"][k, :, k], of_one["v"], atol=1e-9)
            np.testing.assert_allclose(of["delassus"][k][:, rows, rows], of_one["delassus"], atol=1e-9)
            for name in ("friction", "restitution"):
                slope = of[name]
                np.testing.assert_allclose(slope[k, :, k], of_one[name], atol=1e-9)
                np.testing.assert_allclose(slope[k, :, 1 - k], 0.0, atol=1e-9)


@pytest.mark.parametrize(("seed", "count", "rows"), [(1, 2, 6), (5, 2, 5), (2, 3, 6), (8, 3, 9)])
def test_derivatives_in_contact_space(seed, count, rows):
    """P is of degree 1 in v° and of degree −1 in W; W of redundant contacts changes with J."""
    problem, jacobian = corners(seed, count, rows)
    solution = solve_impact(problem, derivatives=True)
    d, P, v = solution.derivatives, solution.impulse, np.asarray(problem.velocity)
    assert bool(d.boundary & Boundary.RANK) == (rows < 3 * count)
    np.testing.assert_allclose(np.einsum("aibj,bj->ai", d.dP_dv, v), P, atol=1e-8)
    np.testing.assert_allclose(np.einsum("aijk,jk->ai", d.dP_ddelassus, problem.delassus), -P, atol=1e-8)
    rng = np.random.default_rng(seed)
    turn, change = rng.normal(size=jacobian.shape), rng.normal(size=v.shape)
    by_friction, by_restitution = rng.normal(size=(2, count))
    if rows < 3 * count:
        change = (jacobian @ rng.normal(size=rows)).reshape(v.shape)

    def at(s):
        moved = jacobian + s * turn
        changed = ImpactProblem(
            *(moved @ moved.T, v + s * change, problem.friction + s * by_friction),
            *(problem.restitution + s * by_restitution, "energetic"),
        )
        return solve_impact(changed).velocity

    h = 1e-4
    expected = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h)
    delassus = turn @ jacobian.T + jacobian @ turn.T
    slope = np.einsum("aibj,bj->ai", d.dv_dv, change) + np.einsum("aijk,jk->ai", d.dv_ddelassus, delassus)
    slope += d.dv_dfriction @ by_friction + d.dv_drestitution @ by_restitution
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_derivatives_of_impacts_integrated_by_steps_are_nan():
    problem = ImpactProblem(*landing_by_steps(), 0.8, 0.5, "energetic")
    solution = solve_impact(problem, derivatives=True)
    assert "steps" in solution.notes[-1]
    d = solution.derivatives
    assert d.boundary == Boundary.EVENTS_COINCIDE
    assert np.isnan(d.dP_dv).all()
