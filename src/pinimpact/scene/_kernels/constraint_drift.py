"""Constraint drift of the active set over a step, and its correction. (theory.md, 12)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign
from . import lie_charts
from .active_set import NORMAL, active_rows, stop_along
from .contact_forces import SLIP
from .dynamics import evaluate_anew, set_state
from .workspace import SceneWorkspace


@inlined
def constraint_drift(work, v):
    """Return the largest error of gap [m] or velocity [m/s] of active contacts and scalar rows at v (nv,)."""
    mode, velocity = work.active_mode, work.contact_velocity
    gap, rest = work.contact_gap, work.active_rest_gap
    worst = 0.0
    for k in range(len(mode)):
        worst = max(worst, abs(gap[k] - rest[k]), abs(velocity[k, 2]))
        if mode[k] != SLIP:
            worst = max(worst, abs(velocity[k, 0]), abs(velocity[k, 1]))
    for j in work.scalar_velocity:
        worst = max(worst, work.joint_metres[j] * abs(v[j]))
    return worst


@declared(SceneWorkspace, float, FLOATS, FLOATS)
@jit
def correct_constraint_drift(work, t, q, v):
    """Correct constraint drift in q (nq,) and v (nv,); return the kinetic energy gained [J]. (12.1)"""
    index_q, index_v, bound = work.limit_q, work.limit_v, work.limit_bound
    minverse, jacobian = work.minverse, work.contact_jacobian
    gap, rest = work.contact_gap, work.active_rest_gap
    closed, metres = work.modes[work.contacts :][: work.limits], work.joint_metres
    n, nc, ns, nl = len(v), work.active_contacts, work.active_scalars, work.limits
    rates = np.empty(n + 4)
    rows = np.zeros((3 * nc + ns + nl, n))
    errors = np.empty(len(rows))
    set_state(work, q, v)
    evaluate_anew(work, t, rates)
    total = 0
    for k in range(nc):
        assign(rows[total], jacobian[k, 2])
        errors[total] = gap[k] - rest[k]
        total += 1
    for m in range(nl):
        if closed[m] != 0:
            rows[total, index_v[m]] = metres[index_v[m]]
            errors[total] = metres[index_v[m]] * (q[index_q[m]] - bound[m])
            total += 1
    if total > 0 and not work.callback_failed:
        xi, start = np.zeros(n), q.copy()
        stop_along(rows[:total], errors[:total], minverse, xi)
        lie_charts.advance(work.joint_charts, start, xi, q)
        for m in range(nl):
            if closed[m] != 0:
                q[index_q[m]] = bound[m]
        assign(work.q, q)
        evaluate_anew(work, t, rates)
    rows = np.zeros((3 * nc + ns + nl, n))
    total = active_rows(work, v, NORMAL, rows, errors)
    if total == 0 or work.callback_failed:
        return 0.0
    return stop_along(rows[:total], errors[:total], minverse, v)
