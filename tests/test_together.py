"""Policy "together" for a cube that lands on several corners: Coulomb's law, symmetry, Pinocchio's solver."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import ImpactProblem, solve_impact

SIDE, MASS = 0.1, 1.0


def landing(seed, corners):
    """Return W (3n, 3n), velocities (n, 3) and μ of a cube that lands on two or four corners."""
    rng = np.random.default_rng(seed)
    angle, half = rng.uniform(0.05, 1.5), SIDE / 2
    if corners == 2:
        x, z = np.sqrt(2) * half * np.array([np.sin(angle - np.pi / 4), -np.cos(angle - np.pi / 4)])
        points = [(x, s * half, z) for s in (-1, 1)]
    else:
        points = [(s * half, t * half, -half) for s in (-1, 1) for t in (-1, 1)]
    jacobian = np.vstack([np.hstack([np.eye(3), -pin.skew(np.array(point))]) for point in points])
    inverse = np.diag([1 / MASS] * 3 + [6 / (MASS * SIDE**2)] * 3)
    twist = np.r_[rng.normal(size=2), -1.0 + 0.3 * rng.normal(), 5.0 * rng.normal(size=3)]
    return jacobian @ inverse @ jacobian.T, (jacobian @ twist).reshape(-1, 3), rng.uniform(0.05, 1.2)


def together(w, v, mu, e=0.0, **numbers):
    return solve_impact(ImpactProblem(w, v, mu, e, "poisson", **numbers), simultaneous="together")


def obeys_coulomb(impulse, velocity, mu, least, near):
    """Check Coulomb's law within `near`, for normal impulses with the lower bounds `least`."""
    slides = np.hypot(*velocity[:, :2].T)
    assert velocity[:, 2].min() >= -near
    assert (impulse[:, 2] - least).min() >= -near
    assert np.abs((impulse[:, 2] - least) * velocity[:, 2]).max() <= near
    assert (np.hypot(*impulse[:, :2].T) - mu * impulse[:, 2]).max() <= near
    power = (impulse[:, :2] * velocity[:, :2]).sum(axis=1)
    assert power == pytest.approx(-mu * impulse[:, 2] * slides, abs=near)


@pytest.mark.parametrize("corners", [2, 4])
@pytest.mark.parametrize("seed", range(100))
def test_landing_cube_obeys_coulombs_law(seed, corners):
    w, v, mu = landing(seed, corners)
    plastic = together(w, v, mu)
    obeys_coulomb(plastic.impulse, plastic.velocity, mu, 0.0, 1e-9)  # of impulses and velocities of order 1
    assert not plastic.notes
    half = together(w, v, mu, 0.5)
    assert not half.notes
    second = half.impulse - plastic.impulse
    obeys_coulomb(second, half.velocity, mu, 0.5 * plastic.impulse[:, 2], 1e-9)


@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("corners", [2, 4])
@pytest.mark.parametrize("seed", range(25))
def test_landing_cube_with_permuted_or_mirrored_corners(seed, corners, e):
    """Velocities are equal to rounding; impulses, which are not unique, to the tolerance of their program."""
    w, v, mu = landing(seed, corners)
    solution = together(w, v, mu, e)
    order = np.roll(np.arange(corners), 1)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    mirror = np.diag([1.0, -1.0, 1.0])
    whole = np.kron(np.eye(corners), mirror)
    for other, expected in (
        (together(np.ascontiguousarray(w[np.ix_(rows, rows)]), v[order], mu, e), lambda x: x[order]),
        (together(whole @ w @ whole, v @ mirror, mu, e), lambda x: x @ mirror),
    ):
        assert other.velocity == pytest.approx(expected(solution.velocity), abs=1e-9)
        assert other.impulse == pytest.approx(expected(solution.impulse), abs=1e-6)


