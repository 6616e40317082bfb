"""Derivatives of robots' impacts against difference quotients, for all kinds of contacts and shapes."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from mpmath import mp, mpf

import pinimpact
from pinimpact import Boundary, Contact, ImpactProblem, Plane, Shape, Sphere
from pinimpact.geometry.convex_pair import gap
from pinimpact.geometry.lines import Edge, Line
from pinimpact.robot.data_cache import data_cache
from pinimpact.robot.names import free_velocities
from pinimpact.robot.shape_pair import shape_pair

from .reference.reference import solve_reference
from .robot_cases import FRAMES, gripper, load, random_state
from .test_contacts_matrices import INERTIAL
from .test_shape_pairs import two_bodies

MOVING = {"velocity": (0.1, 0.2, 0.05), "angular_velocity": (0.3, 0.2, 0.1)}
CONTACTS = {
    "point on floor": Contact("tip", Plane(), friction=0.3, restitution=0.5),
    "ball on moving slope": Contact(
        *("tip", Plane(normal=(0.3, -0.2, 0.9), point=(0.1, 0.1, 0.1), **MOVING), 0.3, 0.5, "energetic"),
        offset=(0.02, 0.03, 0.1),
        radius=0.05,
    ),
    "point on sphere": Contact("tip", Sphere((0.2, 0.1, 0.1), radius=0.2, **MOVING), 0.3, 0.5, "newton"),
    "ball on sphere": Contact("tip", Sphere((0.2, 0.1, 0.1), radius=0.2), 0.3, 0.5, radius=0.03),
    "rim on moving slope": Contact(
        *("tip", Plane(normal=(0.3, -0.2, 0.9), **MOVING), 0.3, 0.5, "energetic"),
        **{"offset": (0.02, 0.03, 0.1), "radius": 0.01, "rim": 0.08, "axis": (0.2, 1.0, 0.3)},
    ),
    "rim on floor": Contact("tip", Plane(), 0.3, 0.5, "newton", rim=0.1),
    "ball on line": Contact("tip", Line((0.5, 0.1, 0.1), (0.6, 0.0, 0.8)), 0.3, 0.5, radius=0.03),
    "point on capsule": Contact("tip", Line(radius=0.1), 0.3, 0.5, "energetic"),
    "edge on edge": Contact(
        *("tip", Edge((0.2, 0.1, 0.1), (0.6, 0.0, 0.8)), 0.3, 0.5),
        **{"offset": (0.02, 0.03, 0.1), "radius": 0.01, "axis": (0.2, 1.0, 0.3)},
    ),
}
CARRIERS = {"panda": "panda_link3", "solo12": "HR_LOWER_LEG", "talos": "left_sole_link"}
STEP = 1e-4


def slope(function, n, step=STEP):
    """Return the derivatives of a function of (n,) at zero, by difference quotients of fourth order."""
    columns = []
    for unit in np.eye(n) * step:
        a, b, c, d = (function(k * unit) for k in (-2, -1, 1, 2))
        columns.append((a - 8 * b + 8 * c - d) / (12 * step))
    return np.array(columns).T


def close(found, expected, tolerance=1e-8):
    """Return whether derivatives agree within a tolerance relative to their norm, at least 1."""
    return np.linalg.norm(found - expected) <= tolerance * max(np.linalg.norm(expected), 1.0)


def struck(model, data, contact, seed):
    """Return a random state of a regular impact, and the derivatives there."""
    rng = np.random.default_rng(seed)
    while True:
        q, v = random_state(model, rng)
        d = pinimpact.impact_derivatives(model, data, q, v, contact)
        flags = pinimpact.impact(model, data, q, v, contact).solution.flags
        if d.dP_dv.any() and not flags & (pinimpact.Flag.NEAR_JUMP | pinimpact.Flag.NEAR_STICK_THRESHOLD):
            return q, v, d


def check(model, data, q, v, contact, d, surfaces=True):
    """Compare all derivatives with differences of `impact`; those by the surface are optional."""
    nv = model.nv

    def after(q, v, contact=contact):
        hit = pinimpact.impact(model, data, q, v, contact)
        return np.concatenate([hit.v, hit.impulse_world])

    def surface(e):
        plane = contact.plane
        spin = np.asarray(plane.angular_velocity) + e[3:]
        moved = replace(plane, velocity=tuple(plane.velocity + e[:3]), angular_velocity=tuple(spin))
        return after(q, v, replace(contact, plane=moved))

    by_q = slope(lambda e: after(pin.integrate(model, q, e), v), nv)
    by_v = slope(lambda e: after(q, v + e), nv)
    by_friction = slope(lambda e: after(q, v, replace(contact, friction=contact.friction + e[0])), 1)[:, 0]
    pairs = [(d.dv_dq, d.dP_dq, by_q), (d.dv_dv, d.dP_dv, by_v)]
    pairs.append((d.dv_dfriction, d.dP_dfriction, by_friction))
    if isinstance(contact.plane, (Plane, Sphere)) and surfaces:
        pairs.append((d.dv_dsurface, d.dP_dsurface, slope(surface, 6)))
    if not callable(contact.restitution):
        by_e = slope(lambda e: after(q, v, replace(contact, restitution=contact.restitution + e[0])), 1)
        pairs.append((d.dv_drestitution, d.dP_drestitution, by_e[:, 0]))
    for of_v, of_impulse, expected in pairs:
        assert close(of_v, expected[:nv])
        assert close(of_impulse, expected[nv:])


@pytest.mark.filterwarnings("ignore::pinimpact.JointLimitWarning")
@pytest.mark.parametrize("kind", CONTACTS)
@pytest.mark.parametrize("carried", [False, True])
@pytest.mark.parametrize("robot", ["panda", "solo12"])
def test_every_kind_of_contact(robot, carried, kind):
    model, data = load(robot)
    contact = replace(CONTACTS[kind], frame=FRAMES[robot])
    if carried:
        contact = replace(contact, plane=replace(contact.plane, body=CARRIERS[robot]))
    q, v, d = struck(model, data, contact, [31, list(CONTACTS).index(kind), carried])
    assert d.boundary == Boundary.NONE
    assert np.array_equal(d.v, pinimpact.impact(model, data, q, v, contact).v) or close(
        d.v, pinimpact.impact(model, data, q, v, contact).v, 1e-13
    )
    check(model, data, q, v, contact, d)


@pytest.mark.filterwarnings("ignore::pinimpact.JointLimitWarning")
@pytest.mark.parametrize("robot", ["ur5", "kinova", "talos"])
def test_other_robots(robot):
    model, data = load(robot)
    contact = replace(CONTACTS["ball on moving slope"], frame=FRAMES[robot])
    check(model, data, *(state := struck(model, data, contact, 5))[:2], contact, state[2])


class Decaying:
    """e = 0.8 exp(−v/2), with its derivative."""

    def __call__(self, speed):
        return 0.8 * np.exp(-speed / 2)

    def slope(self, speed):
        return -0.4 * np.exp(-speed / 2)


def test_restitution_as_a_function_of_speed():
    model, data = load("panda")
    contact = replace(CONTACTS["point on floor"], frame=FRAMES["panda"], restitution=Decaying())
    q, v, d = struck(model, data, contact, 4)
    check(model, data, q, v, contact, d)
    constant = replace(contact, restitution=pinimpact.impact(model, data, q, v, contact).problem.restitution)
    other = pinimpact.impact_derivatives(model, data, q, v, constant)
    assert not close(d.dv_dv, other.dv_dv, 1e-3)


@pytest.mark.parametrize("locked", [(), ("FR_KFE",)])
def test_held_contacts_and_locked_joints(locked):
    model, data = load("solo12")
    rng = np.random.default_rng(8)
    contact = Contact("FL_FOOT", Plane(normal=(0.1, 0, 1)), friction=0.5, restitution=0.3, radius=0.016)
    held = [Contact("FR_FOOT", Plane(normal=(0, 0.1, 1)), radius=0.016)]
    held.append(Contact("HL_FOOT", Plane(normal=(0, 0.1, 1)), radius=0.016, rim=0.02, axis=(0.1, 1.0, 0.2)))
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv) * 0.3)

    def after(q, v):  # unlike `impact` this accepts held feet that move
        at = pinimpact.contact_matrices(model, data, q, contact, held, locked)
        problem = ImpactProblem(at.delassus, at.velocity(v), contact.friction, contact.restitution)
        impulse = pinimpact.solve_impact(problem).impulse
        return np.concatenate([v + at.response @ impulse, at.axes.T @ impulse])

    matrices = pinimpact.contact_matrices(model, data, q, contact, held, locked)
    still = np.eye(18)[~free_velocities(model, locked)]
    rows = np.vstack([*(anchor.jacobian for anchor in matrices.held), still])
    v = (np.eye(18) - np.linalg.pinv(rows) @ rows) @ rng.normal(size=18)
    v *= -np.sign(matrices.velocity(v)[2])
    d = pinimpact.impact_derivatives(model, data, q, v, contact, held, locked)
    by_q = slope(lambda e: after(pin.integrate(model, q, e), v), 18)
    by_v = slope(lambda e: after(q, v + e), 18)
    assert close(d.dv_dq, by_q[:18])
    assert close(d.dP_dq, by_q[18:])
    assert close(d.dv_dv, by_v[:18])
    assert close(d.dP_dv, by_v[18:])


def test_planar_arm():
    # the row of W across the plane of its two links is zero
    model = pin.Model()
    link = pin.Inertia(1.0, np.array([0.25, 0.0, 0.0]), np.diag([0.001, 0.02, 0.02]))
    for name, x in (("shoulder", 0.0), ("elbow", 0.5)):
        placement = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        joint = model.addJoint(model.njoints - 1, pin.JointModelRY(), placement, name)
        model.appendBodyToJoint(joint, link, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", 2, tip, pin.FrameType.OP_FRAME))
    data = model.createData()
    contact = Contact("tip", Plane(), friction=0.2, restitution=0.5)
    q, v = np.array([0.4, 0.7]), np.array([1.0, 0.3])
    d = pinimpact.impact_derivatives(model, data, q, v, contact)
    assert d.boundary == Boundary.RANK
    by_q = slope(lambda e: pinimpact.impact(model, data, q + e, v, contact).v, 2)
    by_v = slope(lambda e: pinimpact.impact(model, data, q, v + e, contact).v, 2)
    assert close(d.dv_dq, by_q)
    assert close(d.dv_dv, by_v)


def test_joints_that_the_kernels_of_trees_do_not_support():
    # with a helical joint all kinematics are from Pinocchio
    rng = np.random.default_rng(3)
    model = pin.Model()
    kinds = {"base": pin.JointModelRX(), "screw": pin.JointModelHZ(0.2), "wrist": pin.JointModelRY()}
    for name, kind in kinds.items():
        placement = pin.SE3(np.eye(3), rng.normal(size=3))
        joint = model.addJoint(model.njoints - 1, kind, placement, name)
        link = pin.Inertia(1.0, rng.normal(size=3) * 0.1, np.diag([0.02, 0.03, 0.04]))
        model.appendBodyToJoint(joint, link, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), rng.normal(size=3))
    model.addFrame(pin.Frame("tip", 3, tip, pin.FrameType.OP_FRAME))
    data = model.createData()
    contact = replace(CONTACTS["ball on moving slope"], law="poisson")
    assert data_cache(model, data).tree is None
    q, v, d = struck(model, data, contact, 6)
    check(model, data, q, v, contact, d)


def test_results_are_not_overwritten_by_later_calls():
    contact = replace(CONTACTS["point on floor"], frame=FRAMES["panda"])
    q, v, first = struck(MODEL, DATA, contact, 7)
    names = ("v", "dv_dq", "dP_dv", "dv_dsurface", "dP_dfriction", "dv_drestitution")
    kept = {name: getattr(first, name).copy() for name in names}
    other = pinimpact.impact_derivatives(MODEL, DATA, q, 2.0 * v, contact)
    assert not np.array_equal(other.v, first.v)
    for name in names:
        assert np.array_equal(getattr(first, name), kept[name])


def test_two_balls():
    # at e = 1 the balls swap their velocities
    model = pin.Model()
    for name in "ab":
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name} centre", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    contact = Contact("a centre", Sphere(radius=0.1, body="b centre"), 0.0, 1.0, radius=0.1)
    q, v = np.array([-0.1, 0, 0, 0.1, 0, 0]), np.array([1.0, 0, 0, -0.5, 0, 0])
    d = pinimpact.impact_derivatives(model, model.createData(), q, v, contact)
    assert close(d.v, np.array([-0.5, 0, 0, 1.0, 0, 0]), 1e-15)
    along = np.ix_([0, 3], [0, 3])
    assert close(d.dv_dv[along], np.array([[0.0, 1.0], [1.0, 0.0]]), 1e-15)
    assert close(d.dv_dq[along], np.zeros((2, 2)), 1e-15)


# ---- collision shapes

BALL, BRICK = coal.Sphere(0.1), coal.Box(0.4, 0.3, 0.2)
PAIRS = {
    # both shapes; position, roll and pitch of the first in the axes of the second
    "ball on face": (BALL, BRICK, (0.05, 0.06, 0.2, 0.0, 0.0)),
    "ball on edge": (BALL, BRICK, (0.26, 0.06, 0.18, 0.0, 0.0)),
    "ball on corner": (BALL, BRICK, (0.26, 0.2, 0.18, 0.0, 0.0)),
    "corner on face": (BRICK, BRICK, (0.05, 0.06, 0.4, 0.6, 0.4)),
    "face on corner": (BRICK, BRICK, "corner on face"),
    "edge on edge": (BRICK, BRICK, (0.25, 0.02, 0.2, 0.2, 0.8)),
    "capsule on edge": (coal.Capsule(0.05, 0.3), BRICK, (0.25, 0.02, 0.15, 1.5, 0.2)),
}


def brought_together(robot, q):
    """Return a configuration in which the shapes "a" and "b" are in contact."""
    pair, q = shape_pair(robot, Contact(geometry="a", plane=Shape("b"))), q.copy()
    for _ in range(10):
        pin.forwardKinematics(robot.model, robot.data, q)
        found = gap(*pair.placed(robot.data))
        q[:3] -= found.value * found.normal
    return q


def shapes(kind):
    """Return two free bodies with the shapes of a pair, their configuration in contact, and the contact."""
    first, second, place = PAIRS[kind]
    swap = isinstance(place, str)
    robot, rng = two_bodies(first, second), np.random.default_rng(4)
    *x, roll, pitch = PAIRS[place][2] if swap else place
    between = pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, 0.3), np.array(x))
    base = pin.SE3(pin.rpy.rpyToMatrix(*rng.normal(size=3)), rng.normal(size=3))
    q = np.concatenate([pin.SE3ToXYZQUAT(base * between), pin.SE3ToXYZQUAT(base)])
    contact = Contact(geometry="ab"[swap], plane=Shape("ba"[swap]), friction=0.3, restitution=0.5)
    return robot, brought_together(robot, q), contact


@pytest.mark.parametrize("kind", PAIRS)
def test_shapes_in_contact(kind):
    robot, q, contact = shapes(kind)
    model, data, v = robot.model, robot.data, np.random.default_rng(5).normal(size=12)
    if pinimpact.impact(robot, data, q, v, contact).solution.status == pinimpact.Status.NO_IMPACT:
        v = -v
    d = pinimpact.impact_derivatives(robot, data, q, v, contact)
    assert d.boundary == Boundary.NONE

    def after(q, v):
        hit = pinimpact.impact(robot, data, q, v, contact)
        return np.concatenate([hit.v, hit.impulse_world])

    by_v = slope(lambda e: after(q, v + e), 12)
    assert close(d.dv_dv, by_v[:12])
    assert close(d.dP_dv, by_v[12:])

    # for gaps above CLOSE normals at vertices and edges have errors of 1e-11
    step = STEP if "ball" in kind else 3.0 * STEP
    by_q = slope(lambda e: after(pin.integrate(model, q, e), v), 12, step)  # also with gaps or overlap
    assert close(d.dv_dq, by_q[:12])
    assert close(d.dP_dq, by_q[12:])


@pytest.mark.parametrize(
    ("place", "meet"),
    [
        ((0.28, 0.06, 0.16), False),
        ((0.2, 0.06, 0.2), True),
        ((0.2, 0.15, 0.2), True),
        ((0.28, 0.15, 0.16), True),
    ],
)
def test_ball_at_boundary_of_features(place, meet):
    # the curvature jumps between faces, edges and vertices
    robot = two_bodies(BALL, BRICK)
    q = np.array([*place, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1.0])
    v = np.array([-1.0, -1.0, -1.0, *np.zeros(9)])
    contact = Contact(geometry="a", plane=Shape("b"), friction=0.3, restitution=0.5)
    d = pinimpact.impact_derivatives(robot, robot.data, q, v, contact)
    assert (d.boundary == Boundary.FEATURES_MEET) == meet
    for of_q in (d.dv_dq, d.dP_dq):
        assert np.isnan(of_q).all() == meet
    assert np.isfinite(d.dv_dv).all()


# ---- one-sided derivatives


def one_sided_slope(side, function, n, step=STEP):
    """Return one-sided derivatives of a function of (n,) at zero, by difference quotients of third order."""
    here, columns = function(np.zeros(n)), []
    for unit in np.eye(n) * step * side:
        a, b, c = (function(k * unit) for k in (1, 2, 3))
        columns.append((-11 * here + 18 * a - 9 * b + 2 * c) / (6 * side * step))
    return np.array(columns).T


@pytest.mark.parametrize("side", [1, -1])
def test_one_sided_derivatives_at_boundary_of_features(side):
    robot = two_bodies(BALL, BRICK)
    q = np.array([0.2, 0.06, 0.2, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1.0])
    v = np.array([-1.0, -1.0, -1.0, *np.zeros(9)])
    contact = Contact(geometry="a", plane=Shape("b"), friction=0.3, restitution=0.5)
    d = pinimpact.impact_derivatives(robot, robot.data, q, v, contact, side=side)

    def after(e):
        hit = pinimpact.impact(robot, robot.data, pin.integrate(robot.model, q, e), v, contact)
        return np.concatenate([hit.v, hit.impulse_world])

    expected, known = one_sided_slope(side, after, 12), np.isfinite(d.dv_dq).all(axis=0)
    assert known[[0, 6, 10]].all()  # along x and about y
    assert close(d.dv_dq[:, known], expected[:12, known])
    assert close(d.dP_dq[:, known], expected[12:, known])


@pytest.mark.parametrize("side", [1, -1])
def test_one_sided_derivatives_of_start_at_rest(side):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = pin.Inertia(1.0, np.array([0.01, 0.02, 0.0]), np.diag([0.02, 0.03, 0.01]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([0.1, 0.05, -0.2]))
    model.addFrame(pin.Frame("tip", joint, place, pin.FrameType.OP_FRAME))
    data, contact = model.createData(), Contact("tip", Plane(), 0.1, 0.5)
    q, v = pin.neutral(model), np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    both = pinimpact.impact_derivatives(model, data, q, v, contact)
    assert both.boundary == Boundary.START_AT_REST
    missing = np.isnan(both.dv_dv).any(axis=0)
    assert missing.tolist() == [True, True, False, True, True, True]  # v_z does not change slip
    d = pinimpact.impact_derivatives(model, data, q, v, contact, side=side)
    assert np.array_equal(d.dv_dv[:, 2], both.dv_dv[:, 2])
    problem = pinimpact.impact(model, data, q, v, contact).problem
    rows, h = pinimpact.contact_matrices(model, data, q, contact).jacobian, mpf(10) ** -20
    with mp.workdps(60):
        W, P = [[mpf(x) for x in row] for row in problem.delassus.tolist()], []
        for change in (np.zeros(3), *rows.T * side):
            at = [
                mpf(a) + h * mpf(b) for a, b in zip(problem.velocity.tolist(), change.tolist(), strict=True)
            ]
            P.append(solve_reference(W, at, mpf(0.1), mpf(0.5), "poisson", digits=50).impulse)
        expected = np.array(
            [[float((b - a) / h) * side for a, b in zip(P[0], one, strict=True)] for one in P[1:]]
        )
    assert close(d.dP_dv, expected.T, 1e-7)
    assert np.isfinite(d.block).all()
    assert close(
        one_sided_slope(
            side, lambda e: pinimpact.impact(model, data, pin.integrate(model, q, e), v, contact).v, 6, 1e-9
        ),
        d.dv_dq,
        1e-3,
    )


MODEL, DATA = load("panda")
HERE = Contact("panda_hand_tcp", Plane(), 0.3, 0.5)


class Failing(Decaying):
    def slope(self, speed):
        return 1 / 0


@pytest.mark.parametrize(
    ("contact", "words"),
    [
        (replace(HERE, restitution=lambda speed: 0.5), "attribute `slope`"),
        (replace(HERE, restitution=Failing()), r"restitution\.slope: ZeroDivisionError at an approach of"),
        (replace(HERE, rim=0.1), "lies flat"),
        (pinimpact.Contact(geometry="panda_hand_0", plane=Plane()), "RobotWrapper"),
    ],
)
def test_contacts_without_derivatives_raise(contact, words):
    with pytest.raises(pinimpact.InputError, match=words):
        pinimpact.impact_derivatives(MODEL, DATA, pin.neutral(MODEL), np.ones(9), contact)


def test_shape_on_plane_has_derivatives_of_its_tips():
    robot, rng = two_bodies(BRICK, coal.Cylinder(0.1, 0.2)), np.random.default_rng(3)
    q, v = np.array([0, 0, 0.1, 0, 0, 0, 1, 3, 0, 0, 0, 0, 0, 1.0]), rng.normal(size=12)
    v[2] = v[8] = -2.0
    given, rest = (robot, robot.data), {"friction": 0.3, "restitution": 0.5}
    flat = Contact(geometry="a", plane=Plane(), **rest)
    many = pinimpact.impact_derivatives(*given, q, v, flat)
    low = [tip for tip in flat.tips(robot) if tip.gap(robot.model, robot.data, q) < 0.1]
    assert len(low) == 4
    expected = pinimpact.impact_derivatives(*given, q, v, low)
    assert np.array_equal(many.dv_dq, expected.dv_dq, equal_nan=True)
    assert np.array_equal(many.dP_dv, expected.dP_dv, equal_nan=True)
    # a cylinder on its rim
    q = pin.integrate(robot.model, q, np.array([0, 0, 0, 0.3, 0.2, 0, 0, 0, 0, 1.2, 0.3, 0]))
    for contact in (flat, Contact(geometry="b", plane=Plane(), **rest)):
        d = pinimpact.impact_derivatives(*given, q, v, contact)

        def after(e, contact=contact):
            return pinimpact.impact(*given, pin.integrate(robot.model, q, e), v, contact).v

        assert close(d.dv_dq, slope(after, 12))
        assert d.dP_dv.any()


def test_shapes_in_contact_at_several_points_raise():
    robot, v = two_bodies(BRICK, BRICK), np.array([0.0, 0.0, -1.0, *np.zeros(9)])
    contact = Contact(geometry="a", plane=Shape("b"), friction=0.3)
    q = np.array([0, 0, 0.2, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1.0])
    with pytest.raises(pinimpact.InputError, match="at 4 points"):
        pinimpact.impact_derivatives(robot, robot.data, q, v, contact)


def test_joints_with_configuration_dependent_axes_raise():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSphericalZYX(), pin.SE3.Identity(), "wrist")
    model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    with pytest.raises(pinimpact.ModelError, match="wrist"):
        pinimpact.impact_derivatives(
            model, model.createData(), np.zeros(3), np.ones(3), Contact("tip", Plane(), 0.3, 0.5)
        )


def test_impact_rows_with_mimic_joint():
    model = pin.buildModelFromXML(gripper("left", INERTIAL), mimic=True)
    q, v, data = np.array([0.3, 0.7]), np.array([1.0, -0.3]), model.createData()
    contact = Contact("right_finger", Plane(normal=(1, 2, 3)), 0.3, 0.5, offset=(1, 0, 0))
    A, b = pinimpact.impact_rows(model, data, q, v, contact, 1.0)
    assert A[2:].any()
    by_v = slope(lambda e: pinimpact.impact(model, data, q, v + e, contact).v, 2)
    assert close(A[:2], by_v)
    assert close(b[:2] + A[:2] @ v, pinimpact.impact(model, data, q, v, contact).v + by_v @ v)
    with pytest.raises(pinimpact.ModelError, match="right"):
        pinimpact.impact_derivatives(model, data, q, v, contact)


@pytest.mark.parametrize("radius", [0.0, 0.02])
def test_impact_rows(radius):
    contact = Contact("panda_hand_tcp", Plane((0.1, 0.2, 1.0)), 0.3, 0.5, radius=radius)
    q, v, _ = struck(MODEL, DATA, contact, 3)
    A, b = pinimpact.impact_rows(MODEL, DATA, q, v, contact, 1e-3)

    def after(acceleration):
        hit = pinimpact.impact(MODEL, DATA, q, v + 1e-3 * acceleration, contact)
        return np.concatenate([hit.v, hit.impulse_world])

    assert close(A, slope(after, 9, 0.1))
    assert np.allclose(b, after(np.zeros(9)), rtol=1e-13, atol=1e-15)
    with pytest.raises(pinimpact.InputError, match="dt"):
        pinimpact.impact_rows(MODEL, DATA, q, v, contact, 0.0)


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("law", ["newton", "poisson", "energetic"])
def test_robot_of_one_joint(friction, law):
    # the joint moves along the normal: v⁺ = −e v
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    contact = pinimpact.Contact("height", pinimpact.Plane(), friction, 0.5, law)
    d = pinimpact.impact_derivatives(model, model.createData(), np.zeros(1), np.array([-3.0]), contact)
    assert d.dv_dv[0, 0] == pytest.approx(-0.5, abs=1e-15)
    assert d.dv_drestitution[0] == pytest.approx(3.0, abs=1e-14)
    assert d.dv_dq[0, 0] == d.dv_dfriction[0] == 0.0


LEVERS = {"newton": lambda r: 1.0, "poisson": lambda r: r, "energetic": np.sqrt}
"""v⁺/(−e v) of a robot of one joint, by the ratio r of the force's levers in restitution and compression."""


