"""How the methods take a problem, and where they write what is wanted beside the answer."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

Inputs = tuple[float, float, float, float, float, float, float, float, float, float, float, int, float, Array]
"""w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃, v₁, v₂, v₃, μ, e, the law's code, `ImpactProblem.velocity_scale` or 0, and
the numbers of a factor of W, see `FACTOR`, or none."""

FACTOR = 7
"""Numbers of a factor: c₁₁, c₂₁, c₂₂, c₃₁, c₃₂, c₃₃ of the lower triangular C with W = CCᵀ, and the size of
the numbers that C was formed from."""


def triangle_of(numbers: Array) -> Array:
    """Return C (3, 3) from the numbers of a factor."""
    c11, c21, c22, c31, c32, c33 = numbers[:-1].tolist()
    return np.array([[c11, 0.0, 0.0], [c21, c22, 0.0], [c31, c32, c33]])


ENTRY = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where the entries of W stand in the first six of `Inputs`."""

NO_FACTOR: Array = np.empty(0)
"""Instead of a factor that is not known."""

NO_ROWS: Array = np.empty((0, 6))
"""Instead of a trace or path that is not wanted."""
