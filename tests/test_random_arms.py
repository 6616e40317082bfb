"""Singular and nearly singular mechanisms, computed by Pinocchio, against multiple precision."""

import dataclasses

import mpmath as mp
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import (
    LAWS,
    Contact,
    Flag,
    ImpactProblem,
    InputError,
    Plane,
    Status,
    UnstoppableApproachError,
    contact_matrices,
    impact,
    impacts,
    solve_impact,
    solve_impacts,
)
from pinimpact.robot.matrices import contact_geometry

from . import many_arms, random_arms, random_impacts
from .drawing import one_of_each
from .random_arms import Case, Report, check, run, solve
from .reference.arms import Arm, _axes, _rotation
from .reference.reference import solve_reference


def test_random_arms_agree_with_multiple_precision():
    report = run(5, 15)
    assert report.impacts == 15
    assert report.uncovered <= 2
    assert [what for what, _ in report.violations] == []


def test_many_arms_obey_mechanics_in_rotated_axes():
    report = many_arms.run(7, 3000)
    assert report.impacts == 3000
    assert [what for what, _ in report.violations] == []
    assert [what for what, _ in report.judged.violations] == []


@pytest.mark.parametrize(("change", "noticed"), [(1.0, False), (1.0 + 1e-9, True)])
def test_many_arms_detect_wrong_velocities(monkeypatch, change, noticed):
    """Joint velocities with a relative error of 1e-9 violate the balance of momentum."""
    right = many_arms.solve

    def wrong(group):
        hits = right(group)
        hits.v = hits.v * change
        return hits

    monkeypatch.setattr(many_arms, "solve", wrong)
    report = many_arms.run(0, 400)
    assert ("momentum" in {what for what, _ in report.violations}) is noticed


def test_random_arms_detect_wrong_friction(monkeypatch):
    """A relative error of friction of 1e-7 is a violation."""
    arm = Arm((0.3, 0.7, -1.2), (0.2, 0.5, 0.7), (0.3, 0.8, -0.4), (1.0, -0.5, 0.2))
    arm = (
        arm if float(arm.contact_problem()[1][2]) < 0 else Arm(arm.rpy, arm.normal, arm.q, (-1.0, 0.5, -0.2))
    )
    case = Case("any", arm, 0.3, 0.5, "poisson")
    for factor, violations in ((1.0, 0), (1.0 + 1e-7, 1)):
        report = Report()
        monkeypatch.setattr(
            random_arms, "solve", lambda c, f=factor: solve(dataclasses.replace(c, friction=c.friction * f))
        )
        check(np.random.default_rng(0), case, report)
        assert len(report.violations) == violations


