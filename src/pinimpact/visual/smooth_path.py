"""The path of one impact, dense enough to be drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contact_space.many_solution import ManyPath, ManySolution
from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Path, Solution
from ..contact_space.solve import solve_impact

Array = NDArray[np.float64]

BETWEEN = 16
"""Points that are drawn for each recorded one where slip turns."""
CORRECTIONS = 6
"""Steps of Newton's method for how long slip takes from one recorded point to the next."""


def smooth_path(problem: ImpactProblem, solution: Solution) -> Path:
    """Return the path of an impact with points close enough for straight lines between them.

    Between two recorded points slip that turns is integrated in the time of theory.md, 3.1, by Runge-Kutta
    steps; there its direction, the logarithm of its speed and the impulse have smooth rates. What does not
    turn is straight.

    Args:
        problem: What was solved.
        solution: Its answer; one without a path is solved once more with ``record=True``, by "exact".
    """
    recorded = solution.path
    if recorded is not None and solution.part_of is not None:
        return recorded  # other contacts have a part in it; its points are close enough
    if recorded is None:
        recorded = solve_impact(problem, record=True).path
        assert recorded is not None  # it was asked for
    w, start = np.asarray(problem.delassus, dtype=float), np.asarray(problem.velocity, dtype=float)
    velocity, impulse = recorded.velocity, recorded.impulse
    if len(impulse) == 0:  # no impact: the velocity stays what it was
        return Path(np.zeros(2), np.array([start, start]), np.zeros((2, 3)))
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    angle = np.arctan2(velocity[:, 1], velocity[:, 0])
    turn = np.abs(np.angle(np.exp(1j * np.diff(angle))))
    turning = np.flatnonzero((speed[:-1] > 0.0) & (speed[1:] > 0.0) & (turn > 1e-12))
    between = _slip(w, float(problem.friction), angle, speed, impulse, turning)
    pieces = [row[None] for row in impulse]
    for k, piece in zip(turning, between, strict=True):
        pieces[k] = piece
    dense = np.vstack(pieces)
    moved: Array = start + dense @ w.T
    moved[np.cumsum([0, *map(len, pieces[:-1])])] = velocity  # zero where it is zero
    return Path(dense[:, 2], moved, dense)


def many_path(problem: ImpactProblem, solution: ManySolution) -> ManyPath | None:
    """Return the path of an impact at many contacts, None where its policy has none.

    One that was solved without ``record=True`` is solved once more; what comes out then has to be the same,
    for options of the policy are not known here.

    Args:
        problem: What was solved.
        solution: Its answer.
    """
    path = solution.path
    if path is None:
        again = solve_impact(problem, record=True, simultaneous=solution.simultaneous)
        path = again.path if np.array_equal(again.impulse, solution.impulse) else None
    return path if path is not None and len(path.clock) > 1 else None


def _slip(
    w: Array, mu: float, angle: Array, speed: Array, impulse: Array, chosen: NDArray[np.int64]
) -> Array:
    """Return the impulse (k, `BETWEEN`, 3) from each chosen recorded point until shortly before the next."""
    r0, r1 = speed[chosen], speed[chosen + 1]
    ratio = np.log(r1 / r0)
    mean = np.where(np.abs(ratio) > 1e-6, (r1 - r0) / np.where(ratio == 0.0, 1.0, ratio), r0)
    goal = impulse[chosen + 1, 2]
    lasts = (goal - impulse[chosen, 2]) / mean

    def rate(state: Array) -> Array:
        cos, sin, r = np.cos(state[:, 0]), np.sin(state[:, 0]), np.exp(state[:, 1])
        slip = np.stack([cos, sin], axis=1)
        pull = w[:2, 2] - mu * slip @ w[:2, :2]
        along, across = pull[:, 0] * cos + pull[:, 1] * sin, pull[:, 1] * cos - pull[:, 0] * sin
        return np.column_stack([across, along, -mu * r * cos, -mu * r * sin, r])

    def integrated(lasts: Array) -> Array:
        h = (lasts / BETWEEN)[:, None]
        states = [np.column_stack([angle[chosen], np.log(r0), impulse[chosen]])]
        for _ in range(BETWEEN):
            state = states[-1]
            k1 = rate(state)
            k2 = rate(state + 0.5 * h * k1)
            k3 = rate(state + 0.5 * h * k2)
            k4 = rate(state + h * k3)
            states.append(state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
        return np.array(states)

    for _ in range(CORRECTIONS):
        end = integrated(lasts)[-1]
        lasts = np.maximum(lasts + (goal - end[:, 4]) / np.exp(end[:, 1]), 0.5 * lasts)
    found: Array = integrated(lasts)[:-1, :, 2:].transpose(1, 0, 2)
    return found


def invariant_directions(problem: ImpactProblem) -> Array:
    """Return the angles at which slip keeps its direction, in (−π, π] [rad]; empty where all of them do.

    They are the roots of g(φ) = σ⊥ᵀ(b − μAσ), a trigonometric polynomial of degree two (theory.md, 3.1):
    of z = e^{iφ}, a polynomial of degree four whose roots on the unit circle count.
    """
    w: Any = np.asarray(problem.delassus, dtype=float)
    mu = float(problem.friction)
    b1, b2 = w[0, 2], w[1, 2]
    # g = b₂ cos φ − b₁ sin φ − μ (A₁₂ cos 2φ + ½ (A₂₂ − A₁₁) sin 2φ), as Σ cₖ zᵏ with c₋ₖ = c̄ₖ
    first = 0.5 * (b2 + 1j * b1)
    second = -0.5 * mu * (w[0, 1] - 0.5j * (w[1, 1] - w[0, 0]))
    scale = max(abs(first), abs(second))
    if scale <= 1e-14 * max(np.abs(w[:2]).max() * max(mu, 1.0), 1e-300):
        return np.empty(0)
    coefficients = np.array([second, first, 0.0, np.conj(first), np.conj(second)]) / scale
    if abs(coefficients[0]) < 1e-14:
        coefficients = coefficients[1:-1]
    roots = np.roots(coefficients)
    angles = np.angle(roots[np.abs(np.abs(roots) - 1.0) < 1e-6])
    return np.unique(np.round(angles, 9))
