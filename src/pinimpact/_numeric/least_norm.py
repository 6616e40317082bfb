"""The solution of least norm of a small dense system, square or not, regular or not.

A complete orthogonal decomposition A Π = Q [T 0; 0 0] Zᵀ by Householder reflections: columns are pivoted,
what is left of them below a part of the first pivot is zero, and x = Π Z [T⁻¹(Qᵀb); 0]. (G. Golub,
C. Van Loan, Matrix Computations, 4th edition, section 5.4.7)
"""

from __future__ import annotations

import math

import numpy as np

from .jit import inner


@inner
def least_norm(matrix, right, rank_tolerance, x):
    """Fill x (n,) with the least-squares solution of matrix x = right that has the least norm.

    Args:
        matrix: (m, n) A, which is left as it is.
        right: (m,) b.
        rank_tolerance: Part of the largest pivot below which pivots count as zero.
        x: (n,) takes the solution.

    Returns:
        The rank that was found.
    """
    m, n = matrix.shape
    r, b = matrix.copy(), right.copy()
    order = np.arange(n)
    rank, largest = 0, 0.0
    for k in range(min(m, n)):
        # anew at every step, for updated norms lose their digits just where the rank is decided
        longest, chosen = -1.0, k
        for j in range(k, n):
            total = 0.0
            for i in range(k, m):
                total += r[i, j] * r[i, j]
            if total > longest:
                longest, chosen = total, j
        pivot = math.sqrt(longest)
        largest = max(largest, pivot)
        if not pivot > rank_tolerance * largest:
            break
        for i in range(m):
            r[i, k], r[i, chosen] = r[i, chosen], r[i, k]
        order[k], order[chosen] = order[chosen], order[k]
        if r[k, k] > 0.0:
            pivot = -pivot
        r[k, k] -= pivot  # the reflection's vector takes the column's place, up to the diagonal
        scale = 1.0 / (pivot * r[k, k])
        for j in range(k + 1, n):
            total = 0.0
            for i in range(k, m):
                total += r[i, k] * r[i, j]
            total *= scale
            for i in range(k, m):
                r[i, j] += total * r[i, k]
        total = 0.0
        for i in range(k, m):
            total += r[i, k] * b[i]
        total *= scale
        for i in range(k, m):
            b[i] += total * r[i, k]
        r[k, k] = pivot
        rank += 1
    # reflections from the right take rows [R₁₁ R₁₂] to [T 0], from the last row up; each acts on its own
    # diagonal and the columns past the rank
    factor = np.empty(rank)
    for k in range(rank - 1, -1, -1):
        length = r[k, k] * r[k, k]
        for j in range(rank, n):
            length += r[k, j] * r[k, j]
        length = math.copysign(math.sqrt(length), -r[k, k])
        head = r[k, k] - length
        factor[k] = head
        scale = 1.0 / (length * head)
        r[k, k] = length
        for i in range(k):
            total = r[i, k] * head
            for j in range(rank, n):
                total += r[i, j] * r[k, j]
            total *= scale
            r[i, k] += total * head
            for j in range(rank, n):
                r[i, j] += total * r[k, j]
    y = np.zeros(n)
    for k in range(rank - 1, -1, -1):
        total = b[k]
        for j in range(k + 1, rank):
            total -= r[k, j] * y[j]
        y[k] = total / r[k, k]
    for k in range(rank):  # y ← Z y
        total = y[k] * factor[k]
        for j in range(rank, n):
            total += y[j] * r[k, j]
        total /= r[k, k] * factor[k]
        y[k] += total * factor[k]
        for j in range(rank, n):
            y[j] += total * r[k, j]
    for k in range(n):
        x[order[k]] = y[k]
    return rank
