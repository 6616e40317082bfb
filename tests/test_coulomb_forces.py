"""Contact forces: solutions of the kernels against Coulomb's law and enumeration in NumPy."""

from __future__ import annotations

import itertools

import numba
import numpy as np
import pytest
from scipy.optimize import brentq

from pinimpact._numeric.augmented_lagrangian import fill_compliances
from pinimpact._numeric.augmented_newton import continue_to, coulomb_law, evaluate
from pinimpact._numeric.coulomb_problem import CoulombProblem, in_velocities, solve_coulomb
from pinimpact.scene._kernels import contact_forces
from pinimpact.scene._kernels.acting_forces import find_forces, jammed_contact


@numba.njit
def solve(delassus, free, velocity, mu, held, lower, upper, x):
    """Call `solve_coulomb`, which has no Python wrapper."""
    law = coulomb_law(mu, velocity, held, lower, upper)
    return solve_coulomb(CoulombProblem(delassus, free, law), x)


def contacts_at_rest(seed, contacts, velocities):
    """Return the Delassus matrix, free accelerations and μ of random contacts and one bounded row.

    The matrix is singular if `velocities` is less than the number of rows.
    """
    rng = np.random.default_rng(seed)
    rows = 3 * contacts + 1
    jacobian = rng.normal(size=(rows, velocities))
    factor = rng.normal(size=(velocities, velocities))
    inverse = factor @ factor.T / velocities + 0.1 * np.eye(velocities)
    delassus = jacobian @ inverse @ jacobian.T
    return delassus, jacobian @ rng.normal(size=velocities), rng.uniform(0.1, 0.8, size=contacts)


@pytest.mark.parametrize("velocities", [6, 20])
@pytest.mark.parametrize("contacts", [1, 2, 4])
@pytest.mark.parametrize("seed", range(10))
def test_forces_at_rest_satisfy_coulombs_law_in_accelerations(seed, contacts, velocities):
    delassus, free, mu = contacts_at_rest(seed, contacts, velocities)
    bound = 0.3
    x, accuracy = forces_at_rest(delassus, free, mu, np.array([bound]))
    assert accuracy <= 1e-10
    a = delassus @ x + free
    near = 1e-8 * (1.0 + np.abs(x).max() + np.abs(a).max())
    for i in range(contacts):
        tangent, normal = x[3 * i : 3 * i + 2], x[3 * i + 2]
        slip, rise = a[3 * i : 3 * i + 2], a[3 * i + 2]
        assert normal >= -near
        assert rise >= -near
        assert abs(normal * rise) <= near
        assert np.linalg.norm(tangent) <= mu[i] * normal + near
        # maximum friction opposes incipient slip
        assert tangent @ slip == pytest.approx(-mu[i] * normal * np.linalg.norm(slip), abs=near)
    assert abs(x[-1]) <= bound + near
    assert x[-1] * a[-1] == pytest.approx(-bound * abs(a[-1]), abs=near)


def forces_at_rest(delassus, free, mu, bounds=np.zeros(0)):  # noqa: B008
    """Solve for contacts that are all at rest; return the forces and the residual."""
    contacts = len(mu)
    x = np.zeros(3 * contacts + len(bounds))
    still, bilateral = np.zeros((contacts, 2)), np.zeros(contacts, dtype=np.bool_)
    accuracy = solve(delassus, free, still, mu, bilateral, -bounds, bounds, x)
    return x, accuracy


@pytest.mark.parametrize("seed", range(10))
def test_held_contact_can_be_eliminated(seed):
    delassus, free, mu = contacts_at_rest(seed, 3, 20)
    delassus, free = delassus[:9, :9], free[:9]
    x, none, held = np.zeros(9), np.zeros(0), np.array([False, False, True])
    assert solve(delassus, free, np.zeros((3, 2)), mu, held, none, none, x) <= 1e-10
    share = np.linalg.solve(
        delassus[6:, 6:], delassus[6:, :6]
    )  # forces of the held contact per unit force of the others, negated
    reduced = delassus[:6, :6] - delassus[:6, 6:] @ share
    others, accuracy = forces_at_rest(reduced, free[:6] - share.T @ free[6:], mu[:2])
    assert accuracy <= 1e-10
    assert x[:6] == pytest.approx(others, abs=1e-8 * np.abs(x).max())
    assert delassus[6:] @ x + free[6:] == pytest.approx(0.0, abs=1e-9 * np.abs(free).max())


