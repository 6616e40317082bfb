"""The triangular factor of W = YYᵀ, Y = J L⁻¹, and the size of the terms that it is the sum of.

The rounding error of J is ε of the lengths and axes in the products of its columns, relative to the world's
origin; that of the solution of Lᵀ y = x is ε|Lᵀ||y|. Both reach Y through L⁻ᵀ, independently for each
velocity. (theory.md, 6)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.products import add, dot
from .tree import solve_transposed


@inlined
def _take_out(direction, row):
    """Subtract from a row its component along a unit direction; return the component."""
    part = dot(direction, row)
    add(row, -part, direction)
    return part


@inlined
def _normalize(row):
    """Divide a row by its length, and return the length."""
    length = math.sqrt(dot(row, row))
    if length > 0.0:
        for j in range(len(row)):
            row[j] /= length
    return length


@declared(FLOAT_ROWS, INTEGERS, FLOAT_COLUMNS, FLOATS, float, float, float, FLOAT_ROWS, FLOATS)
@jit
def delassus_factor(lower, parents, columns, signs, p1, p2, p3, y, out):
    """Compute the factor of W and its scale. (6.6)

    Args:
        lower: (nv, nv) L with M = LᵀL.
        parents: (nv,) next velocity towards the root, or −1.
        columns, signs: As for `contact_kinematics.jacobian`.
        p1, p2, p3: Contact point in world axes.
        y: (3, nv) Y.
        out: (FACTOR,) is overwritten with the factor, see `contact_space.inputs`.
    """
    n = len(signs)
    sizes, rows = np.zeros(n), np.empty((3, n))
    reach = math.sqrt(p1 * p1 + p2 * p2 + p3 * p3)
    for j in range(n):
        if signs[j] != 0.0:
            u1, u2, u3, w1, w2, w3 = (
                *(columns[0, j], columns[1, j], columns[2, j]),
                *(columns[3, j], columns[4, j], columns[5, j]),
            )
            turning = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
            sizes[j] = math.sqrt(u1 * u1 + u2 * u2 + u3 * u3) + reach * turning
    for k in range(n):
        size = abs(y[0, k]) + abs(y[1, k]) + abs(y[2, k])
        for i in range(3):
            rows[i, k] = y[i, k]
        j = k
        while j >= 0:
            sizes[j] += abs(lower[k, j]) * size
            j = parents[j]
    errors = np.zeros((n, n))
    for j in range(n):
        errors[j, j] = sizes[j]
    solve_transposed(lower, parents, errors)
    total = 0.0
    for row in errors:
        total += dot(row, row)
    out[0] = _normalize(rows[0])
    out[1] = _take_out(rows[0], rows[1])
    out[2] = _normalize(rows[1])
    out[3] = _take_out(rows[0], rows[2])
    out[4] = _take_out(rows[1], rows[2])
    out[5] = _normalize(rows[2])
    out[6] = math.sqrt(total)
