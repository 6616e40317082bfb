"""Coefficients of Bogacki and Shampine's Runge-Kutta method of order 3; its dense output is a cubic.

Source: P. Bogacki, L. F. Shampine, Applied Mathematics Letters 2, 1989. The last row of the first matrix is
the step itself (first same as last).
"""

from __future__ import annotations

import numpy as np

STAGES = 3

NODES = np.array([0.0, 1 / 2, 3 / 4, 1.0])

STEP = np.array([[0.0, 0.0, 0.0], [1 / 2, 0.0, 0.0], [0.0, 3 / 4, 0.0], [2 / 9, 1 / 3, 4 / 9]])

ERROR = np.array([-5 / 72, 1 / 12, 1 / 9, -1 / 8])
"""Error estimate of order 2."""
