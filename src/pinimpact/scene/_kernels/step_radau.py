"""One step of the Radau IIA method of order 9, for slip whose direction settles fast.

Friction follows the direction of slip, and at a small speed s that direction turns at a rate of about
wᵀu/s: w picks the velocity across the slip, and u = ∂v̇/∂θ is what a turn of the friction does. Where h wᵀu/s
is large an explicit step is unstable. Here the angles θ of friction at the stages are unknowns of their own,
with the condition that there is no velocity across them; that stays regular down to s = 0. Newton's method
then needs no more than a system with one unknown per contact and stage, and the rest is iterated along.

Source of the method: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd edition, sections
IV.5 and IV.8. Its coefficients are made here from their definition.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ..._numeric.elimination import RANK, solve
from ..._numeric.jit import inner, jit
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, nonzero
from ..._numeric.products import apply
from .contact_forces import SLIP
from .dense_output import rate_bounds
from .dop853 import STAGES as LAST
from .dynamics import evaluate, set_state
from .lie_charts import advance, chart_rate, gone_astray, magnitudes, turned_too_far
from .samples import record_sample
from .slip import restore_directions

STAGES = 5
ITERATIONS = 12
STIFF = 3.0
"""Explicit steps are stable up to about twice this h wᵀu/s."""


def _coefficients():
    """Return nodes, matrix, weights of the rates at 0, dense output, its start, and the error's factor."""
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
    # θ, θ(1 − θ), θ²(1 − θ), … as powers of θ, see `dense_output.interpolate`
    size = s + 2
    basis: NDArray[np.float64] = np.zeros((size, size))
    factor = Polynomial([0.0, 1.0])
    for k in range(size):
        basis[k, : k + 1] = factor.coef[1:]
        factor = factor * (Polynomial([1.0, -1.0]) if k % 2 == 0 else Polynomial([0.0, 1.0]))
    dense = np.linalg.solve(basis.T, np.pad(integrals, ((0, 2), (0, 0))))
    # vanishes at the nodes, with slope 1 at 0 and 0 at 1: lets the dense output start at the rate there
    correction = Polynomial([0.0, 1.0]) * Polynomial([1.0, -1.0])
    for node in nodes:
        correction = correction * Polynomial([1.0, -1.0 / node])
    start = np.linalg.solve(basis.T, np.array(correction.coef[1:], dtype=float))
    eigenvalues = np.linalg.eigvals(np.linalg.inv(matrix))
    real = eigenvalues[np.argmin(np.abs(eigenvalues.imag))].real
    return nodes, matrix, lagrange[0].copy(), dense, start, 1.0 / real


ABSCISSAE, MATRIX, AT_START, DENSE, START, GAMMA = _coefficients()


@inner
def turn(work, k, s1, s2, across, effect):
    """Fill w and u of a contact that slips towards (s1, s2), at the state last evaluated."""
    mode, mu, jacobian = work.closed_mode, work.closed_friction, work.contact_jacobian
    equations, response, solution = work.equation_rows, work.force_response, work.solution
    n, size = len(across), len(solution)
    row = 0
    for i in range(k):
        row += 1 if mode[i] == SLIP else 3
    force = mu[k] * solution[row]
    pushed, change, reaction = np.empty(n), np.empty(size), np.empty(size)
    for j in range(n):
        across[j] = s1 * jacobian[k, 1, j] - s2 * jacobian[k, 0, j]
        pushed[j] = -force * across[j]
    apply(work.minverse, pushed, effect)
    for m in range(size):
        total = 0.0
        for j in range(n):
            total -= equations[m, j] * effect[j]
        change[m] = total
    if solve(work.system, change, reaction, RANK) != 0:
        for m in range(size):
            for j in range(n):
                effect[j] += response[m, j] * reaction[m]


