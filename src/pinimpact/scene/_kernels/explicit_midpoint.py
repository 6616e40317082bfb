"""Coefficients of the explicit midpoint method of order 2; its dense output is a cubic.

The last stage is at the end of the step, where the next one starts. With f the right-hand side, the local
error is h³ (f′f′f/6 + f″ff/24), and h (k₁ − 2 k₂ + k₃)/3 is h³ (f′f′f/6 + f″ff/12).
"""

from __future__ import annotations

import numpy as np

STAGES = 2

NODES = np.array([0.0, 1 / 2, 1.0])

STEP = np.array([[0.0, 0.0], [1 / 2, 0.0], [0.0, 1.0]])

ERROR = np.array([1 / 3, -2 / 3, 1 / 3])
"""Error estimate: an upper bound of the local error, term by term."""
