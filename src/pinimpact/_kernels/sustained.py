"""Forces of contacts that last: in a given mode by a linear system, and which mode holds by sweeps over the contacts.

Contacts have three rows (t₁, t₂, n) each. Scalar rows are a joint at its limit (force within [0, ∞)) or a joint
held by its dry friction (force within ±τ).
"""

from __future__ import annotations

import math

import numpy as np

from .jit import jit

FREE, SLIP, STICK, HELD = range(4)
RANK = 1e-10
"""Singular values below this part of the largest count as zero."""


@jit
def slip_direction(velocity, reference, still):
    """Return the direction of slip; signed to agree with `reference`, so that it passes smoothly through zero."""
    s = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    if s <= still:
        return reference[0], reference[1]
    if velocity[0] * reference[0] + velocity[1] * reference[1] < 0.0:
        s = -s
    return velocity[0] / s, velocity[1] / s


@jit
def constrain(
    minverse,
    acceleration,
    jacobians,
    free,
    velocity,
    mode,
    mu,
    reference,
    still,
    scalar_index,
    force,
    scalar_force,
):
    """Add the accelerations that the contact forces cause; all contacts and scalar rows given are active.

    Args:
        minverse: (nv, nv) M⁻¹.
        acceleration: (nv,) without contact forces; updated in place.
        jacobians: (nc, 3, nv) contact Jacobians.
        free: (nc, 3) contact accelerations without contact forces.
        velocity: (nc, 3) contact velocities.
        mode: (nc,) `SLIP`, `STICK` or `HELD`.
        mu: (nc,) friction coefficients.
        reference: (nc, 2) directions of slip.
        still: Speed [m/s] below which the direction of slip is `reference`.
        scalar_index: (ns,) velocity index of each scalar row.
        force: (nc, 3) takes the contact forces in contact axes [N].
        scalar_force: (ns,) takes the forces of the scalar rows [N or N m].

    Returns:
        The number of forces that are not unique (those of least norm are given; where one of them would pull
        although others need not, without it), and the least effective inverse inertia of a slipping contact
        over that without friction (at most zero: Painlevé's paradox).
    """
    n = len(acceleration)
    nc, ns = len(mode), len(scalar_index)
    size = ns
    for i in range(nc):
        size += 1 if mode[i] == SLIP else 3
    rows = np.zeros((size, n))
    columns = np.zeros((size, n))
    target = np.empty(size)
    directions = np.zeros((nc, 2))
    m = 0
    for i in range(nc):
        if mode[i] == SLIP:
            s1, s2 = slip_direction(velocity[i], reference[i], still)
            directions[i, 0], directions[i, 1] = s1, s2
            for j in range(n):
                rows[m, j] = jacobians[i, 2, j]
                columns[m, j] = jacobians[i, 2, j] - mu[i] * (
                    s1 * jacobians[i, 0, j] + s2 * jacobians[i, 1, j]
                )
            target[m] = -free[i, 2]
            m += 1
        else:
            for k in range(3):
                for j in range(n):
                    rows[m, j] = columns[m, j] = jacobians[i, k, j]
                target[m] = -free[i, k]
                m += 1
    for i in range(ns):
        j = scalar_index[i]
        rows[m, j] = columns[m, j] = 1.0
        target[m] = -acceleration[j]
        m += 1
    response = minverse @ columns.T
    system = rows @ response
    least = 1.0
    m = 0
    for i in range(nc):
        if mode[i] == SLIP:
            plain = 0.0
            for j in range(n):
                for k in range(n):
                    plain += rows[m, j] * minverse[j, k] * rows[m, k]
            if plain > 0.0:
                least = min(least, system[m, m] / plain)
            m += 1
        else:
            m += 3
    solution, _, rank, _ = np.linalg.lstsq(system, target, RANK)
    if rank < size:
        solution = without_pulling(system, target, solution, mode)
    for j in range(n):
        for m in range(size):
            acceleration[j] += response[j, m] * solution[m]
    m = 0
    for i in range(nc):
        if mode[i] == SLIP:
            force[i, 0] = -mu[i] * directions[i, 0] * solution[m]
            force[i, 1] = -mu[i] * directions[i, 1] * solution[m]
            force[i, 2] = solution[m]
            m += 1
        else:
            for k in range(3):
                force[i, k] = solution[m + k]
            m += 3
    for i in range(ns):
        scalar_force[i] = solution[m + i]
    return size - rank, least


