"""Forces by convex programs against Coulomb's law itself, written down in NumPy."""

from __future__ import annotations

import itertools

import numba
import numpy as np
import pytest
from scipy.optimize import brentq

from pinimpact._numeric.coulomb_problem import solve_coulomb
from pinimpact.scene._kernels import contact_forces
from pinimpact.scene._kernels.acting_forces import find_forces, jammed_contact


@numba.njit
def solve(delassus, free, velocity, mu, held, lower, upper, x):
    """Call the kernel, which only kernels can."""
    return solve_coulomb(delassus, free, velocity, mu, np.zeros(len(mu)), held, lower, upper, x)


def contacts_at_rest(seed, contacts, velocities):
    """A system of contacts and one bounded row, of full or of deficient rank, that loads press together."""
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
def test_forces_obey_coulombs_law_at_the_level_of_accelerations(seed, contacts, velocities):
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
        # friction opposes what begins to slip, with all that it has
        assert tangent @ slip == pytest.approx(-mu[i] * normal * np.linalg.norm(slip), abs=near)
    assert abs(x[-1]) <= bound + near
    assert x[-1] * a[-1] == pytest.approx(-bound * abs(a[-1]), abs=near)


def forces_at_rest(delassus, free, mu, bounds=np.zeros(0)):  # noqa: B008
    """Solve for contacts that are all at rest; return their forces, and how far these are from the law."""
    contacts = len(mu)
    x = np.zeros(3 * contacts + len(bounds))
    still, bilateral = np.zeros((contacts, 2)), np.zeros(contacts, dtype=np.bool_)
    accuracy = solve(delassus, free, still, mu, bilateral, -bounds, bounds, x)
    return x, accuracy


@pytest.mark.parametrize("seed", range(10))
def test_forces_beside_a_contact_without_bounds_are_those_of_what_it_leaves_free(seed):
    delassus, free, mu = contacts_at_rest(seed, 3, 20)
    delassus, free = delassus[:9, :9], free[:9]
    x, none, held = np.zeros(9), np.zeros(0), np.array([False, False, True])
    assert solve(delassus, free, np.zeros((3, 2)), mu, held, none, none, x) <= 1e-10
    share = np.linalg.solve(delassus[6:, 6:], delassus[6:, :6])  # forces of the held contact
    reduced = delassus[:6, :6] - delassus[:6, 6:] @ share
    others, accuracy = forces_at_rest(reduced, free[:6] - share.T @ free[6:], mu[:2])
    assert accuracy <= 1e-10
    assert x[:6] == pytest.approx(others, abs=1e-8 * np.abs(x).max())
    assert delassus[6:] @ x + free[6:] == pytest.approx(0.0, abs=1e-9 * np.abs(free).max())


def test_without_loads_there_are_no_forces():
    delassus, free, mu = contacts_at_rest(1, 2, 9)
    x, none = np.ones(6), np.zeros(0)
    bilateral = np.zeros(2, dtype=np.bool_)
    assert solve(delassus[:6, :6], 0.0 * free[:6], np.zeros((2, 2)), mu, bilateral, none, none, x) == 0.0
    assert not x.any()


@pytest.mark.parametrize("excess", [1e-8, 1e-5])
@pytest.mark.parametrize("seed", range(40))
def test_forces_are_found_where_sticking_has_just_ceased_to_be_possible(seed, excess):
    """Slip that begins may be far from rest there, with iterations that creep past where the solution was."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(6, 8))
    delassus, mu = jacobian @ jacobian.T, np.array([1.2, 0.9])
    angle = rng.uniform(0.0, 2.0 * np.pi, size=2)
    normal = rng.uniform(0.5, 5.0, size=2)
    share = np.array([1.0 + excess, 0.6])  # of the cone
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
def test_forces_are_found_for_a_contact_that_slides_off_a_stretched_arm(seed, beyond):
    """Nothing moves it along u, just outside its cone, and the motion carries it on: it can but slide off.

    Its forces are large, and the slip that they cause depends on them the more steeply the nearer u is.
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
def test_forces_are_found_where_a_joint_yields_the_other_way(seed):
    """A contact at rest beside one that slips, and dry joints: the convex programs end elsewhere."""
    rng = np.random.default_rng(seed)
    jacobian, factor = rng.normal(size=(9, 8)), rng.normal(size=(8, 8))
    delassus = jacobian @ (factor @ factor.T / 8.0 + 0.1 * np.eye(8)) @ jacobian.T
    free = jacobian @ rng.normal(size=8) - np.array([0, 0, 1, 0, 0, 1, 0, 0, 0])
    velocity = np.array([[0.0, 0.0], rng.normal(size=2)])
    mu, bound = rng.uniform(0.5, 1.2, size=2), rng.uniform(0.05, 0.5)
    forces_obey_the_law(delassus, free, velocity, mu, bound)


