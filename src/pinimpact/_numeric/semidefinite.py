"""Linear systems with a symmetric positive semidefinite matrix."""

from __future__ import annotations

import math

import numpy as np

from .elimination import RANK
from .jit import inner


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
def forward(lower, order, right, y):
    """Fill y (rank,) with the solution of lower y = right, by the rows in order."""
    for a in range(len(y)):
        i = order[a]
        total = right[i]
        for j in range(a):
            total -= lower[i, j] * y[j]
        y[a] = total / lower[i, a]


@inner
def backward(lower, order, y, x):
    """Fill x, in order, with the solution of lowerᵀ x = y (rank,); elsewhere it counts as zero."""
    for a in range(len(y) - 1, -1, -1):
        total = y[a]
        for b in range(a + 1, len(y)):
            total -= lower[order[b], a] * x[order[b]]
        x[order[a]] = total / lower[order[a], a]


@inner
def impulses(matrix, target, x):
    """Fill an x that solves matrix x = target, in least squares where the semidefinite matrix is singular."""
    size = len(target)
    order, lower, y = np.empty(size, dtype=np.int64), np.zeros((size, size)), np.empty(size)
    rank = factor(matrix, order, lower)
    for a in range(size):
        x[a] = 0.0
    if rank == size:
        forward(lower, order, target, y)
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
        forward(inner_lower, inner_order, y, z)
        backward(inner_lower, inner_order, z, y)
    backward(lower, order, y[:rank], x)
