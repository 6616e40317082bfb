"""One step of the Radau IIA method of order 9, for drives and damping of joints that are stiff.

A drive of damping d on a joint of little inertia settles at a rate N d, where N = ∂v̇/∂τ is what forces of the
drives do to v̇ with all that is closed; an explicit step is stable up to about five of these times. Here
Newton's method takes the laws of the drives as they are, ∂v̇/∂v = −N d and ∂v̇/∂q = −N k with the N at the
start, and iterates the rest along. Viscous damping of a joint is a law of the same kind, with k = 0. See
`step_radau` for the method.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.ahead import FLOAT_ROWS, INTEGERS, ahead
from ..._numeric.elimination import RANK, solve
from ..._numeric.jit import inner, jit, separate
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, nonzero
from ..._numeric.lu import factorize, substitute
from .contact_forces import SINGULAR_STILL
from .dop853 import STAGES as LAST
from .dynamics import evaluate, invert_mass_matrix, set_state
from .lie_charts import advance, chart_rate, gone_astray, magnitudes, turned_too_far
from .samples import record_sample
from .step_radau import ABSCISSAE, AT_START, GAMMA, MATRIX, STAGES, advance_to, complete
from .workspace import SceneWorkspace

STIFF = 4.0
"""Steps longer than this, times the rate at which the drives settle, are implicit."""

ITERATIONS = 10

SQUARE = MATRIX @ MATRIX


@inner
def following(work):
    """Return the velocities on which a linear law acts: drives within their efforts, and damping."""
    side, stiffness, drive_damping, damping = (
        work.drive_side,
        work.drive_stiffness,
        work.drive_damping,
        work.damping,
    )
    held = work.modes[work.contacts + work.limits :]
    marks = np.zeros(len(held), dtype=np.int64)
    for j in range(len(held)):
        follows = side[j] == 0 and (stiffness[j] > 0.0 or drive_damping[j] > 0.0)
        marks[j] = (follows or damping[j] > 0.0) and held[j] == 0
    return nonzero(marks)


@inner
def law(work, j):
    """Return stiffness and damping of the linear law of a velocity."""
    if work.drive_side[j] != 0:
        return 0.0, work.damping[j]
    return work.drive_stiffness[j], work.drive_damping[j] + work.damping[j]


@ahead(SceneWorkspace, INTEGERS, FLOAT_ROWS)
@separate
def respond(work, driven, response):
    """Fill (k, nv) what a unit of each drive's force does to v̇ at the state last evaluated, with its M⁻¹."""
    rows, effect, minverse = work.equation_rows, work.force_response, work.minverse
    n, size = len(minverse), len(rows)
    target, reaction, no_basis = np.empty(size), np.empty(size), np.empty((0, size))
    for c in range(len(driven)):
        assign(response[c], minverse[driven[c]])
        if size == 0:
            continue
        for m in range(size):
            total = 0.0
            for j in range(n):
                total -= rows[m, j] * response[c, j]
            target[m] = total
        if solve(work.system, target, reaction, RANK) == 0:
            least_norm(work.system, target, SINGULAR_STILL, reaction, no_basis)
        for m in range(size):
            for j in range(n):
                response[c, j] += reaction[m] * effect[m, j]


@ahead(SceneWorkspace)
@separate
def rate_of_drives(work):
    """Return how fast the drives settle at the most, about [1/s], at the state last evaluated."""
    if not work.stiff_joints:
        return 0.0
    driven = following(work)
    if len(driven) == 0:
        return 0.0
    if work.closed_contacts + work.closed_scalars == 0 and not invert_mass_matrix(work):
        return 0.0
    response = np.empty((len(driven), len(work.v)))
    respond(work, driven, response)
    fastest = 0.0
    for j in driven:
        total = 0.0
        for c in range(len(driven)):
            total += abs(response[c, j]) * law(work, driven[c])[1]
        fastest = max(fastest, total)
    return fastest


@jit
def attempt(work, t, h, rtol, atol):
    """Compute a step of length h; return its error over the tolerance, infinite if it is not found."""
    work.step_turns = False
    error = solve_stages(work, t, h, rtol, atol)
    if error <= 1.0 and not work.callback_failed:
        n = len(work.v1)
        set_state(work, work.q1, work.v1)
        evaluate(work, t + h, work.stage_rates[LAST, n:])
        for m in range(n):
            work.stage_reactions[LAST, m] = work.stage_rates[LAST, n + m] - work.acceleration[m]
        work.samples = 1 + STAGES
        complete(work, h)
    return error