@pytest.mark.parametrize("seed", [1344, 4048, 10102, 13088])
def test_forces_are_found_where_both_ends_of_an_edge_may_begin_to_slip_beside_others_that_do(seed):
    """The ends move alike along the edge; neither sticking nor the slip that convex programs see will do."""
    rng = np.random.default_rng(seed)
    jacobian, factor = rng.normal(size=(15, 14)), rng.normal(size=(14, 14))
    jacobian[9] = jacobian[6]
    delassus = jacobian @ (factor @ factor.T / 14.0 + 0.1 * np.eye(14)) @ jacobian.T
    free = jacobian @ rng.normal(size=14) - np.array([0, 0, 1] * 4 + [0] * 3)
    velocity = np.vstack([rng.normal(size=(2, 2)), np.zeros((2, 2))])
    mu, bound = rng.uniform(0.5, 1.2, size=4), rng.uniform(0.05, 0.5)
    forces_obey_the_law(delassus, free, velocity, mu, bound)


def forces_obey_the_law(delassus, free, velocity, mu, bound):
    """Check the forces of contacts that slip or, where their velocity is zero, rest, and of dry joints."""
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


def choices_that_hold(delassus, free, directions, mu):
    """Return the forces of each choice of which slipping contacts are closed that obeys the law."""
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


def test_forces_on_contacts_that_slip_are_found_wherever_there_are_any():
    """Slip may drive contacts in (Painlevé): then there may be none, or several."""
    rng = np.random.default_rng(5)
    counts = []
    for _ in range(300):
        jacobian = rng.normal(size=(9, 12))
        delassus, mu = jacobian @ jacobian.T, rng.uniform(0.5, 2.0, size=3)
        velocity = rng.normal(size=(3, 2))
        free = rng.normal(size=9)
        expected = choices_that_hold(delassus, free, velocity / np.linalg.norm(velocity, axis=1)[:, None], mu)
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


def slip_held_by_joints(seed, joints):
    """One contact that slips, on joints with dry friction that would jam it if they all held."""
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
def test_slip_that_jams_while_joints_hold_has_forces_at_which_they_yield(joints, seeds):
    """The gap accelerates down without a force and up with a large one, so some force is right."""
    for seed in [*seeds, *range(10)]:
        delassus, free, mu, push = slip_held_by_joints(seed, joints)
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
def find(delassus, free, slip, mu, held, lower, upper, x, pressed, before):
    """Call the kernel, which only kernels can."""
    least = np.zeros(len(mu))
    return find_forces(delassus, free, slip, mu, least, held, lower, upper, x, pressed, before, True)


def found_from(delassus, free, slip, mu, bound, pressed, before=0.0):
    """Return what `find_forces` finds for contacts and joints with these bounds."""
    nc, x = len(mu), np.zeros(len(free))
    limits = np.full(len(free) - 3 * nc, bound)
    held, start = np.zeros(nc, dtype=bool), np.zeros(len(free)) + before
    assert find(delassus, free, slip, mu, held, -limits, limits, x, np.array(pressed), start)
    return x


def could_open_or_stay(seed, bound):
    """A contact beside a joint at its bound that obeys the law open and, by linear algebra, at rest too."""
    rng = np.random.default_rng(seed)
    while True:
        jacobian = rng.normal(size=(4, 5)) @ np.diag(rng.uniform(0.2, 2.0, size=5))
        delassus, free = jacobian @ jacobian.T, rng.normal(size=4)
        alone = np.clip(-free[3] / delassus[3, 3], -bound, bound)
        opens = free + delassus[:, 3] * alone
        resting = np.linalg.solve(delassus, -free)
        if abs(resting[3]) > bound:  # it yields
            resting[3] = np.sign(resting[3]) * bound
            resting[:3] = np.linalg.solve(delassus[:3, :3], -free[:3] - delassus[:3, 3] * resting[3])
            if (delassus[3] @ resting + free[3]) * resting[3] > 0.0:
                continue
        if opens[2] > 0.01 and 0.01 < np.hypot(*resting[:2]) < 0.9 * resting[2]:
            return delassus, free, alone, resting


