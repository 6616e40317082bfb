"""Forces on the touching contacts at an instant, from which the modes are chosen. (theory.md, 11.3, 11.4)

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.coulomb_problem import (
    USABLE,
    CoulombProblem,
    orientation,
    polish,
    solve_compliant,
    solve_coulomb,
)
from ..._numeric.elimination import RANK
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, filled, nonzero, ones
from ..._numeric.tolerances import COMPUTED, UNDETERMINED
from .tolerances import NEGLIGIBLE

COMPLIANT, AT_REST, ANY = range(3)
"""Ways to find forces: the limit of small compliances; Newton's method from those that keep pressed contacts
at rest; the method of augmented Lagrangians."""


@declared(CoulombProblem, FLOATS, FLAGS, bool, result=bool)
@external
def find_forces(problem, x, pressed, unique):
    """Find forces that satisfy Coulomb's law, preferably persistent ones. (theory.md, 11.3 and 11.4)

    Newton's method starts from the forces at which pressed contacts and joints rest, so that they stay at
    rest if possible. The method of augmented Lagrangians comes last. The search stops at the first forces
    whose equations have no negative determinant.

    Args:
        problem: The `CoulombProblem`.
        x: (3 nc + ns,) is overwritten with the forces; if none are found, with those of the last attempt.
        pressed: (nc + ns,) whether each contact or scalar row has been pressed, or held, so far.
        unique: Whether W is regular; otherwise the limit of small compliances is tried first.

    Returns:
        Whether forces were found.
    """
    trial, found = np.empty(len(x)), False
    for way in range(AT_REST if unique else COMPLIANT, ANY + 1):
        if way <= AT_REST:
            at_rest(problem, pressed, trial)
        if way == COMPLIANT:
            error = solve_compliant(problem, trial, ones(len(problem.law.friction)), COMPUTED)
        elif way == ANY:
            error = solve_coulomb(problem, trial)
        else:
            error = polish(problem, trial, COMPUTED)
        if error > (USABLE if unique else UNDETERMINED):  # see (11.10)
            if way == ANY and not found:
                assign(x, trial)
            continue
        determinant_sign = orientation(problem, trial)
        if determinant_sign > 0 or not found:
            assign(x, trial)
        found = True
        if determinant_sign >= 0:
            break
    return found


@inlined
def at_rest(problem, pressed, x):
    """Fill forces x (m,) at which pressed contacts and scalar rows have no acceleration.

    The friction of a sliding contact is proportional to its normal force, opposite to the slip.
    """
    delassus, free, law = problem
    mu, slip, _, _, held, lower, upper = law
    nc, size = len(mu), len(x)
    moves, drag = np.zeros(size, dtype=np.int64), np.zeros((nc, 2))
    for k in range(nc):
        speed, slides = math.hypot(slip[k, 0], slip[k, 1]), mu[k] == 0.0
        if speed > 0.0 and not held[k]:
            slides = True
            drag[k, 0], drag[k, 1] = -mu[k] * slip[k, 0] / speed, -mu[k] * slip[k, 1] / speed
        moves[3 * k + 2] = pressed[k] or held[k]
        moves[3 * k] = moves[3 * k + 1] = held[k] or (pressed[k] and not slides)
    for m in range(len(lower)):  # joints with dry friction rest if their bounds allow it
        moves[3 * nc + m] = pressed[nc + m] or -math.inf < lower[m] <= upper[m] < math.inf
    filled(x, 0.0)
    beyond = True
    while beyond:  # fix joints beyond their bounds at these
        stop_rows(delassus, free, drag, nonzero(moves), x)
        beyond = False
        for m in range(len(lower)):
            a, within = 3 * nc + m, min(max(x[3 * nc + m], lower[m]), upper[m])
            if within != x[a]:
                x[a], moves[a], beyond = within, 0, True
    for k in range(nc):
        if moves[3 * k] == 0:
            x[3 * k], x[3 * k + 1] = drag[k, 0] * x[3 * k + 2], drag[k, 1] * x[3 * k + 2]


@inlined
def stop_rows(delassus, free, drag, rows, x):
    """Fill the entries `rows` of forces x so that these rows have no acceleration.

    drag (nc, 2) is the friction of each sliding contact per normal force, zero for others.
    """
    m, closed = len(rows), 3 * len(drag)
    system, right, solution = np.empty((m, m)), np.empty(m), np.empty(m)
    for c in range(m):
        x[rows[c]] = 0.0
    for c in range(m):
        right[c] = -free[rows[c]]
        for a in range(closed, len(x)):
            right[c] -= delassus[rows[c], a] * x[a]
        for d in range(m):
            b = rows[d]
            system[c, d] = delassus[rows[c], b]
            if b < closed and b % 3 == 2:
                for e in range(2):
                    system[c, d] += delassus[rows[c], b - 2 + e] * drag[b // 3, e]
    least_norm(system, right, RANK, solution, np.empty((0, m)))
    for c in range(m):
        x[rows[c]] = solution[c]


@inlined
def jammed_contact(problem, x):
    """Return a contact that jams by itself under the other forces x (13.1), or −1 if none does."""
    delassus, free, law = problem
    mu, slip, held = law.friction, law.slip, law.held
    for k in range(len(mu)):
        b, speed = 3 * k, math.hypot(slip[k, 0], slip[k, 1])
        if held[k] or mu[k] == 0.0 or speed == 0.0:
            continue
        whole, acceleration = delassus[b + 2, b + 2], free[b + 2]
        across = (slip[k, 0] * delassus[b + 2, b] + slip[k, 1] * delassus[b + 2, b + 1]) / speed
        for a in range(len(x)):
            if not b <= a < b + 3:
                acceleration += delassus[b + 2, a] * x[a]
        if whole - mu[k] * across <= NEGLIGIBLE * whole and acceleration < 0.0:
            return k
    return -1
