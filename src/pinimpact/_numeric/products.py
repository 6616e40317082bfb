"""Products of small matrices, in loops that numba compiles fast."""

from __future__ import annotations

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
def products(rows, others, out):
    """Fill out (k, l) with the products of each of rows (k, n) and each of others (l, n)."""
    for a in range(len(rows)):
        for b in range(len(others)):
            total = 0.0
            for j in range(rows.shape[1]):
                total += rows[a, j] * others[b, j]
            out[a, b] = total
