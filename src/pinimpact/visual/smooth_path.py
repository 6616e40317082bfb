"""The path of one impact, dense enough to be drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Path, Solution
from ..contact_space.solve import solve_impact

Array = NDArray[np.float64]

BETWEEN = 12
"""Points that are drawn for each recorded one where slip turns."""


def smooth_path(problem: ImpactProblem, solution: Solution) -> Path:
    """Return the path of an impact with points close enough for straight lines between them.

    At each recorded point the law of friction gives the slope, dP_t/dP₃ = −μ v_t/|v_t| in slip; between two
    of them the impulse is the cubic that has both points and both slopes, and v = v° + W P. In stick and in
    straight slip that is the straight line.

    Args:
        problem: What was solved.
        solution: Its answer; one without a path is solved once more with ``record=True``, by "exact".
    """
    recorded = solution.path
    if recorded is None:
        recorded = solve_impact(problem, record=True).path
        assert recorded is not None  # it was asked for
    p3, velocity, impulse = recorded.normal_impulse, recorded.velocity, recorded.impulse
    if len(p3) < 2:
        return recorded
    mu = float(problem.friction)
    pieces: list[Array] = []
    for i in range(len(p3) - 1):
        width = p3[i + 1] - p3[i]
        slips = [_direction(velocity[i]), _direction(velocity[i + 1])]
        if slips[0] is None:  # slip that begins at zero keeps its direction, and so does slip that ends there
            slips[0] = slips[1]
        elif slips[1] is None:
            slips[1] = slips[0]
        share = np.linspace(0.0, 1.0, BETWEEN, endpoint=False)[:, None]
        if slips[0] is None or slips[1] is None or np.allclose(slips[0], slips[1], rtol=0.0, atol=1e-12):
            share = share[:1]
        piece = impulse[i] + share * (impulse[i + 1] - impulse[i])
        if slips[0] is not None and slips[1] is not None and len(share) > 1:
            chord = (impulse[i + 1] - impulse[i])[:2]
            piece[:, :2] += share * (1.0 - share) ** 2 * (-mu * width * slips[0] - chord)
            piece[:, :2] -= share**2 * (1.0 - share) * (-mu * width * slips[1] - chord)
        pieces.append(piece)
    dense = np.vstack([*pieces, impulse[-1:]])
    moved: Array = (
        np.asarray(problem.velocity, dtype=float) + dense @ np.asarray(problem.delassus, dtype=float).T
    )
    starts = np.cumsum([0, *map(len, pieces)])
    moved[starts] = velocity  # zero where it is zero
    return Path(dense[:, 2], moved, dense)


def _direction(velocity: Array) -> Array | None:
    speed = float(np.hypot(velocity[0], velocity[1]))
    return velocity[:2] / speed if speed > 0.0 else None


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