def _tip_beside_the_plane(rng, joints):
    """Return a randomly oriented arm whose tip can only move parallel to the plane."""
    rpy = rng.uniform(-3, 3, 3)
    normal = pin.rpy.rpyToMatrix(*rpy)[:, 2]
    return Arm(
        tuple(rpy), tuple(normal), tuple(rng.uniform(-2, 2, joints)), tuple(rng.standard_normal(joints))
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("joints", [1, 2, 3])
def test_motion_parallel_to_plane_is_no_impact(joints, law):
    rng = np.random.default_rng(joints)
    for _ in range(20):
        arm = _tip_beside_the_plane(rng, joints)
        hit = solve(Case("parallel", arm, 0.3, 0.5, law))
        assert hit.solution.status == Status.NO_IMPACT
        assert hit.v.tolist() == list(arm.v)


def test_approach_of_surface_to_arm_that_moves_parallel_to_it_raises():
    arm = _tip_beside_the_plane(np.random.default_rng(0), 2)
    model = pin.buildModelFromXML(arm.urdf())
    plane = Plane(normal=arm.normal, velocity=tuple(1e-9 * np.array(arm.normal)))
    with pytest.raises(UnstoppableApproachError, match="no normal impulse can stop"):
        impact(model, model.createData(), np.array(arm.q), np.array(arm.v), Contact("tip", plane, 0.3, 0.5))


@pytest.mark.parametrize("joints", [2, 3])
def test_no_impulse_perpendicular_to_plane_of_arm(joints):
    """The tip moves straight down, and v_t is a rounding error of about 1e-17."""
    rng = np.random.default_rng(joints)
    for yaw in rng.uniform(-3, 3, 20):
        q = rng.uniform(0.3, 2.0, joints)
        arm = Arm((np.pi / 2, 0.0, yaw), (0.0, 0.0, 1.0), tuple(q), (0.0,) * joints)
        J = np.array(arm._planar()[0].tolist(), dtype=float)
        arm = Arm(arm.rpy, arm.normal, arm.q, tuple(np.linalg.pinv(J) @ [0.0, -1.0]))
        hit = solve(Case("upright", arm, 1.5, 0.5, "poisson"))
        across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        assert np.abs(hit.problem.velocity[:2]).max() < 3e-15
        assert abs(hit.impulse_world @ across) <= 1e-14 * hit.impulse_world[2]


CANCELLED = ImpactProblem(
    [
        [0.003631707486929861, -0.00936539822372787, -0.0041241163159054794],
        [-0.00936539822372787, 0.02415136246646152, 0.010635215462267282],
        [-0.0041241163159054794, 0.010635215462267282, 0.004683288907030377],
    ],
    (6.553959486511713e-07, -1.690126221736247e-06, -7.442584885864878e-07),
    193.57780565863237,
    0.0,
    "energetic",
)


def test_velocity_small_by_cancellation_has_a_solution():
    solution = solve_impact(CANCELLED)
    assert solution.velocity.tolist() == [0.0, 0.0, 0.0]
    assert np.abs(solution.impulse).max() < 1e-4


@pytest.mark.parametrize(("law", "scale"), one_of_each(list(LAWS), [True, False]))
def test_impulses_for_velocities_in_range_of_rank_one(scale, law):
    """v = W r has rounding errors, and may be small by cancellation; impulses are no quotients of errors."""
    rng = np.random.default_rng(3)
    X = rng.standard_normal((50_000, 3, 1))
    W = X @ X.transpose(0, 2, 1)
    r = rng.standard_normal((50_000, 3))
    v = np.einsum("nij,nj->ni", W, r)
    v[v[:, 2] > 0] *= -1
    sizes = np.einsum("nij,nj->n", np.abs(W), np.abs(r))
    mu, e = 10 ** rng.uniform(-1.5, 2.5, len(v)), rng.random(len(v))
    batch = solve_impacts(W, v, mu, e, law, velocity_scale=sizes if scale else None)
    assert (batch.status <= Status.LOCKED).all()
    # at rank one all changes of velocity are along u
    u = X[:, :, 0]
    made = np.abs(np.sum(u * batch.velocity, axis=1) - np.sum(u * v, axis=1)) / np.sum(u * u, axis=1)
    assert np.abs(np.sum(u * batch.impulse, axis=1)) == pytest.approx(made, rel=1e-9, abs=1e-12)
    c = W[:, 2, 2]
    assert (np.abs(batch.impulse[:, 2]) * c <= 1e6 * np.abs(v).max(axis=1)).all()


NEARLY_PLANAR = ImpactProblem(
    [
        [2.0029409218408483, -3.039812777756059e-12, 0.6203699546440935],
        [-3.039812777756059e-12, 5.0461925204740406e-24, -1.0298352082600083e-12],
        [0.6203699546440935, -1.0298352082600083e-12, 0.2101704506653078],
    ],
    (-0.9901205183766008, 1.7998771973194827e-12, -0.3673218770039761),
    1.123977948132712,
    0.21721067982942144,
    "energetic",
)


def test_accuracy_of_nearly_planar_mechanism():
    solution = solve_impact(NEARLY_PLANAR)
    p = NEARLY_PLANAR
    exact = solve_reference(p.delassus, p.velocity, p.friction, p.restitution, p.law)
    assert solution.impulse == pytest.approx([float(x) for x in exact.impulse], rel=1e-12)
    assert solution.velocity == pytest.approx([float(x) for x in exact.velocity], rel=1e-11, abs=1e-24)
    assert Flag.SLIP_RESUMED in solution.flags


@pytest.mark.parametrize("tilt", [1e-3, 1e-5, 1e-7, 1e-9, 4.9e-12])
def test_slow_slip_of_tilted_arms(tilt):
    """The plane of the arm is tilted, so v_t does not vanish and friction turns out of the plane."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        arm = Arm((np.pi / 2 + tilt, 0.0, 0.0), (0.0, 0.0, 1.0), tuple(rng.uniform(0.3, 1.8, 2)), (1.0, -2.0))
        W, v, _ = arm.contact_problem()
        if v[2] > 0:
            arm = Arm(arm.rpy, arm.normal, arm.q, (-1.0, 2.0))
            W, v, _ = arm.contact_problem()
        exact = solve_reference(W, v, 0.8, 0.5, "poisson")
        hit = solve(Case("tilted", arm, 0.8, 0.5, "poisson"))
        size = float(exact.impulse[2])
        error = np.abs(hit.solution.impulse - [float(x) for x in exact.impulse]).max() / size
        assert error <= 1e-12 + 4e-15 / tilt  # the base angle has a rounding error of 2e-16


def test_maximum_of_v3_just_above_zero():
    """The tip moves nearly parallel to the plane: the maximum of v₃ is a millionth above zero."""
    arm = Arm(
        (-0.1702886459437738, -0.8561693184828377, 0.09848280984389923),
        (-0.7578243529637448, 0.09541705828585698, 0.6454439054194833),
        (-1.1668022599256869, -1.722923627686554, -1.8128927657723501),
        (1.0081895570759398, 0.9777418135339674, -1.1805268719567252),
    )
    W, v, _ = arm.contact_problem()
    exact = solve_reference(W, v, 0.05108799013575157, 0.0, "poisson")
    solution = solve(Case("parallel", arm, 0.05108799013575157, 0.0, "poisson")).solution
    assert solution.impulse == pytest.approx([float(x) for x in exact.impulse], rel=1e-9)
    assert solution.velocity == pytest.approx([float(x) for x in exact.velocity], rel=1e-6, abs=1e-15)


def test_unstoppable_approach_at_rank_one_in_rotated_axes():
    """Slip turns to a direction of zero force; rounding errors must not leave a force, in any axes."""
    W = np.array(
        [
            [0.8861422875255425, 0.3154149258118694, 0.037517440739397986],
            [0.3154149258118694, 0.11226930124586734, 0.013354018822995542],
            [0.037517440739397986, 0.013354018822995542, 0.0015884112285903115],
        ]
    )
    v = np.array([-0.38824158017406785, -0.1930965243082683, -0.6145436819223341])
    T = random_impacts.turned(np.random.default_rng(0).uniform(0, 2 * np.pi, 2000))
    matrices, velocities = random_impacts.mapped(T, np.tile(W, (2000, 1, 1)), np.tile(v, (2000, 1)))
    batch = solve_impacts(matrices, velocities, 2.6569998937133446, 1.0)
    assert (batch.status == Status.UNSTOPPABLE).all()


def near_singular(miss: float) -> Case:
    """Return an impact of a wrist near a singular posture, which sticks and loads the weak direction."""
    twists = ((np.pi / 2, 0.0, 0.4), (-np.pi / 2, 0.3, 0.0))
    arm = Arm((0.3, -0.8, 0.5), (0.0, 0.0, 1.0), (0.4, 0.9, 0.0), (0.6, -0.3, 0.8), twists)
    q = many_arms.singular(arm, np.array([arm.q]))
    directions = np.linalg.svd(many_arms.kinematics(arm, q)[0][0])[0]
    normal = directions @ [0.2, 0.3, 1.0]  # the last is the weak direction
    q += [0.0, 0.0, miss]
    directions, _, rates = np.linalg.svd(many_arms.kinematics(arm, q)[0][0])
    v = -np.sign(normal @ directions) @ rates  # approaches along each direction
    arm = dataclasses.replace(arm, q=tuple(q[0]), normal=tuple(normal), v=tuple(v))
    return Case("near singular", arm, 9.0, 0.5, "poisson")


@pytest.mark.parametrize("miss", [1e-5, 1e-8, 1e-11])
def test_accuracy_in_weak_direction_by_factor_of_W(miss):
    """With the factor of W, impulses of the order of 1/miss have relative errors of the order of ε/miss."""
    case = near_singular(miss)
    W, v, _ = case.arm.contact_problem()
    exact = solve_reference(W, v, case.friction, case.restitution, case.law)
    P = [float(x) for x in exact.impulse]
    assert P[2] > 1e-2 / miss
    hit = solve(case)
    assert hit.solution.impulse == pytest.approx(P, rel=1e-13 / miss + 1e-9)
    assert Flag.LOCKED not in hit.solution.flags
    again = solve_impact(hit.problem)
    assert again.impulse.tolist() == hit.solution.impulse.tolist()
    model = pin.buildModelFromXML(case.arm.urdf())
    state = model, model.createData(), np.array(case.arm.q), np.array(case.arm.v)
    contact = Contact("tip", Plane(normal=case.arm.normal), case.friction, case.restitution, case.law)
    recorded = impact(*state, contact, record=True).solution
    assert recorded.impulse == pytest.approx(P, rel=1e-13 / miss + 1e-9)
    assert recorded.path.impulse[-1] == pytest.approx(P, rel=1e-13 / miss + 1e-9)
    rows = impacts(*state, contact)
    assert rows.impulse_world[0] == pytest.approx(hit.impulse_world, rel=1e-14)
    assert rows.work.compression[0] == pytest.approx(hit.solution.work.compression, rel=1e-14)


def test_slow_slip_of_nearly_stretched_arm():
    """The weaker direction is 1e-3 of the other, and the plane of the arm is 1e-10 from the floor."""
    rpy = (0.4, -0.7, 0.2)
    normal = pin.rpy.rpyToMatrix(*rpy) @ [np.sin(1e-10), 0.0, np.cos(1e-10)]
    arm = Arm(rpy, tuple(normal), (0.3, 1e-3), (1.0, -2.0))
    if float(arm.contact_problem()[1][2]) > 0:
        arm = dataclasses.replace(arm, v=(-1.0, 2.0))
    W, v, _ = arm.contact_problem()
    exact = solve_reference(W, v, 0.8, 0.5, "poisson")
    P = np.array([float(x) for x in exact.impulse])
    hit = solve(Case("leaning", arm, 0.8, 0.5, "poisson"))
    assert hit.solution.status.name == exact.status
    assert hit.solution.impulse == pytest.approx(P, rel=1e-3)


def test_arm_weak_in_two_directions_locks_after_slow_slip():
    """The arm is within 1e-7 of stretched and of parallel to the floor, so forces are 1e-15 of those of A.

    Slip decreases as its angle to an invariant direction to the power of 3.7e-15, and impulses are 1e7 times
    as large as usual.
    """
    tilt, stretch = 1.050433347286944e-08, 6.204527366365593e-08
    arm = Arm((0.0, 0.0, 0.0), (tilt, 0.0, 1.0), (-1.3855791555045882, stretch), (-1.36308, 1.30135))
    case = Case("parallel", arm, 0.3887521995637984, 0.24556941523742737, "energetic")
    W, v, axes = arm.contact_problem()
    exact = solve_reference(W, v, case.friction, case.restitution, case.law)
    solution = solve(case).solution
    assert solution.status.name == exact.status == "LOCKED"
    impulse = np.array(exact.impulse, dtype=float) @ np.array(axes, dtype=float)
    assert impulse[2] > 1e7
    assert solution.impulse == pytest.approx(impulse, rel=1e-6)


@pytest.mark.parametrize("joints", [3, 25])
@pytest.mark.parametrize("lightest", [1.0, 1e-4])
def test_rank_of_planar_chain(joints, lightest):
    """W has rank two; its tolerance must neither miss this for 25 joints nor include forces in the plane."""
    rng = np.random.default_rng(joints)
    model, parent, turned = pin.Model(), 0, pin.rpy.rpyToMatrix(0.4, -1.1, 0.7)
    for k, mass in enumerate(np.geomspace(1.0, lightest, joints)):
        place = pin.SE3(turned, np.zeros(3)) if k == 0 else pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint {k}")
        link = pin.Inertia(mass, np.array([0.2, 0.0, 0.0]), 0.02 * mass * np.eye(3))
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    model.addFrame(
        pin.Frame("tip", parent, pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), pin.FrameType.OP_FRAME)
    )
    contact = Contact("tip", Plane(normal=turned @ [0.6, 0.64, 0.48]), 0.3, 0.5)
    q, v = rng.uniform(-2, 2, joints), rng.standard_normal(joints)
    data = model.createData()
    if contact_matrices(model, data, q, contact).velocity(v)[2] > 0:
        v = -v
    hit = impact(model, data, q, v, contact)
    assert hit.solution.status == Status.SEPARATED
    assert Flag.SINGULAR_DELASSUS in hit.solution.flags
    assert Flag.NEAR_JUMP not in hit.solution.flags
    size = hit.problem.velocity_scale
    after = contact_matrices(model, data, q, contact).velocity(hit.v)
    assert after == pytest.approx(hit.solution.velocity, abs=1e-12 * size)


@pytest.mark.parametrize(
    ("factor", "message"),
    [(2 * np.eye(3), "which is not W"), (np.eye(2), "shape"), (np.full((3, 3), np.nan), "not finite")],
)
def test_wrong_factor_raises(factor, message):
    with pytest.raises(InputError, match=message) as caught:
        solve_impact(ImpactProblem(np.eye(3), (1, 0, -1), 0.3, 0.5, factor=factor))
    assert caught.value.field == "factor"


@pytest.mark.parametrize("scale", [-1.0, np.nan, "fast"])
def test_invalid_velocity_scale_raises(scale):
    with pytest.raises(InputError, match="velocity_scale") as caught:
        solve_impact(ImpactProblem(np.eye(3), (1, 0, -1), 0.3, 0.5, velocity_scale=scale))
    assert caught.value.field == "velocity_scale"


def _weak_twice(rng):
    """Return a problem W = XXᵀ of rank two, weak in two directions, and exact W and v in its range."""
    strong, weak, lift = 0.5 + rng.random(), 10.0 ** rng.uniform(-13, -5), 10.0 ** rng.uniform(-9, 0)
    k1, k2 = lift * rng.standard_normal(2)
    X = np.array([[strong, 0.0], [0.0, weak], [strong * k1, weak * k2]])
    v = np.array([rng.choice([-1, 1]) * (0.5 + rng.random()), weak * rng.standard_normal(), 0.0])
    with mp.workprec(400):
        F = mp.matrix(X.tolist())
        v3 = F[2, 0] / F[0, 0] * v[0] + F[2, 1] / F[1, 1] * v[1]
        if v3 > 0:
            v, v3 = -v, -v3
        W, exact = (F * F.T).tolist(), (mp.mpf(v[0]), mp.mpf(v[1]), v3)
    v[2] = float(v3)
    mu, e, law = 10.0 ** rng.uniform(-1.5, 1), float(rng.choice([0.0, 1.0, 0.6])), str(rng.choice(LAWS))
    return ImpactProblem(X @ X.T, v, mu, e, law, velocity_scale=1.0, factor=X), W, exact


@pytest.mark.parametrize("count", [12, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_accuracy_of_problems_weak_in_two_directions(count):
    """Forces along the slip are 1e-26 of the usual ones, and v₃ changes by a difference c − μbᵀσ."""
    rng = np.random.default_rng(2)
    for _ in range(count):
        problem, W, v = _weak_twice(rng)
        exact = solve_reference(W, v, problem.friction, problem.restitution, problem.law)
        solution = solve_impact(problem)
        P = np.array(exact.impulse, dtype=float)
        assert solution.impulse == pytest.approx(P, abs=1e-10 * np.abs(P).max())
        assert solution.velocity == pytest.approx([float(x) for x in exact.velocity], abs=1e-12)


@pytest.mark.parametrize(
    ("case", "rel"),
    [
        (
            Case(
                "along the floor",
                Arm(
                    (-0.4518783414425571, -1.3066087708615255, -0.5893361838945224),
                    (-0.47922346991945874, 0.8456690437745591, 0.23492282622124266),
                    (-1.555182378781205, -3.5766781857756096e-11),
                    (-1.45110241890847, 1.5014880876791503),
                ),
                *(0.2235198592886382, 0.0, "newton"),
            ),
            1e-3,
        ),
        (
            Case(
                "upright",
                Arm(
                    (0.23881782859207767, -0.007576635897118766, -0.6050411180987755),
                    (0.5486184202457679, 0.8019024515055119, 0.23658041076274702),
                    (0.5430693072812867, -1.6193890423890397e-09),
                    (-0.46341158075330213, 0.5552582347670861),
                ),
                *(8.166571465127012, 1.0, "newton"),
            ),
            1e-3,
        ),
        (
            Case(
                "upright, three joints",
                Arm(
                    (0.0, 0.0, 0.0),
                    (0.9423295551919427, 0.33468643446030993, 1.0293242627893104e-05),
                    (-1.0210324430014062, 6.26055756068409e-10, 1.0232409783297224e-12),
                    (-0.5169910836327004, -0.8724349638514344, 1.899739512148779),
                ),
                *(8.579245366774192, 1.0, "poisson"),
            ),
            1e-3,
        ),
    ],
)
def test_arms_weak_in_two_directions_have_solutions(case, rel):
    W, v, _ = case.arm.contact_problem()
    exact = solve_reference(W, v, case.friction, case.restitution, case.law)
    solution = solve(case).solution
    assert solution.status.name == exact.status
    assert solution.impulse[2] == pytest.approx(float(exact.impulse[2]), rel=rel)


def test_rounding_errors_of_a_row_of_the_jacobian_are_relative_to_it():
    """The plane of the arm is tilted by a small angle from the floor, so the normal row is small."""
    rpy, tilt = (0.4, -0.7, 0.2), 3e-10
    normal = pin.rpy.rpyToMatrix(*rpy) @ [np.sin(tilt), 0.0, np.cos(tilt)]
    arm = Arm(rpy, tuple(normal), (0.3, -0.8, 1.1), (1.0, -2.0, 0.5))
    model = pin.buildModelFromXML(arm.urdf())
    contact = Contact("tip", Plane(normal=arm.normal), 0.3, 0.5)
    matrices = contact_matrices(model, model.createData(), np.array(arm.q), contact)
    with mp.workdps(40):
        J, _ = arm._planar()
        x, y = (_axes(arm.normal) * _rotation(rpy))[2, 0:2]
        rows = [x * J[0, j] + y * J[1, j] for j in range(3)]
        exact = [float(row / rows[0]) for row in rows]
    assert matrices.h / matrices.h[0] == pytest.approx(exact, rel=1e-5)
    # the error of the tilt is common to all joints: the row is a combination of the two exact planar ones
    planar = np.array(J.tolist(), dtype=float)
    residual = np.linalg.lstsq(planar.T, matrices.h, rcond=None)[0] @ planar - matrices.h
    assert np.abs(residual).max() < 1e-14 * np.abs(matrices.h).max()


def test_rows_of_the_jacobian_for_all_kinds_of_joints():
    """The joints are revolute, prismatic, planar and free."""
    pin.seed(0)
    model, parent = pin.Model(), 0
    joints = [pin.JointModelFreeFlyer(), pin.JointModelPX(), pin.JointModelPlanar(), pin.JointModelRY()]
    rng = np.random.default_rng(0)
    for k, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Random(), f"joint {k}")
        model.appendBodyToJoint(parent, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    model.addFrame(pin.Frame("tip", parent, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    q = pin.integrate(model, pin.neutral(model), rng.standard_normal(model.nv))
    contact = Contact("tip", Plane(normal=(0.2, -0.4, 0.9)), 0.3, 0.5)
    data = model.createData()
    plain = contact_geometry(model, data, q, contact).jacobian
    assert contact_matrices(model, data, q, contact).jacobian == pytest.approx(plain, abs=1e-13)