@jit
def attempt(work, t, h, rtol, atol):
    """Compute a step of length h; return its error over the tolerance, infinite if it is not found."""
    slowest = work.direction_speed
    work.step_turns = True
    work.direction_speed = math.inf  # so that friction takes the direction that it is given
    error = solve_stages(work, t, h, rtol, atol)
    work.direction_speed = slowest
    if not error <= 1.0 or work.callback_failed:
        restore_directions(work)
    else:  # where slip is slow, friction goes on in the direction that was found
        set_state(work, work.q1, work.v1)
        evaluate(work, t + h, work.stage_rates[LAST, len(work.v1) :])
        for m in range(len(work.v1)):
            work.stage_reactions[LAST, m] = work.stage_rates[LAST, len(work.v1) + m] - work.acceleration[m]
        work.samples = 1 + STAGES
        complete(work, h)
    return error


@inner
def solve_stages(work, t, h, rtol, atol):
    """Iterate for the rates at the stages and the directions of friction there; return the error."""
    joints, q0, v0, v1 = work.joint_charts, work.q0, work.v0, work.v1
    rates, xi, sizes = work.stage_rates, work.xi, work.tolerance_sizes
    q, v = work.q, work.v
    mode, mu, reference, velocity = (
        work.closed_mode,
        work.closed_friction,
        work.slip_reference,
        work.contact_velocity,
    )
    n, width, s = len(v0), rates.shape[1], STAGES
    rubbing = np.zeros(len(mode), dtype=np.int64)
    for k in range(len(mode)):
        rubbing[k] = mode[k] == SLIP and mu[k] > 0.0
    slips = nonzero(rubbing)
    count = len(slips)
    size = s * count
    directions = np.empty((s, count, 2))
    across, effect = np.zeros((s, count, n)), np.zeros((s, count, n))
    speeds = np.zeros((s, count))
    matrix, right, angle = np.empty((size, size)), np.empty(size), np.empty(size)
    found = np.empty((s, width))
    scale = np.empty(2 * n)
    magnitudes(joints, q0, sizes)
    for m in range(n):
        scale[m] = 1.0 / (atol + rtol * sizes[m])
        scale[n + m] = 1.0 / (atol + rtol * abs(v0[m]))
    for i in range(s):
        assign(rates[1 + i], rates[0])
        for c in range(count):
            assign(directions[i, c], reference[slips[c]])
    before, no_basis = math.inf, np.empty((0, size))
    for iteration in range(ITERATIONS):
        for i in range(s):
            advance_to(i, h, rates, v0, xi, v)
            if gone_astray(xi, v) or turned_too_far(joints, xi):
                return math.inf
            advance(joints, q0, xi, q)
            chart_rate(joints, xi, v, found[i, :n])
            for m in range(2 * n, width):
                found[i, m] = 0.0
            for c in range(count):
                assign(reference[slips[c]], directions[i, c])
            evaluate(work, t + ABSCISSAE[i] * h, found[i, n:])
            if work.callback_failed:
                return math.inf
            record_sample(work, i + 1, ABSCISSAE[i])
            for m in range(width):
                found[i, m] -= rates[1 + i, m]
            for c in range(count):
                k, s1, s2 = slips[c], directions[i, c, 0], directions[i, c, 1]
                turn(work, k, s1, s2, across[i, c], effect[i, c])
                speeds[i, c] = s1 * velocity[k, 0] + s2 * velocity[k, 1]
                right[i * count + c] = s2 * velocity[k, 0] - s1 * velocity[k, 1]
        for i in range(s):
            for c in range(count):
                row = i * count + c
                for j in range(s):
                    for m in range(n):
                        right[row] -= h * MATRIX[i, j] * across[i, c, m] * found[j, n + m]
                    for d in range(count):
                        total = 0.0
                        for m in range(n):
                            total += across[i, c, m] * effect[j, d, m]
                        matrix[row, j * count + d] = h * MATRIX[i, j] * total
                matrix[row, row] -= speeds[i, c]
        # contacts that share their loads turn together where slip begins, and one of them cannot alone
        if solve(matrix, right, angle, RANK) == 0:
            if work.forces_unique:
                return math.inf
            least_norm(matrix, right, RANK, angle, no_basis)
        norm = 0.0
        for i in range(s):
            for c in range(count):
                change = angle[i * count + c]
                for m in range(n):
                    found[i, n + m] += effect[i, c, m] * change
                x, y = math.cos(change), math.sin(change)
                s1, s2 = directions[i, c, 0], directions[i, c, 1]
                directions[i, c, 0], directions[i, c, 1] = x * s1 - y * s2, y * s1 + x * s2
            for m in range(width):
                rates[1 + i, m] += found[i, m]
            for m in range(2 * n):
                norm += (h * found[i, m] * scale[m]) ** 2
        norm = math.sqrt(norm / (2 * n * s))
        ratio = norm / before if iteration > 0 else 0.5
        if not norm < math.inf or (iteration > 2 and ratio >= 1.0):
            return math.inf
        if norm == 0.0 or (ratio < 1.0 and norm * ratio / (1.0 - ratio) <= 1e-2):
            break
        before = norm
    else:
        return math.inf
    # the error: what the rates' polynomial says of the start, against the rates there
    error = np.empty(2 * n)
    for m in range(2 * n):
        total = rates[0, m]
        for j in range(s):
            total -= AT_START[j] * rates[1 + j, m]
        error[m] = GAMMA * h * total
    filtered(h, across[0], effect[0], speeds[0], error[n:])
    norm = 0.0
    for m in range(2 * n):
        norm += (error[m] * scale[m]) ** 2
    norm = math.sqrt(norm / (2 * n))
    advance_to(s - 1, h, rates, v0, xi, v1)
    advance(joints, q0, xi, work.q1)
    for c in range(count):
        assign(reference[slips[c]], directions[s - 1, c])
        assign(work.end_directions[slips[c]], directions[s - 1, c])
    return norm ** (8.0 / (s + 1)) if norm == norm else math.inf


