"""Which of several forces that obey Coulomb's law last. (theory.md, 11)

Where slip meets other constraints there may be three: between two that last one whose equations have a
negative determinant, from which any deviation grows.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.ahead import ahead
from ..._numeric.elimination import RANK, solve
from ..._numeric.jit import separate
from ..._numeric.loops import assign
from ..._numeric.products import apply
from .force_cones import SYSTEM, USABLE, forces_on_path, newton, scale

INSIDE = 1.0 - 1e-9
"""Part of the largest friction below which it holds, whatever rounding leaves of the acceleration."""

OPEN = 1e-14
"""Part of the largest force that rounding leaves of a contact that is open."""


@ahead(*SYSTEM, result=int)
@separate
def orientation(delassus, free, velocity, mu, held, lower, upper, x):
    """Return the sign of the determinant of the equations (9.3) that forces x solve, zero where singular."""
    nc, ns, size = len(mu), len(lower), len(x)
    row, pushes, response = np.empty(size, dtype=np.int64), np.zeros((size, size)), np.empty((size, size))
    n, largest = 0, 0.0
    for force in x:
        largest = max(largest, abs(force))
    for i in range(nc):
        b, fn = 3 * i, x[3 * i + 2]
        if not held[i] and not fn > OPEN * largest:
            continue
        tangent = math.hypot(x[b], x[b + 1])
        rubs = velocity[i, 0] != 0.0 or velocity[i, 1] != 0.0 or not tangent < INSIDE * mu[i] * fn
        if rubs and not held[i]:
            for d in range(3):
                pushes[n, b + d] = x[b + d] / fn
            row[n] = b + 2
            n += 1
            continue
        for d in range(3):
            row[n], pushes[n, b + d] = b + d, 1.0
            n += 1
    for i in range(ns):
        b = 3 * nc + i
        if INSIDE * lower[i] < x[b] < INSIDE * upper[i]:
            row[n], pushes[n, b] = b, 1.0
            n += 1
    system = np.empty((n, n))
    for c in range(n):
        apply(delassus, pushes[c], response[c])
    for r in range(n):
        for c in range(n):
            unit = math.sqrt(delassus[row[r], row[r]] * delassus[row[c], row[c]])
            system[r, c] = response[c, row[r]] / unit if unit > 0.0 else 0.0
    return solve(system, np.zeros(n), np.empty(n), RANK)


@ahead(*SYSTEM)
@separate
def take_lasting(delassus, free, velocity, mu, held, lower, upper, x):
    """Replace forces x of a negative determinant by others that last, if such are found.

    Lemke's path leads to a solution of a positive determinant. (M. J. Todd, Mathematics of Operations
    Research 1, 1976) Else one thing after the other lets go, and Newton's method goes on from there.
    """
    if orientation(delassus, free, velocity, mu, held, lower, upper, x) >= 0:
        return
    nc, ns, size = len(mu), len(lower), len(x)
    d, scale_a, scale_f, a_now = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    scale(delassus, free, nc, d, scale_a, scale_f)
    trial = x.copy()
    worst = forces_on_path(
        delassus, free, velocity, mu, held, lower, upper, trial, a_now, d, scale_a, scale_f
    )
    if worst <= USABLE and orientation(delassus, free, velocity, mu, held, lower, upper, trial) > 0:
        assign(x, trial)
        return
    for k in range(nc + 2 * ns):
        assign(trial, x)
        if k < nc:
            trial[3 * k] = trial[3 * k + 1] = trial[3 * k + 2] = 0.0
        else:
            i = (k - nc) // 2
            bound = lower[i] if (k - nc) % 2 == 0 else upper[i]
            if abs(bound) == math.inf:
                continue
            trial[3 * nc + i] = bound
        worst = newton(delassus, free, velocity, mu, held, lower, upper, trial, a_now, scale_a, scale_f)
        if worst <= USABLE and orientation(delassus, free, velocity, mu, held, lower, upper, trial) > 0:
            assign(x, trial)
            return