def could_slip_or_stay(seed, bound):
    """A contact that begins to slip beside a joint that begins to move, lawfully, though both could rest."""
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


def test_what_is_pressed_and_at_rest_stays_so_where_it_could_slip():
    for seed in range(40):
        delassus, free, _, resting = could_slip_or_stay(seed, 1.0)
        found = found_from(delassus, free, np.zeros((1, 2)), np.ones(1), 1.0, [True, False])
        np.testing.assert_allclose(found, resting, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("slides", [0.0, 0.6])
def test_what_stays_at_rest_beside_a_contact_that_slips_bears_what_that_needs(slides):
    """Two contacts, one of which slips: what rests has no acceleration, what slips none along its normal.

    Where the determinant of their equations is negative that would not last, and what opens does.
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
        force = found_from(delassus, free, np.array([[0.0, 0.0], [0.6, 0.8]]), mu, 0.0, [True, True])
        expected = [resting, push * friction] if lasts else opened
        np.testing.assert_allclose(force, np.ravel(expected), rtol=1e-8, atol=1e-8)
    assert found > 0


@pytest.mark.parametrize("bound", [0.1, 10.0])
def test_what_is_pressed_stays_closed_where_it_could_open(bound):
    for seed in range(40):
        delassus, free, _, resting = could_open_or_stay(seed, bound)
        found = found_from(delassus, free, np.zeros((1, 2)), np.ones(1), bound, [True, False])
        np.testing.assert_allclose(found, resting, rtol=1e-9, atol=1e-9)


def every_solution(delassus, free, mu, bound):
    """All forces of one contact that slips along t₁ and of rows within ±bound, by enumeration; their signs.

    The sign is that of the determinant of the equations of what is closed and held.
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
    """Of 2,000 draws: Delassus matrix, accelerations, friction, bound, and all solutions."""
    rng = np.random.default_rng(7)
    for _ in range(2000):
        factor = rng.normal(size=(5, 5))
        delassus, free = factor @ factor.T, 3.0 * rng.normal(size=5)
        mu, bound = rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.0)
        solutions = every_solution(delassus, free, mu, bound)
        if len(solutions) > 1:
            yield delassus, free, mu, bound, solutions


def slipping(delassus, free, mu, bound, x):
    """Arguments of kernels for such a problem."""
    limits = np.full(2, bound)
    return (delassus, free, np.array([[1.0, 0.0]]), np.array([mu]), np.array([False]), -limits, limits, x)


def test_of_several_forces_those_where_the_search_begins_are_taken():
    """Where iterations come near forces but take too long, others are not to be found in their place."""
    rng = np.random.default_rng(1)
    several = 0
    for *problem, solutions in problems_with_several_solutions():
        several += 1
        for x, _ in solutions:
            near = x + 1e-6 * rng.normal(size=5)
            assert solve(*slipping(*problem, near)) <= 1e-10
            assert near == pytest.approx(x, rel=1e-9, abs=1e-9)
    assert several > 50


@pytest.mark.parametrize("pressed", [[True, True, True], [True, False, False], [False] * 3])
def test_forces_from_which_any_deviation_grows_give_way_to_others(pressed):
    """Those of a negative determinant do, nearly wherever there are others."""
    several = lasts = 0
    for delassus, free, mu, bound, solutions in problems_with_several_solutions():
        taken = found_from(delassus, free, np.array([[1.0, 0.0]]), np.array([mu]), bound, pressed)
        off = [np.abs(taken - x).max() <= 1e-8 * np.abs(taken).max() for x, _ in solutions]
        assert any(off)
        several += 1
        lasts += any(near and positive for near, (_, positive) in zip(off, solutions, strict=True))
    assert several > 50
    assert lasts >= several - 2


