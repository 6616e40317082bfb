"""Loops in place of what NumPy does in one line: assigning slices and searching take numba a second each."""

from __future__ import annotations

import numpy as np

from .jit import inner


@inner
def assign(to, values):
    """Copy values (n,) into an array."""
    for i in range(len(to)):
        to[i] = values[i]


@inner
def nonzero(marks):
    """Return where an array (n,) of integers is not zero."""
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
