"""Derivatives in contact space against multiple precision, closed forms and identities; boundaries."""

from __future__ import annotations

import numpy as np
import pytest

import pinimpact
from pinimpact import LAWS, Boundary, Flag, ImpactProblem

from .drawing import one_of_each
from .reference.problems import RECIPES
from .reference.slopes import INPUTS, slope_along, slopes

UPPER = np.triu_indices(3)
REGIMES = {
    "smooth slip": Flag.SLIP_TURNED,
    "slip to stick": Flag.STICK,
    "resumed slip": Flag.SLIP_RESUMED,
    "jam": Flag.JAM,
    "second compression": Flag.SECOND_COMPRESSION,
    "no slip": Flag.NONE,
    "near-invariant start": Flag.SLIP_TURNED,
    "isotropic": Flag.NONE,
    "straight": Flag.NONE,
    "frictionless": Flag.NONE,
    "scaled": Flag.NONE,
}
"""Recipes of random problems, and the flag that the drawn impact must have."""


def drawn(category, law, seed):
    """Return W, v, μ and e of a random problem with the flag of its regime, and its derivatives."""
    rng = np.random.default_rng((31, list(RECIPES).index(category), LAWS.index(law), seed))
    while True:
        W, v, mu = RECIPES[category](rng)
        e = float(rng.uniform(0.05, 0.95))
        if category == "second compression":
            e = float(rng.uniform(0.9, 0.99))
        solution = pinimpact.solve_impact(ImpactProblem(W, v, mu, e, law), derivatives=True)
        near = solution.flags & (Flag.NEAR_JUMP | Flag.NEAR_STICK_THRESHOLD)
        if REGIMES[category] in solution.flags and not near:
            return W, v, mu, e, solution.derivatives


def columns_of(d):
    """Return derivatives (6, 11): rows v⁺ and P, columns as in `slopes`, one for each pair of W_ij = W_ji."""
    both = []
    for name in "vP":
        by_delassus = getattr(d, f"d{name}_ddelassus") * (2.0 - np.eye(3))
        rest = getattr(d, f"d{name}_dfriction"), getattr(d, f"d{name}_drestitution")
        both.append(np.column_stack([getattr(d, f"d{name}_dv"), by_delassus[:, UPPER[0], UPPER[1]], *rest]))
    return np.vstack(both)


def error(found, reference, W, v):
    """Return the largest error of the derivatives of v⁺ or P by v°, W, μ or e, relative to their norm.

    The norm is at least that of a derivative of order one.
    """
    worst = 0.0
    speed, inertia = float(np.linalg.norm(v)), float(np.linalg.norm(W))
    for rows, unit in ((slice(0, 3), speed), (slice(3, 6), speed / inertia)):
        groups = (slice(0, 3), speed), (slice(3, 9), inertia), (slice(9, 10), 1.0), (slice(10, 11), 1.0)
        for group, by in groups:
            size = max(float(np.linalg.norm(reference[rows, group])), unit / by)
            relative = float(np.linalg.norm(found[rows, group] - reference[rows, group])) / size
            worst = relative if not relative < worst else worst
    return worst


def error_along(found, W, v, mu, e, law):
    """Return the largest error as `error`, in a random direction of v° and one of W instead of all columns.

    That is a third of the work. Columns of NaN are left out.
    """
    known, rng = np.isfinite(found).all(axis=0), np.random.default_rng(0)
    found = np.where(known, found, 0.0)
    directions = np.zeros((4, INPUTS))
    directions[0, :3], directions[1, 3:9], directions[2, 9], directions[3, 10] = (
        *(rng.normal(size=3), rng.normal(size=6)),
        *(1.0, 1.0),
    )
    directions *= known
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    sides = 0, 0, int(mu == 0.0), int(e == 0.0) - int(e == 1.0)
    speed, inertia = float(np.linalg.norm(v)), float(np.linalg.norm(W))
    worst = 0.0
    for direction, by, side in zip(directions, (speed, inertia, 1.0, 1.0), sides, strict=True):
        reference, along = slope_along(direction, W, v, mu, e, law, side), found @ direction
        for rows, unit in ((slice(0, 3), speed), (slice(3, 6), speed / inertia)):
            size = max(float(np.linalg.norm(reference[rows])), unit / by)
            relative = float(np.linalg.norm(along[rows] - reference[rows])) / size
            worst = relative if not relative < worst else worst
    return worst


