"""How rows of a time step bend along its velocity, and how that changes with the state. (derivatives.md, 12)

Velocities at the end of a step are J v⁺ + ½h J̇ v, with J and J̇ v at its midpoint (16.2). Axes stand still for
tangential components; along the normal it is the second rate of the gap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..robot.derivatives import Tree
from ..robot.many_derivatives import ContactRow, RowSlopes, rows_of
from ..robot.placed_robot import PlacedRobot

PART = 1e-4
"""Part of a step from its midpoint to where rates along its velocity are computed from: their error is half
of it in second rates, which count for half a step, or rounding over it."""


class RowBends(NamedTuple):
    """Bends of the rows of contacts, in the axes of the `RowSlopes`.

    Attributes:
        bends: (k, 3) J̇ v [m/s²].
        by_q, by_v: (k, 3, nv) how they change, in axes that follow the configuration.
    """

    bends: Array
    by_q: Array
    by_v: Array


class _Along(NamedTuple):
    """Velocities of contacts at a configuration, against the surface in the world, and how they change.

    Attributes:
        velocity: (k, 3).
        by_q, by_v: (k, 3, nv) changes by this configuration and by v.
        follows: (k, 3, nv) by how corners move over the shapes with the configuration at the midpoint.
        rate, rate_by_q, rate_by_v, rate_follows: The same of the rates of gaps.
    """

    velocity: Array
    by_q: Array
    by_v: Array
    follows: Array
    rate: Array
    rate_by_q: Array
    rate_by_v: Array
    rate_follows: Array


def row_bends(model: pin.Model, data: pin.Data, h: float, slopes: RowSlopes, q: Array, v: Array) -> RowBends:
    """Return the bends of the rows of contacts of a step of length h [s], with slopes at q (nq,); v is (nv,).

    The data are overwritten.
    """
    k, nv, s = len(slopes.rows), len(v), PART * h
    if not v.any() or not k:
        return RowBends(np.zeros((k, 3)), *np.zeros((2, k, 3, nv)))
    turn, push = pin.dIntegrate(model, q, s * v)
    placed = PlacedRobot(model, data, pin.integrate(model, q, s * v))
    tree = Tree.of(placed)
    rows = rows_of(placed, tree, slopes.carried, True)[1]
    start = _along(0.0, slopes.fixed, slopes.tree.motions(v), slopes, v)
    end = _along(s, rows, tree.motions(v), slopes, v)
    axes, turns = np.array(slopes.axes), np.array([row.turns for row in slopes.rows])
    bends = (end.velocity - start.velocity) / s
    by_q = (end.by_q @ turn + end.follows - start.by_q - start.follows) / s
    by_v = end.by_q @ push + (end.by_v - start.by_v) / s
    found = RowBends((axes @ bends[:, :, None])[:, :, 0], axes @ (by_q + _skews(bends) @ turns), axes @ by_v)
    found.bends[:, 2] = (end.rate - start.rate) / s
    found.by_q[:, 2] = (end.rate_by_q @ turn + end.rate_follows - start.rate_by_q - start.rate_follows) / s
    found.by_v[:, 2] = end.rate_by_q @ push + (end.rate_by_v - start.rate_by_v) / s
    return found


def less_turning(found: RowBends, slopes: RowSlopes, still: Array, by_v: Array) -> RowBends:
    """Return bends along velocities of free bodies in axes that stand still: without J (ω × v).

    Args:
        found: Bends along constant v.
        slopes: Slopes of the rows.
        still: (nv,) ω × v.
        by_v: (nv, nv) its derivative.
    """
    if not slopes.rows or not by_v.any():
        return found
    motions = slopes.tree.motions(still)
    jacobian = np.array([row.axes @ row.jacobian for row in slopes.rows])
    by_q = np.array([row.slopes(motions) for row in slopes.rows])
    return RowBends(found.bends - jacobian @ still, found.by_q - by_q, found.by_v - jacobian @ by_v)


def _along(t: float, rows: list[ContactRow], motions: Array, slopes: RowSlopes, v: Array) -> _Along:
    """Return velocities v of the contacts at the configuration of some rows, a time t after the midpoint."""
    axes, jacobian = (np.array([getattr(row, name) for row in rows]) for name in ("axes", "jacobian"))
    along = np.array([row.slopes(motions, True) for row in rows])
    velocity = jacobian @ v - np.array([row.of_surface for row in rows])
    by_q = axes.transpose(0, 2, 1) @ along - _skews(velocity) @ np.array([row.turns for row in rows])
    follows, normals, signs = np.zeros_like(by_q), axes[:, 2], slopes.signs[:, None]
    rate_follows = np.zeros_like(follows[:, 0])
    for i, (row, follow, fixed) in enumerate(zip(rows, slopes.rows, slopes.fixed, strict=True)):
        if follow is not fixed:  # a corner moves over the shapes, which carry that on
            tip, base = motions[row.place.tip, 3:], motions[row.place.base, 3:]
            moves = (follow.place.shifts - fixed.place.shifts)[:, :3].T
            tilt = -pin.skew(fixed.axes[2]) @ (follow.turns - fixed.turns)
            moves, tilt = moves + t * pin.skew(tip) @ moves, tilt + t * pin.skew(base) @ tilt
            follows[i] = pin.skew(tip - base) @ moves
            rate_follows[i] = normals[i] @ follows[i] + velocity[i] @ tilt
    return _Along(
        *(signs * velocity, signs[:, None] * by_q, signs[:, None] * jacobian, signs[:, None] * follows),
        *((normals * velocity).sum(axis=1), along[:, 2], (normals[:, None] @ jacobian)[:, 0], rate_follows),
    )


def _skews(vectors: Array) -> Array:
    """Return the matrices (k, 3, 3) of the cross products with vectors (k, 3)."""
    return np.array([pin.skew(one) for one in vectors])
