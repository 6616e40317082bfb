"""Forces that obey Coulomb's law and bounds, whatever the modes, by projected Gauss–Seidel iterations.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import jit

ITERATIONS = 200
"""The largest number of iterations."""

TOLERANCE = 1e-12
"""Change of the forces in an iteration, relative to the largest, at which to stop."""


@declared(FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLAGS, FLOATS, FLOATS, FLOAT_ROWS, FLOATS)
@jit
def forces_by_gauss_seidel(delassus, free, velocity, mu, held, lower, upper, force, scalar_force):
    """Find forces that obey Coulomb's law at acceleration level, by projected Gauss–Seidel iterations.

    Args:
        delassus: (3 nc + ns, 3 nc + ns) of all contacts that touch, then of the scalar rows.
        free: (3 nc + ns,) accelerations without forces.
        velocity: (nc, 2) velocities of slip, zero for a contact that may stick.
        mu: (nc,) friction coefficients.
        held: (nc,) True for bilateral contacts.
        lower, upper: (ns,) bounds of the scalar forces.
        force: (nc, 3) start, and takes the forces.
        scalar_force: (ns,) likewise.

    Returns:
        The iterations taken (or −1: no convergence), and a contact with negative normal acceleration at which
        no force exists (Painlevé), or −1.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    x = np.empty(size)
    for i in range(nc):
        for k in range(3):
            x[3 * i + k] = force[i, k]
    for i in range(ns):
        x[3 * nc + i] = scalar_force[i]
    taken = -1
    for iteration in range(ITERATIONS):
        change = largest = 0.0
        for i in range(nc):
            b = 3 * i
            c = delassus[b + 2, b + 2]
            if c <= 0.0:
                continue
            old1, old2, old3 = x[b], x[b + 1], x[b + 2]
            speed = math.sqrt(velocity[i, 0] ** 2 + velocity[i, 1] ** 2)
            if not held[i] and mu[i] > 0.0 and speed > 0.0:
                s1, s2 = velocity[i, 0] / speed, velocity[i, 1] / speed
                effective = c - mu[i] * (s1 * delassus[b + 2, b] + s2 * delassus[b + 2, b + 1])
                a = free[b + 2]
                for j in range(size):
                    a += delassus[b + 2, j] * x[j]
                a -= effective * x[b + 2]
                if effective <= 1e-12 * c:
                    if a < 0.0:
                        return iteration, i
                    x[b + 2] = 0.0  # of several solutions, the contact that opens
                else:
                    x[b + 2] = max(0.0, -a / effective)
                x[b], x[b + 1] = -mu[i] * x[b + 2] * s1, -mu[i] * x[b + 2] * s2
            else:
                a = free[b + 2]
                for j in range(size):
                    a += delassus[b + 2, j] * x[j]
                x[b + 2] = x[b + 2] - a / c if held[i] else max(0.0, x[b + 2] - a / c)
                if mu[i] > 0.0 or held[i]:
                    a1, a2 = free[b], free[b + 1]
                    for j in range(size):
                        a1 += delassus[b, j] * x[j]
                        a2 += delassus[b + 1, j] * x[j]
                    trace = delassus[b, b] + delassus[b + 1, b + 1]
                    if trace > 1e-14 * c:
                        x[b] -= a1 / trace
                        x[b + 1] -= a2 / trace
                    limit = mu[i] * x[b + 2]
                    size_t = math.sqrt(x[b] ** 2 + x[b + 1] ** 2)
                    if not held[i] and size_t > limit:
                        x[b] *= limit / size_t
                        x[b + 1] *= limit / size_t
                else:
                    x[b] = x[b + 1] = 0.0
            change = max(change, abs(x[b] - old1), abs(x[b + 1] - old2), abs(x[b + 2] - old3))
            largest = max(largest, abs(x[b]), abs(x[b + 1]), abs(x[b + 2]))
        for i in range(ns):
            b = 3 * nc + i
            a = free[b]
            for j in range(size):
                a += delassus[b, j] * x[j]
            old = x[b]
            x[b] = min(max(x[b] - a / delassus[b, b], lower[i]), upper[i])
            change = max(change, abs(x[b] - old))
            largest = max(largest, abs(x[b]))
        if not largest < math.inf:  # with negative normal acceleration they may grow without bound
            break
        if change <= TOLERANCE * largest:
            taken = iteration + 1
            break
    for i in range(nc):
        for k in range(3):
            force[i, k] = x[3 * i + k]
    for i in range(ns):
        scalar_force[i] = x[3 * nc + i]
    return taken, -1
