"""Forces of what touches, by Lemke's pivots.

The forces need not be found downhill: joints that their dry friction holds can make slip drive the surface in
until one of them yields, and of contacts that begin to slip together each changes where the others slip to.
With w = q + M y ≥ 0, y ≥ 0, wᵀy = 0 the pivots follow the solutions of w = q + M y + d z from a large z to
z = 0. Friction at rest is a sum of pushes along the sides of a polygon, y_k ≥ 0, of which those act that go
against the acceleration the most, with λ ≥ 0 the largest of −d_kᵀa_t. (13.6)

A force between bounds is y above the lower one, with a row of its own for the upper one. Both kinds of
further rows have no d; then the path ends only where slip drives the surface in with every joint yielding.
(Cottle, Pang, Stone, The Linear Complementarity Problem, section 4.4)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.ahead import FLAGS, FLOAT_ROWS, FLOATS, ahead
from ..._compile.jit import inner, separate
from ..._numeric.loops import flags, repeated
from ..._numeric.products import apply

LEAST = 1e-11
"""Pivots, and rates of slip, below this are none, of rows whose largest entries are about 1."""

PIVOTS = 20
"""Pivots at most, over the number of rows."""


@ahead(FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLOATS, int, FLOATS)
@separate
def forces_by_pivots(delassus, free, velocity, mu, held, lower, upper, sides, x):
    """Fill x with forces, cones of friction with so many sides; return whether the pivots come to an end.

    Other arguments as in `force_sweeps`, with W scaled to a diagonal of about 1.
    """
    nc, ns, size = len(mu), len(lower), len(free)
    most = nc * (sides + 1) + 2 * nc + ns
    room, limit, normal, sticks = np.empty(most), np.zeros(most), repeated(most, -1), flags(most, False)
    pushes, feels = np.zeros((most, size)), np.zeros((most, size))  # force by force, and the row of each
    cone = np.empty(nc, dtype=np.int64)
    acceleration, response = np.empty(size), np.empty((most, size))
    for a in range(size):
        x[a] = 0.0
    for r in range(most):
        room[r] = math.inf
    n = cones = 0
    for i in range(nc):
        b, speed = 3 * i, math.hypot(velocity[i, 0], velocity[i, 1])
        pushes[n, b + 2] = feels[n, b + 2] = 1.0
        sticks[n] = held[i]
        n += 1
        if held[i]:
            for d in range(2):
                sticks[n], pushes[n, b + d], feels[n, b + d] = True, 1.0, 1.0
                n += 1
        elif speed > 0.0:
            for d in range(2):
                pushes[n - 1, b + d] = -mu[i] * velocity[i, d] / speed
        elif mu[i] > 0.0:
            cone[cones], first, limit[n - 1] = i, n - 1, mu[i]
            cones += 1
            for k in range(sides):
                angle = 2.0 * math.pi * k / sides
                pushes[n, b] = feels[n, b] = math.cos(angle)
                pushes[n, b + 1] = feels[n, b + 1] = math.sin(angle)
                normal[n] = first
                n += 1
    boxes = 0
    for i in range(ns):
        b, sign = 3 * nc + i, 1.0
        room[n] = upper[i] - lower[i]
        sticks[n] = lower[i] == -math.inf and upper[i] == math.inf
        if lower[i] > -math.inf:
            x[b] = lower[i]
        elif upper[i] < math.inf:
            x[b], sign = upper[i], -1.0
        pushes[n, b] = feels[n, b] = sign
        boxes += room[n] < math.inf
        n += 1
    # columns: w, y, z, q
    rows = n + cones + boxes
    z, q, table = 2 * rows, 2 * rows + 1, np.zeros((rows, 2 * rows + 2))
    basis, fixed = repeated(rows, 0), flags(rows, False)
    for r in range(rows):
        basis[r], table[r, r] = r, 1.0
    apply(delassus, x, acceleration)
    for c in range(n):
        apply(delassus, pushes[c], response[c])
    more = n
    for r in range(n):
        for a in range(size):
            table[r, q] += feels[r, a] * (free[a] + acceleration[a])
            for c in range(n):
                table[r, rows + c] -= feels[r, a] * response[c, a]
        table[r, z] = 0.0 if sticks[r] else -1.0
        fixed[r] = sticks[r]
        i = normal[r]
        if i >= 0:
            if normal[r - 1] != i:
                table[more, rows + i] = -limit[i]
                more += 1
            table[r, rows + more - 1], table[more - 1, rows + r] = -1.0, 1.0
    for r in range(n):
        if room[r] < math.inf:
            table[r, rows + more], table[more, rows + r], table[more, q] = -1.0, 1.0, room[r]
            more += 1
    for _ in range(n):  # what is held
        largest, best, column = LEAST, -1, -1
        for r in range(n):
            if sticks[r] and basis[r] < rows:
                for c in range(n):
                    if sticks[c] and abs(table[r, rows + c]) > largest:
                        largest, best, column = abs(table[r, rows + c]), r, rows + c
        if best < 0:
            break
        exchange(table, basis, best, column)
    lowest, leaving = 0.0, -1
    for r in range(rows):
        if not fixed[r] and table[r, z] < 0.0 and table[r, q] < lowest:
            lowest, leaving = table[r, q], r
    entering = z
    for _ in range(PIVOTS * rows):
        if leaving < 0:
            break
        left = basis[leaving]
        exchange(table, basis, leaving, entering)
        leaving = -1
        if left == z:
            break
        entering = left + rows if left < rows else left - rows
        least = math.inf
        for r in range(rows):
            if not fixed[r] and table[r, entering] > LEAST:
                ratio = table[r, q] / table[r, entering]
                if ratio < least or (ratio == least and basis[r] == z):
                    least, leaving = ratio, r
        if leaving < 0:
            return False
    for r in range(rows):
        if basis[r] == z:
            return False
        c = basis[r] - rows
        if 0 <= c < n:
            for a in range(size):
                x[a] += pushes[c, a] * table[r, q]
    for r in range(rows):
        c = basis[r] - rows
        if n <= c < n + cones and table[r, q] > LEAST:  # it slips: its force is on the cone itself
            i = cone[c - n]
            b, length = 3 * i, math.hypot(x[3 * i], x[3 * i + 1])
            for d in range(2):
                x[b + d] *= mu[i] * x[b + 2] / length if length > 0.0 else 1.0
    return True


@inner
def exchange(table, basis, row, column):
    """Let a column enter the basis in a row."""
    pivot = table[row, column]
    for b in range(table.shape[1]):
        table[row, b] /= pivot
    for a in range(len(table)):
        factor = table[a, column]
        if a != row and factor != 0.0:
            for b in range(table.shape[1]):
                table[a, b] -= factor * table[row, b]
    basis[row] = column
