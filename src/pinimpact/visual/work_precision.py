"""Work-precision diagrams: error against time, on logarithmic axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

COLUMNS = 4
ROUNDING = float(np.finfo(float).eps)
"""Smallest error that is drawn: relative ones below it are rounding."""


@dataclass(frozen=True, slots=True)
class Curve:
    """Measurements of one method on one problem, and their style."""

    label: str  # in the legend
    seconds: Sequence[float]  # the points, joined by a line; those whose error is NaN are left out
    errors: Sequence[float]
    marker: str = "^"  # Matplotlib's name of it
    color: str | None = None  # Matplotlib's name of it; None for the next of its cycle
    size: float = 4.0  # size of the markers [pt]


def draw_work_precision(panels: Mapping[str, Sequence[Curve]], path: str | Path) -> None:
    """Draw error against time as PNG: curves of panels by title, later ones below earlier ones."""
    columns = min(COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(3.4 * columns + 0.6, 3.0 * rows + 0.9), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (title, curves) in zip(grid, panels.items(), strict=False):
        for below, curve in enumerate(curves):
            measured = zip(curve.seconds, curve.errors, strict=True)
            points = [(time, error) for time, error in measured if not math.isnan(error)]
            axes.loglog(
                [1e6 * time for time, _ in points],
                [max(error, ROUNDING) for _, error in points],
                marker=curve.marker,
                color=curve.color,
                markersize=curve.size,
                linewidth=1,
                label=curve.label,
                zorder=3 - below / len(curves),
            )
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.3)
        axes.set_xlabel("time of one impact [µs]", fontsize=8)
    for axes in grid[::columns]:
        axes.set_ylabel("error of v⁺ and P", fontsize=8)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=140)
