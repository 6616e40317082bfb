"""One step of the Dormand-Prince method in a chart about its start, with its dense output.

`run` — joints (k, 4) the table of `charts`; q0, v0 the state at the start of the step; q1, v1 that at the
end of the step last attempted; rates (16, 2 nv + 4) at the stages; xi and sizes (nv,) scratch; peak (4, nv)
see `stages.largest`; coefficients (7, 2 nv + 4) see `stages.interpolate`.
"""

from __future__ import annotations

import math

from . import stages
from .charts import magnitudes, turned_too_far
from .dop853 import DENSE, DENSE_STAGES, ERROR, NODES, STAGES, STEP
from .jit import inner
from .motion import FAILED, evaluate


@inner
def attempt(t, h, rtol, atol, run, tree, points, closed, state):
    """Compute a step of length h; return its error over the tolerance, infinite if it turns too far."""
    joints, q0, v0, q1, v1, rates, xi, sizes = run[:8]
    q, v = tree[1], tree[2]
    n = len(v0)
    for i in range(1, STAGES + 1):
        stages.stage(i, h, STEP, rates, v0, joints, q0, xi, q, v)
        if i == STAGES:
            if turned_too_far(joints, xi):
                return math.inf
            q1[:] = q
            v1[:] = v
        evaluate(t + NODES[i] * h, tree, points, closed, state, rates[i, n:])
        if state[FAILED] != 0.0:
            return math.inf
    magnitudes(joints, q0, sizes)
    error = stages.error_norm(h, ERROR, rates[: STAGES + 1], v0, v1, sizes, rtol, atol)
    return error if error == error else math.inf


@inner
def complete(t, h, run, tree, points, closed, state):
    """Fill the dense output of the step last attempted, and `peak`."""
    joints, q0, v0, _, _, rates, xi, _, peak, coefficients = run
    n = len(v0)
    stages.largest(rates, STAGES + 1, n, peak)
    for i in range(STAGES + 1, DENSE_STAGES):
        stages.stage(i, h, STEP, rates, v0, joints, q0, xi, tree[1], tree[2])
        evaluate(t + NODES[i] * h, tree, points, closed, state, rates[i, n:])
    stages.dense(h, STEP, DENSE, rates, coefficients)


@inner
def go_on(run):
    """Take the end of the step last attempted as the start of the next one."""
    _, q0, v0, q1, v1, rates = run[:6]
    q0[:] = q1
    v0[:] = v1
    rates[0] = rates[STAGES]
    rates[0, : len(v0)] = v0
