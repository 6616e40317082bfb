"""The smooth motion of a scene from its present state to the end of one step, or to the first event in it."""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner, jit
from ...robot._kernels import contact_motion
from . import step_dop853
from . import workspace as at
from .contact_forces import FREE, SLIP
from .dynamics import (
    ERROR,
    LEAST_MARGIN,
    LENGTH,
    MARGIN,
    SLOWEST,
    STIFFNESS,
    STILL,
    all_gaps,
    evaluate,
    follow_surface,
    gaps,
    limit_gap,
    look_closely,
    measure,
    release,
    take,
)
from .event_location import ALONG, FORCE, GAP, LIMIT, RATE, first_crossing, root, sample
from .gap_bounds import clear, curvatures
from .workspace import d1, d2, d3, f2, i1, i2, put

MODE_CHANGE = np.int64(-1)
"""Number of an event that is no contact's or limit's."""

SAFETY = 1.5
"""Factor on the bounds of a tip's motion, which come from the stages of the step."""

LOOKS = 10
"""Parts of a step at which forces are looked at where its stages saw them leave their bounds."""


@jit
def begin(t, q, v, near, seen, mem):
    """Begin a stretch: evaluate at its start, look at the gaps, and take the stiffness of slip.

    Args:
        t: Time [s].
        q: (nq,) configuration.
        v: (nv,) velocity.
        near: Gap [m] at which a contact counts as touching.
        seen: (n, 2) takes the gaps and rates of all contacts.
        mem: The table of `memory`.

    Returns:
        A guess how long a bounce just begun lasts [s]; infinite where there is none.
    """
    state = d1(mem, at.STATE)
    rates = d2(mem, at.RATES)
    n = len(v)
    put(d1(mem, at.Q0), q)
    put(d1(mem, at.V0), v)
    take(q, v, mem)
    for i in range(len(rates)):
        for m in range(2 * n, rates.shape[1]):
            rates[i, m] = 0.0
    for m in range(n):
        rates[0, m] = v[m]
    evaluate(t, mem, rates[0, n:])
    turn_references(d2(mem, at.VELOCITY), mem)
    state[STIFFNESS] = fastest_turn(mem)
    state[LENGTH] = 0.0
    guess = math.inf
    if len(seen) == 0:
        return guess
    mode = i1(mem, at.STANDING)
    gaps(mem, seen)
    rows, three = np.empty((3, n)), np.empty((3, 3))
    free = d1(mem, at.ACCELERATION)
    for i in range(len(seen)):
        if mode[i] == FREE and abs(seen[i, 0]) <= near and seen[i, 1] > state[STILL]:
            look_closely(mem, i, rows, three[0], three[1], three[2])
            fall = -three[1, 2]
            for j in range(n):  # what is closed pushes
                fall -= rows[2, j] * (rates[0, n + j] - free[j])
            if fall > 0.0:
                guess = min(guess, 2.0 * seen[i, 1] / fall)
    return guess


@jit
def look(q, v, seen, mem):
    """Fill (n + nl, 2) gaps and rates of all contacts, then of the joint limits, at a state."""
    all_gaps(q, v, seen, mem)


@jit
def probe(t, q, v, which, joints, rows, velocity, acceleration, surface, gap, mem):
    """Fill v̇ and the motion of some contacts without contact forces, see `motion.look_closely`."""
    take(q, v, mem)
    release(t, mem, np.empty(2))
    put(joints, d1(mem, at.ACCELERATION))
    for i in which:
        follow_surface(mem, i)
    measure(mem, which, rows, velocity, acceleration, surface, gap)


@inner
def turn_references(velocity, mem):
    """Let the remembered directions of slip follow the contact velocities (nc, 3); a reversal is an event."""
    modes, reference, state = i1(mem, at.MODES), d2(mem, at.REFERENCE), d1(mem, at.STATE)
    for k in range(len(modes)):
        if modes[k] == SLIP:
            x, y = velocity[k, 0], velocity[k, 1]
            speed = math.hypot(x, y)
            if speed > state[SLOWEST] and x * reference[k, 0] + y * reference[k, 1] > 0.0:
                reference[k, 0], reference[k, 1] = x / speed, y / speed


