"""The arrays of the workspace that describe a completed step, in one block of memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ._kernels.step_dop853 import TERMS
from ._kernels.workspace import DENSE_TERMS
from .dense_step import WORKS


class StepArrays(NamedTuple):
    """Parts of the block.

    Attributes:
        control_force: (nv,) constant generalized force of the control.
        q0, v0: (nq,) configuration and (nv,) velocity at the start of the next step.
        dense_coefficients: (k, 2 nv + `WORKS`) dense output of the step.
    """

    control_force: Array
    q0: Array
    v0: Array
    dense_coefficients: Array


class StepMemory:
    """The block of memory, which is copied at once: four copies of short arrays take four times as long."""

    def __init__(self, nq: int, nv: int) -> None:
        rates = 2 * nv + WORKS
        self._nv, self._nq, self._end, self._rates = nv, nv + nq, 2 * nv + nq, rates
        self._lengths = (self._end + TERMS * rates).tolist()
        self.values = np.zeros(self._end + DENSE_TERMS * rates)

    def arrays(self, values: Array) -> StepArrays:
        """Return the parts of the block, or of a copy of its first values."""
        nv, nq, end = self._nv, self._nq, self._end
        return StepArrays(values[:nv], values[nv:nq], values[nq:end], values[end:].reshape(-1, self._rates))

    def copy(self, method: int) -> StepArrays:
        """Return copies of the arrays, with the terms of the dense output of a method."""
        return self.arrays(self.values[: self._lengths[method]].copy())
