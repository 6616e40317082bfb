"""Products of small matrices and vectors, as loops that numba compiles fast."""

from __future__ import annotations

import numpy as np

from .._compile.declared import FLOAT_ROWS, declared
from .._compile.jit import external, inlined
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


@declared(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS)
@external
def add_product(left, right, out):
    """Add left (k, m) times right (m, n) to out (k, n); blocks of 2 by 4 entries of `left` are faster."""
    k, m = left.shape
    n, whole = right.shape[1], m - m % 4
    for a in range(0, k - 1, 2):
        x, y, to, other = left[a], left[a + 1], out[a], out[a + 1]
        for b in range(0, whole, 4):
            x1, x2, x3, x4 = x[b], x[b + 1], x[b + 2], x[b + 3]
            y1, y2, y3, y4 = y[b], y[b + 1], y[b + 2], y[b + 3]
            first, second, third, fourth = right[b], right[b + 1], right[b + 2], right[b + 3]
            for c in range(n):
                r1, r2, r3, r4 = first[c], second[c], third[c], fourth[c]
                to[c] += x1 * r1 + x2 * r2 + x3 * r3 + x4 * r4
                other[c] += y1 * r1 + y2 * r2 + y3 * r3 + y4 * r4
        for b in range(whole, m):
            add(to, x[b], right[b])
            add(other, y[b], right[b])
    if k % 2 == 1:
        for b in range(m):
            add(out[k - 1], left[k - 1, b], right[b])


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