@inner
def advance_to(i, h, rates, v0, xi, v):
    """Fill chart coordinates and velocity at a stage, from the rates at all."""
    n = len(v0)
    for m in range(n):
        a = b = 0.0
        for j in range(STAGES):
            a += MATRIX[i, j] * rates[1 + j, m]
            b += MATRIX[i, j] * rates[1 + j, n + m]
        xi[m] = h * a
        v[m] = v0[m] + h * b


@inner
def filtered(h, across, effect, speeds, error):
    """Divide an error of v by 1 − γ h ∂v̇/∂v, which takes the stiff part out of it."""
    count, n = across.shape
    matrix, right, turned = np.empty((count, count)), np.empty(count), np.empty(count)
    for c in range(count):
        right[c] = 0.0
        for m in range(n):
            right[c] += across[c, m] * error[m]
        for d in range(count):
            total = 0.0
            for m in range(n):
                total += across[c, m] * effect[d, m]
            matrix[c, d] = -GAMMA * h * total
        matrix[c, c] += speeds[c]
    if solve(matrix, right, turned, RANK) != 0:
        for c in range(count):
            for m in range(n):
                error[m] += GAMMA * h * effect[c, m] * turned[c]


@inner
def complete(work, h):
    """Fill the dense output of the step last attempted, and the bounds of its rates."""
    rates, coefficients = work.stage_rates, work.dense_coefficients
    n = len(work.v0)
    rate_bounds(rates, 1 + STAGES, n, work.rate_bounds)
    for m in range(rates.shape[1]):
        late = rates[0, m] if m < n else 0.0  # of the configuration: its rate at the start is certain
        for j in range(STAGES):
            late -= AT_START[j] * rates[1 + j, m] if m < n else 0.0
        for k in range(7):
            total = late * START[k]
            for j in range(STAGES):
                total += DENSE[k, j] * rates[1 + j, m]
            coefficients[k, m] = h * total
