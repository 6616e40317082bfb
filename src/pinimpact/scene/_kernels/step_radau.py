"""A step of the Radau IIA method of order 9, for slip whose direction settles fast, and for stiff drives.

Friction is opposite to the slip, and at a small speed s the direction of slip settles at a rate of about
wᵀu/s, where wᵀv is the velocity across the slip and u = ∂v̇/∂θ the effect of turning the friction by an angle
θ. If h wᵀu/s is large an explicit step is unstable. Here the angles θ at the stages are additional unknowns,
with the equations wᵀv = 0, which are regular down to s = 0. Newton's method treats only these angles (one
unknown per contact and stage) and the laws of stiff drives implicitly; the remaining terms are iterated. See
`radau` for the method, `stiff_drives` for the drives.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import inlined, jit
from ..._numeric.elimination import RANK, solve
from ..._numeric.loops import assign, largest, nonzero
from ..._numeric.products import add, apply_symmetric, dot
from .contact_forces import SLIP, add_reactions
from .radau import GAMMA, MATRIX, SLOW, STAGES, complete, evaluate_stage, iterate
from .slip import restore_directions
from .stiff_drives import add_response, driven_at, filter_error
from .workspace import SceneWorkspace

ITERATIONS = 12
"""Largest number of iterations of a step."""

STIFF = 3.0
"""h wᵀu/s above which steps are implicit: explicit ones are stable up to about twice this value."""


@inlined
def fill_turn_effect(work, k, s1, s2, across, effect):
    """Fill w, across (nv,), and u, effect (nv,), of active contact k that slips along (s1, s2).

    They are those of the state last evaluated.
    """
    mode, mu, jacobian = work.active_mode, work.active_friction, work.contact_jacobian
    n, row = len(across), 0
    for i in range(k):
        row += 1 if mode[i] == SLIP else 3
    force, found = mu[k] * work.solution[row], np.zeros((1, n))
    for j in range(n):
        across[j] = s1 * jacobian[k, 1, j] - s2 * jacobian[k, 0, j]
    apply_symmetric(work.minverse, across, effect)
    add(found[0], -force, effect)
    add_reactions(work, found)
    assign(effect, found[0])


class Turning(NamedTuple):
    """Data of the iteration for the c contacts that slip against friction.

    Attributes:
        slips: (c,) positions among the active contacts.
        directions: (stages, c, 2) directions opposite to friction.
        across: (stages, c, nv) rows w.
        effect: (stages, c, nv) u = ∂v̇/∂θ.
        answer: (stages, c, stages, 2 nv) derivatives of all stage rates with respect to θ: u, and the
            response of the drives to it.
        speeds: (stages, c) speeds along the directions [m/s].
    """

    slips: Any
    directions: Any
    across: Any
    effect: Any
    answer: Any
    speeds: Any


@inlined
def turning(work, stiff):
    """Return the initial `Turning` of the iteration; it has no contacts unless `stiff`."""
    mode, mu, reference, n, s = work.active_mode, work.active_friction, work.slip_reference, work.nv, STAGES
    rubbing = np.zeros(len(mode), dtype=np.int64)
    for k in range(len(mode)):
        rubbing[k] = stiff and mode[k] == SLIP and mu[k] > 0.0
    slips = nonzero(rubbing)
    count = len(slips)
    directions = np.empty((s, count, 2))
    for i in range(s):
        for c in range(count):
            assign(directions[i, c], reference[slips[c]])
    across, effect, answer = np.zeros((s, count, n)), np.zeros((s, count, n)), np.zeros((s, count, s, 2 * n))
    return Turning(slips, directions, across, effect, answer, np.zeros((s, count)))


@inlined
def correct(work, t, h, known, changes):
    """Fill the next changes of the stage rates, turn the directions of friction; return False on failure."""
    driven, (slips, directions, across, effect, answer, speeds) = known
    reference, velocity = work.slip_reference, work.contact_velocity
    s, count, n, drives = speeds.shape[0], speeds.shape[1], across.shape[2], len(driven.index) > 0
    size = s * count
    matrix, right, angle = np.empty((size, size)), np.empty(size), np.empty(size)
    for i in range(s):
        for c in range(count):
            assign(reference[slips[c]], directions[i, c])
        if not evaluate_stage(work, i, t, h, changes[i]):
            return False
        for c in range(count):
            k, s1, s2 = slips[c], directions[i, c, 0], directions[i, c, 1]
            fill_turn_effect(work, k, s1, s2, across[i, c], effect[i, c])
            answer[i, c] = 0.0
            assign(answer[i, c, i, n:], effect[i, c])
            if drives:
                add_response(h, driven, answer[i, c])
            speeds[i, c] = s1 * velocity[k, 0] + s2 * velocity[k, 1]
            right[i * count + c] = s2 * velocity[k, 0] - s1 * velocity[k, 1]
    if drives:
        add_response(h, driven, changes)
    if count == 0:
        return True
    for i in range(s):
        for c in range(count):
            row = i * count + c
            matrix[row] = 0.0
            for j in range(s):
                right[row] -= h * MATRIX[i, j] * dot(across[i, c], changes[j, n:])
                for d in range(count):
                    for o in range(s):
                        if not drives and o != j:
                            continue
                        total = dot(across[i, c], answer[j, d, o, n:])
                        matrix[row, j * count + d] += h * MATRIX[i, o] * total
            matrix[row, row] -= speeds[i, c]
    equilibrate(matrix, right)
    if solve(matrix, right, angle, RANK) == 0:
        return False
    for i in range(s):
        for c in range(count):
            change = angle[i * count + c]
            for o in range(s):
                add(changes[o, : 2 * n], change, answer[i, c, o])
            x, y = math.cos(change), math.sin(change)
            s1, s2 = directions[i, c, 0], directions[i, c, 1]
            directions[i, c, 0], directions[i, c, 1] = x * s1 - y * s2, y * s1 + x * s2
    return True


@inlined
def equilibrate(matrix, right):
    """Divide each equation by its largest coefficient, since speeds may differ by orders of magnitude."""
    for a in range(len(right)):
        size = largest(matrix[a])
        if size > 0.0:
            for b in range(len(right)):
                matrix[a, b] /= size
            right[a] /= size


@inlined
def finish(work, h, known, error):
    """Divide the error (2 nv,) of ξ and v by 1 − γ h times the stiff derivatives; store the directions."""
    driven, (slips, directions, across, effect, _, speeds) = known
    count, n = across.shape[1], across.shape[2]
    matrix, right, turned = np.empty((count, count)), np.empty(count), np.empty(count)
    relieved = np.zeros((count, 2 * n))
    filter_error(h, driven, error)
    for c in range(count):
        assign(relieved[c, n:], effect[0, c])
        filter_error(h, driven, relieved[c])
    for c in range(count):
        right[c] = dot(across[0, c], error[n:])
        for d in range(count):
            matrix[c, d] = -GAMMA * h * dot(across[0, c], relieved[d, n:])
        matrix[c, c] += speeds[0, c]
    equilibrate(matrix, right)
    if count > 0 and solve(matrix, right, turned, RANK) != 0:
        for c in range(count):
            add(error, GAMMA * h * turned[c], relieved[c])
    for c in range(count):
        assign(work.slip_reference[slips[c]], directions[len(directions) - 1, c])
        assign(work.end_directions[slips[c]], directions[len(directions) - 1, c])


iterations = iterate(correct, finish, ITERATIONS)


@declared(SceneWorkspace, float, float, float, float)
@jit
def attempt(work, t, h, rtol, atol):
    """Compute a step of length h [s] from t [s]; return its error relative to the tolerance.

    The error is infinite if the iteration does not converge.
    """
    slowest, turns = work.direction_speed, h * work.slip_stiffness > SLOW
    work.step_turns = turns
    if turns:
        work.direction_speed = math.inf  # friction is then opposite to `slip_reference` at any speed
    driven, found = driven_at(work, t, h)
    error = iterations(work, t, h, rtol, atol, (driven, turning(work, turns))) if found else math.inf
    work.direction_speed = slowest
    if error <= 1.0 and not work.callback_failed:
        complete(work, t, h)
    elif turns:
        restore_directions(work)
    return error
