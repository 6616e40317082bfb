"""Loops that replace NumPy functions, whose compilation takes up to a second per type of array."""

from __future__ import annotations

import numpy as np

from .._compile.jit import inlined


@inlined
def assign(to, values):
    """Copy values (n,) into the array `to` (n,)."""
    for i in range(len(to)):
        to[i] = values[i]


@inlined
def power(x, k):
    """Return xᵏ for an integer k ≥ 0."""
    result = 1.0
    while k > 0:
        if k % 2 == 1:
            result *= x
        k //= 2
        x *= x
    return result


@inlined
def filled(array, value):
    """Set all elements of an array (n,) to a value, and return the array."""
    for i in range(len(array)):
        array[i] = value
    return array


@inlined
def largest(values):
    """Return the largest magnitude in an array (n,), zero if it is empty."""
    even = odd = 0.0  # independent, which is faster
    for i in range(0, len(values) - 1, 2):
        x, y = abs(values[i]), abs(values[i + 1])
        even = x if x > even else even
        odd = y if y > odd else odd
    if len(values) % 2 == 1:
        x = abs(values[len(values) - 1])
        even = x if x > even else even
    return odd if odd > even else even


@inlined
def largest_diagonal(matrix):
    """Return the largest magnitude on the diagonal of a matrix (n, n), zero if it is empty."""
    found = 0.0
    for i in range(len(matrix)):
        found = max(found, abs(matrix[i, i]))
    return found


@inlined
def ones(n):
    """Return an array (n,) of ones."""
    return filled(np.empty(n), 1.0)


@inlined
def repeated(n, value):
    """Return an array (n,) of int64 with one value."""
    return filled(np.empty(n, dtype=np.int64), value)


@inlined
def flags(n, value):
    """Return a boolean array (n,) with one value."""
    return filled(np.empty(n, dtype=np.bool_), value)


@inlined
def nonzero(marks):
    """Return the indices of the nonzero elements of an integer array (n,)."""
    total = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            total += 1
    result = np.empty(total, dtype=np.int64)
    total = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            result[total] = i
            total += 1
    return result
