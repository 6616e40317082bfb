"""The whole impact of a robot in one call: mass matrix and Jacobians in, post-impact velocity out."""

from __future__ import annotations

import numpy as np

from ..._numeric.ahead import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGERS, READONLY, ahead
from ..._numeric.jit import inner, jit
from ...contact_space._kernels.codes import INVALID_NUMBERS, LOCKED, NO_IMPACT
from ...contact_space._kernels.delassus import WELL_CONDITIONED, clear
from ...contact_space._kernels.path import SCRATCH, solve_into
from ...contact_space.inputs import FACTOR
from .contact_kinematics import jacobian, locate
from .delassus_factor import delassus_factor
from .python_calls import call
from .tree import factor, solve, solve_transposed

DELASSUS, VELOCITY, SURFACE, AXES, AFTER, SCALE, SINGULAR, BEYOND, SIZE = 0, 6, 9, 12, 21, 28, 29, 36, 37
"""Where `robot_impact` puts, after the nv post-impact velocities: W (upper triangle), v, the surface's own
velocity, the contact axes, v⁺, P and the compression impulse, the scale of v, the factor of a W that is
ill-conditioned (else 0), and how many coordinates are beyond their bounds."""

SINGULAR_MASS = -1
"""Status: the mass matrix is not positive definite."""

CALL_RAISED, ALL_DONE = -2, -1
"""Where `robot_impacts` came to no velocity at which M is singular."""


@inner
def all_finite(x):
    """Whether no number of a vector is infinite or NaN."""
    total = 0.0
    for i in range(len(x)):
        total += 0.0 * x[i]
    return total == 0.0


