"""Series of the slow motion, where friction turns slip into equilibrium fast. (theory.md, section 14.5)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, INTEGERS, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, filled, largest
from ..._numeric.products import add, dot
from ..._numeric.semidefinite import forward
from ..._numeric.tolerances import ROUNDOFF
from .codes import SLIPPING
from .propagation_mechanism import new_mechanism
from .propagation_series import (
    ORDER,
    Series,
    answer_of_turn,
    find_mechanism,
    force_inverse,
    forces_of_order,
    hold,
    integrate,
    what_changes,
)
from .propagation_state import State, System, loads

STIFF = 100.0
"""Least ratio of the rate at which slip turns to that of the slow motion, for coordinates that turn fast."""

PASSES = 5
"""Largest number of passes over the orders; each divides the residual of velocities by `STIFF` or more."""

REFINED = 2
"""Number of solutions of each linear system, the second a refinement: L is accurate to `NEGLIGIBLE` only."""

NEAR = 0.1
"""Largest distance of the state from the slow motion after the first pass, over the slowest slip."""


class Stiff(NamedTuple):
    """Response of m slipping contacts to turns of slip, in the r coordinates y of their `Mechanism`.

    Attributes:
        ties: (m,) indices of the contacts.
        answers: (m, 3n) change of the forces per angle of slip at each contact.
        matrix: (r, r) S of (14.5).
        turned: (r, r) S projected onto the coordinates that turn fast.
        right, turn: (2m,) and (r,) scratch.
    """

    ties: Integers
    answers: FloatRows
    matrix: FloatRows
    turned: FloatRows
    right: Floats
    turn: Floats


@declared(System, State, INTEGERS, FLOAT_ROWS, Series, float, FLOAT_ROWS, FLOAT_ROWS, result=float)
@external
def expand_slowly(system, state, unknown, inverse, series, part, slow, residual):
    """Expand the series of the slow motion next to a state. (14.5)

    Args:
        system, state: The `System` and the `State`.
        unknown, inverse: As for `expand`.
        series: Is overwritten with the series.
        part: Rate of turning, relative to the fastest, below which coordinates are integrated as usual.
        slow: (ORDER + 2, 3n) scratch.
        residual: (ORDER + 2, 3n) is overwritten with the residual of velocities: their difference from those
            that the forces cause, starting from the state.

    Returns:
        The time scale of the series, or 0 if there is no slow motion.
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    unknown, inverse, slow = borrowed(unknown), borrowed(inverse), borrowed(slow)
    residual = borrowed(residual)
    ties = _slipping(system, state)
    if len(ties) == 0:
        return 0.0
    rates, n = np.empty(len(system.friction)), len(state.v)
    closed = what_changes(system, state, rates)[0]
    filled(slow.ravel(), 0.0)
    filled(series.changes, 0)
    assign(slow[0], state.v)
    assign(series.v[0], state.v)
    assign(series.indentation[0], state.indentation)
    stiff, mechanism, fixed = _set_up(system, state, series, unknown, inverse, ties, closed)
    fastest = 0.0
    for a in range(len(stiff.matrix)):
        fastest = max(fastest, stiff.matrix[a, a])
    pace, least = 1.0, max(STIFF / fastest, part) if fastest > 0.0 else 1.0
    null = np.zeros(stiff.matrix.shape)
    for turn in range(PASSES + 1):
        if turn == 1:  # pass 0 gives the rate of change of the motion
            if not largest(residual[0]) <= NEAR * _slowest(series, ties):
                return 0.0
            pace = _pace_of(series, ties, slow)
            least = max(STIFF / (pace * fastest), part)
            for i in range(n):
                slow[0, i] = state.v[i]
                slow[1, i] *= pace
        if not least < 1.0:
            return 0.0
        free = len(null) - least_norm(stiff.matrix, np.zeros(len(null)), least, stiff.turn, null)
        _project(stiff, null, free)
        for k in range(ORDER + 1 if turn > 0 else 2):
            if k > 0:
                _keep_fast_part(stiff, mechanism, null[:free], slow[k], series.v[k], residual[k])
            else:
                for i in range(n):
                    series.v[0, i], residual[0, i] = slow[0, i], slow[0, i] - state.v[i]
            forces_of_order(system, state, series, k, False, closed)
            hold(system, state, series.unit[0], unknown, inverse, fixed, series.force[k])
            for _ in range(REFINED):
                _balance(
                    system, series, k, stiff, mechanism, least, (k + 1.0) / pace, slow[k + 1], residual[k]
                )
            assign(slow[k], series.v[k])
            integrate(system, closed, rates, series, k, pace, False)
        if turn > 1 and residual_at(residual, 1.0) <= ROUNDOFF:
            break
    return pace


@inlined
def _slipping(system, state):
    """Return the slipping contacts; none if slip starts from rest or a Hertz contact has just closed."""
    count = 0
    ties = np.empty(len(system.friction), dtype=np.int64)
    for j in range(len(ties)):
        slips = state.tangent[j] == SLIPPING
        rests = state.v[3 * j] == 0.0 and state.v[3 * j + 1] == 0.0
        closes = system.exponent != 1.0 and loads(state.normal[j]) and state.indentation[j] <= 0.0
        if (slips and rests) or closes:
            return ties[:0].copy()
        if slips:
            ties[count] = j
            count += 1
    return ties[:count].copy()


