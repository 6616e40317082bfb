"""Which of several forces that obey Coulomb's law last. (theory.md, 11)

Where slip meets other constraints there may be three: between two that last one whose equations have a
negative determinant, from which any deviation grows.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import external
from ..._numeric.coulomb_problem import (
    AS_FORCES_SAY,
    SYSTEM,
    USABLE,
    linearize,
    newton,
    residual,
    scale,
    solve_coulomb,
)
from ..._numeric.elimination import RANK, solve
from ..._numeric.loops import assign, repeated


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS, result=int)
@external
def orientation(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f):
    """Return the sign of the determinant of the equations that forces x solve, zero where singular.

    Where slip begins, it is negative also if it is with directions as they are, in which slip goes on.
    """
    nc, size = len(mu), len(x)
    system, right, undecided = np.empty((size, size)), np.empty(size), repeated(nc, AS_FORCES_SAY)
    residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
    linearize(
        *(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f, undecided),
        *(system, right),
    )
    sign = solve(system, right, np.empty(size), RANK)
    directed, begins = velocity.copy(), False
    for k in range(nc):
        rests = mu[k] > 0.0 and not held[k] and velocity[k, 0] == 0.0 and velocity[k, 1] == 0.0
        b = 3 * k
        g1 = x[b] / scale_f[b] - a_now[b] * scale_a[b]
        g2 = x[b + 1] / scale_f[b] - a_now[b + 1] * scale_a[b]
        if rests and math.hypot(g1, g2) > mu[k] * x[b + 2] / scale_f[b]:
            directed[k, 0], directed[k, 1], begins = -g1, -g2, True
    if sign <= 0 or not begins:
        return sign
    linearize(
        *(delassus, free, directed, mu, least, held, lower, upper, x, a_now, scale_a, scale_f, undecided),
        *(system, right),
    )
    return solve(system, right, np.empty(size), RANK)


@declared(*SYSTEM)
@external
def take_lasting(delassus, free, velocity, mu, least, held, lower, upper, x):
    """Replace forces x of a negative determinant by others that last, if such are found.

    The method of multipliers is tried from no forces on; then one thing after the other lets go, and Newton's
    method goes on from there.
    """
    nc, ns, size = len(mu), len(lower), len(x)
    d, scale_a, scale_f, a_now = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    if scale(delassus, free, nc, d, scale_a, scale_f) == 0.0:
        return
    if orientation(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f) >= 0:
        return
    trial = np.zeros(size)
    for k in range(-1, nc + 2 * ns):
        if k < 0:
            worst = solve_coulomb(delassus, free, velocity, mu, least, held, lower, upper, trial)
        else:
            assign(trial, x)
            if k < nc:
                trial[3 * k] = trial[3 * k + 1] = trial[3 * k + 2] = 0.0
            else:
                i = (k - nc) // 2
                bound = lower[i] if (k - nc) % 2 == 0 else upper[i]
                if abs(bound) == math.inf:
                    continue
                trial[3 * nc + i] = bound
            worst = newton(
                delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f
            )
        if worst > USABLE:
            continue
        if (
            orientation(
                delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f
            )
            > 0
        ):
            assign(x, trial)
            return
