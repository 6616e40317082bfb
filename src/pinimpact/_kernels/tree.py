"""Factor and solve with the mass matrix of a kinematic tree, M = LᵀL, touching only ancestors.

L is lower triangular and L[i, j] ≠ 0 only where velocity j is an ancestor of velocity i (Featherstone,
Rigid Body Dynamics Algorithms, 2008, section 6.5).
"""

from __future__ import annotations

import math

from .jit import jit

EPS = 2.0**-52


@jit
def factor(mass, parents, free, lower):
    """Fill `lower` with L; its entries that are no ancestor's are left as they are.

    Args:
        mass: (nv, nv) M.
        parents: (nv,) the next velocity on the way to the root, or −1.
        free: (nv,) False where the velocity is locked: its row and column of M become the identity's.
        lower: (nv, nv) takes L.

    Returns:
        −1, or the first velocity whose inertia, with all that it carries free to move, is not positive.
    """
    n = mass.shape[0]
    for i in range(n):
        j = i
        while j >= 0:
            lower[i, j] = mass[i, j] if free[i] and free[j] else 0.0
            j = parents[j]
        if not free[i]:
            lower[i, i] = 1.0
    for k in range(n - 1, -1, -1):
        pivot = lower[k, k]
        if not (pivot > n * EPS * mass[k, k]) and free[k]:
            return k
        root = math.sqrt(pivot)
        lower[k, k] = root
        i = parents[k]
        while i >= 0:
            lower[k, i] /= root
            i = parents[i]
        i = parents[k]
        while i >= 0:
            x = lower[k, i]
            if x != 0.0:
                j = i
                while j >= 0:
                    lower[i, j] -= x * lower[k, j]
                    j = parents[j]
            i = parents[i]
    return -1


@jit
def solve_transposed(lower, parents, rhs):
    """Solve Lᵀ y = x in place for the columns of `rhs` (nv, m)."""
    m = rhs.shape[1]
    for i in range(lower.shape[0] - 1, -1, -1):
        moved = False
        for c in range(m):
            if rhs[i, c] != 0.0:
                moved = True
                rhs[i, c] /= lower[i, i]
        if moved:
            j = parents[i]
            while j >= 0:
                x = lower[i, j]
                for c in range(m):
                    rhs[j, c] -= x * rhs[i, c]
                j = parents[j]


@jit
def solve(lower, parents, rhs):
    """Solve L y = x in place for the columns of `rhs` (nv, m)."""
    m = rhs.shape[1]
    for i in range(lower.shape[0]):
        j = parents[i]
        while j >= 0:
            x = lower[i, j]
            for c in range(m):
                rhs[i, c] -= x * rhs[j, c]
            j = parents[j]
        for c in range(m):
            rhs[i, c] /= lower[i, i]
