"""Forces of the active set in given modes, from the linear system (9.3). (theory.md, 9 and 11.4)

A slipping contact has one row (n), any other contact three (t₁, t₂, n). A scalar row belongs to a joint at
its limit (force in [0, ∞)) or a joint held by dry friction (force in ±τ).
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.elimination import RANK, solve
from ..._numeric.least_norm import least_norms
from ..._numeric.loops import assign, filled, largest_diagonal
from ..._numeric.products import add, apply_symmetric, dot, products
from ..._numeric.tolerances import NOISE, ROUNDOFF, TINY
from .tolerances import (
    AMBIGUOUS,
    FINEST,
    LEAST_SIZE,
    NEGLIGIBLE,
    ROUNDED,
    SINGULAR_STILL,
    UNDECIDED,
    WEIGHTLESS,
)
from .workspace import SceneWorkspace

FREE, SLIP, STICK, HELD = range(4)
"""Modes of a contact: open, sliding, sticking, held (bilateral)."""


@inlined
def slip_direction(velocity, reference, slowest):
    """Return the unit direction of slip with the sign that agrees with `reference`: smooth at a reversal.

    Up to the speed `slowest` [m/s] it is `reference` itself.
    """
    s = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    if s <= slowest:
        return reference[0], reference[1]
    if velocity[0] * reference[0] + velocity[1] * reference[1] < 0.0:
        s = -s
    return velocity[0] / s, velocity[1] / s


@inlined
def joint_forces(work, powers):
    """Fill τ = control − damping · v − dry friction and the powers (2,) of control and joints [W]."""
    velocity, control, tau = work.v, work.control_force, work.tau
    damping, friction = work.damping, work.sliding_friction
    control_power = joint_power = 0.0
    for j in range(len(velocity)):
        resistance = damping[j] * velocity[j] + friction[j]
        tau[j] = control[j] - resistance
        control_power += control[j] * velocity[j]
        joint_power -= resistance * velocity[j]
    powers[0], powers[1] = control_power, joint_power


@inlined
def set_up_equations(work, acceleration):
    """Fill the equations (9.3) of the active set: `equation_rows` to `target` of the workspace.

    The workspace has M⁻¹ and the motion of the active contacts without contact forces; `acceleration` (nv,)
    is the corresponding v̇. Returns the smallest ratio, over the slipping contacts, of the effective inverse
    inertia along the normal to the one without friction; zero or less is Painlevé's paradox.
    """
    minverse, jacobian, free = work.minverse, work.contact_jacobian, work.contact_acceleration
    mode, mu, directions = work.active_mode, work.active_friction, work.slip_direction
    rows, response, system, target = work.equation_rows, work.force_response, work.system, work.target
    index, inverse = work.scalar_velocity, work.inverse_inertia
    n, size = len(acceleration), len(rows)
    column, alone = np.empty(n), np.empty(n)
    least = 1.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            s1, s2 = slip_direction(work.contact_velocity[i], work.slip_reference[i], work.direction_speed)
            directions[i, 0], directions[i, 1] = s1, s2
            for j in range(n):
                rows[m, j] = jacobian[i, 2, j]
                column[j] = rows[m, j] - mu[i] * (s1 * jacobian[i, 0, j] + s2 * jacobian[i, 1, j])
            apply_symmetric(minverse, rows[m], alone)
            apply_symmetric(minverse, column, response[m])
            inverse[m] = dot(rows[m], alone)
            if inverse[m] > 0.0:
                least = min(least, dot(rows[m], response[m]) / inverse[m])
            target[m] = -free[i, 2]
            m += 1
        else:
            for d in range(3):
                assign(rows[m], jacobian[i, d])
                apply_symmetric(minverse, rows[m], response[m])
                inverse[m], target[m] = dot(rows[m], response[m]), -free[i, d]
                m += 1
    for i in range(len(index)):
        metres = work.joint_metres[index[i]]
        for j in range(n):
            rows[m, j] = 0.0
            response[m, j] = metres * minverse[j, index[i]]
        rows[m, index[i]] = metres
        inverse[m], target[m] = metres * response[m, index[i]], -metres * acceleration[index[i]]
        m += 1
    products(rows, response, system)
    largest = largest_diagonal(system)
    for a in range(size):
        if abs(system[a, a]) <= ROUNDOFF * largest:  # no force moves it (out of the plane of a planar robot)
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
    """Return whether the matrix D of (13.5) shows a negative normal acceleration of slipping contacts.

    The rows of sticking contacts, joint stops and held joints, which may be redundant, are eliminated first.
    """
    mode, system, size = work.active_mode, work.system, len(work.target)
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
    answer = np.zeros((slipping, holding))
    if holding > 0:
        least_norms(part, given, NOISE, answer, np.empty((0, holding)))
    free, plain, count = np.empty(slipping, dtype=np.int64), np.empty(slipping), 0
    for k in range(slipping):
        whole = work.inverse_inertia[slips[k]]
        remainder = whole - dot(answer[k], given[k])
        if remainder > NOISE * whole:  # else the row depends on the eliminated ones: no force moves it
            free[count], plain[count] = k, remainder
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
    """Return whether a sum of principal minors of D (n, n) is negative; for n = 1 whether D ≤ 0. (13.5)

    These sums are the elementary symmetric functions of the eigenvalues, computed by the Faddeev–Le Verrier
    recursion. If none is negative, no real eigenvalue is.
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
            filled(power[k], 0.0)
            add(power[k], -1.0, product[k])
            power[k, k] += minors
    return False