@pytest.mark.parametrize("mu", [0.0, 0.7])
def test_level_cube_distributes_load_by_stiffness(mu):
    """The total impulse is m v; the loads are equal, or proportional to k within each diagonal."""
    w, _, _ = landing(0, 4)
    v = np.tile([0.0, 0.0, -1.0], (4, 1))
    equal = together(w, v, mu).impulse
    assert equal == pytest.approx(np.tile([0, 0, MASS / 4], (4, 1)), abs=1e-9)
    # minimum of Σ P²/k with Σ P = m and zero torque: corners 0 and 3 of a diagonal have equal loads, so have
    # 1 and 2; torque does not determine the loads of the diagonals
    unequal = together(w, v, 0.0, stiffness=[1.0, 3.0, 3.0, 1.0]).impulse[:, 2]
    assert unequal == pytest.approx(MASS * np.array([1.0, 3.0, 3.0, 1.0]) / 8, abs=1e-9)


def test_sticking_cube_has_zero_contact_velocities():
    """The impulse −W⁺v of least norm stops both corners; it is in both friction cones for large μ."""
    for seed in range(20):
        w, v, _ = landing(seed, 2)
        stop = -np.linalg.pinv(w) @ v.ravel()
        normal, tangent = stop[2::3], np.hypot(stop[0::3], stop[1::3])
        if normal.min() <= 0.0:
            continue
        solution = together(w, v, 1.1 * (tangent / normal).max())
        assert np.abs(solution.velocity).max() <= 1e-12 * np.abs(v).max() + 1e-13
        # the solution of least norm
        assert solution.impulse.ravel() == pytest.approx(stop, abs=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_plastic_impact_agrees_with_pinocchios_solver(seed):
    """Compare with `ADMMConstraintSolver` on the same W, within its tolerance.

    The load distribution of four coplanar corners is not unique, and friction and motion depend on it; with a
    compliance at each corner the motion is unique.
    """
    w, v, mu = landing(seed, 2 + 2 * (seed % 2))
    w += (seed % 2) * 0.01 * np.trace(w) / len(w) * np.eye(len(w))
    found = pinocchio_impulses(w, v.ravel(), mu)
    assert together(w, v, mu).velocity.ravel() == pytest.approx(v.ravel() + w @ found, abs=1e-8)


def pinocchio_impulses(w, v, mu):
    """Return the impulses (3n,) of Coulomb's law by Pinocchio's solver."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    models, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for _ in range(len(v) // 3):
        contact = pin.PointContactConstraintModel(model, joint)
        contact.setFriction(mu)
        models.append(pin.ConstraintModel(contact))
        datas.append(models[-1].createData())
    settings, result = pin.ADMMSolverSettings(), pin.ADMMSolverResult()
    settings.absolute_feasibility_tol = settings.relative_feasibility_tol = 1e-11
    settings.absolute_complementarity_tol = settings.relative_complementarity_tol = 1e-11
    settings.max_iterations = 20000
    solver = pin.ADMMConstraintSolver()
    assert solver.solve(
        pin.DelassusOperatorDense(np.asfortranarray(w)), v.copy(), models, datas, settings, result
    )
    return result.retrieveConstraintImpulses()


@pytest.mark.parametrize("seed", [2, 31, 241, 524])
def test_nearly_coplanar_corners_obey_coulombs_law(seed):
    rng = np.random.default_rng(seed)
    points = np.array([[x, y, -1.0] for x in (-1, 1) for y in (-1, 1)]) + 1e-6 * rng.normal(size=(4, 3))
    jacobian = np.vstack([np.hstack([np.eye(3), -pin.skew(point)]) for point in points])
    twist = rng.normal(size=6) * [1, 1, 0, 0, 0, 1] - [0, 0, 1, 0, 0, 0]
    w, v = jacobian @ np.diag([1, 1, 1, 1.5, 1.5, 1.5]) @ jacobian.T, (jacobian @ twist).reshape(-1, 3)
    w = 0.5 * (w + w.T)
    plastic, half = together(w, v, 1.0), together(w, v, 1.0, 0.5)
    assert not plastic.notes
    assert not half.notes
    obeys_coulomb(plastic.impulse, plastic.velocity, 1.0, 0.0, 1e-9)
    second = half.impulse - plastic.impulse
    obeys_coulomb(second, half.velocity, 1.0, 0.5 * plastic.impulse[:, 2], 1e-9)
    assert half.velocity.ravel() == pytest.approx(v.ravel() + w @ half.impulse.ravel(), abs=1e-9)