@inner
def solve_stages(work, t, h, rtol, atol):
    """Iterate for the rates at the stages; return the error."""
    joints, q0, v0, rates, xi = work.joint_charts, work.q0, work.v0, work.stage_rates, work.xi
    q, v, sizes = work.q, work.v, work.tolerance_sizes
    n, width, s = len(v0), rates.shape[1], STAGES
    driven = following(work)
    k = len(driven)
    response, stiffness, damping = np.empty((k, n)), np.empty(k), np.empty(k)
    found, scale = np.empty((s, width)), np.empty(2 * n)
    set_state(work, q0, v0)
    evaluate(work, t, found[0, n:])
    if work.callback_failed:
        return math.inf
    if work.closed_contacts + work.closed_scalars == 0 and not invert_mass_matrix(work):
        return math.inf
    respond(work, driven, response)
    for c in range(k):
        stiffness[c], damping[c] = law(work, driven[c])
    matrix, order, right = np.empty((s * k, s * k)), np.empty(s * k, dtype=np.int64), np.empty(s * k)
    for i in range(s):
        for c in range(k):
            for j in range(s):
                for d in range(k):
                    effect = h * MATRIX[i, j] * damping[d] + h * h * SQUARE[i, j] * stiffness[d]
                    matrix[i * k + c, j * k + d] = effect * response[d, driven[c]]
            matrix[i * k + c, i * k + c] += 1.0
    if not factorize(matrix, order):
        return math.inf
    magnitudes(joints, q0, sizes)
    for m in range(n):
        scale[m] = 1.0 / (atol + rtol * sizes[m])
        scale[n + m] = 1.0 / (atol + rtol * abs(v0[m]))
    for i in range(s):
        assign(rates[1 + i], rates[0])
    force = np.empty((s, k))
    before = math.inf
    for iteration in range(ITERATIONS):
        for i in range(s):
            advance_to(i, h, rates, v0, xi, v)
            if gone_astray(xi, v) or turned_too_far(joints, xi):
                return math.inf
            advance(joints, q0, xi, q)
            chart_rate(joints, xi, v, found[i, :n])
            for m in range(2 * n, width):
                found[i, m] = 0.0
            evaluate(work, t + ABSCISSAE[i] * h, found[i, n:])
            if work.callback_failed:
                return math.inf
            record_sample(work, i + 1, ABSCISSAE[i])
            for m in range(width):
                found[i, m] -= rates[1 + i, m]
        # the change of the drives' forces that the change of the rates brings, first by what ξ̇ lacks
        for i in range(s):
            for c in range(k):
                force[i, c] = 0.0
                for j in range(s):
                    force[i, c] -= stiffness[c] * h * MATRIX[i, j] * found[j, driven[c]]
        for i in range(s):
            for c in range(k):
                right[i * k + c] = found[i, n + driven[c]]
                for d in range(k):
                    right[i * k + c] += response[d, driven[c]] * force[i, d]
        substitute(matrix, order, right)
        for i in range(s):
            for c in range(k):
                for j in range(s):
                    effect = h * MATRIX[i, j] * damping[c] + h * h * SQUARE[i, j] * stiffness[c]
                    force[i, c] -= effect * right[j * k + c]
        norm = 0.0
        for i in range(s):
            for c in range(k):
                for m in range(n):
                    found[i, n + m] += response[c, m] * force[i, c]
                for j in range(s):
                    found[i, driven[c]] += h * MATRIX[i, j] * right[j * k + c]
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
    error = np.empty(2 * n)
    for m in range(2 * n):
        total = rates[0, m]
        for j in range(s):
            total -= AT_START[j] * rates[1 + j, m]
        error[m] = GAMMA * h * total
    filtered(h, driven, response, stiffness, damping, error)
    norm = 0.0
    for m in range(2 * n):
        norm += (error[m] * scale[m]) ** 2
    norm = math.sqrt(norm / (2 * n))
    advance_to(s - 1, h, rates, v0, xi, work.v1)
    advance(joints, q0, xi, work.q1)
    return norm ** (8.0 / (s + 1)) if norm == norm else math.inf


@inner
def filtered(h, driven, response, stiffness, damping, error):
    """Divide an error of ξ and v by 1 − γ h times the derivative of the rates, for the laws of the drives."""
    k, n = len(driven), response.shape[1]
    step = GAMMA * h
    matrix, order, right = np.empty((k, k)), np.empty(k, dtype=np.int64), np.empty(k)
    for c in range(k):
        right[c] = error[n + driven[c]]
        for d in range(k):
            right[c] -= step * response[d, driven[c]] * stiffness[d] * error[driven[d]]
            matrix[c, d] = step * response[d, driven[c]] * (damping[d] + step * stiffness[d])
        matrix[c, c] += 1.0
    if not factorize(matrix, order):
        return
    substitute(matrix, order, right)
    for c in range(k):
        force = stiffness[c] * error[driven[c]] + (damping[c] + step * stiffness[c]) * right[c]
        for m in range(n):
            error[n + m] -= step * response[c, m] * force
    for c in range(k):
        error[driven[c]] += step * error[n + driven[c]]
