"""Derivatives of reference solutions by difference quotients in multiple precision."""

from __future__ import annotations

import numpy as np
from mpmath import mp, mpf

from .reference import solve_reference

STEP = mpf(10) ** -20
INPUTS = 11
"""Number of inputs: v₁, v₂, v₃, w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃, μ, e."""


def slopes(W, v, mu, e, law: str, columns=range(INPUTS), to: int = 0, power: int = 12) -> np.ndarray:
    """Return ∂(v⁺, P) by the inputs (6, 11), to about twenty digits; one-sided if μ or e is at a bound.

    Columns not in `columns` are zero. With `to`, 1 or −1, all are one-sided, by a step of 10^-power.
    """
    found = np.zeros((6, INPUTS))
    for column in columns:
        value = {9: float(mu), 10: float(e)}.get(column)
        side = 1 if value == 0.0 else -1 if value == 1.0 and column == 10 else 0
        h = STEP if not to else mpf(10) ** -power
        found[:, column] = slope_along(np.eye(INPUTS)[column], W, v, mu, e, law, to or side, h)
    return found


def slope_along(direction, W, v, mu, e, law: str, side: int = 0, h: mpf = STEP) -> np.ndarray:
    """Return the derivative (6,) of (v⁺, P) in a direction (11,) of the inputs; one-sided if `side` is ±1."""
    at = [mpf(float(x)) for x in (*v, *np.asarray(W)[np.triu_indices(3)], mu, e)]

    def answer(step: mpf) -> list[mpf]:
        x = [value + step * mpf(float(part)) for value, part in zip(at, direction, strict=True)]
        matrix = [[x[3], x[4], x[5]], [x[4], x[6], x[7]], [x[5], x[7], x[8]]]
        found = solve_reference(matrix, x[:3], x[9], x[10], law, digits=50)
        return [*found.velocity, *found.impulse]

    with mp.workdps(80):
        if side:
            parts = [answer(k * side * h) for k in range(3)]
            change = [(-3 * a + 4 * b - c) / (2 * side * h) for a, b, c in zip(*parts, strict=True)]
        else:
            change = [(a - b) / (2 * h) for a, b in zip(answer(h), answer(-h), strict=True)]
        return np.array([float(x) for x in change])
