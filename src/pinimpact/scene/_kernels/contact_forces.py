"""Forces of what is closed, in given modes, by a linear system.

Contacts have three rows (t₁, t₂, n) each. Scalar rows are a joint at its limit (force within [0, ∞)) or a
joint held by its dry friction (force within ±τ).
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external, inlined
from ..._numeric.elimination import RANK, solve
from ..._numeric.least_norm import least_norm, least_norms
from ..._numeric.loops import assign, flags
from ..._numeric.products import apply_symmetric, dot, products
from ..._numeric.tolerances import ROUNDOFF
from .tolerances import FINEST, LEAST_SIZE, NEGLIGIBLE, SINGULAR_STILL
from .workspace import SceneWorkspace

FREE, SLIP, STICK, HELD = range(4)
"""Modes of a contact: open, sliding, at rest against its surface, held by the scene."""


@inlined
def slip_direction(velocity, reference, slowest):
    """Return the direction of slip, signed to agree with `reference`: smooth where the slip reverses."""
    s = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    if s <= slowest:
        return reference[0], reference[1]
    if velocity[0] * reference[0] + velocity[1] * reference[1] < 0.0:
        s = -s
    return velocity[0] / s, velocity[1] / s


@inlined
def joint_forces(work, powers):
    """Fill τ = control − damping q̇ − dry friction, and the powers of the control and in the joints."""
    velocity, control, tau = work.v, work.control_force, work.tau
    damping, friction = work.damping, work.sliding_friction
    given = taken = 0.0
    for j in range(len(velocity)):
        lost = damping[j] * velocity[j] + friction[j]
        tau[j] = control[j] - lost
        given += control[j] * velocity[j]
        taken -= lost * velocity[j]
    powers[0], powers[1] = given, taken


@inlined
def set_up_equations(work, acceleration):
    """Set up the equations of what is closed: `equation_rows`, `force_response`, `system`, `target`.

    The workspace has M⁻¹ and the motion of the closed contacts without contact forces, for v̇ (nv,). Returned
    is the least effective inverse inertia of a slipping contact over that without friction (at most zero:
    Painlevé's paradox).
    """
    minverse, jacobian, free = work.minverse, work.contact_jacobian, work.contact_acceleration
    mode, mu, directions = work.active_mode, work.active_friction, work.slip_direction
    rows, response, system, target = work.equation_rows, work.force_response, work.system, work.target
    index = work.scalar_velocity
    n, size = len(acceleration), len(rows)
    column, alone = np.empty(n), np.empty(n)
    least = 1.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            s1, s2 = slip_direction(work.contact_velocity[i], work.slip_reference[i], work.direction_speed)
            directions[i, 0], directions[i, 1] = s1, s2
            plain = effective = 0.0
            for j in range(n):
                rows[m, j] = jacobian[i, 2, j]
                column[j] = rows[m, j] - mu[i] * (s1 * jacobian[i, 0, j] + s2 * jacobian[i, 1, j])
            apply_symmetric(minverse, rows[m], alone)
            apply_symmetric(minverse, column, response[m])
            for j in range(n):
                effective += rows[m, j] * response[m, j]
                plain += rows[m, j] * alone[j]
            if plain > 0.0:
                least = min(least, effective / plain)
            target[m] = -free[i, 2]
            m += 1
        else:
            for d in range(3):
                assign(rows[m], jacobian[i, d])
                apply_symmetric(minverse, rows[m], response[m])
                target[m] = -free[i, d]
                m += 1
    for i in range(len(index)):
        metres = work.joint_metres[index[i]]
        for j in range(n):
            rows[m, j] = 0.0
            response[m, j] = metres * minverse[j, index[i]]
        rows[m, index[i]] = metres
        target[m] = -metres * acceleration[index[i]]
        m += 1
    products(rows, response, system)
    largest = 0.0
    for a in range(size):
        largest = max(largest, abs(system[a, a]))
    for a in range(size):
        if abs(system[a, a]) <= ROUNDOFF * largest:  # nothing moves this way (across a planar robot)
            for b in range(size):
                system[a, b] = system[b, a] = 0.0
            system[a, a] = largest
            target[a] = 0.0
    return least


@inlined
def delassus_of_rows(rows, minverse, response, delassus):
    """Fill the response M⁻¹ rowsᵀ, row by row, and the Delassus matrix rows M⁻¹ rowsᵀ."""
    for a in range(len(rows)):
        apply_symmetric(minverse, rows[a], response[a])
    products(rows, response, delassus)


@declared(SceneWorkspace)
@external
def accelerates_inward(work):
    """Return whether contacts drive the surface in as they slip.

    What sticks, stops and joints at rest hold against that; their rows may depend on each other. (13.5)
    """
    mode, system, rows, size = work.active_mode, work.system, work.equation_rows, len(work.target)
    held, slips = np.empty(size, dtype=np.int64), np.empty(len(mode), dtype=np.int64)
    row = holding = slipping = 0
    for k in range(len(mode)):
        if mode[k] == SLIP:
            slips[slipping] = row
            row, slipping = row + 1, slipping + 1
        else:
            for _ in range(3):
                held[holding] = row
                row, holding = row + 1, holding + 1
    for a in range(row, size):
        held[holding] = a
        holding += 1
    part, given = np.empty((holding, holding)), np.empty((slipping, holding))
    for a in range(holding):
        for b in range(holding):
            part[a, b] = system[held[a], held[b]]
        for k in range(slipping):
            given[k, a] = system[slips[k], held[a]]
    answer, alone = np.zeros((slipping, holding)), np.empty(rows.shape[1])
    if holding > 0:
        least_norms(part, given, FINEST, answer, np.empty((0, holding)))
    free, plain, count = np.empty(slipping, dtype=np.int64), np.empty(slipping), 0
    for k in range(slipping):
        apply_symmetric(work.minverse, rows[slips[k]], alone)
        whole = left = dot(rows[slips[k]], alone)
        for a in range(holding):
            left -= answer[k, a] * given[k, a]
        if left > FINEST * whole:  # what others hold by themselves drives nothing in, however it slips
            free[count], plain[count] = k, left
            count += 1
    effective = np.empty((count, count))
    for k in range(count):
        for m in range(count):
            effective[k, m] = system[slips[free[k]], slips[free[m]]]
            for a in range(holding):
                effective[k, m] -= answer[free[k], a] * system[held[a], slips[free[m]]]
            effective[k, m] /= math.sqrt(plain[k] * plain[m])
    return may_grow(effective)


@inlined
def may_grow(effective):
    """Return whether a sum of principal minors of a matrix (n, n) is negative, or a single one not positive.

    These are the elementary symmetric functions of the eigenvalues, by Faddeev and Le Verrier's recursion: no
    real eigenvalue is negative where none of them is.
    """
    n, size, scale = len(effective), 1.0, 1.0
    if n == 1:
        return effective[0, 0] <= NEGLIGIBLE
    product, power = np.empty((n, n)), np.zeros((n, n))
    for k in range(n):
        power[k, k] = 1.0
        for m in range(n):
            size = max(size, abs(effective[k, m]))
    for order in range(1, n + 1):
        trace = 0.0
        for k in range(n):
            for m in range(n):
                product[k, m] = 0.0
                for a in range(n):
                    product[k, m] += effective[k, a] * power[a, m]
            trace += product[k, k]
        minors, scale = trace / order, scale * size
        if minors < -NEGLIGIBLE * scale:
            return True
        for k in range(n):
            for m in range(n):
                power[k, m] = -product[k, m]
            power[k, k] += minors
    return False


@declared(SceneWorkspace)
@external
def solve_least_norm(work):
    """Fill the limit of small compliances, without contacts that pull where the others can do without them.

    Likewise, where a contact rubs, with stops and joints at their bounds. It is the solution of least norm
    where none does. Where forces within their bounds are known from before it is the same for what differs
    from them, and it shows that such forces still exist.

    Returns:
        Whether there are no other solutions.
    """
    modes, system, target, solution = work.active_mode, work.system, work.target, work.solution
    known, lower, upper = work.inner_forces, work.scalar_lower, work.scalar_upper
    size = len(target)
    no_basis = np.empty((0, size))
    trial, columns, part, right = np.empty(size), np.empty((size, size)), np.empty(size), np.empty(size)
    for a in range(size):
        right[a] = target[a]
        for b in range(size):
            right[a] -= system[a, b] * known[b]
    work.rank_tolerance = SINGULAR_STILL
    unique = least_norm(system, right, SINGULAR_STILL, solution, no_basis) == size
    shares = not unique and rubs(work)
    if shares:
        share_by_compliances(system, SINGULAR_STILL, solution)
    for a in range(size):
        solution[a] += known[a]
    off = missed_by(work, solution)
    if off > NEGLIGIBLE:
        # what little moves along a closed row is not to be moved at all, however large its force
        least_norm(system, right, FINEST, trial, no_basis)
        for a in range(size):
            trial[a] += known[a]
        if missed_by(work, trial) < 0.1 * off:
            work.rank_tolerance = FINEST
            assign(solution, trial)
    assign(trial, solution)
    pushes, given = flags(size, True), np.zeros(size)
    while True:
        pull, pulling, width = 0.0, size, 0
        a = 0
        for k in range(len(modes)):
            rows = 1 if modes[k] == SLIP else 3
            if modes[k] != HELD and pushes[a] and trial[a + rows - 1] < pull:
                pull, pulling, width = trial[a + rows - 1], a, rows
            a += rows
        for m in range(size - a if shares else 0):
            bound = min(max(trial[a + m], lower[m]), upper[m])
            if pushes[a + m] and -abs(trial[a + m] - bound) < pull:
                pull, pulling, width = -abs(trial[a + m] - bound), a + m, 1
                given[pulling] = bound
        if pulling == size:
            assign(solution, trial)
            return unique
        for a in range(pulling, pulling + width):
            pushes[a] = False
        for a in range(size):
            right[a] = target[a]
            for b in range(size):
                columns[a, b] = system[a, b] if pushes[b] else 0.0
                right[a] -= system[a, b] * (known[b] if pushes[b] else given[b])
        least_norm(columns, right, work.rank_tolerance, part, no_basis)
        if shares:
            for a in range(size):
                for b in range(size):
                    columns[a, b] *= pushes[a]
            share_by_compliances(columns, work.rank_tolerance, part)
        for a in range(size):
            trial[a] = part[a] + known[a] if pushes[a] else given[a]
        if not missed_by(work, trial) <= NEGLIGIBLE:
            return unique


@external
def share_by_compliances(system, rank_tolerance, x):
    """Take a solution x (n,) of A x = b, A singular, to the limit of (A + ε 1) x = b, ε → 0. (11.12)

    With Lᵀ A = 0 and A N = 0 it is the one with Lᵀ x = 0; x stays as it is where Lᵀ N is singular.
    """
    size = len(x)
    nothing, found = np.empty((0, size)), np.empty((0, size))
    right_null, left_null = np.empty((size, size)), np.empty((size, size))
    free = size - least_norms(system, nothing, rank_tolerance, found, right_null)
    if free != size - least_norms(system.T.copy(), nothing, rank_tolerance, found, left_null):
        return
    overlap, off, part = np.empty((free, free)), np.empty(free), np.empty(free)
    for a in range(free):
        off[a] = -dot(left_null[a], x)
        for b in range(free):
            overlap[a, b] = dot(left_null[a], right_null[b])
    if solve(overlap, off, part, RANK) == 0:
        return
    for a in range(free):
        for b in range(size):
            x[b] += part[a] * right_null[a, b]


@inlined
def rubs(work):
    """Return whether a contact slips against friction."""
    modes, mu = work.active_mode, work.active_friction
    found = False
    for k in range(len(modes)):
        found |= modes[k] == SLIP and mu[k] > 0.0
    return found


@inlined
def missed_by(work, x):
    """Return by how much forces miss the equations, in parts of what makes up each contact's or joint's."""
    system, target, modes = work.system, work.target, work.active_mode
    worst, a = 0.0, 0
    for k in range(len(modes) + len(work.scalar_velocity)):
        missed, most = 0.0, LEAST_SIZE
        for _ in range(3 if k < len(modes) and modes[k] != SLIP else 1):
            missing, parts = -target[a], abs(target[a])
            for b in range(len(x)):
                part = system[a, b] * x[b]
                missing += part
                parts += abs(part)
            missed = max(missed, abs(missing)) if missing == missing else math.inf
            most = max(most, parts)
            a += 1
        worst = max(worst, missed / most)
    return worst


@inlined
def apply_forces(work, acceleration, powers):
    """Take the forces from `solution`: add what they cause to v̇, fill `contact_force` and `scalar_force`.

    Powers (2,) takes those of sliding friction and of moving surfaces [W]. Returned is by how much the forces
    keep within Coulomb's law and the bounds [N]; below zero, they do not.
    """
    solution, response, directions = work.solution, work.force_response, work.slip_direction
    velocity, surface = work.contact_velocity, work.surface_velocity
    mode, mu, force = work.active_mode, work.active_friction, work.contact_force
    lower, upper, scalar = work.scalar_lower, work.scalar_upper, work.scalar_force
    for m in range(len(solution)):
        for j in range(len(acceleration)):
            acceleration[j] += response[m, j] * solution[m]
    margin = np.inf
    rubbed = carried = 0.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            force[i, 0] = -mu[i] * directions[i, 0] * solution[m]
            force[i, 1] = -mu[i] * directions[i, 1] * solution[m]
            force[i, 2] = solution[m]
            margin = min(margin, force[i, 2])
            m += 1
        else:
            for d in range(3):
                force[i, d] = solution[m + d]
            m += 3
            if mode[i] == STICK:
                tangent = math.sqrt(force[i, 0] ** 2 + force[i, 1] ** 2)
                margin = min(margin, force[i, 2], mu[i] * force[i, 2] - tangent)
        for d in range(3):
            rubbed += force[i, d] * velocity[i, d]
            carried += force[i, d] * surface[i, d]
    for i in range(len(lower)):
        scalar[i] = work.joint_metres[work.scalar_velocity[i]] * solution[m]
        margin = min(margin, solution[m] - lower[i], upper[i] - solution[m])
        m += 1
    powers[0], powers[1] = rubbed, carried
    return margin
