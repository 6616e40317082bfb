"""Flat landings on several corners by the method of events, against independent time integration."""

import re

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import BoundReachedWarning, ImpactProblem, solve_impact
from pinimpact.contact_space.many_inputs import many_inputs
from pinimpact.contact_space.waves import _propagate_in_steps

from .landing_reference import landing


def body(corners, height):
    """Return W and the contact Jacobian (3n, 6) of a body of mass 1 with the inertia of a box.

    `height`, one number or (n,), is that of the centre above the corners [m].
    """
    rows = []
    for (x, y), depth in zip(corners, np.broadcast_to(height, len(corners)), strict=True):
        rows += [[1, 0, 0, 0, -depth, -y], [0, 1, 0, depth, 0, x], [0, 0, 1, y, -x, 0]]
    jacobian = np.array(rows, dtype=float)
    inverse = np.diag([1.0, 1.0, 1.0, 600.0, 500.0, 450.0])
    return jacobian @ inverse @ jacobian.T, jacobian


BOX = [(0.05, 0.05), (0.05, -0.05), (-0.05, 0.05), (-0.05, -0.05)]
STOOL = [(0.06, 0.0), (-0.03, 0.05), (-0.03, -0.05)]


def landing_by_steps():
    """Return W and velocities of a box with uneven corners, two of which slip more slowly than the others."""
    w, jacobian = body(BOX, (0.05, 0.0501, 0.04995, 0.05003))
    return w, (jacobian @ np.array((0.3, 0.0, -1.0, 0.0, 0.0, 0.5))).reshape(-1, 3)


@pytest.mark.parametrize(
    ("corners", "friction", "restitution", "u"),
    [
        (BOX, 0.5, 0.5, (0.5, 0.0, -1.0, 0.0, 0.0, 0.0)),
        (BOX, 0.3, 0.7, (0.3, 0.2, -1.0, 0.5, -0.4, 0.0)),
        (STOOL, 0.8, 0.5, (0.2, -0.1, -1.0, 0.0, 0.0, 1.0)),
    ],
)
def test_flat_landings_against_short_steps(corners, friction, restitution, u):
    w, jacobian = body(corners, 0.05)
    start, n = jacobian @ np.array(u), len(corners)
    by_steps, error = landing(
        w, start, np.full(n, friction), np.full(n, restitution), np.full(n, 1 / w[2, 2]), 0.001
    )
    solution = solve_impact(
        ImpactProblem(w, start.reshape(-1, 3), friction, restitution, "energetic", stiffness=np.ones(n))
    )
    after = start + w @ solution.impulse.ravel()
    # error of extrapolation at this step size [m/s]
    assert error < 4e-7
    assert np.abs(after - by_steps).max() < 4e-7


@pytest.mark.parametrize("scale", [4.0**15, 4.0**-15])
@pytest.mark.parametrize("by_steps", [False, True])
def test_landing_is_invariant_under_scaling_of_mass(by_steps, scale):
    w, start = landing_by_steps()
    if not by_steps:
        w, jacobian = body(BOX, 0.05)
        start = (jacobian @ np.array((0.5, 0.0, -1.0, 0.0, 0.0, 0.0))).reshape(-1, 3)
    known = solve_impact(ImpactProblem(w, start, 0.8, 0.5, "energetic"), record=True)
    assert bool(known.notes) == by_steps
    solution = solve_impact(ImpactProblem(w * scale, start, 0.8, 0.5, "energetic"), record=True)
    assert np.array_equal(solution.impulse * scale, known.impulse)
    assert np.array_equal(solution.work.friction * scale, known.work.friction)
    assert np.array_equal(solution.path.impulse * scale, known.path.impulse)
    assert solution.notes == known.notes