@pytest.mark.parametrize("law", LEVERS)
def test_pendulum_with_friction(law):
    """Its tip stops slipping where compression ends. The levers of the force are |J_n| ± μ|J_t|."""
    model, friction, e, v = pin.Model(), 0.4, 0.5, np.array([2.0])
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.5, 0.1, 0.1), pin.SE3.Identity())
    x, z = 0.5, -0.2
    place = pin.SE3(np.eye(3), np.array([x, 0.0, z]))
    model.addFrame(pin.Frame("tip", joint, 0, place, pin.FrameType.OP_FRAME))

    def after(q, v=v, friction=friction, e=e):
        normal, tangent = abs(x * np.cos(q) + z * np.sin(q)), abs(z * np.cos(q) - x * np.sin(q))
        return -e * v * LEVERS[law]((normal - friction * tangent) / (normal + friction * tangent))

    q = np.array([0.3])
    contact = Contact("tip", Plane(), friction, e, law)
    d = pinimpact.impact_derivatives(model, model.createData(), q, v, contact)
    assert d.boundary == Boundary.RANK
    assert d.v == pytest.approx(after(q), abs=1e-14)
    assert close(d.dv_dq, slope(lambda s: after(q + s), 1), 1e-11)
    assert close(d.dv_dv, slope(lambda s: after(q, v + s), 1), 1e-11)
    assert close(d.dv_dfriction, slope(lambda s: after(q, v, friction + s), 1)[:, 0], 1e-11)
    assert close(d.dv_drestitution, slope(lambda s: after(q, v, friction, e + s), 1)[:, 0], 1e-11)


