"""A time step: rows at the midpoint, arriving contacts, and the contact problem. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOATS, FOUR_FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.augmented_newton import VelocityProblem, law_of_steps, rates
from ..._numeric.loops import assign, flags
from ..._numeric.products import add, apply_symmetric
from ..._numeric.tolerances import NOISE, SETTLED, SOFTEST
from ...geometry._kernels.constants import ABSENT, KIND, RADIUS
from .dynamics import (
    CONTROL,
    FAR,
    compute_kinematics,
    contact_gap,
    evaluate_without_contacts,
    follow_surface,
    limit_gap,
    limit_scale,
    motion_by_columns,
    moving_columns,
    set_state,
    sphere_gap,
)
from .lie_charts import add_turning
from .step_impulses import step_impulses
from .step_rows import StepResult, StepRows, StepSystem, closing_speed, first_row, normal_row
from .struck_islands import mark_struck, replace_struck
from .tolerances import STEPS_GAIN
from .workspace import SceneWorkspace


@declared(SceneWorkspace, FLOATS, FLOATS, float, float, FLAGS, bool, INTEGERS, result=int)
@jit
def near_rows(work, q, v, h, slack, rests, placed, near):
    """Fill the numbers of the contacts and limits that may close within a step; return their number.

    Args:
        work: The workspace.
        q: (nq,) configuration at the midpoint.
        v: (nv,) velocity.
        h: Length of the step [s].
        slack: Closing of gaps in addition to their rates [m].
        rests: (nj,) joints that are at rest, including the world.
        placed: Whether the kinematics are already those of this state.
        near: (n + nl,) is overwritten with the numbers: contacts other than held ones, then n + limit.
    """
    if not placed:
        set_state(work, q, v)
        compute_kinematics(work)
    blocks, ends, constants, count = work.contact_blocks, work.contact_joints, work.contact_constants, 0
    for b in range(len(blocks)):
        first, stop, k = blocks[b, 0], blocks[b, 1], blocks[b, 2]
        if k >= 0 and not (rests[ends[first, 0]] and rests[ends[first, 1]]):
            gap, _ = sphere_gap(work, k, first)
            if gap > FAR * work.sphere_constants[k, RADIUS]:
                continue
        for i in range(first, stop):
            if constants[i, KIND] == ABSENT or work.bilateral[i] != 0:
                continue
            if not (rests[ends[i, 0]] and rests[ends[i, 1]]):
                gap, rate = contact_gap(work, i)
                if gap + 0.5 * h * rate <= slack:
                    near[count] = i
                    count += 1
    for k in range(work.limits):
        gap, rate = limit_gap(work, k, q, v)
        if not rests[work.velocity_joint[work.limit_v[k]]] and gap + 0.5 * h * rate <= slack:
            near[count] = work.contacts + k
            count += 1
    return count


@inlined
def fill_rows(work, v, rows, u, acceleration, turning):
    """Fill the rows of a step at the state last evaluated.

    Args:
        work: The workspace.
        v: (nv,) velocity.
        rows: The `StepRows`, with the numbers of its rows; the other fields are filled.
        u: (rows,) is overwritten with the row velocities at v [m/s].
        acceleration: (nc + nh, 3) is overwritten with contact accelerations without contact forces [m/s²].
        turning: (nc + nh, 3) is overwritten with their additional terms in fixed axes [m/s²].
    """
    contacts, held, limits, dry, values, columns, counts, surface, gap = rows
    every, width = len(contacts) + len(held), values.shape[1]
    signs, jacobian, motion = np.empty(width), np.empty((3, width)), np.empty(3)
    for k in range(every):
        i, a = contacts[k] if k < len(contacts) else held[k - len(contacts)], 3 * k
        follow_surface(work, i)
        count = moving_columns(work, i, columns[a], signs)
        moving = np.empty((count, 6)).T
        for m in range(count):
            for e in range(6):
                moving[e, m] = work.joint_jacobian[e, columns[a, m]]
        gap[k] = motion_by_columns(
            work, i, moving, signs[:count], jacobian, motion, acceleration[k], turning[k], surface[k]
        )
        gap[k] -= work.rest_gap[i]
        pushes = k >= len(contacts)  # no normal force, and so no friction, acts where none moves the robot
        for m in range(count):
            pushes = pushes or jacobian[2, m] != 0.0
        count = count if pushes else 0
        for e in range(3):
            u[a + e], counts[a + e] = motion[e], count
            for m in range(count):
                values[a + e, m], columns[a + e, m] = jacobian[e, m], columns[a, m]
    for k in range(len(limits)):
        a = 3 * every + k
        values[a, 0], columns[a, 0], counts[a] = limit_scale(work, limits[k]), work.limit_v[limits[k]], 1
        gap[every + k], u[a] = limit_gap(work, limits[k], work.q, v)
    for k in range(len(dry)):
        a = 3 * every + len(limits) + k
        values[a, 0], columns[a, 0], counts[a] = work.joint_metres[dry[k]], dry[k], 1
        u[a] = values[a, 0] * v[dry[k]]


@inlined
def bend_rows(work, h, rows, acceleration, turning, offset, found):
    """Add ∓½h J̇ v to the contact velocities at the start and end of a step, and −⅛h² J̇ v to the gaps. (16.2)

    Rows are those of the midpoint; J̇ v is their change along the velocity. A path whose ends are on the
    surface is off it by ⅛h² J̇ v at the midpoint. The gaps of contacts that are open at the start, on paths
    that bend away from the surface, stay as they are. Tangential velocities are in fixed axes, the normal
    follows the surface, as the gap rate does.

    Args:
        work: The workspace.
        h: Length of the step [s].
        rows: The `StepRows`; its gaps are changed.
        acceleration, turning: See `fill_rows`.
        offset: (rows,) offset of the velocities from J v; changed to that at the end of the step.
        found: The `StepResult`; its `u_start` is changed.
    """
    bends = np.empty(len(offset))
    rates(rows.values, rows.columns, rows.counts, work.acceleration, bends)
    for k in range(len(acceleration)):
        for e in range(3):
            still = turning[k, e] if e < 2 else 0.0
            bend = acceleration[k, e] + still - bends[3 * k + e]
            if e == 2:
                opened = k < len(rows.contacts) and bend > 0.0
                if not (opened and rows.gap[k] >= 0.5 * h * found.u_start[3 * k + e]):
                    rows.gap[k] -= 0.125 * h * h * bend
            found.u_start[3 * k + e] -= 0.5 * h * bend
            offset[3 * k + e] += 0.5 * h * bend


@inlined
def velocities(rows, offset, v, out):
    """Fill out (rows,) with the row velocities J v + offset [m/s]."""
    rates(rows.values, rows.columns, rows.counts, v, out)
    add(out, 1.0, offset)


@inlined
def number_of(work, rows, i):
    """Return the number of near contact i among all contacts, or of limit i − nc as n + limit."""
    nc = len(rows.contacts)
    return rows.contacts[i] if i < nc else work.contacts + rows.limits[i - nc]


@inlined
def part_to_touch(gap, first, last):
    """Return the fraction of a step after which a gap closes whose rate is linear in time.

    Args:
        gap: The gap at the start divided by the length of the step [m/s].
        first: Its rate at the start [m/s].
        last: Its rate at the end [m/s].
    """
    # gap + first s + (last − first) s²/2 = 0
    root = math.sqrt(max(first * first - 2.0 * (last - first) * gap, 0.0))
    share = 2.0 * gap / (root - first) if root > first else 1.0
    return min(max(share, 0.0), 1.0)


@inlined
def free_velocity(h, v, acceleration, system, predicted, out):
    """Fill out (nv,) with the velocity at the end of the step without impulses. (16.1)

    `acceleration` (nv,) is that at the midpoint, where v alone leads, and at the mean of v and `predicted`.
    The forces of damping are corrected linearly from `predicted` to the result, those of stiffness from v.
    """
    softened, damping, moved = system.softened, system.damping, np.empty(len(v))
    for c in range(len(v)):
        moved[c] = h * softened[c] * acceleration[c] - 0.5 * damping[c] * (predicted[c] - v[c])
    apply_symmetric(system.inverse, moved, out)  # most entries of `moved` are zero
    for c in range(len(v)):
        out[c] = v[c] + h * acceleration[c] - out[c]


@inlined
def find_arrivals(work, h, strikes, system, rows, acceleration, free, found):
    """Fill in which contacts and limits arrive: they close so fast that they have been apart. (theory.md, 16)

    Arriving contacts are left out of (16.2). If they close in the step, those with an impact law collide;
    others get their impulse in the next step, so that it is not divided between two steps.

    Args:
        work: The workspace.
        h: Length of the step [s].
        strikes: Whether impacts are allowed in this step.
        system: The `StepSystem`.
        rows: The `StepRows`.
        acceleration: (nc + nh, 3) of contacts without contact forces [m/s²].
        free: (rows,) velocities at the end of the step without impulses [m/s].
        found: The `StepResult`, with `u_start`; its `fast` and `arrives` are filled.
    """
    collides, u_start, arrives = system.collides, found.u_start, found.arrives
    nc, every = len(rows.contacts), len(rows.contacts) + len(rows.held)
    for i in range(nc + len(rows.limits)):
        row, place = normal_row(nc, every, i)
        # a sustained contact can close only as fast as the acceleration of the step makes it; forces of other
        # contacts, for example of a stack, are of the order of weights: twice that is an impact
        own = max(abs(free[row] - u_start[row]), h * system.gravity)
        if i < nc:
            own = max(own, h * abs(acceleration[i, 2]))
        may = (strikes and collides[number_of(work, rows, i)]) or rows.gap[place] > 0.0
        found.fast[i] = u_start[row] < -max(work.resting_speed, 2.0 * own)
        arrives[i] = may and found.fast[i]


@inlined
def contact_problem(work, h, system, rows, found, slow, free):
    """Return the `VelocityProblem` of a step, and which of its contacts and scalar rows take part.

    Args:
        work: The workspace.
        h: Length of the step [s].
        system: The `StepSystem`.
        rows: The `StepRows`.
        found: The `StepResult`, with `u_start`, `fast` and `arrives`; contacts that arrive do not take part.
        slow: Speed up to which overlap is closed [m/s].
        free: (rows,) velocities at the end of the step without impulses [m/s]; gap/h is added, so that gaps
            at the midpoint of the next step are not negative, and restitution e u⁻. (16.2), (16.5)
    """
    contacts, held, limits, dry, values, columns, counts, _, gap = rows
    nc, every, n = len(contacts), len(contacts) + len(held), len(free)
    friction, compliance, active = np.empty(nc), np.empty(nc), flags(n - 2 * nc, True)
    for i in range(nc):
        friction[i], compliance[i] = work.friction[contacts[i]], system.compliances[contacts[i]]
    for i in range(nc + len(limits)):
        row = normal_row(nc, every, i)[0]
        active[i if i < nc else row - 2 * nc] = not found.arrives[i]
        if found.fast[i]:
            free[row] += system.restitution[number_of(work, rows, i)] * found.u_start[row]
    lower, upper = np.empty(n - 3 * nc), np.empty(n - 3 * nc)
    for a in range(3 * nc, n):
        k = a - 3 * nc
        lower[k], upper[k] = -math.inf, math.inf
        if a >= 3 * every + len(limits):
            upper[k] = h * work.dry_friction[dry[a - 3 * every - len(limits)]] / values[a, 0]
            lower[k] = -upper[k]
        elif a >= 3 * every:
            lower[k] = 0.0
            free[a] += closing_speed(gap[a - 2 * every], slow, h)
    for i in range(every):
        free[3 * i + 2] += closing_speed(gap[i], slow, h) if i < nc else gap[i] / h
    problem = VelocityProblem(
        *(system.mass, system.inverse, system.start, values, columns, counts, free),
        *(law_of_steps(friction, lower, upper), compliance),
    )
    return problem, active


@inlined
def close_gaps(work, h, strikes, system, rows, found):
    """Fill in the gaps at the end of a step; return its first collision, normal work and overlap.

    Args:
        work: The workspace.
        h: Length of the step [s].
        strikes: Whether impacts are allowed in this step.
        system: The `StepSystem`.
        rows: The `StepRows`.
        found: The `StepResult`; its `gap_end` is filled.

    Returns:
        The fraction of the step until the first collision, one if there is none; the work of impulses along
        normals and limits until then [J]; the largest overlap, at the end, of contacts and limits that do not
        collide, or gap of held contacts [m].
    """
    nc, every, gap = len(rows.contacts), len(rows.contacts) + len(rows.held), rows.gap
    u_start, u_end, impulse, gap_end = found.u_start, found.u_end, found.impulse, found.gap_end
    share, work_done, overlap = 1.0, 0.0, 0.0
    for i in range(len(gap_end)):
        row, place = normal_row(nc, every, i)
        gap_end[i] = gap[place] + 0.5 * h * u_end[row]
        if not (strikes and found.arrives[i] and system.collides[number_of(work, rows, i)]):
            overlap = max(overlap, -gap_end[i])
        elif gap_end[i] < 0.0:
            part = part_to_touch(gap[place] / h - 0.5 * u_start[row], u_start[row], u_end[row])
            share = min(share, part)
    for k in range(nc, every):
        overlap = max(overlap, abs(gap[k]))
    for i in range(len(gap_end)):
        row = normal_row(nc, every, i)[0]
        work_done += share * impulse[row] * (u_start[row] + 0.5 * share * (u_end[row] - u_start[row]))
    return share, work_done, overlap


@inlined
def adds_energy(h, system, rows, v, pushed, found):
    """Return whether contacts add more energy in a step from v (nv,) than `STEPS_GAIN` allows.

    With rows of the midpoint and J v⁺ = 0 their work is −½ (J v)ᵀ W⁻¹ J v ≤ 0. The change b of the rows, and
    overlap that is closed, add ½ bᵀ W⁻¹ b, which is unbounded near a singular posture. (theory.md, 16)
    """
    work_done = energy = 0.0
    for a in range(3 * len(rows.surface)):
        work_done += 0.5 * found.impulse[a] * (found.u_start[a] + found.u_end[a])
    if work_done <= 0.0:
        return False
    for c in range(len(v)):
        for d in range(system.start[c], len(v)):
            if system.tree[d] != system.tree[c]:
                break
            energy += 0.5 * system.mass[c, d] * (v[c] * v[d] + h * h * pushed[c] * pushed[d])
    return work_done > STEPS_GAIN * energy


@inlined
def evaluate_in_still_axes(work, t, q, v):
    """Compute `work.acceleration` without contact forces, of free bodies in the fixed axes of the midpoint.

    Returns whether this succeeded. (16.1)
    """
    set_state(work, q, v)
    evaluate_without_contacts(work, t, np.empty(2))
    add_turning(work.joint_charts, v, 1.0, work.acceleration)
    return not work.callback_failed


@inlined
def add_change(work, system, change, v_end):
    """Add the change (nv,) by the impulses to the velocity at the end; it is zero at joints at rest."""
    for c in range(len(change)):
        v_end[c] = 0.0 if system.rests[work.velocity_joint[c]] else v_end[c] + change[c]


@inlined
def evaluate_both_sides(work, t, q, v, found, first, control):
    """Set the acceleration of struck islands to the mean of those before and after their impacts.

    Args:
        work: The workspace, with the acceleration at the mean velocity.
        t, q, v: As in `midpoint_step`.
        found: The `StepResult`; its `predicted` is set to the velocity after the impacts in struck islands.
        first, control: (nv,) acceleration and forces of the control at v.

    Returns:
        Whether this succeeded.
    """
    nv, struck = len(v), found.struck
    mean, own = work.acceleration.copy(), work.control_force.copy()
    for c in range(nv):
        if struck[c]:
            found.predicted[c] = found.v_end[c]
    if not evaluate_in_still_axes(work, t, q, found.predicted):
        return False
    for c in range(nv):
        work.acceleration[c] = 0.5 * (first[c] + work.acceleration[c]) if struck[c] else mean[c]
        work.control_force[c] = 0.5 * (control[c] + work.control_force[c]) if struck[c] else own[c]
    return True


@inlined
def rate_of_change(system, v, mean, first, second):
    """Return the change of acceleration (nv,) from `first` to `second` over that of velocity [1/s].

    It is that of the tree in which it is largest, in the norm of M: for a symmetric ∂f/∂v it is at most the
    largest eigenvalue of M⁻¹ ∂f/∂v. Changes of velocity that are rounding errors are left out.
    """
    nv, largest = len(v), 0.0
    changed = moved = size = 0.0
    for c in range(nv):
        if system.start[c] == c:
            changed = moved = size = 0.0
        for d in range(system.start[c], nv):
            if system.tree[d] != system.tree[c]:
                break
            changed += system.mass[c, d] * (second[c] - first[c]) * (second[d] - first[d])
            moved += system.mass[c, d] * (mean[c] - v[c]) * (mean[d] - v[d])
            size += system.mass[c, d] * mean[c] * mean[d]
        last = c + 1 == nv or system.tree[c + 1] != system.tree[c]
        if last and moved > NOISE * NOISE * size:
            largest = max(largest, changed / moved)
    return math.sqrt(largest)


@declared(
    *(SceneWorkspace, float, float, FLOATS, FLOATS, bool),
    *(StepSystem, StepRows, FLOATS, FLOATS, StepResult),
    result=FOUR_FLOATS,
)
@jit
def midpoint_step(work, t, h, q, v, strikes, system, rows, begin, pushed, found):
    """Take a time step (16.1), (16.2); repeat it without the change of the rows if contacts add energy.

    Args:
        work: The workspace.
        t: Time at the midpoint [s].
        h: Length of the step [s].
        q: (nq,) configuration at the midpoint.
        v: (nv,) velocity at the start, in the axes of the midpoint.
        strikes: Whether impacts are allowed in this step.
        system: The `StepSystem`.
        rows: The `StepRows`, with only the numbers of its rows set.
        begin: (nv,) warm start, see `step_impulses`.
        pushed: (nv,) mean acceleration by the impulses of the previous step; overwritten with that of this
            step.
        found: Is overwritten with the `StepResult`.

    Returns:
        The residual of Coulomb's law, see `step_impulses`, and the results of `close_gaps`.
    """
    first, before = begin.copy(), pushed.copy()
    for bent in (True, False):
        result = attempt(work, t, h, q, v, strikes, system, rows, begin, pushed, found, bent)
        found.bent[0] = bent and (work.callback_failed or not adds_energy(h, system, rows, v, pushed, found))
        if found.bent[0]:
            break
        if bent:
            assign(begin, first)
            assign(pushed, before)
    for c in range(len(v)):
        if found.struck[c]:  # impulses of impacts do not predict those of the next step
            pushed[c] = 0.0
    return result


@declared(
    *(SceneWorkspace, float, float, FLOATS, FLOATS, bool),
    *(StepSystem, StepRows, FLOATS, FLOATS, StepResult, bool),
    result=FOUR_FLOATS,
)
@external
def attempt(work, t, h, q, v, strikes, system, rows, begin, pushed, found, bent):
    """Take a step, with or without the change of rows (`bent`, see `StepResult`); see `midpoint_step`."""
    n, nv, slow = len(rows.counts), len(v), work.resting_speed if bent else 0.0
    offset, free, mean, change = np.empty(n), np.empty(n), np.empty(nv), np.empty(nv)
    acceleration, turning = np.empty((2, len(rows.contacts) + len(rows.held), 3))
    predicted, v_end = found.predicted, found.v_end
    if not evaluate_in_still_axes(work, t, q, v):
        return 0.0, 1.0, 0.0, 0.0
    first, control = work.acceleration.copy(), work.control_force.copy()
    fill_rows(work, v, rows, found.u_start, acceleration, turning)
    rates(rows.values, rows.columns, rows.counts, v, offset)
    for a in range(n):
        offset[a] = found.u_start[a] - offset[a]
    if bent:
        bend_rows(work, h, rows, acceleration, turning, offset, found)
    free_velocity(h, v, work.acceleration, system, v, predicted)
    velocities(rows, offset, predicted, free)
    find_arrivals(work, h, strikes, system, rows, acceleration, free, found)
    for c in range(nv):
        predicted[c] += h * pushed[c]  # with the impulses of the previous step
        mean[c] = 0.5 * (v[c] + predicted[c])
    assign(found.foreseen, predicted)
    if not evaluate_in_still_axes(work, t, q, mean):
        return 0.0, 1.0, 0.0, 0.0
    if work.calls[CONTROL] != 0:
        found.stiffness[0] = h * rate_of_change(system, v, mean, first, work.acceleration)
    free_velocity(h, v, work.acceleration, system, predicted, v_end)
    velocities(rows, offset, v_end, free)
    problem, active = contact_problem(work, h, system, rows, found, slow, free)
    noise = work.touching_gap / h
    given = SOFTEST, SETTLED, noise, begin, change, found.impulse, found.course
    residual = step_impulses(problem, active, system.tree, *given)
    add_change(work, system, change, v_end)
    if mark_struck(rows, system, active, found):
        if not evaluate_both_sides(work, t, q, v, found, first, control):
            return 0.0, 1.0, 0.0, 0.0
        free_velocity(h, v, work.acceleration, system, predicted, v_end)
        velocities(rows, offset, v_end, free)
        problem, active = contact_problem(work, h, system, rows, found, slow, free)
        for i in range(len(active)):
            row = first_row(len(rows.contacts), i)
            active[i] = active[i] and rows.counts[row] > 0 and found.struck[rows.columns[row, 0]]
        again = np.empty(n), np.empty(found.course.shape), begin.copy(), np.empty(nv)
        given = SOFTEST, SETTLED, noise, again[2], again[3], again[0], again[1]
        residual = max(residual, step_impulses(problem, active, system.tree, *given))
        replace_struck(rows, found, begin, change, again)
        add_change(work, system, change, v_end)
    for c in range(nv):
        if system.rests[work.velocity_joint[c]]:
            predicted[c] = 0.0
        else:
            pushed[c] = change[c] / h
    velocities(rows, offset, v_end, found.u_end)
    share, work_done, overlap = close_gaps(work, h, strikes, system, rows, found)
    return residual, share, work_done, overlap
