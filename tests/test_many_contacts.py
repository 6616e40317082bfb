"""Impacts at several contacts in contact space: closed forms, integration by SciPy, symmetries, energy."""

import math
import re

import numba
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinimpact
from pinimpact import Flag, ImpactProblem, InputError, LawError, Status, solve_impact
from pinimpact._compile import jit
from pinimpact.contact_space import simultaneous
from pinimpact.contact_space._kernels.propagation_stages import Springs, minimize
from pinimpact.contact_space._kernels.tolerances import BY_STEPS
from pinimpact.contact_space.many_inputs import many_inputs
from pinimpact.contact_space.waves import _propagate_in_steps
from pinimpact.robot._kernels.responses import half_solve

from .drawing import one_of_each

CRADLE = (-0.130261695064521, 0.150229569434774, 0.980032125629747)


def row_of_balls(count, masses=None):
    """Return J (3n, balls) and M⁻¹ of balls in a row with n contacts."""
    jacobian = np.zeros((3 * (count - 1), count))
    for j in range(count - 1):
        jacobian[3 * j + 2, j : j + 2] = -1.0, 1.0
    return jacobian, np.eye(count) if masses is None else np.diag(1.0 / np.asarray(masses, dtype=float))


def collide(jacobian, inverse, u, friction=0.0, restitution=0.0, **options):
    """Solve an impact with the energetic law; return the solution and u⁺."""
    problem = ImpactProblem(
        jacobian @ inverse @ jacobian.T,
        (jacobian @ u).reshape(-1, 3),
        friction,
        restitution,
        "energetic",
        stiffness=options.pop("stiffness", None),
    )
    solution = solve_impact(problem, **options)
    return solution, u + inverse @ jacobian.T @ solution.impulse.ravel()


def planar_body(points, mass, inertia):
    """Return J and M⁻¹ of a planar body (vx, vz, ω) with contacts at points (x, z) relative to its centre."""
    rows = [row for x, z in points for row in ([1.0, 0.0, -z], [0.0, 0.0, 0.0], [0.0, 1.0, x])]
    return np.array(rows), np.diag([1.0 / mass, 1.0 / mass, 1.0 / inertia])


def turning_about(corner, omega):
    """Return the velocity (vx, vz, ω) of a body that rotates about its corner (x, z)."""
    return np.array([omega * corner[1], -omega * corner[0], omega])


@pytest.mark.parametrize(
    ("e", "after", "digits"),
    [
        (1.0, CRADLE, 1e-14),
        (0.9, (-0.0653045867, 0.1671929516, 0.8981116351), 1e-10),
        (0.5, (0.1827348569, 0.2339841796, 0.5832809634), 1e-10),
        (0.0, (1 / 3, 1 / 3, 1 / 3), 1e-14),
    ],
)
def test_three_balls_in_a_row(e, after, digits):
    # reference values by an independent program
    _, found = collide(*row_of_balls(3), np.array([1.0, 0.0, 0.0]), restitution=e)
    assert found == pytest.approx(after, abs=digits)


def test_three_elastic_balls_agree_with_modal_solution():
    # δ₁ ± δ₂ oscillate with frequencies 1 and √3. The first contact separates at the zero of
    # sin t + sin(√3 t)/√3, after which the second one unloads with frequency √2.
    low, high = 2.0, 3.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high)
            if math.sin(middle) + math.sin(math.sqrt(3) * middle) / math.sqrt(3) > 0
            else (low, middle)
        )
    t = low
    d2 = 0.5 * (math.sin(t) - math.sin(math.sqrt(3) * t) / math.sqrt(3))
    p1 = 0.5 * ((1 - math.cos(t)) + (1 - math.cos(math.sqrt(3) * t)) / 3)
    p2 = 0.5 * ((1 - math.cos(t)) - (1 - math.cos(math.sqrt(3) * t)) / 3)
    rate = (p1 - p2) - p2  # of δ₂
    amplitude = math.hypot(d2, rate / math.sqrt(2))
    phase = math.atan2(d2, rate / math.sqrt(2))
    p2 += (amplitude / math.sqrt(2)) * (math.cos(phase) + 1)
    _, found = collide(*row_of_balls(3), np.array([1.0, 0.0, 0.0]), restitution=1.0)
    assert found == pytest.approx([1 - p1, p1 - p2, p2], abs=1e-14)


def test_rows_of_balls_with_hertzian_contacts():
    _, three = collide(
        *row_of_balls(3), np.array([1.0, 0, 0]), restitution=1.0, exponent=1.5, simultaneous="propagate"
    )
    assert three == pytest.approx((-0.0709524, 0.0764030, 0.9945493), abs=5e-8)
    start = np.zeros(10)
    start[0] = 1.0
    _, ten = collide(*row_of_balls(10), start, restitution=1.0, exponent=1.5, simultaneous="propagate")
    expected = (-0.0710850, -0.0302738, -0.0158334, -0.0088857, -0.0051266)
    expected += (-0.0029860, -0.0017377, 0.0026720, 0.1473903, 0.9858659)
    assert ten == pytest.approx(expected, abs=1e-7)


def test_ten_balls_agree_with_siconos():
    # Siconos, Examples/Mechanics/ChainOfBalls/resultMonodisperseChain_LZBModel.ref, after the impact:
    # the same model, integrated by Euler's method with steps of 1e-6 N s, to an accuracy of 5e-4
    theirs = (-0.07105929287758861, -0.030186240457886, -0.01574960308766378, -0.008808055289868551)
    theirs += (-0.005062343781337067, -0.00293663194584919, -0.001701856524055756, 0.002624517363818925)
    theirs += (0.1469233855937676, 0.9859561210066624)
    start = np.eye(10)[0]
    _, ours = collide(*row_of_balls(10), start, restitution=1.0, exponent=1.5, simultaneous="propagate")
    assert ours == pytest.approx(theirs, abs=5e-4)
    assert abs(ours[8] - theirs[8]) > 4e-4  # an error of Siconos, as the previous test shows


@pytest.mark.parametrize(("ratio", "e"), one_of_each([1e4, 1e6, 1e8], [1.0, 0.5]))
def test_stiffness_ratios_of_1e4_to_1e8(e, ratio):
    # with increasing stiffness the balls behind the first contact move as one body; with decreasing stiffness
    # impacts of two balls follow each other
    start, power = np.eye(4)[0], np.arange(3.0)
    rows, inverse = row_of_balls(4)
    spinning = np.zeros((9, 12))  # balls with velocity along y and rotation; the first one strikes obliquely
    for j in range(3):
        spinning[3 * j + 2] = np.kron(np.eye(4)[j + 1] - np.eye(4)[j], [1, 0, 0])
        spinning[3 * j] = np.kron(np.eye(4)[j + 1] - np.eye(4)[j], [0, 1, 0])
        spinning[3 * j] -= np.kron(np.eye(4)[j + 1] + np.eye(4)[j], [0, 0, 1])
    oblique = np.array([1.0, 0.2, 0.3, *np.zeros(9)])
    options = {"restitution": e, "stiffness": ratio**power}
    smooth, after = collide(rows, inverse, start, **options)
    rough, spun = collide(spinning, np.diag([1, 1, 2.5] * 4), oblique, friction=0.3, **options)
    as_one = np.full(4, (1.0 + e) / 4.0) - np.array([e, 0.0, 0.0, 0.0])
    for solution, velocity in ((smooth, after), (rough, spun[::3])):
        assert not solution.flags & pinimpact.Flag.BOUND_REACHED
        assert velocity == pytest.approx(as_one, abs=1.0 / ratio + 1e-7)  # up to the energy of vibrations
    in_turn = start.copy()
    while (np.diff(in_turn) < -1e-14).any():
        j = int(np.argmin(np.diff(in_turn)))
        in_turn[j : j + 2] = np.array([[1 - e, 1 + e], [1 + e, 1 - e]]) @ in_turn[j : j + 2] / 2
    _, after = collide(rows, inverse, start, restitution=e, stiffness=ratio**-power)
    assert after == pytest.approx(in_turn, abs=1.0 / ratio + 1e-7)


