"""Work-precision diagrams: error over run time, on logarithmic axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .plots.style import plain

COLUMNS = 4
ROUNDING = float(np.finfo(float).eps)
"""Smallest relative error that is drawn; smaller ones are rounding errors."""

Curve = tuple[str, Sequence[tuple[float, float]], Mapping[str, Any]]
"""Label, points (time [s], error), which are omitted where the error is NaN, and line style."""


def draw_work_precision(panels: Mapping[str, Sequence[Curve]], path: str | Path) -> None:
    """Draw error over time as PNG: panels by title, with their curves; the first curve is on top."""
    columns = min(COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(3.4 * columns + 0.6, 3.0 * rows + 0.9), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (title, curves) in zip(grid, panels.items(), strict=False):
        for number, (label, measured, style) in enumerate(curves):
            points = [(time, error) for time, error in measured if not math.isnan(error)]
            axes.loglog(
                [1e6 * time for time, _ in points],
                [max(error, ROUNDING) for _, error in points],
                linewidth=1,
                label=plain(label),
                zorder=3 - number / len(curves),
                **{"marker": "^", "markersize": 4.0, **style},
            )
        axes.set_title(plain(title), fontsize=10)
        axes.grid(alpha=0.3)
        axes.set_xlabel("time of one impact [µs]", fontsize=8)
    for axes in grid[::columns]:
        axes.set_ylabel("error of v⁺ and P", fontsize=8)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=140)
