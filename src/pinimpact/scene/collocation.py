"""Collocation of the derivatives of a motion at Radau points. (docs/derivatives.md, 9)

"Changes" (2nv, n) are as in `saltation`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre
from numpy.polynomial.legendre import legvander

from .._numeric.tolerances import RANK
from ..arrays import Array, Integers
from ._kernels.variations import changes_across, changes_at_end, stage_equations
from .mode_slopes import SlopesWithin


class Radau(NamedTuple):
    """A collocation method of Radau (IIA).

    Attributes:
        nodes: (s,) c, in [0, 1].
        weights, twice: (s, s) A and A².
        modes: (s, s) coefficients in Legendre polynomials of values at the nodes.
        decay, power: The error estimate is the last coefficient times `decay` and this power of the ratio of
            the last coefficient to the first, as for e^{zt} with z → 0. (D24)
    """

    nodes: Array
    weights: Array
    twice: Array
    modes: Array
    decay: float
    power: float


def _radau(stages: int, decay: float, power: float) -> Radau:
    """Return the method with s stages, of order 2s − 1 with constraints too."""
    nodes = np.real((Legendre.basis(stages - 1) - Legendre.basis(stages)).roots()) / 2.0 + 0.5
    powers = np.arange(1, stages + 1)
    integrals = nodes[:, None] ** powers / powers
    weights = integrals @ np.linalg.inv(nodes[:, None] ** (powers - 1))
    modes = np.asarray(np.linalg.inv(legvander(2.0 * nodes - 1.0, stages - 1)), dtype=float)
    return Radau(nodes, weights, weights @ weights, modes, decay, power)


RULES = _radau(3, 3.0 / 35.0, 1.0), _radau(4, 1.0 / 385.0, 2.0)
"""Rules in the order in which they are tried: three stages suffice for the short steps of a control, and four
need fewer intervals otherwise."""


def collocate(
    rule: Radau, nodes: SlopesWithin, h: float, x: Array, turned: Integers, force: Array, given: int
) -> tuple[Array, float]:
    """Return the changes at the end of an interval, and their relative error. (D23, D24)

    Args:
        rule: The method.
        nodes: Slopes of the motion at its s nodes.
        h: Length of the interval [s].
        x: (2nv, n) changes at its start.
        turned: Indices of the velocities of joints that rotate.
        force: (nv, n) changes of a constant generalized force.
        given: Number of columns by forces, which follow those by the state.
    """
    columns, slopes = (len(x), given), nodes[:5]
    if nodes.unique:
        end, error, regular = changes_across(h, *rule, turned, *columns, force, *slopes, x)
        if regular:
            return end, error
    matrix, right, start, moved, _ = stage_equations(h, *rule[:3], turned, force, False, *slopes, x)
    rates = _with_least_forces(matrix.reshape(*right.shape[:2], -1), right, nodes)
    return changes_at_end(h, *rule[1:], turned, *columns, nodes.inverse, start, moved, rates)


def _with_least_forces(matrix: Array, right: Array, nodes: SlopesWithin) -> Array:
    """Return the rates (s nv, n) with the forces of equally stiff contacts that stop active contacts. (D23)

    Columns with NaN stay NaN.

    Args:
        matrix: (s, nv + m or nv + 2 m, s nv) equations of the rates, of the constraint velocities, and of
            changes of the shares of forces that are not unique; see `stage_equations`.
        right: (s, nv + m or nv + 2 m, n) their right-hand sides.
        nodes: Slopes at the s stages.
    """
    (stages, nv, m), n = nodes.response.shape, right.shape[2]
    pushed = np.zeros((stages, nv, stages, m))
    for i, response in enumerate(nodes.response):
        pushed[i, :, i] = response
    both = np.concatenate([right[:, :nv], pushed.reshape(stages, nv, -1)], axis=2)
    rates = np.linalg.solve(matrix[:, :nv].reshape(stages * nv, -1), both.reshape(stages * nv, -1))
    rows = -matrix[:, nv:] @ rates
    rows[..., :n] += right[:, nv:]
    size, columns = stages * m, n + stages * m
    velocities, matrix = np.split(rows[:, :m].reshape(size, columns), [n], axis=1)
    moved = matrix.diagonal()
    shares = np.zeros((stages, m, columns))
    for i in range(stages):
        left, sizes, _ = np.linalg.svd(nodes.by_state[i, nv : nv + m, nv:] @ nodes.response[i])
        null = left[:, sizes <= RANK * sizes[0]]
        onto = moved.max() * null @ null.T
        if rows.shape[1] > m:
            shares[i] = -onto @ rows[i, m:]
        shares[i, :, n + i * m : n + (i + 1) * m] += onto
    known = np.isfinite(velocities).all(axis=0)
    shared = shares.reshape(size, columns)
    found, right = np.full_like(velocities, np.nan), np.vstack([velocities, shared[:, :n]])[:, known]
    matrix = np.vstack([matrix, shared[:, n:]])
    found[:, known] = np.linalg.lstsq(matrix, right, rcond=RANK)[0]
    return np.asarray(rates[:, :n] - rates[:, n:] @ found)
