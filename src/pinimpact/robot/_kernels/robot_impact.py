"""The impact of a robot in one call: from configuration and velocity to post-impact velocity.

Mass matrix, Jacobian and placements come from the numbers of the model, `tree_matrices`, or, for joints that
it does not support, from Pinocchio.
"""

from __future__ import annotations

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import (
    FLAGS,
    FLOAT_COLUMNS,
    FLOAT_ROWS,
    FLOATS,
    FOUR,
    INTEGER_ROWS,
    INTEGERS,
    declared,
)
from ..._compile.jit import inlined, jit, released
from ..._numeric.loops import assign
from ..._numeric.products import dot
from ...contact_space._kernels.codes import INVALID_NUMBERS, LOCKED, NO_IMPACT
from ...contact_space._kernels.delassus import clear
from ...contact_space._kernels.path import SCRATCH, solve_into
from ...contact_space._kernels.tolerances import WELL_CONDITIONED
from ...contact_space.inputs import FACTOR
from .contact_kinematics import contact_rows, fill_by_axes
from .delassus_factor import delassus_factor
from .robot_workspace import RobotWorkspace
from .tree import factor, solve, solve_transposed
from .tree_matrices import BODY, placed, tree_matrices

DELASSUS, VELOCITY, SURFACE, AXES, AFTER, SCALE, SINGULAR, SIZE = 0, 6, 9, 12, 21, 28, 29, 36
"""Layout of the results of `robot_impact` after the nv post-impact velocities: W (upper triangle), v, the
surface's velocity, the contact axes, v⁺, P and the compression impulse, the scale of v, and the factor of an
ill-conditioned W (else 0)."""

SINGULAR_MASS = -1
"""Status: the mass matrix is not positive definite."""

NOT_NORMALIZED = -2
"""Status: a quaternion or a (cos, sin) pair is not of unit length."""

ALL_DONE = -1
"""Result of a batch without a singular M."""


@inlined
def all_finite(x):
    """Return whether all numbers of a vector are finite."""
    total = 0.0
    for i in range(len(x)):
        total += 0.0 * x[i]
    return total == 0.0


@inlined
def evaluate_contact(frame, carrier, columns, signs, constants, v, lower, parents, y, singular):
    """Compute W and the velocity of a contact.

    Args:
        frame … v, parents: As for `resolve`.
        lower: (nv, nv) L with M = LᵀL.
        y: (3, nv) is overwritten with JL⁻¹.
        singular: (FACTOR,) is overwritten with the factor of an ill-conditioned W, else with zeros.

    Returns:
        The result of `contact_rows`; the upper triangle of W (6); the contact velocity (3); the size of the
        terms that it is the sum of; the length of the factor, FACTOR or 0.
    """
    geometry = contact_rows(frame, carrier, columns, signs, constants, False, y)
    s1, s2, s3 = geometry[9], geometry[10], geometry[11]
    v1, v2, v3 = dot(y[0], v) - s1, dot(y[1], v) - s2, dot(y[2], v) - s3
    scale = abs(s1) + abs(s2) + abs(s3)
    for j in range(len(v)):
        scale += (abs(y[0, j]) + abs(y[1, j]) + abs(y[2, j])) * abs(v[j])
    solve_transposed(lower, parents, y)
    w11, w12, w13 = dot(y[0], y[0]), dot(y[0], y[1]), dot(y[0], y[2])
    w22, w23, w33 = dot(y[1], y[1]), dot(y[1], y[2]), dot(y[2], y[2])
    singular[:] = 0.0
    known = 0 if clear(w11, w12, w13, w22, w23, w33, WELL_CONDITIONED)[0] else FACTOR
    if known > 0:
        x1, x2, x3 = geometry[12], geometry[13], geometry[14]
        fill_by_axes(columns, signs, x1, x2, x3, geometry[:9], y)
        v1, v2, v3 = dot(y[0], v) - s1, dot(y[1], v) - s2, dot(y[2], v) - s3
        solve_transposed(lower, parents, y)
        w11, w12, w13 = dot(y[0], y[0]), dot(y[0], y[1]), dot(y[0], y[2])
        w22, w23, w33 = dot(y[1], y[1]), dot(y[1], y[2]), dot(y[2], y[2])
        delassus_factor(lower, parents, columns, signs, x1, x2, x3, y, singular)
    return geometry, (w11, w12, w13, w22, w23, w33), (v1, v2, v3), scale, known


