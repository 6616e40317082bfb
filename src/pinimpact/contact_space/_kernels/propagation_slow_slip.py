"""Slip that is far slower than its direction would turn: series of the slow motion. (theory.md, 14)

Slip of 10⁻⁶ of the largest velocity, as where corners do not lie quite in a plane, turns in a clock of 10⁻⁶
to where friction and the other forces are in equilibrium, and follows that from then on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, INTEGERS, FloatRows, Floats, Integers, declared
from ..._compile.jit import external, inlined
from ..._numeric.elimination import largest_of
from ..._numeric.least_norm import least_norm
from ..._numeric.products import dot
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
"""How often slip would turn, at least, while the slow motion changes by as much as it is."""

PASSES = 5
"""Passes over the orders, at most: each divides what velocities miss by `STIFF` or more."""

REFINED = 2
"""How often linear equations are solved: L is right to `NEGLIGIBLE`, forces then to rounding."""

NEAR = 0.1
"""Part of the speed of a slip by which the slow motion may be off it, where changes are left out."""


class Stiff(NamedTuple):
    """The slips (m,) of a state, and how friction turns them, in coordinates (r,) of their `Mechanism`.

    Attributes:
        ties: (m,) the contacts.
        answers: (m, 3n) what a turn of each changes of the forces.
        matrix: (r, r) S: by how much friction slows down a change of velocities; Σ μF/|v_t| l lᵀ where no
            contact is held and slips.
        turned: (r, r) S without what it makes of slow velocities.
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
def expand_slowly(system, state, unknown, inverse, series, part, slow, missed):
    """Fill the series of the slow motion next to a state, where slip turns fast. (14.5)

    Args:
        part: Of the fastest turn, below which velocities are integrated, as elsewhere.
        slow: (ORDER + 2, 3n) scratch.
        missed: (ORDER + 2, 3n) takes by how much its velocities are not those that forces make from the
            state on.

    Returns:
        The unit of the clock, or 0 where there is no such motion.
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    unknown, inverse, slow, missed = borrowed(unknown), borrowed(inverse), borrowed(slow), borrowed(missed)
    ties = _slipping(system, state)
    if len(ties) == 0:
        return 0.0
    rates, n = np.empty(len(system.friction)), len(state.v)
    closed = what_changes(system, state, rates)[0]
    for i in range(n):
        series.v[0, i] = slow[0, i] = state.v[i]
        series.changes[i] = 0
        for k in range(1, ORDER + 2):
            slow[k, i] = 0.0
    for j in range(len(rates)):
        series.indentation[0, j] = state.indentation[j]
    stiff, mechanism, fixed = _set_up(system, state, series, unknown, inverse, ties, closed)
    fastest = 0.0
    for a in range(len(stiff.matrix)):
        fastest = max(fastest, stiff.matrix[a, a])
    pace, least = 1.0, max(STIFF / fastest, part) if fastest > 0.0 else 1.0
    null = np.zeros(stiff.matrix.shape)
    for turn in range(PASSES + 1):
        if turn == 1:  # the first one shows how fast the motion changes
            if not largest_of(missed[0], 0) <= NEAR * _slowest(series, ties):
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
                _take_slow(stiff, mechanism, null[:free], slow[k], series.v[k], missed[k])
            else:
                for i in range(n):
                    series.v[0, i], missed[0, i] = slow[0, i], slow[0, i] - state.v[i]
            forces_of_order(system, state, series, k, False, closed)
            hold(system, state, series.unit[0], unknown, inverse, fixed, series.force[k])
            for _ in range(REFINED):
                _balance(system, series, k, stiff, mechanism, least, (k + 1.0) / pace, slow[k + 1], missed[k])
            for i in range(n):
                slow[k, i] = series.v[k, i]
            integrate(system, rates, series, k, pace, False)
        if turn > 1 and missed_slowly(missed, 1.0) <= ROUNDOFF:
            break
    return pace


@inlined
def _slipping(system, state):
    """Return the contacts that slip, none where any begins to, is held, or has no series in the clock."""
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
    """Return the `Stiff` of slips, their mechanism, and scratch for `hold`; coefficients 0 are filled."""
    m, fixed, unit, force = len(ties), np.empty(len(unknown)), series.unit, series.force
    forces_of_order(system, state, series, 0, False, closed)
    hold(system, state, unit[0], unknown, inverse, fixed, force[0])
    for j in ties:
        state.direction[2 * j], state.direction[2 * j + 1] = unit[0, 2 * j], unit[0, 2 * j + 1]
    answers, mechanism = np.empty((m, len(state.v))), new_mechanism(m)
    for c in range(m):
        answer_of_turn(system, state, unit[0], unknown, inverse, fixed, ties[c], force[0], answers[c])
    # what forces reach is what they do without friction of what is held, which is symmetric
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
            for b in range(r):
                matrix[a, b] -= turn[a] * mechanism.across[c, b] / series.speed[0, ties[c]]
    return Stiff(ties, answers, matrix, np.empty((r, r)), right, turn), mechanism, fixed


@inlined
def _project(stiff, null, free):
    """Fill `turned`: S without its part along the first rows of null, whose velocities are integrated."""
    r = len(null)
    for b in range(r):
        for a in range(r):
            stiff.turned[a, b] = stiff.matrix[a, b]
        for k in range(free):
            along = 0.0
            for a in range(r):
                along += null[k, a] * stiff.matrix[a, b]
            for a in range(r):
                stiff.turned[a, b] -= along * null[k, a]


@inlined
def _slowest(series, ties):
    """Return the least speed of some contacts."""
    least = math.inf
    for j in ties:
        least = min(least, series.speed[0, j])
    return least


@inlined
def _pace_of(series, ties, slow):
    """Return a unit of the clock in which slow slip changes by as much as it is, at the most 1."""
    pace = 1.0
    for j in ties:
        change = math.hypot(slow[1, 3 * j], slow[1, 3 * j + 1])
        if change > series.speed[0, j]:
            pace = min(pace, series.speed[0, j] / change)
    return pace


@inlined
def _take_slow(stiff, mechanism, null, slow, v, missed):
    """Take the part of velocities (3n,) that turns fast from the pass before; the rest is integrated.

    Args:
        stiff: The slips.
        mechanism: Theirs.
        null: (k, r) coordinates that do not turn fast.
        slow: (3n,) velocities of the pass before.
        v: (3n,) integrated ones, changed.
        missed: (3n,) takes the change.
    """
    ties, right, turn = stiff.ties, stiff.right, stiff.turn
    for i in range(len(missed)):
        missed[i] = 0.0
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        right[a] = slow[i] - v[i]
    forward(mechanism.lower, mechanism.order, len(turn), right, turn)
    for row in null:
        along = dot(row, turn)
        for k in range(len(turn)):
            turn[k] -= along * row[k]
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        missed[i] = dot(mechanism.lower[a, : len(turn)], turn)
        v[i] += missed[i]


@inlined
def _balance(system, series, k, stiff, mechanism, least, factor, slow, missed):
    """Turn slip of order k until forces make of velocities what the pass before has one order higher.

    Args:
        system: The `System`.
        series: Its series.
        k: The order.
        stiff: The slips.
        mechanism: Theirs.
        least: Part of the fastest turn below which velocities stay.
        factor: From that order to forces.
        slow: (3n,) the velocities of that order.
        missed: (3n,) what is added to those of order k, changed.
    """
    ties, right, turn = stiff.ties, stiff.right, stiff.turn
    v, speed, unit, force = series.v, series.speed, series.unit, series.force
    r = len(turn)
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        right[a] = dot(system.w[i], force[k]) - factor * slow[i]
    left = np.empty(r)
    forward(mechanism.lower, mechanism.order, r, right, left)
    least_norm(stiff.turned, left, least, turn, np.empty((0, r)))
    for a in range(len(right)):
        i = 3 * ties[a // 2] + a % 2
        change = dot(mechanism.lower[a, :r], turn)
        v[k, i] += change
        missed[i] += change
    for c in range(len(ties)):
        j = ties[c]
        x = dot(mechanism.across[c, :r], turn) / speed[0, j]
        speed[k, j] += dot(mechanism.along[c, :r], turn)
        dx, dy = unit[0, 2 * j], unit[0, 2 * j + 1]
        unit[k, 2 * j] -= x * dy
        unit[k, 2 * j + 1] += x * dx
        for i in range(force.shape[1]):
            force[k, i] += x * stiff.answers[c, i]


@inlined
def missed_slowly(missed, h):
    """Return by how much velocities on the way to h are not those that forces make from the state on."""
    largest = 0.0
    for i in range(missed.shape[1]):
        total = abs(missed[ORDER, i])
        for k in range(ORDER - 1, -1, -1):
            total = total * h + abs(missed[k, i])
        if not total < math.inf:  # where series diverge from pass to pass
            return math.inf
        largest = max(largest, total)
    return largest
