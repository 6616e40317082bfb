"""Rank of symmetric positive semidefinite matrices, and linear systems with them."""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.jit import external, inlined
from .tolerances import RANK


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
            total = matrix[i, p]
            for j in range(k):
                total -= lower[i, j] * lower[p, j]
            lower[i, k] = total / pivot
            rest[i] -= lower[i, k] ** 2
    return size


@inlined
def forward(lower, order, rank, right, y):
    """Fill the first `rank` entries of y with L₁₁⁻¹ times the entries of `right` in pivot order."""
    for k in range(rank):
        i = order[k]
        total = right[i]
        for j in range(k):
            total -= lower[i, j] * y[j]
        y[k] = total / lower[i, k]


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
