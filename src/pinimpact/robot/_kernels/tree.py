"""Factorization and solution with the mass matrix of a kinematic tree, M = LᵀL, using ancestors only.

L is lower triangular and L[i, j] ≠ 0 only where velocity j is an ancestor of velocity i (Featherstone,
Rigid Body Dynamics Algorithms, 2008, section 6.5).
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, INTEGERS, declared
from ..._compile.jit import external, jit
from ..._numeric.products import add
from ..._numeric.tolerances import EPS

KNOWN = 10.0
"""Least ratio of the inertia that velocity k moves, with all others free, to the rounding error n ε M_kk of
M_kk; the inertia is then accurate to a tenth. (1.9)"""


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@jit
def factor(mass, parents, lower):
    """Compute L of M (nv, nv).

    Args:
        mass: (nv, nv) M.
        parents: (nv,) next velocity towards the root, or −1.
        lower: (nv, nv) is overwritten with L, except for entries of velocities that are not ancestors.

    Returns:
        −1, or the index of a velocity whose inertia, with all others free, is zero within rounding. (1.9)
    """
    n, growth = mass.shape[0], 1.0
    for i in range(n):
        j = i
        while j >= 0:
            lower[i, j] = mass[i, j]
            j = parents[j]
    for k in range(n - 1, -1, -1):
        pivot = lower[k, k]
        if not pivot > 0.0:
            return k
        growth *= mass[k, k] / pivot
        root = math.sqrt(pivot)
        inverse = 1.0 / root
        lower[k, k] = root
        i = parents[k]
        while i >= 0:
            lower[k, i] *= inverse
            i = parents[i]
        i = parents[k]
        while i >= 0:
            x = lower[k, i]
            j = i
            while j >= 0:
                lower[i, j] -= x * lower[k, j]
                j = parents[j]
            i = parents[i]
    if math.e * growth * KNOWN * n * EPS < 1.0:  # M_kk (M⁻¹)_kk ≤ e · growth, from the determinant
        return -1
    return _without_inertia(mass, parents, lower)


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS, result=int)
@external
def _without_inertia(mass, parents, lower):
    """Return the index k of the largest M_kk (M⁻¹)_kk if it violates (1.9), else −1."""
    n = mass.shape[0]
    growth, row = np.empty(n), np.empty(n)
    found, most = -1, 1.0 / (KNOWN * n * EPS)
    for k in range(n):
        before = parents[k]
        growth[k] = mass[k, k] / lower[k, k] ** 2 * (growth[before] if before >= 0 else 1.0)
        if math.e * growth[k] < most:  # only ancestors matter
            continue
        i = k
        while i >= 0:
            row[i] = 0.0
            i = parents[i]
        row[k], total, i = mass[k, k] ** 0.5, 0.0, k
        while i >= 0:  # L⁻ᵀ of a unit vector
            x = row[i] / lower[i, i]
            total += x * x
            j = parents[i]
            while j >= 0:
                row[j] -= x * lower[i, j]
                j = parents[j]
            i = parents[i]
        if not total < most:
            found, most = k, total
    return found


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@jit
def solve_transposed(lower, parents, rows):
    """Solve Lᵀ y = x in place for each row x (nv,) of `rows` (m, nv)."""
    for row in rows:
        for i in range(len(row) - 1, -1, -1):
            if row[i] != 0.0:
                x = row[i] / lower[i, i]
                row[i] = x
                j = parents[i]
                while j >= 0:
                    row[j] -= x * lower[i, j]
                    j = parents[j]


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@jit
def solve(lower, parents, rows):
    """Solve L y = x in place for each row x (nv,) of `rows` (m, nv)."""
    for row in rows:
        for i in range(len(row)):
            x = row[i]
            j = parents[i]
            while j >= 0:
                x -= lower[i, j] * row[j]
                j = parents[j]
            row[i] = x / lower[i, i]


@declared(FLOAT_ROWS, INTEGERS, FLOAT_ROWS)
@jit
def solve_mass(lower, parents, columns):
    """Solve M y = x in place for each column x (nv,) of `columns` (nv, m)."""
    n, m = columns.shape
    for i in range(n - 1, -1, -1):
        inverse = 1.0 / lower[i, i]
        for k in range(m):
            columns[i, k] *= inverse
        j = parents[i]
        while j >= 0:
            add(columns[j], -lower[i, j], columns[i])
            j = parents[j]
    for i in range(n):
        j = parents[i]
        while j >= 0:
            add(columns[i], -lower[i, j], columns[j])
            j = parents[j]
        inverse = 1.0 / lower[i, i]
        for k in range(m):
            columns[i, k] *= inverse
