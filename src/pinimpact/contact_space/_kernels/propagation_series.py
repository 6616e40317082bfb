"""Power series of an impact at several contacts between two events. (theory.md, section 14.6)

The variable is the clock s, or τ = √s where a Hertz contact begins to load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, INTEGERS, FloatRows, Integers, declared
from ..._compile.jit import always_inlined, external, inlined
from ..._numeric.least_norm import least_norms
from ..._numeric.loops import filled
from ..._numeric.products import dot
from .codes import BOUND, FREE, HELD, OPEN, SLIPPING, STUCK
from .propagation_mechanism import fill_mechanism, new_mechanism, turn_together
from .propagation_state import TIED, State, System, friction_share, loads, rate
from .tolerances import NEGLIGIBLE

ORDER, FEWER, SHORT = np.int64(24), np.int64(14), np.int64(2)
"""Degree of the series; the one that is tried first after an event, since the next one is often close; and
the one that is used where slip ends on a straight line."""

START = np.int64(0)
"""Order of the first coefficient of a series."""

POINTS = 4
"""Number of points per step in a recorded path."""


class Series(NamedTuple):
    """Coefficients of power series of degree K; the first axis is the order.

    Attributes:
        v, indentation, force: (K + 2, 3n) v, (K + 2, n) δ, (K + 1, 3n) p.
        speed, unit: (K + 1, n) |v_t|, or ρ of (14.14) for shared incipient slip; (K + 1, 2n) v_t/|v_t|.
        power: (K + 2, n) δ^η.
        changes: (3n,) 1 for velocities that are not constant.
        beyond: (POINTS, 3n) impulses to be added to those of `force` at points of the step; see `spread`.
    """

    v: FloatRows
    indentation: FloatRows
    force: FloatRows
    speed: FloatRows
    unit: FloatRows
    power: FloatRows
    changes: Integers
    beyond: FloatRows


@inlined
def new_series(n):
    """Return a `Series` for n contacts, filled with zeros."""
    return Series(
        np.zeros((ORDER + 2, 3 * n)),
        np.zeros((ORDER + 2, n)),
        np.zeros((ORDER + 1, 3 * n)),
        np.zeros((ORDER + 1, n)),
        np.zeros((ORDER + 1, 2 * n)),
        np.zeros((ORDER + 2, n)),
        np.zeros(3 * n, dtype=np.int64),
        np.zeros((POINTS, 3 * n)),
    )


@inlined
def bounded_unknowns(system, state):
    """Return the indices in (3n,) of constraint forces: sticking friction, normal forces of held contacts."""
    n = len(system.friction)
    places = np.empty(3 * n, dtype=np.int64)
    count = 0
    for j in range(n):
        if state.tangent[j] == STUCK:
            places[count] = 3 * j
            places[count + 1] = 3 * j + 1
            count += 2
        if state.normal[j] == HELD:
            places[count] = 3 * j + 2
            count += 1
    return places[:count].copy()


@inlined
def force_inverse(system, state, unit, unknown, weight, inverse):
    """Compute the matrix that maps accelerations at the unknown forces to the forces that cause them. (14.4)

    If these are not unique, those of least Σ|f|²/weight are taken.

    Args:
        system, state: The `System` and the `State`.
        unit: (2n,) directions of slip.
        unknown: (m,) indices in (3n,) of the unknown forces.
        weight: (n,) sizes of forces, ≥ 0.
        inverse: (m, m) is overwritten with the matrix.
    """
    w = system.w
    m = len(unknown)
    if m == 0:
        return
    scaled = np.empty((m, m))
    roots = np.empty(m)
    for a in range(m):
        roots[a] = math.sqrt(weight[unknown[a] // 3])
    for a in range(m):
        row = unknown[a]
        for b in range(m):
            place = unknown[b]
            entry = w[row, place]
            j = place // 3
            if place == 3 * j + 2:
                gx, gy = friction_share(system, state, unit, j)
                entry += w[row, 3 * j] * gx + w[row, 3 * j + 1] * gy
            scaled[a, b] = roots[a] * entry * roots[b]
    units, columns = np.zeros((m, m)), np.empty((m, m))
    for b in range(m):
        units[b, b] = 1.0
    least_norms(scaled, units, NEGLIGIBLE, columns, np.empty((0, m)))
    for b in range(m):
        for a in range(m):
            inverse[a, b] = roots[a] * columns[b, a] * roots[b]


@inlined
def unknown_after(system, state, unit, weight):
    """Return the indices of the unknown forces, the matrix of `force_inverse`, and `weight`.

    Contacts at their friction bounds, or whose slip has just begun, get their direction in `unit` (2n,) from
    `State.direction`.
    """
    for j in range(len(system.friction)):
        if state.tangent[j] == BOUND or state.fresh[j] != 0:
            unit[2 * j], unit[2 * j + 1] = state.direction[2 * j], state.direction[2 * j + 1]
    unknown = bounded_unknowns(system, state)
    inverse = np.empty((len(unknown), len(unknown)))
    force_inverse(system, state, unit, unknown, weight, inverse)
    return unknown, inverse, weight


@declared(System, State, INTEGERS, FLOAT_ROWS, int, int, float, Series, result=bool)
@external
def expand(system, state, unknown, inverse, begin, order, pace, series):
    """Compute the power series of the motion from a state on, for constant modes.

    Args:
        system, state: The `System` and the `State`.
        unknown: (m,) indices in (3n,) of the unknown forces.
        inverse: (m, m) matrix of `force_inverse`.
        begin: Order of the first coefficients to compute: `START`, or one more than those in `series`.
        order: Degree of the series.
        pace: Time scale: the variable is s/pace, or √s/pace.
        series: Is overwritten with the coefficients.

    Returns:
        Whether the variable is √s/pace.
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    unknown, inverse = borrowed(unknown), borrowed(inverse)
    friction = system.friction
    n = len(friction)
    v, indentation, force, unit = series.v, series.indentation, series.force, series.unit
    hertz = system.exponent != 1.0
    root = False
    for j in range(n):
        indentation[0, j] = state.indentation[j]
        for i in range(3 * j, 3 * j + 3):
            v[0, i] = state.v[i]
            if begin == START:
                series.changes[i] = 0
        if hertz and loads(state.normal[j]) and state.indentation[j] <= 0.0:
            root = True
    fixed, rates = np.empty(len(unknown)), np.empty(n)
    closed, ties = what_changes(system, state, rates)
    count = len(ties) if order > 0 else 0
    answers, mechanism = np.zeros((count, 3 * n)), new_mechanism(count)
    for k in range(START if count > 0 else begin, order + 1):  # answers and mechanism need the first one
        forces_of_order(system, state, series, k, root, closed)
        hold(system, state, unit[0], unknown, inverse, fixed, force[k])
        if count > 0 and k == 0:
            for c in range(count):
                answer_of_turn(system, state, unit[0], unknown, inverse, fixed, ties[c], force[k], answers[c])
            find_mechanism(system, state, unit[0], unknown, inverse, fixed, ties, force[0], mechanism)
        elif count > 0:
            turn_together(system, state, series, k, pace, ties, answers, mechanism)
        integrate(system, closed, rates, series, k, pace, root)
    return root


