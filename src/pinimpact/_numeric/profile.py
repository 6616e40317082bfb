"""Symmetric matrices whose rows have zeros at their beginnings, and definite systems with them."""

from __future__ import annotations

import math

from .._compile.jit import external, inlined


@inlined
def apply_within(matrix, start, x, out):
    """Fill out (m,) with a symmetric matrix times x, whose row a is zero before start[a]."""
    for a in range(len(out)):
        total = matrix[a, a] * x[a]
        for b in range(start[a], a):
            total += matrix[a, b] * x[b]
            out[b] += matrix[a, b] * x[a]
        out[a] = total


@external
def solve_profile(system, last, x):
    """Replace x by the solution of a definite system, the matrix by its factor U; row a ends at last[a].

    Only the upper triangle is used.
    """
    m = len(x)
    for k in range(m):
        pivot = system[k]
        root = 1.0 / math.sqrt(max(pivot[k], 1e-300))
        for b in range(k, last[k] + 1):
            pivot[b] *= root
        x[k] /= pivot[k]
        for a in range(k + 1, last[k] + 1):
            part = pivot[a]
            if part != 0.0:
                row = system[a]
                for b in range(a, last[k] + 1):
                    row[b] -= part * pivot[b]
                x[a] -= part * x[k]
    for a in range(m - 1, -1, -1):
        total = x[a]
        for b in range(a + 1, last[a] + 1):
            total -= system[a, b] * x[b]
        x[a] = total / system[a, a]