@pytest.mark.parametrize(("e", "after"), [(1.0, (-0.2, 0.6, 0.3464102)), (0.5, (0.1, 0.45, 0.2598076))])
def test_ball_strikes_two_balls_symmetrically(e, after):
    jacobian = np.zeros((6, 6))
    for j, side in enumerate((1.0, -1.0)):
        normal = np.array([math.cos(math.pi / 6), side * math.sin(math.pi / 6)])
        jacobian[3 * j + 2, :2] = -normal
        jacobian[3 * j + 2, 2 * j + 2 : 2 * j + 4] = normal
    _, u = collide(jacobian, np.eye(6), np.array([1.0, 0, 0, 0, 0, 0]), restitution=e)
    assert u[:4] == pytest.approx([after[0], 0.0, *after[1:]], abs=5e-8)
    assert u[4:] == pytest.approx([u[2], -u[3]], abs=1e-14)


@pytest.mark.parametrize("slenderness", [4.0, 2.0, 1.0, 1 / math.sqrt(2)])
@pytest.mark.parametrize("e", [0.0, 0.3, 0.5])
def test_rocking_block_rotates_about_the_other_corner(slenderness, e):
    height = slenderness
    corners = (-1.0, -height), (1.0, -height)
    jacobian, inverse = planar_body(corners, 1.0, (1 + height**2) / 3)
    start = turning_about(corners[0], -1.0)
    _, after = collide(jacobian, inverse, start, friction=100.0, restitution=e)
    alpha = math.atan2(1.0, height)
    assert after[2] / -1.0 == pytest.approx(1 - 1.5 * (1 + e) * math.sin(alpha) ** 2, abs=1e-12)


def test_flat_block_lands_on_its_second_corner():
    corners = (-0.5, -0.25), (0.5, -0.25)
    jacobian, inverse = planar_body(corners, 1.0, (1 + 0.25) / 12)
    start = turning_about(corners[0], -1.0)
    solution, after = collide(jacobian, inverse, start, friction=100.0, restitution=0.0)
    # a sequence of decreasing compressions ends at 1e-10 of the largest velocity
    assert after == pytest.approx(np.zeros(3), abs=1e-10)
    assert solution.impulse[:, 2] == pytest.approx((0.0833333, 0.4166667), abs=1e-7)
    _, bounced = collide(jacobian, inverse, start, friction=100.0, restitution=0.5)
    assert bounced[2] / -1.0 == pytest.approx(-0.298915, abs=1e-6)


@pytest.mark.parametrize(
    ("corners", "masses", "friction", "restitution"),
    [
        (
            [(-1.7516, -0.8834), (0.1586, -0.2343), (1.3725, 0.5722), (1.9419, -0.153)],
            [0.1863, 0.7309, 0.2338, 0.305, 1.3252, 1.3169],
            [0.194570540618, 1.0, 0.0, 0.194570540618],
            [0.130564015563, 1.0, 0.5, 1.0],
        ),
        (
            [(-0.593, 0.9283), (-0.6878, -2.4761), (0.6991, -1.5317), (-1.3326, -0.4305), (-1.1462, 0.0271)],
            [0.6041, 1.1586, 0.7941, 3.817, 23.1221, 0.084],
            [0.3, 0.950006, 0.0, 0.5, 0.3],
            [0.5, 0.001825, 0.931954, 0.5, 0.5],
        ),
    ],
)
def test_flat_landing_on_unequal_corners_does_not_depend_on_numbering(corners, masses, friction, restitution):
    # the distribution of friction is not unique, but must not depend on the numbering
    n = len(corners)
    jacobian = np.zeros((3 * n, 6))
    for j, (x, y) in enumerate(corners):
        jacobian[3 * j : 3 * j + 3, :3] = np.eye(3)
        jacobian[3 * j : 3 * j + 3, 3:] = [[0.0, -1.0, -y], [1.0, 0.0, x], [y, -x, 0.0]]
    w = jacobian @ np.diag(1.0 / np.array(masses)) @ jacobian.T
    v = np.tile([0.0, 0.0, -1.0], (n, 1))
    mu, e = np.array(friction), np.array(restitution)
    found = []
    for order in [np.roll(np.arange(n), k) for k in range(n)] + [np.arange(n)[::-1]]:
        rows = (3 * order[:, None] + np.arange(3)).ravel()
        problem = ImpactProblem(w[np.ix_(rows, rows)], v, mu[order], e[order], law="energetic")
        solution = solve_impact(problem)
        assert all("integrated by adaptive steps" in note for note in solution.notes)
        velocity = np.empty((n, 3))
        velocity[order] = solution.velocity
        found.append(velocity)
    # accuracy of the steps [m/s]
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (n + 1, n, 3)), atol=1e-7)


def test_flat_bar_rebounds_without_rotation():
    jacobian, inverse = planar_body([(-0.5, 0.0), (0.5, 0.0)], 1.0, 1 / 12)
    solution, after = collide(jacobian, inverse, np.array([0.0, -1.0, 0.0]), restitution=0.6)
    assert after == pytest.approx([0.0, 0.6, 0.0], abs=1e-14)
    assert solution.statuses == (Status.SEPARATED, Status.SEPARATED)


def test_point_mass_leaves_narrow_wedge():
    # 48 events between walls at an angle of 5°; reference values by an independent program
    half = math.radians(2.5)
    jacobian = np.zeros((6, 2))
    jacobian[2], jacobian[5] = (math.sin(half), math.cos(half)), (math.sin(half), -math.cos(half))
    solution, after = collide(jacobian, np.eye(2), np.array([-1.0, -0.3]), restitution=0.5)
    assert after == pytest.approx((0.451, 0.002), abs=5e-4)
    assert not solution.notes