def room_to_resolve(nv: int) -> int:
    """Return the size of the work array of `resolve`; for Python."""
    return (nv + 4) * nv + SCRATCH


@declared(
    *(FLOAT_ROWS, INTEGERS, FLOATS, FLOATS, FLOAT_COLUMNS, FLOATS, FLOATS, FLOAT_ROWS, FLOATS, FLOATS),
    *(float, float, int, FLOATS, FLOATS),
    result=FOUR,
)
@jit
def resolve(mass, parents, frame, carrier, columns, signs, constants, bounds, q, v, mu, e, law, room, out):
    """Solve the impact of one contact.

    Args:
        mass: (nv, nv) M.
        parents: (nv,) index of the next velocity towards the root, or −1.
        frame, carrier: (12,) placements of the frame of the contact and of that of its surface.
        columns, signs: As for `contact_kinematics.fill_jacobian`, relative to the origin of the placements.
        constants: (CONSTANTS,) constants of the contact in the axes of the two frames.
        bounds: (2, nq) joint limits.
        q: (nq,) configuration; it is only checked.
        v: (nv,) pre-impact velocity.
        mu, e, law: μ, e and the code of the law.
        room: (`room_to_resolve`,) scratch.
        out: (nv + SIZE,) is overwritten with the post-impact velocity and the results from `DELASSUS` on.

    Returns:
        Status, flags, iterations, and the number of coordinates beyond their bounds; or `SINGULAR_MASS` and
        the index of the velocity at which the factorization stops.
    """
    mass, columns, room, out = borrowed(mass), borrowed(columns), borrowed(room), borrowed(out)
    n = len(v)
    beyond = 0
    for i in range(len(q)):
        if q[i] < bounds[0, i] or q[i] > bounds[1, i]:
            beyond += 1
    if not (all_finite(q) and all_finite(v)):
        return INVALID_NUMBERS, 0, 0, 0
    scratch, unwanted = room[: (n + 4) * n].reshape((n + 4, n)), room[:0].reshape((0, 6))
    lower, y, delta = scratch[:n], scratch[n : n + 3], scratch[n + 3]
    stopped = factor(mass, parents, lower)
    if stopped >= 0:
        return SINGULAR_MASS, stopped, 0, 0
    singular = out[n + SINGULAR : n + SINGULAR + FACTOR]
    geometry, w, relative, scale, known = evaluate_contact(
        frame, carrier, columns, signs, constants, v, lower, parents, y, singular
    )
    w11, w12, w13, w22, w23, w33 = w
    v1, v2, v3 = relative
    status, flags, iterations, a1, a2, a3, p1, p2, p3, pc, _, _, _ = solve_into(
        *(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, scale),
        *(singular[:known], room[(n + 4) * n :], unwanted, unwanted),
    )
    for j in range(n):
        delta[j] = y[0, j] * p1 + y[1, j] * p2 + y[2, j] * p3
    if status != NO_IMPACT:
        solve(lower, parents, scratch[n + 3 :])
    for j in range(n):
        out[j] = v[j] + delta[j]
    rest = (*w, *relative, *geometry[9:12], *geometry[:9], *(a1, a2, a3, p1, p2, p3, pc, scale))
    assign(out[n : n + SINGULAR], rest)
    return status, flags, iterations, beyond


def room_for(nv: int, bodies: int) -> int:
    """Return the size of the work array of `robot_impact`; for Python."""
    return BODY * (bodies + 2) + 6 * nv + nv * nv + room_to_resolve(nv)