@pytest.mark.parametrize("law", LEVERS)
@pytest.mark.parametrize("count", [1, 2])
def test_robots_of_few_joints(count, law):
    """Slip and compression end together: the tip moves in fewer directions than it has components."""
    found = 0
    for seed in range(60):
        rng, model, joint = np.random.default_rng(seed), pin.Model(), 0
        for kind in (pin.JointModelRX(), pin.JointModelRY())[:count]:
            joint = model.addJoint(joint, kind, pin.SE3(np.eye(3), 0.2 * rng.normal(size=3)), f"{joint}")
            body = pin.Inertia.FromBox(*rng.uniform(0.2, 1.0, 4))
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), 0.5 * rng.normal(size=3))
        model.addFrame(pin.Frame("tip", joint, 0, place, pin.FrameType.OP_FRAME))
        q, v, data = rng.normal(size=count), 2.0 * rng.normal(size=count), model.createData()
        contact = Contact("tip", Plane(normal=rng.normal(size=3)), rng.uniform(0.05, 0.5), 0.6, law)
        hit = pinimpact.impact(model, data, q, v, contact)
        near = pinimpact.Flag.NEAR_JUMP | pinimpact.Flag.NEAR_STICK_THRESHOLD
        if hit.solution.flags & near or not hit.solution.flags & pinimpact.Flag.SLIP_RESUMED:
            continue
        found += 1
        d = pinimpact.impact_derivatives(model, data, q, v, contact)
        assert d.boundary == Boundary.RANK
        assert np.isnan(d.dv_dsurface).all()
        check(model, data, q, v, contact, d, surfaces=False)
        w = pinimpact.contact_matrices(model, data, q, contact)
        problem = ImpactProblem(w.delassus, w.velocity(v), contact.friction, 0.6, law)
        of_velocity = pinimpact.solve_impact(problem, derivatives=True).derivatives
        assert of_velocity.boundary == Boundary.RANK | Boundary.EVENTS_COINCIDE
        assert np.isnan(of_velocity.dv_dv).all()
    assert found > 3


