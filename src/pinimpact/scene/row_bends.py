"""How rows of a time step bend along its velocity, and how that changes with the state. (derivatives.md, 12)

Velocities at the end of a step are J v⁺ + ½h J̇ v, with J and J̇ v at its midpoint (16.2). Axes stand still for
tangential components; along the normal it is the second rate of the gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..robot.derivatives import Tree
from ..robot.many_derivatives import ContactRow, RowSlopes, motions_in, rows_of
from ..robot.placed_robot import PlacedRobot

PART = 1e-4
"""Part of a step from its midpoint to where rates along its velocity are computed from: their error is half
of it in second rates, which count for half a step, or rounding over it."""


class RowBends(NamedTuple):
    """Bends of the rows of contacts, in the axes of the `RowSlopes`.

    Attributes:
        bends: (k, 3) J̇ v [m/s²].
        changes: (k, 3, n) how they change, in axes that follow the configuration.
    """

    bends: Array
    changes: Array


class _Along(NamedTuple):
    """Velocities of contacts at a configuration, and how they change.

    Attributes:
        velocity: (k, 3) against the surface, in the world.
        rate: (k,) of the gap.
        by: (k, 3, n) changes of the first.
        by_rate: (k, n) changes of the second.
    """

    velocity: Array
    rate: Array
    by: Array
    by_rate: Array


def row_bends(
    model: pin.Model,
    data: pin.Data,
    h: float,
    slopes: RowSlopes,
    state: tuple[Array, Array],
    changes: tuple[Array, Array],
) -> RowBends:
    """Return the bends of a step's rows of contacts.

    Args:
        model: The robot's model.
        data: Data that are overwritten.
        h: Length of the step [s].
        slopes: Of its rows, at the configuration.
        state: Configuration (nq,) and velocity (nv,).
        changes: (nv, n) of these.
    """
    k, n = len(slopes.rows), changes[0].shape[1]
    if not state[1].any() or not k:
        return RowBends(np.zeros((k, 3)), np.zeros((k, 3, n)))
    s = PART * h
    ends = [
        _along(*one, slopes, state[1], changes) for one in _places(model, data, slopes, state, changes, s)
    ]
    bends, rates, by, by_rates = ((after - before) / s for before, after in zip(*ends, strict=True))
    found, by_state = np.empty((k, 3)), np.empty((k, 3, n))
    for i, (row, axes) in enumerate(zip(slopes.rows, slopes.axes, strict=True)):
        turned = by[i] - row.turned(bends[i]) @ changes[0]
        found[i], by_state[i] = axes @ bends[i], axes @ turned
        found[i, 2], by_state[i, 2] = rates[i], by_rates[i]
    return RowBends(found, by_state)


def _places(
    model: pin.Model,
    data: pin.Data,
    slopes: RowSlopes,
    state: tuple[Array, Array],
    changes: tuple[Array, Array],
    s: float,
) -> Iterator[tuple[float, list[ContactRow], Array, Array]]:
    """Give time, rows, motions and changes of the configuration at the midpoint, and a time s along v."""
    (q, v), (by_q, by_v) = state, changes
    yield 0.0, slopes.fixed, slopes.motions(v), by_q
    turn, push = pin.dIntegrate(model, q, s * v)
    placed = PlacedRobot(model, data, pin.integrate(model, q, s * v))
    tree = Tree.of(placed)
    rows = rows_of(placed, tree, slopes.carried, True)[1]
    yield s, rows, motions_in(tree, v), turn @ by_q + push @ (s * by_v)


def _along(
    t: float,
    rows: list[ContactRow],
    motions: Array,
    moved: Array,
    slopes: RowSlopes,
    v: Array,
    changes: tuple[Array, Array],
) -> _Along:
    """Return velocities v of the contacts at one of `_places`."""
    by_q, by_v = changes
    k, n = len(rows), by_q.shape[1]
    found = _Along(np.empty((k, 3)), np.empty(k), np.empty((k, 3, n)), np.empty((k, n)))
    for i, (row, sign) in enumerate(zip(rows, slopes.signs.tolist(), strict=True)):
        axes, jacobian = row.axes, row.jacobian
        velocity, along = jacobian @ v - row.of_surface, row.slopes(motions, True)
        found.velocity[i], found.rate[i] = velocity, axes[2] @ velocity
        found.by[i] = (axes.T @ along + row.turned(velocity)) @ moved + jacobian @ by_v
        found.by_rate[i] = along[2] @ moved + axes[2] @ jacobian @ by_v
        if slopes.rows[i] is not slopes.fixed[i]:  # a corner moves over the shapes, which carry that on
            tip, base = motions[row.place.tip, 3:], motions[row.place.base, 3:]
            follows, fixed, n = slopes.rows[i], slopes.fixed[i], slopes.fixed[i].axes[2]
            moves = (follows.place.shifts - fixed.place.shifts)[:, :3].T @ by_q
            tilt = np.cross((follows.turns - fixed.turns).T, n).T @ by_q
            moves, tilt = moves + t * np.cross(tip, moves.T).T, tilt + t * np.cross(base, tilt.T).T
            by_moves = np.cross(tip - base, moves.T).T
            found.by[i] += by_moves
            found.by_rate[i] += axes[2] @ by_moves + velocity @ tilt
        found.velocity[i] *= sign
        found.by[i] *= sign
    return found
