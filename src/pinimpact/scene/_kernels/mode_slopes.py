"""Derivatives of v̇, and of velocities and forces of the active set, along a step. (derivatives.md, 9)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, flags
from ..._numeric.products import add, add_product, apply_symmetric, dot
from ..._numeric.tolerances import COMPUTED, RANK
from ...robot._kernels import configuration_slopes as slopes
from ...robot._kernels.placement import rotate
from ...robot._kernels.python_calls import call
from .active_set import close
from .contact_forces import FREE, HELD, SLIP, STICK, slips_with_friction
from .dense_output import state
from .drives import set_saturation
from .dynamics import invert_mass_matrix
from .force_evaluation import evaluate_closed, places_of_contacts
from .lie_charts import PLANAR, RIGID, ROTATION
from .tolerances import NEGLIGIBLE
from .workspace import SceneWorkspace


@declared(SceneWorkspace, INTEGERS, FLOAT_ROWS, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS)
@external
def closed_slopes(work, parent, scratch, axes, velocities, forces):
    """Fill the derivatives of contact velocities and of Jᵀf with respect to q. (D19, D20)

    Args:
        work: The workspace, with the forces of `evaluate_closed`.
        parent: (joints,) parent of each joint; joint 0 is the world.
        scratch: (joints, 6) scratch array.
        axes: (k, 3, 3) is overwritten with the axes of the active contacts, as rows.
        velocities: (k, 3, nv) is overwritten with ∂(contact velocity)/∂q, in axes that turn with the surface.
        forces: (nv, nv) is overwritten with ∂(Jᵀf)/∂q for forces that turn with the axes; (0, 0): not needed.
    """
    index, force = work.active_index, work.contact_force
    columns, joint = work.joint_jacobian, work.velocity_joint
    points, at, shifts = np.empty((len(index), 3)), np.empty(slopes.PLACE), np.empty((work.nv, slopes.SHIFT))
    places_of_contacts(work, index, axes, points)
    forces[:, :] = 0.0
    slopes.fill_motions(columns, joint, parent, work.v, scratch)
    for m in range(len(index)):
        tip, base = _fill_place(work, parent, index[m], axes[m], at, shifts)
        slopes.velocity_slopes(columns, joint, parent, tip, base, at, shifts, scratch, True, velocities[m])
        if len(forces) > 0:
            f1, f2, f3 = rotate(at, force[m, 0], force[m, 1], force[m, 2])
            slopes.force_slopes(columns, joint, parent, at, shifts, f1, f2, f3, forces)


@inlined
def _fill_place(work, parent, i, axes, at, shifts):
    """Fill `at` and `shifts` of contact i with axes (3, 3), see `slopes.fill_place`; return its joints."""
    tip, base = work.contact_joints[i, 0], work.contact_joints[i, 1]
    slopes.fill_place(
        *(work.placements[tip], work.placements[base], work.contact_constants[i], axes.reshape(9)),
        *(True, work.joint_jacobian, work.velocity_joint, parent, tip, base, at, shifts),
    )
    return tip, base


@declared(
    *(SceneWorkspace, INTEGERS, FLOATS, FLOAT_STACK, INTEGERS, INTEGERS),
    *(FLOAT_ROWS, FLOATS, FLOATS, float, float, FLOATS),
    *(FLOAT_STACK, bool, bool),
)
@jit
def slopes_along(
    work, derive, acceleration, smooth, parent, friction, coefficients, q0, v0, start, h, times, ends, unique,
    free,
):  # fmt: skip
    """Return derivatives of v̇ and of the m vanishing velocities at several times within a step. (D23)

    Args:
        work: The workspace, with the modes, constants of the contacts, signs of dry friction and control.
        derive: Addresses of a function that fills `smooth` for v̇ = `acceleration`, and of its arguments.
        acceleration: (nv,) is overwritten with v̇.
        smooth: (2, nv, nv) array for the derivatives of M v̇ + h by q and v, at constant v̇.
        parent: (joints,) parent of each joint; joint 0 is the world.
        friction: Numbers of the contacts whose coefficients of friction are parameters; −1 for none.
        coefficients, q0, v0, start, h: The step, see `DenseStep`.
        times: (s,) times [s].
        ends: (2, k, 2) directions of slip of active contacts, at the start and at the end of the step.
        unique: As in `forces_at`.
        free: Whether the active set is empty, so that drives may reach their limits.

    Returns:
        by_state (s, nv + m or nv + 2 m, 2 nv): ∂v̇/∂(q, v), then the rows of the vanishing velocities, then,
        unless forces are unique, those of `_fill_shares`; derivatives of v̇ with respect to the
        forces of the rows (s, nv, m); M⁻¹ (s, nv, nv); derivatives of v̇ with respect to friction (s, nv, n);
        N of the joints that turn (s, k, k); and whether a sticking contact yields beside others that slip.
    """
    close(work, np.zeros((work.contacts, 2)))
    nv, stages, rows, index = len(v0), len(times), work.active_rows, work.active_index
    turns = 0
    for k in range(len(work.joint_charts)):
        if work.joint_charts[k, 0] in (PLANAR, RIGID, ROTATION):
            turns += work.joint_charts[k, 3]
    q, v = np.empty(len(q0)), np.empty(nv)
    of_contacts, forces = np.empty((nv, nv)), np.empty((nv, 2 * nv))
    scratch, axes = np.empty((len(parent), 6)), np.empty((len(index), 3, 3))
    moved = np.empty((len(index), 3, nv))
    shares = 0 if unique else rows
    by_state = np.zeros((stages, nv + rows + shares, 2 * nv))
    response, inverse = np.zeros((stages, nv, rows)), np.empty((stages, nv, nv))
    turning, by_friction = np.zeros((stages, turns, turns)), np.zeros((stages, nv, len(friction)))
    yields = False
    for i in range(stages):
        _evaluate(work, times[i], coefficients, q0, v0, start, h, ends, unique, free, q, v)
        closed_slopes(work, parent, scratch, axes, moved, of_contacts)
        if not work.callback_failed:
            _fill_acceleration(work, acceleration)
            work.callback_failed = not call(derive[0], derive[1])
        if rows > 0 or invert_mass_matrix(work):  # else it is that of the forces
            assign(inverse[i].ravel(), work.minverse.ravel())
        _fill_smooth(work, smooth, of_contacts, forces)
        _fill_closed(work, moved, True, acceleration, forces, by_state[i], inverse[i], response[i])
        _fill_friction(work, friction, inverse[i], by_friction[i])
        add_product(inverse[i], forces, by_state[i, :nv])
        _fill_turning(work, v, turning[i])
        if shares > 0:
            yields |= _sticking_yields(work)
            _fill_shares(work, parent, scratch, by_state[i])
        if work.callback_failed:
            break
    return by_state, response, inverse, by_friction, turning, yields


@declared(
    *(SceneWorkspace, INTEGERS, FLOAT_ROWS, FLOATS, FLOATS, float, float, float, FLOAT_STACK, bool, bool),
)
@jit
def constraints_at(work, parent, coefficients, q0, v0, start, h, t, ends, unique, free):
    """Return v̇ and the constraints at a time t [s], at which the speed of slip may be zero.

    Arguments are those of `slopes_along`.

    Returns:
        v̇ (nv,); its derivatives by the forces of the rows (nv, m); the rows of the velocities that vanish
        (m, 2 nv); M⁻¹ (nv, nv); ∂(contact velocity)/∂q (k, 3, nv); and the result of `_at_bound`.
    """
    close(work, np.zeros((work.contacts, 2)))
    nv, rows, contacts = len(v0), work.active_rows, len(work.active_index)
    moved, axes, scratch = np.empty((contacts, 3, nv)), np.empty((contacts, 3, 3)), np.empty((len(parent), 6))
    by_state, response = np.zeros((nv + rows, 2 * nv)), np.zeros((nv, rows))
    inverse, acceleration, none = np.empty((nv, nv)), np.empty(nv), np.empty((0, 0))
    _evaluate(work, t, coefficients, q0, v0, start, h, ends, unique, free, np.empty(len(q0)), np.empty(nv))
    closed_slopes(work, parent, scratch, axes, moved, none)
    _fill_acceleration(work, acceleration)
    if rows > 0 or invert_mass_matrix(work):  # else it is that of the forces
        assign(inverse.ravel(), work.minverse.ravel())
    _fill_closed(work, moved, False, acceleration, none, by_state, inverse, response)
    return acceleration, response, by_state[nv:].copy(), inverse, moved, _at_bound(work, unique)


@declared(SceneWorkspace, FLOATS)
@jit
def gap_rows(work, acceleration):
    """Return the rows of the constraints that are rates of gaps which remain closed, and which bear a load.

    Args:
        work: The workspace, with the forces last evaluated.
        acceleration: (nv,) v̇.

    Returns:
        (k,) numbers of the rows; (k,) whether the constraint is bilateral or its force moves joints by more
        than rounding errors of v̇; (m,) the rows without those of contacts and limits that bear no load.
    """
    gaps, first = np.empty(work.active_rows, dtype=np.int64), np.empty(work.active_rows, dtype=np.int64)
    loaded, kept = flags(work.active_rows, False), flags(work.active_rows, True)
    count, row, size = 0, 0, _size(work, acceleration)
    for k in range(len(work.active_mode)):
        end = row + (1 if work.active_mode[k] == SLIP else 3)
        bilateral = work.bilateral[work.active_index[k]] != 0
        for r in range(row if bilateral else end - 1, end):
            gaps[count], first[count], loaded[count] = r, row, bilateral
            count += 1
        row = end
    for k in range(len(work.scalar_velocity)):
        lower, upper = work.scalar_lower[k], work.scalar_upper[k]
        friction = abs(upper if np.isinf(lower) else lower)  # may hold a joint instead of its limit
        if np.isinf(lower) != np.isinf(upper) and (friction == 0.0 or abs(work.solution[row + k]) > friction):
            gaps[count], first[count] = row + k, row + k
            count += 1
    for a in range(count):
        loaded[a] |= _bears(work, gaps[a], size)
        if not loaded[a]:
            kept[first[a] : gaps[a] + 1] = False
    return gaps[:count], loaded[:count], kept


@declared(*(SceneWorkspace, FLOAT_ROWS, FLOATS, FLOATS, float, float, FLOATS), *(FLOAT_STACK, bool))
@jit
def speeds_along(work, coefficients, q0, v0, start, h, times, ends, unique):
    """Return the slip speeds (s, k) of active contacts at several times within a step, zero without slip.

    Arguments are those of `slopes_along`.
    """
    close(work, np.zeros((work.contacts, 2)))
    speeds = np.empty((len(times), len(work.active_index)))
    q, v = np.empty(len(q0)), np.empty(len(v0))
    for i in range(len(times)):
        _evaluate(work, times[i], coefficients, q0, v0, start, h, ends, unique, False, q, v)
        for k in range(speeds.shape[1]):
            x, y = work.contact_velocity[k, 0], work.contact_velocity[k, 1]
            speeds[i, k] = np.sqrt(x * x + y * y) if work.active_mode[k] == SLIP else 0.0
    return speeds


@inlined
def _at_bound(work, unique):
    """Return whether friction of a sticking contact or joint is at its bound in the modes last evaluated.

    If the forces are not `unique`, all of them must be at their bounds: others take over the load of one.
    """
    force, row, bounds, holds = work.solution, 0, 0, 0
    for k in range(len(work.active_mode)):
        if work.active_mode[k] == STICK:
            bound = work.active_friction[k] * force[row + 2]
            margin = bound - np.sqrt(force[row] ** 2 + force[row + 1] ** 2)
            bounds += 1 if bound > 0.0 else 0
            holds += 1 if abs(margin) > COMPUTED * bound > 0.0 else 0
        row += 1 if work.active_mode[k] == SLIP else 3
    for k in range(len(work.scalar_velocity)):
        bound = work.scalar_upper[k]
        if np.isfinite(work.scalar_lower[k]) and np.isfinite(bound):
            bounds += 1 if bound > 0.0 else 0
            holds += 1 if abs(bound - abs(force[row + k])) > COMPUTED * bound > 0.0 else 0
    return holds < bounds if unique else bounds > 0 and holds == 0


@inlined
def _evaluate(work, t, coefficients, q0, v0, start, h, ends, unique, free, q, v):
    """Evaluate motion and forces at a time within a step; fill its state q and v."""
    part, reference = (t - start) / h, np.zeros((work.contacts, 2))
    state(coefficients, part, work.joint_charts, q0, v0, q, v)
    row = 0
    for k in range(work.contacts):
        if work.modes[k] != FREE:
            x = (1.0 - part) * ends[0, row, 0] + part * ends[1, row, 0]
            y = (1.0 - part) * ends[0, row, 1] + part * ends[1, row, 1]
            size = np.sqrt(x * x + y * y)
            if size > 0.0:
                reference[k, 0], reference[k, 1] = x / size, y / size
            row += 1
    if free:
        set_saturation(work, q, v)
    evaluate_closed(work, t, q, v, reference, unique)


@inlined
def _fill_acceleration(work, acceleration):
    """Fill v̇ (nv,) at the state last evaluated, with the forces of the active set."""
    assign(acceleration, work.acceleration)
    for k in range(len(work.solution)):
        add(acceleration, work.solution[k], work.force_response[k])


@inlined
def _fill_smooth(work, smooth, of_contacts, forces):
    """Fill the derivatives of the generalized forces at constant v̇, including damping and drives."""
    n = work.nv
    for i in range(n):
        for j in range(n):
            forces[i, j] = of_contacts[i, j] - smooth[0, i, j]
            forces[i, n + j] = -smooth[1, i, j]
        forces[i, n + i] -= work.damping[i]
    for j in work.drive_velocity:
        if work.drive_side[j] == 0:
            forces[j, j] -= work.drive_stiffness[j]
            forces[j, n + j] -= work.drive_damping[j]


@inlined
def _fill_closed(work, moved, moving, acceleration, forces, by_state, inverse, response):
    """Fill the rows of the vanishing velocities and the response of v̇ to their forces.

    Friction without a load holds nothing: tangential rows of sticking contacts that bear none are left zero.
    If `moving`, terms by the change of slip directions are added to `forces`, see `_fill_smooth`.
    """
    jacobian, force, velocity = work.contact_jacobian, work.contact_force, work.contact_velocity
    row, nv = work.nv, work.nv
    shared = moving and not work.forces_unique and slips_with_friction(work)
    push, turn, size = np.empty(nv), np.empty(nv), _size(work, acceleration)
    for k in range(len(force)):
        if shared and _without_load(work, k, row - nv):
            row += 1 if work.active_mode[k] == SLIP else 3
            continue
        if work.active_mode[k] != SLIP:
            idle = work.active_mode[k] == STICK and not _bears(work, row - nv + 2, size)
            row += 2 if idle else 0
            for d in range(2 if idle else 0, 3):
                assign(by_state[row, :nv], moved[k, d])
                assign(by_state[row, nv:], jacobian[k, d])
                _respond(inverse, jacobian[k, d], response, row - nv)
                row += 1
            continue
        mu, s1, s2 = work.active_friction[k], work.slip_direction[k, 0], work.slip_direction[k, 1]
        assign(by_state[row, :nv], moved[k, 2])
        assign(by_state[row, nv:], jacobian[k, 2])
        for j in range(nv):
            push[j] = jacobian[k, 2, j] - mu * (s1 * jacobian[k, 0, j] + s2 * jacobian[k, 1, j])
        _respond(inverse, push, response, row - nv)
        row += 1
        if not (moving and mu > 0.0):
            continue
        speed = np.sqrt(velocity[k, 0] ** 2 + velocity[k, 1] ** 2)
        for j in range(nv):
            push[j] = -mu * force[k, 2] * (s1 * jacobian[k, 1, j] - s2 * jacobian[k, 0, j])
            turn[j] = (s1 * moved[k, 1, j] - s2 * moved[k, 0, j]) / speed
        for i in range(nv):
            for j in range(nv):
                forces[i, j] += push[i] * turn[j]
                forces[i, nv + j] += push[i] * (s1 * jacobian[k, 1, j] - s2 * jacobian[k, 0, j]) / speed
    for k in range(len(work.scalar_velocity)):
        j = work.scalar_velocity[k]
        held, metres = work.solution[row - nv], work.joint_metres[j]
        if work.forces_unique or work.scalar_lower[k] < held < work.scalar_upper[k]:  # not at a bound
            by_state[row, nv + j] = metres
            for i in range(nv):
                response[i, row - nv] = metres * inverse[i, j]
        row += 1


@inlined
def _size(work, acceleration):
    """Return the size of accelerations v̇ (nv,) [m/s²], at least that of gravity."""
    size = work.gravity
    for j in range(len(acceleration)):
        size = max(size, work.joint_metres[j] * abs(acceleration[j]))
    return size


@inlined
def _bears(work, row, size):
    """Return whether the force of a row changes v̇, of a size [m/s²], by more than rounding errors."""
    found = False
    for j in range(work.nv):
        rate = work.joint_metres[j] * work.force_response[row, j] * work.solution[row]
        found |= abs(rate) > COMPUTED * size
    return found


@inlined
def _without_load(work, k, row):
    """Return whether active contact k, with first row `row`, has been released from a shared load."""
    last = row if work.active_mode[k] == SLIP else row + 2
    return work.active_mode[k] != HELD and work.solution[last] == 0.0


@inlined
def _fill_shares(work, parent, scratch, by_state):
    """Fill the last m rows with ∂(J w)/∂q, where the forces are λ = J w, J the rows of velocities. (D23)"""
    nv, m, index = work.nv, work.active_rows, work.active_index
    columns, joint = work.joint_jacobian, work.velocity_joint
    gram, weights, w = np.empty((m, m)), np.empty(m), np.zeros(nv)
    for a in range(m):
        for b in range(m):
            gram[a, b] = dot(by_state[nv + a, nv:], by_state[nv + b, nv:])
    least_norm(gram, work.solution, RANK, weights, np.empty((0, m)))
    for a in range(m):
        for j in range(nv):
            w[j] += weights[a] * by_state[nv + a, nv + j]
    slopes.fill_motions(columns, joint, parent, w, scratch)
    at, shifts, changes = np.empty(slopes.PLACE), np.empty((nv, slopes.SHIFT)), np.empty((3, nv))
    axes, points, row = np.empty((len(index), 3, 3)), np.empty((len(index), 3)), nv + m
    places_of_contacts(work, index, axes, points)
    shared = slips_with_friction(work)
    for k in range(len(index)):
        if shared and _without_load(work, k, row - nv - m):
            row += 1 if work.active_mode[k] == SLIP else 3
            continue
        tip, base = _fill_place(work, parent, index[k], axes[k], at, shifts)
        slopes.velocity_slopes(columns, joint, parent, tip, base, at, shifts, scratch, False, changes)
        for d in range(2 if work.active_mode[k] == SLIP else 0, 3):
            assign(by_state[row, :nv], changes[d])
            row += 1


@inlined
def _sticking_yields(work):
    """Return whether a sticking contact is at its cone and others slip: the motion depends on its share."""
    found = False
    for k in range(len(work.active_mode)):
        force = work.contact_force[k]
        if work.active_mode[k] == STICK and force[2] != 0.0:
            bound = work.active_friction[k] * force[2]
            found |= bound - np.sqrt(force[0] ** 2 + force[1] ** 2) <= NEGLIGIBLE * bound
    return found and slips_with_friction(work)


@inlined
def _respond(inverse, push, response, row):
    """Fill column `row` of the response (nv, m) with v̇ by a unit force along `push` (nv,)."""
    rate = np.empty(len(push))
    apply_symmetric(inverse, push, rate)
    for i in range(len(push)):
        response[i, row] = rate[i]


@inlined
def _fill_friction(work, friction, inverse, by_friction):
    """Fill by_friction (nv, n), zero before, with derivatives of v̇ by coefficients of friction."""
    jacobian, force = work.contact_jacobian, work.contact_force
    for column in range(len(friction)):
        for k in range(len(force)):
            if work.active_index[k] == friction[column] and work.active_mode[k] == SLIP:
                s1, s2 = work.slip_direction[k, 0], work.slip_direction[k, 1]
                for i in range(len(inverse)):
                    for j in range(len(inverse)):
                        along = s1 * jacobian[k, 0, j] + s2 * jacobian[k, 1, j]
                        by_friction[i, column] -= force[k, 2] * inverse[i, j] * along


@inlined
def _fill_turning(work, v, turning):
    """Fill N of (D22), zero before, for the joints that turn."""
    a = 0
    for c in range(len(work.joint_charts)):
        kind, j = work.joint_charts[c, 0], work.joint_charts[c, 2]
        if kind == PLANAR:
            turning[a, a + 1], turning[a, a + 2] = -v[j + 2], v[j + 1]
            turning[a + 1, a], turning[a + 1, a + 2] = v[j + 2], -v[j]
            a += 3
        elif kind == ROTATION:
            _fill_cross(v, j, turning, a, a)
            a += 3
        elif kind == RIGID:
            _fill_cross(v, j, turning, a, a + 3)
            _fill_cross(v, j + 3, turning, a, a)
            _fill_cross(v, j + 3, turning, a + 3, a + 3)
            a += 6


@inlined
def _fill_cross(v, j, out, row, column):
    """Fill out[row : row + 3, column : column + 3] with the cross product matrix of v[j : j + 3]."""
    x, y, z = v[j], v[j + 1], v[j + 2]
    out[row, column + 1], out[row, column + 2] = -z, y
    out[row + 1, column], out[row + 1, column + 2] = z, -x
    out[row + 2, column], out[row + 2, column + 1] = -y, x
