"""Products of small matrices, in loops that numba compiles fast."""

from __future__ import annotations

import numpy as np

from .jit import inner


@inner
def apply(matrix, x, out):
    """Fill out (m,) with matrix (m, n) times x (n,)."""
    for i in range(len(out)):
        total = 0.0
        for j in range(len(x)):
            total += matrix[i, j] * x[j]
        out[i] = total


@inner
def apply_symmetric(matrix, x, out):
    """Fill out (n,) with a symmetric matrix (n, n) times x (n,), of which many may be zero."""
    n = len(out)
    for i in range(n):
        out[i] = 0.0
    for j in range(n):
        part = x[j]
        if part != 0.0:
            for i in range(n):
                out[i] += matrix[j, i] * part


@inner
def products(rows, others, out):
    """Fill out (k, l) with the products of each of rows (k, n), many of them zero, and of others (l, n)."""
    n = rows.shape[1]
    places = np.empty(n, dtype=np.int64)
    for a in range(len(rows)):
        count = 0
        for j in range(n):
            if rows[a, j] != 0.0:
                places[count] = j
                count += 1
        for b in range(len(others)):
            total = 0.0
            for k in range(count):
                total += rows[a, places[k]] * others[b, places[k]]
            out[a, b] = total