@pytest.mark.parametrize(("alpha", "inertia"), [(0.3, 0.4), (0.2, 0.1)])
def test_two_feet_of_a_rimless_wheel(alpha, inertia):
    feet = (-math.sin(alpha), -math.cos(alpha)), (math.sin(alpha), -math.cos(alpha))
    jacobian, inverse = planar_body(feet, 1.0, inertia)
    _, after = collide(jacobian, inverse, turning_about(feet[0], -1.0), friction=100.0, restitution=0.0)
    assert after[2] / -1.0 == pytest.approx((math.cos(2 * alpha) + inertia) / (1 + inertia), abs=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_propagation_with_one_contact_equals_single_impact(seed):
    rng = np.random.default_rng(seed)
    compared = 0
    for _ in range(200):
        factor = rng.normal(size=(3, 5))
        v, mu, e = rng.normal(size=3), rng.uniform(0, 1.5), rng.uniform(0, 1)
        v[2] = -abs(v[2])
        w = factor @ factor.T
        alone = solve_impact(ImpactProblem(w, v, mu, e, "energetic"))
        if Flag.SECOND_COMPRESSION in alone.flags:
            continue  # after partial restitution the contact is stiffer here
        of_many = solve_impact(ImpactProblem(w, v[None], mu, e, "energetic"))
        assert of_many.velocity[0] == pytest.approx(alone.velocity, abs=1e-10 * np.abs(v).max())
        assert of_many.work.friction[0] == pytest.approx(alone.work.friction, abs=1e-9)
        compared += 1
    assert compared > 180


def integrate_with_scipy(w, v, e, stiffness, exponent):
    """Return v₃⁺ of n frictionless contacts, integrated by SciPy from event to event."""
    n = len(v)
    d, deepest, loading = np.zeros(n), np.zeros(n), v < 0
    v = v.copy()
    while True:
        force_of = lambda d: stiffness * np.where(loading | (d > 0), np.maximum(d, 0.0), 0.0) ** exponent  # noqa: E731
        modes = [("C" if loading[j] else ("R" if deepest[j] > 0 else "O")) for j in range(n)]
        rho = np.array([1 / e[j] ** 2 if modes[j] == "R" else 1.0 for j in range(n)])

        def rates(s, y, rho=rho, force_of=force_of):
            return np.concatenate([w @ force_of(y[n:]), -rho * y[:n]])

        events = []
        for j in range(n):
            if modes[j] == "C":
                events.append((lambda s, y, j=j: y[j], 1, j, "peak"))
            elif modes[j] == "R":
                events.append((lambda s, y, j=j: y[n + j], -1, j, "open"))
                events.append(
                    (lambda s, y, j=j, top=deepest[j]: y[n + j] - top * (1 + 1e-13), 1, j, "deeper")
                )
            else:
                events.append((lambda s, y, j=j: y[n + j], 1, j, "close"))
        for event in events:
            event[0].__dict__.update(terminal=True, direction=event[1])
        if not (d > 1e-13).any() and not (loading & (v < 0)).any():
            closing = [j for j in range(n) if v[j] < -1e-12]
            if not closing:
                return v
        run = solve_ivp(
            rates,
            (0, 500),
            np.concatenate([v, d]),
            "DOP853",
            events=[x[0] for x in events],
            rtol=1e-12,
            atol=1e-14,
        )
        v, d = run.y[:n, -1].copy(), run.y[n:, -1].copy()
        happened = [k for k, times in enumerate(run.t_events) if len(times)]
        if not happened:
            return v
        for k in happened:
            _, _, j, kind = events[k]
            if kind == "peak":
                v[j], deepest[j], loading[j] = 0.0, d[j], False
            elif kind == "open":
                d[j], deepest[j] = 0.0, 0.0
            elif kind == "deeper":
                loading[j] = True
            else:
                d[j], loading[j] = 0.0, True


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("seed", range(6))
def test_frictionless_impacts_agree_with_integration_by_scipy(seed, exponent):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    factor = rng.normal(size=(n, n + 1))
    normal = factor @ factor.T
    v, e, stiffness = -rng.uniform(0.2, 1.0, n), rng.uniform(0.3, 1.0, n), rng.uniform(0.5, 2.0, n)
    w = np.zeros((3 * n, 3 * n))
    w[2::3, 2::3] = normal
    velocity = np.zeros((n, 3))
    velocity[:, 2] = v
    problem = ImpactProblem(w, velocity, 0.0, e, "energetic", stiffness=stiffness)
    found = solve_impact(problem, simultaneous="propagate", exponent=exponent)
    scaled = stiffness / np.max(stiffness * np.diag(normal))
    expected = integrate_with_scipy(normal, v / np.abs(v).max(), e, scaled, exponent) * np.abs(v).max()
    assert found.velocity[:, 2] == pytest.approx(expected, abs=1e-8)


def random_robot(seed, flat=False):
    """Return J, M⁻¹, u, μ and e of a random robot with several contacts."""
    rng = np.random.default_rng(seed)
    n, dofs = int(rng.integers(2, 5)), int(rng.integers(4, 15))
    jacobian, u = rng.normal(size=(3 * n, dofs)), rng.normal(size=dofs)
    if rng.random() < 0.3:
        jacobian, u = np.round(2 * jacobian) / 2, np.round(2 * u) / 2
    inverse = np.diag(np.exp(rng.normal(size=dofs)))
    mu = rng.choice([0.0, 0.3, 0.6, rng.uniform(0, 1.2)], n)
    e = rng.choice([0.0, 0.5, 1.0, rng.uniform(0.05, 1)], n)
    return jacobian, inverse, u, mu, e


def test_invariants_of_random_problems():
    moved = []
    for seed in range(300):
        jacobian, inverse, u, mu, e = random_robot(seed)
        n = len(mu)
        v = (jacobian @ u).reshape(n, 3)
        solution, after = collide(jacobian, inverse, u, friction=mu, restitution=e)
        scale = np.abs(v).max()
        assert (jacobian @ after).reshape(n, 3) == pytest.approx(solution.velocity, abs=1e-6 * scale)
        p = solution.impulse
        assert (np.hypot(p[:, 0], p[:, 1]) <= mu * p[:, 2] * (1 + 1e-6) + 1e-9 * np.abs(p).max()).all(), seed
        assert (p[:, 2] >= -1e-12 * np.abs(p).max()).all(), seed
        assert (solution.velocity[:, 2] >= -1e-6 * scale).all(), seed
        before, later = 0.5 * u @ (u / np.diag(inverse)), 0.5 * after @ (after / np.diag(inverse))
        assert later <= before * (1 + 1e-9), seed
        assert later - before == pytest.approx(solution.work.total.sum(), abs=1e-6 * before), seed
        order = np.random.default_rng(seed).permutation(n)
        rows = (3 * order[:, None] + np.arange(3)).ravel()
        other, _ = collide(jacobian[rows], inverse, u, friction=mu[order], restitution=e[order])
        moved.append(np.abs(other.velocity - solution.velocity[order]).max() / scale)
    # results differ only if rounding decides a tie where the map is discontinuous
    assert np.quantile(moved, 0.97) < 1e-9


def test_sliding_continues_through_infinitely_many_impacts_in_a_groove():
    # a body in a groove bounces between its sides infinitely often. Slip keeps its direction, so the limit is
    # linear: v₃ = 0 at both sides, with friction −μ P₃ at one
    turned = math.sqrt(0.5)
    jacobian = np.zeros((6, 3))
    jacobian[[0, 2]] = [[turned, -turned, turned], [turned, turned, -turned]]
    jacobian[[3, 5]] = [[turned, turned, turned], [-turned, turned, turned]]
    u, mu = np.array([0.3, -1.0, 1.0]), 0.5
    push = np.array([jacobian[2], jacobian[5] - mu * jacobian[3]]).T
    impulse = np.linalg.solve(jacobian[2::3] @ push, -(jacobian[2::3] @ u))
    solution, after = collide(jacobian, np.eye(3), u, friction=[0.0, mu], restitution=0.05)
    assert solution.events > 20
    assert (jacobian @ u)[3] > 0.0
    assert (jacobian @ after)[3] > 0.1  # it keeps sliding
    assert solution.impulse[:, 2] == pytest.approx(impulse, abs=1e-9)
    assert after == pytest.approx(u + push @ impulse, abs=1e-9)


def test_simultaneous_stop_of_all_contacts_in_any_coordinates():
    # slip at three contacts and an approach end at the same time; the coordinates change rounding errors only
    jacobian = np.array(
        [
            *([-0.0513, 1.4280, -0.1032], [0.5254, 0.2257, -1.2808], [0.7010, 1.2363, -1.7537]),
            *([-0.0217, -1.8394, -1.0865], [-0.1825, -1.9483, 2.2871], [0.3352, 0.3917, -0.2450]),
            *([-0.1192, 1.6405, -0.0597], [0.6650, 0.0031, 2.3085], [-0.2617, -0.0172, 1.5924]),
        ]
    )
    u, mu = np.array([-1.5749, -0.1310, 0.1704]), [0.9522, 0.1968, 0.2709]
    for seed in range(12):
        turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
        solution, after = collide(jacobian @ turn, np.eye(3), turn.T @ u, friction=mu)
        assert solution.events < 20
        assert np.abs(solution.velocity).max() < 1e-12
        assert np.abs(after).max() < 1e-12


def test_small_perturbations_after_simultaneous_stop_have_small_effects():
    # a body comes to rest at four loaded contacts at once, and moves again afterwards
    jacobian = np.array(
        [
            *(
                [-1.4, 0.78, 1.22, -1.07, 2.09],
                [-0.93, 1.51, -2.52, 1.32, -0.1],
                [0.47, -0.01, -0.19, 1.25, -0.01],
            ),
            *(
                [1.4, -3.76, -0.64, -0.54, -2.79],
                [0.0, 2.98, -0.06, -0.57, 1.8],
                [0.93, -0.77, 0.54, -3.57, -1.85],
            ),
            *(
                [0.0, 0.0, 0.0, 0.0, 2.13],
                [0.93, -0.77, 0.02, -0.75, -0.47],
                [0.47, -0.76, 1.26, -1.93, -1.17],
            ),
            *(
                [0.0, -1.49, -0.23, -0.21, -2.58],
                [1.4, 2.94, -1.17, -0.99, -0.14],
                [0.0, 0.0, 0.52, -1.55, -0.69],
            ),
            *(
                [-2.33, 0.81, 1.09, -0.11, 0.65],
                [0.47, -2.25, 0.51, -1.22, -2.34],
                [-1.4, -0.7, 1.51, 1.61, 1.78],
            ),
        ]
    )
    u, mu, e = (
        np.array([-0.77, -0.42, -0.07, -0.12, 0.94]),
        [0.3, 0.3, 0.975, 0.5, 0.0],
        [1.0, 0.0, 0.961, 0.0, 0.5],
    )
    _, after = collide(jacobian, np.eye(5), u, friction=mu, restitution=e)
    for seed, shift in enumerate((1e-10, 1e-9, 1e-8)):
        other = u + shift * np.random.default_rng(seed).normal(size=5)
        solution, moved = collide(jacobian, np.eye(5), other, friction=mu, restitution=e)
        assert solution.events < 300
        assert moved == pytest.approx(after, abs=100.0 * shift)


@pytest.mark.parametrize("policy", ["sequence", "any"])
@pytest.mark.parametrize("e", [0.0, 0.5, [0.2, 0.9]])
def test_infinite_sequence_of_impacts_reaches_its_limit(policy, e):
    # in a slot that narrows by 2°, tens of thousands of bounces hardly change the direction of the velocity;
    # in the limit the normal velocities vanish
    turn = math.radians(1.0)
    jacobian = np.zeros((6, 3))
    jacobian[2], jacobian[5] = (
        [math.cos(turn), math.sin(turn), 0.0],
        [-math.cos(turn), math.sin(turn), 0.0],
    )
    inverse = np.array([[1.0, 0.2, 0.1], [0.2, 0.7, 0.3], [0.1, 0.3, 0.9]])
    u, normals = np.array([0.3, -1.0, 0.4]), jacobian[2::3]
    with pytest.warns(pinimpact.BoundReachedWarning, match="After 400 single impacts"):
        solution, after = collide(jacobian, inverse, u, restitution=e, simultaneous=policy)
    assert Flag.BOUND_REACHED in solution.flags
    impulse = -np.linalg.solve(normals @ inverse @ normals.T, normals @ u)
    assert solution.impulse[:, 2] == pytest.approx(impulse, rel=1e-8)
    assert after == pytest.approx(u + inverse @ normals.T @ impulse, abs=1e-9)
    mass = np.linalg.inv(inverse)
    assert solution.work.total.sum() == pytest.approx(0.5 * (after @ mass @ after - u @ mass @ u), abs=1e-9)
    assert "After 400 single impacts" in solution.notes[0]
    assert solution.notes[0].count("contact 0 at") + solution.notes[0].count("contact 1 at") == 5


@pytest.mark.parametrize("seed", [3, 17, 29])
def test_permuted_contacts_give_bitwise_equal_results(seed):
    jacobian, inverse, u, mu, e = random_robot(seed)
    n = len(mu)
    delassus, velocity = jacobian @ inverse @ jacobian.T, (jacobian @ u).reshape(n, 3)
    delassus = 0.5 * (delassus + delassus.T)
    solution = solve_impact(ImpactProblem(delassus, velocity, mu, e, "energetic"), record=True)
    order = np.random.default_rng(seed).permutation(n)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    problem = ImpactProblem(delassus[np.ix_(rows, rows)], velocity[order], mu[order], e[order], "energetic")
    other = solve_impact(problem, record=True)
    assert (order != np.arange(n)).any()
    assert (other.velocity == solution.velocity[order]).all()
    assert (other.impulse == solution.impulse[order]).all()
    assert other.segments == tuple(solution.segments[j] for j in order)
    assert (other.path.impulse == solution.path.impulse[:, order]).all()
    assert (other.path.velocity == solution.path.velocity[:, order]).all()
    assert (other.work.friction == solution.work.friction[order]).all()


def test_scaling_of_speeds_and_masses():
    jacobian, inverse, u, mu, e = random_robot(11)
    _, after = collide(jacobian, inverse, u, friction=mu, restitution=e)
    _, faster = collide(jacobian, inverse, 7.0 * u, friction=mu, restitution=e)
    _, heavier = collide(jacobian, inverse / 13.0, u, friction=mu, restitution=e)
    assert faster == pytest.approx(7.0 * after, rel=1e-10)
    assert heavier == pytest.approx(after, rel=1e-9)


@pytest.mark.parametrize("seed", [86, 204, 218])
def test_scaling_of_masses_by_a_power_of_two_is_exact(seed):
    rng, n = np.random.default_rng(seed), 4
    jacobian = rng.normal(size=(3 * n, 6))
    w, v = jacobian @ jacobian.T, (jacobian @ rng.normal(size=6)).reshape(n, 3)
    mu, e = rng.choice([0.0, 0.3, 1.0], n), rng.choice([0.0, 0.3, 0.8], n)
    stones = solve_impact(ImpactProblem(w, v, mu, e, "energetic"), record=True)
    scale = 4.0**15
    dust = solve_impact(ImpactProblem(w * scale, v, mu, e, "energetic"), record=True)
    assert np.array_equal(dust.velocity, stones.velocity)
    assert np.array_equal(dust.impulse * scale, stones.impulse)
    assert np.array_equal(dust.work.restitution * scale, stones.work.restitution)
    assert np.array_equal(dust.path.velocity, stones.path.velocity)
    assert np.array_equal(dust.path.impulse * scale, stones.path.impulse)
    assert [part.end * scale for part in dust.segments[0]] == [part.end for part in stones.segments[0]]


def test_splitting_a_contact_into_two_of_half_stiffness_changes_nothing():
    jacobian, inverse, u, mu, e = random_robot(5)
    mu, e = mu[:2], np.array([0.5, 0.7])
    whole, after = collide(jacobian[:6], inverse, u, friction=mu, restitution=e)
    rows = np.vstack([jacobian[:6], jacobian[:3]])
    _, split = collide(
        *(rows, inverse, u),
        friction=mu[[0, 1, 0]],
        restitution=e[[0, 1, 0]],
        stiffness=(0.5, 1.0, 0.5),
    )
    assert split == pytest.approx(after, abs=1e-9)
    assert whole.events > 0


def test_uncoupled_impacts_are_independent():
    first, second = random_robot(21), random_robot(22)
    together = [
        np.block([[a, np.zeros((len(a), b.shape[1]))], [np.zeros((len(b), a.shape[1])), b]])
        for a, b in zip(first[:2], second[:2], strict=True)
    ]
    joined = [np.concatenate([a, b]) for a, b in zip(first[2:], second[2:], strict=True)]
    one = collide(first[0], first[1], first[2], friction=first[3], restitution=first[4])[1]
    other = collide(second[0], second[1], second[2], friction=second[3], restitution=second[4])[1]
    both = collide(together[0], together[1], joined[0], friction=joined[1], restitution=joined[2])[1]
    assert both == pytest.approx(np.concatenate([one, other]), abs=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize(
    ("mu", "u"), [(0.3, (0, 0, -1, 0.7, 0, 0)), (0.3, (1, 0.2, -1, 0, 0, 2)), (0.0, (0, 0, -1, 0, 0, 0))]
)
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_contacts_listed_several_times_are_one_contact(e, mu, u, exponent):
    # without restitution, twins that are held shared their force unevenly and separated one after the other
    corners = [(x, y, -0.25) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    rows = [np.hstack([np.eye(3), -pin.skew(np.array(corner))]) for corner in corners]
    inverse, stiffness = np.diag([1.0, 1.0, 1.0, 9.6, 9.6, 6.0]), np.array([1.0, 2.0, 0.5, 3.0])
    options = {"friction": mu, "restitution": e, "exponent": exponent, "record": True}
    once, after = collide(np.vstack(rows), inverse, np.array(u, float), stiffness=stiffness, **options)
    order = np.random.default_rng(0).permutation(12)
    of, part = np.tile(np.arange(4), 3)[order], np.repeat([0.5, 0.3, 0.2], 4)[order]
    jacobian = np.vstack([rows[k] for k in of])
    found, other = collide(jacobian, inverse, np.array(u, float), stiffness=part * stiffness[of], **options)
    assert other == pytest.approx(after, abs=1e-12)
    assert found.velocity == pytest.approx(once.velocity[of], abs=1e-12)
    assert found.impulse == pytest.approx(part[:, None] * once.impulse[of], abs=1e-12)
    assert found.work.total == pytest.approx(part * once.work.total[of], abs=1e-12)
    assert found.compression_impulse == pytest.approx(part * once.compression_impulse[of], abs=1e-12)
    assert found.path.impulse[-1] == pytest.approx(found.impulse, abs=1e-12)
    assert found.flags == once.flags
    assert found.statuses == tuple(once.statuses[k] for k in of)


@pytest.mark.parametrize("policy", ["propagate", "sequence", "together"])
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_uncoupled_contacts_of_any_speed_and_mass_change_no_bit(policy, e):
    # with common scales a fast, light or heavy body beside others changed their impacts by up to their speed
    law, friction = ("poisson" if policy == "together" else "energetic"), 0.3
    jacobian, inverse, u, _, _ = random_robot(1)
    w, v = jacobian @ inverse @ jacobian.T, (jacobian @ u).reshape(-1, 3)
    n = len(v)
    alone = solve_impact(ImpactProblem(w, v, friction, e, law), simultaneous=policy)
    assert alone.impulse[:, 2].max() > 0.0
    ball = np.array([[0.5, 0.0, -1.0]])
    for mass, speed in ((1.0, 1e12), (1.0, 1e-12), (1e-12, 1.0), (1e12, 1.0), (1.0, -1e12), (1.0, 0.0)):
        both = np.zeros((3 * n + 3, 3 * n + 3))
        both[:-3, :-3], both[-3:, -3:] = w, np.eye(3) / mass
        problem = ImpactProblem(both, np.vstack([v, speed * ball]), friction, e, law)
        solution = solve_impact(problem, simultaneous=policy, record=policy == "propagate")
        assert np.array_equal(solution.velocity[:n], alone.velocity)
        assert np.array_equal(solution.impulse[:n], alone.impulse)
        assert solution.statuses[:n] == alone.statuses
        assert solution.segments[:n] == alone.segments
        # the ball slips throughout: P₃ = (1 + e) m v and P_t = −μ P₃
        expected = (1.0 + e) * mass * max(speed, 0.0) * np.array([-friction, 0.0, 1.0])
        assert solution.impulse[n] == pytest.approx(expected, rel=1e-12, abs=0.0)
        assert solution.statuses[n] == (
            Status.NO_IMPACT if speed <= 0.0 else Status.SEPARATED if e > 0.0 else Status.ENDED_AT_REST
        )
        if solution.path is not None:
            moved = problem.velocity.ravel() + solution.path.impulse.reshape(-1, 3 * n + 3) @ both
            fastest = np.abs(problem.velocity).max()
            assert solution.path.velocity.reshape(moved.shape) == pytest.approx(moved, abs=1e-12 * fastest)
            assert np.diff(solution.path.clock).min() > 0.0


@pytest.mark.parametrize("policy", list(pinimpact.POLICIES))
def test_rounding_errors_of_a_contact_that_nothing_moves_are_no_approach(policy):
    # such as a contact of a link that held contacts fix, with a velocity that is zero except for rounding
    w = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    velocity = np.array([[0.0, 0.0, -1.0], [1e-16, 0.0, -2e-16]])
    found = solve_impact(ImpactProblem(w, velocity, 0.0, 0.5), simultaneous=policy)
    assert found.velocity == pytest.approx(np.array([[0.0, 0.0, 0.5], [1e-16, 0.0, -2e-16]]), abs=1e-30)
    assert found.impulse == pytest.approx(np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 0.0]]), abs=1e-15)
    assert found.statuses == (Status.SEPARATED, Status.NO_IMPACT)
    assert not found.flags & Flag.NEAR_JUMP


