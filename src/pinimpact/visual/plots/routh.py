"""Routh's diagram: the path of the impulse, the friction cone, the ends of slip and compression."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._numeric.tolerances import HALF_DIGITS
from ...arrays import Array
from ...contact_space.problem import ImpactProblem
from ...errors import InputError
from ..impact_marks import OneImpact
from ..smooth_path import smooth_path
from .one_impact import check_alone, parts, solved
from .style import BLACK, COMPRESSION, GREEN, RESTITUTION, STICK, axes_for, legend


def impulse_space(impact: OneImpact | ImpactProblem, *, ax: Any = None) -> Any:
    """Draw the path of the impulse in the space of impulses (Routh's diagram).

    The plot shows the friction cone |Pₜ| = μP₃, the line of sticking vₜ° + A Pₜ + b P₃ = 0, and the plane of
    maximum compression, v₃° + bᵀPₜ + c P₃ = 0. An impact that stays in one plane is drawn in that plane; any
    other in three dimensions.

    Args:
        impact: A `Hit`, an impact of a trajectory, or an `ImpactProblem`, which is solved.
        ax: Axes to draw into; three-dimensional (``projection="3d"``) unless the impact is planar.

    Raises:
        InputError: Not an impact, an impact at many contacts, or two-dimensional axes for an impact that is
            not planar.
    """
    check_alone(impact, "impulse_space")
    impact = solved(impact)
    problem = impact.problem
    path = smooth_path(problem, impact.solution)
    direction = _plane(problem, path.impulse)
    solid = direction is None if ax is None else ax.name == "3d"
    if not solid and direction is None:
        raise InputError(
            'ax: two-dimensional axes given, but the impact is not planar; use projection="3d"',
            value=ax,
        )
    if solid:
        ax = axes_for(ax, (6.0, 6.0), projection="3d")
        _draw_solid(ax, impact, path.impulse)
    else:
        assert direction is not None
        ax = axes_for(ax, (5.6, 5.4))
        _draw_flat(ax, problem, path.impulse, direction)
    across = None if solid else direction
    for segment, part in parts(path, impact.solution.segments):
        color = COMPRESSION if segment.phase == "compression" else RESTITUTION
        points = path.impulse[part]
        rows = points.T if across is None else ((points[:, :2] @ across), points[:, 2])
        ax.plot(*rows, color=color, lw=2.4, zorder=5, label=f"impulse, {segment.phase}")
    ax.set_title("Impulse space")
    legend(ax, below=True, columns=2)
    return ax


def _plane(problem: ImpactProblem, impulse: Array) -> Array | None:
    """Return the tangential direction of the plane of a planar impact, or None."""
    w = np.asarray(problem.delassus, dtype=float)
    velocity = np.asarray(problem.velocity, dtype=float)
    vectors = np.vstack([impulse[:, :2], velocity[None, :2], w[None, :2, 2]])
    longest = vectors[np.linalg.norm(vectors, axis=1).argmax()]
    length = float(np.linalg.norm(longest))
    direction = longest / length if length > 0.0 else np.array([1.0, 0.0])
    if direction[np.abs(direction).argmax()] < 0.0:
        direction = -direction
    across = np.array([-direction[1], direction[0]])
    for row in (impulse[:, :2], velocity[:2], w[:2, 2], w[:2, :2] @ direction):
        if np.abs(row @ across).max() > HALF_DIGITS * float(np.abs(row).max()):
            return None
    return direction


def _reach(problem: ImpactProblem, impulse: Array) -> tuple[float, float]:
    """Return the height and half the width of the plot [N s]."""
    top = 1.12 * float(impulse[-1, 2]) or 1.0
    aside = max(
        1.25 * float(np.abs(impulse[:, :2]).max()), min(float(problem.friction), 1.0) * top, 0.15 * top
    )
    return top, aside


def _draw_flat(ax: Any, problem: ImpactProblem, impulse: Array, direction: Array) -> None:
    w, v = np.asarray(problem.delassus, dtype=float), np.asarray(problem.velocity, dtype=float)
    mu = float(problem.friction)
    top, aside = _reach(problem, impulse)
    a, b, c = float(direction @ w[:2, :2] @ direction), float(w[:2, 2] @ direction), float(w[2, 2])
    ax.fill(
        [0.0, mu * top, -mu * top], [0.0, top, top], color=STICK, alpha=0.22, lw=0.0, label="friction cone"
    )
    _line(ax, a, b, float(v[:2] @ direction), "line of sticking", GREEN, "--", aside, top)
    _line(ax, b, c, float(v[2]), "line of maximum compression", BLACK, "-.", aside, top)
    turned = np.degrees(np.arctan2(direction[1], direction[0])) + 0.0  # no negative zero
    ax.set(
        xlim=(-aside, aside), ylim=(0.0, top), xlabel=f"Pₜ at {turned:.3g}° from t₁ [N s]", ylabel="P₃ [N s]"
    )


def _line(
    ax: Any, along: float, up: float, start: float, name: str, color: str, dash: str, aside: float, top: float
) -> None:
    """Draw the line start + along Pₜ + up P₃ = 0 across the plot."""
    if along == up == 0.0:
        return
    reach = 4.0 * np.hypot(aside, top)
    foot = -start * np.array([along, up]) / (along**2 + up**2)
    half = reach * np.array([-up, along]) / np.hypot(along, up)
    ends = np.array([foot - half, foot + half])
    ax.plot(ends[:, 0], ends[:, 1], dash, color=color, lw=1.5, label=name)


def _draw_solid(ax: Any, impact: OneImpact, impulse: Array) -> None:
    problem = impact.problem
    w, v = np.asarray(problem.delassus, dtype=float), np.asarray(problem.velocity, dtype=float)
    mu = float(problem.friction)
    top, aside = _reach(problem, impulse)
    height = min(top, aside / mu) if mu > 0.0 else top
    angle, level = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 49), np.linspace(0.0, height, 2))
    x, y = mu * level * np.cos(angle), mu * level * np.sin(angle)
    ax.plot_surface(x, y, level, color=STICK, alpha=0.22, lw=0.0, label="friction cone")
    ax.plot(x[-1], y[-1], level[-1], color=STICK, lw=1.2)
    p3 = np.linspace(0.0, top, 200)
    sticking = -np.linalg.pinv(w[:2, :2]) @ (v[:2, None] + w[:2, 2:] * p3)
    within = np.abs(sticking).max(axis=0) <= aside
    ax.plot(*sticking[:, within], p3[within], "--", color=GREEN, lw=1.8, label="line of sticking")
    if w[2, 2] > 0.0:
        ticks = np.linspace(-aside, aside, 25)
        p1, p2 = np.meshgrid(ticks, ticks)
        plane = -(v[2] + w[0, 2] * p1 + w[1, 2] * p2) / w[2, 2]
        plane = np.where((plane >= 0.0) & (plane <= top), plane, np.nan)
        ax.plot_surface(p1, p2, plane, color=BLACK, alpha=0.12, lw=0.0, label="plane of maximum compression")
    ax.set(xlim=(-aside, aside), ylim=(-aside, aside), zlim=(0.0, top))
    ax.set(xlabel="P₁ [N s]", ylabel="P₂ [N s]", zlabel="P₃ [N s]")
    ax.locator_params(nbins=5)
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=0.87)
    ax.view_init(elev=18.0, azim=-55.0)
