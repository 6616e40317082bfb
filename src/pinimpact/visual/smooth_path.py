"""The path of one impact, with enough points to be drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from .._numeric.tolerances import EPS, HALF_DIGITS
from ..arrays import Array
from ..contact_space.many_solution import ManySolution
from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Path, Solution
from ..contact_space.solve import solve_impact


def smooth_path(problem: ImpactProblem, solution: Solution) -> Path:
    """Return the path of an impact, with points close enough for straight lines between them.

    A solution without a path is solved again with ``record=True``, by "exact".
    """
    path = solution.path
    if path is None:
        path = solve_impact(problem, record=True).path
        assert path is not None  # record=True
    if len(path.impulse) == 0:  # no impact: the velocity is constant
        start = np.asarray(problem.velocity, dtype=float)
        return Path(np.zeros(2), np.array([start, start]), np.zeros((2, 3)))
    return path


class Solved(NamedTuple):
    """An impact problem with its solution, without a robot."""

    problem: ImpactProblem
    solution: Any


def parts_at(problem: ImpactProblem, solution: ManySolution) -> list[Solved]:
    """Return the parts of an impact at the contacts, with paths if its policy has any.

    A problem solved without ``record=True`` is solved again. Options of the policy are not known here, so the
    path is used only if the impulses are the same.
    """
    path = solution.path
    if path is None:
        again = solve_impact(problem, record=True, simultaneous=solution.simultaneous)
        path = again.path if np.array_equal(again.impulse, solution.impulse) else None
    whole = replace(solution, path=path if path is not None and len(path.clock) > 1 else None)
    used = replace(problem, law=solution.law)
    return [Solved(used.part(k), whole.part(k)) for k in range(len(solution.velocity))]


def invariant_directions(problem: ImpactProblem) -> Array:
    """Return the invariant directions of slip as angles in (−π, π] [rad]; empty if all directions are.

    They are the roots of g(φ) = σ⊥ᵀ(b − μAσ), a trigonometric polynomial of degree two (theory.md, 3.1):
    in z = e^{iφ}, the roots on the unit circle of a polynomial of degree four.
    """
    w: Any = np.asarray(problem.delassus, dtype=float)
    mu = float(problem.friction)
    b1, b2 = w[0, 2], w[1, 2]
    # g = b₂ cos φ − b₁ sin φ − μ (A₁₂ cos 2φ + ½ (A₂₂ − A₁₁) sin 2φ), as Σ cₖ zᵏ with c₋ₖ = c̄ₖ
    first = 0.5 * (b2 + 1j * b1)
    second = -0.5 * mu * (w[0, 1] - 0.5j * (w[1, 1] - w[0, 0]))
    scale = max(abs(first), abs(second))
    if scale <= 64.0 * EPS * np.abs(w[:2]).max() * max(mu, 1.0):
        return np.empty(0)
    coefficients = np.array([second, first, 0.0, np.conj(first), np.conj(second)]) / scale
    if abs(coefficients[0]) < 64.0 * EPS:
        coefficients = coefficients[1:-1]
    roots = np.roots(coefficients)
    # a double root is accurate to half of the digits
    angles = np.angle(roots[np.abs(np.abs(roots) - 1.0) < 64.0 * HALF_DIGITS])
    return np.unique(np.round(angles, 9))
