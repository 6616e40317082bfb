"""Overlap at the end of a time step, and the least displacement that removes it. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import jit
from ..._numeric.augmented_newton import VelocityProblem, law_of_steps
from ..._numeric.loops import flags
from ..._numeric.tolerances import LITTLE, SETTLED
from .dynamics import ABA, call_python, set_state
from .midpoint_step import fill_rows
from .step_impulses import step_impulses
from .step_rows import StepRows, StepSystem, normal_row
from .workspace import SceneWorkspace


@declared(SceneWorkspace, FLOATS, FLOATS, StepRows, result=float)
@jit
def overlap_at(work, q, v, rows):
    """Fill the rows of a step at q (nq,) and v (nv,); return the overlap [m].

    It is the largest overlap of contacts and limits, or |gap| of held contacts.
    """
    set_state(work, q, v)
    call_python(work, ABA)  # fills joint placements, Jacobian, velocities and accelerations
    nc, every = len(rows.contacts), len(rows.contacts) + len(rows.held)
    acceleration, turning = np.empty((2, every, 3))
    fill_rows(work, v, rows, np.empty(len(rows.counts)), acceleration, turning)
    overlap = 0.0
    for k in range(len(rows.gap)):
        overlap = max(overlap, abs(rows.gap[k]) if nc <= k < every else -rows.gap[k])
    return overlap


@declared(StepSystem, StepRows, FLOATS, FLOATS)
@jit
def least_displacement(system, rows, displacement, pushes):
    """Fill the least displacement ξ (nv,) in the metric of M that removes overlap, and its multipliers.

    `system` has M without the terms of damping and drives. `pushes` (nc + nl + 3 nh,) are the multipliers z
    of `StepRows.normals`, then of `StepRows.held_rows`.
    """
    nc, nh, n = len(rows.contacts), len(rows.held), len(pushes)
    every, near = nc + nh, nc + len(rows.limits)
    values, columns = np.empty((n, rows.values.shape[1])), np.empty((n, rows.values.shape[1]), dtype=np.int64)
    counts, free, none = np.empty(n, dtype=np.int64), np.zeros(n), np.empty(0)
    lower, upper = np.zeros(n), np.full(n, math.inf)
    for i in range(n):
        if i < near:
            row, place = normal_row(nc, every, i)
            free[i] = rows.gap[place]
        else:
            row, lower[i] = 3 * nc + i - near, -math.inf
            if row % 3 == 2:
                free[i] = rows.gap[row // 3]
        counts[i] = rows.counts[row]
        for k in range(counts[i]):
            values[i, k], columns[i, k] = rows.values[row, k], rows.columns[row, k]
    problem = VelocityProblem(
        *(system.mass, system.inverse, system.start, values, columns, counts),
        *(free, law_of_steps(none, lower, upper), none),
    )
    begin, active, unknown = np.zeros(len(displacement)), flags(n, True), np.empty((2, 0, n))
    step_impulses(problem, active, system.tree, LITTLE, SETTLED, 0.0, begin, displacement, pushes, unknown)
