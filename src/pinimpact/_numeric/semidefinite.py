"""Symmetric positive semidefinite matrices: rank and linear systems."""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.jit import external, inlined
from .tolerances import RANK


@inlined
def factor(matrix, order, lower, least):
    """Fill `lower` (m, m) with the pivoted Cholesky factor of a semidefinite matrix; return its rank.

    A pivot is taken as zero up to a part `least` of the largest.
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
    """Fill the first `rank` entries of y with L₁₁⁻¹ times those of `right` in the order of the pivots."""
    for k in range(rank):
        i = order[k]
        total = right[i]
        for j in range(k):
            total -= lower[i, j] * y[j]
        y[k] = total / lower[i, k]


@declared(FLOAT_ROWS, FLOATS, FLOATS)
@external
def solve_definite(matrix, target, solution):
    """Solve a system with a positive semidefinite matrix; return whether it is definite, else none is found.

    In half the time of `elimination.solve`.
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
