"""The rank of a symmetric positive semidefinite matrix."""

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