def test_uncoupled_contacts_are_named_by_their_numbers():
    w = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    problem = ImpactProblem(w, [[0, 0, -1], [0, 0, -2]], 0.5, 0.0)
    with pytest.raises(
        pinimpact.UnstoppableApproachError, match=r"contact 1 approaches at 2 m/s.* 1 contact "
    ):
        solve_impact(problem)
    with pytest.raises(pinimpact.UnstoppableApproachError):  # raised a ValueError of math.log2
        solve_impact(ImpactProblem(np.zeros((6, 6)), [[0, 0, -1], [0, 0, -2]], 0.5, 0.0))
    fine = ImpactProblem(w, [[0, 0, -1], [0, 0, 0]], 0.5, 0.0)
    assert solve_impact(fine).flags & Flag.SINGULAR_DELASSUS
    light = ImpactProblem(np.diag(np.repeat([1.0, 1e-15], 3)), [[0, 0, -1], [0, 0, -1]], 0.5, 0.0)
    assert not solve_impact(light).flags & Flag.SINGULAR_DELASSUS
    light.delassus[3, 3] = -1e-15
    with pytest.raises(InputError, match="semidefinite"):
        solve_impact(light)


def test_error_falls_with_rtol():
    jacobian, inverse, u, mu, e = random_robot(3)
    exact, _ = collide(jacobian, inverse, u, friction=mu, restitution=e)
    errors = []
    for rtol in (1e-2, 1e-5, 1e-9):
        found, _ = collide(
            jacobian, inverse, u, friction=mu, restitution=e, simultaneous="propagate", rtol=rtol
        )
        errors.append(np.abs(found.velocity - exact.velocity).max())
    assert errors[0] < 1e-1
    assert errors[1] < 1e-3
    assert errors[2] < 1e-8