@pytest.mark.parametrize("held", [False, True])
def test_vertical_fall_is_a_start_at_rest(held):
    # the tangential velocity of the foot is a rounding error, which does not determine a direction of slip
    robot = pinimpact.load_robot("solo12")
    model, data = robot.model, robot.data
    foot = pinimpact.Contact("FL_FOOT", pinimpact.Plane(), friction=0.2, restitution=0.3)
    options = {"locked": ["FL_HAA"]} if held else {}
    q = pin.integrate(model, robot.q0, np.array([0.0] * 3 + [0.3, 0.2, 0.1] + [0.1] * 12))
    v = np.zeros(18)
    v[:3] = pin.Quaternion(q[3:7]).matrix().T @ [0.0, 0.0, -1.0]
    found = pinimpact.impact_derivatives(model, data, q, v, foot, **options)
    assert found.boundary == pinimpact.Boundary.START_AT_REST
    assert np.isnan(found.dv_dv).any()
    for side in (1, -1):
        one = pinimpact.impact_derivatives(model, data, q, v, foot, side=side, **options)
        h = side * 1e-7
        ends = [pinimpact.impact(model, data, q, v + h * e, foot, **options).v for e in np.eye(18)]
        expected = (np.array(ends) - one.v).T / h
        assert np.abs(one.dv_dv - expected).max() < 1e-3 * np.abs(expected).max()


