"""Plastic impact at several contacts, by Coulomb's law or least kinetic energy. (theory.md, section 14)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.cone_program import CONE, cone_program
from ..._numeric.coulomb_problem import solve_compliant
from ..._numeric.loops import filled, flags, repeated
from ..._numeric.products import dot
from ..._numeric.tolerances import ROUNDOFF, TINY
from .tolerances import FOUND, MISSED, OPTIMAL

SWEEPS = 100
"""Largest number of Gauss–Seidel iterations that remove slow approaches."""


@declared(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS)
@external
def plastic_impulses(w, v, friction, given, impulse):
    """Minimize ½ Pᵀ W P + Pᵀ v subject to |P_t| ≤ μ P₃ and P₃ ≥ given. (14.6)

    Args:
        w: (3n, 3n) W [1/kg].
        v: (3n,) velocities [m/s].
        friction: (n,) μ.
        given: (n,) least normal impulses, ≥ 0 [N s].
        impulse: (3n,) is overwritten with P [N s].
    """
    n = len(friction)
    largest, stiffest = TINY, TINY
    for i in range(3 * n):
        largest, stiffest = max(largest, abs(v[i])), max(stiffest, w[i, i])
    unit = largest / stiffest
    cones = 0
    for j in range(n):
        cones += 1 if friction[j] > 0.0 else 0
    columns, rows = n + 2 * cones, n + 3 * cones
    places, signs, sides = np.empty(columns, dtype=np.int64), np.zeros((rows, columns)), np.zeros(rows)
    column, row = n, n
    for j in range(n):
        places[j] = 3 * j + 2  # P₃ − given ≥ 0
        signs[j, j] = -1.0
        if friction[j] > 0.0:
            places[column], places[column + 1] = 3 * j, 3 * j + 1
            signs[row, j] = -friction[j]
            sides[row] = friction[j] * given[j] / unit
            signs[row + 1, column] = -1.0
            signs[row + 2, column + 1] = -1.0
            column += 2
            row += 3
    program, linear = np.empty((columns, columns)), np.empty(columns)
    for a in range(columns):
        linear[a] = v[places[a]] / largest
        for b in range(columns):
            program[a, b] = w[places[a], places[b]] / stiffest
        for j in range(n):
            linear[a] += w[places[a], 3 * j + 2] * given[j] / largest
    x, s, z = np.empty(columns), np.empty(rows), np.empty(rows)
    cone_program(program, linear, signs, sides, n, repeated(cones, CONE), OPTIMAL, x, s, z)
    filled(impulse, 0.0)
    for a in range(columns):
        impulse[places[a]] = x[a] * unit
    for j in range(n):
        impulse[3 * j + 2] += given[j]


@declared(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
@jit
def impulses_together(w, v, friction, given, stiffness, impulse):
    """Compute impulses that satisfy Coulomb's law, with sliding contacts at zero normal velocity. (14.7)

    If they are not unique, the limit of small compliances 1/κ is returned. If none is found, they are
    those of `plastic_impulses`.

    Args:
        w, v, friction, given, impulse: As for `plastic_impulses`.
        stiffness: (n,) κ; only ratios matter.

    Returns:
        The residual of Coulomb's law relative to the largest velocity.
    """
    n = len(friction)
    compliance = np.empty(n)
    for i in range(n):
        impulse[3 * i] = impulse[3 * i + 1] = 0.0
        impulse[3 * i + 2], compliance[i] = given[i], 1.0 / stiffness[i]
    none, rest, held = np.zeros(0), np.zeros((n, 2)), flags(n, False)
    residual = solve_compliant(w, v, rest, friction, given, held, none, none, impulse, compliance)
    if not residual <= FOUND:
        plastic_impulses(w, v, friction, given, impulse)
    return residual


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
                for i in range(len(v)):
                    v[i] += w[i, z] * push
                v[z] = 0.0
                state.impulse[z] += push
        if not approaches:
            break


@inlined
def plastic_impulses_now(system, state, impulse):
    """Compute the impulses (3n,) of a plastic impact that starts at the state; see `impulses_together`."""
    n = len(system.friction)
    impulses_together(system.w, state.v, system.friction, np.zeros(n), np.ones(n), impulse)


@inlined
def end_plastically(system, state, impulse, works):
    """Apply the impulses (3n,) of a plastic impact; return whether they stop all approaches."""
    w, v = system.w, state.v
    stopped = True
    for i in range(len(v)):
        change = dot(w[i], impulse)
        works[i // 3, 0 if i % 3 == 2 else 2] += (v[i] + 0.5 * change) * impulse[i]
    for i in range(len(v)):
        for k in range(len(v)):
            v[i] += w[i, k] * impulse[k]
        state.impulse[i] += impulse[i]
        stopped = stopped and (i % 3 != 2 or v[i] > -MISSED)
    return stopped