def test_segments_and_path_of_each_contact():
    jacobian, inverse = row_of_balls(3)
    solution, _ = collide(jacobian, inverse, np.array([1.0, 0, 0]), restitution=0.5, record=True)
    for j, segments in enumerate(solution.segments):
        assert segments[0].start == 0.0
        assert segments[-1].end == pytest.approx(solution.impulse[j, 2], rel=1e-12)
        assert {segment.phase for segment in segments} == {"compression", "restitution"}
        w = solution.work
        assert w.restitution[j] == pytest.approx(-0.25 * w.compression[j], rel=1e-9)  # the energetic law
    path = solution.path
    assert path.velocity[0] == pytest.approx((jacobian @ [1.0, 0, 0]).reshape(-1, 3), abs=0)
    assert path.velocity[-1] == pytest.approx(solution.velocity, abs=1e-12)
    assert path.impulse[-1] == pytest.approx(solution.impulse, abs=1e-12)
    assert (np.diff(path.normal_impulse, axis=0) >= -1e-14).all()
    part = solution.part(1)
    assert part.impulse == pytest.approx(solution.impulse[1], abs=0)
    assert part.work.total == pytest.approx(solution.work.total[1], abs=0)


def test_newtons_cradle_by_the_other_policies():
    problem = ImpactProblem(*_cradle_of("poisson"))
    assert _balls_after(solve_impact(problem, simultaneous="together")) == pytest.approx(
        (-1 / 3, 2 / 3, 2 / 3), abs=1e-9
    )
    assert _balls_after(solve_impact(problem, simultaneous="sequence")) == pytest.approx((0, 0, 1), abs=1e-14)
    assert _balls_after(solve_impact(problem, simultaneous="reflect")) == pytest.approx((0, 0, 1), abs=1e-9)
    one, other = (solve_impact(problem, simultaneous="any", seed=seed) for seed in (3, 3))
    assert np.array_equal(one.impulse, other.impulse)


def _cradle_of(law):
    jacobian, _ = row_of_balls(3)
    return jacobian @ jacobian.T, (jacobian @ [1.0, 0, 0]).reshape(2, 3), 0.0, 1.0, law


def _balls_after(solution):
    return np.array([1.0, 0, 0]) + row_of_balls(3)[0].T @ solution.impulse.ravel()


