"""Products of small matrices and vectors, as loops that numba compiles fast."""

from __future__ import annotations

import numpy as np

from .._compile.jit import inlined
from .loops import filled


@inlined
def dot(x, y):
    """Return xᵀy."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@inlined
def add(to, part, x):
    """Add part · x (n,) to an array `to` (n,)."""
    for i in range(len(to)):
        to[i] += part * x[i]


@inlined
def apply(matrix, x, out):
    """Fill out (m,) with matrix (m, n) times x (n,)."""
    for i in range(len(out)):
        out[i] = dot(x, matrix[i])


@inlined
def apply_symmetric(matrix, x, out):
    """Fill out (n,) with a symmetric matrix (n, n) times a sparse x (n,)."""
    filled(out, 0.0)
    for j in range(len(out)):
        if x[j] != 0.0:
            add(out, x[j], matrix[j])


@inlined
def products(rows, others, out):
    """Fill out (k, l) with rows · othersᵀ, for sparse rows (k, n) and others (l, n)."""
    m, n = others.shape
    places = np.empty(n, dtype=np.int64)
    for a in range(len(rows)):
        count = 0
        for j in range(n):
            if rows[a, j] != 0.0:
                places[count] = j
                count += 1
        for b in range(0, m - 3, 4):  # four independent sums at a time, which is faster
            first = second = third = fourth = 0.0
            for k in range(count):
                j = places[k]
                x = rows[a, j]
                first += x * others[b, j]
                second += x * others[b + 1, j]
                third += x * others[b + 2, j]
                fourth += x * others[b + 3, j]
            out[a, b], out[a, b + 1], out[a, b + 2], out[a, b + 3] = first, second, third, fourth
        for b in range(m - m % 4, m):
            total = 0.0
            for k in range(count):
                total += rows[a, places[k]] * others[b, places[k]]
            out[a, b] = total