@inner
def dot(x, y):
    """Return xᵀy."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@ahead(
    FLOAT_ROWS,
    INTEGERS,
    FLOAT_ROWS,
    FLOAT_ROWS,
    FLOAT_COLUMNS,
    FLOATS,
    READONLY,
    FLOAT_ROWS,
    FLOATS,
    FLOATS,
    float,
    float,
    int,
    FLOATS,
)
@jit
def robot_impact(
    mass,
    parents,
    frame,
    carrier,
    columns,
    signs,
    constants,
    bounds,
    q,
    v,
    mu,
    e,
    law,
    out,
):
    """Resolve the impact of one contact.

    Args:
        mass: (nv, nv) M.
        parents: (nv,) the next velocity on the way to the root, or −1.
        frame: This and the next four as in `contact_kinematics.jacobian`.
        carrier: See there.
        columns: See there.
        signs: See there.
        constants: See there.
        bounds: (2, nq) the least and the greatest value of each coordinate, see `BEYOND`.
        q: (nq,), only looked through for numbers that are not finite, or beyond these.
        v: (nv,) pre-impact velocity.
        mu: Friction.
        e: Restitution.
        law: Code of its law.
        out: (nv + SIZE,) takes the answer; see `DELASSUS` and its neighbours.

    Returns:
        status, flags and iterations; or `SINGULAR_MASS` and the velocity at which the factorization stops.
    """
    n = len(v)
    beyond = 0.0
    for i in range(len(q)):
        if q[i] < bounds[0, i] or q[i] > bounds[1, i]:
            beyond += 1.0
    if not (all_finite(q) and all_finite(v)):
        return INVALID_NUMBERS, 0, 0
    scratch = np.empty((n + 4, n))
    lower, y, delta = scratch[:n], scratch[n : n + 3], scratch[n + 3]
    stopped = factor(mass, parents, lower)
    if stopped >= 0:
        return SINGULAR_MASS, stopped, 0
    geometry = jacobian(frame, carrier, columns, signs, constants, y)
    s1, s2, s3 = geometry[9], geometry[10], geometry[11]
    v1, v2, v3 = dot(y[0], v) - s1, dot(y[1], v) - s2, dot(y[2], v) - s3
    scale = abs(s1) + abs(s2) + abs(s3)  # v is known to rounding of this size
    for j in range(n):
        scale += (abs(y[0, j]) + abs(y[1, j]) + abs(y[2, j])) * abs(v[j])
    solve_transposed(lower, parents, y)
    w11, w12, w13 = dot(y[0], y[0]), dot(y[0], y[1]), dot(y[0], y[2])
    w22, w23, w33 = dot(y[1], y[1]), dot(y[1], y[2]), dot(y[2], y[2])
    singular = out[n + SINGULAR : n + SINGULAR + FACTOR]
    singular[:] = 0.0
    known = 0 if clear(w11, w12, w13, w22, w23, w33, WELL_CONDITIONED)[0] else FACTOR
    if known > 0:
        place = locate(frame, carrier, constants)
        delassus_factor(lower, parents, columns, signs, place[4], place[5], place[6], y, singular)
    unwanted = np.empty((0, 6))
    status, flags, iterations, a1, a2, a3, p1, p2, p3, pc, _, _, _ = solve_into(
        *(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, scale),
        *(singular[:known], np.empty(SCRATCH), unwanted, unwanted),
    )
    for j in range(n):
        delta[j] = y[0, j] * p1 + y[1, j] * p2 + y[2, j] * p3
    if status != NO_IMPACT:
        solve(lower, parents, scratch[n + 3 :])
    for j in range(n):
        out[j] = v[j] + delta[j]
    rest = (
        *(w11, w12, w13, w22, w23, w33, v1, v2, v3, s1, s2, s3),
        *geometry[:9],
        *(a1, a2, a3, p1, p2, p3, pc, scale),
    )
    for i in range(SINGULAR):
        out[n + i] = rest[i]
    out[n + BEYOND] = beyond
    return status, flags, iterations


@inner
def homogeneous(placement, matrix):
    """Fill a homogeneous (4, 4) matrix with a placement (12,); its last row stands."""
    for i in range(3):
        for j in range(4):
            matrix[i, j] = placement[3 * j + i]


@jit
def robot_impacts(
    calls,
    buffer,
    mass,
    parents,
    frame,
    carrier,
    columns,
    signs,
    constants,
    bounds,
    q,
    v,
    usable,
    mu,
    e,
    law,
    after,
    impulses,
    codes,
    numbers,
):
    """Resolve one contact's impact from N states.

    Args:
        calls: (2 k,) addresses of functions and their arguments, see `python_calls`; after them mass, frame,
            carrier and columns are those of the buffer.
        buffer: (nq,) where the calls find the configuration.
        mass: As in `robot_impact`, as all that is not told here.
        parents: See there.
        frame: (12,) placement of the contact's frame.
        carrier: (12,) placement of the frame that carries the surface.
        columns: See `robot_impact`.
        signs: See there.
        constants: See there.
        bounds: See there.
        q: (N, nq).
        v: (N, nv).
        usable: (N,) whether a row's q is a configuration; the others are passed by.
        mu: (N,).
        e: (N,).
        law: Code of the law.
        after: (N, nv) takes v⁺.
        impulses: (N, 3) takes the impulses in world axes.
        codes: (N, 2) takes status and flags.
        numbers: (N, SIZE) takes what `robot_impact` has beyond v⁺; (0, SIZE) where that is not wanted.

    Returns:
        `ALL_DONE`, or the velocity at which the factorization of M stops, or `CALL_RAISED`.
    """
    n = v.shape[1]
    out, placed, carried = np.empty(n + SIZE), np.eye(4), np.eye(4)
    fresh = False
    for row in range(len(v)):
        if not usable[row]:
            continue
        for i in range(len(buffer)):
            if buffer[i] != q[row, i]:
                fresh = False
                buffer[i] = q[row, i]
        if not fresh:
            for k in range(0, len(calls), 2):
                if not call(calls[k], calls[k + 1]):
                    return CALL_RAISED
            fresh = True
        homogeneous(frame, placed)
        homogeneous(carrier, carried)
        status, flags, _ = robot_impact(
            *(mass, parents, placed, carried, columns, signs, constants, bounds),
            *(q[row], v[row], mu[row], e[row], law, out),
        )
        if status == SINGULAR_MASS:
            return flags
        codes[row, 0] = status
        if status > LOCKED:
            continue
        codes[row, 1] = flags
        if len(numbers) > 0:
            for i in range(SIZE):
                numbers[row, i] = out[n + i]
        for j in range(n):
            after[row, j] = out[j]
        axes, p = out[n + AXES :], out[n + AFTER + 3 :]
        for i in range(3):
            impulses[row, i] = p[0] * axes[i] + p[1] * axes[3 + i] + p[2] * axes[6 + i]
    return ALL_DONE
