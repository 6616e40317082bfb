"""Families of contact-space problems, with one parameter, that cross boundaries of regimes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pinimpact import ImpactProblem, solve_impact

W = np.array([[1.5, 0.25, 0.875], [0.25, 1.125, -0.5], [0.875, -0.5, 1.375]])
SYMMETRIC = np.array([[1.0, 0, 0.75], [0, 2.0, 0], [0.75, 0, 1.0]])
JAMS = np.array([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]])
THRESHOLD = float(np.linalg.norm(np.linalg.solve(W[:2, :2], W[:2, 2])))


@dataclass(frozen=True)
class Sweep:
    """Problems as a function of a parameter x.

    Attributes:
        label: Meaning and unit of x.
        start, end: Range of x.
        problem: Returns the problem at x.
        jumps: Number of jumps of the impact map in the range.
        factor: Returns F (3, 2) and r (2) at x with W = FFᵀ and v = F r, for singular W.
    """

    label: str
    start: float
    end: float
    problem: Callable[[float], ImpactProblem]
    jumps: int = 0
    factor: Callable[[float], tuple[np.ndarray, np.ndarray]] | None = None

    def answer(self, x: float) -> np.ndarray:
        """Return v⁺ and P at x (6,)."""
        solution = solve_impact(self.problem(x))
        return np.concatenate([solution.velocity, solution.impulse])

    def steepest(self, places: int, number: int) -> list[tuple[float, float]]:
        """Return the `number` intervals of an equidistant grid on which the solution changes most."""
        x = np.linspace(self.start, self.end, places)
        steps = np.abs(np.diff([self.answer(y) for y in x], axis=0)).max(axis=1)
        return [(x[k], x[k + 1]) for k in np.argsort(-steps)[:number]]

    def close_in(self, low: float, high: float) -> tuple[float, float, float]:
        """Bisect towards the larger change until no double is in between; return interval and change."""
        first, last = self.answer(low), self.answer(high)
        while True:
            middle = (low + high) / 2
            if not low < middle < high:
                return low, high, float(np.abs(last - first).max())
            half = self.answer(middle)
            if np.abs(half - first).max() >= np.abs(last - half).max():
                high, last = middle, half
            else:
                low, first = middle, half


def _edge(law: str) -> Callable[[float], ImpactProblem]:
    return lambda v3: ImpactProblem(JAMS, [0.5, 12, v3], 1.5, 1.0, law)


FACTOR = np.array([[1.0, 0.25], [0.375, -0.75]])
"""Jacobian of a planar arm times the root of its inverse inertia; rows are along the floor, and up."""


def _leaning(tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return F and r of an arm whose plane deviates from the normal by an angle."""
    F = np.array([FACTOR[0], np.sin(tilt) * FACTOR[1], np.cos(tilt) * FACTOR[1]])
    return F, np.array([0.25, 1.0])


def _parallel(v3: float) -> tuple[np.ndarray, np.ndarray]:
    """Return F and r of an arm that moves almost along the floor, with a slip of about 1 and velocity v₃."""
    normal = 0.125 * FACTOR[1]
    made = v3 * normal / (normal @ normal) + np.array([-normal[1], normal[0]]) / np.linalg.norm(normal)
    return np.array([FACTOR[0], FACTOR[1], normal]), made


def _made(factor: Callable[[float], tuple[np.ndarray, np.ndarray]]) -> Callable[[float], ImpactProblem]:
    def problem(x: float) -> ImpactProblem:
        F, r = factor(x)
        return ImpactProblem(F @ F.T, F @ r, 0.9, 0.5)

    return problem


SWEEPS = {
    "1 friction through the stick threshold": Sweep(
        "μ / threshold − 1",
        -0.3,
        0.3,
        lambda x: ImpactProblem(W, [0.1, -0.2, -1.0], THRESHOLD * (1 + x), 0.5),
    ),
    "2 slip through the stable invariant direction": Sweep(
        "angle off it [rad]",
        -0.5,
        0.5,
        lambda x: ImpactProblem(SYMMETRIC, [2 * np.cos(x), 2 * np.sin(x), -1.0], 0.4, 0.5),
    ),
    "2 slip through the unstable invariant direction": Sweep(
        "angle off it [rad]",
        -0.5,
        0.5,
        lambda x: ImpactProblem(SYMMETRIC, [-2 * np.cos(x), 2 * np.sin(x), -1.0], 0.4, 0.5),
    ),
    "3 sliding speed through zero": Sweep(
        "v₁ [m/s]", -0.2, 0.2, lambda x: ImpactProblem(W, [x, x * x, -1.0], 0.4, 0.5)
    ),
    "5 approach speed towards zero in jam": Sweep(
        "v₃ [m/s]", -0.2, 0.0, lambda x: ImpactProblem(JAMS, [1.0, 0.5, x], 1.5, 0.5)
    ),
    "6 the second compression's edge, Poisson": Sweep("v₃ [m/s]", -0.56, -0.5, _edge("poisson"), 1),
    "6 the second compression's edge, energetic": Sweep("v₃ [m/s]", -0.48, -0.42, _edge("energetic"), 1),
    "7 restitution towards zero": Sweep(
        "e", 0.0, 0.1, lambda e: ImpactProblem(JAMS, [0.5, 12, -0.5], 1.5, e, "energetic")
    ),
    "8 smallest eigenvalue through its tolerance": Sweep(
        "ln λ / ‖W‖",
        -40.0,
        -10.0,
        lambda x: ImpactProblem(
            np.array([[1.5, 0, 1.5], [0, 3, 0], [1.5, 0, 1.5]])
            + 1.5 * np.exp(x) * np.outer([1, 0, -1], [1, 0, -1]),
            [-0.75, 0.75, -0.75],
            0.5,
            0.8,
        ),
    ),
    "8a tilt of an arm's plane through zero": Sweep("tilt [rad]", -0.5, 0.5, _made(_leaning), 1, _leaning),
    "8a approach through zero, parallel to the floor": Sweep(
        "v₃ [m/s]", -0.02, 0.01, _made(_parallel), 1, _parallel
    ),
}