def slip_that_begins(delassus, free, mu, bound):
    """All forces (4,) of a contact that begins to slip beside a joint within ±bound; whether they last.

    They do if, in the direction d(θ) of slip, the determinant of what is closed and held is positive, and the
    acceleration across d turns slip back to it: it falls with θ where it vanishes.
    """

    def at(angle, side):
        """Acceleration across the direction, forces, whether they obey the law, and the determinant."""
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
def test_slip_that_begins_lasts_in_the_direction_it_takes(seed):
    """Of all equations the determinant may be positive where neither the forces last nor the direction."""
    rng, begun = np.random.default_rng(seed), 0
    for _ in range(100):
        factor = rng.normal(size=(4, 4))
        delassus, free = factor @ factor.T, 3.0 * rng.normal(size=4)
        mu, bound = rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.0)
        solutions = slip_that_begins(delassus, free, mu, bound)
        x = found_from(delassus, free, np.zeros((1, 2)), np.array([mu]), bound, [False, False])
        taken = [lasts for one, _, lasts in solutions if np.abs(one - x).max() <= 1e-6 * np.abs(x).max()]
        assert all(taken)
        begun += len(taken)
    assert begun > 10


def could_move_or_hold(seed, bound):
    """A contact that slips beside a joint that begins to move, though both laws let it be held too."""
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


def test_a_joint_that_has_been_held_beside_slip_stays_so_where_it_could_move():
    for seed in range(40):
        delassus, free, mu, _, _, force, strength = could_move_or_hold(seed, 1.0)
        found = found_from(delassus, free, np.array([[0.6, 0.8]]), np.array([mu]), 1.0, [True, True])
        np.testing.assert_allclose(found, [*force, strength], rtol=1e-8)


@numba.njit
def driven(delassus, free, slip, mu, held, x):
    """Call the kernel, which only kernels can."""
    return jammed_contact(delassus, free, slip, mu, held, x)


def test_slip_drives_a_surface_in_where_no_force_of_its_own_helps():
    """Painlevé: c − μ b·s < 0 and a surface that is approached; another force may keep it off."""
    delassus = np.array([[4.0, 0.0, 1.9], [0.0, 4.0, 0.0], [1.9, 0.0, 1.0]])
    free, mu, held = np.array([0.0, 0.0, -1.0]), np.array([0.8]), np.array([False])
    for direction, expected in ((1.0, 0), (-1.0, -1), (0.0, -1)):
        assert driven(delassus, free, np.array([[direction, 0.0]]), mu, held, np.zeros(3)) == expected
    lifted = np.block([[delassus, np.array([[0.0], [0.0], [2.0]])], [np.array([0.0, 0.0, 2.0, 5.0])]])
    more = np.append(free, 0.0)
    for push, expected in ((0.4, 0), (0.6, -1)):
        forces = np.array([0.0, 0.0, 0.0, push])
        assert driven(lifted, more, np.array([[1.0, 0.0]]), mu, held, forces) == expected


@numba.njit
def may_grow(effective):
    """Call the kernel, which only kernels can."""
    return contact_forces.may_grow(effective)


@pytest.mark.parametrize("rank", [1, 2, 3, 4])
def test_slip_drives_in_where_a_sum_of_principal_minors_is_negative(rank):
    """Against the characteristic polynomial by NumPy; also of four corners of a sole, whose rank is three."""
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
    """Return the sum of all principal minors of an order."""
    chosen = itertools.combinations(range(len(matrix)), order)
    return sum(np.linalg.det(matrix[np.ix_(rows, rows)]) for rows in chosen)


@pytest.mark.parametrize("start", [np.nan, np.inf, 1e200])
def test_where_the_search_for_forces_begins_does_not_matter(start):
    """Sweeps that diverge leave numbers that are none."""
    delassus, free, mu = contacts_at_rest(3, 2, 6)
    held, nothing, velocity = np.zeros(2, dtype=np.bool_), np.zeros(0), np.zeros((2, 2))
    found, expected = np.full(6, start), np.zeros(6)
    assert solve(delassus, free, velocity, mu, held, nothing, nothing, found) <= 1e-10
    assert solve(delassus, free, velocity, mu, held, nothing, nothing, expected) <= 1e-10
    assert np.abs(expected).max() > 0.0
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
