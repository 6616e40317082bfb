"""Events of an impact at several contacts: their times and the changes of modes. (theory.md, section 14.6)"""

from __future__ import annotations

import math

from numba import types

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import filled, largest
from ..._numeric.tolerances import NOISE, ROUNDOFF
from .codes import HELD, LOADING, OPEN, RISING, SINKING, SLIPPING, STUCK
from .first_fall import NEVER, first_fall, value_at
from .propagation_series import SHORT, Series
from .propagation_sharing import limit_of_holding
from .propagation_state import (
    AT_BOUND,
    NOT_SHARED,
    SHARED,
    TIED,
    UNEVEN,
    State,
    System,
    close,
    open_contact,
    stick,
)
from .tolerances import NEGLIGIBLE, SAME, SLIP_SPEED, SLOW, STOPS

REACH = 20.0
"""Slip that would end only after more than this many step sizes is not tested for a straight end."""


@inlined
def _fall(c, degree, h, zero, crowded, work):
    """Return the first time in [0, h] at which a guard becomes negative, or `NEVER`.

    `crowded` ignores guards that start at zero and are negative at once, to end a cascade of such events.
    """
    time = first_fall(c, degree, h, zero, work)
    return NEVER if crowded and time <= 0.0 and c[0] >= -zero else time


@declared(
    *(System, State, Series, float, int, float, bool, FLOAT_ROWS, FLOATS, FLOAT_ROWS),
    result=types.Tuple((types.float64, types.int64)),
)
@external
def find_events(system, state, series, h, order, tie, crowded, roots, guard, work):
    """Find the times in [0, h] at which the modes of contacts end.

    Args:
        system, state, series: The `System`, the `State` at the start of the step, and the `Series`.
        h: Step size, in the variable of the series.
        order: Degree of the series.
        tie: Difference of times within which events are simultaneous.
        crowded: Whether too many events have followed each other without a step.
        roots: (n, 3) is overwritten with the times at which either of two normal guards and the tangential
            guard cross zero; `NEVER` if not in the step.
        guard, work: (ORDER + 1,), (4, ORDER + 1) scratch.

    Returns:
        The time of the first event, and the degree to which the series is evaluated up to there: `SHORT` for
        slip that ends on a straight line.
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    roots, guard, work = borrowed(roots), borrowed(guard), borrowed(work)
    n = len(system.friction)
    first, degree, uneven = NEVER, order, False
    strongest = 0.0
    for j in range(n):
        for k in range(2):
            strongest = max(strongest, abs(series.force[k, 3 * j + 2]))
    for j in range(n):
        reach = min(h, first + tie)
        mode, x, y, z = state.normal[j], 3 * j, 3 * j + 1, 3 * j + 2
        filled(roots[j], NEVER)
        still = series.changes[x] + series.changes[y] + series.changes[z] == 0 and series.v[0, z] == 0.0
        if still and mode in (OPEN, LOADING):
            continue
        _fill_normal_guard(state, series, order, mode, j, guard)
        zero = ROUNDOFF * strongest if mode == HELD else ROUNDOFF
        roots[j, 0] = _fall(guard, order, reach, zero, crowded, work)
        if mode == HELD and state.ringing[j] > 0.0 and series.force[1, z] > 0.0:
            for k in range(order):
                guard[k] = (k + 1.0) * series.force[k + 1, z]
            guard[order] = 0.0
            top = _fall(guard, order, reach, ROUNDOFF * strongest, crowded, work)
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            highest = value_at(series.force, z, order, top) if top < roots[j, 0] else 0.0
            if highest + state.ringing[j] * system.exponent > cap * (1.0 + NEGLIGIBLE):
                roots[j, 0] = top
        if mode in (RISING, SINKING, HELD):
            for k in range(order + 1):
                if mode == RISING:
                    guard[k] = series.indentation[k, j]
                else:
                    guard[k] = -series.force[k, z] if mode == HELD else -series.indentation[k, j]
            if mode == SINKING:
                guard[0] += state.deepest[j]
            elif mode == HELD:
                guard[0] += system.stiffness[j] * state.deepest[j] ** system.exponent
            roots[j, 1] = _fall(guard, order, reach, zero, crowded, work)
        if state.tangent[j] == STUCK:
            _fill_stick_guard(system, series, order, j, guard)
            roots[j, 2] = _fall(guard, order, reach, NOISE * strongest * strongest, crowded, work)
            if state.shared[j] != NOT_SHARED:
                uneven |= roots[j, 2] < NEVER
                roots[j, 2] = NEVER
        elif state.tangent[j] == SLIPPING:
            roots[j, 2], straight, least = _end_of_slip(state, series, h, order, reach, j, guard, work)
            if straight and roots[j, 2] < first:
                degree = SHORT
            first = min(first, least)
        for k in range(3):
            if roots[j, k] < first:
                first = roots[j, k]
                if k < 2 or state.tangent[j] == STUCK:
                    degree = order
    for j in range(n):
        if state.shared[j] != NOT_SHARED:
            state.shared[j] = UNEVEN if uneven else SHARED
    if uneven:
        limit = limit_of_holding(system, state, series, order, min(h, first), roots, work)
        if limit < NEVER:
            return limit, order
    return first, degree


@inlined
def _fill_normal_guard(state, series, order, mode, j, guard):
    """Fill the series of the guard of contact j's normal mode: its gap, ±v₃, or its least force if held."""
    z = 3 * j + 2
    for k in range(order + 1):
        if mode == OPEN:
            guard[k] = -series.indentation[k, j]
        elif mode == HELD:
            guard[k] = series.force[k, z] - (state.ringing[j] if k == 0 else 0.0)
        elif mode == RISING:
            guard[k] = series.v[k, z]
        else:
            guard[k] = -series.v[k, z]


