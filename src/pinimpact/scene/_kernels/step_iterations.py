"""Derivatives of the iterations that solve the contact problem of a time step. (derivatives.md, 12)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import (
    FLAGS,
    FLOAT_ROWS,
    INTEGERS,
    FloatRows,
    Floats,
    FloatStack,
    declared,
)
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign, filled, flags, repeated
from ..._numeric.lu import factorize, substitute
from ..._numeric.products import add, add_product
from ..._numeric.tolerances import ROUNDING, SETTLED, TINY
from ...robot._kernels.configuration_slopes import force_slopes
from ...robot._kernels.row_slopes import Rows, row_slopes


class Law(NamedTuple):
    """The law of the rows of a step: 3 nc rows of contacts, then of held contacts, limits, and dry joints.

    Attributes:
        contacts: Number nc of contacts.
        limits, dry: The first row of limits, and of dry joints.
        friction: (nc,) coefficients of friction.
        bounds: (nd,) bounds of the impulses of dry joints.
        speed: Largest velocity of a row [m/s].
        h: Step size [s].
    """

    contacts: int
    limits: int
    dry: int
    friction: Floats
    bounds: Floats
    speed: float
    h: float


class Places(NamedTuple):
    """The contacts of a step, near and held.

    Attributes:
        rows: Their places.
        axes: (k, 3, 3) axes of the rows of the step.
        turns: (k, 3, 3) rotations from the axes of `rows` to those of the step.
    """

    rows: Rows
    axes: FloatStack
    turns: FloatStack


class Changes(NamedTuple):
    """Changes of the data of a step, n columns.

    Attributes:
        jacobian: (rows, nv) Jacobian of the rows.
        total: (nv, nv) M + S.
        softer: (nv,) derivative of S by the step size.
        middle: (nv, n) changes of the configuration.
        length: (n,) changes of the step size [s].
        known: (nv, n) changes of the forces, for constant impulses and velocities.
        closing: (rows, n) changes of the velocities of the rows, for constant velocities at the end.
        softened: (rows, n) relative changes of r.
        by_friction: (rows, n) changes of the friction of the row's contact.
    """

    jacobian: FloatRows
    total: FloatRows
    softer: Floats
    middle: FloatRows
    length: Floats
    known: FloatRows
    closing: FloatRows
    softened: FloatRows
    by_friction: FloatRows


class Course(NamedTuple):
    """The iterations of (16.3), some of which may have ended for some rows.

    Attributes:
        r: (…, rows) r; zero for rows whose iterations have ended.
        before, after: (…, rows) impulses before and after each iteration [N s].
        u: (…, rows) velocities of the rows that it makes vanish [m/s].
        shift: (…, nv) difference of the velocities from those at the end of the step.
        of_mass: (…, nv, nv) ∂(M `shift`)/∂q.
    """

    r: FloatRows
    before: FloatRows
    after: FloatRows
    u: FloatRows
    shift: FloatRows
    of_mass: FloatStack


@declared(Law, Places, Changes, Course, bool, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def iterate(law, places, changes, course, otherwise, v_end, impulses, forces):
    """Compute the changes in a step after all iterations; return whether P has a kink in any. (D40)

    Args:
        law, places, changes, course: The step.
        otherwise: Whether to decide ties the opposite way.
        v_end: (nv, n) is overwritten with the changes of the velocity; those without impulses before.
        impulses: (rows, n) is overwritten with the changes of the impulses; zero before.
        forces: (nv, nv) is overwritten with ∂(Jᵀf)/∂q of the last iteration; zero before.
    """
    jacobian, (size, nv), tied = changes.jacobian, changes.jacobian.shape, False
    stiff, passed = np.empty((size, size)), np.empty(impulses.shape)
    matrix, order = np.empty((nv, nv)), np.empty(nv, dtype=np.int64)
    for i in range(len(course.r)):
        tied |= _iteration(law, places, changes, course, i, otherwise, stiff, impulses, forces)
        _add_stiffness(changes.total, stiff, jacobian, matrix)
        for j in range(nv):
            assign(v_end[j], changes.known[j])
            add(v_end[j], -changes.softer[j] * course.shift[i, j], changes.length)
        add_product(forces - course.of_mass[i], changes.middle, v_end)
        for a in range(size):
            for j in range(nv):
                if jacobian[a, j] != 0.0:
                    add(v_end[j], jacobian[a, j], impulses[a])
        factorize(matrix, order)
        substitute(matrix, order, v_end)
        passed[:, :] = 0.0
        add_product(jacobian, v_end, passed)
        _subtract(stiff, passed, impulses)
    return tied


@inlined
def _iteration(law, places, changes, course, i, otherwise, stiff, impulses, forces):
    """Replace the changes of the impulses by those of iteration i for a constant velocity; return ties.

    `stiff` (rows, rows) is filled with ∂P/r, and `forces` (nv, nv) with ∂(Jᵀf)/∂q.
    """
    r, now, u, size = course.r[i], course.after[i], course.u[i], len(impulses)
    rate, slopes, by_friction = np.zeros(size), np.zeros((size, size)), np.zeros(size)
    for a in range(size):
        if r[a] > 0.0:
            rate[a] = 1.0 / r[a]
    tied = _fill_slopes(law, r, rate, course.before[i] - u * rate, now, otherwise, slopes, by_friction)
    _fill_forces(places, now, forces)
    moving, earlier = changes.closing.copy(), impulses.copy()
    _add_motion(places, course.shift[i], changes.middle, moving)
    for a in range(size):
        if r[a] > 0.0:
            filled(impulses[a], 0.0)
            for b in range(size):
                if slopes[a, b] != 0.0:
                    part = slopes[a, b] * rate[b]
                    add(impulses[a], slopes[a, b], earlier[b])
                    add(impulses[a], -part, moving[b])
                    add(impulses[a], part * u[b], changes.softened[a])
            add(impulses[a], by_friction[a], changes.by_friction[a])
            if a >= law.dry and slopes[a, a] == 0.0:
                add(impulses[a], now[a] / law.h, changes.length)
        for b in range(size):
            stiff[a, b] = slopes[a, b] * rate[b]
    return tied


@inlined
def _add_stiffness(total, stiff, jacobian, matrix):
    """Fill matrix (nv, nv) with `total` + Jᵀ · `stiff` · J."""
    size, nv = jacobian.shape
    pressed = np.zeros((size, nv))
    _subtract(stiff, jacobian, pressed)
    for j in range(nv):
        assign(matrix[j], total[j])
    for a in range(size):
        for j in range(nv):
            if jacobian[a, j] != 0.0:
                add(matrix[j], -jacobian[a, j], pressed[a])


@inlined
def _subtract(left, right, out):
    """Subtract left (k, m), sparse, times right (m, n) from out (k, n)."""
    for a in range(len(left)):
        for b in range(len(right)):
            if left[a, b] != 0.0:
                add(out[a], -left[a, b], right[b])


@inlined
def _fill_forces(places, now, forces):
    """Fill ∂(Jᵀf)/∂q (nv, nv) for impulses of the contacts that are fixed in their axes. (D20)"""
    forces[:, :] = 0.0
    rows, world = places.rows, np.empty(3)
    for k in range(len(rows.tips)):
        for d in range(3):
            world[d] = 0.0
            for e in range(3):
                world[d] += now[3 * k + e] * places.axes[k, e, d]
        force_slopes(
            *(rows.J, rows.joint, rows.parent, rows.at[k], rows.shifts[k]),
            *(world[0], world[1], world[2], forces),
        )


@inlined
def _add_motion(places, shift, middle, moving):
    """Add the changes of J `shift` with the configuration to those of the velocities of contacts. (D19)"""
    moved, turned = np.empty((len(places.axes), 3, len(shift))), np.empty((3, len(shift)))
    row_slopes(places.rows, shift, False, moved)
    for k in range(len(moved)):
        turned[:, :] = 0.0
        add_product(places.turns[k], moved[k], turned)
        add_product(turned, middle, moving[3 * k : 3 * k + 3])


@inlined
def _fill_slopes(law, r, rate, z, impulse, otherwise, out, by_friction):
    """Fill the derivatives of P of (16.4); return whether it has a kink in a row that is iterated.

    Args:
        law: The law.
        r, rate: (rows,) r and 1/r, zero for rows that are not iterated.
        z: (rows,) argument of P.
        impulse: (rows,) P(z).
        otherwise: Whether to decide ties the opposite way.
        out: (rows, rows) is filled with ∂P; zero before.
        by_friction: (rows,) is filled with the derivatives by friction; zero before.
    """
    near, tied, found = SETTLED * law.speed * rate, flags(len(z), False), False
    for k in range(law.contacts):
        n = 3 * k + 2
        tied[n] = abs(z[n]) <= near[n]
        if (impulse[n] > 0.0) == (tied[n] and otherwise):
            continue
        out[n, n] = 1.0
        z1, z2 = z[n - 2], z[n - 1]
        size, pushed = math.hypot(z1, z2), math.hypot(impulse[n - 2], impulse[n - 1])
        radius = law.friction[k] * impulse[n]
        tied[n - 2] = radius > 0.0 and abs(size - radius) <= near[n]
        if (pushed < (1.0 - ROUNDING) * radius) != (tied[n - 2] and otherwise):
            out[n - 2, n - 2] = out[n - 1, n - 1] = 1.0
            continue
        x, y, part = z1 / max(size, TINY), z2 / max(size, TINY), pushed / max(size, pushed, TINY)
        out[n - 2, n - 2], out[n - 2, n - 1] = part * (1.0 - x * x), -part * x * y
        out[n - 1, n - 2], out[n - 1, n - 1] = -part * y * x, part * (1.0 - y * y)
        out[n - 2, n], out[n - 1, n] = law.friction[k] * x, law.friction[k] * y
        by_friction[n - 2], by_friction[n - 1] = impulse[n] * x, impulse[n] * y
    for a in range(3 * law.contacts, len(z)):
        acts = True  # held contacts
        if a >= law.dry:
            bound = law.bounds[a - law.dry]
            tied[a], acts = abs(abs(z[a]) - bound) <= near[a], abs(impulse[a]) < (1.0 - ROUNDING) * bound
        elif a >= law.limits:
            tied[a], acts = abs(z[a]) <= near[a], impulse[a] > 0.0
        out[a, a] = 1.0 if acts != (tied[a] and otherwise) else 0.0
    for a in range(len(z)):
        found |= r[a] > 0.0 and tied[a]
    return found


@declared(FLOAT_ROWS, FLOAT_ROWS, FLAGS, int, INTEGERS)
@jit
def largest_rows(jacobian, response, acts, contacts, largest):
    """Fill for each row (rows,) the contact row of its island with the largest diagonal entry of W.

    Args:
        jacobian: (rows, nv) Jacobian of the rows.
        response: (nv, rows) M⁻¹Jᵀ.
        acts: (rows,) whether the row acts; the normal one decides for those of a contact.
        contacts: Number of contacts.
        largest: (rows,) is filled; rows without contacts in their islands have their own numbers.
    """
    size = len(acts)
    delassus, island, todo = np.zeros((size, size)), repeated(size, -1), np.empty(size, dtype=np.int64)
    add_product(jacobian, response, delassus)
    for k in range(contacts):
        acts[3 * k] = acts[3 * k + 1] = acts[3 * k + 2]
    for first in range(size):
        if island[first] >= 0:
            continue
        island[first], todo[0], count, done = first, first, 1, 0
        while done < count:
            a = todo[done]
            done += 1
            for b in range(size):
                if island[b] < 0 and acts[a] and acts[b] and delassus[a, b] != 0.0:
                    island[b], todo[count] = first, b
                    count += 1
        top = -1
        for a in range(min(size, 3 * contacts)):
            if island[a] == first and (top < 0 or delassus[a, a] > delassus[top, top]):
                top = a
        for k in range(count):
            largest[todo[k]] = top if top >= 0 else todo[k]
