"""One adaptive Runge-Kutta step on the configuration manifold, and its dense output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ._kernels import charts, stages
from ._kernels.dop853 import DENSE, DENSE_STAGES, ERROR, NODES, STAGES, STEP

Array = NDArray[np.float64]
Joints = NDArray[np.int64]
Flow = Callable[[float, Array, Array, Array], None]
"""flow(t, q, v, out) fills out with v̇ and those rates of the quadratures that are not zero."""

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


class Integrator:
    """Steps of the Dormand-Prince method of order 8 in a chart about the state at the start of each step.

    Attributes:
        t, q, v, w: The state that the next step starts from.
        q1, v1: The state at the end of the step last attempted.
        peak: (4, nv) the largest |ξ̇| and |v̇| of its stages, and their largest change within it.
    """

    def __init__(self, flow: Flow, joints: Joints, nq: int, nv: int, rtol: float, atol: float) -> None:
        self.flow = flow
        self.joints = joints
        self.nv = nv
        self.rtol = rtol
        self.atol = atol
        self.evaluations = 0
        self._rates = np.zeros((DENSE_STAGES, 2 * nv + QUADRATURES))
        self._flow_rows = [row[nv:] for row in self._rates]
        self._step_rates = self._rates[: STAGES + 1]
        self._nodes = NODES.tolist()
        self._xi = np.empty(nv)
        self._q = np.empty(nq)
        self._v = np.empty(nv)
        self._sizes = np.empty(nv)
        self.q1 = np.empty(nq)
        self.v1 = np.empty(nv)
        self.peak = np.empty((4, nv))

    def start(self, t: float, q: Array, v: Array, w: Array) -> None:
        """Begin a new stretch: after an event, or where the state was corrected."""
        self.t, self.q, self.v, self.w = t, q, v, w
        self._rates[:, 2 * self.nv :] = 0.0
        self._rates[0, : self.nv] = v
        self.flow(t, q, v, self._flow_rows[0])
        self.evaluations += 1

    def first_step(self) -> float:
        """Return a cautious step length for a stretch of unknown pace."""
        nv = self.nv
        acceleration = self._rates[0, nv : 2 * nv]
        charts.magnitudes(self.joints, self.q, self._sizes)
        pace = np.abs(acceleration) / (self.atol + self.rtol * np.maximum(1.0, np.abs(self.v)))
        fastest = float(pace.max(initial=0.0)) * self.rtol
        return 0.01 / fastest if fastest > 0.0 else 0.01

    def attempt(self, h: float) -> float:
        """Compute a step of length h; return its error over the tolerance, infinite if it turns too far."""
        rates, joints, flow, nodes, rows = self._rates, self.joints, self.flow, self._nodes, self._flow_rows
        t, q0, v0, xi, q, v = self.t, self.q, self.v, self._xi, self._q, self._v
        stage = stages.stage
        for i in range(1, STAGES):
            stage(i, h, STEP, rates, v0, joints, q0, xi, q, v)
            flow(t + nodes[i] * h, q, v, rows[i])
        stage(STAGES, h, STEP, rates, v0, joints, q0, xi, self.q1, self.v1)
        if charts.turned_too_far(joints, xi):
            return np.inf
        flow(t + h, self.q1, self.v1, rows[STAGES])
        self.evaluations += STAGES
        charts.magnitudes(joints, q0, self._sizes)
        error = stages.error_norm(h, ERROR, self._step_rates, v0, self.v1, self._sizes, self.rtol, self.atol)
        return float(error) if error == error else np.inf

    def segment(self, h: float) -> Segment:
        """Return the step last attempted, with its dense output; `peak` is filled too."""
        rates = self._rates
        stages.largest(rates, STAGES + 1, self.nv, self.peak)
        for i in range(STAGES + 1, DENSE_STAGES):
            stages.stage(i, h, STEP, rates, self.v, self.joints, self.q, self._xi, self._q, self._v)
            self.flow(self.t + self._nodes[i] * h, self._q, self._v, self._flow_rows[i])
        self.evaluations += DENSE_STAGES - STAGES - 1
        coefficients = np.empty((7, rates.shape[1]))
        stages.dense(h, STEP, DENSE, rates, coefficients)
        return Segment(self.t, h, self.q, self.v, self.w, coefficients, self.joints)

    def go_on(self, h: float, w: Array) -> None:
        """Take the end of the step last attempted as the start of the next one."""
        self.t += h
        self.q = self.q1.copy()
        self.v = self.v1.copy()
        self.w = w
        self._rates[0] = self._rates[STAGES]
        self._rates[0, : self.nv] = self.v
