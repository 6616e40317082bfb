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
    at = [mpf(float(x)) for x in (*v, *np.asarray(W)[np.triu_indices(3)], mu, e)]

    def answer(column: int, step: mpf) -> list[mpf]:
        x = list(at)
        x[column] += step
        matrix = [[x[3], x[4], x[5]], [x[4], x[6], x[7]], [x[5], x[7], x[8]]]
        found = solve_reference(matrix, x[:3], x[9], x[10], law, digits=50)
        return [*found.velocity, *found.impulse]

    found = np.zeros((6, INPUTS))
    with mp.workdps(80):
        for column in columns:
            h = STEP if not to else mpf(10) ** -power
            side = 1 if column >= 9 and at[column] == 0 else -1 if column == 10 and at[column] == 1 else 0
            side = to or side
            if side:
                parts = [answer(column, k * side * h) for k in range(3)]
                change = [(-3 * a + 4 * b - c) / (2 * side * h) for a, b, c in zip(*parts, strict=True)]
            else:
                ahead, behind = answer(column, h), answer(column, -h)
                change = [(a - b) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
            found[:, column] = [float(x) for x in change]
    return found
