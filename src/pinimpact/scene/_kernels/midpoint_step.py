"""A time step: its rows at the midpoint, what collides in it, and the contact problem. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import flags
from ..._numeric.products import apply_symmetric
from ..._numeric.proximal_newton import rates
from ..._numeric.tolerances import SETTLED
from ...geometry._kernels.constants import RADIUS
from .contact_forces import FREE, HELD, SLIP, STICK
from .dynamics import (
    FAR,
    compute_kinematics,
    contact_gap,
    evaluate_without_contacts,
    follow_surface,
    limit_gap,
    motion_by_columns,
    moving_columns,
    set_state,
    sphere_gap,
)
from .force_evaluation import places_of_contacts
from .lie_charts import chart_rate
from .step_impulses import step_impulses
from .workspace import SceneWorkspace


@declared(SceneWorkspace, FLOATS, FLOATS, float, float, FLAGS, FLAGS, bool, INTEGERS, result=int)
@jit
def near_rows(work, q, v, h, slack, idle, rests, placed, near):
    """Fill which contacts, and limits past those, may close within a step; return how many.

    Args:
        work: The workspace.
        q: (nq,) configuration at the midpoint.
        v: (nv,) velocity.
        h: Length of the step [s].
        slack: What gaps may close by beside their rates [m or rad].
        idle: (n,) contacts that are kept for shapes which are apart.
        rests: (nj,) joints that are at rest, the world among them.
        placed: Whether kinematics are those of this state already.
        near: (n + nl,) takes the numbers, without held contacts.
    """
    if not placed:
        set_state(work, q, v)
        compute_kinematics(work)
    blocks, ends, count = work.contact_blocks, work.contact_joints, 0
    for b in range(len(blocks)):
        first, stop, k = blocks[b, 0], blocks[b, 1], blocks[b, 2]
        if k >= 0 and not (rests[ends[first, 0]] and rests[ends[first, 1]]):
            gap, _ = sphere_gap(work, k, first)
            if gap > FAR * work.sphere_constants[k, RADIUS]:
                continue
        for i in range(first, stop):
            if not idle[i] and work.bilateral[i] == 0 and not (rests[ends[i, 0]] and rests[ends[i, 1]]):
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
def fill_rows(work, v, contacts, held, limits, dry, values, columns, counts, u, surface, acceleration, gap):
    """Fill the rows of a step at the state last evaluated, and their velocities; see `midpoint_step`."""
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
            work, i, moving, signs[:count], jacobian, motion, acceleration[k], surface[k]
        )
        gap[k] -= work.rest_gap[i]
        for e in range(3):
            u[a + e], counts[a + e] = motion[e], count
            for m in range(count):
                values[a + e, m], columns[a + e, m] = jacobian[e, m], columns[a, m]
    for k in range(len(limits)):
        a = 3 * every + k
        values[a, 0], columns[a, 0], counts[a] = work.limit_sign[limits[k]], work.limit_v[limits[k]], 1
        gap[every + k], u[a] = limit_gap(work, limits[k], work.q, v)
    for k in range(len(dry)):
        a = 3 * every + len(limits) + k
        values[a, 0], columns[a, 0], counts[a], u[a] = 1.0, dry[k], 1, v[dry[k]]


@inlined
def velocities(values, columns, counts, offset, v, out):
    """Fill out (n,) with J v + offset."""
    rates(values, columns, counts, v, out)
    for a in range(len(out)):
        out[a] += offset[a]


@inlined
def part_to_touch(gap, first, last):
    """Return the part of a step after which a gap closes, whose rate goes linearly from one to another.

    Args:
        gap: The gap at the start over the length of the step [m/s].
        first: Its rate at the start [m/s].
        last: Its rate at the end [m/s].
    """
    # gap + first s + (last − first) s²/2 = 0
    root = math.sqrt(max(first * first - 2.0 * (last - first) * gap, 0.0))
    share = 2.0 * gap / (root - first) if root > first else 1.0
    return min(max(share, 0.0), 1.0)


@inlined
def free_velocity(h, v, acceleration, inverse, softened, predicted, out):
    """Fill v (nv,) at the end of the step without impulses; `softened` forces are those of its end."""
    moved = np.empty(len(v))
    for c in range(len(v)):
        moved[c] = softened[c] * (h * acceleration[c] - (predicted[c] - v[c]))
    apply_symmetric(inverse, moved, out)  # many are not softened
    for c in range(len(v)):
        out[c] = v[c] + h * acceleration[c] - out[c]


@declared(
    *(SceneWorkspace, float, float, FLOATS, FLOATS, float, FLAGS, FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS),
    *(INTEGERS, FLAGS, INTEGERS, INTEGERS, INTEGERS, INTEGERS),
    *(FLOATS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, INTEGERS),
    *(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLAGS, FLOATS, FLOATS, FLOATS, FLOATS),
    result=float,
)
@jit
def midpoint_step(
    work,
    t,
    h,
    q,
    v,
    touching,
    bounces,
    compliances,
    softened,
    mass,
    inverse,
    tree,
    rests,
    contacts,
    held,
    limits,
    dry,
    begin,
    pushed,
    values,
    columns,
    counts,
    surface,
    gap,
    impulse,
    u_start,
    u_end,
    arrives,
    predicted,
    v_end,
    gap_end,
    numbers,
):
    """Take a step; return how far its impulses are from Coulomb's law, see `step_impulses`.

    Rows are three of each contact, three of each held one, then those of limits and of dry joints.

    Args:
        work: The workspace.
        t: Time at the midpoint [s].
        h: Length of the step [s].
        q: (nq,) configuration at the midpoint.
        v: (nv,) velocity at the start.
        touching: Gap above which what is open can arrive [m]; infinite where nothing is to collide.
        bounces: (n + nl,) which contacts and limits have restitution.
        compliances: (n,) of all contacts.
        softened: (nv,) what damping and drives add to M.
        mass: (nv, nv) M with that.
        inverse: (nv, nv) of it.
        tree: (nv,) number of the tree that each velocity belongs to.
        rests: (nj,) joints that are at rest, the world among them; their velocity is zero and stays so.
        contacts: (nc,) that are near.
        held: (nh,) that are held.
        limits: (nl,) that are near.
        dry: (nd,) velocities of joints with dry friction.
        begin: (nv,) see `step_impulses`.
        pushed: (nv,) mean acceleration by the impulses of the step before; takes that of this one.
        values: (rows, …) takes what is not zero of each row of the Jacobian.
        columns: (rows, …) takes where that stands, in ascending order.
        counts: (rows,) takes how much there is.
        surface: (nc + nh, 3) takes velocities of the surfaces [m/s].
        gap: (nc + nh + nl,) takes the gaps at the midpoint [m or rad].
        impulse: (rows,) takes the impulses.
        u_start: (rows,) takes the velocities of the rows at the start.
        u_end: (rows,) takes those at the end.
        arrives: (nc + nl,) takes what closes so fast that it collides: it has no impulse here.
        predicted: (nv,) takes the velocity with which forces were evaluated at the end.
        v_end: (nv,) takes the velocity at the end.
        gap_end: (nc + nl,) takes the gaps at the end [m or rad].
        numbers: (3,) takes the part of the step until what arrives first touches, one if nothing does; the
            work of impulses along normals and limits until then [J]; and by how much what has taken part
            overlaps at the end, or what is held is off [m or rad].
    """
    n, nv, nc, every = len(counts), len(v), len(contacts), len(contacts) + len(held)
    offset, free, powers, mean = np.empty(n), np.empty(n), np.empty(2), np.empty(nv)
    acceleration, friction, compliance = np.empty((every, 3)), np.empty(nc), np.empty(nc)
    set_state(work, q, v)
    evaluate_without_contacts(work, t, powers)
    if work.callback_failed:
        return 0.0
    fill_rows(
        *(work, v, contacts, held, limits, dry, values, columns, counts),
        *(u_start, surface, acceleration, gap),
    )
    rates(values, columns, counts, v, offset)
    for a in range(n):
        offset[a] = u_start[a] - offset[a]
    free_velocity(h, v, work.acceleration, inverse, softened, v, predicted)
    velocities(values, columns, counts, offset, predicted, free)
    active = flags(n - 2 * nc, True)
    for i in range(nc + len(limits)):
        row = 3 * i + 2 if i < nc else 3 * every + i - nc
        number = contacts[i] if i < nc else work.contacts + limits[i - nc]
        height = gap[i] if i < nc else gap[every + i - nc]
        # what is apart and closes faster than the step's own acceleration makes: an impact
        own = abs(free[row] - u_start[row])
        if i < nc:
            own = max(own, h * abs(acceleration[i, 2]))
            friction[i], compliance[i] = work.friction[number], compliances[number]
        arrives[i] = (
            bounces[number]
            and u_start[row] < -max(work.resting_speed, 2.0 * own)
            and height - 0.5 * h * u_start[row] > touching
        )
        active[i if i < nc else row - 2 * nc] = not arrives[i]
    for c in range(nv):
        predicted[c] += h * pushed[c]  # by impulses as in the step before
        mean[c] = 0.5 * (v[c] + predicted[c])
    set_state(work, q, mean)
    evaluate_without_contacts(work, t, powers)
    if work.callback_failed:
        return 0.0
    free_velocity(h, v, work.acceleration, inverse, softened, predicted, v_end)
    velocities(values, columns, counts, offset, v_end, free)
    lower, upper = np.empty(n - 3 * nc), np.empty(n - 3 * nc)
    for a in range(3 * nc, n):
        k = a - 3 * nc
        lower[k], upper[k] = -math.inf, math.inf
        if a >= 3 * every + len(limits):
            upper[k] = h * work.dry_friction[dry[a - 3 * every - len(limits)]]
            lower[k] = -upper[k]
        elif a >= 3 * every:
            lower[k] = 0.0
            free[a] += 2.0 * max(gap[a - 2 * every], 0.0) / h
    for i in range(every):
        free[3 * i + 2] += 2.0 * (max(gap[i], 0.0) if i < nc else gap[i]) / h
    off = step_impulses(
        *(
            mass,
            inverse,
            values,
            columns,
            counts,
            free,
            friction,
            lower,
            upper,
            compliance,
            active,
            tree,
            SETTLED,
        ),
        *(begin, mean, impulse),
    )
    for c in range(nv):
        if rests[work.velocity_joint[c]]:
            v_end[c] = predicted[c] = 0.0
        else:
            v_end[c] += mean[c]
            pushed[c] = mean[c] / h
    velocities(values, columns, counts, offset, v_end, u_end)
    share, work_done, overlap = 1.0, 0.0, 0.0
    for i in range(nc + len(limits)):
        row = 3 * i + 2 if i < nc else 3 * every + i - nc
        height = gap[i] if i < nc else gap[every + i - nc]
        gap_end[i] = height + 0.5 * h * u_end[row]
        if not arrives[i]:
            overlap = max(overlap, -gap_end[i])
        elif gap_end[i] < 0.0:
            share = min(share, part_to_touch(height / h - 0.5 * u_start[row], u_start[row], u_end[row]))
    for k in range(nc, every):
        overlap = max(overlap, abs(gap[k]))
    for i in range(nc + len(limits)):
        row = 3 * i + 2 if i < nc else 3 * every + i - nc
        work_done += share * impulse[row] * (u_start[row] + 0.5 * share * (u_end[row] - u_start[row]))
    numbers[0], numbers[1], numbers[2] = share, work_done, overlap
    return off


@declared(
    *(SceneWorkspace, float, float, FLOATS, FLOATS, FLOATS, FLOATS, FLAGS),
    *(INTEGERS, INTEGERS, INTEGERS, INTEGERS),
    *(FLOAT_ROWS, INTEGER_ROWS, INTEGERS, FLOAT_ROWS, FLOATS, FLOATS, FLOATS),
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOATS),
    result=bool,
)
@jit
def report_step(
    work,
    h,
    still,
    v,
    v_end,
    softened,
    predicted,
    rests,
    contacts,
    held,
    limits,
    dry,
    values,
    columns,
    counts,
    surface,
    impulse,
    u_start,
    u_end,
    coefficients,
    world,
    points,
    normals,
    joints,
):
    """Fill dense output, modes and mean forces of a step just taken; return whether any force acts.

    The velocity is linear in time, and so are the powers.

    Args:
        work: The workspace; its modes are set.
        h: Length of the step [s].
        still: Speed up to which nothing slips [m/s].
        v: (nv,) velocity at the start.
        v_end: (nv,) at the end.
        softened: (nv,) as of `midpoint_step`, like the arguments up to `u_end`.
        predicted: (nv,) likewise.
        rests: (nj,) likewise; the modes of what rests stay.
        contacts: (nc,) likewise.
        held: (nh,) likewise.
        limits: (nl,) likewise.
        dry: (nd,) likewise.
        values: (rows, …) likewise.
        columns: (rows, …) likewise.
        counts: (rows,) likewise.
        surface: (nc + nh, 3) likewise.
        impulse: (rows,) likewise.
        u_start: (rows,) likewise.
        u_end: (rows,) likewise.
        coefficients: (terms, 2 nv + works) takes the dense output; zero before.
        world: (nc + nh, 3) takes the forces in world axes [N]; zero before, like those that follow.
        points: (nc + nh, 3) takes where they act [m].
        normals: (nc + nh, 3) takes the normals there.
        joints: (nv,) takes the forces of limits and dry friction.
    """
    nv, nc, every, modes, acts = len(v), len(contacts), len(contacts) + len(held), work.modes, False
    turn, rate, mean, dried = np.empty(nv), np.empty(nv), np.empty(nv), np.zeros(nv)
    for c in range(nv):
        mean[c] = 0.5 * (v[c] + v_end[c])
        turn[c] = 0.5 * h * mean[c]
    chart_rate(work.joint_charts, turn, mean, rate)
    for i in range(work.contacts):
        if not (rests[work.contact_joints[i, 0]] and rests[work.contact_joints[i, 1]]):
            modes[i] = FREE
    for k in range(work.limits):
        if not rests[work.velocity_joint[work.limit_v[k]]]:
            modes[work.contacts + k] = FREE
    for c in range(nv):
        if not rests[work.velocity_joint[c]]:
            modes[work.contacts + work.limits + c] = FREE
    powers = np.zeros((4, 2))  # of control and drives, of joints, of sliding friction, of surfaces
    for k in range(len(dry)):
        row = 3 * every + len(limits) + k
        dried[dry[k]] = impulse[row]
        modes[work.contacts + work.limits + dry[k]] = 1 if abs(u_end[row]) <= still else 0
    for k in range(len(limits)):
        modes[work.contacts + limits[k]] = 1 if impulse[3 * every + k] > 0.0 else 0
    for c in range(nv):
        coefficients[0, c] = h * rate[c]
        coefficients[1, c] = -0.5 * h * (v_end[c] - v[c])
        coefficients[0, nv + c] = v_end[c] - v[c]
        follows = (softened[c] - 0.5 * h * work.damping[c]) * (v_end[c] - predicted[c])
        pushed, lost = h * work.control_force[c] - follows, dried[c] - h * work.damping[c] * mean[c]
        for e in range(2):
            speed = v[c] if e == 0 else v_end[c]
            powers[0, e] += pushed * speed
            powers[1, e] += lost * speed
    index, axes = np.empty(every, dtype=np.int64), np.empty((every, 3, 3))
    for k in range(every):
        index[k] = contacts[k] if k < nc else held[k - nc]
    places_of_contacts(work, index, axes, points)
    for k in range(every):
        i, a = index[k], 3 * k
        for e in range(3):
            normals[k, e] = axes[k, 2, e]
            for o in range(3):
                world[k, e] += impulse[a + o] / h * axes[k, o, e]
            for o in range(2):
                powers[3, o] += impulse[a + e] * surface[k, e]
        if k >= nc:
            modes[i] = HELD
            continue
        for e in range(2):
            powers[2, 0] += impulse[a + e] * u_start[a + e]
            powers[2, 1] += impulse[a + e] * u_end[a + e]
        if impulse[a + 2] > 0.0:
            slips = math.hypot(u_end[a], u_end[a + 1]) > still or work.friction[i] == 0.0
            modes[i] = SLIP if slips else STICK
    for k in range(4):
        coefficients[0, 2 * nv + k] = 0.5 * (powers[k, 0] + powers[k, 1])
        coefficients[1, 2 * nv + k] = 0.5 * (powers[k, 0] - powers[k, 1])
    for a in range(len(impulse)):
        acts = acts or impulse[a] != 0.0
        if a >= 3 * every and impulse[a] != 0.0:
            for k in range(counts[a]):
                joints[columns[a, k]] += impulse[a] / h * values[a, k]
    return acts