@pytest.mark.parametrize("u", [(0.5, 0.0, -1.0, 0.0, 0.0, 0.0), (0.3, 0.2, -1.0, 0.5, -0.4, 0.0), None])
@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_recorded_path_of_flat_landing_obeys_the_laws(u, friction):
    w, start = landing_by_steps()
    if u is not None:
        w, jacobian = body(BOX, 0.05)
        start = jacobian @ np.array(u)
    problem = ImpactProblem(w, start.reshape(-1, 3), friction, 0.5, "energetic")
    solution = solve_impact(problem, record=True)
    path = solution.path
    assert len(path.clock) > 20
    assert np.diff(path.clock).min() >= 0.0
    assert path.velocity[0].ravel() == pytest.approx(start.ravel(), abs=1e-15)
    assert path.velocity[-1] == pytest.approx(solution.velocity, abs=1e-14)
    assert path.impulse[-1] == pytest.approx(solution.impulse, abs=0.0)
    moved = start.ravel() + path.impulse.reshape(len(path.clock), -1) @ w
    assert path.velocity.reshape(moved.shape) == pytest.approx(moved, abs=1e-12)
    steps = np.diff(path.impulse, axis=0)
    assert steps[:, :, 2].min() >= -1e-12
    # also where corners share their friction and all reach its bound
    assert (np.hypot(steps[:, :, 0], steps[:, :, 1]) - friction * steps[:, :, 2]).max() <= 1e-12


@pytest.mark.parametrize("seed", [6, 11])
def test_shared_friction_of_uneven_plate_is_within_its_bounds(seed):
    """Friction resists some motions of the plate a thousand times less than others."""
    rng = np.random.default_rng(seed)
    a, b, h = rng.uniform(0.02, 0.2, 3)
    corners = np.array([(x * a, y * b, -h) for x in (-1, 0, 1) for y in (-1, 0, 1)])
    corners += 10 ** rng.uniform(-3, -2) * h * rng.normal(size=(9, 3))
    jacobian = np.vstack([np.hstack([np.eye(3), -pin.skew(corner)]) for corner in corners])
    inertia = np.array([1.0, 1.0, 1.0, (b * b + h * h) / 3.0, (a * a + h * h) / 3.0, (a * a + b * b) / 3.0])
    friction, start = rng.uniform(0.2, 0.6), (jacobian @ [0, 0, -1.0, 0, 0, 0]).reshape(-1, 3)
    problem = ImpactProblem(jacobian / inertia @ jacobian.T, start, friction, 0.7, "energetic")
    solution = solve_impact(problem, record=True)
    assert solution.events > 0
    steps = np.diff(solution.path.impulse, axis=0)
    assert (np.hypot(steps[:, :, 0], steps[:, :, 1]) - friction * steps[:, :, 2]).max() <= 1e-12


def grid(count):
    """Return the points of a square grid."""
    sides = np.linspace(-0.05, 0.05, round(np.sqrt(count)))
    return [(x, y) for x in sides for y in sides]


@pytest.mark.parametrize("count", [4, 9])
@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5, "in a plane"])
def test_landing_by_events_and_by_steps(count, seed):
    """Slip starts at all corners at once, in the series and in the implicit steps of (14.10)."""
    w, jacobian = body(grid(count), 0.05)
    u, mu, e = np.array([0.3, 0.0, -1.0, 0.0, 0.0, 0.0]), 0.4, 0.6
    if seed != "in a plane":
        rng = np.random.default_rng([9, seed])
        u = np.append(rng.uniform(-0.4, 0.4, 2), [-1.0, *rng.uniform(-0.5, 0.5, 3)])
        mu, e = rng.uniform(0.2, 1.0), rng.uniform(0.3, 0.9)
    compare_with_steps(ImpactProblem(w, (jacobian @ u).reshape(-1, 3), mu, e, "energetic"))