@inlined
def parts(work, room):
    """Return views of a work array: bodies, columns, M, placements of frame and carrier; and the rest."""
    nv, n = work.nv, work.bodies
    first = BODY * (n + 2)
    second = first + 6 * nv
    third = second + nv * nv
    bodies = room[:first].reshape((n + 2, BODY))
    columns, mass = room[first:second].reshape((nv, 6)).T, room[second:third].reshape((nv, nv))
    return bodies, columns, mass, bodies[n, :12], bodies[n + 1, :12], room[third:]


@inlined
def evaluate(work, q, bodies, columns, mass, frame, carrier):
    """Fill the `parts` of a work array, and return whether q is normalized."""
    normalized = tree_matrices(work, q, bodies, columns, mass)
    placed(bodies[work.frame_joint], work.frame, frame)
    placed(bodies[work.carrier_joint], work.carrier, carrier)
    return normalized


@inlined
def _by_tree(work, room, evaluated, q, v, mu, e, out):
    """Solve the impact of a contact; return the result of `resolve`, or `NOT_NORMALIZED`.

    `evaluated`: whether the work array already contains the matrices at q, from the previous call.
    """
    room, q, v, out = borrowed(room), borrowed(q), borrowed(v), borrowed(out)
    bodies, columns, mass, frame, carrier, room = parts(work, room)
    if not evaluated and not evaluate(work, q, bodies, columns, mass, frame, carrier):
        return NOT_NORMALIZED, 0, 0, 0
    return resolve(
        *(mass, work.velocity_parent, frame, carrier, columns, work.signs, work.constants, work.bounds),
        *(q, v, mu, e, work.law, room, out),
    )


@declared(RobotWorkspace, FLOATS, FLOATS, float, FLOATS)
@jit
def robot_impact(work, q, v, e, out):
    """Solve the impact of one contact at q (nq,) and v (nv,); other arguments and result as for `resolve`.

    The status is `NOT_NORMALIZED` for a quaternion or (cos, sin) pair that is not of unit length.
    """
    return _by_tree(work, work.scratch, False, q, v, work.friction, e, out)


@inlined
def _keep(row, status, flags, out, after, impulses, codes, numbers):
    """Write a row of a batch."""
    n = after.shape[1]
    codes[row, 0] = status
    if status > LOCKED:
        return
    codes[row, 1] = flags
    if len(numbers) > 0:
        assign(numbers[row], out[n:])
    assign(after[row], out)
    axes, p = out[n + AXES :], out[n + AFTER + 3 :]
    for i in range(3):
        impulses[row, i] = p[0] * axes[i] + p[1] * axes[3 + i] + p[2] * axes[6 + i]


@declared(
    *(RobotWorkspace, FLOAT_ROWS, FLOAT_ROWS, FLAGS, FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS),
    *(INTEGER_ROWS, FLOAT_ROWS),
)
@released
def robot_impacts(work, q, v, usable, mu, e, after, impulses, codes, numbers):
    """Solve the impact of one contact for N states.

    Args:
        work: The workspace.
        q, v: (N, nq), (N, nv) configurations and pre-impact velocities.
        usable: (N,) rows to solve; output rows of others are left.
        mu, e: (N,) μ and e.
        after: (N, nv) is overwritten with the post-impact velocities.
        impulses: (N, 3) is overwritten with the impulses in world axes [N s].
        codes: (N, 2) is overwritten with status and flags.
        numbers: (N, SIZE) is overwritten with the other results of `resolve`; (0, SIZE): not needed.

    Returns:
        `ALL_DONE`, or the index of the velocity at which the factorization of M stops.
    """
    room, out = np.empty(work.room), np.empty(v.shape[1] + SIZE)
    last = -1
    for row in range(len(v)):
        if not usable[row]:
            continue
        evaluated = last >= 0
        for i in range(q.shape[1]):
            if evaluated and q[row, i] != q[last, i]:
                evaluated = False
        status, flags, _, _ = _by_tree(work, room, evaluated, q[row], v[row], mu[row], e[row], out)
        if status == SINGULAR_MASS:
            return flags
        last = -1
        if status != NOT_NORMALIZED:
            last = row
            _keep(row, status, flags, out, after, impulses, codes, numbers)
    return ALL_DONE
