"""One step of the Dormand-Prince method in a chart about its start, with its dense output."""

from __future__ import annotations

import math

from ..._numeric.jit import inner, jit
from . import stages
from . import workspace as at
from .dop853 import DENSE, DENSE_STAGES, ERROR, NODES, STAGES, STEP
from .dynamics import FAILED, LEAST_MARGIN, evaluate
from .lie_charts import magnitudes, turned_too_far
from .workspace import d1, d2, i2, put


@jit
def attempt(t, h, rtol, atol, mem):
    """Compute a step of length h; return its error over the tolerance, infinite if it turns too far."""
    state = d1(mem, at.STATE)
    joints, q0, v0, q1, v1, rates, xi, sizes = (
        i2(mem, at.JOINTS),
        d1(mem, at.Q0),
        d1(mem, at.V0),
        d1(mem, at.Q1),
        d1(mem, at.V1),
        d2(mem, at.RATES),
        d1(mem, at.XI),
        d1(mem, at.SIZES),
    )
    q, v = d1(mem, at.Q), d1(mem, at.V)
    state[LEAST_MARGIN] = math.inf
    n = len(v0)
    for i in range(1, STAGES + 1):
        stages.stage(i, h, STEP, rates, v0, joints, q0, xi, q, v)
        if i == STAGES:
            if turned_too_far(joints, xi):
                return math.inf
            put(q1, q)
            put(v1, v)
        evaluate(t + NODES[i] * h, mem, rates[i, n:])
        if state[FAILED] != 0.0:
            return math.inf
    magnitudes(joints, q0, sizes)
    error = stages.error_norm(h, ERROR, rates[: STAGES + 1], v0, v1, sizes, rtol, atol)
    return error if error == error else math.inf


@inner
def complete(t, h, mem):
    """Fill the dense output of the step last attempted, and `peak`."""
    joints, q0, v0, rates, xi, peak, coefficients = (
        i2(mem, at.JOINTS),
        d1(mem, at.Q0),
        d1(mem, at.V0),
        d2(mem, at.RATES),
        d1(mem, at.XI),
        d2(mem, at.PEAK),
        d2(mem, at.COEFFICIENTS),
    )
    n = len(v0)
    stages.largest(rates, STAGES + 1, n, peak)
    for i in range(STAGES + 1, DENSE_STAGES):
        stages.stage(i, h, STEP, rates, v0, joints, q0, xi, d1(mem, at.Q), d1(mem, at.V))
        evaluate(t + NODES[i] * h, mem, rates[i, n:])
    stages.dense(h, STEP, DENSE, rates, coefficients)


@inner
def go_on(mem):
    """Take the end of the step last attempted as the start of the next one."""
    q0, v0, q1, v1, rates = d1(mem, at.Q0), d1(mem, at.V0), d1(mem, at.Q1), d1(mem, at.V1), d2(mem, at.RATES)
    put(q0, q1)
    put(v0, v1)
    put(rates[0], rates[STAGES])
    for m in range(len(v0)):
        rates[0, m] = v0[m]