@pytest.mark.parametrize(("category", "law"), one_of_each(list(REGIMES), list(LAWS)))
def test_random_problems_along_random_directions(category, law):
    W, v, mu, e, d = drawn(category, law, 0)
    found = columns_of(d)
    no_direction = category == "no slip" and d.boundary == Boundary.START_AT_REST
    assert np.flatnonzero(np.isnan(found).any(axis=0)).tolist() == ([0, 1] if no_direction else [])
    assert d.boundary in (Boundary.NONE, Boundary.START_AT_REST, Boundary.BOUND)
    assert (d.boundary == Boundary.BOUND) == (mu == 0.0)
    assert error_along(found, W, v, mu, e, law) < 1e-9


@pytest.mark.exhaustive
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("category", REGIMES)
def test_random_problems_against_multiple_precision(category, law):
    W, v, mu, e, d = drawn(category, law, 0)
    found, known = columns_of(d), np.arange(INPUTS)
    if category == "no slip" and d.boundary == Boundary.START_AT_REST:
        assert np.isnan(found[:, :2]).all()
        found[:, :2] = 0.0
        known = known[2:]
    assert np.isfinite(found).all()
    assert d.boundary in (Boundary.NONE, Boundary.START_AT_REST, Boundary.BOUND)
    assert (d.boundary == Boundary.BOUND) == (mu == 0.0)
    assert error(found, slopes(W, v, mu, e, law, known), W, v) < 1e-9


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("e", "mu"), [(0.0, 0.3), (1.0, 0.3), (0.5, 0.0)])
def test_derivatives_at_bounds_are_one_sided(law, e, mu):
    rng = np.random.default_rng(5)
    W, v, _ = RECIPES["smooth slip"](rng)
    d = pinimpact.solve_impact(ImpactProblem(W, v, mu, e, law), derivatives=True).derivatives
    assert d.boundary == Boundary.BOUND
    assert error_along(columns_of(d), W, v, mu, e, law) < 1e-9


def many(category, law, count):
    rng = np.random.default_rng((7, list(RECIPES).index(category)))
    problems = [RECIPES[category](rng) for _ in range(count)]
    W, v, mu = (np.array(part) for part in zip(*problems, strict=True))
    e = rng.uniform(0.05, 0.95, count)
    return W, v, mu, e, pinimpact.solve_impacts(W, v, mu, e, law, derivatives=True)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("category", ["smooth slip", "slip to stick", "resumed slip", "jam", "isotropic"])
def test_identities_of_scaling_and_of_rotation(category, law):
    W, v, _, _, batch = many(category, law, 200)
    d, P = batch.derivatives, batch.impulse
    good = d.boundary == 0
    assert good.mean() > 0.95
    size = np.linalg.norm(P, axis=1)
    by_v = np.einsum("nij,nj->ni", d.dP_dv, v)
    by_delassus = np.einsum("nkij,nij->nk", d.dP_ddelassus, W)
    Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    turned = np.einsum("nij,nj->ni", d.dP_dv, v @ Z.T)
    turned += np.einsum("nkij,nij->nk", d.dP_ddelassus, Z @ W - W @ Z)
    terms = size + np.linalg.norm(d.dP_dv, axis=(1, 2)) * np.linalg.norm(v, axis=1)
    for change, expected in ((by_v, P), (by_delassus, -P), (turned, P @ Z.T)):
        assert (np.linalg.norm(change - expected, axis=1) / terms)[good].max() < 1e-9


def test_zero_friction_in_closed_form():
    W, v, _, e, _ = many("frictionless", "poisson", 50)
    d = pinimpact.solve_impacts(W, v, 0.0, e, derivatives=True).derivatives
    # v⁺ = v − (1 + e) W n v₃/W₃₃
    column = W[:, :, 2] / W[:, 2, 2][:, None]
    expected = np.tile(np.eye(3), (50, 1, 1))
    expected[:, :, 2] -= (1.0 + e)[:, None] * column
    assert np.abs(d.dv_dv - expected).max() < 1e-12
    assert np.abs(d.dv_drestitution + column * v[:, 2][:, None]).max() < 1e-12


