"""LU factorization with partial pivoting, for linear systems with several right-hand sides."""

from __future__ import annotations

from .._compile.declared import FLOAT_ROWS, INTEGERS, declared
from .._compile.jit import external, inlined
from .products import add

PANEL = 4
"""Number of pivots whose rows are subtracted from the other ones at once."""


@declared(FLOAT_ROWS, INTEGERS)
@external
def factorize(matrix, order):
    """Replace a matrix (m, n), m ≥ n, by LU factors, fill its row order (n,); return whether it is regular.

    Step k exchanges rows k and order[k]. A matrix that is not finite is not regular. The row order is always
    valid.
    """
    rows, size = matrix.shape
    for k in range(size):
        order[k] = k
    for first in range(0, size, PANEL):
        last = min(first + PANEL, size)
        for k in range(first, last):
            row = k
            for a in range(k + 1, rows):
                if abs(matrix[a, k]) > abs(matrix[row, k]):
                    row = a
            order[k] = row
            if not abs(matrix[row, k]) > 0.0:
                return False
            if row != k:
                for b in range(size):
                    matrix[k, b], matrix[row, b] = matrix[row, b], matrix[k, b]
            for a in range(k + 1, rows):
                matrix[a, k] /= matrix[k, k]
                for b in range(k + 1, last):
                    matrix[a, b] -= matrix[a, k] * matrix[k, b]
        for a in range(first + 1, last):
            for k in range(first, a):
                add(matrix[a, last:], -matrix[a, k], matrix[k, last:])
        if last < size:
            _subtract_panel(matrix, first, matrix, last, last, rows)
    return True


@inlined
def _subtract_panel(factors, first, rows, start, begin, end):
    """Subtract from rows `begin` … `end`, from column `start` on, the rows of a panel times their factors."""
    one, two, three, four = (
        *(rows[first, start:], rows[first + 1, start:]),
        *(rows[first + 2, start:], rows[first + 3, start:]),
    )
    for a in range(begin, end - 1, 2):  # two rows at a time are faster
        to, other = rows[a, start:], rows[a + 1, start:]
        x1, x2, x3, x4 = (
            *(factors[a, first], factors[a, first + 1]),
            *(factors[a, first + 2], factors[a, first + 3]),
        )
        y1, y2, y3, y4 = (
            *(factors[a + 1, first], factors[a + 1, first + 1]),
            *(factors[a + 1, first + 2], factors[a + 1, first + 3]),
        )
        for c in range(len(to)):
            to[c] -= x1 * one[c] + x2 * two[c] + x3 * three[c] + x4 * four[c]
            other[c] -= y1 * one[c] + y2 * two[c] + y3 * three[c] + y4 * four[c]
    if (end - begin) % 2 == 1:
        for k in range(first, first + PANEL):
            add(rows[end - 1, start:], -factors[end - 1, k], rows[k, start:])


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@external
def substitute(factors, order, right):
    """Replace right-hand sides (n, k) by the solutions (n, k), given the result of `factorize`."""
    size, columns = right.shape
    for a in range(size):
        if order[a] != a:
            for c in range(columns):
                right[a, c], right[order[a], c] = right[order[a], c], right[a, c]
    for first in range(0, size, PANEL):
        last = min(first + PANEL, size)
        for a in range(first + 1, last):
            for b in range(first, a):
                add(right[a], -factors[a, b], right[b])
        if last < size:
            _subtract_panel(factors, first, right, 0, last, size)
    for k in range((size - 1) // PANEL, -1, -1):
        first, last = k * PANEL, min(k * PANEL + PANEL, size)
        for a in range(last - 1, first - 1, -1):
            for b in range(a + 1, last):
                add(right[a], -factors[a, b], right[b])
            for c in range(columns):
                right[a, c] /= factors[a, a]
        if last - first == PANEL:
            _subtract_panel(factors, first, right, 0, 0, first)
        else:
            for a in range(first):
                for b in range(first, last):
                    add(right[a], -factors[a, b], right[b])