@declared(SceneWorkspace, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS)
@external
def solve_redundant(work, system, rights, found, null):
    """Fill found (k, m) with solutions of a system like (9.3), which may be singular, for `rights` (k, m).

    Rows are scaled to an inverse inertia of one without friction: light bodies would decide the rank, and
    their rounding errors the forces on others.

    Args:
        work: The workspace.
        system: (m, m) matrix of (9.3), or its transpose.
        rights: (k, m) right-hand sides.
        found: (k, m) is overwritten.
        null: (m, m), or (0, m) if not needed, is overwritten with unit vectors that span the null space.

    Returns:
        The rank, the last pivot and the first one that is taken as zero, see `least_norm.decompose`.
    """
    size, largest, d, scaled, sides = len(system), 0.0, np.empty(len(system)), system.copy(), rights.copy()
    for a in range(size):  # the diagonal entry is larger for rows that no force moves
        d[a] = max(work.inverse_inertia[a], system[a, a])
        largest = max(largest, d[a])
    for a in range(size):
        d[a] = 1.0 / math.sqrt(max(d[a], ROUNDOFF * largest, TINY))
    for a in range(size):
        for b in range(size):
            scaled[a, b] *= d[a] * d[b]
        for side in sides:
            side[a] *= d[a]
    rank, kept, dropped = least_norms(scaled, sides, work.rank_tolerance, found, null)
    for x in found:
        for a in range(size):
            x[a] *= d[a]
    for k in range(min(size - rank, len(null))):
        for a in range(size):
            null[k, a] *= d[a]
        length = math.sqrt(dot(null[k], null[k]))
        for a in range(size):
            null[k, a] /= length
    return rank, kept, dropped


@declared(SceneWorkspace, FLOAT_ROWS)
@external
def add_reactions(work, effects):
    """Add to accelerations (k, nv) those of the forces that keep the active rows from accelerating."""
    rows, response, size, count = work.equation_rows, work.force_response, len(work.target), len(effects)
    targets, reactions, no_basis = np.empty((count, size)), np.empty((count, size)), np.empty((0, size))
    for c in range(count):
        for m in range(size):
            targets[c, m] = -dot(rows[m], effects[c])
    if size > 0 and work.forces_unique:
        least_norms(work.system, targets, RANK, reactions, no_basis)
    elif size > 0:
        solve_redundant(work, work.system, targets, reactions, no_basis)
    for c in range(count):
        for m in range(size):
            add(effects[c], reactions[c, m], response[m])


