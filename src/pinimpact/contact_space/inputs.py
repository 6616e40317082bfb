"""How the methods take a problem, and where they write what is wanted beside the answer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Inputs = tuple[float, float, float, float, float, float, float, float, float, float, float, int, float]
"""w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃, v₁, v₂, v₃, μ, e, the law's code, and `ImpactProblem.velocity_scale` or 0."""

NO_ROWS: Array = np.empty((0, 6))
"""Instead of a trace or path that is not wanted."""
