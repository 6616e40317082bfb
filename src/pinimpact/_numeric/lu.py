"""Square linear systems for several right-hand sides: factored once, with partial pivoting."""

from __future__ import annotations

from .._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from .._compile.jit import external


@declared(FLOAT_ROWS, INTEGERS)
@external
def factorize(matrix, order):
    """Replace a matrix by its factors L and U, fill the order of its rows; return whether it is regular."""
    size = len(order)
    for k in range(size):
        row = k
        for a in range(k + 1, size):
            if abs(matrix[a, k]) > abs(matrix[row, k]):
                row = a
        order[k] = row
        if not abs(matrix[row, k]) > 0.0:
            return False
        if row != k:
            for b in range(size):
                matrix[k, b], matrix[row, b] = matrix[row, b], matrix[k, b]
        for a in range(k + 1, size):
            matrix[a, k] /= matrix[k, k]
            for b in range(k + 1, size):
                matrix[a, b] -= matrix[a, k] * matrix[k, b]
    return True


@declared(FLOAT_ROWS, INTEGERS, FLOATS)
@external
def substitute(factors, order, right):
    """Replace a right-hand side by the solution of the system that was factored."""
    size = len(order)
    for k in range(size):
        right[k], right[order[k]] = right[order[k]], right[k]
    for a in range(size):
        for b in range(a):
            right[a] -= factors[a, b] * right[b]
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            right[a] -= factors[a, b] * right[b]
        right[a] /= factors[a, a]
