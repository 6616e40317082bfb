"""The whole impact of a robot in one call: mass matrix and Jacobians in, post-impact velocity out."""

from __future__ import annotations

import numpy as np

from .codes import INVALID_NUMBERS, NO_IMPACT
from .exact import solve
from .geometry import jacobian
from .jit import jit
from .tree import factor, solve_transposed
from .tree import solve as solve_lower

DELASSUS, VELOCITY, SURFACE, AXES, AFTER, IMPULSE, SIZE = 0, 6, 9, 12, 21, 24, 28
"""Where `reset` puts, after the nv post-impact velocities: W (upper triangle), v, the surface's own
velocity, the contact axes, v⁺, P and the compression impulse."""

SINGULAR_MASS = -1
"""Status: the mass matrix is not positive definite."""


@jit
def all_finite(x):
    """Whether no number of a vector is infinite or NaN."""
    total = 0.0
    for i in range(len(x)):
        total += 0.0 * x[i]
    return total == 0.0


@jit
def approach(transposed, v, surface):
    """Return J v − v_surface; `transposed` is Jᵀ (nv, 3)."""
    v1, v2, v3 = -surface[0], -surface[1], -surface[2]
    for j in range(len(v)):
        v1 += transposed[j, 0] * v[j]
        v2 += transposed[j, 1] * v[j]
        v3 += transposed[j, 2] * v[j]
    return v1, v2, v3


@jit
def gram(y):
    """Return the upper triangle of YᵀY for Y (nv, 3)."""
    w11 = w12 = w13 = w22 = w23 = w33 = 0.0
    for j in range(len(y)):
        y1, y2, y3 = y[j, 0], y[j, 1], y[j, 2]
        w11 += y1 * y1
        w12 += y1 * y2
        w13 += y1 * y3
        w22 += y2 * y2
        w23 += y2 * y3
        w33 += y3 * y3
    return w11, w12, w13, w22, w23, w33


@jit
def reset(
    mass, parents, free, frame, frame_jacobian, carrier, carrier_jacobian, constants, q, v, mu, e, law, out
):
    """Resolve the impact of one contact.

    Args:
        mass: (nv, nv) M.
        parents: (nv,) the next velocity on the way to the root, or −1.
        free: (nv,) False where the velocity is locked.
        frame: This and the next four as in `geometry.jacobian`.
        frame_jacobian: See there.
        carrier: See there.
        carrier_jacobian: See there.
        constants: See there.
        q: (nq,), only looked through for numbers that are not finite.
        v: (nv,) pre-impact velocity.
        mu: Friction.
        e: Restitution.
        law: Code of its law.
        out: (nv + SIZE,) takes the answer; see `DELASSUS` and its neighbours.

    Returns:
        status and flags; or `SINGULAR_MASS` and the velocity at which the factorization stops.
    """
    n = len(v)
    if not (all_finite(q) and all_finite(v)):
        return INVALID_NUMBERS, 0
    lower = np.empty((n, n))
    stopped = factor(mass, parents, free, lower)
    if stopped >= 0:
        return SINGULAR_MASS, stopped
    y = np.empty((n, 3))
    axes = np.empty((3, 3))
    surface = jacobian(frame, frame_jacobian, carrier, carrier_jacobian, constants, y, axes)
    v1, v2, v3 = approach(y, v, surface)
    for j in range(n):
        if not free[j]:
            y[j, 0] = y[j, 1] = y[j, 2] = 0.0
    solve_transposed(lower, parents, y)
    w11, w12, w13, w22, w23, w33 = gram(y)
    status, flags, _, a1, a2, a3, p1, p2, p3, pc = solve(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law)
    delta = np.empty((n, 1))
    for j in range(n):
        delta[j, 0] = y[j, 0] * p1 + y[j, 1] * p2 + y[j, 2] * p3
    if status != NO_IMPACT:
        solve_lower(lower, parents, delta)
    for j in range(n):
        out[j] = v[j] + delta[j, 0]
    rest = (w11, w12, w13, w22, w23, w33, v1, v2, v3, surface[0], surface[1], surface[2])
    for i in range(12):
        out[n + i] = rest[i]
    for i in range(3):
        for j in range(3):
            out[n + AXES + 3 * i + j] = axes[i, j]
    after = (a1, a2, a3, p1, p2, p3, pc)
    for i in range(7):
        out[n + AFTER + i] = after[i]
    return status, flags
