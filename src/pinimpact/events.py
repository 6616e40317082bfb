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
    curvature: tuple[float, float],
    floor: float,
) -> float | None:
    """Return the first time in (a, b] at which a gap closes, or None.

    Between two times the gap stays above both parabolas that its values, its rates and the curvature allow
    there: at most its bound, and within its variation of the mean that the two rates give. Where those leave
        room for a dip the interval is halved, so a dip within one step is found however short.

    Args:
        sample: The gap and its rate at a time.
        a: Start of the interval [s].
        b: Its end.
        start: The gap and its rate at a; a gap at or a rounding below zero is taken as zero.
        end: The gap and its rate at b.
        curvature: Bounds of the second derivative's size, and of its variation.
        floor: A gap above −floor counts as none (rounding).
    """
    time, (gap, rate) = a, start
    gap = max(gap, 0.0)
    pending = [(b, *end)]
    while pending:
        later, later_gap, later_rate = pending[-1]
        width = later - time
        fall, bend = curvatures(rate, later_rate, width, curvature)
        if clear(gap, rate, later_gap, later_rate, fall, width, floor):
            pending.pop()
            time, gap, rate = later, max(later_gap, 0.0), later_rate
            continue
        falling = max(rate, later_rate) + 0.5 * bend * width < 0.0
        if falling and gap > 0.0 and later_gap < 0.0:
            return falling_root(sample, time, later, later_gap, later_rate, 1e-3 * floor)
        middle = time + 0.5 * width
        if not time < middle < later or width <= 4e-16 * abs(later):
            if later_gap < -floor:
                return later
            pending.pop()
            time, gap, rate = later, max(later_gap, 0.0), later_rate
            continue
        pending.append((middle, *sample(middle)))
    return None


def curvatures(
    rate: float, later_rate: float, width: float, bounds: tuple[float, float]
) -> tuple[float, float]:
    """Return the largest downward curvature between two times, and the largest in either direction."""
    size, change = bounds
    mean = (later_rate - rate) / width
    return max(min(size, change - mean), 0.0), min(size, change + abs(mean))


def falling_root(sample: Sample, a: float, b: float, gap: float, rate: float, tolerance: float) -> float:
    """Return where a gap that falls throughout [a, b] closes, by Newton's method from b."""
    t = b
    for _ in range(60):
        guess = t - gap / rate
        if not a < guess < b:
            guess = a + 0.5 * (b - a)
        if guess in (a, b) or abs(guess - t) <= 2e-16 * abs(t):
            break
        t = guess
        gap, rate = sample(t)
        if abs(gap) <= tolerance:
            break
        if gap > 0.0:
            a = t
        else:
            b = t
    return t


def root(f: Callable[[float], float], a: float, b: float, fa: float, fb: float) -> float:
    """Return where f changes sign between a and b, to rounding and not before (Ridders' method)."""
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
