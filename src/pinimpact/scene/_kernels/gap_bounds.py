"""Tests that a gap stays open over a step, from its ends and a bound of its curvature."""

from __future__ import annotations

from ..._numeric.jit import inner


@inner
def clear(gap, rate, later_gap, later_rate, curvature, width, floor):
    """Whether the gap provably stays above −floor.

    From the left it is at least P(s) = g + ġ s − B s²/2, from the right alike, and the larger of the two
    counts; they meet at one point m, and each is concave, so the ends and m decide.
    """
    if later_gap < -floor or gap < -floor:
        return False
    slope = later_rate - rate + curvature * width
    if slope <= 0.0:
        return True
    m = (gap - later_gap + width * (later_rate + 0.5 * curvature * width)) / slope
    m = min(max(m, 0.0), width)
    left = gap + m * (rate - 0.5 * curvature * m)
    rest = width - m
    right = later_gap - rest * (later_rate + 0.5 * curvature * rest)
    return max(left, right) > -floor if 0.0 < m < width else (left > -floor if m > 0.0 else right > -floor)
