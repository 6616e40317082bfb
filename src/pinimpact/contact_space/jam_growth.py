"""Impacts without collision: growth of indentations where no admissible forces exist. (theory.md, 13.2)"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import wraps
from itertools import combinations
from typing import Any

import numpy as np

from .._numeric.tolerances import UNDETERMINED
from ..arrays import Array, Bools
from ._kernels.tolerances import LEAST_NUDGE, NUDGE, SLOW
from .many_inputs import ManyInputs, rows_of
from .many_solution import ManySolution, Run

MOST_CHOSEN = 12
"""Largest number of contacts of which all subsets are tried."""


def nudged(velocity: Array, slips: Bools, growing: Array) -> Array:
    """Return velocities (n, 3) with the approach at which an impact without collision begins. (13.2)

    Args:
        velocity: (n, 3) velocities [m/s].
        slips: (n,) whether each contact slips.
        growing: (n,) relative indentations.
    """
    speed = float(np.abs(velocity).max(initial=0.0))
    fastest = velocity[int(np.argmax(growing * slips))]
    approach = max(NUDGE * math.hypot(fastest[0], fastest[1]), LEAST_NUDGE * speed)
    return np.column_stack([velocity[:, :2], velocity[:, 2] - approach * growing])


def from_rest(run: Run) -> Run:
    """Return a policy that resolves an impact without collision if no contact approaches and slip jams."""

    @wraps(run)
    def run_nudged(inputs: ManyInputs, record: bool, **options: Any) -> ManySolution:
        velocity, friction = inputs.velocity, inputs.friction
        rest = SLOW * float(np.abs(velocity).max(initial=0.0))
        if velocity[:, 2].min() < -rest:
            return run(inputs, record, **options)
        at = np.flatnonzero(velocity[:, 2] <= rest)
        slips = (np.hypot(velocity[at, 0], velocity[at, 1]) > rest) & (friction[at] > 0.0)
        if slips.any():
            one = inputs.part(at)
            growing = growing_indentations(one.delassus, one.velocity, one.friction, slips, one.stiffness)
            if growing is not None:
                velocity = velocity.copy()
                velocity[at] = nudged(velocity[at], slips, growing)
        return run(inputs._replace(velocity=velocity), record, **options)

    return run_nudged


def friction_of_jam(delassus: Array, velocity: Array, friction: Array, slips: Bools) -> float:
    """Return the factor s* ≥ 1 of friction at which the forces grow without bound, or infinity. (13.1)

    Args:
        delassus: (3n, 3n) Delassus matrix of the active contacts.
        velocity: (n, 3) their velocities [m/s].
        friction: (n,) coefficients of friction.
        slips: (n,) whether each slips.
    """
    rows, along = _slipping_rows(velocity, friction, slips)
    of_rows = delassus[rows]
    weights, basis = np.linalg.eigh(of_rows[:, rows])
    known = weights > UNDETERMINED * weights[-1]
    basis = basis[:, known] / np.sqrt(weights[known])
    # det(1 − s C) = 0
    inverses = np.linalg.eigvals(basis.T @ of_rows @ along @ basis)
    real = inverses.real[np.abs(inverses.imag) <= UNDETERMINED * np.abs(inverses).max()]
    largest = float(real.max(initial=0.0))
    return max(1.0, (1.0 + UNDETERMINED) / largest) if largest > 0.0 else math.inf


def growing_indentations(
    delassus: Array, velocity: Array, friction: Array, slips: Bools, stiffness: Array
) -> Array | None:
    """Return the relative indentations (n,) that grow fastest, with maximum 1, or None if none grow.

    If all contacts do not grow together, subsets are tried that grow while they lift the others. (theory.md,
    13.2, steps 2 and 3) Arguments are those of `friction_of_jam`, and the stiffnesses (n,).
    """
    numbers = delassus, velocity, friction, slips, stiffness
    count = len(velocity)
    for chosen in range(count, 0 if count <= MOST_CHOSEN else count - 1, -1):
        for some in combinations(range(count), chosen):
            grown = _fastest_growth(list(some), *numbers)
            if grown is None:
                continue
            forces, rates = grown
            others = np.delete(rates, some)
            if (
                forces.min() >= -UNDETERMINED * forces.max()
                and others.min(initial=0.0) >= -UNDETERMINED * np.abs(rates).max()
            ):
                return _indentations(some, forces, stiffness)
    return None


def _fastest_growth(
    active: list[int],
    delassus: Array,
    velocity: Array,
    friction: Array,
    slips: Bools,
    stiffness: Array,
) -> tuple[Array, Array] | None:
    """Return the normal forces of the fastest growing indentations of active contacts, or None if none grow.

    The one of largest magnitude is 1. Also returned are the normal accelerations
    (n,) of all contacts under these forces.
    """
    places = rows_of(np.array(active))
    rows, along = _slipping_rows(velocity[active], friction[active], slips[active])
    part = delassus[np.ix_(places, places)]
    system = part[rows][:, rows] - part[rows] @ along
    normal = np.array(rows) % 3 == 2
    held = system[np.ix_(~normal, ~normal)]
    answer = np.zeros((int((~normal).sum()), len(active)))  # tangential forces of the sticking contacts
    if held.size:
        answer = -np.linalg.pinv(held, rcond=UNDETERMINED, hermitian=True) @ system[np.ix_(~normal, normal)]
    pressed = system[np.ix_(normal, normal)] + system[np.ix_(normal, ~normal)] @ answer
    values, vectors = np.linalg.eig(stiffness[active, None] * pressed)
    size = float(np.abs(values).max())
    real = np.abs(values.imag) <= UNDETERMINED * size
    rates = np.where(real, values.real, np.inf)
    fastest = int(np.argmin(rates))
    if not rates[fastest] < 0.1 * UNDETERMINED * size:
        return None
    forces = vectors[:, fastest].real
    forces /= forces[np.argmax(np.abs(forces))]
    of_rows = np.empty(len(rows))
    of_rows[normal], of_rows[~normal] = forces, answer @ forces
    total = -along @ of_rows
    total[rows] += of_rows
    return forces, delassus[2::3, places] @ total


def _indentations(active: Sequence[int], forces: Array, stiffness: Array) -> Array:
    """Return the indentations (n,), with maximum 1, of the normal forces of active contacts."""
    indentations = np.zeros(len(stiffness))
    indentations[list(active)] = np.maximum(forces, 0.0) / stiffness[list(active)]
    return np.array(indentations / indentations.max())


def _slipping_rows(velocity: Array, friction: Array, slips: Bools) -> tuple[list[int], Array]:
    """Return the active rows, and the friction (3n, rows) per unit of each row's force.

    A slipping contact has its normal row only, a sticking one three rows.
    """
    rows, columns = [], []
    for i, (x, y, _) in enumerate(velocity.tolist()):
        for d in (2,) if slips[i] or friction[i] == 0.0 else range(3):
            rows.append(3 * i + d)
            column = np.zeros(3 * len(velocity))
            speed = math.hypot(x, y)
            if slips[i] and speed > 0.0:
                column[3 * i : 3 * i + 2] = friction[i] * x / speed, friction[i] * y / speed
            columns.append(column)
    return rows, np.array(columns).T