def test_batch_has_the_derivatives_of_its_rows():
    W, v, mu, e, batch = many("slip to stick", "energetic", 40)
    plain = pinimpact.solve_impacts(W, v, mu, e, "energetic")
    assert plain.derivatives is None
    assert np.array_equal(plain.velocity, batch.velocity)
    assert np.array_equal(plain.work.total, batch.work.total)
    for k in (0, 17, 39):
        problem = ImpactProblem(W[k], v[k], mu[k], e[k], "energetic")
        one = pinimpact.solve_impact(problem, derivatives=True).derivatives
        assert np.array_equal(one.dv_ddelassus, batch.derivatives.dv_ddelassus[k])
        assert np.array_equal(one.dP_dfriction, batch.derivatives.dP_dfriction[k])


def test_invalid_row_has_nan():
    velocity = np.array([[1.0, 0.0, -1.0], [1.0, 0.0, np.nan]])
    d = pinimpact.solve_impacts(np.eye(3), velocity, 0.3, 0.5, derivatives=True).derivatives
    assert np.isfinite(d.dv_dv[0]).all()
    assert np.isnan(d.dv_dv[1]).all()


W0 = np.array([[1.0, 0.1, 0.2], [0.1, 1.5, 0.1], [0.2, 0.1, 1.2]])
RATIO = np.array([3.0, 4.0, 5.0]) / 16


def at(W, v, mu, e=0.5, law="poisson"):
    return pinimpact.solve_impact(ImpactProblem(W, v, mu, e, law), derivatives=True).derivatives


def test_separating_contact():
    d = at(W0, [1.0, 0.0, 0.5], 0.3)
    assert np.array_equal(d.dv_dv, np.eye(3))
    assert not d.dP_ddelassus.any()
    assert d.boundary == Boundary.NONE


def test_grazing_contact():
    d = at(W0, [1.0, 0.0, 0.0], 0.3)
    assert d.boundary == Boundary.GRAZING
    assert np.isnan(d.dv_dv[:, 2]).all()
    assert np.array_equal(d.dv_dv[:, :2], np.eye(3)[:, :2])


def test_start_at_rest_is_a_boundary_only_if_slip_starts():
    sticks, slips = at(W0, [0.0, 0.0, -1.0], 2.0), at(W0, [0.0, 0.0, -1.0], 0.05)
    assert sticks.boundary == Boundary.NONE
    assert np.isfinite(sticks.dv_dv).all()
    assert slips.boundary == Boundary.START_AT_REST
    assert np.isnan(slips.dv_dv[:, :2]).all()
    assert np.isfinite(slips.dv_dv[:, 2]).all()


def test_slip_that_stops_along_unstable_direction_is_a_start_at_rest():
    # slip departs from that direction at a speed of 1e-24, then it resumes
    W = np.array(
        [
            [0.8065653127910517, 0.28221143872614274, -0.17857665026509545],
            [0.28221143872614274, 1.2015739688651268, 0.1256899254082034],
            [-0.17857665026509545, 0.1256899254082034, 0.48836852021838],
        ]
    )
    v = [0.05451158163845011, -0.04442384732357345, -0.12524776892080303]
    d = at(W, v, 0.11268620017598864, 0.9)
    assert d.boundary == Boundary.START_AT_REST
    assert np.isnan(d.dv_dv[:, :2]).all()
    assert np.isnan(d.dv_dfriction).all()
    assert np.isfinite(d.dv_dv[:, 2]).all()
    assert np.isfinite(d.dv_drestitution).all()


def test_slip_that_reverses_in_a_plane_of_symmetry():
    # after the reversal the velocity across the plane is a power, of exponent above one, of that before
    def mass(across):
        return np.array([[1.5, 0.0, 1.0], [0.0, across, 0.0], [1.0, 0.0, 1.3]])

    W, v, mu = mass(0.3), [-0.05, 0.0, -1.0], 0.5
    d = at(W, v, mu)
    assert d.boundary == Boundary.EVENTS_COINCIDE
    assert at(mass(1.8), v, mu).boundary == Boundary.NONE  # exponent above two
    known = [0, 2, 3, 5, 8, 9, 10]
    in_plane = slopes(W, v, mu, 0.5, "poisson", known)
    assert error(columns_of(d)[:, known], in_plane[:, known], W, v) < 1e-9
    assert d.dv_dv[1, 1] == 0.0
    slows, falls, grows = 1.0 + mu * 1.5, mu * 0.3, 1.0 - mu * 1.5
    power = (1.0 + falls / grows) / (1.0 - falls / slows)
    steps = 1e-5, 1e-6
    ends = [pinimpact.solve_impact(ImpactProblem(W, [v[0], h, v[2]], mu, 0.5)).velocity[1] for h in steps]
    assert np.log10(ends[0] / ends[1]) == pytest.approx(power, rel=1e-3)


