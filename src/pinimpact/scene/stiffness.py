"""Which time steps are too long for a stiff control that is a function. (theory.md, 16.4)"""

from __future__ import annotations

import math

from ._kernels.tolerances import STEPS_STABLE

JUMPS = 1.5
"""Ratio of the rates of two steps above which the control jumps, as one with the sign of a velocity does:
with half of the step size the rate of a jump doubles, that of damping stays."""


class Stiffness:
    """Rejects steps in which the control is unstable; `restart` begins a step of full length."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget the rate of earlier steps."""
        self._rate = math.inf

    def rejects(self, stiffness: float, h: float) -> bool:
        """Return whether a step of length h [s] is to be halved; `stiffness` is that of the `StepResult`."""
        if stiffness <= STEPS_STABLE:
            return False
        rate = stiffness / h
        self._rate = rate if rate <= JUMPS * self._rate else 0.0
        return self._rate > 0.0
