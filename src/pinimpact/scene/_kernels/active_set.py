"""The active set: its layout in the workspace, its rows, and impulses that stop rows."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, nonzero
from ..._numeric.semidefinite import cholesky
from ..._numeric.tolerances import LITTLE
from .contact_forces import FREE, HELD, SLIP
from .tolerances import DIFFERENT, NEGLIGIBLE
from .workspace import SceneWorkspace

NORMAL, ALL = np.arange(2)  # variables: numba would compile a kernel for each literal
"""Rows of a slipping contact: the normal one, whose velocity vanishes, or the tangential ones too."""


@inlined
def scalar_rows(work, chosen):
    """Return the numbers of the nonzero entries of chosen (limits + nv,), limits then velocities.

    A joint held by both its limit and its dry friction has one scalar row, that of the limit.
    """
    single = chosen.copy()
    for k in range(work.limits):
        if chosen[k] != 0:
            single[work.limits + work.limit_v[k]] = 0
    return nonzero(single)


@inlined
def scalar_row(work, j, chosen):
    """Return velocity index and force bounds [N] of scalar row j: a joint limit, or from `limits` on a joint.

    If limit and dry friction both hold the joint, the bounds are those of their sum. Rows are scaled to
    metres by `joint_metres`.
    """
    limits = work.limits
    if j >= limits:
        j -= limits
        friction = work.dry_friction[j] / work.joint_metres[j]
        return j, -friction, friction
    sign, i = work.limit_sign[j], work.limit_v[j]
    friction = work.dry_friction[i] / work.joint_metres[i] if chosen[limits + i] != 0 else 0.0
    return i, -math.inf if sign < 0.0 else -friction, math.inf if sign > 0.0 else friction


@declared(SceneWorkspace, FLOAT_ROWS)
@external
def close(work, reference):
    """Fill the fields of the active set from `work.modes` and the directions of slip, reference (n, 2)."""
    modes = work.modes
    held = modes[work.contacts :]
    contacts, scalars = nonzero(modes[: work.contacts]), scalar_rows(work, held)
    rows = len(scalars)
    for i in contacts:
        rows += 1 if modes[i] == SLIP else 3
    work.active_contacts, work.active_scalars, work.active_rows = len(contacts), len(scalars), rows
    index, mode, mu = work.active_index, work.active_mode, work.active_friction
    rest, slip = work.active_rest_gap, work.slip_reference
    for k in range(len(contacts)):
        i = contacts[k]
        index[k], mode[k], mu[k], rest[k] = i, modes[i], work.friction[i], work.rest_gap[i]
        assign(slip[k], reference[i])
    velocity, lower, upper = work.scalar_velocity, work.scalar_lower, work.scalar_upper
    for m in range(len(scalars)):
        velocity[m], lower[m], upper[m] = scalar_row(work, scalars[m], held)
    work.forces_unique = True


@declared(SceneWorkspace, INTEGERS, FLOATS, INTEGERS, FLOATS, FLOAT_ROWS, INTEGER_ROWS)
@jit
def take_over(work, modes, sliding, sides, control, constants, joints):
    """Set modes, friction, drives, control and active contacts from a `forces.ClosedSet`."""
    assign(work.modes, modes)
    assign(work.sliding_friction, sliding)
    assign(work.drive_side, sides)
    assign(work.control_force, control)
    index = nonzero(modes[: work.contacts])
    for k in range(len(index)):
        assign(work.contact_constants[index[k]], constants[k])
        assign(work.contact_joints[index[k]], joints[k])


@declared(SceneWorkspace)
@jit
def close_held(work):
    """Make the held contacts the active set, and nothing else."""
    modes, bilateral = work.modes, work.bilateral
    for i in range(len(modes)):
        modes[i] = HELD if i < len(bilateral) and bilateral[i] != 0 else FREE
    close(work, np.zeros((len(bilateral), 2)))


@declared(SceneWorkspace, FLOATS, int, FLOAT_ROWS, FLOATS)
@external
def active_rows(work, v, which, rows, speeds):
    """Fill the rows (m, nv), zero before, of the active set and their speeds (m,) [m/s]; return their number.

    They are those of the state last evaluated. `which` selects the rows of slipping contacts: `NORMAL` or
    `ALL`.
    """
    mode, jacobian, velocity = work.active_mode, work.contact_jacobian, work.contact_velocity
    total = 0
    for k in range(len(mode)):
        for d in range(3):
            if d == 2 or which == ALL or mode[k] != SLIP:
                assign(rows[total], jacobian[k, d])
                speeds[total] = velocity[k, d]
                total += 1
    for j in work.scalar_velocity:
        rows[total, j] = work.joint_metres[j]
        speeds[total] = work.joint_metres[j] * v[j]
        total += 1
    return total


@declared(FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS)
@external
def stop_along(rows, velocity, minverse, v):
    """Stop rows (m, nv) by the least change of v (nv,) in the metric of M; return the energy gained [J].

    `velocity` (m,) are the velocities of the rows. With M⁻¹ = L Lᵀ and v = L w this is the least change of w.
    Rows that almost depend on others are also stopped if this changes w little more.
    """
    moved = moved_by(rows, minverse)
    m, n = len(rows), len(moved)
    if m == 0 or n == 0:
        return 0.0
    lower, scaled = np.empty((n, n)), np.empty((m, n))
    for j in range(n):
        for k in range(n):
            lower[j, k] = minverse[moved[j], moved[k]]
    cholesky(lower)
    for a in range(m):
        for j in range(n):
            scaled[a, j] = 0.0
            for k in range(j, n):
                scaled[a, j] += rows[a, moved[k]] * lower[k, j]
    change, finer, no_basis = np.empty(n), np.empty(n), np.empty((0, n))
    least_norm(scaled, velocity, DIFFERENT, change, no_basis)
    least_norm(scaled, velocity, NEGLIGIBLE, finer, no_basis)
    w = np.empty(n)
    size = more = 0.0
    for i in range(n):  # w = L⁻¹ v
        total = v[moved[i]]
        for j in range(i):
            total -= lower[i, j] * w[j]
        w[i] = total / lower[i, i]
        size, more = size + w[i] ** 2, more + (finer[i] - change[i]) ** 2
    if more <= LITTLE**2 * size:
        assign(change, finer)
    energy = 0.0
    for j in range(n):
        energy -= change[j] * (w[j] - 0.5 * change[j])
    for i in range(n):
        for j in range(i + 1):
            v[moved[i]] -= lower[i, j] * change[j]
    return energy


@inlined
def moved_by(rows, minverse):
    """Return the indices of the velocities that impulses along rows (m, nv) change."""
    n = len(minverse)
    moved = np.zeros(n, dtype=np.int64)
    for j in range(n):
        for row in rows:
            if row[j] != 0.0:
                for i in range(n):
                    if minverse[j, i] != 0.0:
                        moved[i] = 1
                break
    return nonzero(moved)
