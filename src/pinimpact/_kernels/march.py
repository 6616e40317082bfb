"""The smooth motion of a scene from its present state to the end of one step, or to the first event in it."""

from __future__ import annotations

import math

import numpy as np

from . import collocation, step, touch
from .crossings import ALONG, FORCE, GAP, LIMIT, RATE, curvatures, first_crossing, root, sample
from .guards import clear
from .jit import inner, jit
from .motion import ERROR, FAILED, LEAST_MARGIN, LENGTH, MARGIN, STIFFNESS, STILL, gaps, look_closely
from .sustained import FREE, SLIP

COVERED, EVENT, VANISHED, BROKEN = range(4)
"""How a step ends: it is covered; an event cuts it; it fell below what time resolves; a call raised."""

MODE_CHANGE = np.int64(-1)
"""Number of an event that is no contact's or limit's."""

SAFETY = 1.5
"""Factor on the bounds of a gap's second derivative, which come from the stages of the step."""

LOOKS = 10
"""Parts of a step at which forces are looked at where its stages saw them leave their bounds."""


@jit
def outlook(mode, seen, near, tree, points, closed, state):
    """Prepare for a stretch that begins at the state last evaluated: take the stiffness of its slip.

    Returns:
        A guess how long a bounce just begun lasts [s]; infinite where there is none.
    """
    state[STIFFNESS] = collocation.stiffness(tree, closed, state)
    state[LENGTH] = 0.0
    guess = math.inf
    n = points[2].shape[1]
    rows, three = np.empty((3, n)), np.empty((3, 3))
    for i in range(len(mode)):
        if mode[i] == FREE and abs(seen[i, 0]) <= near and seen[i, 1] > 0.0:
            look_closely(tree, points, i, rows, three[0], three[1], three[2])
            if three[1, 2] < 0.0:
                guess = min(guess, -2.0 * seen[i, 1] / three[1, 2])
    return guess


@jit
def advance(t, h, left, rtol, atol, floor, mode, shut, tolerated, seen, later, machine):
    """Take one accepted step, and look for the first event in it.

    Args:
        t: The time [s]; the state stands in `run`.
        h: Length to try [s].
        left: Time left [s].
        rtol, atol: Tolerances.
        floor: Gaps above −floor count as none.
        mode: (n,) modes of all contacts.
        shut: (m,) whether each joint limit is closed.
        tolerated: Whether forces beyond their bounds are no event, for no other mode is held either.
        seen: (n, 2) gaps and rates at t.
        later: (n, 2) takes them at the end of the step.
        machine: See `crossings`; the step and its dense output are left in `run`.

    Returns:
        How it ended, the length of the step, the time of the event and its
        number (contacts, then limits), the margin and the drift of the closed contacts at the end of the
        step, the attempts rejected, and the length to try next.
    """
    run, tree, points, closed, state, _ = machine
    rejected = 0
    natural = h
    while True:
        trial = left if h > 0.9 * left else h
        if t + trial <= t:
            return VANISHED, trial, t, MODE_CHANGE, 0.0, 0.0, rejected, natural
        state[LEAST_MARGIN] = math.inf
        implicit = trial * state[STIFFNESS] > collocation.STIFF
        if implicit:
            error = collocation.attempt(t, trial, rtol, atol, run, tree, points, closed, state)
        else:
            error = step.attempt(t, trial, rtol, atol, run, tree, points, closed, state)
        if state[FAILED] != 0.0:
            return BROKEN, trial, t, MODE_CHANGE, 0.0, 0.0, rejected, natural
        if error > 1.0:
            rejected += 1
            h = trial * (0.2 if error == math.inf else max(0.2, 0.9 * error**-0.125))
            natural = h
            continue
        margin = state[MARGIN]
        drift = drifted(run, closed)
        velocity = closed[9].copy()
        stiffness = collocation.stiffness(tree, closed, state)
        if len(mode):
            gaps(tree, points, state, later)
        if implicit:
            collocation.complete(trial, run)
        else:
            step.complete(t, trial, run, tree, points, closed, state)
        time, number = first_event(t, trial, floor, mode, shut, tolerated, seen, later, velocity, machine)
        if state[FAILED] != 0.0:
            return BROKEN, trial, t, MODE_CHANGE, 0.0, 0.0, rejected, natural
        if time > t + trial:
            step.go_on(run)
            state[STIFFNESS] = stiffness
            natural = trial * growth(trial, error, state)
            return COVERED, trial, time, number, margin, drift, rejected, natural
        if time >= t:
            return EVENT, trial, time, number, margin, drift, rejected, natural
        h = 0.5 * trial  # the slip turns too fast for a step of this length
        rejected += 1


@inner
def growth(h, error, state):
    """Return how much longer the next step may be, and keep this one in mind for the step after it.

    The trend of the last two steps counts where it asks for less: steps towards the end of a slip shrink one
    after the other. (K. Gustafsson, ACM Transactions on Mathematical Software 20, 1994)
    """
    error = max(error, 1e-7)
    factor = min(5.0, 0.9 * error**-0.125)
    if state[LENGTH] > 0.0:
        factor = min(factor, 0.9 * h / state[LENGTH] * (max(state[ERROR], 1e-2) / error**2) ** 0.125)
    state[LENGTH], state[ERROR] = h, error
    return max(factor, 0.2)


