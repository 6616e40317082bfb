"""The least change of velocity (11.9) that stops sticking contacts and held joints, against NumPy."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinimpact.scene._kernels import coming_to_rest

CONTACT = 3


@numba.njit
def come_to_rest(minverse, rows, start, rests, against, moves, first, error, metres, on, v):
    """Call the kernel `come_to_rest` from Python; reversed slip is not ignored at any speed."""
    limits = error, 0.0, np.inf
    return coming_to_rest.come_to_rest(
        minverse, rows, start, rests, against, moves, first, *limits, metres, on, v
    )


def projected(inertia, rows, v):
    """Return the velocity nearest to v in the metric of the inertia for which the given rows vanish."""
    response = np.linalg.solve(inertia, rows.T)
    return v - response @ np.linalg.lstsq(rows @ response, rows @ v, rcond=1e-13)[0]


def settled(inertia, rows, v, rests, against, moves, first, error, metres=None):
    """Return the velocity after `come_to_rest`, rows at rest, rows that keep sliding, and energy gained."""
    after, rests, on = v.copy(), rests.copy(), np.zeros(len(rows), dtype=np.int64)
    inverse = np.linalg.inv(inertia)
    arguments = against, moves, first, error, np.ones(len(v)) if metres is None else metres, on, after
    energy, _ = come_to_rest((inverse + inverse.T) / 2.0, rows, rows @ v, rests, *arguments)
    return after, rests, on, energy


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 2), st.integers(0, 4), st.booleans())
def test_it_is_the_least_change_after_which_nothing_begins_against_its_friction(seed, nc, joints, begins):
    rng = np.random.default_rng(seed)
    n, first = 11, CONTACT * nc
    inertia = np.eye(n) + (a := rng.normal(size=(n, n))) @ a.T
    rows = np.vstack([rng.normal(size=(first, n)), np.eye(n)[rng.permutation(n)[:joints]]])
    rests, against = np.ones(len(rows), dtype=bool), np.zeros(len(rows))
    yields = first + np.flatnonzero(rng.random(joints) < 0.7)
    rests[yields], against[yields] = False, rng.choice([-1.0, 1.0], len(yields))
    if begins:
        rests[0], against[0] = False, -1.0
    v = rng.normal(size=n)
    after, resting, on, energy = settled(
        inertia, rows, v, rests, against, np.zeros(len(rows), dtype=bool), first, math.inf
    )
    assert (resting >= rests).all()
    assert not on.any()
    assert after == pytest.approx(projected(inertia, rows[resting], v), abs=1e-9)
    assert (against * (rows @ after) <= 1e-9).all()
    assert energy == pytest.approx((after @ inertia @ after - v @ inertia @ v) / 2.0, abs=1e-9)


@pytest.mark.parametrize("lean", [1e-5, 1e-7])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_joint_whose_row_almost_depends_on_rows_at_rest_keeps_moving(lean, sign):
    """While its tip rests, a rod that moves at unit speed moves the joint, rail 0, at the speed `lean`.

    Stopping this joint, which moves against its friction, would stop the whole motion along the rod.
    """
    rows = np.array([[1.0, lean, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    v = np.array([-lean, 1.0, 0.0, 0.0]) * -sign
    rests, against = np.array([True, True, True, False]), np.array([0.0, 0.0, 0.0, sign])
    after, resting, on, _ = settled(np.eye(4), rows, v, rests, against, ~rests, CONTACT, 1e-3)
    assert on.tolist() == [0, 0, 0, sign]
    assert not resting[3]
    assert after == pytest.approx(v, abs=1e-15)


@pytest.mark.parametrize("unit", [2.0**-20, 2.0**20])
@pytest.mark.parametrize("error", [1e-3, 1e3])
def test_stopped_rows_do_not_depend_on_units_of_velocities(unit, error):
    """The previous rod, with its velocity in units of `unit` metres, as if it were a joint with a lever."""
    metres = np.array([1.0, unit, 1.0, 1.0])
    rows = np.array([[1.0, 1e-5, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0], [1.0, 0, 0, 0]])
    v = np.array([1e-5, -1.0, 0.0, 0.0])
    rests, against = np.array([True, True, True, False]), np.array([0.0, 0.0, 0.0, 1.0])
    one, resting, on, _ = settled(np.eye(4), rows, v, rests, against, ~rests, CONTACT, error)
    other = settled(
        np.diag(metres**2), rows * metres, v / metres, rests, against, ~rests, CONTACT, error, metres
    )
    assert other[0] * metres == pytest.approx(one, rel=1e-12, abs=1e-18)
    assert (other[1] == resting).all()
    assert (other[2] == on).all()


def test_contact_whose_sticking_would_accelerate_a_joint_keeps_sliding():
    """The same rail at rest, while the tip still slides at `lean` times the speed of the rod."""
    lean = 1e-6
    rows = np.array([[1.0, lean, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    v = np.array([0.0, 1.0, 0.0, 0.0])
    rests, against = np.array([True, True, True, False]), np.array([0.0, 0.0, 0.0, -1.0])
    moves = np.array([True, True, False, False])
    _, _, on, _ = settled(np.eye(4), rows, v, rests, against, moves, CONTACT, 1e-3)
    assert on.tolist() == [1, 0, 0, 0]
