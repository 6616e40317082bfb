"""A step of an explicit Runge-Kutta method in a chart about its start, with dense output. (theory.md, 9)

`work.method` selects the order: 8 (Dormand and Prince), or, where steps are cut short, for example by the
next sample of a control, 5 with half of the evaluations, 3 with a quarter, or 2 with a sixth.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign, largest
from ..._numeric.products import dot
from . import bogacki_shampine, dopri5, explicit_midpoint
from .dense_output import rate_bounds
from .dop853 import DENSE, DENSE_STAGES, ERROR, NODES, STAGES, STEP
from .dynamics import evaluate
from .lie_charts import advance, chart_rate, diverged, magnitudes, turned_too_far
from .samples import record_sample
from .trees import end_of_tree
from .workspace import DENSE_TERMS, SceneWorkspace

SAMPLES = np.array(
    [
        [0, -1, -1, -1, -1, 3, -1, -1, -1, 4, -1, -1, 6, 1, 2, 5],
        [0, 1, 2, 3, 4, -1, 5, -1, -1, -1, -1, -1, -1, -1, -1, -1],
        [0, 1, 2, 3, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1],
        [0, 1, 2, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1],
    ]
)
"""Sample number of each stage by method, see `samples`; −1 for stages that are not sampled."""

SAMPLE_COUNTS = np.array([7, 6, 4, 3])

POWERS = np.array([1 / 8, 1 / 5, 1 / 3, 1 / 3, 1 / 8])
"""Exponents p by method: the step size control scales a step by error⁻ᵖ."""

LOW = dopri5, bogacki_shampine, explicit_midpoint
"""The methods of low order."""

IMPLICIT = 1 + len(LOW)
"""Number of the method of `step_radau`."""

LAST = np.array([STAGES, *(one.STAGES for one in LOW), STAGES])
"""Stage at the end of the step, by method."""

TERMS = np.array([DENSE_TERMS, 4, 3, 3, DENSE_TERMS])
"""Number of rows of the dense output that are not zero, by method."""


def _stacked(high, *others):
    """Return the coefficients of all methods in one array, padded with zeros."""
    found = np.zeros((1 + len(others), *high.shape))
    found[0] = high
    for k, low in enumerate(others, start=1):
        found[k][tuple(map(slice, low.shape))] = low
    return found


ALL_NODES = _stacked(NODES, *(one.NODES for one in LOW))
STEPS = _stacked(STEP, *(one.STEP for one in LOW))
ERRORS = _stacked(ERROR, *(np.array([0.0 * one.ERROR, one.ERROR]) for one in LOW))
DENSES = _stacked(DENSE, dopri5.DENSE[None], *np.zeros((2, 1, 0)))


@declared(SceneWorkspace, float, float, float, float)
@jit
def attempt(work, t, h, rtol, atol):
    """Compute a step of length h [s] from t [s]; return its error relative to the tolerance.

    The error is infinite if a stage leaves the chart or a call into Python fails.
    """
    rates, v0, v1 = work.stage_rates, work.v0, work.v1
    reactions = work.stage_reactions
    work.step_turns = False
    n, closed = len(v0), work.active_contacts + work.active_scalars > 0
    which = work.method
    last = LAST[which]
    for i in range(1, last + 1):
        set_stage(work, i, h)
        if diverged(work.xi, work.v):
            return math.inf
        if i == last:
            if turned_too_far(work.joint_charts, work.xi):
                return math.inf
            assign(work.q1, work.q)
            assign(v1, work.v)
        evaluate(work, t + ALL_NODES[which, i] * h, rates[i, n:])
        if work.callback_failed:
            return math.inf
        if closed:
            for m in range(n):
                reactions[i, m] = rates[i, n + m] - work.acceleration[m]
            if SAMPLES[which, i] > 0:
                record_sample(work, SAMPLES[which, i], ALL_NODES[which, i])
    work.evaluated = closed
    magnitudes(work.joint_charts, work.q0, work.tolerance_sizes)
    error, reaction, first, weights = 0.0, 0.0, 0, ERRORS[which]
    rates, reactions = rates[: last + 1], reactions[: last + 1]
    while first < n:  # the largest error of a tree, so that it does not depend on other bodies
        tree = first, end_of_tree(work.velocity_parent, first)
        own = error_norm(h, weights, rates, tree, v0, v1, work.tolerance_sizes, rtol, atol)
        if closed:
            reaction = reaction_error(h, weights, reactions, tree, v0, v1, rtol, atol)
        if not own + reaction < math.inf:
            return math.inf
        error, first = max(error, own, reaction), tree[1]
    return error


@inlined
def reaction_error(h, weights, reactions, tree, v0, v1, rtol, atol):
    """Return the error of ∫ r dt over the step relative to the tolerance, r = v̇ of a tree due to active rows.

    A body at rest does not move under any load, so the error of the motion does not show that a step is too
    long for a changing load; the error of the reactions does. (theory.md, 11.6)
    """
    e3 = e5 = 0.0
    for m in range(tree[0], tree[1]):
        a, b = dot(reactions[:, m], weights[0]), dot(reactions[:, m], weights[1])
        size = max(abs(v0[m]), abs(v1[m]), abs(h) * largest(reactions[:, m]))
        scale = 1.0 / (atol + rtol * size)
        e3 += (a * scale) ** 2
        e5 += (b * scale) ** 2
    if e3 == 0.0 and e5 == 0.0:
        return 0.0
    return abs(h) * e5 / math.sqrt((e5 + 0.01 * e3) * (tree[1] - tree[0]))


@declared(SceneWorkspace, int, float)
@external
def set_stage(work, i, h):
    """Set the state at stage i of a step of length h [s], and fill ξ̇ of the stage."""
    rates, v0, xi, v = work.stage_rates, work.v0, work.xi, work.v
    n, weights = len(v0), STEPS[work.method, i]
    for m in range(n):
        a = b = 0.0  # independent sums, which is faster
        for j in range(i):
            c = weights[j]
            a += c * rates[j, m]
            b += c * rates[j, n + m]
        xi[m] = h * a
        v[m] = v0[m] + h * b
    advance(work.joint_charts, work.q0, xi, work.q)
    chart_rate(work.joint_charts, xi, v, rates[i, :n])


@inlined
def error_norm(h, weights, rates, tree, v0, v1, sizes, rtol, atol):
    """Return the error of a tree relative to the tolerance, root mean square over its ξ and v.

    `tree` contains its first velocity and that after its last one.
    """
    n, (first, stop) = len(v0), tree
    e3 = e5 = 0.0
    for half in range(2):
        for m in range(half * n + first, half * n + stop):
            a = b = 0.0
            for j in range(len(rates)):
                a += weights[0, j] * rates[j, m]
                b += weights[1, j] * rates[j, m]
            size = sizes[m] if half == 0 else max(abs(v0[m - n]), abs(v1[m - n]))
            scale = 1.0 / (atol + rtol * size)
            e3 += (a * scale) ** 2
            e5 += (b * scale) ** 2
    if e3 == 0.0 and e5 == 0.0:
        return 0.0
    return abs(h) * e5 / math.sqrt((e5 + 0.01 * e3) * 2 * (stop - first))


@inlined
def complete(work, t, h):
    """Fill the dense output of the last attempted step, and the bounds of its rates."""
    rates, out = work.stage_rates, work.dense_coefficients
    n, which = len(work.v0), work.method
    last, terms = LAST[which], TERMS[which]
    used = DENSE_STAGES if which == 0 else last + 1
    rate_bounds(rates, last + 1, n, work.rate_bounds)
    for i in range(last + 1, used):
        set_stage(work, i, h)
        evaluate(work, t + NODES[i] * h, rates[i, n:])
        record_sample(work, SAMPLES[0, i], NODES[i])
    work.samples = SAMPLE_COUNTS[which]
    for m in range(rates.shape[1]):
        total = dot(rates[:last, m], STEPS[which, last])
        out[0, m] = h * total
        out[1, m] = h * (rates[0, m] - total)
        out[2, m] = h * (2.0 * total - rates[0, m] - rates[last, m])
        for k in range(3, terms):
            out[k, m] = h * dot(rates[:used, m], DENSES[which, k - 3])
        for k in range(terms, DENSE_TERMS):
            out[k, m] = 0.0


@inlined
def begin_next(work):
    """Copy the end of the last attempted step to the start of the next one."""
    rates, v0, last = work.stage_rates, work.v0, LAST[work.method]
    assign(work.q0, work.q1)
    assign(v0, work.v1)
    assign(rates[0], rates[last])
    assign(rates[0, : len(v0)], v0)
    assign(work.stage_reactions[0], work.stage_reactions[last])