@declared(SceneWorkspace)
@external
def limit_of_compliances(work):
    """Fill `work.solution` with the limit (A + ε 1) x = b, ε → 0, of the singular system (9.3). (11.12)

    It has Lᵀx = 0, where LᵀA = 0. If LᵀN is singular, where A N = 0, any solution is returned. Bounds are not
    considered, see `compliant_forces`.

    The rank is decided where a motion begins, see `evaluate_anew`. In the stages of a step redundant rows
    contradict each other by the error of the stage, which only very large forces would satisfy.

    Returns:
        Whether the solution is unique.
    """
    system, size, x = work.system, len(work.target), work.solution
    rights, found, none = np.empty((1, size)), np.empty((1, size)), np.empty((0, size))
    right_null, left_null = np.empty((size, size)), np.empty((size, size))
    assign(rights[0], work.target)
    decides = work.rank_tolerance == UNDECIDED
    if decides:
        work.rank_tolerance = SINGULAR_STILL
    rank, kept, dropped = solve_redundant(work, system, rights, found, right_null)
    symmetric = not slips_with_friction(work)
    while decides and symmetric and below_close_pivot(work.rank_tolerance, kept, dropped) > FINEST:
        work.rank_tolerance = below_close_pivot(work.rank_tolerance, kept, dropped)
        rank, kept, dropped = solve_redundant(work, system, rights, found, right_null)
    free, decided = size - rank, work.rank_tolerance
    residual = relative_residual(work, found[0])
    if decides and residual > NEGLIGIBLE:
        # keep rows of small inverse inertia too, although their forces may be large
        work.rank_tolerance = FINEST
        finer, null = np.empty((1, size)), np.empty((size, size))
        rank, _, _ = solve_redundant(work, system, rights, finer, null)
        if relative_residual(work, finer[0]) < 0.1 * residual:
            free, found, right_null = size - rank, finer, null
        else:
            work.rank_tolerance = decided
    assign(x, found[0])
    if free == 0:
        return True
    if not symmetric:
        rank, _, _ = solve_redundant(work, system.T.copy(), none, none, left_null)
        if free != size - rank:
            return False
    else:
        left_null = right_null
    overlap, right, part = np.empty((free, free)), np.empty(free), np.empty(free)
    for a in range(free):
        right[a] = -dot(left_null[a], x)
        for b in range(free):
            overlap[a, b] = dot(left_null[a], right_null[b])
    if solve(overlap, right, part, RANK) != 0:
        for a in range(free):
            add(x, part[a], right_null[a])
    return False


@inlined
def below_close_pivot(tolerance, kept, dropped):
    """Return a pivot tolerance below a pivot close to the present one, or 0 if there is none. (11.4)

    Whether that pivot exceeds it would depend on the order of equal rows, which rounding decides.
    """
    if dropped > AMBIGUOUS * tolerance:
        return AMBIGUOUS * dropped
    return AMBIGUOUS * kept if AMBIGUOUS * kept < tolerance else 0.0


@inlined
def slips_with_friction(work):
    """Return whether a contact slips against friction."""
    modes, mu = work.active_mode, work.active_friction
    found = False
    for k in range(len(modes)):
        found |= modes[k] == SLIP and mu[k] > 0.0
    return found


@inlined
def relative_residual(work, x):
    """Return the largest residual of (9.3) at forces x, relative to the acceleration of its contact or joint.

    It is not relative to the effects of the forces, which are large on light bodies and nearly cancel.
    """
    system, target, modes = work.system, work.target, work.active_mode
    worst, a = 0.0, 0
    for k in range(len(modes) + len(work.scalar_velocity)):
        missed, most = 0.0, max(LEAST_SIZE, work.gravity)
        for _ in range(3 if k < len(modes) and modes[k] != SLIP else 1):
            missing = dot(system[a], x) - target[a]
            missed = max(missed, abs(missing)) if missing == missing else math.inf
            most = max(most, abs(target[a]))
            a += 1
        worst = max(worst, missed / most)
    return worst


