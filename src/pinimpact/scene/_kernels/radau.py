"""The Radau IIA method of order 9: coefficients, fixed-point iteration, error estimate, dense output.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd edition, sections IV.5 and IV.8.
The coefficients are computed from their definition.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial

from ..._compile.jit import inlined
from ..._numeric.loops import assign, filled
from ..._numeric.products import add, dot
from .dense_output import BASIS, rate_bounds
from .dop853 import STAGES as LAST
from .dynamics import evaluate, set_state
from .lie_charts import advance, chart_rate, diverged, magnitudes, turned_too_far
from .samples import record_sample
from .tolerances import ITERATED
from .trees import end_of_tree

STAGES = 5

SLOW = 0.5
"""h wᵀu/s, and h times the rate of the drives, up to which an implicit step only iterates these terms."""


def _coefficients():
    """Return the coefficients of the method, see below."""
    s = STAGES
    p = Polynomial([0.0] * (s - 1) + [1.0]) * Polynomial([-1.0, 1.0]) ** s
    p = p.deriv(s - 1)
    nodes = np.sort(p.roots().real)
    for _ in range(3):
        nodes = nodes - p(nodes) / p.deriv()(nodes)
    nodes[-1] = 1.0
    powers = np.arange(s)
    lagrange = np.linalg.inv(nodes[:, None] ** powers)  # column j: the polynomial that is 1 at node j
    integrals = lagrange / (powers + 1.0)[:, None]  # times θ^(k + 1)
    matrix = nodes[:, None] ** (powers + 1.0) @ integrals
    dense = np.linalg.solve(BASIS.T, np.pad(integrals, ((0, 2), (0, 0))))
    # a polynomial that vanishes at the nodes, with slopes 1 at 0 and 0 at 1, corrects the initial rate of the
    # dense output
    correction = Polynomial([0.0, 1.0]) * Polynomial([1.0, -1.0])
    for node in nodes:
        correction = correction * Polynomial([1.0, -1.0 / node])
    start = np.linalg.solve(BASIS.T, np.array(correction.coef[1:], dtype=float))
    eigenvalues = np.linalg.eigvals(np.linalg.inv(matrix))
    real = eigenvalues[np.argmin(np.abs(eigenvalues.imag))].real
    return nodes, matrix, lagrange[0].copy(), dense, start, 1.0 / real


ABSCISSAE, MATRIX, AT_START, DENSE, START, GAMMA = _coefficients()
"""Nodes; Runge-Kutta matrix; weights of the rate at 0 of the interpolating polynomial; dense output by the
stage rates and by the correction of the rate at 0; factor γ of the error."""


@inlined
def start_rates(work, rtol, atol, scale):
    """Initialize the stage rates with those at the start; fill scale (2 nv,) with 1/tolerance of ξ and v."""
    rates, v0, sizes = work.stage_rates, work.v0, work.tolerance_sizes
    n = len(v0)
    magnitudes(work.joint_charts, work.q0, sizes)
    for m in range(n):
        scale[m] = 1.0 / (atol + rtol * sizes[m])
        scale[n + m] = 1.0 / (atol + rtol * abs(v0[m]))
    for i in range(STAGES):
        assign(rates[1 + i], rates[0])


@inlined
def advance_to(work, i, h, v):
    """Fill ξ in the workspace and v (nv,) at stage i, from the rates at all stages."""
    rates, v0, xi = work.stage_rates, work.v0, work.xi
    n = len(v0)
    for m in range(n):
        a = b = 0.0  # independent sums, which is faster
        for j in range(STAGES):
            a += MATRIX[i, j] * rates[1 + j, m]
            b += MATRIX[i, j] * rates[1 + j, n + m]
        xi[m] = h * a
        v[m] = v0[m] + h * b


@inlined
def evaluate_stage(work, i, t, h, change):
    """Evaluate at stage i, fill the residual of its rates; return False outside the chart or on failure."""
    rates, xi, v = work.stage_rates, work.xi, work.v
    n, width = len(v), rates.shape[1]
    advance_to(work, i, h, v)
    if diverged(xi, v) or turned_too_far(work.joint_charts, xi):
        return False
    advance(work.joint_charts, work.q0, xi, work.q)
    chart_rate(work.joint_charts, xi, v, change[:n])
    filled(change[2 * n : width], 0.0)
    evaluate(work, t + ABSCISSAE[i] * h, change[n:])
    if work.callback_failed:
        return False
    record_sample(work, i + 1, ABSCISSAE[i])
    add(change, -1.0, rates[1 + i])
    return True


@inlined
def change_rates(rates, changes, h, scale):
    """Add changes to the stage rates; return their size relative to the tolerance, root mean square."""
    size = 0.0
    for i in range(STAGES):
        add(rates[1 + i], 1.0, changes[i])
        for m in range(len(scale)):
            size += (h * changes[i, m] * scale[m]) ** 2
    return math.sqrt(size / (len(scale) * STAGES))


@inlined
def start_error(rates, h, error):
    """Fill error (2 nv,) with γ h times the rate at the start minus that of the interpolating polynomial."""
    for m in range(len(error)):
        error[m] = GAMMA * h * (rates[0, m] - dot(AT_START, rates[1:, m]))


@inlined
def reach_end(work, h, error, scale):
    """Fill the state at the end of the step; return the largest error of a tree relative to the tolerance."""
    advance_to(work, STAGES - 1, h, work.v1)
    advance(work.joint_charts, work.q0, work.xi, work.q1)
    n, first, largest = len(work.v1), 0, 0.0
    while first < n:
        stop, own = end_of_tree(work.velocity_parent, first), 0.0
        for m in range(first, stop):
            own += (error[m] * scale[m]) ** 2 + (error[n + m] * scale[n + m]) ** 2
        own = math.sqrt(own / (2 * (stop - first)))
        if not own < math.inf:
            return math.inf
        largest, first = max(largest, own), stop
    return largest ** (8.0 / (STAGES + 1))


def iterate(correct, finish, most):
    """Return the kernel that iterates for the stage rates of a step.

    Args:
        correct: correct(work, t, h, known, changes) fills the next changes of the stage rates, and returns
            whether it succeeded.
        finish: finish(work, h, known, error) filters the error (2 nv,) by the stiff derivatives.
        most: Largest number of iterations.
    """

    @inlined
    def iterations(work, t, h, rtol, atol, known):
        """Return the error relative to the tolerance; infinite if the iteration does not converge."""
        rates, n = work.stage_rates, len(work.v0)
        changes, scale, error = np.empty((STAGES, rates.shape[1])), np.empty(2 * n), np.empty(2 * n)
        start_rates(work, rtol, atol, scale)
        size = math.inf
        for iteration in range(most):
            if not correct(work, t, h, known, changes):
                return math.inf
            before, size = size, change_rates(rates, changes, h, scale)
            ratio = size / before if iteration > 0 else 0.5
            if not size < math.inf or (iteration > 2 and ratio >= 1.0):
                return math.inf
            if size == 0.0 or (ratio < 1.0 and size * ratio / (1.0 - ratio) <= ITERATED):
                start_error(rates, h, error)
                finish(work, h, known, error)
                return reach_end(work, h, error, scale)
        return math.inf

    return iterations


@inlined
def complete(work, t, h):
    """Evaluate at the end of the last attempted step; fill its dense output and the bounds of its rates."""
    n = len(work.v1)
    set_state(work, work.q1, work.v1)
    evaluate(work, t + h, work.stage_rates[LAST, n:])
    for m in range(n):
        work.stage_reactions[LAST, m] = work.stage_rates[LAST, n + m] - work.acceleration[m]
    work.samples = 1 + STAGES
    rates, coefficients = work.stage_rates, work.dense_coefficients
    rate_bounds(rates, 1 + STAGES, n, work.rate_bounds)
    for m in range(rates.shape[1]):
        # corrected for ξ only, whose initial rate is exact
        late = rates[0, m] - dot(AT_START, rates[1:, m]) if m < n else 0.0
        for k in range(7):
            coefficients[k, m] = h * (late * START[k] + dot(DENSE[k], rates[1:, m]))
