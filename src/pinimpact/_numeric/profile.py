"""Products and linear systems of matrices in profile form: zeros at the start and end of each row."""

from __future__ import annotations

from .._compile.jit import external, inlined


@inlined
def apply_within(matrix, start, x, out):
    """Fill out (m,) with matrix (m, m) times x (m,); the matrix is symmetric, row a zero before start[a]."""
    for a in range(len(out)):
        total = matrix[a, a] * x[a]
        for b in range(start[a], a):
            total += matrix[a, b] * x[b]
            out[b] += matrix[a, b] * x[a]
        out[a] = total


@external
def eliminate_profile(system, last, x):
    """Replace x (m,) by the solution of a system, the matrix by its factors; return whether no pivot is zero.

    Row and column a are zero after last[a]. There is no pivoting, so the matrix should be nearly definite.
    """
    m = len(x)
    for k in range(m):
        pivot = system[k]
        if pivot[k] == 0.0:
            return False
        inverse = 1.0 / pivot[k]
        for a in range(k + 1, last[k] + 1):
            row = system[a]
            part = row[k] = row[k] * inverse
            if part != 0.0:
                for b in range(k + 1, last[k] + 1):
                    row[b] -= part * pivot[b]
    substitute_profile(system, last, x)
    return True


@external
def substitute_profile(factors, last, x):
    """Replace x (m,) by the solution of a system with the factors of `eliminate_profile`."""
    m = len(x)
    for k in range(m):
        for a in range(k + 1, last[k] + 1):
            x[a] -= factors[a, k] * x[k]
    for a in range(m - 1, -1, -1):
        total = x[a]
        for b in range(a + 1, last[a] + 1):
            total -= factors[a, b] * x[b]
        x[a] = total / factors[a, a]
