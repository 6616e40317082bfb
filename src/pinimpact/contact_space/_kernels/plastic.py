"""A plastic impact at many contacts: the least kinetic energy that impulses in their cones can leave."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.ahead import FLOAT_ROWS, FLOATS, ahead
from ..._compile.jit import inner, jit, separate
from ..._numeric.cone_program import CONE, cone_program
from ..._numeric.loops import repeated

STOPPED = 1e-6
"""Part of the largest velocity that an approach may keep by rounding."""

TINY, SWEEPS = 1e-14, 100
"""Part of the largest velocity that is zero, and how often approaches at rest are taken away at most."""

FOUND = 1e-6
"""What the last repetition may change of the velocities where Coulomb's law is met well enough."""

REPETITIONS, SETTLED = 500, 1e-12
"""Of the search for Coulomb's law, and the change of velocities, in parts of the largest, that ends it."""


@ahead(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
@separate
def plastic_impulses(w, v, friction, given, shift, impulse):
    """Fill the impulses (3n,) that minimise ½ Pᵀ W P + Pᵀ (v + shift n), |P_t| ≤ μ P₃, P₃ ≥ given. (14.6)

    Args:
        w: (3n, 3n) W.
        v: (3n,) velocities.
        friction: (n,) μ.
        given: (n,) least normal impulses, ≥ 0.
        shift: (n,) what is added to normal velocities.
        impulse: (3n,) takes P.
    """
    n = len(friction)
    largest, stiffest = 1e-300, 1e-300
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
        if a < n:
            linear[a] += shift[a] / largest
        for b in range(columns):
            program[a, b] = w[places[a], places[b]] / stiffest
        for j in range(n):
            linear[a] += w[places[a], 3 * j + 2] * given[j] / largest
    x, s, z = np.empty(columns), np.empty(rows), np.empty(rows)
    cone_program(program, linear, signs, sides, n, repeated(cones, CONE), 1e-22, x, s, z)
    for i in range(3 * n):
        impulse[i] = 0.0
    for a in range(columns):
        impulse[places[a]] = x[a] * unit
    for j in range(n):
        impulse[3 * j + 2] += given[j]


@ahead(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
@jit
def impulses_together(w, v, friction, given, shift, impulse):
    """Fill the impulses (3n,) of Coulomb's law on impulses: sliding contacts neither part nor approach.

    The least power of `plastic_impulses` lets what slides part at μ |v_t|; the shift that takes this away is
    found by repetition. (14.7)

    Args:
        w, v, friction, given, impulse: As there.
        shift: (n,) the shift to begin with, ≥ 0; takes what is found.

    Returns:
        What the last repetition has changed, in parts of the largest velocity.
    """
    n = len(friction)
    before, largest = np.empty(3 * n), 1e-300
    for i in range(3 * n):
        largest = max(largest, abs(v[i]))
    change = 0.0
    for _ in range(REPETITIONS):
        plastic_impulses(w, v, friction, given, shift, impulse)
        change = 0.0
        for j in range(n):
            for a in range(2):
                before[3 * j + a] = v[3 * j + a]
                for k in range(3 * n):
                    before[3 * j + a] += w[3 * j + a, k] * impulse[k]
            slides = friction[j] * math.hypot(before[3 * j], before[3 * j + 1])
            change = max(change, abs(slides - shift[j]) / largest)
            shift[j] = slides
        if change <= SETTLED:
            break
    return change


@inner
def come_to_rest(system, state, works):
    """Take away approaches that are too slow to be seen, one after the other, by their normals alone.

    A convex program is no use here: it knows the shift of (14.7), and so what sliding contacts are given,
    to a part of the slip only.
    """
    w, v = system.w, state.v
    for _ in range(SWEEPS):
        approaches = False
        for z in range(2, len(v), 3):
            if v[z] < -TINY and w[z, z] > 0.0:
                approaches = True
                push = -v[z] / w[z, z]
                works[z // 3, 0] += 0.5 * v[z] * push
                for i in range(len(v)):
                    v[i] += w[i, z] * push
                v[z] = 0.0
                state.impulse[z] += push
        if not approaches:
            break


@inner
def end_plastically(system, state, works):
    """Bring an impact to its end by a plastic one; return whether that stops all approaches.

    What slides begins with the shift that keeps it on its surface, so that where hardly anything approaches
    hardly anything changes. Where no shift is found the rest loses as much energy as it can. (14.6)
    """
    w, v = system.w, state.v
    n = len(system.friction)
    impulse, zero, shift = np.empty(3 * n), np.zeros(n), np.empty(n)
    for j in range(n):
        shift[j] = system.friction[j] * math.hypot(v[3 * j], v[3 * j + 1])
    if not impulses_together(w, v, system.friction, zero, shift, impulse) <= FOUND:
        plastic_impulses(w, v, system.friction, zero, zero, impulse)
    stopped = True
    for i in range(3 * n):
        change = 0.0
        for k in range(3 * n):
            change += w[i, k] * impulse[k]
        works[i // 3, 0 if i % 3 == 2 else 2] += (v[i] + 0.5 * change) * impulse[i]
    for i in range(3 * n):
        for k in range(3 * n):
            v[i] += w[i, k] * impulse[k]
        state.impulse[i] += impulse[i]
        stopped = stopped and (i % 3 != 2 or v[i] > -STOPPED)
    return stopped
