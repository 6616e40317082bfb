"""Plastic impact at several contacts, by Coulomb's law. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.augmented_newton import Law
from ..._numeric.coulomb_problem import CoulombProblem, solve_compliant
from ..._numeric.loops import filled, flags
from ..._numeric.products import add, dot
from ..._numeric.tolerances import COMPUTED, ROUNDOFF
from .tolerances import MISSED

SWEEPS = 100
"""Largest number of Gauss–Seidel iterations that remove slow approaches."""


@declared(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
@jit
def impulses_together(w, v, friction, given, stiffness, impulse):
    """Compute impulses that satisfy Coulomb's law, with sliding contacts at zero normal velocity. (14.7)

    If they are not unique, the limit of small compliances 1/κ is returned.

    Args:
        w: (3n, 3n) W [1/kg].
        v: (3n,) velocities [m/s].
        friction: (n,) μ.
        given: (n,) least normal impulses, ≥ 0 [N s].
        stiffness: (n,) κ; only ratios matter.
        impulse: (3n,) is overwritten with P [N s].

    Returns:
        The residual of Coulomb's law relative to the largest velocity.
    """
    n = len(friction)
    compliance = np.empty(n)
    for i in range(n):
        impulse[3 * i] = impulse[3 * i + 1] = 0.0
        impulse[3 * i + 2], compliance[i] = given[i], 1.0 / stiffness[i]
    none = np.zeros(0)
    law = Law(friction, np.zeros((n, 2)), given, filled(np.empty(n), math.inf), flags(n, False), none, none)
    return solve_compliant(CoulombProblem(w, v, law), impulse, compliance, COMPUTED)


@inlined
def come_to_rest(system, state, works):
    """Remove negligible approaches by normal impulses, with Gauss–Seidel iterations.

    Problem (14.7) would not do: its solver determines the shift s, and with it the normal velocity of sliding
    contacts, only to a tolerance relative to the slip velocity, which can be much larger than these
    approaches.
    """
    w, v = system.w, state.v
    for _ in range(SWEEPS):
        approaches = False
        for z in range(2, len(v), 3):
            if v[z] < -ROUNDOFF and w[z, z] > 0.0:
                approaches = True
                push = -v[z] / w[z, z]
                works[z // 3, 0] += 0.5 * v[z] * push
                add(v, push, w[z])
                v[z] = 0.0
                state.impulse[z] += push
        if not approaches:
            break


@inlined
def end_plastically(system, state, impulse, works):
    """Apply the impulses (3n,) of a plastic impact; return whether they stop all approaches."""
    w, v = system.w, state.v
    stopped = True
    for i in range(len(v)):
        change = dot(w[i], impulse)
        works[i // 3, 0 if i % 3 == 2 else 2] += (v[i] + 0.5 * change) * impulse[i]
        v[i] += change
        state.impulse[i] += impulse[i]
        stopped = stopped and (i % 3 != 2 or v[i] > -MISSED)
    return stopped
