"""Loops instead of NumPy's functions, which numba compiles in up to a second for each kind of array."""

from __future__ import annotations

import numpy as np

from .._compile.jit import inlined


@inlined
def assign(to, values):
    """Copy values (n,) into an array."""
    for i in range(len(to)):
        to[i] = values[i]


@inlined
def power(x, k):
    """Return xᵏ for an integer k ≥ 0."""
    found = 1.0
    while k > 0:
        if k % 2 == 1:
            found *= x
        k //= 2
        x *= x
    return found


@inlined
def filled(array, value):
    """Set all elements of an array (n,) to a value, and return it."""
    for i in range(len(array)):
        array[i] = value
    return array


@inlined
def ones(n):
    """Return (n,) ones."""
    return filled(np.empty(n), 1.0)


@inlined
def repeated(n, value):
    """Return (n,) times the same integer, one of NumPy's."""
    return filled(np.empty(n, dtype=np.int64), value)


@inlined
def flags(n, value):
    """Return (n,) times the same truth value."""
    return filled(np.empty(n, dtype=np.bool_), value)


@inlined
def nonzero(marks):
    """Return the indices of nonzero elements of an array (n,) of integers."""
    total = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            total += 1
    found = np.empty(total, dtype=np.int64)
    total = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            found[total] = i
            total += 1
    return found
