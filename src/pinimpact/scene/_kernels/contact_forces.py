"""Forces of contacts that last: in given modes by a linear system, and which modes hold by sweeps.

Contacts have three rows (t₁, t₂, n) each. Scalar rows are a joint at its limit (force within [0, ∞)) or a
joint held by its dry friction (force within ±τ).
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner, jit
from ..._numeric.products import apply, products

FREE, SLIP, STICK, HELD = range(4)
SINGULAR_STILL = 1e-7
"""The same where singular values have been below `RANK`, lest a motion along the edge goes to and fro."""

RIGID = 1e-14
"""Rows whose effective inverse inertia is below this part of the largest do not move."""


@inner
def slip_direction(velocity, reference, still):
    """Return the direction of slip, signed to agree with `reference`: smooth where the slip reverses."""
    s = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    if s <= still:
        return reference[0], reference[1]
    if velocity[0] * reference[0] + velocity[1] * reference[1] < 0.0:
        s = -s
    return velocity[0] / s, velocity[1] / s


@inner
def joint_forces(velocity, control, damping, dry, tau, powers):
    """Fill τ = control − damping q̇ − dry friction, and the powers of the control and in the joints."""
    given = taken = 0.0
    for j in range(len(velocity)):
        lost = damping[j] * velocity[j] + dry[j]
        tau[j] = control[j] - lost
        given += control[j] * velocity[j]
        taken -= lost * velocity[j]
    powers[0], powers[1] = given, taken


@inner
def assemble(
    minverse,
    acceleration,
    jacobians,
    free,
    velocity,
    mode,
    mu,
    reference,
    still,
    index,
    directions,
    rows,
    response,
    system,
    target,
):
    """Set up the equations of the closed contacts and scalar rows.

    Args:
        minverse: (nv, nv) M⁻¹.
        acceleration: (nv,) without contact forces.
        jacobians: (nc, 3, nv) contact Jacobians.
        free: (nc, 3) contact accelerations without contact forces.
        velocity: (nc, 3) contact velocities.
        mode: (nc,) `SLIP`, `STICK` or `HELD`.
        mu: (nc,) friction coefficients.
        reference: (nc, 2) directions of slip.
        still: Speed [m/s] below which the direction of slip is `reference`.
        index: (ns,) velocity index of each scalar row.
        directions: (nc, 2) takes the directions of slip.
        rows: (m, nv) takes the rows whose acceleration becomes zero: one of a slipping contact, else three.
        response: (m, nv) takes M⁻¹ times the direction in which each row's force acts.
        system: (m, m) takes the equations; target: (m,) their right-hand side.

    Returns:
        The least effective inverse inertia of a slipping contact over that without friction (at most zero:
        Painlevé's paradox).
    """
    n, size = len(acceleration), len(rows)
    column = np.empty(n)
    least = 1.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            s1, s2 = slip_direction(velocity[i], reference[i], still)
            directions[i, 0], directions[i, 1] = s1, s2
            plain = effective = 0.0
            for j in range(n):
                rows[m, j] = jacobians[i, 2, j]
                column[j] = rows[m, j] - mu[i] * (s1 * jacobians[i, 0, j] + s2 * jacobians[i, 1, j])
            for j in range(n):
                total = along = 0.0
                for k in range(n):
                    total += minverse[j, k] * column[k]
                    along += minverse[j, k] * rows[m, k]
                response[m, j] = total
                effective += rows[m, j] * total
                plain += rows[m, j] * along
            if plain > 0.0:
                least = min(least, effective / plain)
            target[m] = -free[i, 2]
            m += 1
        else:
            for d in range(3):
                for j in range(n):
                    rows[m, j] = jacobians[i, d, j]
                apply(minverse, rows[m], response[m])
                target[m] = -free[i, d]
                m += 1
    for i in range(len(index)):
        for j in range(n):
            rows[m, j] = 0.0
            response[m, j] = minverse[j, index[i]]
        rows[m, index[i]] = 1.0
        target[m] = -acceleration[index[i]]
        m += 1
    products(rows, response, system)
    largest = 0.0
    for a in range(size):
        largest = max(largest, abs(system[a, a]))
    for a in range(size):
        if abs(system[a, a]) <= RIGID * largest:  # nothing moves this way (across a planar robot): no force
            system[a, :] = 0.0
            system[:, a] = 0.0
            system[a, a] = largest
            target[a] = 0.0
    return least


@inner
def finish(
    solution,
    response,
    directions,
    velocity,
    surface,
    mode,
    mu,
    lower,
    upper,
    acceleration,
    force,
    scalar,
    powers,
):
    """Add the accelerations that the forces cause, and fill the forces and their powers.

    Args:
        solution: (m,) forces of the rows; then as in `assemble`.
        surface: (nc, 3) velocities of the surfaces.
        lower, upper: (ns,) bounds of the scalar forces.
        acceleration: (nv,) updated.
        force: (nc, 3) takes the contact forces in contact axes [N].
        scalar: (ns,) takes the forces of the scalar rows.
        powers: (2,) takes the powers of sliding friction and of moving surfaces [W].

    Returns:
        By how much the forces keep within Coulomb's law and the bounds; below zero, they do not.
    """
    for m in range(len(solution)):
        for j in range(len(acceleration)):
            acceleration[j] += response[m, j] * solution[m]
    margin = np.inf
    rubbed = carried = 0.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            force[i, 0] = -mu[i] * directions[i, 0] * solution[m]
            force[i, 1] = -mu[i] * directions[i, 1] * solution[m]
            force[i, 2] = solution[m]
            margin = min(margin, force[i, 2])
            m += 1
        else:
            for d in range(3):
                force[i, d] = solution[m + d]
            m += 3
            if mode[i] == STICK:
                tangent = math.sqrt(force[i, 0] ** 2 + force[i, 1] ** 2)
                margin = min(margin, force[i, 2], mu[i] * force[i, 2] - tangent)
        for d in range(3):
            rubbed += force[i, d] * velocity[i, d]
            carried += force[i, d] * surface[i, d]
    for i in range(len(lower)):
        scalar[i] = solution[m]
        margin = min(margin, scalar[i] - lower[i], upper[i] - scalar[i])
        m += 1
    powers[0], powers[1] = rubbed, carried
    return margin


@jit
def decide(delassus, free, velocity, mu, held, lower, upper, force, scalar_force, sweeps, tolerance):
    """Find forces that obey Coulomb's law at acceleration level, by projected sweeps.

    Args:
        delassus: (3 nc + ns, 3 nc + ns) of all contacts that touch, then the scalar rows.
        free: (3 nc + ns,) accelerations without forces.
        velocity: (nc, 2) velocities of slip, zero for a contact that may stick.
        mu: (nc,) friction coefficients.
        held: (nc,) True for bilateral contacts.
        lower, upper: (ns,) bounds of the scalar forces.
        force: (nc, 3) start, and takes the forces.
        scalar_force: (ns,) likewise.
        sweeps: Their largest number.
        tolerance: Change of the forces, relative to the largest, at which to stop.

    Returns:
        The sweeps taken (or −1: they did not converge), and the contact where slip drives the surface in and
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
    for sweep in range(sweeps):
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