def test_panels_of_slip_that_stops_at_high_friction():
    # if r²/g grew by e¹⁸ on a panel around an invariant direction, the error of the work would be 3e-9
    W = np.array(
        [
            [1.1670477719786607, 0.31911605103589463, -0.478686692372857],
            [0.31911605103589463, 0.855181658068907, -0.5090086304192746],
            [-0.478686692372857, -0.5090086304192746, 0.9795375112059294],
        ]
    )
    v, mu, e = [0.0888981564776723, 2.010901117501425, -0.7008733984338208], 127.98369189359983, 0.65
    solution = pinimpact.solve_impact(ImpactProblem(W, v, mu, e, "energetic"), derivatives=True)
    found = columns_of(solution.derivatives)
    assert error(found, slopes(W, v, mu, e, "energetic"), W, v) < 2e-10


def test_slip_whose_angle_underflows():
    # the angle to the invariant direction decreases by a factor exp(1111) until the end of compression
    W = np.array(
        [
            [0.06508752890705019, -0.010112761333167335, 0.20504168993138364],
            [-0.010112761333167335, 2.4642112051386342, -1.1946946826215397],
            [0.20504168993138364, -1.1946946826215397, 1.2063152238207302],
        ]
    )
    v, mu = [0.053035800676820184, -2.321201080602611, -0.03951502583063517], 3.0119891143094497
    d = at(W, v, mu)
    assert d.boundary == Boundary.NONE
    assert error_along(columns_of(d), W, v, mu, 0.5, "poisson") < 1e-9


@pytest.mark.parametrize(
    ("law", "triangle", "v", "mu", "e"),
    [
        (
            "newton",
            [
                2.6510512554128653,
                -0.27165185658707725,
                -0.22994108846644726,
                0.5017643458148286,
                -0.26365423573462793,
                0.8144267564626233,
            ],
            [0.37490460946454873, 0.24842399648151314, -0.7606728287550223],
            0.31262246919490716,
            0.449976388902183,
        ),
        (
            "energetic",
            [
                0.29885005017711974,
                0.546122747729565,
                -0.37627520186603675,
                1.7180882439532565,
                -0.6778673415571168,
                1.002476591877455,
            ],
            [0.0863314664449011, 0.02658536115395515, -0.8732331065800509],
            0.6459982303339054,
            0.6218483853027272,
        ),
    ],
)
def test_slip_that_stops_while_turning_and_resumes(law, triangle, v, mu, e):
    # the direction converges slowly while the speed decreases below rounding errors
    W = np.zeros((3, 3))
    W[UPPER] = triangle
    W = W + np.triu(W, 1).T
    d = at(W, v, mu, e, law)
    assert d.boundary == Boundary.NONE
    assert error_along(columns_of(d), W, v, mu, e, law) < 1e-9


def test_stick_threshold_is_a_boundary():
    W = np.array([[1.0, 0.0, RATIO[0]], [0.0, 1.0, RATIO[1]], [RATIO[0], RATIO[1], 1.0]])
    v = [0.0, 0.0, -1.0]
    d = at(W, v, RATIO[2])
    assert d.boundary == Boundary.STICK_THRESHOLD | Boundary.START_AT_REST
    assert np.isnan(d.dv_dfriction).all()
    assert np.isnan(d.dv_ddelassus[:, 0, 2]).all()
    assert np.isnan(d.dv_dv[:, :2]).all()
    known = [2, 8, 10]
    reference = slopes(W, v, RATIO[2], 0.5, "poisson", known)
    assert np.abs(columns_of(d)[:, known] - reference[:, known]).max() < 1e-9