def swinging(*joints):
    """Return an arm of boxes of 1 m along x, on the given joints, with the frame "tip" at its end."""
    model, parent = pin.Model(), 0
    for k, joint in enumerate(joints):
        place = pin.SE3(np.eye(3), np.array([float(k > 0), 0.0, 0.0]))
        parent = model.addJoint(parent, joint, place, f"joint {k}")
        middle = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
        model.appendBodyToJoint(parent, pin.Inertia.FromBox(1.0, 1.0, 0.1, 0.1), middle)
    end = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, end, pin.FrameType.OP_FRAME))
    return model


STRAIGHT = {
    "one joint": (swinging(pin.JointModelRZ()), [0.0], [2.0], (0, -1, 0), [0]),
    "stretched": (swinging(pin.JointModelRZ(), pin.JointModelRZ()), [0, 0], [2.0, 1.0], (0, -1, 0), [0, 1]),
    "ball joint": (swinging(pin.JointModelSpherical()), [0, 0, 0, 1], [0.3, 2.0, 0.0], (0, 0, 1), [1]),
    "slip stops": (swinging(pin.JointModelSpherical()), [0, 0, 0, 1], [0.0, 2.0, 0.5], (0, 0, 1), [1]),
}


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("kind", STRAIGHT)
def test_friction_where_no_impulse_moves_the_tip_changes_its_sign_with_q(kind, many):
    """It has no effect if the tip strikes straight, but as soon as a change of q makes it slip or tend to."""
    model, q, v, normal, kinks = STRAIGHT[kind]
    data, (q, v), nv = model.createData(), (np.array(x, dtype=float) for x in (q, v)), model.nv
    tip = Contact("tip", Plane(normal=normal), 0.3, 0.5, law="energetic")
    contact = [tip] if many else tip
    d = pinimpact.impact_derivatives(model, data, q, v, contact)
    before = pinimpact.impact(model, data, q, v, contact).v
    assert d.boundary & (Boundary.START_AT_REST | Boundary.JUMP)
    for k, unit in enumerate(1e-6 * np.eye(nv)):
        to_right, to_left = (
            (pinimpact.impact(model, data, pin.integrate(model, q, s * unit), v, contact).v - before)
            / (s * 1e-6)
            for s in (1.0, -1.0)
        )
        if k in kinks:
            assert np.abs(to_right - to_left).max() > 0.1
            assert np.isnan(d.dv_dq[:, k]).all()
        elif not many or np.isfinite(d.dv_dq[:, k]).all():  # differences do not see that W and v° turn alike
            assert d.dv_dq[:, k] == pytest.approx(to_right, abs=1e-5)
            assert d.dv_dq[:, k] == pytest.approx(to_left, abs=1e-5)
    moved = slope(lambda x: pinimpact.impact(model, data, q, v + x, contact).v, nv, 1e-5)
    assert d.dv_dv == pytest.approx(moved, abs=1e-7)
