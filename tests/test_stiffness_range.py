"""Ranges of impacts at several contacts over relative stiffnesses."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from pinimpact import ImpactProblem, InputError, solve_impact


def cradle(balls, stiffness=1.0):
    """Return the elastic impact of a ball at 1 m/s on a row of equal balls in contact."""
    n = balls - 1
    w, velocity = np.zeros((3 * n, 3 * n)), np.zeros((n, 3))
    w[2::3, 2::3] = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    velocity[0, 2] = -1.0
    return ImpactProblem(w, velocity, 0.0, 1.0, "energetic", stiffness=stiffness)


@pytest.mark.parametrize(
    "balls", [3, *(pytest.param(count, marks=pytest.mark.exhaustive) for count in (4, 9))]
)
def test_wide_range_reaches_the_limits_of_sequences(balls):
    """If stiffnesses decrease along the row, impacts happen in sequence and only the last ball moves."""
    low, high = solve_impact(cradle(balls)).range(stiffness=(1e-4, 1e4), draws=40)
    assert low.shape == high.shape == (balls - 1, 3)
    assert (low[:, :2] == 0.0).all()
    assert (high[:, :2] == 0.0).all()
    if balls == 3:
        # a far stiffer first contact gives a sequence, a far softer one an impact on a pair of balls
        assert high[1, 2] == pytest.approx(1.0, abs=1e-3)
        assert low[1, 2] == pytest.approx(0.0, abs=1e-3)
        assert high[0, 2] == pytest.approx(1.0, abs=1e-3)
        assert low[0, 2] == pytest.approx(0.0, abs=1e-3)
    for seed in range(5 if balls < 5 else 0):  # at many contacts, draws do not reach all extremes
        factors = np.exp(np.random.default_rng(100 + seed).uniform(-1.0, 1.0, balls - 1))
        inside = solve_impact(cradle(balls, factors)).velocity
        assert (low - 0.05 <= inside).all()
        assert (inside <= high + 0.05).all()


def test_range_grows_with_factor():
    solution = solve_impact(cradle(4))
    last = np.zeros((3, 3))
    for factor in (1.0, 2.0, 10.0, 100.0):
        low, high = solution.range(stiffness=(1.0 / factor, factor), draws=0)
        assert (low <= solution.velocity).all()
        assert (solution.velocity <= high).all()
        if factor == 1.0:
            assert (high - low).max() <= 1e-15
        assert (high - low).sum() >= last.sum()
        last = high - low


def test_decoupled_contacts_do_not_depend_on_stiffness():
    w = np.eye(6) + 0.1
    w[:3, 3:] = w[3:, :3] = 0.0
    problem = ImpactProblem(w, [[0.3, 0.1, -1.0], [0.2, -0.4, -2.0]], 0.4, 0.5, "energetic")
    low, high = solve_impact(problem).range(stiffness=(0.1, 10.0))
    assert high == pytest.approx(low, abs=1e-12)


def test_range_is_reproducible_after_pickling():
    solution = solve_impact(cradle(4))
    first = solution.range(stiffness=(0.1, 10.0))
    again = pickle.loads(pickle.dumps(solution)).range(stiffness=(0.1, 10.0))
    assert np.array_equal(first, again)


@pytest.mark.parametrize(
    "wrong", [(10.0, 0.1), (0.0, 1.0), (-1.0, 2.0), (1.0,), (0.1, np.nan), (0.1, np.inf)]
)
def test_invalid_factors_raise(wrong):
    with pytest.raises(InputError, match="stiffness"):
        solve_impact(cradle(3)).range(stiffness=wrong)


@pytest.mark.parametrize("wrong", [{"draws": -1}, {"draws": True}, {"seed": -1}, {"seed": "a"}])
def test_invalid_draws_or_seed_raise(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))}: .*, a whole number from 0 expected"):
        solve_impact(cradle(3)).range(stiffness=(0.1, 10.0), **wrong)
