"""Solution of square linear systems by elimination with complete pivoting."""

from __future__ import annotations

import numpy as np

from .._compile.declared import FLOAT_ROWS, FLOATS, declared
from .._compile.jit import external
from .loops import largest
from .products import add
from .tolerances import RANK as RANK  # re-exported


@declared(FLOAT_ROWS, FLOATS, FLOATS, float)
@external
def solve(system, target, solution, rank):
    """Solve system (n, n) · solution = target (n,); return the sign of the determinant.

    If a pivot is at most `rank` times the largest one, the sign is zero and `solution` is not filled.
    """
    size = len(target)
    matrix = system.copy()
    right = target.copy()
    order = np.empty(size, dtype=np.int64)
    for k in range(size):
        order[k] = k
    most = 0.0
    sign = 1
    for k in range(size):
        pivot, row, col = 0.0, k, k
        for a in range(k, size):
            found = largest(matrix[a, k:])
            if found > pivot:
                pivot, row = found, a
        for b in range(size - 1, k - 1, -1):
            if abs(matrix[row, b]) == pivot:
                col = b
        most = max(most, pivot)
        if not pivot > rank * most:
            return 0
        if (matrix[row, col] < 0.0) != ((row != k) != (col != k)):
            sign = -sign
        if row != k:
            for b in range(size):
                matrix[k, b], matrix[row, b] = matrix[row, b], matrix[k, b]
            right[k], right[row] = right[row], right[k]
        if col != k:
            for a in range(size):
                matrix[a, k], matrix[a, col] = matrix[a, col], matrix[a, k]
            order[k], order[col] = order[col], order[k]
        for a in range(k + 1, size):
            factor = matrix[a, k] / matrix[k, k]
            add(matrix[a, k + 1 :], -factor, matrix[k, k + 1 :])
            right[a] -= factor * right[k]
    for k in range(size - 1, -1, -1):
        total = right[k]
        for b in range(k + 1, size):
            total -= matrix[k, b] * solution[order[b]]
        solution[order[k]] = total / matrix[k, k]
    return sign
