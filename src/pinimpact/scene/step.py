"""One adaptive Runge-Kutta step on the configuration manifold, and its dense output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._kernels import stages
from ._kernels.dop853 import DENSE_STAGES

Array = NDArray[np.float64]
Joints = NDArray[np.int64]

QUADRATURES = 4
"""Works that are integrated along: of the control, in the joints, of sliding friction, of moving surfaces."""


class Segment:
    """A stretch of smooth motion with its dense output.

    Attributes:
        start, end: Times [s]; `end` is before start + h where an event cut the step.
        h: Length of the step that was computed [s].
        q, v, w: State at its start.
        coefficients: (7, 2 nv + 4) dense output of (ξ, v, w).
        joints: Table of the configuration space.
    """

    __slots__ = ("coefficients", "end", "h", "joints", "q", "start", "v", "w")

    def __init__(
        self, start: float, h: float, q: Array, v: Array, w: Array, coefficients: Array, joints: Joints
    ) -> None:
        self.start = start
        self.end = start + h
        self.h = h
        self.q = q
        self.v = v
        self.w = w
        self.coefficients = coefficients
        self.joints = joints

    def at(self, t: float) -> tuple[Array, Array]:
        """Return q and v at a time within the step."""
        q, v = np.empty(len(self.q)), np.empty(len(self.v))
        theta = (t - self.start) / self.h
        stages.state(self.coefficients, theta, self.joints, self.q, self.v, q, v)
        return q, v

    def works(self, t: float) -> Array:
        """Return the works w at a time within the step."""
        increment = np.empty(len(self.w))
        coefficients = self.coefficients[:, -len(self.w) :]
        stages.interpolate(coefficients, (t - self.start) / self.h, increment)
        return self.w + increment


class Step:
    """The numbers of a step, which the kernels fill.

    Attributes:
        q0, v0: State at its start.
        q1, v1: State at the end of the step last attempted.
        rates: (16, 2 nv + 4) rates at its stages.
        coefficients: (7, 2 nv + 4) its dense output.
        arrays: All of them, as `step_dop853` takes them.
    """

    def __init__(self, joints: Joints, nq: int, nv: int) -> None:
        self.joints = joints
        self.q0, self.v0 = np.empty(nq), np.empty(nv)
        self.q1, self.v1 = np.empty(nq), np.empty(nv)
        self.rates = np.zeros((DENSE_STAGES, 2 * nv + QUADRATURES))
        self.coefficients = np.empty((7, 2 * nv + QUADRATURES))
        self.arrays = (
            *(joints, self.q0, self.v0, self.q1, self.v1, self.rates),
            *(np.empty(nv), np.empty(nv), np.empty((4, nv)), self.coefficients),
        )

    def first_length(self, rtol: float, atol: float) -> float:
        """Return a cautious length for the first step of a stretch of unknown pace."""
        nv = len(self.v0)
        pace = np.abs(self.rates[0, nv : 2 * nv]) / (atol + rtol * np.maximum(1.0, np.abs(self.v0)))
        fastest = float(pace.max(initial=0.0)) * rtol
        return 0.01 / fastest if fastest > 0.0 else 0.01

    def segment(self, t: float, h: float, q: Array, v: Array, w: Array) -> Segment:
        """Return the step last completed; it began at t in the state q, v, w."""
        return Segment(t, h, q, v, w, self.coefficients.copy(), self.joints)
