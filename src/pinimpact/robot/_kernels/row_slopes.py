"""Jacobians of several contacts, and derivatives of the velocities of their rows. (derivatives.md, 5)"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._compile.declared import (
    FLOAT_COLUMNS,
    FLOAT_ROWS,
    FLOAT_STACK,
    FLOATS,
    FloatRows,
    FloatStack,
    Integers,
    declared,
)
from ..._compile.jit import jit
from .configuration_slopes import (
    CARRIER,
    MATERIAL,
    ORIGIN,
    POINT,
    SPIN,
    TIP,
    fill_motions,
    velocity_slopes,
)
from .placement import cross


class Rows(NamedTuple):
    """The places of k contacts.

    Attributes:
        J, joint, parent: See `configuration_slopes.fill_motions`.
        tips, bases: (k,) joints of tip and surface.
        at, shifts: (k, PLACE) and (k, nv, SHIFT), see `configuration_slopes.fill_place`.
    """

    J: Annotated[NDArray[np.float64], FLOAT_COLUMNS]
    joint: Integers
    parent: Integers
    tips: Integers
    bases: Integers
    at: FloatRows
    shifts: FloatStack


@declared(Rows, FLOATS, bool, FLOAT_STACK)
@jit
def row_slopes(rows, x, relative, out):
    """Fill ∂(J x)/∂q (k, 3, nv), or with `relative` ∂(J x − v_surface)/∂q, of all contacts. (D19)"""
    motions = np.empty((len(rows.parent), 6))
    fill_motions(rows.J, rows.joint, rows.parent, x, motions)
    for k in range(len(out)):
        velocity_slopes(
            *(rows.J, rows.joint, rows.parent, rows.tips[k], rows.bases[k]),
            *(rows.at[k], rows.shifts[k], motions, relative, out[k]),
        )


@declared(Rows, FLOATS, FLOAT_STACK, FLOAT_ROWS)
@jit
def row_velocities(rows, v, jacobian, velocity):
    """Fill the Jacobians (k, 3, nv) of all contacts, and J v − v_surface (k, 3), in world axes."""
    J = rows.J
    for k in range(len(jacobian)):
        at = rows.at[k]
        p1, p2, p3 = at[POINT], at[POINT + 1], at[POINT + 2]
        x1, x2, x3 = cross(
            *(at[SPIN], at[SPIN + 1], at[SPIN + 2]),
            *(p1 - at[ORIGIN], p2 - at[ORIGIN + 1], p3 - at[ORIGIN + 2]),
        )
        u1, u2, u3 = -at[MATERIAL] - x1, -at[MATERIAL + 1] - x2, -at[MATERIAL + 2] - x3
        for j in range(len(v)):
            sign = rows.shifts[k, j, TIP] - rows.shifts[k, j, CARRIER]
            x1, x2, x3 = cross(J[3, j], J[4, j], J[5, j], p1, p2, p3)
            a1, a2, a3 = sign * (J[0, j] + x1), sign * (J[1, j] + x2), sign * (J[2, j] + x3)
            jacobian[k, 0, j], jacobian[k, 1, j], jacobian[k, 2, j] = a1, a2, a3
            u1, u2, u3 = u1 + a1 * v[j], u2 + a2 * v[j], u3 + a3 * v[j]
        velocity[k, 0], velocity[k, 1], velocity[k, 2] = u1, u2, u3
