"""Location of the first time within the last completed step at which a function falls below zero.

The function is a kernel `value(work, i, t)` that returns its value and rate at the state set in the
workspace, at time t. The rate may be zero for functions that are only sampled (`search_for_fall`,
`search_for_root`). Searches are generated for each function, since numba does not cache kernels with function
arguments.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined
from ..._numeric.tolerances import EPS, LITTLE
from ...geometry.tolerances import SAFETY
from .dense_output import set_state_within
from .gap_bounds import clear, curvatures
from .slip import set_directions_within

PARTS = 8
"""Number of intervals into which a step is divided to sample a function without a bound of its rate."""

DEPTH = 10
"""Largest number of halvings of these intervals."""

LOWEST = 10.0
"""Negative values are cut off at this multiple of the largest positive one: beyond a jump, for example to
−inf, they would show no curvature of the function before it."""

SHORTEST = 1.5 * 0.5**DEPTH
"""Shortest interval, relative to the initial ones, that is halved."""

BULGE = SAFETY / 8.0
"""Largest fall below the chord between samples, relative to their second difference: that of a parabola with
`SAFETY` times the curvature."""

FADING = 1.0 / 16.0
"""Least ratio of the fall in a half to that in the whole interval: a quarter of the curvature is assumed."""

MOST = 200
"""Largest number of halvings in a search. The functions of regular motions need less than a hundred; noise
would halve all intervals `DEPTH` times."""


def sampled(value):
    """Return the kernel value_at(work, i, t), the function and its rate at a time within the step."""

    @inlined
    def value_at(work, i, t):
        fraction = (t - work.step_start) / work.step_length
        set_state_within(work, fraction)
        set_directions_within(work, fraction)
        return value(work, i, t)

    return value_at


def search_for_touch(value_at):
    """Return the kernel that locates the zero of a falling gap."""

    @inlined
    def touch(work, i, base, low, high, found, slope):
        """Return the time in (low, high) at which gap − base is zero; at `high` it is negative.

        Newton's method with bracketing starts at `high`, where the value is `found` and its rate `slope`.
        """
        t = high
        for _ in range(60):
            guess = t - found / slope
            if not low < guess < high:
                guess = low + 0.5 * (high - low)
            if guess in (low, high) or abs(guess - t) <= EPS * abs(t):
                break
            t = guess
            found, slope = value_at(work, i, t)
            found -= base
            if abs(found) <= LITTLE * work.gap_floor:
                break
            if found > 0.0:
                low = t
            else:
                high = t
        return t

    return touch


def search_for_closing(value):
    """Return the kernel that locates the closing of a gap, given its value and rate."""
    value_at = sampled(value)
    root = search_for_touch(value_at)

    @inlined
    def first_closing(work, i, end, gap, rate, end_gap, end_rate, bounds):
        """Return the first time until `end` at which a gap closes; infinity if it does not. (10.4)

        Between two times the gap stays above the parabolas (10.4) from both. If these allow it to close, the
        interval is halved, so that even the shortest dip below zero is found.

        Args:
            work: The workspace.
            i: Index of the gap.
            end: End of the search [s].
            gap, rate: Gap and gap rate at the start of the step. If the gap is negative there, for example by
                the correction of other gaps, all gaps of the step are taken relative to it.
            end_gap, end_rate: Gap and gap rate at the end of the step.
            bounds: (4,) see `gap_bounds.curvatures`.
        """
        start, h = work.step_start, work.step_length
        floor = work.gap_floor
        base = min(gap, 0.0)
        gap, end_gap = gap - base, end_gap - base
        fall, _ = curvatures(gap, rate, end_gap, end_rate, h, bounds)
        if clear(gap, rate, end_gap, end_rate, fall, h, floor):
            return math.inf
        if end < start + h:
            end_gap, end_rate = value_at(work, i, end)
            end_gap -= base
        depth, time = 0, start
        later, later_gap, later_rate = np.empty(80), np.empty(80), np.empty(80)
        later[0], later_gap[0], later_rate[0] = end, end_gap, end_rate
        while depth >= 0:
            width = later[depth] - time
            fall, bend = curvatures(gap, rate, later_gap[depth], later_rate[depth], width, bounds)
            if clear(gap, rate, later_gap[depth], later_rate[depth], fall, width, floor):
                time, gap, rate = later[depth], max(later_gap[depth], 0.0), later_rate[depth]
                depth -= 1
                continue
            falling = max(rate, later_rate[depth]) + 0.5 * bend * width < 0.0
            if falling and gap > 0.0 and later_gap[depth] < 0.0:
                return root(work, i, base, time, later[depth], later_gap[depth], later_rate[depth])
            middle = time + 0.5 * width
            shortest = 2.0 * EPS * abs(later[depth])
            if not time < middle < later[depth] or width <= shortest or depth + 1 == len(later):
                if later_gap[depth] < -floor:
                    return later[depth]
                time, gap, rate = later[depth], max(later_gap[depth], 0.0), later_rate[depth]
                depth -= 1
                continue
            depth += 1
            later[depth] = middle
            later_gap[depth], later_rate[depth] = value_at(work, i, middle)
            later_gap[depth] -= base
        return math.inf

    return first_closing


def search_for_fall(value):
    """Return the kernel that locates the first fall of a function below zero."""
    value_at, root = sampled(value), search_for_root(value)

    @inlined
    def first_fall(work, i, end, floor):
        """Return the first time until `end` at which a function falls below −floor; infinity if it does not.

        Where the curvature that the samples show allows a fall between two of them the interval is halved, up
        to `DEPTH` times. A function that starts from zero and falls does so at the start.
        """
        start = work.step_start
        width = (end - start) / PARTS
        if not width > 0.0:
            return math.inf
        values = np.empty(PARTS + 1)
        for k in range(PARTS + 1):
            values[k] = value_at(work, i, end if k == PARTS else start + k * width)[0]
        largest = second = 0.0
        halvings = 0
        for k in range(PARTS + 1):
            largest = max(largest, values[k])
        lowest = -max(LOWEST * largest, 2.0 * floor)
        for k in range(PARTS + 1):
            values[k] = max(values[k], lowest)
        for k in range(1, PARTS):
            second = max(second, abs(values[k - 1] - 2.0 * values[k] + values[k + 1]))
        later, later_value, bulges = np.empty(DEPTH + 1), np.empty(DEPTH + 1), np.empty(DEPTH + 1)
        for k in range(PARTS):
            time, value_now = start + k * width, max(values[k], 0.0)
            later[0] = end if k == PARTS - 1 else time + width
            later_value[0], bulges[0] = values[k + 1], BULGE * second
            depth = 0
            while depth >= 0:
                value_then, bulge = later_value[depth], bulges[depth]
                part = later[depth] - time
                middle = time + 0.5 * part
                splits = part > SHORTEST * width and time < middle < later[depth]  # so depth < DEPTH
                splits = splits and halvings < MOST
                if value_then < -floor:
                    if value_now > 0.0:
                        return root(work, i, time, later[depth], value_now, value_then)
                    if not splits:
                        return time
                rises_clear = value_now == 0.0 and value_then > 4.0 * bulge
                if splits and not (min(value_now, value_then) - bulge >= -floor or rises_clear):
                    depth, halvings = depth + 1, halvings + 1
                    later[depth] = middle
                    later_value[depth] = max(value_at(work, i, middle)[0], lowest)
                    # the curvature here may be smaller than elsewhere in the step
                    bend = abs(value_now - 2.0 * later_value[depth] + value_then)
                    bulges[depth] = bulges[depth - 1] = max(BULGE * bend, FADING * bulge)
                    continue
                time, value_now = later[depth], max(value_then, 0.0)
                depth -= 1
        return math.inf

    return first_fall


def search_for_root(value):
    """Return the kernel that locates a change of sign of a function."""
    value_at = sampled(value)

    @inlined
    def root(work, i, a, b, fa, fb):
        """Return the time, to rounding and not before, at which a function changes sign between a and b.

        Ridders' method is used; fa and fb are the values at a and b.
        """
        for _ in range(100):
            middle = a + 0.5 * (b - a)
            if not a < middle < b or fb == 0.0:
                break
            fm = value_at(work, i, middle)[0]
            if fm == 0.0:
                return middle
            scale = math.sqrt(fm * fm - fa * fb)
            guess = middle + (middle - a) * math.copysign(fm, fa * fm) / scale if scale > 0.0 else middle
            if fa * fm < 0.0:
                b, fb = middle, fm
            else:
                a, fa = middle, fm
            if a < guess < b:
                fg = value_at(work, i, guess)[0]
                if fg == 0.0:
                    return guess
                if fa * fg < 0.0:
                    b, fb = guess, fg
                else:
                    a, fa = guess, fg
        return b

    return root
