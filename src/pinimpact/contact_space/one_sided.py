"""One-sided derivatives where the two-sided ones do not exist. (docs/derivatives.md, 6)"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._numeric.tolerances import COMPUTED
from ..arrays import Array
from ..checks import in_short
from ..errors import InputError
from ._kernels.tolerances import NEAR_LIMIT
from .inputs import ENTRY, NO_FACTOR, Inputs

STEPS = 1e-5, 1e-6, 1e-8, 1e-10, 1e-12
"""Distances from a boundary at which slopes are evaluated, relative to the size of an input; tried in this
order until the limit of the slopes is known."""

FOLLOWS = 0.05
"""Largest relative difference between the limit of slopes and a difference quotient; at a jump or a root it
is at least a half."""


def check_side(side: int | None, without: str = "") -> None:
    """Raise `InputError` for a side other than 1, −1 or None, or any side if `without` says what has none."""
    if side is None:
        return
    what = f"not available for {without}" if without else f"{in_short(side)} given; 1 or −1 is expected"
    if without or isinstance(side, bool) or side not in (1, -1):
        raise InputError(f"side: {what}", value=side)


def fill_one_sided(
    slopes: Array,
    values: Array,
    sizes: Array,
    side: int,
    moved: Callable[[int, float], tuple[Array, Array] | None],
) -> None:
    """Replace columns of NaN by their one-sided limits, if these exist.

    Args:
        slopes: (m, n) derivatives of the values by the inputs; columns of NaN are overwritten.
        values: (m,) values.
        sizes: (n,) sizes of the inputs; columns of size 0 are left.
        side: 1 or −1.
        moved: moved(k, h) returns the values and their slopes by input k, with that input changed by h; None
            if there is no solution.
    """
    for k in np.flatnonzero(np.isnan(slopes).any(axis=0) & (sizes > 0.0)).tolist():
        unit, best = side * sizes[k], None
        for h in STEPS:
            near = [moved(k, n * h * unit) for n in (1.0, 2.0, 4.0)]
            found = [one[1] for one in near if one is not None]
            if len(found) < len(near) or not np.isfinite(found).all():
                break
            limit, distance = _limit(*found)
            if distance <= NEAR_LIMIT:
                best = limit
                break
        beyond = moved(k, STEPS[0] * unit)
        if best is None or beyond is None:
            continue
        change, size = (beyond[0] - values) / (STEPS[0] * unit), np.linalg.norm(values) / sizes[k]
        if np.linalg.norm(change - best) <= FOLLOWS * (np.linalg.norm(best) + STEPS[0] * size):
            slopes[:, k] = best


def _limit(once: Array, twice: Array, again: Array) -> tuple[Array, float]:
    """Return the limit of slopes at h, 2h and 4h with errors c hᵖ, and the relative distance to it. (D32)"""
    size, change, more = (float(np.linalg.norm(x)) for x in (once, twice - once, again - twice))
    if max(change, more) <= COMPUTED * size:
        return once, 0.0
    if not (more > change > 0.0 and size > 0.0):
        return once, np.inf
    rest = (twice - once) / (more / change - 1.0)
    return once - rest, float(np.linalg.norm(rest)) / size


def fill_one_sided_of_problem(
    inputs: Inputs,
    slopes: Array,
    values: Array,
    side: int,
    evaluate: Callable[[Inputs], tuple[Array, Array] | None],
) -> None:
    """Replace columns of NaN in slopes (6, 14) of v⁺ and P in contact space by their one-sided limits.

    Args:
        inputs: The problem.
        slopes: (6, 14) derivatives; columns of NaN are overwritten.
        values: (6,) v⁺ and P.
        side: 1 or −1.
        evaluate: Returns values (6,) and slopes of a problem; None if it has no solution.
    """
    W, mu = np.array(inputs[:6])[ENTRY], inputs[9]
    sizes = np.sqrt(np.outer(W.diagonal(), W.diagonal())).ravel()
    speed = float(np.linalg.norm(inputs[6:9]))
    every = np.concatenate([np.full(3, speed), sizes, [mu if mu > 0.0 else 1.0, 1.0]])

    def moved(k: int, h: float) -> tuple[Array, Array] | None:
        x: list[Any] = list(inputs)
        if 3 <= k < 12:
            i, j = divmod(k - 3, 3)
            x[ENTRY[i, j]] += h if i == j else 0.5 * h  # half of a change of both symmetric entries
            x[13] = NO_FACTOR
        else:
            x[6 + k if k < 3 else k - 3] += h
        if x[9] < 0.0 or not 0.0 <= x[10] <= 1.0:
            return None
        found = evaluate(tuple(x))
        return None if found is None else (found[0], found[1][:, k])

    fill_one_sided(slopes, values, every, side, moved)