@pytest.mark.parametrize("seed", range(20))
def test_policy_together_satisfies_coulombs_law(seed):
    jacobian, inverse, u, mu, _ = random_robot(seed)
    n = len(mu)
    w = jacobian @ inverse @ jacobian.T
    v = (jacobian @ u).reshape(n, 3)
    solution = solve_impact(ImpactProblem(w, v, mu, 0.0), simultaneous="together")
    p, after = solution.impulse, solution.velocity
    scale = np.abs(v).max()
    assert (after[:, 2] > -1e-6 * scale).all()
    assert np.abs(p[:, 2] * after[:, 2]).max() < 1e-5 * scale * max(np.abs(p).max(), 1e-300)
    slides = np.hypot(after[:, 0], after[:, 1])
    for j in range(n):
        if slides[j] > 1e-4 * scale and p[j, 2] > 1e-4 * np.abs(p).max():
            assert p[j, :2] == pytest.approx(
                -mu[j] * p[j, 2] * after[j, :2] / slides[j], abs=1e-3 * np.abs(p).max()
            )


def test_replaced_restitution_law_is_noted():
    for law, notes in (("newton", 1), ("poisson", 0)):  # Poisson's law is the default, so no note is given
        solution = solve_impact(ImpactProblem(*_cradle_of(law)))
        assert solution.law == "energetic"
        assert len(solution.notes) == notes
        assert _balls_after(solution) == pytest.approx(CRADLE, abs=1e-14)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"friction": (0.1, 0.2, 0.3)}, InputError, r"friction: shape \(3,\) given, a number or \(2,\)"),
        ({"restitution": (0.5, 1.5)}, InputError, r"restitution: 1.5 given"),
        ({"stiffness": (1.0, 0.0)}, InputError, r"stiffness: 0.0 given, a finite number > 0"),
        ({"friction": -0.1}, InputError, r"friction: -0.1 given"),
        ({"delassus": np.eye(5)}, InputError, r"delassus: shape \(5, 5\) given, \(6, 6\)"),
        ({"delassus": -np.eye(6)}, InputError, r"delassus: W must be positive semidefinite"),
        ({"velocity": [[0, 0, np.nan], [0, 0, 0]]}, InputError, r"velocity: .* not finite"),
        ({"law": "soft"}, pinimpact.UnknownNameError, r"law: 'soft'"),
    ],
)
def test_bad_input(change, error, words):
    numbers = {
        "delassus": np.eye(6),
        "velocity": [[0, 0, -1.0], [0, 0, -1.0]],
        "friction": 0.5,
        "restitution": 0.5,
    }
    with pytest.raises(error, match=words):
        solve_impact(ImpactProblem(**(numbers | change)))


def test_bad_policies():
    problem = ImpactProblem(*_cradle_of("energetic"))
    with pytest.raises(pinimpact.UnknownNameError, match="simultaneous: 'all' is not a policy"):
        solve_impact(problem, simultaneous="all")
    with pytest.raises(LawError, match='"together" supports Poisson'):
        solve_impact(problem, simultaneous="together")
    with pytest.raises(pinimpact.UnknownNameError, match="seed: unknown option of 'propagate'"):
        solve_impact(problem, simultaneous="propagate", seed=1)
    with pytest.raises(InputError, match=r"exponent: 2 given"):
        solve_impact(problem, simultaneous="propagate", exponent=2)
    rough = ImpactProblem(np.eye(6), [[0, 0, -1.0], [0, 0, -1.0]], 0.5, 0.5)
    with pytest.raises(InputError, match='"reflect" supports zero friction only'):
        solve_impact(rough, simultaneous="reflect")


def test_unstoppable_approach_raises():
    w = np.zeros((6, 6))
    w[2, 2] = 1.0
    with pytest.raises(pinimpact.UnstoppableApproachError, match="contact"):
        solve_impact(ImpactProblem(w, [[0, 0, -1.0], [0, 0, -2.0]], 0.0, 0.5, "energetic"))


def test_unstoppable_approach_raises_after_inconclusive_steps():
    # contact 0 cannot be stopped; integration by steps leaves half of its approach velocity
    rows = np.array([[-2, 1], [0, -2], [-1, 1], [0, -1], [-1, -2], [1, 1]], dtype=float)
    start = [[0.0, 2.0, -1.0], [0.0, 0.0, 0.0]]
    with pytest.raises(pinimpact.UnstoppableApproachError, match="contact 0"):
        solve_impact(ImpactProblem(rows @ rows.T, start, [0.8, 0.3], 0.0, "energetic"))


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("restitution", [0.6, 0.01])
@pytest.mark.parametrize("seed", [3, 11, 22])
def test_integration_by_steps_agrees_with_series_of_events(monkeypatch, seed, restitution, exponent):
    # two integrations of the same model
    jacobian, inverse, u, mu, _ = random_robot(seed)
    options = {"friction": mu, "restitution": restitution, "simultaneous": "propagate", "exponent": exponent}
    by_events, _ = collide(jacobian, inverse, u, **options)
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_STEPS", 0)
    by_steps, after = collide(jacobian, inverse, u, **options)
    assert "integrated by adaptive steps" in by_steps.notes[-1]
    # a step has an error of up to 1e-11, which changes of stiffness and small restitution amplify
    largest = np.abs(jacobian @ u).max()
    assert by_steps.velocity == pytest.approx(by_events.velocity, abs=2e-8 * largest)
    mass = np.linalg.inv(inverse)
    gained = 0.5 * (after @ mass @ after - u @ mass @ u)
    assert by_steps.work.total.sum() == pytest.approx(gained, rel=1e-6)


@numba.njit
def call_minimize(rows, restitution, x, part, y, v):
    """Call `minimize`, equation (14.10), for one frictionless stiff contact fully loaded at x (1,)."""
    none = np.zeros(1)
    springs, stiff = Springs(x, x, restitution, np.ones(1), 1.0), np.ones(1, dtype=np.bool_)
    return minimize(rows, none, 1e-9, springs, stiff, x, part, none, y, v)


def test_stage_of_stiff_contact_agrees_with_closed_form():
    # closed form: the contact unloads from x by d = part * v / e^2, and y = part * (x - d)
    rng, rows = np.random.default_rng(0), np.array([[0.0], [0.0], [1.0]])
    for _ in range(100):
        e, x = np.array([10.0 ** rng.uniform(-6.0, -4.0)]), rng.uniform(0.5, 1.5, 1)
        part, d = e[0] * 10.0 ** rng.uniform(-1.0, 1.0), rng.uniform(0.0, 1.0) * x[0]
        speed, y = d * e[0] ** 2 / part, np.zeros(1)
        v = np.array([0.0, 0.0, speed - part * (x[0] - d)])
        assert call_minimize(rows, e, x, part, y, v)
        assert v[2] == pytest.approx(speed, abs=1e-9)


@pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
@pytest.mark.parametrize("seed", [11, 23, 44])
def test_noted_error_of_extrapolation_to_zero_restitution(monkeypatch, seed):
    # with few steps allowed, e = 0 is extrapolated from three coefficients, the minimum for an error estimate
    jacobian, inverse, u, mu, _ = random_robot(seed)
    options = {"friction": mu, "restitution": 0.0, "simultaneous": "propagate"}
    by_events, _ = collide(jacobian, inverse, u, **options)
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_STEPS", 0)
    monkeypatch.setattr("pinimpact.contact_space.waves.SPENT", 0)
    by_steps, _ = collide(jacobian, inverse, u, **options)
    noted = float(re.search(r"to about (\S+) of the largest", by_steps.notes[-1])[1])
    missed = np.abs(by_steps.velocity - by_events.velocity).max() / np.abs(jacobian @ u).max()
    assert missed <= 1.05 * noted <= 1e-4  # two digits are noted


@pytest.mark.parametrize(("restitution", "most"), [(0.5, 200), (0.0, 400)])
def test_fewer_steps_than_required_reduce_noted_accuracy(monkeypatch, restitution, most):
    jacobian, inverse, u, mu, _ = random_robot(11)
    options = {"friction": mu, "restitution": restitution, "simultaneous": "propagate"}
    by_events, _ = collide(jacobian, inverse, u, **options)
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_STEPS", 0)
    usual, _ = collide(jacobian, inverse, u, **options)
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_SHORT_STEPS", most)
    with pytest.warns(pinimpact.BoundReachedWarning, match="integrated by adaptive steps"):
        fewer, _ = collide(jacobian, inverse, u, **options)
    noted = float(re.search(r"to about (\S+) of the largest", fewer.notes[-1])[1])
    largest = np.abs(jacobian @ u).max()
    missed = np.abs(fewer.velocity - by_events.velocity).max() / largest
    assert missed <= noted <= 1e-3
    assert missed > np.abs(usual.velocity - by_events.velocity).max() / largest


