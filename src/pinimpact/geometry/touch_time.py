"""Time of contact of two moving convex shapes: conservative advancement.

With n the normal of their gap at a time t, turned from then on at a constant rate Ω, the gap at t + h is at
least

    min_a (n·a + h (n·a)˙) − max_b (n·b + h (n·b)˙) − r − ½ h² β

over the vertices a and b of the cores, with r the radius around both. This is concave in h, so its root is a
time before which nothing touches; there n is recomputed. Ω is such that all extreme vertices, those of a face
or an edge, rise at the same rate: the normal follows the features that are about to touch. As the gap closes
the remaining gap decreases quadratically from step to step, until the last step reaches contact to rounding,
from one side: no contact is missed, however short. With α the largest acceleration of a point of one shape
relative to the other, and v and l the largest relative velocity and distance,
β = α + 2 |Ω| (v + α h) + Ω² l.

For shapes that separate as their contact force decreases, the gap grows like h³ only, which this bound does
not resolve. A second bound uses the second rates at t that close the gap, and a bound γ h³/6 of the
third-order term, from rates along n: shapes that slide over each other keep their gap, however fast they turn
about n. The bound that reaches farther is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import LITTLE
from ..arrays import Array
from .convex_pair import Followed, Touch, Turning, follow, gap, ties, touches
from .convex_shape import PlacedShape, coincidence, cross
from .tolerances import COINCIDE, FAR, SAFETY

MAX_ADVANCES = 20_000
"""Largest number of advances of a pair; one that separates at a thousandth of the acceleration bound needs
some thousands."""

SAMPLES = 8
"""Number of samples of a step for its largest accelerations and their rates."""


class PairState(NamedTuple):
    """Two shapes at a time."""

    a: PlacedShape
    b: PlacedShape
    velocity_a: Array  # (6,) spatial, at the world's origin, linear over angular, in world axes
    velocity_b: Array
    acceleration_a: Array  # (6,) time derivatives of these, at the world's origin
    acceleration_b: Array

    @property
    def mirrored(self) -> PairState:
        """The same, with A and B exchanged."""
        a, b, *rates = self
        return PairState(b, a, rates[1], rates[0], rates[3], rates[2])


class Advance(NamedTuple):
    """Result of an advancement of two shapes."""

    time: float  # its end [s]
    gap: float  # the gap there [m]
    touches: bool  # whether they touch there, closing


class Front(NamedTuple):
    """The features that face each other along a normal, at a time."""

    heights_a: Array  # (n,) heights of the points of A, and their rates
    rates_a: Array
    heights_b: Array  # (m,) heights of the points of B, and their rates
    rates_b: Array
    apart: float  # height of the lowest point of A above the highest of B in contact [m]
    value: float  # the gap [m]
    bend: float  # bound of the second rates, until `until` [m/s²]
    until: float = math.inf  # validity of the bounds [s]
    closing_a: Array | None = None  # (n,), (m,) second rates that close the gap, less a common one [m/s²]
    closing_b: Array | None = None
    third: float = math.inf  # bound of the third rate of the gap, likewise [m/s³]


def first_touch(
    at: Callable[[float], PairState], start: float, end: float, bend: float, floor: float
) -> Advance | None:
    """Return the first contact of two shapes from `start` to `end` [s]; without contact, the state at `end`.

    `at` returns the shapes at a time. `bend` bounds the acceleration of a point of one shape relative to the
    other [m/s²]. A gap below `floor` is taken as zero [m]. None is returned if they neither touch nor
    separate within `MAX_ADVANCES`.
    """
    near: Array | None = None
    fastest: _Fastest | None = None

    def fronts(t: float) -> list[Front]:
        nonlocal near, fastest
        if fastest is None and t > start:  # sampled only if the first bound does not reach the end
            fastest = _fastest(at, start, end)
        state = at(t)
        value, near = gap(state.a, state.b, near)
        closest = coincidence(state.a.shape, state.b.shape)
        turns = [_following_rate(state, value, near)]
        if state.a.shape.radius + state.b.shape.radius > 0.0:
            if value <= closest:
                facing = touches(state.a, state.b, near, closest)
                turns += [normal_rate(one, follow(one, state.a, state.b, near), state) for one in facing]
            return [_front(state, value, near, bend, fastest, turn) for turn in turns]
        if value > closest:
            return [_front(state, value, near, bend, fastest, turns[0])]
        return [
            _front(state, value, one.normal, bend, fastest, _turn(state, one))
            for one in ties(state.a, state.b, near)
        ]

    return advance(fronts, start, end, floor)


def _following_rate(state: PairState, value: float, normal: Array) -> Array:
    """Return the rate (3,) of a normal for which all extreme vertices rise at the same rate."""
    a, b = state.a, state.b
    if value >= FAR * (a.shape.reach + b.shape.reach):
        return np.zeros(3)
    behind = max(value, coincidence(a.shape, b.shape))
    arms, uneven = [], []
    for placed, velocity, sign in ((a, state.velocity_a, 1.0), (b, state.velocity_b, -1.0)):
        heights = sign * (placed.vertices @ normal)
        foremost = placed.vertices[heights <= heights.min() + behind]
        foremost = foremost - foremost.mean(axis=0)
        arms.append(foremost - np.outer(foremost @ normal, normal))
        uneven.append(foremost @ cross(normal, velocity[3:]))
    turn = -np.linalg.lstsq(np.concatenate(arms), np.concatenate(uneven), rcond=COINCIDE)[0]
    return np.asarray(turn - (turn @ normal) * normal)


def _turn(state: PairState, one: Turning) -> Array:
    """Return the rate (3,) of the normal of a face or of two edges."""
    spin_a, spin_b = state.velocity_a[3:], state.velocity_b[3:]
    if one.edges is None:
        return cross(spin_a if one.of_a else spin_b, one.normal)
    return _edges_turn(one.edges[0], one.edges[1], one.normal, spin_a, spin_b)


def _edges_turn(u: Array, w: Array, normal: Array, spin_a: Array, spin_b: Array) -> Array:
    """Return the rate (3,) of the normal of two edges: ṅ = (Ṅ − n n·Ṅ)/|N| with N = ± u × w."""
    across = cross(u, w)
    rate = cross(cross(spin_a, u), w) + cross(u, cross(spin_b, w))
    rate = rate / math.copysign(float(np.linalg.norm(across)), float(across @ normal))
    return np.asarray(rate - (rate @ normal) * normal)


class _Fastest(NamedTuple):
    """Bounds of the motion of points of two shapes relative to each other, from samples of a step."""

    second: float  # acceleration [m/s²]
    third: float  # its rate [m/s³]
    thirds_a: Array  # (k, n, 3), (k, m, 3) rates of the accelerations of the vertices in each interval
    thirds_b: Array

    def third_along(self, normal: Array) -> float:
        """Return the bound of the rate of the acceleration along a direction [m/s³]."""
        a, b = self.thirds_a @ normal, self.thirds_b @ normal
        return float(max((a.max(axis=1) - b.min(axis=1)).max(), (b.max(axis=1) - a.min(axis=1)).max()))


def _fastest(at: Callable[[float], PairState], start: float, end: float) -> _Fastest:
    """Return the `_Fastest` of a step."""
    states = [at(t) for t in np.linspace(start, end, 1 + SAMPLES).tolist()]
    accelerations = [_accelerations(state, _velocities(state)) for state in states]
    second = SAFETY * max(_most(*both) for both in accelerations)
    thirds_a, thirds_b = (
        SAFETY * SAMPLES / (end - start) * np.diff(one, axis=0) for one in zip(*accelerations, strict=True)
    )
    third = max(_most(*both) for both in zip(thirds_a, thirds_b, strict=True))
    return _Fastest(second, third, thirds_a, thirds_b)


def _velocities(state: PairState) -> list[Array]:
    """Return the velocities (n, 3), (m, 3) of the vertices of both cores."""
    return [
        velocity[:3] + cross(velocity[3:], placed.vertices)
        for placed, velocity in ((state.a, state.velocity_a), (state.b, state.velocity_b))
    ]


def _accelerations(state: PairState, velocities: list[Array]) -> list[Array]:
    """Return the accelerations (n, 3), (m, 3) of the vertices of both cores, from their velocities."""
    return [
        rate[:3] + cross(rate[3:], placed.vertices) + cross(velocity[3:], moving)
        for placed, velocity, rate, moving in (
            (state.a, state.velocity_a, state.acceleration_a, velocities[0]),
            (state.b, state.velocity_b, state.acceleration_b, velocities[1]),
        )
    ]


def _most(one: Array, other: Array) -> float:
    """Return an upper bound of |x − y| for rows x of `one` (n, 3) and y of `other` (m, 3)."""
    mean = 0.5 * (one.mean(axis=0) + other.mean(axis=0))
    return sum(float(np.linalg.norm(each - mean, axis=1).max()) for each in (one, other))


def _front(
    state: PairState, value: float, normal: Array, bend: float, most: _Fastest | None, turn: Array
) -> Front:
    """Return the `Front` along a normal that turns at the rate `turn` (3,).

    `value` is the gap, `bend` the bound of the relative acceleration, `most` that of `_fastest`, if known.
    """
    a, b = state.a, state.b
    size = a.shape.reach + b.shape.reach
    heights_a, heights_b = a.vertices @ normal, b.vertices @ normal
    center = a.vertices[heights_a.argmin()]
    velocities = _velocities(state)
    moving_a, moving_b = velocities
    spin = float(np.linalg.norm(turn))
    speed = _most(moving_a, moving_b)
    until = math.sqrt(size / bend) if bend > 0.0 else size / speed if spin * speed > 0.0 else math.inf
    far, curving = size + max(value, 0.0), bend
    if spin > 0.0:
        curving += 2.0 * spin * (speed + bend * until) + 2.0 * spin * spin * far
    now = Front(
        heights_a,
        moving_a @ normal + (a.vertices - center) @ turn,
        heights_b,
        moving_b @ normal + (b.vertices - center) @ turn,
        a.shape.radius + b.shape.radius,
        value,
        curving,
        until,
    )
    if most is None:
        return now
    seconds = [
        speeding @ normal + 2.0 * (moving @ turn) - spin * spin * (placed.vertices - center) @ normal
        for placed, moving, speeding in zip(
            (a, b), velocities, _accelerations(state, velocities), strict=True
        )
    ]
    common = 0.5 * (seconds[0][heights_a.argmin()] + seconds[1][heights_b.argmax()])
    third = most.third_along(normal)
    if spin > 0.0:
        speed += most.second * until
        far += speed * until
        third += spin * (until * most.third + 3.0 * most.second + 3.0 * spin * speed + spin * spin * far)
    return now._replace(
        closing_a=np.minimum(seconds[0] - common, 0.0),
        closing_b=np.maximum(seconds[1] - common, 0.0),
        third=third,
    )


def advance(fronts: Callable[[float], list[Front]], start: float, end: float, floor: float) -> Advance | None:
    """Return the first contact of features that face each other, until a time; see `first_touch`.

    A negative gap at the start, rounding after a separation, is subtracted from all gaps. `fronts` returns
    the `Front` along the normal at a time, or those along several equally good normals.
    """
    t, base = start, math.inf
    for _ in range(MAX_ADVANCES):
        found = fronts(t)
        value = found[0].value
        base = min(value, 0.0) if base == math.inf else base
        steps = [_step(one._replace(value=value - base), end - t, floor) for one in found]
        step = max(steps)
        if step <= 0.0 or t + step <= t:
            return Advance(t, value, True)
        if t + step >= end or step == end - t:
            return Advance(end, value, False)
        t += step
    return None


def _step(now: Front, left: float, floor: float) -> float:
    """Return the time without contact along a normal; zero if there is contact, closing."""
    if now.value <= floor:
        lowest = now.heights_a <= now.heights_a.min() + floor
        highest = now.heights_b >= now.heights_b.max() - floor
        closing = float(now.rates_b[highest].max() - now.rates_a[lowest].min())
        if closing > (math.sqrt(2.0 * now.bend * floor) if now.value >= -floor else 0.0):
            return 0.0
    first, other = now.heights_a.argmin(), now.heights_b.argmax()
    gap_now = max(now.value, floor)
    raised = gap_now - float(now.heights_a[first] - now.heights_b[other] - now.apart)
    longest = min(left, now.until)
    if now.bend > 0.0:  # upper limit: the time at which the bound of the two extreme vertices is zero
        rate = float(now.rates_a[first] - now.rates_b[other])
        root = math.sqrt(rate * rate + 2.0 * now.bend * gap_now)
        # without cancellation: accelerations of bodies that slide freely are rounding errors
        longest = min(longest, (rate + root) / now.bend if rate >= 0.0 else 2.0 * gap_now / (root - rate))

    def bound(h: float) -> float:
        lower = (now.heights_a + h * now.rates_a).min() - (now.heights_b + h * now.rates_b).max()
        return float(lower) + raised - now.apart - 0.5 * now.bend * h * h

    step = _clear(bound, longest)
    if now.closing_a is None or now.closing_b is None or step >= min(left, now.until):
        return step
    closing_a, closing_b = 0.5 * now.closing_a, 0.5 * now.closing_b

    def bound_of_third(h: float) -> float:
        low = (now.heights_a + h * (now.rates_a + h * closing_a)).min()
        high = (now.heights_b + h * (now.rates_b + h * closing_b)).max()
        return float(low - high) + raised - now.apart - now.third / 6.0 * h**3

    return max(step, _clear(bound_of_third, min(left, now.until)))


def _clear(bound: Callable[[float], float], longest: float) -> float:
    """Return a lower bound close to the root of a concave function, positive at 0; at most `longest`."""
    high, at_high = longest, bound(longest)
    if at_high >= 0.0:
        return longest
    low, at_low = 0.0, bound(0.0)
    for _ in range(60):
        low_next = low + (high - low) * at_low / (at_low - at_high)  # a chord is below a concave function
        at_next = bound(low_next)
        if not at_next > 0.0:
            return low_next
        if low_next - low <= LITTLE * low_next:
            return low_next
        low, at_low = low_next, at_next
        middle = 0.5 * (low + high)
        at_middle = bound(middle)
        if at_middle >= 0.0:
            low, at_low = middle, at_middle
        else:
            high, at_high = middle, at_middle
    return low


def normal_rate(touch: Touch, now: Followed, state: PairState) -> Array:
    """Return the rate (3,) of the normal of a pair of features, in world axes [1/s]."""
    n, spin_a, spin_b = now.normal, state.velocity_a[3:], state.velocity_b[3:]
    if touch.kind in ("face-vertex", "edge-vertex"):
        mirrored = now._replace(touch=now.touch.mirrored, normal=-n)
        return -normal_rate(touch.mirrored, mirrored, state.mirrored)
    if touch.kind == "vertex-face":
        return cross(spin_b, n)
    if touch.kind == "edge-edge":
        u, w = state.a.edge(touch.features[0]), state.b.edge(touch.features[1])
        return _edges_turn(u, w, n, spin_a, spin_b)
    between = now.touch.point - now.touch.other
    moving = state.velocity_a[:3] + cross(spin_a, now.touch.point)
    moving = moving - state.velocity_b[:3] - cross(spin_b, now.touch.other)
    if touch.kind == "vertex-edge":  # the closest point moves along the edge
        line = state.b.edge(touch.features[1])
        line = line / np.linalg.norm(line)
        moving = moving - line * (line @ moving + cross(spin_b, line) @ between)
    return np.asarray((moving - (moving @ n) * n) / np.linalg.norm(between))