@always_inlined
def forces_of_order(system, state, series, k, root, closed):
    """Compute the coefficients k of slip directions and of forces, without constraint forces.

    Args:
        system, state: The `System` and the `State`.
        series: The `Series`; velocities and indentations are known up to order k.
        k: The order.
        root: Whether the series is in τ.
        closed: Indices of the contacts that have forces.
    """
    friction, force, unit = system.friction, series.force, series.unit
    hertz = system.exponent != 1.0
    filled(force[k], 0.0)
    for j in closed:
        p = 3 * j
        mode, tangent = state.normal[j], state.tangent[j]
        normal = state.pressed[j] if mode == HELD and k == 0 else 0.0
        if loads(mode):
            if hertz:
                normal = system.stiffness[j] * _power(series, system.exponent, k, j)
            else:
                normal = system.stiffness[j] * series.indentation[k, j]
        force[k, p + 2] = normal
        if tangent == SLIPPING and state.fresh[j] == TIED:
            _known_direction(state, series, k, j)
        elif tangent == SLIPPING:
            _direction(series, k, j)
        elif tangent == BOUND:
            for i in range(2 * j, 2 * j + 2):
                unit[k, i] = state.direction[i] if k == 0 else 0.0
        if tangent == STUCK:
            force[k, p] += state.share[2 * j] * normal
            force[k, p + 1] += state.share[2 * j + 1] * normal
        elif tangent in (SLIPPING, BOUND):
            for i in range(k + 1):
                force[k, p] -= friction[j] * force[i, p + 2] * unit[k - i, 2 * j]
                force[k, p + 1] -= friction[j] * force[i, p + 2] * unit[k - i, 2 * j + 1]


