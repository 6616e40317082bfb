"""Which contacts stay closed at an instant, and what brings those that do back onto their surfaces.

Contacts have three rows (t₁, t₂, n), scalar rows (joint limits, then joints with dry friction) one.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner, jit
from ..._numeric.products import apply, products
from ..._numeric.semidefinite import factor, impulses
from ...robot._kernels.python_calls import call
from . import lie_charts, stages
from . import workspace as at
from .contact_forces import FREE, HELD, RIGID, SLIP, STICK, decide
from .dynamics import (
    ALLOWANCE,
    FAILED,
    INVERT,
    SLOWEST,
    STILL,
    UNIQUE,
    all_gaps,
    evaluate,
    follow_surface,
    look_closely,
    release,
    take,
)
from .workspace import d1, d2, d3, i1, i2, positions, put

FAR, NEAR, HIT = range(3)
"""Where a contact or limit is at an instant."""

SWEEPS = 20_000
SINGULAR = 1e-5
"""Forces whose effects cancel to this part are those of a singularity."""

LOOKS = 10
"""Parts of a step at which to ask whether modes still hold."""

STANDARD_GRAVITY = 9.80665


@inner
def answer(rows, minverse, response, matrix):
    """Fill the response M⁻¹ rowsᵀ, row by row, and the matrix rows M⁻¹ rowsᵀ."""
    for a in range(len(rows)):
        apply(minverse, rows[a], response[a])
    products(rows, response, matrix)


@inner
def take_away(rows, velocity, minverse, v):
    """Change v by impulses along the rows so that their velocities vanish; return the energy gained."""
    m, n = rows.shape
    response, matrix, x = np.empty((m, n)), np.empty((m, m)), np.empty(m)
    answer(rows, minverse, response, matrix)
    impulses(matrix, velocity, x)
    work = 0.0
    for a in range(m):
        for j in range(n):
            work -= 0.5 * x[a] * rows[a, j] * v[j]
    for a in range(m):
        for j in range(n):
            v[j] -= x[a] * response[a, j]
    for a in range(m):
        for j in range(n):
            work -= 0.5 * x[a] * rows[a, j] * v[j]
    return work


@inner
def closed_rows(v, slips, rows, speeds, mem):
    """Fill rows (m, nv), zero before, and their velocities of what is closed; return how many.

    Args:
        v: (nv,) velocity.
        slips: Whether the tangential rows of contacts that slip are among them.
        rows, speeds: With room for three rows a contact and the scalar rows.
        mem: The table of `memory`.
    """
    modes, jacobians, velocity = i1(mem, at.MODES), d3(mem, at.ROWS), d2(mem, at.VELOCITY)
    count = 0
    for k in range(len(modes)):
        for d in range(3):
            if d == 2 or slips or modes[k] != SLIP:
                put(rows[count], jacobians[k, d])
                speeds[count] = velocity[k, d]
                count += 1
    for j in i1(mem, at.SCALARS):
        rows[count, j] = 1.0
        speeds[count] = v[j]
        count += 1
    return count


@inner
def choose(t, q, v, candidates, standing, reference, breaking, mem):
    """Find what stays closed of the contacts, limits and joints that are at rest against each other.

    Args:
        t: Time [s].
        q: (nq,) configuration.
        v: (nv,) the velocity, which loses what closed contacts take away of it.
        candidates: Not zero for what touches, in the order of `STANDING`.
        standing: Takes the modes, like `STANDING`.
        reference: (n, 2) takes the directions of slip where they are known.
        breaking: (nv,) takes the force on each joint that its dry friction holds no longer.
        mem: The table of `memory`.

    Returns:
        The contact where slip drives the surface in and no force exists, or −1; whether the forces were
        found to the usual accuracy; the kinetic energy gained.
    """
    state = d1(mem, at.STATE)
    calls, acceleration, minverse = i1(mem, at.CALLS), d1(mem, at.ACCELERATION), d2(mem, at.MINVERSE)
    friction, bilateral, sign, dry = (
        d1(mem, at.FRICTION),
        i1(mem, at.BILATERAL),
        d1(mem, at.SIGN),
        d1(mem, at.DRY),
    )
    before = i1(mem, at.STANDING)
    count, limits, n = len(friction), len(sign), len(v)
    for i in range(len(standing)):
        standing[i] = FREE
    for i in range(count):
        reference[i, 0] = reference[i, 1] = 0.0
    for j in range(n):
        breaking[j] = 0.0
    contacts = positions(candidates[:count])
    joints = positions(candidates[count:])  # scalar rows: limits, then stuck joints
    nc, ns = len(contacts), len(joints)
    size = 3 * nc + ns
    take(q, v, mem)
    release(t, mem, np.empty(2))
    if state[FAILED] != 0.0 or not call(calls[INVERT], calls[INVERT + 1]):
        state[FAILED] = 1.0
        return -1, True, 0.0
    rows, response, delassus = np.zeros((size, n)), np.empty((size, n)), np.empty((size, size))
    velocity, free = np.empty((nc, 3)), np.empty(size)
    surface, mu, held = np.empty(3), np.empty(nc), np.empty(nc, dtype=np.bool_)
    for k in range(nc):
        b = 3 * k
        follow_surface(mem, contacts[k])
        look_closely(mem, contacts[k], rows[b : b + 3], velocity[k], free[b : b + 3], surface)
        mu[k], held[k] = friction[contacts[k]], bilateral[contacts[k]] != 0
    scalars, lower, upper = np.empty(ns, dtype=np.int64), np.empty(ns), np.empty(ns)
    for m in range(ns):
        scalars[m], lower[m], upper[m] = scalar_row(joints[m], mem)
        rows[3 * nc + m, scalars[m]] = 1.0
        free[3 * nc + m] = acceleration[scalars[m]]
    answer(rows, minverse, response, delassus)
    force, strength = np.zeros((nc, 3)), np.zeros(ns)
    slip = np.zeros((nc, 2))  # left zero where a contact may stick
    for k in range(nc):
        if slips_on(contacts[k], velocity[k, 0], velocity[k, 1], mem):
            slip[k, 0], slip[k, 1] = velocity[k, 0], velocity[k, 1]
    sweeps, jamming = decide(delassus, free, slip, mu, held, lower, upper, force, strength, SWEEPS, 1e-12)
    if jamming >= 0:
        b = 3 * jamming + 2
        return contacts[jamming], True, take_away(rows[b : b + 1], velocity[jamming, 2:], minverse, v)
    result = free.copy()
    largest = 0.0
    for a in range(size):
        largest = max(largest, abs(free[a]))
        for k in range(nc):
            for d in range(3):
                result[a] += delassus[a, 3 * k + d] * force[k, d]
        for m in range(ns):
            result[a] += delassus[a, 3 * nc + m] * strength[m]
    rank = factor(delassus, np.empty(size, dtype=np.int64), np.zeros((size, size)))
    stiffest = 0.0
    for a in range(size):
        stiffest = max(stiffest, delassus[a, a])
    for a in range(size):
        rank += delassus[a, a] <= RIGID * stiffest  # nothing moves this way
    unique = rank == size
    pace = (1e-11 if unique else 1e-9) * (largest + 1e-3 * STANDARD_GRAVITY)  # slower than this is none

    kept = np.zeros(size, dtype=np.bool_)  # rows whose velocity becomes zero
    for k in range(nc):
        b, i = 3 * k, contacts[k]
        normal, tangent = force[k, 2], math.hypot(force[k, 0], force[k, 1])
        speed = math.hypot(slip[k, 0], slip[k, 1])
        if held[k]:
            standing[i] = HELD
            kept[b : b + 3] = True
            continue
        if normal <= state[ALLOWANCE] and result[b + 2] > pace:
            kept[b + 2] = velocity[k, 2] < 0.0
            continue
        kept[b + 2] = True
        # a force on its cone means slip, unless another one would do, and then only what moves slips
        held_back = tangent <= mu[k] * normal * (1.0 - 1e-9)
        held_back |= not unique and math.hypot(result[b], result[b + 1]) <= pace
        if mu[k] > 0.0 and speed == 0.0 and held_back:
            standing[i] = STICK
            kept[b : b + 2] = True
            continue
        standing[i] = SLIP
        if speed == 0.0 and before[i] != SLIP:  # slip begins from rest
            kept[b : b + 2] = True
        reference[i, 0] = 1.0
        if speed > 0.0:
            reference[i, 0], reference[i, 1] = slip[k, 0] / speed, slip[k, 1] / speed
        elif tangent > 0.0:
            reference[i, 0], reference[i, 1] = -force[k, 0] / tangent, -force[k, 1] / tangent
    for m in range(ns):
        a, j = 3 * nc + m, joints[m]
        kept[a] = True
        if j < limits:
            kept[a] = abs(strength[m]) > state[ALLOWANCE] or sign[j] * result[a] <= pace
        elif abs(strength[m]) >= dry[scalars[m]] * (1.0 - 1e-9):
            kept[a] = False
            breaking[scalars[m]] = strength[m]
            v[scalars[m]] = 0.0
        standing[count + j] = 1 if kept[a] else 0
    taken = 0
    speeds = np.empty(size)
    for a in range(size):
        if kept[a]:
            speeds[taken] = velocity[a // 3, a % 3] if a < 3 * nc else v[scalars[a - 3 * nc]]
            put(rows[taken], rows[a])
            taken += 1
    return -1, sweeps >= 0, take_away(rows[:taken], speeds[:taken], minverse, v)


@inner
def slips_on(i, x, y, mem):
    """Whether a contact of tangential velocity (x, y) slips, or goes on slipping, however slowly."""
    state, which, modes, reference = (
        d1(mem, at.STATE),
        i1(mem, at.WHICH),
        i1(mem, at.MODES),
        d2(mem, at.REFERENCE),
    )
    if math.hypot(x, y) > state[STILL]:
        return True
    for k in range(len(which)):
        if which[k] == i and modes[k] == SLIP:
            return reference[k, 0] * x + reference[k, 1] * y > state[SLOWEST]
    return False


@inner
def scalar_row(j, mem):
    """Return velocity index and bounds of the force of a joint limit, past those of a stuck joint."""
    index, sign, dry = i1(mem, at.INDEX_V), d1(mem, at.SIGN), d1(mem, at.DRY)
    if j >= len(sign):
        j -= len(sign)
        return j, -dry[j], dry[j]
    return index[j], -math.inf if sign[j] < 0.0 else 0.0, math.inf if sign[j] > 0.0 else 0.0


@inner
def lay_out(reference, mem):
    """Lay out the arrays of what is closed, for the modes in `STANDING` and the directions of slip (n, 2)."""
    standing, friction, kept = i1(mem, at.STANDING), d1(mem, at.FRICTION), d1(mem, at.KEPT)
    count = len(friction)
    contacts, joints = positions(standing[:count]), positions(standing[count:])
    nc, ns, size = len(contacts), len(joints), len(joints)
    for i in contacts:
        size += 1 if standing[i] == SLIP else 3
    for row in range(at.WHICH, at.REST + 1):
        mem[row, 1] = nc
    for row in range(at.SCALARS, at.UPPER + 1):
        mem[row, 1] = ns
    for row in range(at.ROWS, at.DIRECTIONS + 1):
        mem[row, 1] = nc
    for row in range(at.EQUATIONS, at.SOLUTION + 1):
        mem[row, 1] = size
    mem[at.SYSTEM, 2] = size
    mem[at.FORCE, 1], mem[at.SCALAR_FORCE, 1] = nc, ns
    which, modes, mu, directions, rest = (
        i1(mem, at.WHICH),
        i1(mem, at.MODES),
        d1(mem, at.MU),
        d2(mem, at.REFERENCE),
        d1(mem, at.REST),
    )
    for k in range(nc):
        i = contacts[k]
        which[k], modes[k], mu[k], rest[k] = i, standing[i], friction[i], kept[i]
        put(directions[k], reference[i])
    scalars, lower, upper = i1(mem, at.SCALARS), d1(mem, at.LOWER), d1(mem, at.UPPER)
    for m in range(ns):
        scalars[m], lower[m], upper[m] = scalar_row(joints[m], mem)
    d1(mem, at.STATE)[UNIQUE] = 1.0


@jit
def hold(mem):
    """Close what the scene holds, and nothing else."""
    standing, bilateral = i1(mem, at.STANDING), i1(mem, at.BILATERAL)
    for i in range(len(standing)):
        standing[i] = HELD if i < len(bilateral) and bilateral[i] != 0 else FREE
    lay_out(np.zeros((len(bilateral), 2)), mem)


@jit
def approach(q, v, near, starting, rest, quiet, watched, slow, mem):
    """Return which contact or limit to resolve an impact of, or −1, and its gap rate [m/s].

    Args:
        q: (nq,) configuration.
        v: (nv,) velocity.
        near: Gap [m] at which a contact counts as touching.
        starting: Whether the motion starts now, so that what touches has just closed its gap.
        rest: The resting speed [m/s], zero if no contact is to stay closed.
        quiet: Approach [m/s] below which there is none, for what has just closed its gap.
        watched: (n + nl,) `FAR`, `NEAR` or `HIT` (its gap closes now); what is near is added.
        slow: (n + nl,) takes what touches and approaches or parts no faster than the resting speed.
        mem: The table of `memory`.
    """
    bilateral, standing = i1(mem, at.BILATERAL), i1(mem, at.STANDING)
    count = len(bilateral)
    found = np.empty((len(watched), 2))
    all_gaps(q, v, found, mem)
    fastest, hit = 0.0, -1
    for i in range(len(watched)):
        gap, rate = found[i, 0], found[i, 1]
        slow[i] = 0
        if i < count and bilateral[i] != 0:
            slow[i] = 1
            continue
        if watched[i] == FAR and (gap <= near or standing[i] != FREE):
            watched[i] = HIT if starting and gap <= near else NEAR
        if watched[i] == FAR:
            continue
        if (rate < -rest or (watched[i] == HIT and rate < -quiet)) and rate < fastest:
            fastest, hit = rate, i
        if rest > 0.0 and abs(rate) <= rest:
            slow[i] = 1
    return hit, fastest


@jit
def settle(t, q, v, slow, mem):
    """Set the modes of what touches without bouncing (`slow`, see `approach`); results as of `choose`."""
    standing, dry, sliding = i1(mem, at.STANDING), d1(mem, at.DRY), d1(mem, at.SLIDING)
    still = d1(mem, at.STATE)[STILL]
    n, touching = len(v), len(slow)
    candidates, chosen = np.zeros(touching + n, dtype=np.int64), np.zeros(touching + n, dtype=np.int64)
    for i in range(touching):
        candidates[i] = slow[i]
    for j in range(n):
        if dry[j] > 0.0:
            candidates[touching + j] = abs(v[j]) <= still
            sliding[j] = 0.0 if abs(v[j]) <= still else math.copysign(dry[j], v[j])
    reference, breaking = np.zeros((len(d1(mem, at.FRICTION)), 2)), np.zeros(n)
    jamming, converged, work = -1, True, 0.0
    if len(positions(candidates)) > 0:
        jamming, converged, work = choose(t, q, v, candidates, chosen, reference, breaking, mem)
        if jamming >= 0 or d1(mem, at.STATE)[FAILED] != 0.0:
            return jamming, converged, work
    for j in range(n):
        if breaking[j] != 0.0:
            sliding[j] = -math.copysign(dry[j], breaking[j])
    put(standing, chosen)
    lay_out(reference, mem)
    return jamming, converged, work


@jit
def end_of_modes(t, h, end, q0, v0, coefficients, mem):
    """Return the first time in a step from which no forces exist for the modes that hold; infinite if none.

    Where forces are not unique, those of least norm may leave their bounds while others do not.

    Args:
        t: Its start [s].
        h: Its length [s].
        end: The time up to which to look.
        q0, v0: The state at its start.
        coefficients: Its dense output, see `stages.interpolate`.
        mem: The table of `memory`.
    """
    standing = i1(mem, at.STANDING)
    chosen = np.empty(len(standing), dtype=np.int64)
    reference = np.empty((len(d1(mem, at.FRICTION)), 2))
    q, v, breaking = np.empty(len(q0)), np.empty(len(v0)), np.empty(len(v0))
    earlier, later, part = t, math.inf, 1
    while d1(mem, at.STATE)[FAILED] == 0.0:
        if later == math.inf:
            time = end if part == LOOKS else t + (end - t) * part / LOOKS
        else:
            time = 0.5 * (earlier + later)
            if not earlier < time < later:
                break
        stages.state(coefficients, (time - t) / h, i2(mem, at.JOINTS), q0, v0, q, v)
        choose(time, q, v, standing, chosen, reference, breaking, mem)
        changed = False
        for i in range(len(chosen)):
            changed |= chosen[i] != standing[i]
        if changed:
            later = time
        elif time == end:
            break
        else:
            earlier, part = time, part + 1
    return later


@jit
def jam(t, q, v, certain, mem):
    """Stop all slip where contacts that slip drive the surface in until their forces have no bound.

    Args:
        t: Time [s].
        q: (nq,) configuration.
        v: (nv,) the velocity, which loses what the closed contacts take away of it.
        certain: Whether this is known to be such a place, so that any slip is stopped.
        mem: The table of `memory`.

    Returns:
        Whether slip was stopped; else v is as it was.
    """
    modes, slipping = i1(mem, at.MODES), False
    for k in range(len(modes)):
        slipping |= modes[k] == SLIP
    if not slipping:
        return False
    take(q, v, mem)
    evaluate(t, mem, np.empty(len(v) + 4))
    if d1(mem, at.STATE)[FAILED] != 0.0:
        return False
    force, strength, minverse = d2(mem, at.FORCE), d1(mem, at.SCALAR_FORCE), d2(mem, at.MINVERSE)
    closed, n = 3 * len(modes), len(v)
    size = closed + len(strength)
    rows, speeds = np.zeros((size, n)), np.empty(size)
    closed_rows(v, True, rows, speeds, mem)
    response, delassus = np.empty((size, n)), np.empty((size, size))
    answer(rows, minverse, response, delassus)
    left = whole = 0.0  # what the forces do to the normals, where near the singularity they cancel
    for k in range(len(modes)):
        total = 0.0
        for a in range(size):
            push = force[a // 3, a % 3] if a < closed else strength[a - closed]
            part = delassus[3 * k + 2, a] * push
            total += part
            whole = max(whole, abs(part))
        left = max(left, abs(total))
    if not certain and not left < SINGULAR * whole:
        return False
    take_away(rows, speeds, minverse, v)
    return True


@jit
def correct(t, q, v, mem):
    """Bring the closed contacts back onto their surfaces; return the kinetic energy gained.

    Args:
        t: Time [s].
        q: (nq,) the configuration, which is changed.
        v: (nv,) the velocity, which is changed.
        mem: The table of `memory`.
    """
    state = d1(mem, at.STATE)
    joints = i2(mem, at.JOINTS)
    minverse = d2(mem, at.MINVERSE)
    jacobians, gap, rest = d3(mem, at.ROWS), d1(mem, at.GAP), d1(mem, at.REST)
    index_q, index_v, bound = i1(mem, at.INDEX_Q), i1(mem, at.INDEX_V), d1(mem, at.BOUND)
    n, nc, ns = len(v), len(gap), len(i1(mem, at.SCALARS))
    shut = i1(mem, at.STANDING)[len(d1(mem, at.FRICTION)) :][: len(bound)]
    rates = np.empty(n + 4)
    rows = np.zeros((3 * nc + ns + len(shut), n))
    off = np.empty(len(rows))
    take(q, v, mem)
    evaluate(t, mem, rates)
    count = 0
    for k in range(nc):
        put(rows[count], jacobians[k, 2])
        off[count] = gap[k] - rest[k]
        count += 1
    for m in range(len(shut)):
        if shut[m] != 0:
            rows[count, index_v[m]] = 1.0
            off[count] = q[index_q[m]] - bound[m]
            count += 1
    if count > 0 and state[FAILED] == 0.0:
        xi, start = np.zeros(n), q.copy()
        take_away(rows[:count], off[:count], minverse, xi)
        lie_charts.advance(joints, start, xi, q)
        for m in range(len(shut)):
            if shut[m] != 0:
                q[index_q[m]] = bound[m]
        put(d1(mem, at.Q), q)
        evaluate(t, mem, rates)
    rows = np.zeros((3 * nc + ns + len(shut), n))
    count = closed_rows(v, False, rows, off, mem)
    if count == 0 or state[FAILED] != 0.0:
        return 0.0
    return take_away(rows[:count], off[:count], minverse, v)
