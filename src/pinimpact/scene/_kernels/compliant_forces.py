"""Forces that are not unique: the limit of small compliances under Coulomb's law. (theory.md, 11.4)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external
from ..._numeric.coulomb_problem import solve_compliant
from ..._numeric.loops import assign, flags
from ..._numeric.products import apply
from ..._numeric.tolerances import ROUNDOFF, UNDETERMINED
from .contact_forces import HELD, SLIP, delassus_of_rows, relative_residual
from .tolerances import NEGLIGIBLE
from .workspace import SceneWorkspace


@declared(SceneWorkspace, result=bool)
@external
def compliant_forces(work):
    """Replace `work.solution` by the limit (11.12) within the bounds; return whether it keeps the modes.

    The state has just been evaluated, and `work.solution` solves (9.3) without bounds; `work.target` is
    replaced by what it satisfies, since redundant rows contradict each other by rounding errors.
    """
    modes, index, solution = work.active_mode, work.scalar_velocity, work.solution
    n, nc, ns = work.nv, len(modes), len(index)
    size = 3 * nc + ns
    rows, free, x = np.zeros((size, n)), np.empty(size), np.zeros(size)
    row, slip = np.empty(len(solution), dtype=np.int64), np.zeros((nc, 2))
    held, none = flags(nc, False), np.zeros(nc)
    a = 0
    for k in range(nc):
        held[k] = modes[k] == HELD
        for d in range(3):
            assign(rows[3 * k + d], work.contact_jacobian[k, d])
            free[3 * k + d] = work.contact_acceleration[k, d]
            if modes[k] != SLIP or d == 2:
                row[a], a = 3 * k + d, a + 1
        if modes[k] == SLIP:
            assign(slip[k], work.slip_direction[k])
    for m in range(ns):
        rows[3 * nc + m, index[m]] = work.joint_metres[index[m]]
        row[a], a = 3 * nc + m, a + 1
    apply(work.system, solution, work.target)
    for a in range(len(solution)):
        free[row[a]] = -work.target[a]
    response, delassus = np.empty((size, n)), np.empty((size, size))
    delassus_of_rows(rows, work.minverse, response, delassus)
    residual = solve_compliant(
        *(delassus, free, slip, work.active_friction, none, held, work.scalar_lower, work.scalar_upper),
        *(x, np.ones(nc)),
    )
    found, largest = np.empty(len(solution)), 0.0
    for force in x:
        largest = max(largest, abs(force))
    for k in range(nc):
        if not held[k] and x[3 * k + 2] <= ROUNDOFF * largest:  # open
            x[3 * k] = x[3 * k + 1] = x[3 * k + 2] = 0.0
    for a in range(len(solution)):
        found[a] = x[row[a]]
    if residual > UNDETERMINED or not relative_residual(work, found) <= NEGLIGIBLE:
        return False
    assign(solution, found)
    return True
