"""Where a function of time first falls below zero: found between steps too, and located to rounding."""

from __future__ import annotations

import math
from collections.abc import Callable

from ._kernels.guards import clear

Sample = Callable[[float], tuple[float, float]]
"""sample(t) -> the function and its rate."""


def first_crossing(
    sample: Sample,
    a: float,
    b: float,
    start: tuple[float, float],
    end: tuple[float, float],
    curvature: float,
    floor: float,
) -> float | None:
    """Return the first time in (a, b] at which a gap closes, or None.

    Between two times the gap stays above both parabolas that its values, its rates and `curvature` allow there.
    Where those leave room for a dip the interval is halved, so a dip within one step is found however short.

    Args:
        sample: The gap and its rate at a time.
        a, b: The interval [s].
        start, end: The gap and its rate at a and at b. A start at or a rounding below zero is taken as zero.
        curvature: Bound of the second derivative.
        floor: A gap above −floor counts as none (rounding).
    """
    time, (gap, rate) = a, start
    gap = max(gap, 0.0)
    pending = [(b, *end)]
    while pending:
        later, later_gap, later_rate = pending[-1]
        width = later - time
        if clear(gap, rate, later_gap, later_rate, curvature, width, floor):
            pending.pop()
            time, gap, rate = later, max(later_gap, 0.0), later_rate
            continue
        falling = max(rate, later_rate) + 0.5 * curvature * width < 0.0
        if falling and gap > 0.0 and later_gap < 0.0:
            return root(lambda t: sample(t)[0], time, later, gap, later_gap)
        middle = time + 0.5 * width
        if not time < middle < later or width <= 4e-16 * abs(later):
            if later_gap < -floor:
                return later
            pending.pop()
            time, gap, rate = later, max(later_gap, 0.0), later_rate
            continue
        pending.append((middle, *sample(middle)))
    return None


def root(f: Callable[[float], float], a: float, b: float, fa: float, fb: float) -> float:
    """Return where f changes sign between a and b, to rounding, on b's side or exactly (Ridders' method, bisected)."""
    for _ in range(100):
        middle = a + 0.5 * (b - a)
        if not a < middle < b or fb == 0.0:
            break
        fm = f(middle)
        if fm == 0.0:
            return middle
        scale = math.sqrt(fm * fm - fa * fb)
        guess = middle + (middle - a) * math.copysign(fm, fa * fm) / scale if scale > 0.0 else middle
        if fa * fm < 0.0:
            b, fb = middle, fm
        else:
            a, fa = middle, fm
        if a < guess < b:
            fg = f(guess)
            if fg == 0.0:
                return guess
            if fa * fg < 0.0:
                b, fb = guess, fg
            else:
                a, fa = guess, fg
    return b