@pytest.mark.parametrize("seed", [13, 27, 28, 50])
def test_contacts_locked_by_friction_come_to_rest(monkeypatch, seed):
    # forces within the friction cones can balance each other; the number of steps stays bounded
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_STEPS", 0)
    rng = np.random.default_rng(seed)
    jacobian, u = rng.normal(size=(12, 3)), rng.normal(size=3)
    friction, restitution = rng.uniform(0.3, 1.0, 4), rng.uniform(0.05, 0.9, 4)
    solution, after = collide(jacobian, np.eye(3), u, friction=friction, restitution=restitution)
    assert np.abs(after).max() < 1e-7 * np.abs(u).max()
    assert np.abs(solution.velocity).max() < 1e-7 * np.abs(jacobian @ u).max()
    assert solution.flags & pinimpact.Flag.BOUND_REACHED == 0
    assert np.abs(solution.impulse).max() < 10.0 * np.abs(u).max()
    assert solution.iterations < 20_000


@pytest.mark.parametrize("friction", [100.0, 1e3, 1e6])
def test_body_locked_at_three_contacts_stays_locked_under_rounding(friction):
    # six tangential rows of six coordinates: where all contacts stick the body rests, and the forces, which
    # then cancel except for rounding, never end it; rounding used to release up to half of these bodies
    rng = np.random.default_rng(6)
    root, jacobian = rng.standard_normal((6, 6)), rng.standard_normal((9, 6))
    inverse = root @ root.T / 6 + 0.3 * np.eye(6)
    u = np.array([1.99789532, -0.87427993, -1.79947726, -0.6440844, -1.45943176, 0.44296142])
    w, v = jacobian @ inverse @ jacobian.T, (jacobian @ u).reshape(3, 3)
    assert np.linalg.matrix_rank(w.reshape(3, 3, 3, 3)[:, :2, :, :2].reshape(6, 6)) == 6
    stiffness = (0.90319706, 28.29083228, 12.2310016)
    for seed in range(40):
        scales = 1.0 + 1e-14 * np.random.default_rng(seed).uniform(-1.0, 1.0, 9)
        problem = ImpactProblem(
            scales[:, None] * w * scales,
            scales.reshape(3, 3) * v,
            friction,
            0.5,
            "energetic",
            stiffness=stiffness,
        )
        solution = solve_impact(problem)
        assert np.abs(solution.velocity).max() < 1e-7 * np.abs(v).max(), seed
        assert solution.work.total.sum() == pytest.approx(0.5 * np.sum(v * solution.impulse), rel=1e-6)


@pytest.mark.parametrize("restitution", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("slope", [1.0, 1.3])
def test_ball_that_falls_into_a_rough_wedge_stays(slope, restitution):
    # μ exceeds the tangent of half the angle between the walls, so that friction balances normal forces; no
    # force acts along the wedge, whose rows contain nothing but rounding errors
    rows = []
    for side in (1.0, -1.0):
        normal = np.array([0.0, side * math.sin(slope), math.cos(slope)])
        along = np.array([1.0, 0.0, 0.0])
        for axis in (along, np.cross(normal, along), normal):
            rows.append([*axis, *np.cross(-normal, axis)])
    inverse = np.diag([1.0, 1.0, 1.0, 2.5, 2.5, 2.5])  # a ball of 1 kg and 1 m
    u = np.array([0.0, 0.0, -2.0, 0.0, 0.0, 0.0])
    solution, after = collide(np.array(rows), inverse, u, friction=1.0, restitution=restitution)
    assert np.abs(after).max() < 1e-12
    assert not solution.notes


@pytest.mark.parametrize(
    ("seed", "friction"),
    [(30, 0.0), (133, 0.0), (161, 0.0), (14, 0.4), (41, 0.4), (45, 0.4), (51, 0.4)],
)
def test_zero_restitution_is_limit_of_small_restitution(seed, friction):
    # at some corner the force decreases to less than half of its peak; errors are 1e-2 if it is kept constant
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(int(rng.integers(3, 6)), 3))
    rows = []
    for x, y, _ in corners:
        rows += [[1, 0, 0, 0, -1, -y], [0, 1, 0, 1, 0, x], [0, 0, 1, y, -x, 0]]
    jacobian, inverse = np.array(rows, dtype=float), np.diag(1.0 / rng.uniform(0.3, 2, 6))
    u = rng.normal(size=6)
    u *= np.sign(-(jacobian @ u)[2::3].min())
    none, more, less = (
        collide(jacobian, inverse, u, friction=friction, restitution=e, simultaneous="propagate")[1]
        for e in (0.0, 2e-3, 1e-3)
    )
    # relative to the largest velocity; extrapolation leaves terms in e²
    assert none == pytest.approx(2.0 * less - more, abs=1e-5 * np.abs(u).max())


def impact_on_standing_body(seed):
    """Return W, v and μ of a body that stands on its corners and is struck by another one (last contact)."""
    rng = np.random.default_rng(seed)
    bodies, corners = int(rng.integers(1, 3)), int(rng.integers(2, 5))
    assert bodies == 2

    def rows(arm):
        return np.hstack([np.eye(3), -pin.skew(arm)])

    jacobian = np.zeros((3 * corners + 3, 12))
    for j in range(corners):
        jacobian[3 * j : 3 * j + 3, :6] = rows(rng.normal(size=3) * (0.3, 0.3, 0.0) - (0.0, 0.0, 0.2))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    jacobian[-3:, :6] = -axes @ rows(0.2 * rng.normal(size=3))
    jacobian[-3:, 6:] = axes @ rows(0.2 * rng.normal(size=3))
    masses = rng.uniform(0.3, 2.0, 2)
    mass = np.concatenate([[m, m, m, *(m * rng.uniform(0.01, 0.05, 3))] for m in masses])
    u = rng.normal(size=12)
    u[:6] = 0.0
    velocity = (jacobian @ u).reshape(-1, 3)
    rng.normal(size=(corners, 3))
    return (
        (jacobian / mass) @ jacobian.T,
        -np.sign(velocity[-1, 2]) * velocity,
        rng.choice([0.2, 0.5, 0.8, 1.2]),
    )


@pytest.mark.parametrize("seed", [2746, 4547, 4897])
def test_friction_distribution_does_not_depend_on_rounding(seed):
    """Sticking forces at the corners are not unique, and must not depend on velocities of 1e-16 m/s."""
    delassus, velocity, friction = impact_on_standing_body(seed)
    after = []
    for noise in (None, 1, 2, 3):
        nearly = velocity.copy()
        if noise is not None:
            nearly[:-1] = 1e-16 * np.random.default_rng(noise).normal(size=nearly[:-1].shape)
        problem = ImpactProblem(delassus, nearly, friction, 0.0, law="energetic")
        after.append(solve_impact(problem).velocity)
    for one in after[1:]:
        assert one == pytest.approx(after[0], abs=1e-7 * np.abs(velocity).max())


def test_zero_restitution_is_limit_after_hundreds_of_events():
    # four corners rattle 600 times, then two of them separate; a plastic impact would stop all of them
    rows = []
    for x, y in ((0.152, 0.084), (0.152, -0.084), (-0.185, 0.084), (-0.185, -0.084)):
        rows += [[1, 0, 0, 0, -0.047, -y], [0, 1, 0, 0.047, 0, x], [0, 0, 1, y, -x, 0]]
    inverse = np.diag([1, 1, 1, 1 / 0.00307, 1 / 0.01021, 1 / 0.01183])
    u = np.array([0.43, 0, -1, -1.979, -1.546, 0])
    none, more, less = (
        collide(np.array(rows), inverse, u, friction=0.582, restitution=e)[0].velocity
        for e in (0.0, 2e-3, 1e-3)
    )
    assert none == pytest.approx(2.0 * less - more, abs=1e-3)  # extrapolation leaves terms in e²
    assert none[:, 2].max() > 0.02