@jit
def finish(t, h, error, explicit, floor, tolerated, seen, later, mem):
    """Finish a step whose error is small enough: look for the first event in it.

    Args:
        t: Its start [s].
        h: Its length [s].
        error: Its error over the tolerance.
        explicit: Whether it was an explicit one.
        floor: Gaps above −floor count as none.
        tolerated: Whether forces beyond their bounds are no event, for no other mode is held either.
        seen: (n, 2) gaps and rates at t.
        later: (n, 2) takes them at the end of the step.
        mem: The table of `memory`; the step's dense output is left in it, and its end as the next one's start
            if no event cuts it.

    Returns:
        The time of the first event, infinite if there is none and minus infinity to ask for a shorter step;
        its number (contacts, then limits); the margin and the drift of the closed contacts at the end of the
        step; how much longer the next one may be.
    """
    state = d1(mem, at.STATE)
    margin = state[MARGIN]
    drift = drifted(mem)
    velocity = d2(mem, at.VELOCITY).copy()
    stiffness = fastest_turn(mem)
    for i in i1(mem, at.WHICH):
        follow_surface(mem, i)
    if len(later):
        gaps(mem, later)
    if explicit:
        step_dop853.complete(t, h, mem)
    time, number = first_event(t, h, floor, tolerated, seen, later, velocity, mem)
    if time > t + h:
        step_dop853.go_on(mem)
        state[STIFFNESS] = stiffness
        turn_references(velocity, mem)
        return time, number, margin, drift, growth(h, error, state)
    return time, number, margin, drift, 1.0


@inner
def fastest_turn(mem):
    """Return how fast the direction of slip settles at the most, about [1/s]; see `collocation`."""
    modes, mu, velocity = i1(mem, at.MODES), d1(mem, at.MU), d2(mem, at.VELOCITY)
    jacobians, minverse, force = d3(mem, at.ROWS), d2(mem, at.MINVERSE), d2(mem, at.FORCE)
    reference = d2(mem, at.REFERENCE)
    n = minverse.shape[0]
    fastest = 0.0
    for k in range(len(modes)):
        if modes[k] == SLIP and mu[k] > 0.0:
            speed = math.hypot(velocity[k, 0], velocity[k, 1])
            s1, s2 = reference[k, 0], reference[k, 1]
            if speed > 0.0:
                s1, s2 = velocity[k, 0] / speed, velocity[k, 1] / speed
            total = 0.0
            for i in range(n):
                a = s1 * jacobians[k, 1, i] - s2 * jacobians[k, 0, i]
                for j in range(n):
                    total += a * minverse[i, j] * (s1 * jacobians[k, 1, j] - s2 * jacobians[k, 0, j])
            fastest = max(fastest, mu[k] * abs(force[k, 2]) * total / max(speed, 1e-300))
    return fastest


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
def drifted(mem):
    """Return how far the closed contacts are from where they rest [m], or from rest [m/s]."""
    modes, scalars, rest, velocity, gap = (
        i1(mem, at.MODES),
        i1(mem, at.SCALARS),
        d1(mem, at.REST),
        d2(mem, at.VELOCITY),
        d1(mem, at.GAP),
    )
    worst = 0.0
    for k in range(len(modes)):
        worst = max(worst, abs(gap[k] - rest[k]), abs(velocity[k, 2]))
        if modes[k] != SLIP:
            worst = max(worst, abs(velocity[k, 0]), abs(velocity[k, 1]))
    for j in scalars:
        worst = max(worst, abs(d1(mem, at.V1)[j]))
    return worst