@inlined
def _fill_stick_guard(system, series, order, j, guard):
    """Fill the series of μ²F² − |f|² of contact j."""
    x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
    square = system.friction[j] * system.friction[j]
    for k in range(order + 1):
        total = 0.0
        for i in range(k + 1):
            total += square * series.force[i, z] * series.force[k - i, z]
            total -= series.force[i, x] * series.force[k - i, x]
            total -= series.force[i, y] * series.force[k - i, y]
        guard[k] = total


@inlined
def _end_of_slip(state, series, h, order, reach, j, guard, work):
    """Find the end of slip of contact j, or the time at which its slip velocity passes close to zero.

    Args:
        reach: End of the search interval.
        state, series, h, order, guard, work: As for `find_events`.

    Returns:
        The time of the end, whether slip is straight up to there, and the time of the close passage. Times
        are `NEVER` if not in this step.
    """
    x, y, speed = 3 * j, 3 * j + 1, series.speed[0, j]
    ux, uy, fresh = series.unit[0, 2 * j], series.unit[0, 2 * j + 1], state.fresh[j]
    for k in range(order + 1):
        guard[k] = series.v[k, x] * ux + series.v[k, y] * uy
    if fresh == TIED:  # v_t is of order s²
        guard[0] = guard[1] = 0.0
    time = _fall(guard, order, reach, 0.0, False, work)
    if time < NEVER:
        across = value_at(series.v, y, order, time) * ux - value_at(series.v, x, order, time) * uy
        if abs(across) <= 10.0 * ROUNDOFF:
            return time, False, NEVER
        # slip reverses there; a series from far away would not resolve that, so the step ends
        return NEVER, False, time if time > 0.0 else NEVER
    if not speed < STOPS or fresh == TIED:
        return NEVER, False, NEVER
    along, across = guard[1], abs(series.v[1, y] * ux - series.v[1, x] * uy)
    near = speed <= REACH * h * -along
    straight = along < 0.0 and near and across * speed <= ROUNDOFF * -along
    if fresh != 0:  # slip has just begun, at SLIP_SPEED
        straight = straight and speed < 0.5 * SLIP_SPEED
    # and the series need not be longer than `SHORT`
    if straight and largest(series.v[SHORT + 1]) * (-speed / along) ** 3 <= ROUNDOFF:
        return -speed / along, True, NEVER
    turns_back = fresh == 0 and speed < 10.0 * ROUNDOFF and across > 0.1 * along
    return (0.0 if turns_back else NEVER), turns_back, NEVER


@inlined
def apply_events(system, state, series, order, roots, first, tie):
    """Change the modes of contacts that have an event at the time `first`, or at most `tie` later."""
    now = first + tie
    before = state.tangent.copy()
    at_bound = False
    for j in range(len(system.friction)):
        at_bound = at_bound or (before[j] == STUCK and roots[j, 2] <= now)
    for j in range(len(system.friction)):
        z = 3 * j + 2
        state.fresh[j] = 0 if state.fresh[j] == AT_BOUND else state.fresh[j]
        normal, held, tangent = roots[j, 0] <= now, roots[j, 1] <= now, roots[j, 2] <= now
        mode = state.normal[j]
        if mode in (LOADING, RISING, SINKING):  # v₃ is zero but for rounding
            normal = normal or abs(state.v[z]) <= ROUNDOFF < abs(series.v[0, z])
        if tangent and before[j] == SLIPPING:
            stick(state, j)
            for other in range(len(system.friction)):  # a body comes to rest at all its contacts at once
                speed = math.hypot(state.v[3 * other], state.v[3 * other + 1])
                if state.tangent[other] == SLIPPING and state.fresh[other] == 0 and speed <= SLOW:
                    stick(state, other)
        elif at_bound and before[j] == STUCK:  # together with contacts within `SAME` of their bounds
            fx, fy = value_at(series.force, z - 2, order, first), value_at(series.force, z - 1, order, first)
            length = math.hypot(fx, fy)
            bound = system.friction[j] * value_at(series.force, z, order, first)
            if state.shared[j] != NOT_SHARED:
                state.fresh[j] = AT_BOUND if tangent else 0
            elif length > 0.0 and (tangent or length >= (1.0 - SAME) * bound):
                state.direction[2 * j], state.direction[2 * j + 1] = -fx / length, -fy / length
                state.fresh[j] = AT_BOUND
        if not (normal or held):
            continue
        if mode == OPEN:
            close(system, state, j)
        elif mode == LOADING or (mode == SINKING and normal):
            state.v[z] = 0.0
            if state.indentation[j] <= ROUNDOFF:
                open_contact(state, j)
            else:
                state.normal[j] = HELD if system.unloading[j] == 0.0 else RISING
                state.last[j] = system.stiffness[j] * state.indentation[j] ** system.exponent
                state.ringing[j] = 0.0
        elif mode == SINKING:
            state.normal[j] = LOADING
            state.indentation[j] = state.deepest[j]
        elif mode == RISING and held:
            open_contact(state, j)
        elif mode == RISING:
            state.v[z] = 0.0
            state.normal[j] = SINKING
        elif held:
            state.normal[j] = LOADING
        elif state.ringing[j] <= NEGLIGIBLE:
            open_contact(state, j)
        elif state.last[j] <= state.ringing[j] + NEGLIGIBLE:
            close(system, state, j)
