"""The work-precision diagram of `pinimpact cost`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

if TYPE_CHECKING:
    from ..studies.cost import Report

COLUMNS = 4
STYLES = {
    "exact": ("*", "#d62728"),
    "euler": ("o", "#1f77b4"),
    "rk4": ("s", "#2ca02c"),
    "adaptive": ("D", "#9467bd"),
    "solve_ivp": ("x", "#7f7f7f"),
}
ROUNDING = 1e-17
"""Where an error of zero is drawn."""


def draw(report: Report, path: str | Path) -> None:
    """Draw error against time, one panel for each problem, as PNG.

    Args:
        report: Measurements of `pinimpact.studies.cost.run_cost`.
        path: File to write.
    """
    columns = min(COLUMNS, len(report.problems))
    rows = math.ceil(len(report.problems) / columns)
    figure = Figure(figsize=(3.4 * columns + 0.6, 3.0 * rows + 0.9), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, problem in zip(grid, report.problems, strict=False):
        for method in dict.fromkeys(point.method for point in report.points):
            points = [p for p in report.points if (p.problem, p.method) == (problem, method)]
            points = [p for p in points if not math.isnan(p.error)]
            marker, colour = STYLES.get(method, ("^", None))
            axes.loglog(
                [1e6 * p.cost for p in points],
                [max(p.error, ROUNDING) for p in points],
                marker=marker,
                color=colour,
                markersize=12 if method == "exact" else 4,
                linewidth=1,
                label=method,
                zorder=3 if method == "exact" else 2,
            )
        for contrast in report.contrasts:
            if contrast.problem == problem and not math.isnan(contrast.velocity):
                axes.loglog(
                    [1e6 * contrast.call_seconds],
                    [max(contrast.velocity, contrast.impulse, ROUNDING)],
                    marker={"admm": "P", "pgs": "X"}.get(contrast.solver, "v"),
                    color="#ff7f0e",
                    markersize=6,
                    linestyle="none",
                    label=f"Pinocchio {contrast.solver.upper()} (another model, e = 0)",
                )
        axes.set_title(problem, fontsize=10)
        axes.grid(alpha=0.3)
        axes.set_xlabel("time of one impact [µs]", fontsize=8)
    for axes in grid[::columns]:
        axes.set_ylabel("error of v⁺ and P", fontsize=8)
    for axes in grid[len(report.problems) :]:
        axes.set_visible(False)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=140)