@inlined
def negligible_force(work, mass, inverse_inertia, response, couplings, forces):
    """Return the force of a row that is taken as zero [N]. (11.13)

    Args:
        work: The workspace, with the generalized forces `tau` of the state last evaluated.
        mass: Mass of the lightest tree that the row moves [kg].
        inverse_inertia: Inverse inertia of the row, its entry on the diagonal of W [1/kg].
        response: (nv,) v̇ per unit of the force of the row.
        couplings: (m,) accelerations of the row per unit of each force.
        forces: (m,) the forces [N].
    """
    torques = others = 0.0
    tau = work.tau
    for j in range(len(tau)):
        torques += abs(response[j] * tau[j])
    for b in range(len(forces)):
        others += abs(couplings[b] * forces[b])
    inertia = min(mass, 1.0 / inverse_inertia) if inverse_inertia > 0.0 else mass
    return inertia * max(WEIGHTLESS * max(work.gravity, torques, others), ROUNDED * LEAST_SIZE)


@inlined
def mass_at_contact(work, i):
    """Return the mass of the lighter one of the trees that contact i connects [kg]."""
    return min(work.tree_mass[work.contact_joints[i, 0]], work.tree_mass[work.contact_joints[i, 1]])


@inlined
def row_tolerances(work):
    """Fill `row_tolerance`, the forces of the active rows that are taken as zero."""
    mode, index, found = work.active_mode, work.active_index, work.row_tolerance
    system, response, solution = work.system, work.force_response, work.solution
    last = 0
    for i in range(len(mode) + len(work.scalar_velocity)):
        rows = 3 if i < len(mode) and mode[i] != SLIP else 1
        last += rows
        a = last - 1
        if i < len(mode):
            mass = mass_at_contact(work, index[i])
        else:
            mass = work.tree_mass[work.velocity_joint[work.scalar_velocity[i - len(mode)]]]
        for b in range(last - rows, last):
            found[b] = negligible_force(work, mass, system[a, a], response[a], system[a], solution)


@inlined
def accelerate(work, acceleration):
    """Add the effect of the forces `work.solution` to v̇ (nv,)."""
    solution, response = work.solution, work.force_response
    for m in range(len(solution)):
        add(acceleration, solution[m], response[m])


@declared(SceneWorkspace, FLOATS)
@external
def set_forces(work, powers):
    """Fill `contact_force` and `scalar_force` from the forces `work.solution`.

    `powers` (2,) is overwritten with those of friction and of moving surfaces [W]. That of normal forces is
    an error of the step, which the energy residual shows; that of sticking friction too, but where it is
    large the contact cannot stick. (theory.md, 13.4) Returns the margin of the forces within Coulomb's law
    and their bounds (11.6), with tolerances [N]; negative if one is violated.
    """
    solution, directions = work.solution, work.slip_direction
    velocity, surface = work.contact_velocity, work.surface_velocity
    mode, mu, force = work.active_mode, work.active_friction, work.contact_force
    lower, upper, scalar = work.scalar_lower, work.scalar_upper, work.scalar_force
    row_tolerances(work)
    margin, tolerance = np.inf, work.row_tolerance
    friction_power = surface_power = 0.0
    m = 0
    for i in range(len(mode)):
        if mode[i] == SLIP:
            force[i, 0] = -mu[i] * directions[i, 0] * solution[m]
            force[i, 1] = -mu[i] * directions[i, 1] * solution[m]
            force[i, 2] = solution[m]
            margin = min(margin, force[i, 2] + tolerance[m])
            m += 1
        else:
            for d in range(3):
                force[i, d] = solution[m + d]
            m += 3
            if mode[i] == STICK:
                tangent = math.sqrt(force[i, 0] ** 2 + force[i, 1] ** 2)
                margin = min(margin, min(force[i, 2], mu[i] * force[i, 2] - tangent) + tolerance[m - 1])
        if mode[i] != HELD:
            friction_power += force[i, 0] * velocity[i, 0] + force[i, 1] * velocity[i, 1]
        for d in range(3):
            surface_power += force[i, d] * surface[i, d]
    for i in range(len(lower)):
        scalar[i] = work.joint_metres[work.scalar_velocity[i]] * solution[m]
        margin = min(margin, min(solution[m] - lower[i], upper[i] - solution[m]) + tolerance[m])
        m += 1
    powers[0], powers[1] = friction_power, surface_power
    return margin
