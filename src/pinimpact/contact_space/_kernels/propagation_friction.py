"""Stick or incipient slip of contacts at rest, by Coulomb's law. (theory.md, section 14.3)"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined
from ..._numeric.augmented_newton import Law
from ..._numeric.coulomb_problem import CoulombProblem, solve_compliant
from ..._numeric.loops import assign, filled, flags, largest
from ..._numeric.products import dot
from ..._numeric.tolerances import COMPUTED, LITTLE, TINY
from .codes import BOUND, FREE, HELD, LOADING, OPEN, SLIPPING, STUCK
from .propagation_series import (
    START,
    Series,
    bounded_unknowns,
    expand,
    force_inverse,
    hold,
    natural_pace,
    unknown_after,
)
from .propagation_sharing import holds_now, mark_shared
from .propagation_state import (
    AT_BOUND,
    NOT_SHARED,
    TIED,
    State,
    System,
    begin_to_slip,
    loads,
    open_contact,
    stick,
)
from .tolerances import AHEAD, NEGLIGIBLE, SAME, UNTURNED

WEIGHED_AHEAD = 0.1
"""Clock ahead at which normal forces are evaluated as the weights of (14.4)."""

WEIGHED_ORDER = np.int64(4)
"""Degree of the series for these weights."""

ROOM = 0.95
"""Fraction of the friction bounds up to which the solution (14.4) is accepted at once."""


@declared(System, State, Series, result=types.Tuple((INTEGERS, FLOAT_ROWS, FLOATS)))
@external
def settle(system, state, series):
    """Choose the modes of contacts that do not slip or are held. (14.3)

    Args:
        system: The `System`.
        state: The `State`; its modes are updated.
        series: Scratch.

    Returns:
        The indices of the unknown forces, the matrix of `force_inverse`, and the weights of (14.4).
    """
    system, state, series = borrowed(system), borrowed(state), borrowed(series)
    n = len(system.friction)
    normal, tangent = state.normal, state.tangent
    none, no_inverse = np.empty(0, dtype=np.int64), np.empty((0, 0))
    stuck, held = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    asked, at_bound, any_held = 0, False, False
    for j in range(n):
        state.shared[j] = NOT_SHARED
        if normal[j] == HELD:
            any_held = True
            held[j] = 1
            state.pressed[j] = 0.0
            asked += 1
        if tangent[j] == STUCK or tangent[j] == BOUND:
            stuck[j] = 1
            tangent[j] = STUCK
            state.share[2 * j] = 0.0
            state.share[2 * j + 1] = 0.0
            at_bound = at_bound or state.fresh[j] == AT_BOUND
            asked += 2
    if asked == 0:
        return none, no_inverse, np.empty(0)
    p, weight, cap, unit = np.zeros(3 * n), np.zeros(n), np.zeros(n), np.zeros(2 * n)
    root = _look_ahead(system, state, series, stuck, held, p, weight, cap, unit)
    unknown = bounded_unknowns(system, state)
    inverse = np.empty((len(unknown), len(unknown)))
    force_inverse(system, state, unit, unknown, weight, inverse)
    forces = p.copy()
    hold(system, state, unit, unknown, inverse, np.empty(len(unknown)), forces)
    scale = largest(forces)
    shared = not any_held and mark_shared(system, state)
    fits = _fits(system, state, cap, unknown, forces, scale)
    if fits and not at_bound and (shared or _within_bounds(system, state, forces, ROOM)):
        return unknown, inverse, weight
    if _begin_at_bound(system, state, not root, unit, weight, series):
        if shared:  # whether the remaining sticking contacts share friction may have changed
            mark_shared(system, state)
        return unknown_after(system, state, unit, weight)
    if shared and (fits or holds_now(system, state, p)):
        return unknown, inverse, weight
    moves = not fits and _admit(system, state, unit, weight, cap, p, forces)
    if shared and moves:
        mark_shared(system, state)
    elif shared:
        for j in range(n):
            if stuck[j] == 1:
                state.share[2 * j], state.share[2 * j + 1] = 0.0, 0.0
                tangent[j] = STUCK
    return unknown_after(system, state, unit, weight)


@inlined
def _look_ahead(system, state, series, stuck, held, p, weight, cap, unit):
    """Compute the forces a little ahead, without friction of sticking contacts and forces of held ones.

    Args:
        system, state: The `System` and the `State`.
        series: Scratch.
        stuck: (n,) 1 for contacts that do not slip.
        held: (n,) 1 for held contacts.
        p: (3n,) zeros; is overwritten with the forces at `AHEAD`.
        weight: (n,) zeros; is overwritten with the normal forces at `WEIGHED_AHEAD`.
        cap: (n,) is overwritten with the largest normal forces of held contacts, inf for others.
        unit: (2n,) zeros; is overwritten with the directions of slip.

    Returns:
        Whether the series is in √s.
    """
    n, normal, tangent = len(weight), state.normal, state.tangent
    for j in range(n):
        if stuck[j] == 1:
            tangent[j] = FREE
        if held[j] == 1:
            normal[j] = OPEN
    none, no_inverse = np.empty(0, dtype=np.int64), np.empty((0, 0))
    root = expand(system, state, none, no_inverse, START, WEIGHED_ORDER, 1.0, series)
    for j in range(n):
        if stuck[j] == 1:
            tangent[j] = STUCK
        if held[j] == 1:
            normal[j] = HELD
    near, far = (math.sqrt(AHEAD), math.sqrt(WEIGHED_AHEAD)) if root else (AHEAD, WEIGHED_AHEAD)
    if not root:  # incipient slip turns much earlier
        near = min(near, UNTURNED * natural_pace(state, series))
    heaviest = 0.0
    for k in range(WEIGHED_ORDER, -1, -1):
        for i in range(3 * n):
            p[i] = p[i] * near + series.force[k, i]
        for j in range(n):
            weight[j] = weight[j] * far + max(series.force[k, 3 * j + 2], 0.0)
    for j in range(n):
        cap[j] = math.inf
        if held[j] == 1:
            cap[j] = system.stiffness[j] * state.indentation[j] ** system.exponent
            weight[j] = cap[j]
        elif not loads(normal[j]):
            p[3 * j + 2] = 0.0
        p[3 * j + 2] = max(p[3 * j + 2], 0.0)
        heaviest = max(heaviest, weight[j])
        if tangent[j] == SLIPPING:
            unit[2 * j], unit[2 * j + 1] = series.unit[0, 2 * j], series.unit[0, 2 * j + 1]
    for j in range(n):
        weight[j] = max(weight[j], NEGLIGIBLE * heaviest)
    return root


@inlined
def _begin_at_bound(system, state, smooth, unit, weight, series):
    """Start the slip of contacts whose friction has reached its bound; return whether there are any.

    Contacts that share friction begin together if v_t = s² ρ u has ρ(0) > 0, (14.14). Those with ρ(0) ≤ 0
    stick again; if none remains, each begins to slip by itself.
    """
    n, found, tied = len(system.friction), False, 0
    for j in range(n):
        if state.fresh[j] == AT_BOUND and state.tangent[j] == STUCK:
            begin_to_slip(state, j)
            found = True
            if smooth and state.shared[j] != NOT_SHARED:
                state.fresh[j] = TIED
                tied += 1
    at_bound, dropped = state.fresh.copy(), tied
    while tied > 0 and dropped > 0:
        unknown, inverse, weight = unknown_after(system, state, unit, weight)
        expand(system, state, unknown, inverse, START, np.int64(1), 1.0, series)
        dropped = 0
        for j in range(n):
            if state.fresh[j] == TIED:
                size = 0.0
                for i in range(3 * n):
                    row = abs(system.w[3 * j, i]) + abs(system.w[3 * j + 1, i])
                    size += row * abs(series.force[1, i])
                if not series.speed[0, j] > NEGLIGIBLE * size:
                    stick(state, j)
                    state.fresh[j] = 0
                    dropped += 1
        tied -= dropped
    for j in range(n):
        if at_bound[j] == TIED and tied == 0:
            begin_to_slip(state, j)
    return found


@inlined
def _fits(system, state, cap, unknown, forces, scale):
    """Return whether forces (3n,) are within their bounds and cancel the constrained accelerations.

    Args:
        system, state: The `System` and the `State`.
        cap: (n,) largest normal forces of held contacts.
        unknown: Indices in (3n,) of the constraint forces.
        forces: (3n,) forces.
        scale: The largest of them.
    """
    for place in unknown:
        total = size = 0.0
        for i in range(len(forces)):
            total += system.w[place, i] * forces[i]
            size += abs(system.w[place, i]) * scale
        if not abs(total) <= NEGLIGIBLE * size:
            return False
    for j in range(len(cap)):
        f = forces[3 * j + 2]
        if state.normal[j] == HELD and not -NEGLIGIBLE * scale <= f <= cap[j] + NEGLIGIBLE * scale:
            return False
    return _within_bounds(system, state, forces, 1.0 + NEGLIGIBLE)


@inlined
def _within_bounds(system, state, forces, part):
    """Return whether friction of sticking contacts is within `part` of its bounds, and none is `BOUND`."""
    for j in range(len(system.friction)):
        if state.tangent[j] == BOUND:
            return False
        if state.tangent[j] == STUCK:
            bound = system.friction[j] * forces[3 * j + 2]
            if not math.hypot(forces[3 * j], forces[3 * j + 1]) <= bound * part:
                return False
    return True


@inlined
def _admit(system, state, unit, weight, cap, p, forces):
    """Solve (14.3) and set the modes accordingly; return whether any contact moves.

    Args:
        system: The `System`.
        state: The `State`; its modes are updated.
        unit: (2n,) directions of slip.
        weight: (n,) normal forces of (14.4).
        cap: (n,) largest normal forces of held contacts.
        p: (3n,) forces without friction of sticking contacts and forces of held ones.
        forces: (3n,) is overwritten with all forces.
    """
    w, friction = system.w, system.friction
    n = len(cap)
    assign(forces, p)
    _solve_resting(system, state, unit, weight, cap, forces)
    scale, moves = largest(forces), False
    for j in range(n):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        if state.tangent[j] == STUCK:
            length, bound = math.hypot(forces[x], forces[y]), friction[j] * forces[z]
            ax, ay, size = dot(w[x], forces), dot(w[y], forces), 0.0
            for i in range(3 * n):
                size += (abs(w[x, i]) + abs(w[y, i])) * scale
            fastest = math.hypot(ax, ay)
            slack = (bound - length) * (w[x, x] + w[y, y])
            if fastest > max(NEGLIGIBLE * size, slack):
                state.direction[2 * j], state.direction[2 * j + 1] = ax / fastest, ay / fastest
                begin_to_slip(state, j)
                moves = True
            elif bound > 0.0 and length < (1.0 - SAME) * bound:
                state.share[2 * j], state.share[2 * j + 1] = forces[x] / forces[z], forces[y] / forces[z]
            elif length > 0.0:
                state.tangent[j] = BOUND
                state.direction[2 * j] = -forces[x] / length
                state.direction[2 * j + 1] = -forces[y] / length
        if state.normal[j] == HELD:
            state.pressed[j] = forces[z]
            rise, size = dot(w[z], forces), 0.0
            for i in range(3 * n):
                size += abs(w[z, i]) * scale
            if forces[z] <= 0.0 and rise > NEGLIGIBLE * size:
                open_contact(state, j)
                moves = True
            elif forces[z] >= cap[j] and rise < -NEGLIGIBLE * size:
                state.normal[j] = LOADING
                moves = True
    return moves


@inlined
def _solve_resting(system, state, unit, weight, cap, forces):
    """Solve (14.3) for the forces of contacts that do not slip or are held.

    The normal force of a held contact is between 0 and its cap, that of others is given. Several solutions
    have one limit of small compliances in proportion to 1/(μ F), (14.4).

    Args:
        system, state: The `System` and the `State`.
        unit: (2n,) directions of slip.
        weight: (n,) normal forces F of (14.4).
        cap: (n,) upper bounds of normal forces of held contacts.
        forces: (3n,) forces; those of the contacts of the problem are overwritten.
    """
    w, friction, n, count = system.w, system.friction, len(cap), 0
    at = np.empty(n, dtype=np.int64)
    for j in range(n):
        if state.tangent[j] == STUCK or state.normal[j] == HELD:
            at[count] = j
            count += 1
    none, size = np.empty(0), 3 * count
    mu, slip, compliance = np.zeros(count), np.zeros((count, 2)), np.empty(count)
    least, most, bounds, largest = np.zeros(count), np.empty(count), np.empty(count), TINY
    delassus, free, x = np.empty((size, size)), np.empty(size), np.zeros(size)
    for c in range(count):
        j = at[c]
        least[c] = most[c] = forces[3 * j + 2]
        if state.normal[j] == HELD:
            least[c], most[c] = 0.0, cap[j]
        if state.tangent[j] != FREE:
            mu[c] = friction[j]
        if state.tangent[j] == SLIPPING:
            slip[c, 0], slip[c, 1] = unit[2 * j], unit[2 * j + 1]
        bounds[c] = weight[j] * (friction[j] if friction[j] > 0.0 else 1.0)
        largest = max(largest, bounds[c])
        filled(forces[3 * j : 3 * j + 3], 0.0)
    for a in range(size):
        row = w[3 * at[a // 3] + a % 3]
        free[a] = dot(row, forces)
        for b in range(size):
            delassus[a, b] = row[3 * at[b // 3] + b % 3]
    for c in range(count):
        compliance[c] = 1.0 / max(bounds[c], LITTLE * largest)
    law = Law(mu, slip, least, most, flags(count, False), none, none)
    solve_compliant(CoulombProblem(delassus, free, law), x, compliance, COMPUTED)
    for a in range(size):
        forces[3 * at[a // 3] + a % 3] = x[a]