@pytest.mark.parametrize("e", [0.0, 0.2])
@pytest.mark.parametrize("tilting", [0.0, 1e-13, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-2])
def test_near_jump_is_flagged_if_contacts_reach_peak_compression_together(e, tilting):
    # a body on four corners, higher at one end. Of the two corners at the lower end, the first one at peak
    # compression separates first if it separates before the other one reaches its peak, a time of order e.
    rows = np.zeros((12, 3))
    rows[2::3] = [(1, 0.13, -0.176), (1, -0.13, -0.176), (1, 0.13, 0.164), (1, -0.13, 0.164)]
    inverse, flagged = np.diag([1, 1 / 0.007, 1 / 0.011]), e == 0.0 and tilting < 1e-3
    one, near, mirrored = (
        collide(rows, inverse, np.array([-1.0, rate, 0.0]), restitution=e)[0]
        for rate in (tilting, tilting + 1e-7, -tilting - 1e-7)
    )
    assert (pinimpact.Flag.NEAR_JUMP in one.flags) == flagged
    apart = max(np.abs(other.velocity - one.velocity).max() for other in (near, mirrored))
    if flagged:
        assert apart > 1e-3
    else:  # the mirrored solution differs as its data do
        assert np.abs(near.velocity - one.velocity).max() < 1e-6
        assert one.velocity[[1, 0, 3, 2]] == pytest.approx(mirrored.velocity, abs=1e-6)


def test_flat_landing_of_cube_agrees_with_planar_body():
    # sticking forces at four corners are not unique; a planar body with two corners is equivalent
    half = 0.05
    rows = []
    for x, y in ((-half, -half), (-half, half), (half, -half), (half, half)):
        rows += [[1, 0, 0, 0, -half, -y], [0, 1, 0, half, 0, x], [0, 0, 1, y, -x, 0]]
    inverse = np.diag([1.0, 1.0, 1.0, 600.0, 600.0, 600.0])
    start = np.array([0.5, 0.0, -1.0, 0.0, 0.0, 0.0])
    _, cube = collide(np.array(rows, dtype=float), inverse, start, friction=0.5, restitution=0.5)
    twin = planar_body([(-half, -half), (half, -half)], 1.0, 1 / 600)
    _, planar = collide(*twin, start[[0, 2, 4]], friction=0.5, restitution=0.5)
    assert cube[[0, 2]] == pytest.approx(planar[:2], abs=1e-6)
    assert cube[4] == pytest.approx(-planar[2], abs=2e-5)  # 1e-6 of 1 m/s, 5 cm from the centre
    assert cube[[1, 3, 5]] == pytest.approx(0.0, abs=2e-5)
    assert cube[[0, 2, 4]] == pytest.approx((0.0063, 0.5509, -0.8746), abs=5e-5)  # by an independent program


def test_stoppable_approach_beside_weakly_coupled_contacts_at_rest():
    """A foot with e > 0 lands beside two weakly coupled feet at rest with e = 0."""
    delassus = np.array(
        [
            [18.82, 1.787, 14.241, 0.02, 0.024, 0.008, 0.014, -0.012, 0.033],
            [1.787, 18.238, -2.399, 0.079, 0.186, 0.01, 0.037, 0.287, -0.16],
            [14.241, -2.399, 40.042, 0.007, -0.004, 0.005, -0.006, 0.038, -0.037],
            [0.02, 0.079, 0.007, 46.327, -2.7, -3.091, 0.005, -0.015, 0.041],
            [0.024, 0.186, -0.004, -2.7, 38.456, -6.455, -0.001, -0.07, 0.123],
            [0.008, 0.01, 0.005, -3.091, -6.455, 13.131, 0.004, -0.031, 0.029],
            [0.014, 0.037, -0.006, 0.005, -0.001, 0.004, 25.128, -7.016, -15.432],
            [-0.012, 0.287, 0.038, -0.015, -0.07, -0.031, -7.016, 28.814, 6.505],
            [0.033, -0.16, -0.037, 0.041, 0.123, 0.029, -15.432, 6.505, 28.429],
        ]
    )
    velocity = np.zeros((3, 3))
    velocity[0] = [-0.016, 0.0185, -0.0523]
    problem = ImpactProblem(delassus, velocity, np.full(3, 1.2), np.array([0.6, 0.0, 0.0]), law="energetic")
    solution = solve_impact(problem)
    assert solution.velocity[:, 2].min() > -1e-9
    found = velocity.ravel() + delassus @ solution.impulse.ravel()
    assert solution.velocity.ravel() == pytest.approx(found, abs=1e-9)
    assert solution.work.total.sum() < 0.0


def test_extra_kernels_are_compiled_although_policy_is_compiled(monkeypatch):
    compiled = []
    monkeypatch.setattr(simultaneous, "_compiled", set())
    monkeypatch.setattr(jit, "compile_all", lambda *calls: compiled.extend(kernel for (kernel,) in calls))
    simultaneous.compile_policy("propagate")
    assert compiled
    assert half_solve not in compiled
    simultaneous.compile_policy("propagate", half_solve)
    assert half_solve in compiled
    compiled.clear()
    simultaneous.compile_policy("propagate", half_solve)
    assert not compiled


def test_noted_accuracy_includes_projection_onto_friction_cones():
    # impulses extrapolated to e = 0 are outside their cones; after projection an approach velocity remains
    rng = np.random.default_rng(8269)
    rows = int(rng.integers(2, 4))
    jacobian, u, mu = rng.normal(size=(12, rows)), rng.normal(size=rows), rng.uniform(0.3, 1.0, 4)
    problem = ImpactProblem(jacobian @ jacobian.T, (jacobian @ u).reshape(-1, 3), mu, 0.0, "energetic")
    solution = _propagate_in_steps(many_inputs(problem), 1.0, False, BY_STEPS)
    noted = float(solution.notes[-1].split("about ")[1].split()[0])
    approach = -solution.velocity[:, 2].min()
    assert 1e-5 < approach <= 1.05 * noted * np.abs(jacobian @ u).max()  # two digits are noted


def rocking_foot(seed):
    """Return W and v of three corners of a foot and a joint stop, and slip that no motion of the foot has."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((12, 7))
    for i, (x, y, z) in enumerate([(0.1, 0.05, -0.1), (0.1, -0.05, -0.1), (-0.1, 0.03, -0.1)]):
        turns = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        rows[3 * i : 3 * i + 3, :6] = np.hstack([np.eye(3), turns])
    rows[11, 6] = 1.0
    root = np.diag([1, 1, 1, 0.1, 0.1, 0.1, 0.1]) + rng.normal(size=(7, 7)) * 0.03
    w = rows @ np.linalg.inv(root @ root.T) @ rows.T
    # the foot rotates about two corners towards the third
    velocity = rows @ np.linalg.svd(np.vstack([rows[:6], rows[11]]))[2][-1]
    velocity *= -np.sign(velocity[8]) / np.abs(velocity).max()
    left = np.linalg.svd(rows[:9, :6])[0][:, 6:]
    noise = np.r_[left @ (left.T @ rng.normal(size=9)), np.zeros(3)]
    noise[2::3] = 0.0
    return 0.5 * (w + w.T), velocity, noise


@pytest.mark.parametrize("seed", [3, 84])
def test_rounding_noise_in_uncontrollable_slip_is_ignored(seed):
    # rounding errors of corner velocities, 1e-11, may be incompatible with any motion of the foot
    w, velocity, noise = rocking_foot(seed)
    mu, e = np.array([0.4, 0.4, 0.4, 0.0]), np.array([0.9, 0.9, 0.9, 0.0])
    known, noisy = (
        solve_impact(ImpactProblem(w, v.reshape(4, 3), mu, e, "energetic", stiffness=np.ones(4)))
        for v in (velocity, velocity + 1e-11 * noise)
    )
    assert not noisy.notes
    assert np.abs(noisy.velocity - known.velocity).max() < 1e-9
