"""Forces that are not unique: the limit of small compliances under Coulomb's law. (theory.md, 11.4)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external, inlined
from ..._numeric.augmented_newton import coulomb_law
from ..._numeric.coulomb_problem import CoulombProblem, solve_compliant
from ..._numeric.loops import assign, flags, ones, repeated
from ..._numeric.products import apply
from ..._numeric.tolerances import COMPUTED, ROUNDOFF, UNDETERMINED
from .contact_forces import HELD, SLIP, STICK, delassus_of_rows, solve_redundant
from .workspace import SceneWorkspace


@declared(SceneWorkspace, result=bool)
@external
def compliant_forces(work):
    """Replace `work.solution` by the limit (11.12) within the bounds; return whether it was found.

    The state has just been evaluated, and `work.solution` solves (9.3) without bounds. Only contacts and
    scalar rows are changed that are coupled to a force beyond its bounds. If the limit does not keep the
    modes, it is corrected to satisfy (9.3), and has left its bounds then.
    """
    modes, index, solution = work.active_mode, work.scalar_velocity, work.solution
    chosen = coupled_to_violations(work)
    nc = ns = 0
    for k in range(len(chosen)):
        if chosen[k]:
            nc, ns = nc + (k < len(modes)), ns + (k >= len(modes))
    size, n = 3 * nc + ns, work.nv
    rows, free, x, row = np.zeros((size, n)), np.empty(size), np.zeros(size), repeated(size, -1)
    slip, held, mu = np.zeros((nc, 2)), flags(nc, False), np.empty(nc)
    lower, upper = np.empty(ns), np.empty(ns)
    apply(work.system, solution, work.target)  # redundant rows contradict each other by rounding errors
    a = b = 0
    for k in range(len(modes)):
        slips = modes[k] == SLIP
        if chosen[k]:
            i = b // 3
            held[i], mu[i] = modes[k] == HELD, work.active_friction[k]
            for d in range(3):
                assign(rows[b + d], work.contact_jacobian[k, d])
                free[b + d] = work.contact_acceleration[k, d]
                if not slips or d == 2:
                    row[b + d] = a if slips else a + d
            if slips:
                assign(slip[i], work.slip_direction[k])
                for d in range(2):
                    x[b + d] = -mu[i] * slip[i, d] * solution[a]
            b += 3
        a += 1 if slips else 3
    for m in range(len(index)):
        if chosen[len(modes) + m]:
            lower[b - 3 * nc], upper[b - 3 * nc] = work.scalar_lower[m], work.scalar_upper[m]
            rows[b, index[m]], row[b], b = work.joint_metres[index[m]], a + m, b + 1
    for b in range(size):
        if row[b] >= 0:
            free[b], x[b] = -work.target[row[b]], solution[row[b]]
    response, delassus = np.empty((size, n)), np.empty((size, size))
    delassus_of_rows(rows, work.minverse, response, delassus)
    problem = CoulombProblem(delassus, free, coulomb_law(mu, slip, held, lower, upper))
    residual = solve_compliant(problem, x, ones(nc), work.rank_tolerance)
    if residual > UNDETERMINED:
        return False
    largest = 0.0
    for force in x:
        largest = max(largest, abs(force))
    for i in range(nc):
        if not held[i] and x[3 * i + 2] <= ROUNDOFF * largest:  # open
            x[3 * i] = x[3 * i + 1] = x[3 * i + 2] = 0.0
    for b in range(size):
        if row[b] >= 0:
            solution[row[b]] = x[b]
    satisfy(work, COMPUTED * largest)
    return True


@inlined
def coupled_to_violations(work):
    """Return flags of contacts, then scalar rows, that are coupled by (9.3) to forces beyond their bounds."""
    modes, system, solution = work.active_mode, work.system, work.solution
    nc, size = len(modes), len(solution)
    items = nc + len(work.scalar_velocity)
    chosen, owner = flags(items, False), np.empty(size, dtype=np.int64)
    a = 0
    for k in range(items):
        rows = 3 if k < nc and modes[k] != SLIP else 1
        for d in range(rows):
            owner[a + d] = k
        a += rows
        last = solution[a - 1]
        if k >= nc:
            chosen[k] = last < work.scalar_lower[k - nc] or last > work.scalar_upper[k - nc]
        elif modes[k] == SLIP:
            chosen[k] = last < 0.0
        elif modes[k] == STICK:
            tangent = math.hypot(solution[a - 3], solution[a - 2])
            chosen[k] = last < 0.0 or tangent > work.active_friction[k] * last
    grows = True
    while grows:
        grows = False
        for a in range(size):
            for b in range(size):
                if system[a, b] != 0.0 and chosen[owner[a]] != chosen[owner[b]]:
                    chosen[owner[a]] = chosen[owner[b]] = grows = True
    return chosen


@inlined
def satisfy(work, rounding):
    """Correct `work.solution` so that it satisfies (9.3); changes of `rounding` keep zeros and bounds."""
    system, target, solution = work.system, work.target, work.solution
    size = len(solution)
    missing, change = np.empty((1, size)), np.empty((1, size))
    apply(system, solution, missing[0])
    for a in range(size):
        missing[0, a] = target[a] - missing[0, a]
    solve_redundant(work, system, missing, change, np.empty((0, size)))
    for a in range(size):
        m = a - size + len(work.scalar_lower)
        bounded = solution[a] == 0.0
        if m >= 0:
            bounded = solution[a] == work.scalar_lower[m] or solution[a] == work.scalar_upper[m]
        if not bounded or abs(change[0, a]) > rounding:
            solution[a] += change[0, a]
