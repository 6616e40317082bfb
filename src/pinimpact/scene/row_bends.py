"""J̇ v of the contact rows of a time step, and its derivatives by the state. (derivatives.md, 12)

Velocities at the end of a step are J v⁺ + ½h J̇ v, with J and J̇ v at its midpoint (16.2). Tangential
components of J̇ v are in fixed axes; its normal component is the second rate of the gap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..robot._kernels.configuration_slopes import AXES, TURN
from ..robot._kernels.row_slopes import Rows, row_slopes, row_velocities
from ..robot.derivatives import Tree
from ..robot.many_derivatives import ContactRow, RowSlopes, rows_of, stacked
from ..robot.placed_robot import PlacedRobot

PART = 1e-4
"""Increment of the difference quotients along the velocity, in steps h: the truncation error is half of it
times the next rate, and the rounding error inversely proportional to it."""


class RowBends(NamedTuple):
    """J̇ v of k contacts, in the axes of the `RowSlopes`.

    Attributes:
        bends: (k, 3) J̇ v [m/s²].
        by_q, by_v: (k, 3, nv) its derivatives, in axes that follow the configuration.
    """

    bends: Array
    by_q: Array
    by_v: Array


class _Along(NamedTuple):
    """Velocities of k contacts relative to the surface, in world axes, at a configuration, and derivatives.

    Attributes:
        velocity: (k, 3) velocities [m/s].
        by_q, by_v: (k, 3, nv) derivatives by this configuration and by v.
        follows: (k, 3, nv) derivatives by how corners move over the shapes with the midpoint configuration.
        rate, rate_by_q, rate_by_v, rate_follows: The same for the gap rates: (k,) and (k, nv).
    """

    velocity: Array
    by_q: Array
    by_v: Array
    follows: Array
    rate: Array
    rate_by_q: Array
    rate_by_v: Array
    rate_follows: Array


def row_bends(
    model: pin.Model, data: pin.Data, h: float, slopes: RowSlopes, places: Rows, q: Array, v: Array
) -> RowBends:
    """Return J̇ v of the contact rows of a time step, by differences along the velocity.

    Args:
        model: The model.
        data: Its data; they are overwritten.
        h: Step size [s].
        slopes: Derivatives of the rows at q.
        places: Their places.
        q: (nq,) configuration at the midpoint.
        v: (nv,) velocity.
    """
    k, nv, s = len(slopes.rows), len(v), PART * h
    if not v.any() or not k:
        return RowBends(np.zeros((k, 3)), *np.zeros((2, k, 3, nv)))
    turn, push = pin.dIntegrate(model, q, s * v)
    placed = PlacedRobot(model, data, pin.integrate(model, q, s * v))
    tree = Tree.of(placed)
    rows = rows_of(placed, tree, slopes.carried, True)
    corners = [i for i, row in enumerate(slopes.rows) if row is not slopes.fixed[i]]
    fixed = stacked(slopes.tree, slopes.fixed) if corners else places
    start = _along(0.0, slopes.fixed, fixed, corners, slopes, v)
    end = _along(s, rows, stacked(tree, rows), corners, slopes, v)
    axes, turns = _axes(places), _turns(places)
    bends = (end.velocity - start.velocity) / s
    by_q = (end.by_q @ turn + end.follows - start.by_q - start.follows) / s
    by_v = end.by_q @ push + (end.by_v - start.by_v) / s
    found = RowBends((axes @ bends[:, :, None])[:, :, 0], axes @ (by_q + _skews(bends) @ turns), axes @ by_v)
    found.bends[:, 2] = (end.rate - start.rate) / s
    found.by_q[:, 2] = (end.rate_by_q @ turn + end.rate_follows - start.rate_by_q - start.rate_follows) / s
    found.by_v[:, 2] = end.rate_by_q @ push + (end.rate_by_v - start.rate_by_v) / s
    return found


def less_turning(found: RowBends, places: Rows, still: Array, by_v: Array) -> RowBends:
    """Return J̇ v for velocities of free bodies that are constant in fixed axes: J (ω × v) is subtracted.

    Args:
        found: J̇ v for constant v.
        places: The places of the rows.
        still: (nv,) ω × v.
        by_v: (nv, nv) its derivative by v.
    """
    if not len(places.at) or not by_v.any():
        return found
    by_q, jacobian = np.empty((2, *found.by_q.shape))
    row_slopes(places, still, False, by_q)
    row_velocities(places, still, jacobian, np.empty(found.bends.shape))
    jacobian = _axes(places) @ jacobian
    return RowBends(found.bends - jacobian @ still, found.by_q - by_q, found.by_v - jacobian @ by_v)


def _along(
    t: float, rows: list[ContactRow], places: Rows, corners: list[int], slopes: RowSlopes, v: Array
) -> _Along:
    """Return the velocities of contacts at the configuration of `rows`, a time t [s] after the midpoint."""
    along, jacobian, follows = np.zeros((3, len(rows), 3, len(v)))
    velocity, rate_follows = np.empty((len(rows), 3)), np.zeros((len(rows), len(v)))
    row_slopes(places, v, True, along)
    row_velocities(places, v, jacobian, velocity)
    axes, signs = _axes(places), slopes.signs[:, None]
    by_q, normals = axes.transpose(0, 2, 1) @ along - _skews(velocity) @ _turns(places), axes[:, 2]
    for i in corners:  # the corner moves over the shapes, and is carried along by them
        row, follow, fixed, motions = rows[i], slopes.rows[i], slopes.fixed[i], rows[i].tree.motions(v)
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


def _axes(places: Rows) -> Array:
    """Return the axes (k, 3, 3) of contacts as rows."""
    return places.at[:, AXES : AXES + 9].reshape(-1, 3, 3)


def _turns(places: Rows) -> Array:
    """Return the rotations (k, 3, nv) of the axes of contacts per unit of each q_k, in world axes."""
    return places.shifts[:, :, TURN : TURN + 3].transpose(0, 2, 1)


def _skews(vectors: Array) -> Array:
    """Return the matrices (k, 3, 3) of the cross products with vectors (k, 3)."""
    found, (x, y, z) = np.zeros((len(vectors), 3, 3)), vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = z, -y, x
    return found
