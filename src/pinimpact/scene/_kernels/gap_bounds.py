"""Tests that a gap stays open over a step, from its ends and bounds of its curvature. (theory.md, 10, 15)"""

from __future__ import annotations

import math

from ..._compile.jit import inlined


@inlined
def curvatures(gap, rate, later_gap, later_rate, width, bounds):
    """Return bounds of the downward curvature −g̈ and of |g̈| of a gap between two times. (10.3), (10.5)

    With y the centre of the tip relative to the surface's carrier and ρ the sum of the gap and the radius
    below, g̈ = n·ÿ + b, 0 ≤ b ≤ |ẏ|²/ρ. The downward curvature therefore needs no bound of ρ; the bound of |g̈|
    is infinite if the tip might reach the centre of curvature.

    Args:
        gap, rate, later_gap, later_rate: Gap and gap rate at both times.
        width: Time between [s].
        bounds: (4,) largest |ÿ|, largest change of ÿ, largest |ẏ|, and the least radius of curvature of the
            surface plus the radius of the tip, infinite for a plane.
    """
    size, change, speed, radius = bounds[0], bounds[1], bounds[2], bounds[3]
    mean = (later_rate - rate) / width
    most = size
    if radius < math.inf:
        least = radius + 0.5 * (gap + later_gap - speed * width)
        if least > 0.0:
            bend = speed / least
            most += bend * speed
            # change of n·ÿ as n turns, and of |ẏ_t|²/ρ: |d/dt| ≤ 2 |ẏ||ÿ|/ρ + 3 |ẏ_t|²|ẏ_n|/ρ²
            change += width * bend * (3.0 * size + 1.2 * bend * speed)
        else:
            most = change = math.inf
    return max(min(size, change - mean), 0.0), min(most, change + abs(mean))


@inlined
def clear(gap, rate, later_gap, later_rate, curvature, width, floor):
    """Return whether a gap provably stays above −floor between two times, `width` [s] apart. (10.4)

    Both lower bounds g + ġ s − B s²/2, B = `curvature`, from the left and right, are concave and meet at one
    point m, so the larger one is least at an end or at m.
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


@inlined
def rim_clear(now, later, radius, curvature, width, floor):
    """Return whether the gap of a rim provably stays above −floor between two times. (15.4)

    From the left the gap y − ρ|w| is at least

        P(s) = y + ẏ s − ρ|w + ẇ s| − (B + ρ C) s²/2,

    and likewise from the right. Both bounds are concave, so it is enough that both are above −floor at one
    common time m. Two values of m are tried: the point where parabolas with the same ends meet, and the
    middle.

    Args:
        now, later: (8,) y, ẏ, w and ẇ at both times, see `contact_motion.rim_and_rates`.
        radius: ρ [m].
        curvature: B + ρ C [m/s²].
        width: Time between [s].
        floor: Tolerance of gaps [m].
    """
    gap, rate = rim_gap(now, radius)
    later_gap, later_rate = rim_gap(later, radius)
    if later_gap < -floor or gap < -floor:
        return False
    middle = 0.5 * width
    slope = later_rate - rate + curvature * width
    m = middle
    if slope > 0.0:
        m = (gap - later_gap + width * (later_rate + 0.5 * curvature * width)) / slope
        m = min(max(m, 0.0), width)
    for _ in range(2):
        if (
            _rim_ahead(now, radius, curvature, m) > -floor
            and _rim_ahead(later, radius, curvature, m - width) > -floor
        ):
            return True
        m = middle
    return False


@inlined
def rim_gap(at, radius):
    """Return gap [m] and gap rate [m/s] of a rim; if it lies flat, the rate just after."""
    w1, w2, w3, d1, d2, d3 = at[2], at[3], at[4], at[5], at[6], at[7]
    size = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    along = w1 * d1 + w2 * d2 + w3 * d3
    growth = along / size if size > 0.0 else math.sqrt(d1 * d1 + d2 * d2 + d3 * d3)
    return at[0] - radius * size, at[1] - radius * growth


@inlined
def _rim_ahead(at, radius, curvature, s):
    """Return P(s) of `rim_clear`; s < 0 is to the left."""
    w1, w2, w3 = at[2] + at[5] * s, at[3] + at[6] * s, at[4] + at[7] * s
    size = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    return at[0] + at[1] * s - radius * size - 0.5 * curvature * s * s
