"""Layout of the arguments of the methods."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

Inputs = tuple[float, float, float, float, float, float, float, float, float, float, float, int, float, Array]
"""w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃, v₁, v₂, v₃, μ, e, the law's code, `ImpactProblem.velocity_scale` or 0, and
the factor (FACTOR,) of W, or (0,)."""

FACTOR = 7
"""Length of a factor: c₁₁, c₂₁, c₂₂, c₃₁, c₃₂, c₃₃ of the lower triangular C with W = CCᵀ, and its scale F,
the size of the terms that C is the sum of. (theory.md, 6)"""


def triangle_of(numbers: Array) -> Array:
    """Return C (3, 3) of a factor (FACTOR,)."""
    c11, c21, c22, c31, c32, c33 = numbers[:-1].tolist()
    return np.array([[c11, 0.0, 0.0], [c21, c22, 0.0], [c31, c32, c33]])


ENTRY = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Indices of the entries of W in `Inputs`."""

NO_FACTOR: Array = np.empty(0)
"""An unknown factor."""

NO_ROWS: Array = np.empty((0, 6))
"""No trace, or no path."""
