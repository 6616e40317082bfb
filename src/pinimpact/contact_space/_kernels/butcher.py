"""Runge–Kutta methods as tables of their coefficients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tableau(NamedTuple):
    """Explicit Runge–Kutta method for dP_t/dP₃.

    Attributes:
        a: (m, m) strictly lower triangular.
        c: (m,) row sums of `a`.
        b: (m,) weights of the step.
        area: (m,) weights of ∫ P_t dP₃ over the step, b(1 − c), for the work.
        error: (m,) weights of the error estimate; zeros for none.
        grading: m of `slip_steps.graded` for fixed steps near v_t = 0; 0 for none.
    """

    a: NDArray[np.float64]
    c: NDArray[np.float64]
    b: NDArray[np.float64]
    area: NDArray[np.float64]
    error: NDArray[np.float64]
    grading: float


def _tableau(rows: list[list[float]], b: list[float], lower: list[float] | None = None) -> Tableau:
    m = len(b)
    a = np.zeros((m, m))
    for i, row in enumerate(rows):
        a[i + 1, : len(row)] = row
    c, weights = a.sum(axis=1), np.array(b)
    error = weights - np.array(lower) if lower else np.zeros(m)
    return Tableau(a, c, weights, weights * (1.0 - c), error, 0.0)


# the area below a straight line
EULER = _tableau([], [1.0])._replace(area=np.array([0.5]))

RK4 = _tableau([[1 / 2], [0, 1 / 2], [0, 0, 1]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])._replace(grading=5.0)

# Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19–26
DORMAND_PRINCE = _tableau(
    [
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0],
    [5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40],
)