@inner
def first_event(t, h, floor, tolerated, seen, later, velocity, mem):
    """Return time and number of the first event in the step last completed.

    The time is infinite where there is none, and minus infinity to ask for a shorter step.
    """
    q0, v0, q1, v1, peak = d1(mem, at.Q0), d1(mem, at.V0), d1(mem, at.Q1), d1(mem, at.V1), d2(mem, at.PEAK)
    end = t + h
    found, number = math.inf, int(MODE_CHANGE)
    count = len(seen)
    mode, shut = i1(mem, at.STANDING), i1(mem, at.STANDING)[count:]
    bounds = np.empty((count, 4))
    for i in range(count):  # before a sample moves the kinematics
        if mode[i] == FREE:
            tip = i2(mem, at.ENDS)[i, 0]
            size, change, speed, radius = contact_motion.bounds(
                f2(mem, at.COLUMNS),
                d2(mem, at.WEIGHTS)[i],
                i1(mem, at.GROUP),
                d2(mem, at.PLACEMENT)[tip],
                d2(mem, at.CONSTANTS)[i],
                peak,
                h,
            )
            bounds[i, 0], bounds[i, 1] = SAFETY * size, SAFETY * change
            bounds[i, 2], bounds[i, 3] = SAFETY * speed, radius
    for i in range(count):
        if mode[i] != FREE:
            continue
        gap, rate = later[i, 0], later[i, 1]
        fall, _ = curvatures(seen[i, 0], seen[i, 1], gap, rate, h, bounds[i])
        base = min(seen[i, 0], 0.0)
        if not clear(seen[i, 0] - base, seen[i, 1], gap - base, rate, fall, h, floor):
            if found < math.inf:
                gap, rate = sample(GAP, i, end, t, h, mem)
            time = first_crossing(GAP, i, t, end, seen[i, 0], seen[i, 1], gap, rate, bounds[i], floor, h, mem)
            if time <= end:
                found, end, number = time, time, i
    index = i1(mem, at.INDEX_V)
    for k in range(len(index)):
        gap, rate = limit_gap(mem, k, q0, v0)
        end_gap, end_rate = limit_gap(mem, k, q1, v1)
        bound = np.array([SAFETY * peak[1, index[k]], SAFETY * peak[3, index[k]], 0.0, math.inf])
        base = min(gap, 0.0)
        if shut[k] != 0 or clear(gap - base, rate, end_gap - base, end_rate, bound[0], h, floor):
            continue
        end_gap, end_rate = sample(LIMIT, k, end, t, h, mem)
        time = first_crossing(LIMIT, k, t, end, gap, rate, end_gap, end_rate, bound, floor, h, mem)
        if time <= end:
            found, end, number = time, time, count + k
    sliding = d1(mem, at.SLIDING)
    for j in range(len(v0)):
        if sliding[j] * v1[j] < -1e-12 * abs(sliding[j]) and sliding[j] * v0[j] > 0.0:
            time = root(RATE, j, t, t + h, v0[j], v1[j], t, h, mem)
            if time < end:
                found, end, number = time, time, int(MODE_CHANGE)
    if len(i1(mem, at.WHICH)) + len(i1(mem, at.SCALARS)) == 0:
        return found, number
    time = first_change_of_mode(t, h, end, tolerated, velocity, mem)
    if time <= end:
        return time, MODE_CHANGE
    return found, number


@inner
def first_change_of_mode(t, h, end, tolerated, velocity, mem):
    """Return when a slip ends, or a force leaves what its mode allows, until `end`; else infinity."""
    state = d1(mem, at.STATE)
    modes, mu, reference, slip = (
        i1(mem, at.MODES),
        d1(mem, at.MU),
        d2(mem, at.REFERENCE),
        d2(mem, at.VELOCITY),
    )
    still = state[STILL]
    least = state[LEAST_MARGIN]
    found = math.inf
    for k in range(len(modes)):
        if modes[k] != SLIP or mu[k] == 0.0:
            continue
        ahead = reference[k, 0] * velocity[k, 0] + reference[k, 1] * velocity[k, 1]
        if ahead >= -1e-3 * still:
            continue
        first = sample(ALONG, k, t, t, h, mem)[0]
        if first <= 0.0:  # a step before has left it there, for it was next to nothing
            return t
        time = root(ALONG, k, t, t + h, first, ahead, t, h, mem)
        if time < end:
            sample(ALONG, k, time, t, h, mem)
            if math.hypot(slip[k, 0], slip[k, 1]) > still:
                return -math.inf
            found, end = time, time
    if least < 0.0 and not tolerated:
        before = t
        slack_before = sample(FORCE, MODE_CHANGE, t, t, h, mem)[0]
        start = t
        for part in range(1, LOOKS + 1):
            time = end if part == LOOKS else start + (end - start) * part / LOOKS
            slack = sample(FORCE, MODE_CHANGE, time, t, h, mem)[0]
            if slack < 0.0:
                return (
                    root(FORCE, MODE_CHANGE, before, time, slack_before, slack, t, h, mem)
                    if slack_before > 0.0
                    else time
                )
            before, slack_before = time, slack
    return found
