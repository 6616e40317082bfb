"""Rank of symmetric positive semidefinite matrices, and linear systems with them."""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.jit import external, inlined
from .products import add, dot
from .tolerances import EXACT, RANK, TINY


@inlined
def factor(matrix, order, lower, least):
    """Fill lower (m, m), order (m,) with the pivoted Cholesky factor of matrix (m, m); return its rank.

    Pivots up to `least` times the largest are taken as zero.
    """
    size = len(matrix)
    rest = np.empty(size)
    largest = 0.0
    for a in range(size):
        order[a] = a
        rest[a] = matrix[a, a]
        largest = max(largest, rest[a])
    for k in range(size):
        best = k
        for a in range(k + 1, size):
            if rest[order[a]] > rest[order[best]]:
                best = a
        order[k], order[best] = order[best], order[k]
        p = order[k]
        if not rest[p] > least * largest:
            return k
        pivot = math.sqrt(rest[p])
        lower[p, k] = pivot
        for a in range(k + 1, size):
            i = order[a]
            lower[i, k] = (matrix[i, p] - dot(lower[i, :k], lower[p])) / pivot
            rest[i] -= lower[i, k] ** 2
    return size


@inlined
def forward(lower, order, rank, right, y):
    """Fill the first `rank` entries of y with L₁₁⁻¹ times the entries of `right` in pivot order."""
    for k in range(rank):
        i = order[k]
        y[k] = (right[i] - dot(lower[i, :k], y)) / lower[i, k]


@declared(FLOAT_ROWS, FLOATS, FLOATS)
@external
def solve_definite(matrix, target, solution):
    """Solve a system with a positive definite matrix (m, m); return False, without a solution, if singular.

    This takes half the time of `elimination.solve`.
    """
    size = len(target)
    lower, order, part = np.zeros((size, size)), np.empty(size, dtype=np.int64), np.empty(size)
    if factor(matrix, order, lower, RANK) < size:
        return False
    forward(lower, order, size, target, part)
    for k in range(size - 1, -1, -1):
        total = part[k]
        for j in range(k + 1, size):
            total -= lower[order[j], k] * solution[order[j]]
        solution[order[k]] = total / lower[order[k], k]
    return True


@declared(FLOAT_ROWS)
@external
def invert_definite(matrix):
    """Replace a positive definite matrix (m, m) by its inverse; return False, without a result, if singular.

    M = Lᵀ D L is eliminated from the last row on, so that the mass matrix of a kinematic tree, numbered from
    the root, keeps its zeros between branches, which are skipped. Each of the three parts takes m³/6
    multiplications, along rows.
    """
    size = len(matrix)
    pivots, columns = np.empty(size), np.zeros((size, size))
    for k in range(size - 1, -1, -1):
        pivots[k] = matrix[k, k]
        if not pivots[k] > 0.0:
            return False
        for i in range(k):
            x = matrix[k, i] / pivots[k]
            if x != 0.0:
                add(matrix[i, : i + 1], -x, matrix[k, : i + 1])
        for i in range(k):
            matrix[k, i] /= pivots[k]
    for i in range(size):  # L⁻¹, in place of L
        row = np.zeros(i + 1)
        row[i] = 1.0
        for j in range(i):
            x = matrix[i, j]
            if x != 0.0:
                add(row[: j + 1], -x, matrix[j, : j + 1])
        for j in range(i + 1):
            matrix[i, j] = columns[j, i] = row[j]
    for i in range(size):  # L⁻¹ D⁻¹ L⁻ᵀ
        row = np.zeros(i + 1)
        for k in range(i + 1):
            x = columns[k, i] / pivots[k]
            if x != 0.0:
                add(row[k:], x, columns[k, k : i + 1])
        for j in range(i + 1):
            matrix[i, j] = matrix[j, i] = row[j]
    return True


@inlined
def cholesky(matrix):
    """Replace a positive definite matrix by its Cholesky factor, with large pivots instead of lost ones."""
    n = len(matrix)
    whole, column = np.empty(n), np.empty(n)
    largest = TINY
    for i in range(n):
        whole[i] = matrix[i, i]
        largest = max(largest, whole[i])
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > EXACT * n * whole[k]:
            pivot = 1e64 * largest  # lost to rounding: this makes the unknown zero
        root = math.sqrt(pivot)
        matrix[k, k] = root
        for i in range(k + 1, n):
            matrix[i, k] /= root
            column[i] = matrix[i, k]
        for i in range(k + 1, n):
            part = column[i]
            for j in range(k + 1, i + 1):
                matrix[i, j] -= part * column[j]


@inlined
def substitute(lower, x):
    """Replace x by the solution y of lower lowerᵀ y = x."""
    n = len(x)
    for i in range(n):
        for j in range(i):
            x[i] -= lower[i, j] * x[j]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= lower[j, i] * x[j]
        x[i] /= lower[i, i]