def test_forces_are_zero_without_loads():
    delassus, free, mu = contacts_at_rest(1, 2, 9)
    x, none = np.ones(6), np.zeros(0)
    bilateral = np.zeros(2, dtype=np.bool_)
    assert solve(delassus[:6, :6], 0.0 * free[:6], np.zeros((2, 2)), mu, bilateral, none, none, x) == 0.0
    assert not x.any()


@pytest.mark.parametrize("excess", [1e-8, 1e-5])
@pytest.mark.parametrize("seed", range(40))
def test_forces_exist_just_beyond_the_sticking_limit(seed, excess):
    """Forces of incipient slip may be far from sticking forces, near which iterations converge slowly."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(6, 8))
    delassus, mu = jacobian @ jacobian.T, np.array([1.2, 0.9])
    angle = rng.uniform(0.0, 2.0 * np.pi, size=2)
    normal = rng.uniform(0.5, 5.0, size=2)
    share = np.array([1.0 + excess, 0.6])  # fraction of the friction bound
    stick = np.column_stack(
        [share * mu * normal * np.cos(angle), share * mu * normal * np.sin(angle), normal]
    )
    free = -delassus @ stick.ravel()
    x, accuracy = forces_at_rest(delassus, free, mu)
    assert accuracy <= 1e-10
    a = delassus @ x + free
    near = 1e-9 * (np.abs(free).max() + np.abs(x).max())
    for i in range(2):
        tangent, push = x[3 * i : 3 * i + 2], x[3 * i + 2]
        slip, rise = a[3 * i : 3 * i + 2], a[3 * i + 2]
        assert min(push, rise) >= -near
        assert abs(push * rise) <= near
        assert np.linalg.norm(tangent) <= mu[i] * push + near
        assert tangent @ slip == pytest.approx(-mu[i] * push * np.linalg.norm(slip), abs=10.0 * near)


@pytest.mark.parametrize("beyond", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("seed", range(40))
def test_forces_of_contact_sliding_off_a_stretched_arm(seed, beyond):
    """W is singular in a direction u just outside the friction cone, with negative free acceleration along u.

    The forces are large, and the sensitivity of slip to them grows as u approaches the cone.
    """
    rng = np.random.default_rng(seed)
    mu, angle = rng.uniform(0.5, 1.5), rng.uniform(0.0, 2.0 * np.pi)
    slope = (1.0 + beyond) * mu
    u = np.array([slope * np.cos(angle), slope * np.sin(angle), 1.0]) / np.hypot(1.0, slope)
    across = np.linalg.svd(u[None])[2][1:]
    delassus = across.T @ np.diag(rng.uniform(0.1, 1.0, size=2)) @ across
    free = across.T @ rng.normal(size=2)
    free[2] -= 3.0
    free -= u * (u @ free + rng.uniform(0.01, 0.3))
    if free[2] >= 0.0:
        free -= across.T @ (across[:, 2] / (across[:, 2] @ across[:, 2])) * (free[2] + 3.0)
    x, accuracy = forces_at_rest(delassus, free, np.array([mu]))
    assert accuracy <= 1e-10
    a, near = delassus @ x + free, 1e-9 * np.abs(free).max()
    assert abs(a[2]) <= near
    assert x[2] > 0.0
    assert x[:2] == pytest.approx(-mu * x[2] * a[:2] / np.hypot(a[0], a[1]), rel=1e-6, abs=1e-6 * x[2])


@pytest.mark.parametrize("seed", [12, 2407])
def test_forces_when_a_joint_yields_in_the_other_direction(seed):
    """One sticking and one sliding contact with dry joints, for which the convex programs do not converge."""
    rng = np.random.default_rng(seed)
    jacobian, factor = rng.normal(size=(9, 8)), rng.normal(size=(8, 8))
    delassus = jacobian @ (factor @ factor.T / 8.0 + 0.1 * np.eye(8)) @ jacobian.T
    free = jacobian @ rng.normal(size=8) - np.array([0, 0, 1, 0, 0, 1, 0, 0, 0])
    velocity = np.array([[0.0, 0.0], rng.normal(size=2)])
    mu, bound = rng.uniform(0.5, 1.2, size=2), rng.uniform(0.05, 0.5)
    check_forces_satisfy_law(delassus, free, velocity, mu, bound)


@pytest.mark.parametrize("seed", [1344, 4048, 10102, 13088])
def test_forces_at_incipient_slip_of_edge_beside_sliding_contacts(seed):
    """Both ends of an edge have the same acceleration along it.

    Neither sticking nor the direction of slip from the convex programs is a solution.
    """
    rng = np.random.default_rng(seed)
    jacobian, factor = rng.normal(size=(15, 14)), rng.normal(size=(14, 14))
    jacobian[9] = jacobian[6]
    delassus = jacobian @ (factor @ factor.T / 14.0 + 0.1 * np.eye(14)) @ jacobian.T
    free = jacobian @ rng.normal(size=14) - np.array([0, 0, 1] * 4 + [0] * 3)
    velocity = np.vstack([rng.normal(size=(2, 2)), np.zeros((2, 2))])
    mu, bound = rng.uniform(0.5, 1.2, size=4), rng.uniform(0.05, 0.5)
    check_forces_satisfy_law(delassus, free, velocity, mu, bound)


def check_forces_satisfy_law(delassus, free, velocity, mu, bound):
    """Check the forces of contacts (at rest if their velocity is zero, else sliding) and of dry joints."""
    contacts, joints = len(mu), len(free) - 3 * len(mu)
    x, bounds = np.zeros(len(free)), np.full(joints, bound)
    accuracy = solve(delassus, free, velocity, mu, np.zeros(contacts, dtype=bool), -bounds, bounds, x)
    assert accuracy <= 1e-10
    a, near = delassus @ x + free, 1e-9 * np.abs(free).max()
    for i in range(contacts):
        push, lift = x[3 * i + 2], a[3 * i + 2]
        assert push >= -near
        assert lift >= -near
        assert push * lift == pytest.approx(0.0, abs=near * max(push, 1.0))
        slip = velocity[i] if velocity[i].any() else a[3 * i : 3 * i + 2]
        friction = x[3 * i : 3 * i + 2]
        assert np.linalg.norm(friction) <= mu[i] * push * (1 + 1e-9) + near
        if np.linalg.norm(slip) > near:
            assert friction == pytest.approx(-mu[i] * push * slip / np.linalg.norm(slip), abs=1e-7)
    for force, rate in zip(x[3 * contacts :], a[3 * contacts :], strict=True):
        assert abs(force) <= bound * (1 + 1e-9)
        if abs(rate) > near:
            assert force == pytest.approx(-np.copysign(bound, rate))


def solutions_by_enumeration(delassus, free, directions, mu):
    """Return the forces of each active set of sliding contacts that satisfies complementarity."""
    contacts = len(mu)
    pushes = np.zeros((3 * contacts, contacts))
    for i in range(contacts):
        pushes[3 * i : 3 * i + 2, i], pushes[3 * i + 2, i] = -mu[i] * directions[i], 1.0
    normal = (delassus @ pushes)[2::3]
    found = []
    for choice in itertools.product([False, True], repeat=contacts):
        closed = np.flatnonzero(choice)
        push = np.zeros(contacts)
        push[closed] = np.linalg.solve(normal[np.ix_(closed, closed)], -free[2::3][closed])
        rise = normal @ push + free[2::3]
        if push.min() >= 0.0 and rise[~np.array(choice)].min(initial=0.0) >= 0.0:
            found.append(pushes @ push)
    return found


def test_sliding_forces_are_found_whenever_they_exist():
    """With negative normal accelerations (Painlevé) there may be no solution, or several."""
    rng = np.random.default_rng(5)
    counts = []
    for _ in range(300):
        jacobian = rng.normal(size=(9, 12))
        delassus, mu = jacobian @ jacobian.T, rng.uniform(0.5, 2.0, size=3)
        velocity = rng.normal(size=(3, 2))
        free = rng.normal(size=9)
        expected = solutions_by_enumeration(
            delassus, free, velocity / np.linalg.norm(velocity, axis=1)[:, None], mu
        )
        x = np.zeros(9)
        nothing, held = np.zeros(0), np.zeros(3, dtype=np.bool_)
        accuracy = solve(delassus, free, velocity, mu, held, nothing, nothing, x)
        assert (accuracy <= 1e-10) == bool(expected)
        if expected:
            nearest = min(np.abs(x - one).max() for one in expected)
            assert nearest <= 1e-8 * (1.0 + np.abs(x).max())
        counts.append(len(expected))
    assert {0, 1}.issubset(counts)
    assert max(counts) > 1


def sliding_contact_jammed_by_held_joints(seed, joints):
    """Return a problem of a sliding contact that jams if all joints are held by dry friction."""
    rng = np.random.default_rng(seed)
    while True:
        rows = rng.normal(size=(3 + joints, 3 + joints + 2))
        delassus = rows @ rows.T
        free = 10.0 * rng.normal(size=3 + joints)
        free[2] = -abs(free[2])
        mu = rng.uniform(0.3, 3.0)
        push = np.zeros(3 + joints)
        push[0], push[2] = -mu, 1.0
        alone = delassus[2] @ push
        held = delassus[3:, 3:]
        jammed = alone - delassus[2, 3:] @ np.linalg.solve(held, delassus[3:] @ push)
        if alone > 0.1 and jammed < -0.01:
            return delassus, free, mu, push


@pytest.mark.parametrize(
    ("joints", "seeds"), [(1, [102, 109, 114]), (3, [165, 204, 428]), (8, [145, 157, 300]), (12, [55, 332])]
)
def test_contact_jammed_by_held_joints_has_solution_with_yielding_joints(joints, seeds):
    """The gap closes faster without a normal force and opens with a large one, so a solution exists."""
    for seed in [*seeds, *range(10)]:
        delassus, free, mu, push = sliding_contact_jammed_by_held_joints(seed, joints)
        bound = np.random.default_rng(seed).uniform(0.1, 5.0, size=joints)
        x = np.zeros(3 + joints)
        accuracy = solve(
            delassus,
            free,
            np.array([[0.7, 0.0]]),
            np.array([mu]),
            np.zeros(1, dtype=np.bool_),
            -bound,
            bound,
            x,
        )
        assert accuracy <= 1e-10
        a = delassus @ x + free
        near = 1e-8 * (1.0 + np.abs(x).max() + np.abs(a).max())
        assert x[:3] == pytest.approx(push[:3] * x[2], abs=near)
        assert min(x[2], a[2]) >= -near
        assert abs(x[2] * a[2]) <= near
        for force, rate, most in zip(x[3:], a[3:], bound, strict=True):
            assert abs(force) <= most + near
            assert abs(rate) <= near or force == pytest.approx(-np.sign(rate) * most, abs=near)


@numba.njit
def find(delassus, free, slip, mu, held, lower, upper, x, pressed):
    """Call `find_forces`, which has no Python wrapper."""
    problem = CoulombProblem(delassus, free, coulomb_law(mu, slip, held, lower, upper))
    return find_forces(problem, x, pressed, True)


def solution_from(delassus, free, slip, mu, bound, pressed):
    """Return the forces that `find_forces` selects; all joints have the bounds ±bound."""
    nc, x = len(mu), np.zeros(len(free))
    limits = np.full(len(free) - 3 * nc, bound)
    held = np.zeros(nc, dtype=bool)
    assert find(delassus, free, slip, mu, held, -limits, limits, x, np.array(pressed))
    return x


def contact_that_can_separate_or_stick(seed, bound):
    """Return a problem of a contact and a joint whose contact may separate or stick, and both solutions."""
    rng = np.random.default_rng(seed)
    while True:
        jacobian = rng.normal(size=(4, 5)) @ np.diag(rng.uniform(0.2, 2.0, size=5))
        delassus, free = jacobian @ jacobian.T, rng.normal(size=4)
        alone = np.clip(-free[3] / delassus[3, 3], -bound, bound)
        opens = free + delassus[:, 3] * alone
        resting = np.linalg.solve(delassus, -free)
        if abs(resting[3]) > bound:  # the joint yields
            resting[3] = np.sign(resting[3]) * bound
            resting[:3] = np.linalg.solve(delassus[:3, :3], -free[:3] - delassus[:3, 3] * resting[3])
            if (delassus[3] @ resting + free[3]) * resting[3] > 0.0:
                continue
        if opens[2] > 0.01 and 0.01 < np.hypot(*resting[:2]) < 0.9 * resting[2]:
            return delassus, free, alone, resting


def contact_that_can_slip_or_stick(seed, bound):
    """Return a problem in which contact and joint may start to slip or stay at rest, and both solutions."""
    rng = np.random.default_rng(seed)
    while True:
        jacobian = rng.normal(size=(4, 5)) @ np.diag(rng.uniform(0.2, 2.0, size=5))
        delassus, angle, side = jacobian @ jacobian.T, rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
        push = rng.uniform(0.1, 1.0)
        sliding = np.array([-push * np.cos(angle), -push * np.sin(angle), push, -side * bound])
        slip, rate = rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.5)
        a = np.array([slip * np.cos(angle), slip * np.sin(angle), 0.0, side * rate])
        free = a - delassus @ sliding
        resting = np.linalg.solve(delassus, -free)
        if 0.01 < np.hypot(*resting[:2]) < 0.99 * resting[2] and abs(resting[3]) < bound:
            return delassus, free, sliding, resting


def test_loaded_sticking_contact_sticks_if_it_could_also_slip():
    for seed in range(40):
        delassus, free, _, resting = contact_that_can_slip_or_stick(seed, 1.0)
        found = solution_from(delassus, free, np.zeros((1, 2)), np.ones(1), 1.0, [True, False])
        np.testing.assert_allclose(found, resting, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("slides", [0.0, 0.6])
def test_sticking_contact_beside_sliding_contact_separates_if_unstable(slides):
    """One contact sticks (zero acceleration) and one slides (zero normal acceleration).

    If the determinant of these equations is negative, this is unstable, and the sticking contact separates.
    """
    found = 0
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        jacobian = rng.normal(size=(6, 7)) @ np.diag(rng.uniform(0.2, 2.0, size=7))
        delassus, free, mu = jacobian @ jacobian.T, rng.normal(size=6), np.array([1.0, slides])
        friction = np.array([-slides * 0.6, -slides * 0.8, 1.0])
        effects = np.column_stack([delassus[:, :3], delassus[:, 3:] @ friction])
        *resting, push = np.linalg.solve(effects[[0, 1, 2, 5]], -free[[0, 1, 2, 5]])
        alone = -free[5] / effects[5, 3]
        rests = 0.01 < np.hypot(*resting[:2]) < 0.9 * resting[2] and push > 0.01
        opens = alone > 0.01 and (free + effects[:, 3] * alone)[2] > 0.01
        if not (rests and opens):
            continue
        found += 1
        opened = np.array([[0.0, 0.0, 0.0], alone * friction])
        lasts = np.linalg.det(effects[[0, 1, 2, 5]]) > 0.0
        force = solution_from(delassus, free, np.array([[0.0, 0.0], [0.6, 0.8]]), mu, 0.0, [True, True])
        expected = [resting, push * friction] if lasts else opened
        np.testing.assert_allclose(force, np.ravel(expected), rtol=1e-8, atol=1e-8)
    assert found > 0


@pytest.mark.parametrize("bound", [0.1, 10.0])
def test_loaded_contact_stays_active_if_it_could_also_separate(bound):
    for seed in range(40):
        delassus, free, _, resting = contact_that_can_separate_or_stick(seed, bound)
        found = solution_from(delassus, free, np.zeros((1, 2)), np.ones(1), bound, [True, False])
        np.testing.assert_allclose(found, resting, rtol=1e-9, atol=1e-9)


def every_solution(delassus, free, mu, bound):
    """Enumerate the solutions for one contact that slides along t₁ and rows within ±bound.

    Return forces and, for each, whether the determinant of the equations of active and held rows is positive.
    """
    size = len(free)
    found = []
    for closed, *at in itertools.product((False, True), *[(-1, 0, 1)] * (size - 3)):
        system, right = np.eye(size), np.zeros(size)
        if closed:
            system[0, 2] = mu
            system[2], right[2] = delassus[2], -free[2]
        for a, side in enumerate(at, 3):
            if side == 0:
                system[a], right[a] = delassus[a], -free[a]
            else:
                right[a] = side * bound
        x = np.linalg.solve(system, right)
        acceleration = delassus @ x + free
        contact = x[2] >= 0.0 if closed else acceleration[2] >= 0.0
        rows = all(
            abs(x[a]) <= bound if side == 0 else side * acceleration[a] <= 0.0 for a, side in enumerate(at, 3)
        )
        if contact and rows:
            held = [2] * closed + [a for a, side in enumerate(at, 3) if side == 0]
            effects = delassus[:, held] - mu * np.outer(delassus[:, 0], np.equal(held, 2))
            found.append((x, np.linalg.det(effects[held]) > 0.0))
    return found


def problems_with_several_solutions():
    """Yield W, free accelerations, μ, bound and solutions of those of 2,000 problems with several."""
    rng = np.random.default_rng(7)
    for _ in range(2000):
        factor = rng.normal(size=(5, 5))
        delassus, free = factor @ factor.T, 3.0 * rng.normal(size=5)
        mu, bound = rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.0)
        solutions = every_solution(delassus, free, mu, bound)
        if len(solutions) > 1:
            yield delassus, free, mu, bound, solutions


def slipping(delassus, free, mu, bound, x):
    """Return the arguments of `solve` for such a problem."""
    limits = np.full(2, bound)
    return (delassus, free, np.array([[1.0, 0.0]]), np.array([mu]), np.array([False]), -limits, limits, x)


@pytest.mark.parametrize("pressed", [[True, True, True], [True, False, False], [False] * 3])
def test_stable_solution_is_preferred(pressed):
    """Solutions of negative determinant are unstable, and chosen in at most two of these problems."""
    several = lasts = 0
    for delassus, free, mu, bound, solutions in problems_with_several_solutions():
        taken = solution_from(delassus, free, np.array([[1.0, 0.0]]), np.array([mu]), bound, pressed)
        off = [np.abs(taken - x).max() <= 1e-8 * np.abs(taken).max() for x, _ in solutions]
        assert any(off)
        several += 1
        lasts += any(near and positive for near, (_, positive) in zip(off, solutions, strict=True))
    assert several > 50
    assert lasts >= several - 2


def incipient_slip_solutions(delassus, free, mu, bound):
    """Return forces (4,), determinant and stability of all incipient slips of a contact beside a joint.

    A solution is stable if the determinant of the active and held rows is positive in the direction d(θ) of
    slip, and the acceleration perpendicular to d, zero at the solution, decreases with θ.
    """

    def at(angle, side):
        """Return acceleration perpendicular to d, forces, whether the law is satisfied, determinant."""
        c, s = np.cos(angle), np.sin(angle)
        nothing = np.zeros_like(c)
        friction = np.array([-mu * c, -mu * s, nothing + 1.0, nothing])
        slips, turns = delassus @ friction, delassus[:, 3]
        if side == 0:
            determinant = slips[2] * turns[3] - slips[3] * turns[2]
            push = (turns[2] * free[3] - turns[3] * free[2]) / determinant
            joint = (slips[3] * free[2] - slips[2] * free[3]) / determinant
        else:
            determinant, joint = slips[2], nothing + side * bound
            push = -(free[2] + turns[2] * joint) / determinant
        forces = push * friction + joint * np.array([nothing, nothing, nothing, nothing + 1.0])
        a1, a2, _, rate = delassus @ forces + free[:, None]
        obeys = (push > 0.0) & (c * a1 + s * a2 > 0.0) & (np.abs(joint) <= bound) & (side * rate <= 0.0)
        return c * a2 - s * a1, forces, obeys, determinant

    found, angles = [], np.linspace(0.0, 2.0 * np.pi, 721)
    for side in (-1, 0, 1):
        across, _, _, determinants = at(angles, side)
        passes = (np.diff(np.sign(across)) != 0) & (np.diff(np.sign(determinants)) == 0)
        for k in np.flatnonzero(passes):
            angle = brentq(
                lambda angle, side=side: at(np.array([angle]), side)[0][0], *angles[k : k + 2], xtol=1e-14
            )
            _, x, obeys, determinant = at(np.array([angle]), side)
            if obeys[0]:
                found.append((x[:, 0], determinant[0], determinant[0] > 0.0 and across[k] > 0.0))
    return found


@pytest.mark.parametrize("seed", [2, 7, 9, 14])
def test_direction_of_incipient_slip_is_stable(seed):
    """The determinant of all equations may be positive although forces and direction are unstable."""
    rng, begun = np.random.default_rng(seed), 0
    for _ in range(100):
        factor = rng.normal(size=(4, 4))
        delassus, free = factor @ factor.T, 3.0 * rng.normal(size=4)
        mu, bound = rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.0)
        solutions = incipient_slip_solutions(delassus, free, mu, bound)
        x = solution_from(delassus, free, np.zeros((1, 2)), np.array([mu]), bound, [False, False])
        taken = [lasts for one, _, lasts in solutions if np.abs(one - x).max() <= 1e-6 * np.abs(x).max()]
        assert all(taken)
        begun += len(taken)
    assert begun > 10


def joint_that_can_move_or_stay_held(seed, bound):
    """Return a problem of a sliding contact and a joint that may move or stay held, and both solutions."""
    rng = np.random.default_rng(seed)
    while True:
        jacobian = rng.normal(size=(4, 5)) @ np.diag(rng.uniform(0.2, 2.0, size=5))
        delassus, mu, push, side = jacobian @ jacobian.T, rng.uniform(0.5, 3.0), 1.0, rng.choice([-1.0, 1.0])
        friction = np.array([-0.6 * mu, -0.8 * mu, 1.0])
        effects = np.column_stack([delassus[:, :3] @ friction, delassus[:, 3]])
        free = rng.normal(size=4)
        free[2:] = np.array([0.0, side * rng.uniform(0.01, 1.0)]) - effects[2:] @ [push, -side * bound]
        resting = np.linalg.solve(effects[2:], -free[2:])
        lasts = np.linalg.det(effects[2:]) > 0.0
        if lasts and resting[0] > 0.01 and abs(resting[1]) < 0.99 * bound:
            return delassus, free, mu, push * friction, -side * bound, resting[0] * friction, resting[1]


def test_held_joint_beside_sliding_contact_stays_held_if_it_could_also_move():
    for seed in range(40):
        delassus, free, mu, _, _, force, strength = joint_that_can_move_or_stay_held(seed, 1.0)
        found = solution_from(delassus, free, np.array([[0.6, 0.8]]), np.array([mu]), 1.0, [True, True])
        np.testing.assert_allclose(found, [*force, strength], rtol=1e-8)


@numba.njit
def call_jammed_contact(delassus, free, slip, mu, held, x):
    """Call `jammed_contact`, which has no Python wrapper."""
    none = np.zeros(0)
    return jammed_contact(CoulombProblem(delassus, free, coulomb_law(mu, slip, held, none, none)), x)


def test_painleve_contact_is_detected_unless_other_forces_prevent_penetration():
    """If c − μ b·s < 0 and the gap accelerates downwards, the contact jams unless another force lifts it."""
    delassus = np.array([[4.0, 0.0, 1.9], [0.0, 4.0, 0.0], [1.9, 0.0, 1.0]])
    free, mu, held = np.array([0.0, 0.0, -1.0]), np.array([0.8]), np.array([False])
    for direction, expected in ((1.0, 0), (-1.0, -1), (0.0, -1)):
        assert (
            call_jammed_contact(delassus, free, np.array([[direction, 0.0]]), mu, held, np.zeros(3))
            == expected
        )
    lifted = np.block([[delassus, np.array([[0.0], [0.0], [2.0]])], [np.array([0.0, 0.0, 2.0, 5.0])]])
    more = np.append(free, 0.0)
    for push, expected in ((0.4, 0), (0.6, -1)):
        forces = np.array([0.0, 0.0, 0.0, push])
        assert call_jammed_contact(lifted, more, np.array([[1.0, 0.0]]), mu, held, forces) == expected


@numba.njit
def may_grow(effective):
    """Call `contact_forces.may_grow`, which has no Python wrapper."""
    return contact_forces.may_grow(effective)


@pytest.mark.parametrize("rank", [1, 2, 3, 4])
def test_may_grow_is_the_sign_of_sums_of_principal_minors(rank):
    """Compare with the characteristic polynomial by NumPy, also for rank three with four contacts."""
    rng, found = np.random.default_rng(rank), set()
    for _ in range(400):
        size = max(rank, 2)
        left, right = rng.normal(size=(2, size + (rank == 3), rank))
        effective = left @ (left + rng.uniform(0.0, 3.0) * right).T
        effective /= np.abs(effective).max()
        sums = np.array([sum_of_minors(effective, k) for k in range(1, rank + 1)])
        if np.abs(sums).min() < 1e-6:
            continue
        assert may_grow(effective) == (sums < 0.0).any()
        eigenvalues = np.linalg.eigvals(effective)
        real = eigenvalues.real[np.abs(eigenvalues.imag) < 1e-12]
        assert may_grow(effective) or real.min(initial=0.0) > -1e-9
        found.add(may_grow(effective))
    assert found == {True, False}


def sum_of_minors(matrix, order):
    """Return the sum of all principal minors of the given order."""
    chosen = itertools.combinations(range(len(matrix)), order)
    return sum(np.linalg.det(matrix[np.ix_(rows, rows)]) for rows in chosen)


@pytest.mark.parametrize("start", [np.nan, np.inf, 1e200])
def test_useless_initial_guess_does_not_change_the_solution(start):
    """Diverging projected Gauss–Seidel iterations leave NaN and infinities."""
    delassus, free, mu = contacts_at_rest(3, 2, 6)
    delassus, free = np.ascontiguousarray(delassus[:6, :6]), free[:6].copy()  # without the bounded row
    held, nothing, velocity = np.zeros(2, dtype=np.bool_), np.zeros(0), np.zeros((2, 2))
    found, expected = np.full(6, start), np.zeros(6)
    assert solve(delassus, free, velocity, mu, held, nothing, nothing, found) <= 1e-10
    assert solve(delassus, free, velocity, mu, held, nothing, nothing, expected) <= 1e-10
    assert np.abs(expected).max() > 0.0
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


@numba.njit
def velocities_for(delassus, free, slip, mu, lower, upper, w, part):
    """Return compliances r, J in velocities, and the w that `continue_to` finds for `part` r."""
    none = np.zeros(len(mu), dtype=np.bool_)
    problem = CoulombProblem(delassus, free, coulomb_law(mu, slip, none, lower, upper))
    velocities, profile, now, system = in_velocities(problem, np.ones(len(mu)))
    r = np.empty(len(free))
    fill_compliances(velocities, 0.1, np.empty(len(free)), r)
    before = r.copy()
    now.w[:] = w
    evaluate(velocities, r, np.zeros(len(free)), now)
    continue_to(velocities, profile, r, part, now, system)
    return before, velocities.values, now.w


def test_solutions_for_two_compliances_with_one_active_set_follow_from_each_other():
    """Two contacts stick, one slips in a given direction, one is open; of two rows one is at its bound."""
    rng = np.random.default_rng(4)
    slip, mu = np.zeros((4, 2)), np.array([1e3, 1e3, 0.2, 0.5])
    slip[2] = 0.6, 0.8
    jacobian = rng.normal(size=(14, 9))
    delassus, free = jacobian @ jacobian.T, 0.1 * rng.normal(size=14)
    free[[2, 5, 8]], free[11] = -30.0, 300.0
    free[12:] = 1.0, 100.0
    lower, upper = np.array([-1e3, -0.1]), np.array([1e3, 0.1])
    r, rows, _ = velocities_for(delassus, free, slip, mu, lower, upper, np.zeros(9), 0.5)

    def solution(r):
        """Return w of w = Jᵀ f with f = c − A (u_free + J w)/r in the active set."""
        slopes, constant = np.zeros((14, 14)), np.zeros(14)
        for k in (*range(6), 12):
            slopes[k, k] = 1.0
        slopes[6:9, 8] = -0.2 * 0.6, -0.2 * 0.8, 1.0
        constant[13] = -0.1
        stiff = rows.T @ (slopes / r)
        w = np.linalg.solve(np.eye(9) + stiff @ rows, rows.T @ constant - stiff @ free)
        z = -(free + rows @ w) / r
        assert z[[2, 5, 8]].min() > 0.0 > z[11]
        assert -1e3 < z[12] < 1e3
        assert z[13] < -0.1
        return w

    found = velocities_for(delassus, free, slip, mu, lower, upper, solution(r), 1e-3)[2]
    assert found == pytest.approx(solution(1e-3 * r), rel=1e-9, abs=1e-9)
    assert np.abs(found - solution(r)).max() > 0.1
