"""The end of a step of an impact at several contacts: state, work and records. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import always_inlined, external, inlined
from ..._numeric.loops import filled, power
from ..._numeric.products import add
from .codes import (
    COMPRESSION,
    FREE,
    HELD,
    IN_SLIP,
    IN_STICK,
    LOADING,
    NONE_YET,
    OPEN,
    RESTITUTION,
    RISING,
    SLIPPING,
)
from .first_fall import value_at
from .propagation_series import POINTS, Series
from .propagation_sharing import spread
from .propagation_state import UNEVEN, State, System, open_contact, rate, stored
from .tolerances import SLIP_SPEED, SLOW


@inlined
def time_power(k, h, pace, root):
    """Return the factor of the force coefficient k in the impulse of a step: ∫ of its power of s or τ over s.

    k = 0 gives the clock at the end of the step.
    """
    if root:
        return 2.0 * pace * pace * power(h, k + 2) / (k + 2.0)
    return pace * power(h, k + 1) / (k + 1.0)


@always_inlined
def _product(series, i, k):
    """Return the coefficient k of the power of force component i (3n,)."""
    total = 0.0
    for m in range(k + 1):
        total += series.force[m, i] * series.v[k - m, i]
    return total


@declared(
    *(System, State, Series, float, int, float, bool, FLOATS, FLOAT_ROWS, FLOAT_ROWS, int, INTEGERS),
    result=int,
)
@external
def advance(system, state, series, h, degree, pace, root, parts, works, rows, used, latest):
    """Advance state, work and rows to the end of a step; return the number of rows.

    Args:
        system: The `System`.
        state: The `State`; is overwritten with that at the end of the step.
        series: The `Series` of the step.
        h, degree: Step size, in the variable of the series, and degree to which the series is evaluated.
        pace: Time scale of the series.
        root: Whether the series is in τ = √s.
        parts: (ORDER + 1,) scratch.
        works, rows: As for `propagate`; the step is added.
        used: Number of rows so far.
        latest: (n,) index of the last row of each contact, or `NO_ROW`.
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    parts, works, rows, latest = borrowed(parts), borrowed(works), borrowed(rows), borrowed(latest)
    n = len(system.friction)
    uneven = False
    for k in range(degree + 1):
        parts[k] = time_power(k, h, pace, root)
    for j in range(n):
        uneven |= state.shared[j] == UNEVEN
    filled(series.beyond.ravel(), 0.0)
    if uneven:
        spread(system, state, series, degree, h, pace, root)
    for j in range(n):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        before, moves = state.impulse[z], series.changes[x] + series.changes[y] + series.changes[z] > 0
        if state.normal[j] != OPEN and moves:
            normal_work = friction_work = 0.0
            for k in range(degree + 1):
                part = parts[k]
                if state.normal[j] == HELD:
                    normal_work += _product(series, z, k) * part
                if state.tangent[j] != FREE:
                    friction_work += (_product(series, x, k) + _product(series, y, k)) * part
                add(state.impulse[x : z + 1], part, series.force[k, x:])
            add(state.impulse[x:z], 1.0, series.beyond[POINTS - 1, x:])
            if state.normal[j] != HELD:  # the decrease of the spring's energy
                normal_work = stored(system, j, state.indentation[j])
                normal_work -= stored(system, j, value_at(series.indentation, j, degree, h))
                normal_work /= rate(system, state.normal[j], j)
            restores = state.normal[j] == RISING or state.normal[j] == HELD
            works[j, 1 if restores else 0] += normal_work
            works[j, 2] += friction_work
            if state.impulse[z] > before:
                slips = state.tangent[j] == SLIPPING or state.tangent[j] == FREE
                mode, phase = IN_SLIP if slips else IN_STICK, RESTITUTION if restores else COMPRESSION
                last = latest[j]
                if last >= 0 and rows[last, 1] == mode and rows[last, 2] == phase and rows[last, 4] == before:
                    rows[last, 4] = state.impulse[z]
                elif used < rows.shape[0]:
                    rows[used, 0], rows[used, 1], rows[used, 2] = j, mode, phase
                    rows[used, 3], rows[used, 4] = before, state.impulse[z]
                    latest[j] = used
                    used += 1
        for i in range(x, z + 1):
            if series.changes[i] == 1:
                state.v[i] = value_at(series.v, i, degree, h)
        speed = math.hypot(state.v[x], state.v[y])
        if speed > 10.0 * SLIP_SPEED:
            state.fresh[j] = 0
        if speed > SLOW and state.tangent[j] != FREE:
            state.tangent[j] = SLIPPING
        if state.normal[j] == HELD and abs(state.v[z]) > SLOW:
            if state.v[z] < 0.0:
                state.normal[j] = LOADING
            else:
                open_contact(state, j)
        if state.normal[j] == HELD:
            state.last[j] = value_at(series.force, z, degree, h)
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            state.ringing[j] = min(state.ringing[j], max(cap - state.last[j], 0.0) / system.exponent)
        state.indentation[j] = value_at(series.indentation, j, degree if moves else min(degree, STRAIGHT), h)
        if state.normal[j] == LOADING:
            state.deepest[j] = state.indentation[j]
    return used


@inlined
def record(path, points, clock, state):
    """Append a point to the path, if it is not full; return the number of points."""
    if points < path.shape[0]:
        path[points, 0] = clock
        for i in range(len(state.v)):
            path[points, 1 + i] = state.v[i]
            path[points, 1 + len(state.v) + i] = state.impulse[i]
        return points + 1
    return points


@inlined
def record_step(path, points, clock, series, state, h, degree, pace, root):
    """Append `POINTS` points of a step to the path, the last at its end; return the number of points."""
    m = len(state.v)
    for part in range(1, POINTS):
        if points < path.shape[0]:
            s = h * part / POINTS
            path[points, 0] = clock + time_power(NONE_YET, s, pace, root)
            for i in range(m):
                path[points, 1 + i] = value_at(series.v, i, degree, s)
                rest = 0.0
                for k in range(degree + 1):
                    rest += series.force[k, i] * (time_power(k, h, pace, root) - time_power(k, s, pace, root))
                rest += series.beyond[POINTS - 1, i] - series.beyond[part - 1, i]
                path[points, 1 + m + i] = state.impulse[i] - rest
            points += 1
    return record(path, points, clock + time_power(NONE_YET, h, pace, root), state)


STRAIGHT = np.int64(1)
"""Degree of the series of a contact whose velocity is constant."""

NO_ROW = np.int64(-1)
"""Entry of `latest` for a contact without a row."""
