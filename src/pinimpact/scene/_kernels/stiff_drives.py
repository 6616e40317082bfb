"""Stiff drives and joint damping in an implicit step, see `step_radau`.

A drive of damping d on a joint of little inertia settles at the rate N d, where N = ∂v̇/∂τ includes the active
set; an explicit step is stable up to about five of the corresponding times. Newton's method uses the
derivatives of the drive laws, ∂v̇/∂v = −N d and ∂v̇/∂q = −N k, with N at the start of the step. Viscous
damping of a joint is such a law with k = 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import assign, nonzero
from ..._numeric.lu import factorize, substitute
from ..._numeric.products import add
from .contact_forces import add_reactions
from .dynamics import evaluate, invert_mass_matrix, set_state
from .radau import GAMMA, MATRIX, SLOW, STAGES
from .workspace import SceneWorkspace

STIFF = 4.0
"""Step size times the rate at which the drives settle above which a step is implicit in them."""

SQUARE = MATRIX @ MATRIX
"""Square of the Runge-Kutta matrix: weights of ξ from the rates of v."""


@inlined
def driven_velocities(work):
    """Return the velocities on which a linear law acts: drives within their effort limits, and damping."""
    side, stiffness = work.drive_side, work.drive_stiffness
    drive_damping, damping = work.drive_damping, work.damping
    held = work.modes[work.contacts + work.limits :]
    marks = np.zeros(len(held), dtype=np.int64)
    for j in range(len(held)):
        follows = side[j] == 0 and (stiffness[j] > 0.0 or drive_damping[j] > 0.0)
        marks[j] = (follows or damping[j] > 0.0) and held[j] == 0
    return nonzero(marks)


@inlined
def law(work, j):
    """Return stiffness and damping of the linear law of velocity j."""
    if work.drive_side[j] != 0:
        return 0.0, work.damping[j]
    return work.drive_stiffness[j], work.drive_damping[j] + work.damping[j]


@inlined
def fill_response(work, driven, response):
    """Fill response (k, nv) with v̇ per unit force of each drive, at the state last evaluated with M⁻¹."""
    for c in range(len(driven)):
        assign(response[c], work.minverse[driven[c]])
    add_reactions(work, response)


@declared(SceneWorkspace)
@external
def rate_of_drives(work):
    """Return an estimate of the largest rate at which drives settle [1/s], at the state last evaluated."""
    if not work.stiff_joints:
        return 0.0
    driven = driven_velocities(work)
    if len(driven) == 0:
        return 0.0
    if work.active_contacts + work.active_scalars == 0 and not invert_mass_matrix(work):
        return 0.0
    response = np.empty((len(driven), len(work.v)))
    fill_response(work, driven, response)
    fastest = 0.0
    for j in driven:
        total = 0.0
        for c in range(len(driven)):
            total += abs(response[c, j]) * law(work, driven[c])[1]
        fastest = max(fastest, total)
    return fastest


class Driven(NamedTuple):
    """Data of the iteration for the k velocities on which a linear law acts.

    Attributes:
        index: (k,) their indices in v.
        response: (k, nv) v̇ per unit of each force.
        stiffness, damping: (k,) coefficients of the laws.
        factors: (stages k, stages k) LU factors of the system of the iteration.
        order: (stages k,) row order of the factors.
    """

    index: Any
    response: Any
    stiffness: Any
    damping: Any
    factors: Any
    order: Any


@inlined
def no_drives(work):
    """Return the `Driven` of a step in which drives are not stiff."""
    index, none = np.empty(0, dtype=np.int64), np.empty(0)
    return Driven(index, np.empty((0, work.nv)), none, none, np.empty((0, 0)), index)


@inlined
def stiff_velocities(work, h):
    """Return the velocities whose laws the iteration of a step needs; M⁻¹ is that of its start.

    Of k laws with N d h ≤ `SLOW`/k each, the sum is at most `SLOW`, which bounds the spectral radius of
    h N diag(d): these terms need only be iterated. Constraints only reduce N from M⁻¹.
    """
    index = driven_velocities(work)
    marks = np.zeros(len(work.v), dtype=np.int64)
    for j in index:
        stiffness, damping = law(work, j)
        rate = work.minverse[j, j] * (damping + h * stiffness)
        marks[j] = h * rate * len(index) > SLOW
    return nonzero(marks)


@inlined
def driven_at(work, t, h):
    """Return the `Driven` at the start of a step, and whether this succeeded."""
    n, s = work.nv, STAGES
    if h * work.drive_rate <= SLOW:
        return no_drives(work), True
    set_state(work, work.q0, work.v0)
    evaluate(work, t, np.empty(n + 4))
    inverted = work.active_contacts + work.active_scalars > 0
    if work.callback_failed or not (inverted or invert_mass_matrix(work)):
        return no_drives(work), False
    index = stiff_velocities(work, h)
    k = len(index)
    if k == 0:
        return no_drives(work), True
    response, stiffness, damping = np.empty((k, n)), np.empty(k), np.empty(k)
    matrix, order = np.empty((s * k, s * k)), np.empty(s * k, dtype=np.int64)
    known = Driven(index, response, stiffness, damping, matrix, order)
    fill_response(work, index, response)
    for c in range(k):
        stiffness[c], damping[c] = law(work, index[c])
    for i in range(s):
        for c in range(k):
            for j in range(s):
                for d in range(k):
                    effect = h * MATRIX[i, j] * damping[d] + h * h * SQUARE[i, j] * stiffness[d]
                    matrix[i * k + c, j * k + d] = effect * response[d, index[c]]
            matrix[i * k + c, i * k + c] += 1.0
    return known, factorize(matrix, order)


@external
def add_response(h, driven, changes):
    """Add the response of the drives to changes of the stage rates, changes (stages, 2 nv or more)."""
    index, response, stiffness, damping, factors, order = driven
    k, n, s = response.shape[0], response.shape[1], len(changes)
    right, force = np.empty(s * k), np.empty((s, k))
    # change of the drive forces by the changes of the rates, first by those of ξ̇
    for i in range(s):
        for c in range(k):
            force[i, c] = 0.0
            for j in range(s):
                force[i, c] -= stiffness[c] * h * MATRIX[i, j] * changes[j, index[c]]
    for i in range(s):
        for c in range(k):
            right[i * k + c] = changes[i, n + index[c]]
            for d in range(k):
                right[i * k + c] += response[d, index[c]] * force[i, d]
    substitute(factors, order, right.reshape((s * k, 1)))
    for i in range(s):
        for c in range(k):
            for j in range(s):
                effect = h * MATRIX[i, j] * damping[c] + h * h * SQUARE[i, j] * stiffness[c]
                force[i, c] -= effect * right[j * k + c]
    for i in range(s):
        for c in range(k):
            add(changes[i, n : 2 * n], force[i, c], response[c])
            for j in range(s):
                changes[i, index[c]] += h * MATRIX[i, j] * right[j * k + c]


@external
def filter_error(h, driven, error):
    """Divide an error (2 nv,) of ξ and v by 1 − γ h times the derivative of the rates by the drive laws."""
    index, response, stiffness, damping, _, _ = driven
    k, n, step = response.shape[0], response.shape[1], GAMMA * h
    matrix, order, right = np.empty((k, k)), np.empty(k, dtype=np.int64), np.empty(k)
    for c in range(k):
        right[c] = error[n + index[c]]
        for d in range(k):
            right[c] -= step * response[d, index[c]] * stiffness[d] * error[index[d]]
            matrix[c, d] = step * response[d, index[c]] * (damping[d] + step * stiffness[d])
        matrix[c, c] += 1.0
    if not factorize(matrix, order):
        return
    substitute(matrix, order, right.reshape((k, 1)))
    for c in range(k):
        force = stiffness[c] * error[index[c]] + (damping[c] + step * stiffness[c]) * right[c]
        add(error[n:], -step * force, response[c])
    for c in range(k):
        error[index[c]] += step * error[n + index[c]]
