"""Forces of slipping contacts and scalar rows, by Lemke's pivots.

Where contacts slip the forces need not be found downhill: joints that their dry friction holds can make slip
drive the surface in until one of them yields. With w = q + M y ≥ 0, y ≥ 0, wᵀy = 0 the pivots follow the
solutions of w = q + M y + d z from a large z to z = 0. A force between bounds is y above the lower one, with
a row of its own for the upper one, of which d is zero; then the path ends only where slip drives the surface
in with every joint yielding. (Cottle, Pang, Stone, The Linear Complementarity Problem, section 4.4)
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.ahead import FLAGS, FLOAT_ROWS, FLOATS, ahead
from ..._numeric.jit import inner, separate
from ..._numeric.loops import flags, ones, repeated

LEAST = 1e-11
"""Pivots below this, of rows whose largest entries are about 1, are none."""

PIVOTS = 20
"""Pivots at most, over the number of rows."""


@ahead(FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLOATS, FLOATS)
@separate
def forces_by_pivots(delassus, free, velocity, mu, held, lower, upper, x):
    """Fill x with forces, all that may stick taken to stick; return whether the pivots have come to an end.

    Arguments as in `force_sweeps`, with W scaled to a diagonal of about 1.
    """
    nc, ns, size = len(mu), len(lower), len(free)
    row, sign, room = repeated(size, 0), ones(size), np.empty(size)
    sticks, pushes = flags(size, False), np.zeros((size, size))  # force by force
    n = 0
    for i in range(nc):
        b, speed = 3 * i, math.hypot(velocity[i, 0], velocity[i, 1])
        if held[i] or (mu[i] > 0.0 and speed == 0.0):
            for d in range(3):
                row[n], sticks[n], pushes[n, b + d] = b + d, True, 1.0
                n += 1
            continue
        row[n], pushes[n, b + 2] = b + 2, 1.0
        for d in range(2):
            pushes[n, b + d] = -mu[i] * velocity[i, d] / speed if speed > 0.0 else 0.0
        n += 1
    boxes = 0
    for a in range(size):
        x[a], room[a] = 0.0, math.inf
    for i in range(ns):
        b = 3 * nc + i
        row[n], room[n] = b, upper[i] - lower[i]
        sticks[n] = lower[i] == -math.inf and upper[i] == math.inf
        if lower[i] > -math.inf:
            x[b] = lower[i]
        elif upper[i] < math.inf:
            x[b], sign[n] = upper[i], -1.0
        pushes[n, b] = sign[n]
        boxes += room[n] < math.inf
        n += 1
    # columns: w, y, z, q
    rows = n + boxes
    z, q, table = 2 * rows, 2 * rows + 1, np.zeros((rows, 2 * rows + 2))
    basis, fixed = repeated(rows, 0), flags(rows, False)
    for r in range(rows):
        basis[r] = r
    box = n
    for r in range(n):
        acceleration = free[row[r]]
        for a in range(size):
            acceleration += delassus[row[r], a] * x[a]
        table[r, r], table[r, q] = 1.0, sign[r] * acceleration
        table[r, z] = 0.0 if sticks[r] else -1.0
        fixed[r] = sticks[r]
        for c in range(n):
            for a in range(size):
                table[r, rows + c] -= sign[r] * delassus[row[r], a] * pushes[c, a]
        if room[r] < math.inf:
            table[r, rows + box] = -1.0
            table[box, box] = table[box, rows + r] = 1.0
            table[box, q] = room[r]
            box += 1
    for _ in range(n):  # what sticks
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
