"""Derivatives of the iterations that solve the contact problem of a time step. (derivatives.md, 12)"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._compile.declared import (
    FLOAT_COLUMNS,
    FLOAT_ROWS,
    FLOATS,
    FloatRows,
    Floats,
    FloatStack,
    Integers,
    declared,
)
from ..._compile.jit import inlined, jit
from ..._numeric.loops import filled, flags
from ..._numeric.products import add, add_product
from ..._numeric.tolerances import ROUNDING, SETTLED, TINY
from ...robot._kernels.configuration_slopes import fill_motions, force_slopes, velocity_slopes


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
        J, joint, parent: See `configuration_slopes.fill_motions`.
        tips, bases: (k,) joints of tip and surface.
        at, shifts: (k, …) and (k, nv, …), see `configuration_slopes.fill_place`.
        axes: (k, 3, 3) axes of the rows.
        turns: (k, 3, 3) rotations from the axes of `at` to those of the rows.
    """

    J: Annotated[NDArray[np.float64], FLOAT_COLUMNS]
    joint: Integers
    parent: Integers
    tips: Integers
    bases: Integers
    at: FloatRows
    shifts: FloatStack
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


@declared(
    *(Law, Places, Changes, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT_ROWS, bool),
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS),
)
@jit
def iteration_equations(
    law, places, changes, r, before, now, u, shift, of_mass, otherwise, v_end, stiff, impulses, forces
):
    """Return the equations of the changes of the velocity in an iteration, and whether P has a kink. (D40)

    Args:
        law, places, changes: The step.
        r: (rows,) r of (16.3) in the iteration; zero for rows whose iterations have ended.
        before, now: (rows,) impulses before and after it.
        u: (rows,) velocities of the rows that it makes vanish.
        shift: (nv,) difference of the velocities from those at the end of the step.
        of_mass: (nv, nv) ∂(M `shift`)/∂q.
        otherwise: Whether to decide ties the opposite way.
        v_end: (nv, n) changes of the velocity in the iteration before.
        stiff, impulses: (rows, rows) ∂P/r and (rows, n) changes of the impulses for zero `v_end`, of the
            iteration before; they are replaced by those of this one. Zeros before the first.
        forces: (nv, nv) is overwritten with ∂(Jᵀf)/∂q for the impulses `now`.

    Returns:
        The matrix (nv, nv) and right-hand sides (nv, n) of the changes of the velocity; whether P has a kink.
    """
    jacobian, middle, length = changes.jacobian, changes.middle, changes.length
    size, nv = jacobian.shape
    passed, rate = np.zeros(impulses.shape), np.zeros(size)
    add_product(jacobian, v_end, passed)
    _subtract(stiff, passed, impulses)
    for a in range(size):
        if r[a] > 0.0:
            rate[a] = 1.0 / r[a]
    slopes, by_friction = np.zeros((size, size)), np.zeros(size)
    tied = _fill_slopes(law, r, rate, before - u * rate, now, otherwise, slopes, by_friction)
    moving, change, right = changes.closing.copy(), np.empty((nv, nv)), changes.known.copy()
    _fill_forces(places, now, forces)
    for i in range(nv):
        for j in range(nv):
            change[i, j] = forces[i, j] - of_mass[i, j]
        add(right[i], -changes.softer[i] * shift[i], length)
    add_product(change, middle, right)
    _add_motion(places, shift, middle, moving)
    earlier = impulses.copy()
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
                add(impulses[a], now[a] / law.h, length)
        for b in range(size):
            stiff[a, b] = slopes[a, b] * rate[b]
    matrix, pressed = changes.total.copy(), np.zeros((size, nv))
    _subtract(stiff, jacobian, pressed)
    for a in range(size):
        for j in range(nv):
            if jacobian[a, j] != 0.0:
                add(matrix[j], -jacobian[a, j], pressed[a])
                add(right[j], jacobian[a, j], impulses[a])
    return matrix, right, tied


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
    world = np.empty(3)
    for k in range(len(places.tips)):
        for d in range(3):
            world[d] = 0.0
            for e in range(3):
                world[d] += now[3 * k + e] * places.axes[k, e, d]
        force_slopes(
            *(places.J, places.joint, places.parent, places.at[k], places.shifts[k]),
            *(world[0], world[1], world[2], forces),
        )


@inlined
def _add_motion(places, shift, middle, moving):
    """Add the changes of J `shift` with the configuration to those of the velocities of contacts. (D19)"""
    motions, own = np.empty((len(places.parent), 6)), np.empty((3, len(shift)))
    fill_motions(places.J, places.joint, places.parent, shift, motions)
    for k in range(len(places.tips)):
        velocity_slopes(
            *(places.J, places.joint, places.parent, places.tips[k], places.bases[k]),
            *(places.at[k], places.shifts[k], motions, False, own),
        )
        turned = np.zeros(own.shape)
        add_product(places.turns[k], own, turned)
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
