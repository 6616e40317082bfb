"""Where a function of time first falls below zero within a step, found between samples too.

A function is given by its kind and a number: `GAP` of a contact and `LIMIT` of a joint have a rate, `ALONG`
(slip along its remembered direction), `RATE` (of a joint, against its dry friction) and `FORCE` (by how much
the forces keep to Coulomb's law) have none.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner
from . import stages
from . import workspace as at
from .dynamics import MARGIN, evaluate, kinematics, limit_gap, look
from .gap_bounds import clear, curvatures
from .workspace import d1, d2, i2

GAP, LIMIT, ALONG, RATE, FORCE = np.arange(5)  # as variables, for literals would be compiled one by one


@inner
def sample(kind, i, t, start, h, mem):
    """Return the function and its rate at a time within the step last completed."""
    state = d1(mem, at.STATE)
    joints, q0, v0, coefficients = (
        i2(mem, at.JOINTS),
        d1(mem, at.Q0),
        d1(mem, at.V0),
        d2(mem, at.COEFFICIENTS),
    )
    q, v = d1(mem, at.Q), d1(mem, at.V)
    stages.state(coefficients, (t - start) / h, joints, q0, v0, q, v)
    if kind == GAP:
        kinematics(mem)
        return look(mem, i)
    if kind == LIMIT:
        return limit_gap(mem, i, q, v)
    if kind == RATE:
        return v[i], 0.0
    evaluate(t, mem, np.empty(len(v) + 4))
    if kind == ALONG:
        reference, velocity = d2(mem, at.REFERENCE), d2(mem, at.VELOCITY)
        return reference[i, 0] * velocity[i, 0] + reference[i, 1] * velocity[i, 1], 0.0
    return max(state[MARGIN], -1e300), 0.0


@inner
def first_crossing(kind, i, a, b, gap, rate, end_gap, end_rate, bounds, floor, h, mem):
    """Return the first time in (a, b] at which a gap closes, or NaN.

    Between two times the gap stays above both parabolas that its values, its rates and the curvature allow
    there: at most its bound, and within its variation of the mean that the two rates give. Where those leave
    room for a dip the interval is halved, so a dip within one step is found however short.

    Args:
        kind, i: Which gap.
        a: Start of the step [s].
        b: The time up to which to look.
        gap, rate: The gap and its rate at a; a gap below zero is where all gaps of the step are counted from,
            for a correction of others may have left it there.
        end_gap, end_rate: The same at b.
        bounds: (4,) see `gap_bounds.curvatures`.
        floor: A gap above −floor counts as none (rounding).
        h: Length of the step.
        mem: The table of `memory`.
    """
    depth = 0
    later, later_gap, later_rate = np.empty(80), np.empty(80), np.empty(80)
    base = min(gap, 0.0)
    later[0], later_gap[0], later_rate[0] = b, end_gap - base, end_rate
    time, gap = a, gap - base
    while depth >= 0:
        width = later[depth] - time
        fall, bend = curvatures(gap, rate, later_gap[depth], later_rate[depth], width, bounds)
        if clear(gap, rate, later_gap[depth], later_rate[depth], fall, width, floor):
            time, gap, rate = later[depth], max(later_gap[depth], 0.0), later_rate[depth]
            depth -= 1
            continue
        falling = max(rate, later_rate[depth]) + 0.5 * bend * width < 0.0
        if falling and gap > 0.0 and later_gap[depth] < 0.0:
            low, t, value, slope = time, later[depth], later_gap[depth], later_rate[depth]
            high = t
            for _ in range(60):  # Newton's method from the end, kept within the bracket
                guess = t - value / slope
                if not low < guess < high:
                    guess = low + 0.5 * (high - low)
                if guess in (low, high) or abs(guess - t) <= 2e-16 * abs(t):
                    break
                t = guess
                value, slope = sample(kind, i, t, a, h, mem)
                value -= base
                if abs(value) <= 1e-3 * floor:
                    break
                if value > 0.0:
                    low = t
                else:
                    high = t
            return t
        middle = time + 0.5 * width
        if not time < middle < later[depth] or width <= 4e-16 * abs(later[depth]) or depth + 1 == len(later):
            if later_gap[depth] < -floor:
                return later[depth]
            time, gap, rate = later[depth], max(later_gap[depth], 0.0), later_rate[depth]
            depth -= 1
            continue
        depth += 1
        later[depth] = middle
        later_gap[depth], later_rate[depth] = sample(kind, i, middle, a, h, mem)
        later_gap[depth] -= base
    return math.nan


@inner
def root(kind, i, a, b, fa, fb, start, h, mem):
    """Return where a function changes sign between a and b, to rounding and not before (Ridders' method)."""
    for _ in range(100):
        middle = a + 0.5 * (b - a)
        if not a < middle < b or fb == 0.0:
            break
        fm = sample(kind, i, middle, start, h, mem)[0]
        if fm == 0.0:
            return middle
        scale = math.sqrt(fm * fm - fa * fb)
        guess = middle + (middle - a) * math.copysign(fm, fa * fm) / scale if scale > 0.0 else middle
        if fa * fm < 0.0:
            b, fb = middle, fm
        else:
            a, fa = middle, fm
        if a < guess < b:
            fg = sample(kind, i, guess, start, h, mem)[0]
            if fg == 0.0:
                return guess
            if fa * fg < 0.0:
                b, fb = guess, fg
            else:
                a, fa = guess, fg
    return b
