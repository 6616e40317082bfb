"""Detection of a jam: slip whose contact forces grow without bound. (theory.md, 13.3)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import jit
from .active_set import ALL, active_rows
from .contact_forces import SLIP, delassus_of_rows
from .dynamics import evaluate_anew, set_state
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS, FLOATS, bool, float)
@jit
def forces_unbounded(work, t, q, v, leaving, singular):
    """Return whether the forces of slipping contacts are unbounded at a state. (13.3)

    Args:
        work: The workspace.
        t, q, v: Time [s] and state.
        leaving: Whether the forces have just left their bounds. If the determinant of (9.3) has also changed
            its sign, the forces are unbounded.
        singular: Residual of the cancelling effects on the normals, relative to the largest one, below which
            the forces are unbounded.
    """
    mode, slipping = work.active_mode, False
    for k in range(len(mode)):
        slipping |= mode[k] == SLIP
    if not slipping:
        return False
    set_state(work, q, v)
    evaluate_anew(work, t, np.empty(len(v) + 4))
    if work.callback_failed:
        return False
    force, scalar_force, minverse = work.contact_force, work.scalar_force, work.minverse
    closed, n, scalar, metres = 3 * len(mode), len(v), work.scalar_velocity, work.joint_metres
    size = closed + len(scalar_force)
    rows = np.zeros((size, n))
    active_rows(work, v, ALL, rows, np.empty(size))
    response, delassus = np.empty((size, n)), np.empty((size, size))
    delassus_of_rows(rows, minverse, response, delassus)
    net_effect = largest_term = 0.0  # effects of the forces on the normals: they cancel near the singularity
    for k in range(len(mode)):
        total = 0.0
        for a in range(size):
            push = (
                force[a // 3, a % 3] if a < closed else scalar_force[a - closed] / metres[scalar[a - closed]]
            )
            part = delassus[3 * k + 2, a] * push
            total += part
            largest_term = max(largest_term, abs(part))
        net_effect = max(net_effect, abs(total))
    impossible = leaving and work.force_margin == -math.inf
    return impossible or net_effect < singular * largest_term
