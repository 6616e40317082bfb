"""Tests that a gap stays open over a step, from its ends and a bound of its curvature."""

from __future__ import annotations

from .jit import jit


@jit
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


@jit
def unclear_limits(index_q, index_v, sign, bound, q0, v0, q1, v1, peak, width, floor, out):
    """Fill the numbers of the joint limits that may be passed within a step; return how many."""
    count = 0
    for i in range(len(index_q)):
        a, b, s = index_q[i], index_v[i], sign[i]
        gap = max(s * (q0[a] - bound[i]), 0.0)
        if not clear(gap, s * v0[b], s * (q1[a] - bound[i]), s * v1[b], 1.5 * peak[1, b], width, floor):
            out[count] = i
            count += 1
    return count