@always_inlined
def what_changes(system, state, rates):
    """Fill the rates ρ (n,) of (14.2), 0 for held contacts; return the closed and the `TIED` contacts."""
    n = len(rates)
    closed, ties = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    pressed = count = 0
    for j in range(n):
        rates[j] = 0.0 if state.normal[j] == HELD else rate(system, state.normal[j], j)
        if state.normal[j] != OPEN or state.tangent[j] != FREE:
            closed[pressed] = j
            pressed += 1
        if state.tangent[j] == SLIPPING and state.fresh[j] == TIED:
            ties[count] = j
            count += 1
    return closed[:pressed].copy(), ties[:count].copy()


@always_inlined
def hold(system, state, unit, unknown, inverse, fixed, force):
    """Add the constraint forces that cancel the accelerations of held and sticking contacts.

    Args:
        system, state, unit, unknown, inverse: As for `force_inverse`.
        fixed: (m,) scratch.
        force: (3n,) other forces; the constraint forces are added.
    """
    for a in range(len(unknown)):
        fixed[a] = dot(system.w[unknown[a]], force)
    for a in range(len(unknown)):
        total = -dot(inverse[a, : len(unknown)], fixed)
        place = unknown[a]
        j = place // 3
        force[place] += total
        if place == 3 * j + 2:
            gx, gy = friction_share(system, state, unit, j)
            force[place - 2] += gx * total
            force[place - 1] += gy * total


@inlined
def answer_of_turn(system, state, unit, unknown, inverse, fixed, j, force, answer):
    """Compute the change of all forces per angle of the slip of contact j.

    `force` (3n,) are the forces, `answer` (3n,) is overwritten; other arguments as for `hold`.
    """
    push = system.friction[j] * force[3 * j + 2]
    filled(answer, 0.0)
    answer[3 * j] = push * state.direction[2 * j + 1]
    answer[3 * j + 1] = -push * state.direction[2 * j]
    hold(system, state, unit, unknown, inverse, fixed, answer)