def stack(rng):
    """Return J and the diagonal of M of two boxes, one on the other, and their common velocity."""
    (a, b), h, v = rng.uniform(0.05, 0.2, 2), rng.uniform(0.03, 0.1), rng.uniform(-0.5, 0.5, 2)
    corners = [np.array((x, y, -h)) for x in (-a, a) for y in (-b, b)]
    floor = [np.hstack([np.eye(3), -pin.skew(r), np.zeros((3, 6))]) for r in corners]
    above = [r + np.array((0.0, 0.0, 2.0 * h)) for r in corners]
    between = [
        np.hstack([-np.eye(3), pin.skew(top), np.eye(3), -pin.skew(bottom)])
        for top, bottom in zip(above, corners, strict=True)
    ]
    inertia = np.array([1.0, 1.0, 1.0, (b * b + h * h) / 3.0, (a * a + h * h) / 3.0, (a * a + b * b) / 3.0])
    inertia = np.concatenate([inertia, rng.choice([0.3, 1.0, 3.0]) * inertia])
    return np.vstack([*floor, *between]), inertia, np.tile([*v, -1.0, 0.0, 0.0, 0.0], 2)


@pytest.mark.parametrize("seed", range(8))
def test_landing_of_stack(seed):
    """The boxes have no relative velocity at first; the upper one slips or is dragged along."""
    rng = np.random.default_rng([10, seed])
    jacobian, inertia, u = stack(rng)
    start = (jacobian @ u).reshape(-1, 3)
    mu, e = np.repeat(rng.uniform(0.1, 1.0, 2), 4), np.repeat(rng.uniform(0.2, 0.9, 2), 4)
    compare_with_steps(ImpactProblem(jacobian / inertia @ jacobian.T, start, mu, e, "energetic"))


def test_stack_without_restitution_ends_after_hundreds_of_events_by_a_plastic_impact():
    rng = np.random.default_rng([10, 5])
    jacobian, inertia, u = stack(rng)
    u = u + 0.3 * rng.normal(size=12)
    mu, start = np.repeat(rng.uniform(0.1, 1.0, 2), 4), (jacobian @ u).reshape(-1, 3)
    found = solve_impact(ImpactProblem(jacobian / inertia @ jacobian.T, start, mu, 0.0, "energetic"))
    assert not found.notes
    assert found.events > 500
    after, p = u + jacobian.T @ found.impulse.ravel() / inertia, found.impulse
    assert found.velocity.ravel() == pytest.approx(jacobian @ after, abs=1e-11)
    assert found.velocity[:, 2].min() > -1e-11
    assert (np.hypot(p[:, 0], p[:, 1]) <= (1.0 + 1e-11) * mu * p[:, 2]).all()
    assert found.work.total.sum() == pytest.approx(0.5 * inertia @ (after**2 - u**2), rel=1e-9)


def compare_with_steps(problem):
    """Compare an impact integrated from event to event with the same impact by steps."""
    solution = solve_impact(problem)
    assert solution.events > 0
    by_steps = _propagate_in_steps(many_inputs(problem), 1.0, False, 1e-10)
    assert solution.velocity == pytest.approx(by_steps.velocity, abs=1e-9)
    assert solution.work.friction.sum() == pytest.approx(by_steps.work.friction.sum(), abs=1e-9)