@pytest.mark.parametrize(
    "law", ["poisson", *(pytest.param(law, marks=pytest.mark.exhaustive) for law in ("newton", "energetic"))]
)
def test_slow_slip_at_the_stick_threshold(law):
    # the speed hardly grows, so a slower slip takes a longer path relative to its speed
    W = np.array([[1.0, 0.0, RATIO[0]], [0.0, 1.0, RATIO[1]], [RATIO[0], RATIO[1], 1.0]])
    for speed in (1e-4, 1e-12):
        v = [speed, 0.0, -1.0]
        d = at(W, v, RATIO[2], law=law)
        assert d.boundary == Boundary.NONE
        assert error_along(columns_of(d), W, v, RATIO[2], 0.5, law) < 1e-9


@pytest.mark.parametrize(("share", "known"), [(1.0, True), (1.5, False)])
def test_slip_that_stops_at_the_end_of_a_phase(share, known):
    # slip stops at P₃ = share · |v₃°|/c, the end of compression or of the impact
    d = at(np.diag([1.0, 1.0, 1.0]), [0.5 * share, 0.0, -1.0], 0.5)
    assert d.boundary == Boundary.EVENTS_COINCIDE
    assert np.isnan(d.dv_dv).all()
    assert np.isfinite(d.dv_drestitution).all() == known


def test_jump_is_flagged():
    # impact without collision at v₃ = 0; no impact at any v₃ > 0
    W = np.array([[1.2, 0.0, 1.0], [0.0, 8.0, 0.0], [1.0, 0.0, 1.0]])
    d = at(W, [1.0, 0.0, 0.0], 1.5)
    assert d.boundary == Boundary.JUMP
    assert np.isnan(d.dv_dv[:, 2]).all()
    assert np.isfinite(d.dv_dv[:, :2]).all()