@jit
def margin(mode, mu, force, lower, upper, scalar_force, allowance):
    """Return by how much the forces keep within Coulomb's law and the scalar bounds; below zero, they do not."""
    least = np.inf
    for i in range(len(mode)):
        if mode[i] == HELD:
            continue
        least = min(least, force[i, 2])
        if mode[i] == STICK:
            least = min(least, mu[i] * force[i, 2] - math.sqrt(force[i, 0] ** 2 + force[i, 1] ** 2))
    for i in range(len(lower)):
        least = min(least, scalar_force[i] - lower[i], upper[i] - scalar_force[i])
    return least + allowance


@jit
def without_pulling(system, target, solution, mode):
    """Return a solution in which no contact pulls, if dropping the pulling ones leaves the equations solved."""
    size = len(target)
    kept = np.ones(size)
    trial = solution
    scale = 1e-9 * (np.abs(target).max() + 1e-300)
    for _ in range(len(mode)):
        worst, row, m = 0.0, -1, 0
        for i in range(len(mode)):
            width = 1 if mode[i] == SLIP else 3
            normal = trial[m + width - 1]
            if mode[i] != HELD and kept[m] > 0.0 and normal < worst:
                worst, row = normal, m
                rows = width
            m += width
        if row < 0:
            return trial
        for k in range(rows):
            kept[row + k] = 0.0
        reduced = system * kept
        trial = np.linalg.lstsq(reduced, target, RANK)[0] * kept
        if np.abs(reduced @ trial - target).max() > scale:
            return solution
    return trial


@jit
def decide(delassus, free, velocity, mu, held, still, lower, upper, force, scalar_force, sweeps, tolerance):
    """Find forces that obey Coulomb's law at acceleration level, by projected sweeps.

    Args:
        delassus: (3 nc + ns, 3 nc + ns) of all contacts that touch, then the scalar rows.
        free: (3 nc + ns,) accelerations without forces.
        velocity: (nc, 2) tangential velocities; at most `still` is none.
        mu: (nc,) friction coefficients.
        held: (nc,) True for bilateral contacts.
        still: Speed [m/s].
        lower, upper: (ns,) bounds of the scalar forces.
        force: (nc, 3) start, and takes the forces.
        scalar_force: (ns,) likewise.
        sweeps: Their largest number.
        tolerance: Change of the forces, relative to the largest, at which to stop.

    Returns:
        The sweeps taken (or −1: they did not converge), and the contact where slip drives the surface in and no
        force exists (Painlevé), or −1.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    x = np.empty(size)
    for i in range(nc):
        for k in range(3):
            x[3 * i + k] = force[i, k]
    for i in range(ns):
        x[3 * nc + i] = scalar_force[i]
    for sweep in range(sweeps):
        change = largest = 0.0
        for i in range(nc):
            b = 3 * i
            c = delassus[b + 2, b + 2]
            if c <= 0.0:
                continue
            old1, old2, old3 = x[b], x[b + 1], x[b + 2]
            speed = math.sqrt(velocity[i, 0] ** 2 + velocity[i, 1] ** 2)
            if not held[i] and mu[i] > 0.0 and speed > still:
                s1, s2 = velocity[i, 0] / speed, velocity[i, 1] / speed
                effective = c - mu[i] * (s1 * delassus[b + 2, b] + s2 * delassus[b + 2, b + 1])
                a = free[b + 2]
                for j in range(size):
                    a += delassus[b + 2, j] * x[j]
                a -= effective * x[b + 2]
                if effective <= 1e-12 * c:
                    if a < 0.0:
                        return sweep, i
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
        if change <= tolerance * largest:
            for i in range(nc):
                for k in range(3):
                    force[i, k] = x[3 * i + k]
            for i in range(ns):
                scalar_force[i] = x[3 * nc + i]
            return sweep + 1, -1
    for i in range(nc):
        for k in range(3):
            force[i, k] = x[3 * i + k]
    for i in range(ns):
        scalar_force[i] = x[3 * nc + i]
    return -1, -1