@pytest.mark.parametrize("unevenness", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("seed", [2, 3])
def test_slow_slip_of_uneven_corners_by_events(unevenness, seed):
    """The speed of slip and the time in which it turns are proportional to the unevenness."""
    rng = np.random.default_rng(seed)
    corners = np.column_stack([BOX, np.full(4, -0.05)]) + 0.05 * unevenness * rng.normal(size=(4, 3))
    w, jacobian = body(corners[:, :2], -corners[:, 2])
    u = np.array([*rng.uniform(-0.3, 0.3, 2), -1.0, *rng.uniform(-0.2, 0.2, 2), rng.uniform(-3.0, 3.0)])
    problem = ImpactProblem(w, (jacobian @ u).reshape(-1, 3), 0.6, 0.7, "energetic")
    solution = solve_impact(problem)
    assert solution.notes == ()
    by_steps = _propagate_in_steps(many_inputs(problem), 1.0, False, 1e-10)
    assert solution.velocity == pytest.approx(by_steps.velocity, abs=1e-9)


@pytest.mark.parametrize("seed", [43, 204, 208, 241, 393, 493])
def test_zero_restitution_at_one_of_redundant_contacts_is_a_limit(seed):
    """Slip starts at contacts that share friction before the force without restitution has its maximum."""
    rng = np.random.default_rng([31, seed])
    n = (3, 4, 5)[seed % 3]
    corners = rng.uniform(-0.1, 0.1, (n, 3))[:, :2]
    w, jacobian = body(corners, 0.05)
    start = jacobian @ np.array([*rng.uniform(-0.5, 0.5, 2), -1.0, *rng.uniform(-3.0, 3.0, 3)])
    friction, restitution = rng.uniform(0.2, 1.2, n), np.append(0.0, rng.uniform(0.3, 1.0, n)[1:])

    def after(e):
        restitution[0] = e
        problem = ImpactProblem(w, start.reshape(-1, 3), friction, restitution, "energetic")
        return solve_impact(problem).velocity

    limit = after(0.0)
    coarse, fine = (np.abs(after(e) - limit).max() for e in (1e-3, 1e-4))
    assert 0.0 < fine < 1e-4
    assert fine == pytest.approx(0.1 * coarse, rel=0.05)


def test_noted_accuracy_includes_remaining_approach(monkeypatch):
    # nearly symmetric, e = 0: results at e = 1e-3, 5e-4, … are linear in e, but those at e = 1e-5 are not
    corners = [
        (0.050004013, 0.049999246, -0.191287954),
        (0.049999667, -0.049993353, -0.191261358),
        (-0.050005142, 0.050002582, -0.191275906),
        (-0.050005116, -0.050012408, -0.191289827),
    ]
    jacobian = np.vstack([np.hstack([np.eye(3), -pin.skew(np.array(corner))]) for corner in corners])
    inverse = np.diag([1.0, 1.0, 1.0, 1 / 0.01303019, 1 / 0.01303019, 600.0])
    w, start = jacobian @ inverse @ jacobian.T, jacobian @ np.array((-0.70565988, 0.0, -1.0, 0.0, 0.0, 0.0))
    monkeypatch.setattr("pinimpact.contact_space.waves.MOST_STEPS", 0)
    with pytest.warns(BoundReachedWarning):
        solution = solve_impact(ImpactProblem(w, start.reshape(-1, 3), 0.31174594, 0.0, "energetic"))
    noted = re.search(r"velocities to about (\S+) of the largest", solution.notes[-1])
    assert -solution.velocity[:, 2].min() <= float(noted[1]) * np.abs(start).max() < 1e-5


def test_slip_that_passes_zero_within_rounding():
    """With corners uneven by 1e-12 m slip passes zero at 1e-12 m/s, which series from afar do not resolve."""
    x, y, z = 0.1187182426, 0.0771322297, 0.1960095608
    uneven = 1e-12 * np.array([(0, 41, 20), (-5, -41, 21), (2, 48, 22), (-2, -43, 18)])
    corners = np.array([(x, y, -z), (x, -y, -z), (-x, y, -z), (-x, -y, -z)]) + uneven
    jacobian = np.vstack([np.hstack([np.eye(3), -pin.skew(corner)]) for corner in corners])
    w = jacobian @ np.diag([1, 1, 1, 1 / 0.0147897096, 1 / 0.0175045897, 1 / 0.0066811340]) @ jacobian.T
    u = np.array([0.1448181694, 0.1465365686, -1.0, -1.6785233896, 1.9581336529, 1.7952055105])
    problem = ImpactProblem(w, (jacobian @ u).reshape(-1, 3), 0.93104874, 0.53177841, "energetic")
    by_events = solve_impact(problem, simultaneous="propagate")
    by_steps = _propagate_in_steps(many_inputs(problem), 1.0, False, 1e-9)
    assert not by_events.notes
    assert by_events.velocity == pytest.approx(by_steps.velocity, abs=3e-8)
