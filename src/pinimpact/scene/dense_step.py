"""Steps with dense output."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..arrays import Array, Integers
from ._kernels import dense_output
from .step_taken import StepTaken

WORKS = 4
"""Number of works integrated with the motion: of control, joints, sliding friction and moving surfaces."""

FRICTION = slice(1, 3)
"""Those of friction: in joints, and in sliding contacts."""

SLOPES = dense_output.BASIS * np.arange(1.0, 1.0 + len(dense_output.BASIS))
"""(7, 7) Coefficients of the derivatives of the dense output's terms, by powers of θ."""

WHOLE = 0.999
"""Least covered part of a step that no event ends; less than 1, since the end of a run is rounded."""


@dataclass(slots=True, eq=False, repr=False)
class DenseStep:
    """A step of smooth motion with its dense output.

    Attributes:
        start, end: Times [s]; `end` is before start + h if an event cut the step.
        h: Size of the step that was computed [s].
        q, v, w: (nq,) configuration, (nv,) velocity and (`WORKS`,) work [J] at its start.
        coefficients: (k, 2 nv + `WORKS`) dense output of (ξ, v, w), of at most 7 terms.
        joints: Table of the configuration space.
        closed: The active contacts and their forces, `forces.ClosedSet` or `forces.StepForces`; None: none.
        directions: (2, n, 2) directions of slip at the start and at the end, or None if nothing slips.
        taken: Data of a time step from which its derivatives are computed, or None.
    """

    start: float
    h: float
    q: Array
    v: Array
    w: Array
    coefficients: Array
    joints: Integers
    closed: Any = None
    directions: Array | None = None
    taken: StepTaken | None = None
    end: float = field(init=False)

    def __post_init__(self) -> None:
        self.end = self.start + self.h

    def at(self, t: float) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) at a time [s] within the step."""
        q, v = np.empty(len(self.q)), np.empty(len(self.v))
        theta = (t - self.start) / self.h
        dense_output.state(self.coefficients, theta, self.joints, self.q, self.v, q, v)
        return q, v

    def acceleration(self, t: float) -> Array:
        """Return v̇ (nv,) of the dense output at a time [s] within the step."""
        n, terms = len(self.v), len(self.coefficients)
        powers = ((t - self.start) / self.h) ** np.arange(terms)
        return np.asarray(SLOPES[:terms, :terms] @ powers @ self.coefficients[:, n : 2 * n] / self.h)

    def work_at(self, t: float) -> Array:
        """Return the work (`WORKS`,) [J] at a time [s] within the step."""
        coefficients = self.coefficients[:, -WORKS:]
        if t == self.start + self.h:
            return np.asarray(self.w + coefficients[0])
        increment = np.empty(WORKS)
        dense_output.interpolate(coefficients, (t - self.start) / self.h, increment)
        return self.w + increment