@inlined
def _set_up(system, state, series, unknown, inverse, ties, closed):
    """Return the `Stiff`, the `Mechanism` and scratch for `hold`; fill the coefficients 0 of forces."""
    m, fixed, unit, force = len(ties), np.empty(len(unknown)), series.unit, series.force
    forces_of_order(system, state, series, 0, False, closed)
    hold(system, state, unit[0], unknown, inverse, fixed, force[0])
    for j in ties:
        state.direction[2 * j], state.direction[2 * j + 1] = unit[0, 2 * j], unit[0, 2 * j + 1]
    answers, mechanism = np.empty((m, len(state.v))), new_mechanism(m)
    for c in range(m):
        answer_of_turn(system, state, unit[0], unknown, inverse, fixed, ties[c], force[0], answers[c])
    # the mechanism needs a symmetric response, so friction of held contacts is left out of it
    none, even = np.zeros(unit.shape[1]), np.empty((len(unknown), len(unknown)))
    force_inverse(system, state, none, unknown, np.ones(len(system.friction)), even)
    find_mechanism(system, state, none, unknown, even, fixed, ties, force[0], mechanism)
    r = mechanism.rank[0]
    matrix, right, turn = np.zeros((r, r)), np.empty(2 * m), np.empty(r)
    for c in range(m):
        for a in range(2 * m):
            right[a] = dot(system.w[3 * ties[a // 2] + a % 2], answers[c])
        forward(mechanism.lower, mechanism.order, r, right, turn)
        for a in range(r):
            add(matrix[a], -turn[a] / series.speed[0, ties[c]], mechanism.across[c])
    return Stiff(ties, answers, matrix, np.empty((r, r)), right, turn), mechanism, fixed


@inlined
def _project(stiff, null, free):
    """Fill `turned`, S without its part along the first `free` rows of `null`, which are integrated."""
    matrix = stiff.matrix
    for a in range(len(null)):
        assign(stiff.turned[a], matrix[a])
    for b in range(len(null)):
        for k in range(free):
            add(stiff.turned[:, b], -dot(null[k], matrix[:, b]), null[k])


@inlined
def _slowest(series, ties):
    """Return the least slip speed of the contacts `ties`."""
    least = math.inf
    for j in ties:
        least = min(least, series.speed[0, j])
    return least


@inlined
def _pace_of(series, ties, slow):
    """Return the time, at most 1, in which a slip velocity of the slow motion changes by its own size."""
    pace = 1.0
    for j in ties:
        change = math.hypot(slow[1, 3 * j], slow[1, 3 * j + 1])
        if change > series.speed[0, j]:
            pace = min(pace, series.speed[0, j] / change)
    return pace


@inlined
def _keep_fast_part(stiff, mechanism, null, slow, v, residual):
    """Replace the part of integrated velocities that turns fast by that of the previous pass.

    Args:
        stiff, mechanism: The `Stiff` and the `Mechanism`.
        null: (k, r) coordinates that are integrated.
        slow: (3n,) velocities of the previous pass.
        v: (3n,) integrated velocities; their fast part is overwritten.
        residual: (3n,) is overwritten with the change.
    """
    ties, right, turn = stiff.ties, stiff.right, stiff.turn
    filled(residual, 0.0)
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        right[a] = slow[i] - v[i]
    forward(mechanism.lower, mechanism.order, len(turn), right, turn)
    for row in null:
        add(turn, -dot(row, turn), row)
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        residual[i] = dot(mechanism.lower[a, : len(turn)], turn)
        v[i] += residual[i]


@inlined
def _balance(system, series, k, stiff, mechanism, least, factor, slow, residual):
    """Solve (14.5) for velocities of order k, given those of order k + 1 from the previous pass.

    Args:
        system: The `System`.
        series: Its coefficients k of velocities, directions and forces are updated.
        k: The order.
        stiff, mechanism: The `Stiff` and the `Mechanism`.
        least: Rate of turning, relative to the fastest, below which coordinates are left as they are.
        factor: (k + 1) over the time scale.
        slow: (3n,) velocities of order k + 1.
        residual: (3n,) sum of the changes of order k; the change is added.
    """
    ties, right, turn = stiff.ties, stiff.right, stiff.turn
    v, speed, unit, force = series.v, series.speed, series.unit, series.force
    r = len(turn)
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        right[a] = dot(system.w[i], force[k]) - factor * slow[i]
    unbalanced = np.empty(r)
    forward(mechanism.lower, mechanism.order, r, right, unbalanced)
    least_norm(stiff.turned, unbalanced, least, turn, np.empty((0, r)))
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        change = dot(mechanism.lower[a, :r], turn)
        v[k, i] += change
        residual[i] += change
    for c in range(len(ties)):
        j = ties[c]
        x = dot(mechanism.across[c, :r], turn) / speed[0, j]
        speed[k, j] += dot(mechanism.along[c, :r], turn)
        dx, dy = unit[0, 2 * j], unit[0, 2 * j + 1]
        unit[k, 2 * j] -= x * dy
        unit[k, 2 * j + 1] += x * dx
        add(force[k], x, stiff.answers[c])


@inlined
def residual_at(residual, h):
    """Return a bound on the residual of velocities on [0, h], Σ |coefficient| hᵏ; inf if it diverges."""
    largest = 0.0
    for i in range(residual.shape[1]):
        total = abs(residual[ORDER, i])
        for k in range(ORDER - 1, -1, -1):
            total = total * h + abs(residual[k, i])
        if not total < math.inf:
            return math.inf
        largest = max(largest, total)
    return largest