@inlined
def find_mechanism(system, state, unit, unknown, inverse, fixed, ties, force, mechanism):
    """Compute the `Mechanism` of the contacts `ties` under active constraints; arguments as for `hold`."""
    size = 2 * len(ties)
    response, answer = np.empty((size, size)), np.empty(len(force))
    for b in range(size):
        filled(answer, 0.0)
        answer[3 * ties[b // 2] + b % 2] = 1.0
        hold(system, state, unit, unknown, inverse, fixed, answer)
        for a in range(size):
            response[a, b] = dot(system.w[3 * ties[a // 2] + a % 2], answer)
    fill_mechanism(system, state, response, ties, force, mechanism)


@inlined
def _known_direction(state, series, k, j):
    """Compute the part along u(0) of coefficient k of a slip direction u, from |u| = 1; v_t = s² ρ u."""
    unit = series.unit
    if k == 0:
        unit[0, 2 * j], unit[0, 2 * j + 1] = state.direction[2 * j], state.direction[2 * j + 1]
        return
    total = 0.0
    for i in range(1, k):
        total -= 0.5 * (unit[i, 2 * j] * unit[k - i, 2 * j] + unit[i, 2 * j + 1] * unit[k - i, 2 * j + 1])
    unit[k, 2 * j] = total * state.direction[2 * j]
    unit[k, 2 * j + 1] = total * state.direction[2 * j + 1]


@inlined
def natural_pace(state, series):
    """Return a time, at most 1, in which slip velocities change by no more than ten times their size.

    With this time scale no coefficient overflows.

    Args:
        state: The `State`.
        series: A `Series` of degree 1 or more with time scale 1.
    """
    pace = 1.0
    for j in range(len(state.tangent)):
        if state.tangent[j] == SLIPPING and state.fresh[j] != TIED:
            speed = math.hypot(state.v[3 * j], state.v[3 * j + 1])
            change = math.hypot(series.v[1, 3 * j], series.v[1, 3 * j + 1])
            if change > 10.0 * speed:
                pace = min(pace, 10.0 * speed / change)
    return pace


@always_inlined
def integrate(system, closed, rates, series, k, pace, root):
    """Compute the coefficients k + 1 of velocities and indentations from coefficients k of forces. (14.1)"""
    w = system.w
    n = len(system.friction)
    v, indentation, force = series.v, series.indentation, series.force
    source, factor = (k - 1, 2.0 * pace * pace / (k + 1.0)) if root else (k, pace / (k + 1.0))
    filled(v[k + 1], 0.0)
    if source >= 0:
        for j in closed:
            for a in range(3 * j, 3 * j + 3):  # W is symmetric, and many forces are zero
                push = factor * force[source, a]
                if push == 0.0:
                    continue
                if 4 * system.filled_count[a] < 3 * n:  # sparse, as for a row of balls
                    for place in range(system.filled_count[a]):
                        i = system.filled[a, place]
                        v[k + 1, i] += w[a, i] * push
                        series.changes[i] = 1
                else:
                    for i in range(3 * n):
                        v[k + 1, i] += w[a, i] * push
                        series.changes[i] = 1
    for j in range(n):
        fall = v[source, 3 * j + 2] if source >= 0 else 0.0
        indentation[k + 1, j] = -rates[j] * fall * factor


@always_inlined
def _direction(series, k, j):
    """Compute the coefficients k of |v_t| and v_t/|v_t|."""
    v, speed, unit = series.v, series.speed, series.unit
    x, y = 3 * j, 3 * j + 1
    if k == 0:
        speed[0, j] = math.hypot(v[0, x], v[0, y])
        unit[0, 2 * j] = v[0, x] / speed[0, j]
        unit[0, 2 * j + 1] = v[0, y] / speed[0, j]
        return
    total = 0.0
    for i in range(k + 1):
        total += v[i, x] * v[k - i, x] + v[i, y] * v[k - i, y]
    for i in range(1, k):
        total -= speed[i, j] * speed[k - i, j]
    speed[k, j] = 0.5 * total / speed[0, j]
    along, across = v[k, x], v[k, y]
    for i in range(1, k + 1):
        along -= speed[i, j] * unit[k - i, 2 * j]
        across -= speed[i, j] * unit[k - i, 2 * j + 1]
    unit[k, 2 * j] = along / speed[0, j]
    unit[k, 2 * j + 1] = across / speed[0, j]


@inlined
def _power(series, exponent, k, j):
    """Return the coefficient k of δ^η, for δ(0) > 0 or, in τ, for δ of order τ²."""
    indentation, power = series.indentation, series.power
    if indentation[0, j] > 0.0:
        _next_power(indentation, power, exponent, k, j, 0)
        return power[k, j]
    if indentation[2, j] <= 0.0 or k < 3:  # without approach, δ^η is far below rounding
        return 0.0
    _next_power(indentation, power, exponent, k - 3, j, 2)
    return power[k - 3, j]


@inlined
def _next_power(base, power, exponent, k, j, shift):
    """Compute the coefficient k of (Σ base_{i+shift} xⁱ)^η, by J.C.P. Miller's recurrence."""
    if k == 0:
        power[0, j] = base[shift, j] ** exponent
        return
    total = 0.0
    for i in range(1, k + 1):
        total += (exponent * i - (k - i)) * base[i + shift, j] * power[k - i, j]
    power[k, j] = total / (k * base[shift, j])
