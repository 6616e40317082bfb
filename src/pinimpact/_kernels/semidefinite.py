"""Linear systems with a symmetric positive semidefinite matrix."""

from __future__ import annotations

import math

import numpy as np

from .jit import inner
from .sustained import RANK


@inner
def factor(matrix, order, lower):
    """Fill `lower` (m, m) with the pivoted Cholesky factor of a semidefinite matrix; return its rank."""
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
        if not rest[p] > RANK * largest:
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


@inner
def impulses(matrix, target, x):
    """Fill an x that solves matrix x = target, in least squares where the semidefinite matrix is singular."""
    size = len(target)
    order, lower, y = np.empty(size, dtype=np.int64), np.zeros((size, size)), np.empty(size)
    rank = factor(matrix, order, lower)
    for a in range(size):
        x[a] = 0.0
    if rank == size:
        for a in range(size):
            i = order[a]
            total = target[i]
            for j in range(a):
                total -= lower[i, j] * y[j]
            y[a] = total / lower[i, a]
    elif rank > 0:  # lower y = target, by its normal equations
        normal, inner_order, inner_lower = np.empty((rank, rank)), order.copy(), np.zeros((rank, rank))
        for a in range(rank):
            y[a] = 0.0
            for i in range(size):
                y[a] += lower[i, a] * target[i]
            for b in range(rank):
                total = 0.0
                for i in range(size):
                    total += lower[i, a] * lower[i, b]
                normal[a, b] = total
        factor(normal, inner_order[:rank], inner_lower)
        z = np.empty(rank)
        for a in range(rank):
            i = inner_order[a]
            total = y[i]
            for j in range(a):
                total -= inner_lower[i, j] * z[j]
            z[a] = total / inner_lower[i, a]
        for a in range(rank - 1, -1, -1):
            total = z[a]
            for b in range(a + 1, rank):
                total -= inner_lower[inner_order[b], a] * y[inner_order[b]]
            y[inner_order[a]] = total / inner_lower[inner_order[a], a]
    for a in range(rank - 1, -1, -1):
        total = y[a]
        for b in range(a + 1, rank):
            total -= lower[order[b], a] * x[order[b]]
        x[order[a]] = total / lower[order[a], a]
    return rank