def test_derivatives_are_unbounded_towards_a_jump():
    """The maximum of v₃ approaches the goal of Newton's law, and derivatives grow as 1/√distance."""
    W, v, mu = np.array([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]]), np.array([0.5, 12, -0.5]), 1.5
    low, high = 0.01, 0.99

    def second(e):
        problem = ImpactProblem(W, v, mu, e, "newton")
        return Flag.SECOND_COMPRESSION in pinimpact.solve_impact(problem).flags

    assert not second(low)
    assert second(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if second(middle) else (middle, high)
    near = [abs(at(W, v, mu, low - gap, "newton").dv_drestitution[0]) for gap in (1e-6, 1e-8)]
    assert near[1] / near[0] == pytest.approx(10.0, rel=0.1)
    assert at(W, v, mu, low, "newton").boundary == Boundary.JUMP


@pytest.mark.parametrize("w", [1e-1, 1e-4, 1e-7, 1e-9, 1e-12, 1e-14])
def test_impulse_along_a_direction_of_little_mobility(w):
    """Slip along t₁ stays: v_t2 falls as (1 − μP₃)ʷ, and P_t2 = v_t2° ((1 − μP₃)ʷ − 1)/w."""
    d = at(np.diag([1.0, w, 1.0]), [1.0, 0.0, -1.5], 0.2)
    left = 1.0 - 0.2 * 2.25
    assert d.dv_dv[1, 1] == pytest.approx(left**w, rel=1e-12)
    if w >= 1e-7:
        assert d.boundary == Boundary.NONE
        assert d.dP_dv[1, 1] == pytest.approx(np.expm1(w * np.log(left)) / w, rel=1e-8)
    else:  # the difference of v_t2 is lost in rounding
        assert d.boundary == Boundary.RANK
        assert np.isnan(d.dP_dv[:2]).all()
    assert d.dP_dv[2, 2] == pytest.approx(-1.5, rel=1e-12)
    d = at(np.diag([1.0, w, 1.0]), [1.0, 0.0, -1.5], 0.0)
    assert d.dP_dv == pytest.approx(np.diag([0.0, 0.0, -1.5]), abs=1e-8)


def test_rank_is_flagged():
    W = np.array([[1.0, 0.0, 0.3], [0.0, 0.0, 0.0], [0.3, 0.0, 1.0]])
    d = at(W, [1.0, 0.0, -1.0], 0.2)
    assert d.boundary == Boundary.RANK
    # in its plane equal to those with mobility across it
    other = at(W + np.diag([0.0, 1.0, 0.0]), [1.0, 0.0, -1.0], 0.2)
    plane = np.ix_([0, 2], [0, 2])
    assert np.abs(d.dv_dv[plane] - other.dv_dv[plane]).max() < 1e-12
    assert np.abs(d.dP_ddelassus[0, 0, :] - other.dP_ddelassus[0, 0, :])[[0, 2]].max() < 1e-12


THRESHOLD = np.array([[1.0, 0.0, RATIO[0]], [0.0, 1.0, RATIO[1]], [RATIO[0], RATIO[1], 1.0]])
SIDES = {
    # W, v, μ, negative exponent of the reference's step, and columns along which the boundary continues
    "start at rest": (W0, [0.0, 0.0, -1.0], 0.05, 20, []),
    "grazing": (W0, [1.0, 0.0, 0.0], 0.3, 12, []),
    "threshold": (THRESHOLD, [0.0, 0.0, -1.0], RATIO[2], 12, []),
    "slip ends with compression": (np.eye(3), [0.5, 0.0, -1.0], 0.5, 12, [6]),
    "slip ends with the impact": (np.eye(3), [0.75, 0.0, -1.0], 0.5, 12, [6]),
}


@pytest.mark.parametrize(("kind", "side"), one_of_each(list(SIDES), [1, -1]))
def test_one_sided_derivatives(kind, side):
    W, v, mu, power, along = SIDES[kind]
    problem = ImpactProblem(W, v, mu, 0.5)
    both = columns_of(pinimpact.solve_impact(problem, derivatives=True).derivatives)
    found = columns_of(pinimpact.solve_impact(problem, derivatives=True, side=side).derivatives)
    missing = np.isnan(both).any(axis=0)
    assert np.array_equal(found[:, ~missing], both[:, ~missing])
    assert np.flatnonzero(np.isnan(found).any(axis=0)).tolist() == along
    wanted = [k for k in np.flatnonzero(missing).tolist() if k not in along]
    reference = slopes(W, v, mu, 0.5, "poisson", wanted, side, power)
    assert np.abs(found - reference)[:, wanted].max() < 2e-8


def test_one_sided_derivatives_at_a_jump():
    # no impact at v₃ > 0; v⁺ is continuous for v₃ ≤ 0
    problem = ImpactProblem(
        np.array([[1.2, 0.0, 1.0], [0.0, 8.0, 0.0], [1.0, 0.0, 1.0]]), [1.0, 0, 0], 1.5, 0.5
    )
    ahead, behind = (pinimpact.solve_impact(problem, derivatives=True, side=s).derivatives for s in (1, -1))
    assert np.isnan(ahead.dv_dv[:, 2]).all()
    reference = slopes(problem.delassus, problem.velocity, 1.5, 0.5, "poisson", [2], -1)
    assert np.abs(columns_of(behind)[:, 2] - reference[:, 2]).max() < 1e-9


def test_unbounded_derivatives_have_no_one_sided_ones():
    # the maximum of v₃ is just at the goal of Newton's law: derivatives grow as 1/√distance
    W, v, mu = np.array([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]]), np.array([0.5, 12, -0.5]), 1.5
    low, high = 0.01, 0.99
    for _ in range(60):
        middle = 0.5 * (low + high)
        flags = pinimpact.solve_impact(ImpactProblem(W, v, mu, middle, "newton")).flags
        low, high = (low, middle) if Flag.SECOND_COMPRESSION in flags else (middle, high)
    problem = ImpactProblem(W, v, mu, low, "newton")
    found = pinimpact.solve_impact(problem, derivatives=True, side=-1).derivatives
    assert np.isnan(found.dv_drestitution).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"derivatives": True, "side": 2}, "1 or −1"),
        ({"derivatives": True, "side": True}, "1 or −1"),
        ({"side": 1}, "without derivatives"),
    ],
)
def test_invalid_side_raises(options, words):
    with pytest.raises(pinimpact.InputError, match=f"side: .*{words}"):
        pinimpact.solve_impact(ImpactProblem(W0, [1, 0, -1], 0.3, 0.5), **options)


def test_boundaries_have_sentences():
    assert len((Boundary.JUMP | Boundary.RANK).describe()) == 2
    assert Boundary.NONE.describe() == ()


@pytest.mark.parametrize(
    ("problem", "options", "words"),
    [
        (ImpactProblem(W0, [1, 0, -1], 0.3, 0.5), {"method": "euler"}, "the method 'euler'"),
    ],
)
def test_methods_without_derivatives_raise(problem, options, words):
    with pytest.raises(pinimpact.InputError, match=words):
        pinimpact.solve_impact(problem, derivatives=True, **options)
