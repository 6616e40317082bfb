"""Histograms of many results, one below the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .style import COMPRESSION, FLOW, RESTITUTION, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
BARS = 40


def distributions(columns: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw columns of numbers as histograms with median and 90 % range, those of text as bars.

    Args:
        columns: Arrays (n,) by name; NaN is omitted, and infinite values count for quantiles only.
    """
    from matplotlib import pyplot

    rows = -(-len(columns) // COLUMNS)
    figure = pyplot.figure(figsize=(3.2 * COLUMNS, 2.1 * max(rows, 1)), layout="constrained")
    for k, (name, values) in enumerate(columns.items()):
        ax = figure.add_subplot(rows, COLUMNS, k + 1)
        ax.set_title(plain(name), fontsize="small")
        ax.tick_params(labelsize="x-small")
        if values.dtype.kind in "fiu":
            _histogram(ax, values)
        else:
            names, counts = np.unique(values.astype(str), return_counts=True)
            ax.barh([plain(str(name)) or "none" for name in names], counts / len(values), color=COMPRESSION)
            ax.set_xlim(0.0, 1.0)
    return figure


def _histogram(ax: Axes, values: NDArray[Any]) -> None:
    values = np.asarray(values, dtype=float)
    values = values[~np.isnan(values)]
    drawn = values[np.isfinite(values)]
    ax.set_yticks([])
    if len(drawn) == 0:
        return
    with np.errstate(over="ignore"):
        steps = float(np.ptp(drawn) / np.spacing(np.abs(drawn).max()))  # numbers that a double can represent
    ax.hist(drawn, bins=int(min(BARS, len(np.unique(drawn)), max(steps, 1.0))), color=FLOW)
    quantiles = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf")
    for value, style in zip(quantiles, (":", "-", ":"), strict=True):
        if np.isfinite(value):
            ax.axvline(float(value), color=RESTITUTION, ls=style)
