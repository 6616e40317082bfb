"""Which contacts stay closed at an instant, and what brings those that do back onto their surfaces.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one; tuples
are those of `motion`.
"""

from __future__ import annotations

import math

import numpy as np

from . import charts
from . import memory as at
from .foreign import call
from .jit import inner, jit
from .memory import d1, d2, d3, i1, i2
from .motion import ALLOWANCE, FAILED, INVERT, STILL, evaluate, look_closely, release
from .sustained import RANK, SLIP, STICK, decide

OPEN, CLOSED, BREAKING = range(3)
"""What becomes of a scalar row: its limit opens, it holds, its dry friction gives way."""

SWEEPS = 20_000
STANDARD_GRAVITY = 9.80665


@inner
def factor(matrix, order, lower):
    """Fill `lower` (m, m) with the pivoted Cholesky factor of a semidefinite matrix; return its rank."""
    size = len(matrix)
    rest = np.empty(size)
    largest = 0.0
    for a in range(size):
        order[a] = a
        rest[a] = matrix[a, a]
        largest = max(largest, rest[a])
    for k in range(size):
        best = k
        for a in range(k + 1, size):
            if rest[order[a]] > rest[order[best]]:
                best = a
        order[k], order[best] = order[best], order[k]
        p = order[k]
        if not rest[p] > RANK * largest:
            return k
        pivot = math.sqrt(rest[p])
        lower[p, k] = pivot
        for a in range(k + 1, size):
            i = order[a]
            total = matrix[i, p]
            for j in range(k):
                total -= lower[i, j] * lower[p, j]
            lower[i, k] = total / pivot
            rest[i] -= lower[i, k] ** 2
    return size


@inner
def impulses(matrix, target, x):
    """Fill an x that solves matrix x = target, in least squares where the semidefinite matrix is singular."""
    size = len(target)
    order, lower, y = np.empty(size, dtype=np.int64), np.zeros((size, size)), np.empty(size)
    rank = factor(matrix, order, lower)
    x[:] = 0.0
    if rank == size:
        for a in range(size):
            i = order[a]
            total = target[i]
            for j in range(a):
                total -= lower[i, j] * y[j]
            y[a] = total / lower[i, a]
    elif rank > 0:  # lower y = target, by its normal equations
        normal, inner_order, inner_lower = np.empty((rank, rank)), order.copy(), np.zeros((rank, rank))
        for a in range(rank):
            y[a] = 0.0
            for i in range(size):
                y[a] += lower[i, a] * target[i]
            for b in range(rank):
                total = 0.0
                for i in range(size):
                    total += lower[i, a] * lower[i, b]
                normal[a, b] = total
        factor(normal, inner_order[:rank], inner_lower)
        z = np.empty(rank)
        for a in range(rank):
            i = inner_order[a]
            total = y[i]
            for j in range(a):
                total -= inner_lower[i, j] * z[j]
            z[a] = total / inner_lower[i, a]
        for a in range(rank - 1, -1, -1):
            total = z[a]
            for b in range(a + 1, rank):
                total -= inner_lower[inner_order[b], a] * y[inner_order[b]]
            y[inner_order[a]] = total / inner_lower[inner_order[a], a]
    for a in range(rank - 1, -1, -1):
        total = y[a]
        for b in range(a + 1, rank):
            total -= lower[order[b], a] * x[order[b]]
        x[order[a]] = total / lower[order[a], a]
    return rank


@inner
def answer(rows, minverse, response, matrix):
    """Fill the response M⁻¹ rowsᵀ, row by row, and the matrix rows M⁻¹ rowsᵀ."""
    m, n = rows.shape
    for a in range(m):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += minverse[j, k] * rows[a, k]
            response[a, j] = total
    for a in range(m):
        for b in range(m):
            total = 0.0
            for j in range(n):
                total += rows[a, j] * response[b, j]
            matrix[a, b] = total


