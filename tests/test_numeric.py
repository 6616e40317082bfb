"""Small dense systems against NumPy's decompositions."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinimpact._numeric import elimination, least_norm, lu, semidefinite
from pinimpact.scene._kernels.step_impulses import invert_trees

TOLERANCE = 1e-9
COMPILES = settings(deadline=None)


@numba.njit
def solve_least_norm(matrix, right, x, null):
    """Call the kernel from Python."""
    return least_norm.least_norm(matrix, right, TOLERANCE, x, null)


@numba.njit
def solve_square(matrix, right, x):
    """Call the kernel from Python."""
    return elimination.solve(matrix, right, x, TOLERANCE)


@numba.njit
def solve_symmetric(matrix, right, x):
    """Call the kernel from Python."""
    return semidefinite.solve_definite(matrix, right, x)


def matrix_of_rank(seed, rows, columns, rank):
    """Return a random matrix of given rank with nonzero singular values between 1 and 10."""
    rng = np.random.default_rng(seed)
    left = np.linalg.qr(rng.normal(size=(rows, rows)))[0][:, :rank]
    right = np.linalg.qr(rng.normal(size=(columns, columns)))[0][:, :rank]
    return (left * rng.uniform(1.0, 10.0, size=rank)) @ right.T


@COMPILES
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 12), st.integers(0, 12), st.booleans())
def test_least_norm_is_that_of_the_singular_values(seed, rows, columns, rank, consistent):
    rank = min(rank, rows, columns)
    matrix = matrix_of_rank(seed, rows, columns, rank)
    rng = np.random.default_rng(seed + 1)
    right = matrix @ rng.normal(size=columns) if consistent else rng.normal(size=rows)
    before = matrix.copy()
    x, null = np.empty(columns), np.empty((columns, columns))
    assert solve_least_norm(matrix, right, x, null) == rank
    assert (matrix == before).all()
    null = null[: columns - rank]
    assert np.abs(matrix @ null.T).max(initial=0.0) <= 1e-13
    assert null @ null.T == pytest.approx(np.eye(columns - rank), abs=1e-14)
    expected = np.linalg.pinv(matrix, rcond=TOLERANCE) @ right if rank else np.zeros(columns)
    assert x == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_least_norm_of_equal_columns_is_uniform():
    x = np.empty(4)
    assert solve_least_norm(np.array([[1.0, 1.0, 1.0, 1.0]]), np.array([2.0]), x, np.empty((0, 4))) == 1
    assert x == pytest.approx(0.5, rel=1e-15)


@COMPILES
@given(st.integers(0, 10**6), st.integers(1, 10))
def test_elimination_solves_and_knows_the_sign_of_the_determinant(seed, size):
    matrix = matrix_of_rank(seed, size, size, size)
    right = np.random.default_rng(seed + 1).normal(size=size)
    x = np.empty(size)
    assert solve_square(matrix, right, x) == np.sign(np.linalg.det(matrix))
    assert x == pytest.approx(np.linalg.solve(matrix, right), rel=1e-11, abs=1e-12)
    singular = matrix_of_rank(seed, size, size, size - 1)
    assert solve_square(singular, right, x) == 0


@COMPILES
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_a_definite_system_is_solved_and_a_singular_one_refused(seed, size):
    x, root = np.empty(size), matrix_of_rank(seed, size, size, size)
    right = np.random.default_rng(seed + 1).normal(size=size)
    assert solve_symmetric(root @ root.T, right, x)
    assert x == pytest.approx(np.linalg.solve(root @ root.T, right), rel=1e-9, abs=1e-12)
    root = matrix_of_rank(seed, size, size, size - 1)
    assert not solve_symmetric(root @ root.T, right, x)


@numba.njit
def solve_factored(matrix, rights, order):
    """Call the kernels from Python."""
    if not lu.factorize(matrix, order):
        return False
    columns = rights.T.copy()
    lu.substitute(matrix, order, columns)
    rights[:] = columns.T
    return True


@COMPILES
@given(st.integers(0, 10**6), st.integers(1, 15))
def test_a_system_that_is_factored_once_is_solved_for_every_right_hand_side(seed, size):
    rng = np.random.default_rng(seed)
    matrix, solutions = rng.normal(size=(size, size)), rng.normal(size=(3, size))
    rights = solutions @ matrix.T
    assert solve_factored(matrix.copy(), rights, np.empty(size, dtype=np.int64))
    condition = np.linalg.cond(matrix)
    assert np.abs(rights - solutions).max() <= 1e-13 * condition * size
    singular = np.zeros((size, size))
    assert not solve_factored(singular, rights, np.empty(size, dtype=np.int64))


@COMPILES
@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(0, 6))
def test_factors_of_a_tall_matrix(seed, size, more):
    matrix = np.random.default_rng(seed).normal(size=(size + more, size))
    factors, order = matrix.copy(), np.empty(size, dtype=np.int64)
    assert solve_factored(factors, np.empty((0, size)), order)
    product = (np.tril(factors, -1) + np.eye(size + more, size)) @ np.triu(factors[:size])
    for k in range(size - 1, -1, -1):
        product[[k, order[k]]] = product[[order[k], k]]
    assert product == pytest.approx(matrix, abs=1e-13)


@pytest.mark.parametrize("place", [(0, 0), (1, 1), (2, 0)])
def test_row_order_of_non_finite_matrix_is_valid(place):
    """Right-hand sides are permuted by it, so invalid indices would write out of bounds."""
    matrix, order = np.eye(3), np.full(3, 10**6)
    matrix[place] = np.nan
    solve_factored(matrix, np.ones((2, 3)), order)
    assert (order >= np.arange(3)).all()
    assert (order < 3).all()


@pytest.mark.parametrize("sizes", [(1,), (6, 6), (4, 9, 40)])
def test_inverse_of_mass_matrices_with_branches(sizes):
    """Entries between two branches that start at the third velocity of a tree are zero."""
    rng = np.random.default_rng(len(sizes))
    tree = np.repeat(np.arange(len(sizes)), sizes)
    mass, first = np.zeros((len(tree), len(tree))), 0
    for size in sizes:
        lower = np.tril(rng.normal(size=(size, size))) + 3.0 * np.eye(size)
        half = 2 + (size - 2) // 2
        lower[half:, 2:half] = 0.0
        mass[first : first + size, first : first + size] = lower.T @ lower
        first += size
    added, inverse, filled = rng.uniform(0.0, 1.0, len(tree)), np.zeros_like(mass), np.zeros_like(mass)
    assert invert_trees(np.triu(mass), added, tree, filled, inverse)
    assert np.array_equal(filled, mass + np.diag(added))
    assert (inverse == inverse.T).all()
    assert inverse == pytest.approx(np.linalg.inv(mass + np.diag(added)), abs=1e-13)
    assert not invert_trees(-np.triu(mass), np.zeros(len(tree)), tree, filled, inverse)


def test_non_finite_mass_matrix_has_no_inverse():
    upper, inverse = np.diag([1.0, np.nan, 1.0]), np.zeros((3, 3))
    tree, added = np.array([0, 1, 1]), np.zeros(3)
    assert not invert_trees(upper, added, tree, np.zeros((3, 3)), inverse)
    assert inverse[0, 0] == 1.0