@inner
def drifted(run, closed):
    """Return how far the closed contacts are from where they rest [m], or from rest [m/s]."""
    modes, scalars, rest, velocity, gap = closed[1], closed[4], closed[7], closed[9], closed[12]
    worst = 0.0
    for k in range(len(modes)):
        worst = max(worst, abs(gap[k] - rest[k]), abs(velocity[k, 2]))
        if modes[k] != SLIP:
            worst = max(worst, abs(velocity[k, 0]), abs(velocity[k, 1]))
    for j in scalars:
        worst = max(worst, abs(run[4][j]))
    return worst


@inner
def first_event(t, h, floor, mode, shut, tolerated, seen, later, velocity, machine):
    """Return time and number of the first event in the step last completed.

    The time is infinite where there is none, and minus infinity to ask for a shorter step.
    """
    run, tree, points, closed, _, limits = machine
    q0, v0, q1, v1, peak = run[1], run[2], run[3], run[4], run[8]
    end = t + h
    found, number = math.inf, int(MODE_CHANGE)
    bounds = np.empty((len(mode), 2))
    for i in range(len(mode)):  # before a sample moves the kinematics
        if mode[i] == FREE:
            tip = points[1][i, 0]
            bounds[i, 0], bounds[i, 1] = touch.curvature(
                tree[12], points[2][i], points[3], tree[8][tip], points[0][i], peak, h
            )
    for i in range(len(mode)):
        if mode[i] != FREE:
            continue
        size, change = SAFETY * bounds[i, 0], SAFETY * bounds[i, 1]
        gap, rate = later[i, 0], later[i, 1]
        fall, _ = curvatures(seen[i, 1], rate, h, size, change)
        if not clear(max(seen[i, 0], 0.0), seen[i, 1], gap, rate, fall, h, floor):
            if found < math.inf:
                gap, rate = sample(GAP, i, end, t, h, machine)
            time = first_crossing(
                GAP, i, t, end, seen[i, 0], seen[i, 1], gap, rate, size, change, floor, h, machine
            )
            if time <= end:
                found, end, number = time, time, i
    index_q, index_v, sign, bound = limits
    for k in range(len(sign)):
        a, b, s = index_q[k], index_v[k], sign[k]
        gap, rate = s * (q0[a] - bound[k]), s * v0[b]
        size, change = SAFETY * peak[1, b], SAFETY * peak[3, b]
        if shut[k] or clear(max(gap, 0.0), rate, s * (q1[a] - bound[k]), s * v1[b], size, h, floor):
            continue
        end_gap, end_rate = sample(LIMIT, k, end, t, h, machine)
        time = first_crossing(LIMIT, k, t, end, gap, rate, end_gap, end_rate, size, change, floor, h, machine)
        if time <= end:
            found, end, number = time, time, len(mode) + k
    sliding = tree[14]
    for j in range(len(v0)):
        if sliding[j] * v1[j] < -1e-12 * abs(sliding[j]) and sliding[j] * v0[j] > 0.0:
            time = root(RATE, j, t, t + h, v0[j], v1[j], t, h, machine)
            if time < end:
                found, end, number = time, time, MODE_CHANGE
    if len(closed[0]) + len(closed[4]) == 0:
        return found, number
    time = first_change_of_mode(t, h, end, tolerated, velocity, machine)
    if time <= end:
        return time, MODE_CHANGE
    return found, number


@inner
def first_change_of_mode(t, h, end, tolerated, velocity, machine):
    """Return when a slip ends, or a force leaves what its mode allows, until `end`; else infinity."""
    state, closed = machine[4], machine[3]
    modes, mu, reference, slip = closed[1], closed[2], closed[3], closed[9]
    still = state[STILL]
    least = state[LEAST_MARGIN]
    found = math.inf
    for k in range(len(modes)):
        if modes[k] != SLIP or mu[k] == 0.0:
            continue
        ahead = reference[k, 0] * velocity[k, 0] + reference[k, 1] * velocity[k, 1]
        if ahead >= -1e-3 * still:
            continue
        first = sample(ALONG, k, t, t, h, machine)[0]
        if first <= 0.0:
            continue
        time = root(ALONG, k, t, t + h, first, ahead, t, h, machine)
        if time < end:
            sample(ALONG, k, time, t, h, machine)
            if math.hypot(slip[k, 0], slip[k, 1]) > still:
                return -math.inf
            found, end = time, time
    if least < 0.0 and not tolerated:
        before = t
        m_before = sample(FORCE, MODE_CHANGE, t, t, h, machine)[0]
        start = t
        for part in range(1, LOOKS + 1):
            time = end if part == LOOKS else start + (end - start) * part / LOOKS
            m = sample(FORCE, MODE_CHANGE, time, t, h, machine)[0]
            if m < 0.0:
                return (
                    root(FORCE, MODE_CHANGE, before, time, m_before, m, t, h, machine)
                    if m_before > 0.0
                    else time
                )
            before, m_before = time, m
    return found