@inner
def take_away(rows, velocity, minverse, v):
    """Change v by impulses along the rows so that their velocities vanish; return the energy gained."""
    m, n = rows.shape
    response, matrix, x = np.empty((m, n)), np.empty((m, m)), np.empty(m)
    answer(rows, minverse, response, matrix)
    impulses(matrix, velocity, x)
    work = 0.0
    for a in range(m):
        for j in range(n):
            work -= 0.5 * x[a] * rows[a, j] * v[j]
    for a in range(m):
        for j in range(n):
            v[j] -= x[a] * response[a, j]
    for a in range(m):
        for j in range(n):
            work -= 0.5 * x[a] * rows[a, j] * v[j]
    return work


@jit
def choose(
    t,
    q,
    v,
    contacts,
    held,
    mu,
    scalars,
    sign,
    lower,
    upper,
    mode,
    reference,
    fate,
    strength,
    mem,
):
    """Find what stays closed of the contacts and scalar rows that touch.

    Args:
        t: Time [s].
        q: (nq,) configuration.
        v: (nv,) the velocity, which loses what closed contacts take away of it.
        contacts: (nc,) the contacts that touch.
        held: (nc,) whether they are bilateral.
        mu: (nc,) their friction.
        scalars: (ns,) velocity indices of the scalar rows.
        sign: (nl,) of the joint limits among them, which come first: 1 for a lower one.
        lower, upper: (ns,) bounds of the scalar forces.
        mode: (nc,) takes the modes, `FREE` for a contact that opens.
        reference: (nc, 2) takes the directions of slip where they are known.
        fate: (ns,) takes what becomes of the scalar rows.
        strength: (ns,) takes their forces.
        mem: The table of `memory`.

    Returns:
        The position in `contacts` where slip drives the surface in and no force exists, or −1; whether the
        forces were found to the usual accuracy; the kinetic energy gained.
    """
    state = d1(mem, at.STATE)
    calls, acceleration, minverse = i1(mem, at.CALLS), d1(mem, at.ACCELERATION), d2(mem, at.MINVERSE)
    d1(mem, at.Q)[:] = q
    d1(mem, at.V)[:] = v
    nc, ns, nl, n = len(contacts), len(scalars), len(sign), len(v)
    size = 3 * nc + ns
    release(t, mem, np.empty(2))
    if state[FAILED] != 0.0 or not call(calls[INVERT], calls[INVERT + 1]):
        state[FAILED] = 1.0
        return -1, True, 0.0
    rows, response, delassus = np.zeros((size, n)), np.empty((size, n)), np.empty((size, size))
    velocity, free = np.empty((nc, 3)), np.empty(size)
    surface = np.empty(3)
    for k in range(nc):
        b = 3 * k
        look_closely(mem, contacts[k], rows[b : b + 3], velocity[k], free[b : b + 3], surface)
    for m in range(ns):
        rows[3 * nc + m, scalars[m]] = 1.0
        free[3 * nc + m] = acceleration[scalars[m]]
    answer(rows, minverse, response, delassus)
    force = np.zeros((nc, 3))
    strength[:] = 0.0
    still = state[STILL]
    sweeps, jamming = decide(
        delassus, free, velocity[:, :2], mu, held, still, lower, upper, force, strength, SWEEPS, 1e-12
    )
    if jamming >= 0:
        b = 3 * jamming + 2
        return jamming, True, take_away(rows[b : b + 1], velocity[jamming, 2:], minverse, v)
    result = free.copy()
    largest = 0.0
    for a in range(size):
        largest = max(largest, abs(free[a]))
        for k in range(nc):
            for d in range(3):
                result[a] += delassus[a, 3 * k + d] * force[k, d]
        for m in range(ns):
            result[a] += delassus[a, 3 * nc + m] * strength[m]
    pace = 1e-9 * (largest + 1e-3 * STANDARD_GRAVITY)
    unique = factor(delassus, np.empty(size, dtype=np.int64), np.zeros((size, size))) == size

    kept = np.zeros(size, dtype=np.bool_)  # rows whose velocity becomes zero
    for k in range(nc):
        b = 3 * k
        normal, tangent = force[k, 2], math.hypot(force[k, 0], force[k, 1])
        speed = math.hypot(velocity[k, 0], velocity[k, 1])
        if held[k]:
            kept[b : b + 3] = True
            continue
        if normal <= state[ALLOWANCE] and result[b + 2] > pace:
            kept[b + 2] = velocity[k, 2] < 0.0
            continue
        kept[b + 2] = True
        # a force on its cone means slip, unless another one would do, and then only what moves slips
        held_back = tangent <= mu[k] * normal * (1.0 - 1e-9)
        held_back |= not unique and math.hypot(result[b], result[b + 1]) <= pace
        if mu[k] > 0.0 and speed <= still and held_back:
            mode[k] = STICK
            kept[b : b + 2] = True
            continue
        mode[k] = SLIP
        reference[k, 0], reference[k, 1] = 1.0, 0.0
        if speed > still:
            reference[k, 0], reference[k, 1] = velocity[k, 0] / speed, velocity[k, 1] / speed
        elif tangent > 0.0:
            reference[k, 0], reference[k, 1] = -force[k, 0] / tangent, -force[k, 1] / tangent
    for m in range(ns):
        a = 3 * nc + m
        fate[m] = CLOSED
        if m < nl:
            if abs(strength[m]) <= state[ALLOWANCE] and sign[m] * result[a] > pace:
                fate[m] = OPEN
        elif abs(strength[m]) >= upper[m] * (1.0 - 1e-9):
            fate[m] = BREAKING
            v[scalars[m]] = 0.0
        kept[a] = fate[m] == CLOSED
    count = 0
    speeds = np.empty(size)
    for a in range(size):
        if kept[a]:
            speeds[count] = velocity[a // 3, a % 3] if a < 3 * nc else v[scalars[a - 3 * nc]]
            rows[count] = rows[a]
            count += 1
    return -1, sweeps >= 0, take_away(rows[:count], speeds[:count], minverse, v)


@jit
def correct(t, q, v, shut, mem):
    """Bring the closed contacts back onto their surfaces; return the kinetic energy gained.

    Args:
        t: Time [s].
        q: (nq,) the configuration, which is changed.
        v: (nv,) the velocity, which is changed.
        shut: (mem,) whether each joint limit is closed.
        mem: The table of `memory`.
    """
    state = d1(mem, at.STATE)
    joints = i2(mem, at.JOINTS)
    minverse = d2(mem, at.MINVERSE)
    which, modes, scalars, rest = i1(mem, at.WHICH), i1(mem, at.MODES), i1(mem, at.SCALARS), d1(mem, at.REST)
    jacobians, velocity, gap = d3(mem, at.ROWS), d2(mem, at.VELOCITY), d1(mem, at.GAP)
    index_q, index_v, bound = i1(mem, at.INDEX_Q), i1(mem, at.INDEX_V), d1(mem, at.BOUND)
    n, nc, ns = len(v), len(which), len(scalars)
    rates = np.empty(n + 4)
    rows = np.zeros((3 * nc + ns + len(shut), n))
    off = np.empty(len(rows))
    d1(mem, at.Q)[:] = q
    d1(mem, at.V)[:] = v
    evaluate(t, mem, rates)
    count = 0
    for k in range(nc):
        rows[count] = jacobians[k, 2]
        off[count] = gap[k] - rest[k]
        count += 1
    for m in range(len(shut)):
        if shut[m]:
            rows[count, index_v[m]] = 1.0
            off[count] = q[index_q[m]] - bound[m]
            count += 1
    if count > 0 and state[FAILED] == 0.0:
        xi, start = np.zeros(n), q.copy()
        take_away(rows[:count], off[:count], minverse, xi)
        charts.advance(joints, start, xi, q)
        for m in range(len(shut)):
            if shut[m]:
                q[index_q[m]] = bound[m]
        d1(mem, at.Q)[:] = q
        evaluate(t, mem, rates)
    rows[:] = 0.0
    count = 0
    for k in range(nc):
        for d in range(3):
            if d == 2 or modes[k] != SLIP:
                rows[count] = jacobians[k, d]
                off[count] = velocity[k, d]
                count += 1
    for j in scalars:
        rows[count, j] = 1.0
        off[count] = v[j]
        count += 1
    if count == 0 or state[FAILED] != 0.0:
        return 0.0
    return take_away(rows[:count], off[:count], minverse, v)
