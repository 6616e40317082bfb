"""The regime of an impact over friction and direction of slip, or over friction and restitution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ...arrays import Array, Bools, Integers
from ...checks import in_short
from ...contact_space.batch import BatchSolution, solve_impacts
from ...contact_space.problem import ImpactProblem
from ...errors import InputError
from ...status import Flag, Status
from ..impact_marks import OneImpact
from .one_impact import check_alone
from .style import BLACK, axes_for, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes


REGIMES = (
    ("no impact", "#ffffff"),
    ("no end", "#777777"),
    ("slips to the end", "#b3d4e8"),
    ("comes to stick", "#f4d38a"),
    ("slip stops and resumes", "#e3b3cb"),
)
"""Names and colours of regimes; `classified` returns their indices."""

MARKED = ((Flag.JAM, "jam", "////"), (Flag.SECOND_COMPRESSION, "second compression", "...."))
"""Flags with names and hatches."""


def _over_grid(
    problem: ImpactProblem, turns: bool, most: float, resolution: int
) -> tuple[Array, Array, BatchSolution]:
    """Return n values of μ up to `most`, n angles or restitutions, and the impacts of all pairs."""
    v = np.asarray(problem.velocity, dtype=float)
    low, high = (-np.pi, np.pi) if turns else (0.0, 1.0)
    middles = (np.arange(resolution) + 0.5) / resolution  # not on lines of symmetry, which are exceptional
    mu, other = most * middles, low + (high - low) * middles
    all_mu, all_other = (values.ravel() for values in np.meshgrid(mu, other))
    velocity = np.tile(v, (len(all_mu), 1))
    if turns:
        speed = np.hypot(v[0], v[1])
        velocity[:, 0], velocity[:, 1] = speed * np.cos(all_other), speed * np.sin(all_other)
    restitution = float(problem.restitution) if turns else all_other
    w = np.tile(np.asarray(problem.delassus, dtype=float), (len(all_mu), 1, 1))
    return mu, other, solve_impacts(w, velocity, all_mu, restitution, law=problem.law)


def regime_map(
    impact: OneImpact | ImpactProblem,
    against: Literal["slip angle", "restitution"] = "slip angle",
    *,
    friction: float | None = None,
    resolution: int = 540,
    ax: Axes | None = None,
) -> Axes:
    """Draw the regime of an impact over μ and another parameter; a star marks the impact itself.

    Args:
        impact: A `Hit`, an impact of a trajectory, or an `ImpactProblem`, with the other parameters.
        against: "slip angle", the direction of the initial slip from t₁ at the same speed, or "restitution".
        friction: The largest μ; None for twice the impact's own and twice its stick threshold |A⁺b|, at
            least 1.
        resolution: Number of cells along each axis.
        ax: Axes to draw into.

    Raises:
        InputError: Not an impact, an impact at many contacts, an unknown `against`, or the slip angle of an
            impact that begins without slip.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    check_alone(impact, "regime_map")
    problem = impact if isinstance(impact, ImpactProblem) else impact.problem
    w, v = np.asarray(problem.delassus, dtype=float), np.asarray(problem.velocity, dtype=float)
    speed = float(np.hypot(v[0], v[1]))
    if against not in ("slip angle", "restitution"):
        raise InputError(
            f'against: {in_short(against)} given, "slip angle" or "restitution" expected', value=against
        )
    if against == "slip angle" and speed == 0.0:
        raise InputError(
            'against: "slip angle" given, but the impact begins without slip; "restitution" is possible',
            value=against,
        )
    threshold = float(np.linalg.norm(np.linalg.pinv(w[:2, :2]) @ w[:2, 2]))
    own = float(problem.friction)
    most = max(2.0 * own, 2.0 * threshold, 1.0) if friction is None else friction
    turns = against == "slip angle"
    mu, other, batch = _over_grid(problem, turns, most, resolution)
    codes, hatches = classified(batch.status, batch.flags)
    shape = (resolution, resolution)
    shown = np.degrees(other) if turns else other

    ax = axes_for(ax, (6.8, 4.8))
    colors = ListedColormap([color for _, color in REGIMES])
    ax.pcolormesh(
        mu, shown, codes.reshape(shape), cmap=colors, vmin=-0.5, vmax=len(REGIMES) - 0.5, rasterized=True
    )
    handles = [
        Patch(facecolor=color, edgecolor="#888888", lw=0.5, label=name)
        for code, (name, color) in enumerate(REGIMES)
        if (codes == code).any()
    ]
    for held, (_, name, hatch) in zip(hatches, MARKED, strict=True):
        if held.any():
            grid = held.reshape(shape).astype(float)
            ax.contourf(mu, shown, grid, levels=[0.5, 1.5], colors="none", hatches=[hatch])
            handles.append(Patch(facecolor="white", edgecolor="#555555", lw=0.5, hatch=hatch, label=name))
    here = np.degrees(np.arctan2(v[1], v[0])) if turns else float(problem.restitution)
    (star,) = ax.plot(own, here, "*", color=BLACK, mec="white", ms=14, clip_on=False, label="this impact")
    label = "direction of slip [°]" if turns else "restitution e"
    ax.set(
        xlabel="friction μ",
        ylabel=label,
        xlim=(0.0, most),
        ylim=(-180, 180) if turns else (0, 1),
        title="Regimes",
    )
    if turns:
        ax.set_yticks(np.arange(-180, 181, 90))
    legend(ax, handles=[*handles, star])
    return ax


def classified(status: Integers, flags: Integers) -> tuple[Integers, list[Bools]]:
    """Return the index in `REGIMES` of each of N impacts, and for each of `MARKED` where its flag is set."""
    codes = np.full(status.shape, 2)
    codes[(flags & int(Flag.STICK)) != 0] = 3
    codes[(flags & int(Flag.SLIP_RESUMED)) != 0] = 4
    codes[status == int(Status.NO_IMPACT)] = 0
    codes[(status < 0) | (status > int(Status.LOCKED))] = 1
    return codes, [(flags & int(flag)) != 0 for flag, _, _ in MARKED]
