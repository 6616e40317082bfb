"""Least-squares solution of least norm of a small dense system of any shape and rank.

It uses a complete orthogonal decomposition A Π = Q [T 0; 0 0] Zᵀ by Householder reflections with column
pivoting, x = Π Z [T⁻¹(Qᵀb); 0]. Remaining columns are taken as zero if they are small relative to the largest
pivot. (G. Golub, C. Van Loan, Matrix Computations, 4th edition, section 5.4.7)
"""

from __future__ import annotations

import math

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .loops import assign, filled
from .products import add, dot
from .tolerances import TINY


@inlined
def columns_times(r, k, first, column, out):
    """Fill out[j], j ≥ first, with the product of columns j and `column` of r over the rows from k on.

    A negative `column` means the product of column j with itself. Four independent sums at a time are faster.
    """
    m, n = r.shape
    j = first
    while j < n:
        last = n - 1
        j1, j2, j3 = min(j + 1, last), min(j + 2, last), min(j + 3, last)
        a = b = c = d = 0.0
        if column < 0:
            for i in range(k, m):
                a += r[i, j] * r[i, j]
                b += r[i, j1] * r[i, j1]
                c += r[i, j2] * r[i, j2]
                d += r[i, j3] * r[i, j3]
        else:
            for i in range(k, m):
                part = r[i, column]
                a += part * r[i, j]
                b += part * r[i, j1]
                c += part * r[i, j2]
                d += part * r[i, j3]
        out[j], out[j1], out[j2], out[j3] = a, b, c, d
        j += 4


@inlined
def decompose(matrix, rights, rank_tolerance, order, factor):
    """Replace A (m, n) by its complete orthogonal decomposition, each b of `rights` (k, m) by Qᵀb.

    A is overwritten with T, whose size is the rank, and to its right the reflection vectors of Z, whose
    heads are in factor (min(m, n),); order (n,) is overwritten with the column order Π. Pivots up to
    `rank_tolerance` times the largest are taken as zero. Returns the rank, and, relative to the largest
    pivot, the last one and the first one that is taken as zero.
    """
    m, n = matrix.shape
    r = matrix
    for j in range(n):
        order[j] = j
    rank, largest, kept, dropped, sums = 0, 0.0, 0.0, 0.0, np.empty(n)
    for k in range(min(m, n)):
        answer_signals()
        # recomputed at every step: updated norms would be inaccurate where the rank is decided
        longest, chosen = -1.0, k
        columns_times(r, k, k, -1, sums)
        for j in range(k, n):
            if sums[j] > longest:
                longest, chosen = sums[j], j
        pivot = math.sqrt(longest)
        largest = max(largest, pivot)
        if not pivot > rank_tolerance * largest:
            dropped = pivot
            break
        kept = pivot
        for i in range(m):
            r[i, k], r[i, chosen] = r[i, chosen], r[i, k]
        order[k], order[chosen] = order[chosen], order[k]
        if r[k, k] > 0.0:
            pivot = -pivot
        r[k, k] -= pivot  # the column, from the diagonal on, is now the reflection vector
        scale = 1.0 / (pivot * r[k, k])
        columns_times(r, k, k + 1, k, sums)
        for j in range(k + 1, n):
            sums[j] *= scale
        for i in range(k, m):
            part = r[i, k]
            add(r[i, k + 1 :], part, sums[k + 1 :])
        for b in rights:
            add(b[k:], scale * dot(r[k:, k], b[k:]), r[k:, k])
        r[k, k] = pivot
        rank += 1
    # reflections from the right transform [R₁₁ R₁₂] to [T 0], from the last row up; each acts on one diagonal
    # entry and the columns after the rank
    for k in range(rank - 1, -1, -1):
        length = r[k, k] * r[k, k] + dot(r[k, rank:], r[k, rank:])
        length = math.copysign(math.sqrt(length), -r[k, k])
        head = r[k, k] - length
        factor[k] = head
        scale = 1.0 / (length * head)
        r[k, k] = length
        for i in range(k):
            total = scale * (r[i, k] * head + dot(r[i, rank:], r[k, rank:]))
            r[i, k] += total * head
            add(r[i, rank:], total, r[k, rank:])
    largest = max(largest, TINY)
    return rank, kept / largest, dropped / largest


@inlined
def rotate_back(matrix, rank, order, factor, y, x):
    """Fill x (n,) with Π Z y, for the result of `decompose`; y (n,) is overwritten."""
    n = len(y)
    for k in range(rank):
        total = y[k] * factor[k] + dot(y[rank:], matrix[k, rank:])
        total /= matrix[k, k] * factor[k]
        y[k] += total * factor[k]
        add(y[rank:], total, matrix[k, rank:])
    for k in range(n):
        x[order[k]] = y[k]


@declared(FLOAT_ROWS, FLOAT_ROWS, float, FLOAT_ROWS, FLOAT_ROWS)
@external
def least_norms(matrix, rights, rank_tolerance, found, null):
    """Fill found (k, n) with solutions of least norm for right-hand sides (k, m); see `least_norm`.

    Returns the results of `decompose`.
    """
    m, n = matrix.shape
    r, sides, y = matrix.copy(), rights.copy(), np.zeros(n)
    order, factor = np.empty(n, dtype=np.int64), np.empty(min(m, n))
    rank, kept, dropped = decompose(r, sides, rank_tolerance, order, factor)
    for c in range(len(sides)):
        filled(y, 0.0)
        for k in range(rank - 1, -1, -1):
            y[k] = (sides[c, k] - dot(r[k, k + 1 : rank], y[k + 1 : rank])) / r[k, k]
        rotate_back(r, rank, order, factor, y, found[c])
    for k in range(min(n - rank, len(null))):
        filled(y, 0.0)
        y[rank + k] = 1.0
        rotate_back(r, rank, order, factor, y, null[k])
    return rank, kept, dropped


@declared(FLOAT_ROWS, FLOATS, float, FLOATS, FLOAT_ROWS)
@external
def least_norm(matrix, right, rank_tolerance, x, null):
    """Fill x (n,) with the least-squares solution of least norm of A x = b, A (m, n); return the rank of A.

    Pivots up to `rank_tolerance` times the largest are taken as zero. The first n − rank rows of null (k, n),
    as far as k allows, are overwritten with an orthonormal basis of the null space of A.
    """
    rights, found = np.empty((1, len(right))), np.empty((1, len(x)))
    assign(rights[0], right)
    rank, _, _ = least_norms(matrix, rights, rank_tolerance, found, null)
    assign(x, found[0])
    return rank
