"""LU factorization with partial pivoting, for linear systems with several right-hand sides."""

from __future__ import annotations

from .._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from .._compile.jit import external
from .products import add


@declared(FLOAT_ROWS, INTEGERS)
@external
def factorize(matrix, order):
    """Replace a matrix (n, n) by its LU factors, fill its row order (n,); return whether it is regular.

    A matrix that is not finite is not regular. The row order is always valid.
    """
    size = len(order)
    for k in range(size):
        order[k] = k
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
            add(matrix[a, k + 1 :], -matrix[a, k], matrix[k, k + 1 :])
    return True


@declared(FLOAT_ROWS, INTEGERS, FLOATS)
@external
def substitute(factors, order, right):
    """Replace a right-hand side (n,) by the solution, given the result of `factorize`."""
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


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@external
def substitute_all(factors, order, right):
    """Replace right-hand sides (n, k) by the solutions (n, k), given the result of `factorize`."""
    size, columns = right.shape
    for a in range(size):
        for c in range(columns):
            right[a, c], right[order[a], c] = right[order[a], c], right[a, c]
    for a in range(size):
        for b in range(a):
            add(right[a], -factors[a, b], right[b])
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            add(right[a], -factors[a, b], right[b])
        for c in range(columns):
            right[a, c] /= factors[a, a]
