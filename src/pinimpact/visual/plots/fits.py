"""Fitted parameters and the residuals of their fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from .style import BLACK, COMPRESSION, RESTITUTION, SKY, plain


def fit_figure(result: Any) -> Figure:
    """Draw the parameters of an `Identified` with 95 % intervals, and its residuals.

    The residuals are ordered, against the quantiles of a normal distribution; a line is such a distribution
    with their median absolute deviation.
    """
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    columns = figure.add_gridspec(len(result.names), 2)
    for row, (name, value, error) in enumerate(
        zip(result.names, result.x.tolist(), result.standard_errors.tolist(), strict=True)
    ):
        ax = figure.add_subplot(columns[row, 0])
        low, high = result.interval(0.95)[row].tolist()
        ax.plot([low, high], [0, 0], color=RESTITUTION, lw=3, solid_capstyle="butt")
        ax.plot(value, 0, "o", color=COMPRESSION)
        margin = 0.5 * (high - low) or 0.1
        ax.set(
            xlim=(low - margin, high + margin), yticks=[], xlabel=f"{plain(name)} = {value:.4g} ± {error:.2g}"
        )
        ax.locator_params(axis="x", nbins=4)
        if row == 0:
            ax.set_title("Parameters, with 95 % intervals")
    right = figure.add_subplot(columns[:, 1])
    residuals = np.sort(result.fun)
    quantiles = norm.ppf((np.arange(len(residuals)) + 0.5) / len(residuals))
    spread = float(np.median(np.abs(residuals))) / norm.ppf(0.75)
    right.plot(quantiles, residuals, ".", color=SKY)
    right.plot(quantiles, spread * quantiles, color=BLACK, lw=0.8)
    right.set(xlabel="normal quantile", ylabel="whitened residual", title="Residuals")
    return figure
