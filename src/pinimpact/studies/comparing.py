"""The difference of two models, with intervals by groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from .. import checks
from ..arrays import Array
from ..checks import in_short, truth_value
from ..errors import InputError
from .estimate import Identified
from .measured import digests, numbered
from .rolling_out import RollOuts

RESAMPLES = 2000
"""Number of resamples of a bootstrap; the ends of a 95 % interval then have errors of 5 % of its length."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The mean errors of one model minus those of another.

    Attributes:
        difference: (k,) means over groups: of roll-outs those of position [m] and rotation [rad], of fits
            the length of the residuals of a row, k = 1, in their unit: √J by energy, 1 by covariance.
        interval: (k, 2) from, to.
        groups: Number of groups; if each is given k times, its copies are one.
    """

    difference: Array
    interval: Array
    groups: int


def compare(
    test: RollOuts | Identified,
    other: RollOuts | Identified,
    paired: bool = True,
    *,
    level: float = 0.95,
    seed: int = 0,
) -> Comparison:
    """Return the difference of the mean errors of two models, with intervals by a bootstrap over groups.

    Args:
        test: Roll-outs of one model, or the fit of one law to impacts.
        other: Those of the other.
        paired: Whether both are of the same recordings or impacts; the differences of each group are then
            resampled.
        level: Level of the intervals.
        seed: Seed of the bootstrap.

    Raises:
        InputError: Paired roll-outs or fits of different data, or of impacts with different weights: fits
            weigh by the kinetic energy of their scene unless they have the same ``covariance=``; errors with
            different units, paired or not; fewer than two groups.
    """
    level, seed = checks.level(level), checks.whole_number("seed", seed, 0)
    (one, measure, data), (two, measured, others) = _by_group("test", test), _by_group("other", other)
    if measured != measure:
        raise InputError(
            f"other: its errors are those of {measured}, those of test of {measure}: their units differ",
            value=other,
        )
    if truth_value("paired", paired) and data != others:
        raise InputError(
            "other: its errors belong to data other than those of test, or weigh them otherwise; give "
            "paired=False for other data, and fits of different scenes the same covariance=",
            value=other,
        )
    options = {"confidence_level": level, "n_resamples": RESAMPLES, "rng": np.random.default_rng(seed)}
    difference = one.mean(axis=0) - two.mean(axis=0)
    if paired:
        found = bootstrap((one - two,), np.mean, axis=0, method="percentile", **options)
    else:

        def apart(a: Array, b: Array, axis: int) -> Array:
            return np.asarray(np.mean(a, axis=axis) - np.mean(b, axis=axis))

        found = bootstrap((one, two), apart, axis=0, method="percentile", **options)
    interval = np.column_stack([found.confidence_interval.low, found.confidence_interval.high])
    return Comparison(difference, interval, len(one))


def _by_group(name: str, model: Any) -> tuple[Array, str, Any]:
    """Return the mean errors (groups, k), what they are, and the groups and digests of the data."""
    if isinstance(model, RollOuts):
        rows = digests(model.time, model.recorded)
        errors, group, measure = model.mean(), numbered(model.group, rows), "roll-outs"
    elif isinstance(model, Identified):
        group, measure, rows = model.group, model.measure, model.rows
        errors = np.linalg.norm(model.fun.reshape(len(group), -1), axis=1)[:, None]
    else:
        group = np.zeros(0, np.int64)
    groups = len(set(group.tolist()))
    if groups < 2:
        raise InputError(
            f"{name}: {in_short(model)} given; roll-outs or a fit of two or more groups expected", value=model
        )
    means = np.array([errors[group == k].mean(axis=0) for k in range(groups)])
    return means, measure, (group.tolist(), rows)
