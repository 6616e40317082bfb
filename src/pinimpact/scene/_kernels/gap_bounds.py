"""Tests that a gap stays open over a step, from its ends and a bound of its curvature."""

from __future__ import annotations

import math

from ..._compile.jit import inlined


@inlined
def curvatures(gap, rate, later_gap, later_rate, width, bounds):
    """Return the largest downward curvature of a gap between two times, and the largest in either direction.

    With y the tip's centre seen from the surface's carrier and ρ = gap + the radius below, the gap's second
    derivative is n·ÿ, plus at most |ẏ|²/ρ and at least nothing where the surface bends away from the tip. So
    the downward curvature needs no bound of ρ. The other one is infinite where the tip might come to the
    centre of curvature.

    Args:
        gap, rate, later_gap, later_rate: The gap and its rate at both times.
        width: The time between.
        bounds: (4,) the largest |ÿ|, how much ÿ varies, the largest |ẏ|; and the least radius of curvature of
            the surface the tip's radius off the true one, infinite for a flat one.
    """
    size, change, speed, radius = bounds[0], bounds[1], bounds[2], bounds[3]
    mean = (later_rate - rate) / width
    most = size
    if radius < math.inf:
        least = radius + 0.5 * (gap + later_gap - speed * width)
        if least > 0.0:
            bend = speed / least
            most += bend * speed
            # of n·ÿ, as n turns, and of |ẏ_t|²/ρ: |d/dt| ≤ 2 |ẏ||ÿ|/ρ + 3 |ẏ_t|²|ẏ_n|/ρ²
            change += width * bend * (3.0 * size + 1.2 * bend * speed)
        else:
            most = change = math.inf
    return max(min(size, change - mean), 0.0), min(most, change + abs(mean))


@inlined
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


@inlined
def rim_clear(now, later, radius, curvature, width, floor):
    """Whether the gap of a rim provably stays above −floor, however fast its lowest point goes round it.

    The gap is y − ρ|w|, with the height y of its centre and w = u × n, and these bend little:
    y(s) ≥ y + ẏ s − B s²/2 and |w(s)| ≤ |w + ẇ s| + C s²/2. So it is at least

        P(s) = y + ẏ s − ρ|w + ẇ s| − (B + ρ C) s²/2

    from the left, from the right alike, and the larger of the two counts. Both are concave, so that both
    being above at one m in between is enough; the m tried are where tangents and curvature make them meet,
    and the middle.

    Args:
        now, later: (8,) y, ẏ, w and ẇ at both ends, see `contact_motion.rim_and_rates`.
        radius: ρ [m].
        curvature: B + ρ C [m/s²].
        width: The time between the ends [s].
        floor: Of gaps [m].
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
    """Return gap and gap rate of a rim; where it lies flat, the rate at which its lowest point falls."""
    w1, w2, w3, d1, d2, d3 = at[2], at[3], at[4], at[5], at[6], at[7]
    size = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    along = w1 * d1 + w2 * d2 + w3 * d3
    growth = along / size if size > 0.0 else math.sqrt(d1 * d1 + d2 * d2 + d3 * d3)
    return at[0] - radius * size, at[1] - radius * growth


@inlined
def _rim_ahead(at, radius, curvature, s):
    """Return P(s) of `rim_clear`, to either side."""
    w1, w2, w3 = at[2] + at[5] * s, at[3] + at[6] * s, at[4] + at[7] * s
    size = math.sqrt(w1 * w1 + w2 * w2 + w3 * w3)
    return at[0] + at[1] * s - radius * size - 0.5 * curvature * s * s
