"""Distances of pairs of convex shapes along directions, and tests that pairs stay apart. (theory.md, 15)

Arguments of several kernels: `placements` (nj, 12) of the joints, and `joints` (p, 2), those that carry the
first and the second shape of each pair.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign
from ...robot._kernels.contact_kinematics import column
from ...robot._kernels.placement import place, rotate_back
from ...robot._kernels.python_calls import call
from .dense_output import state

PIECES = 8
"""Largest number of intervals into which a step is divided to test a pair; a power of two."""

TURNS = 12
"""Largest number of iterations of Gilbert's method."""


@declared(
    *(INTEGERS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOAT_ROWS),
    *(FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOATS, FLOATS, FLAGS, INTEGERS, FLOAT_ROWS),
)
@external
def separations(
    calls, q, placements, joints, vertices, ranges, radii, directions,
    coefficients, charts, q0, v0, fractions, wanted, rows, out,
):  # fmt: skip
    """Fill the separations σ (15.5) of pairs along unit directions at several times of a step [m].

    Args:
        calls: Addresses of the function that computes placements at q and of its arguments, see
            `python_calls`.
        q: (nq,) array from which the function reads q.
        placements, joints: See the module.
        vertices: (m, 3) vertices of the cores, in the axes of their joints [m].
        ranges: (p, 3) the first vertex of the first shape, of the second one, and the one after its last.
        radii: (p,) sum of the radii around both cores [m].
        directions: (p, 3) from the second shape to the first, in world axes.
        coefficients: Dense output of the step, see `dense_output.interpolate`.
        charts: Table of the configuration space.
        q0: (nq,) configuration at the start of the step.
        v0: (nv,) velocity at the start of the step.
        fractions: (k,) times as fractions of the step.
        wanted: (p,) pairs to compute.
        rows: (k,) row of `out` for each time.
        out: (m, p) is overwritten with the separations.

    Returns:
        Whether the calls succeeded.
    """
    v = np.empty(len(v0))
    for f in range(len(fractions)):
        state(coefficients, fractions[f], charts, q0, v0, q, v)
        if not call(calls[0], calls[1]):
            return False
        for k in range(len(joints)):
            if wanted[k]:
                out[rows[f], k] = (
                    separation(placements, joints[k], vertices, ranges[k], directions[k]) - radii[k]
                )
    return True


@declared(
    *(INTEGERS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOAT_ROWS), *(FLAGS, FLOATS)
)
@jit
def turn_to_gaps(calls, placements, joints, vertices, ranges, radii, directions, wanted, out):
    """Turn directions towards those of the gaps at the q set; fill out (p,) with the separations [m].

    Other arguments and the result are those of `separations`.
    """
    if not call(calls[0], calls[1]):
        return False
    for k in range(len(joints)):
        if wanted[k]:
            out[k] = turn_to_gap(placements, joints[k], vertices, ranges[k], directions[k]) - radii[k]
    return True


@inlined
def turn_to_gap(placements, joints, vertices, ranges, d):
    """Turn direction d (3,) towards that of the gap of a pair's cores; return the separation along d [m].

    Gilbert's method (SIAM Journal on Control 4, 1966) approximates the point of A − B nearest to the origin:
    the next point is the nearest one on the segment from the present point to the support point along its
    direction. The direction with the largest separation is kept.
    """
    A, B, first, middle, last = placements[joints[0]], placements[joints[1]], ranges[0], ranges[1], ranges[2]
    u1, u2, u3, best = d[0], d[1], d[2], -math.inf
    x1 = x2 = x3 = 0.0
    for n in range(TURNS):
        low, i = lowest(A, vertices[first:middle], u1, u2, u3)
        high, j = lowest(B, vertices[middle:last], -u1, -u2, -u3)
        a1, a2, a3 = place(A, vertices[first + i], 0)
        b1, b2, b3 = place(B, vertices[middle + j], 0)
        w1, w2, w3 = a1 - b1, a2 - b2, a3 - b3
        if low + high > best:
            best = low + high
            d[0], d[1], d[2] = u1, u2, u3
        if n == 0:
            x1, x2, x3 = w1, w2, w3
        else:
            e1, e2, e3 = x1 - w1, x2 - w2, x3 - w3
            along, square = x1 * e1 + x2 * e2 + x3 * e3, e1 * e1 + e2 * e2 + e3 * e3
            if not along > 0.0:
                break
            part = min(along / square, 1.0)
            x1, x2, x3 = x1 - part * e1, x2 - part * e2, x3 - part * e3
        length = math.sqrt(x1 * x1 + x2 * x2 + x3 * x3)
        if length == 0.0:
            break
        u1, u2, u3 = x1 / length, x2 / length, x3 / length
    return best


@inlined
def separation(placements, joints, vertices, ranges, d):
    """Return the separation of the cores of a pair along d (3,) [m]."""
    low, _ = lowest(placements[joints[0]], vertices[ranges[0] : ranges[1]], d[0], d[1], d[2])
    high, _ = lowest(placements[joints[1]], vertices[ranges[1] : ranges[2]], -d[0], -d[1], -d[2])
    return low + high


@inlined
def lowest(R, vertices, d1, d2, d3):
    """Return the least height along d of vertices (m, 3) at the placement R, and the index of the vertex."""
    a, b, c = rotate_back(R, d1, d2, d3)
    low, which = math.inf, 0
    for i in range(len(vertices)):
        height = a * vertices[i, 0] + b * vertices[i, 1] + c * vertices[i, 2]
        if height < low:
            low, which = height, i
    return d1 * R[9] + d2 * R[10] + d3 * R[11] + low, which


@declared(
    FLOAT_ROWS, INTEGER_ROWS, FLOAT_COLUMNS, FLOAT_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, float, FLOATS
)
@external
def acceleration_bounds(placements, joints, J, centers, reaches, moves, peak, h, out):
    """Fill bounds over a step of the relative acceleration of any points of two shapes [m/s²]. (10.2), (10.3)

    They are sums of those of both shapes in world axes: d²p/dt² = Σ J_k v̇_k + Σ H_jk v_j v_k with
    |H_jk| ≤ |ω_inner||J_outer|, the levers |J_k| being increased by the distance that points can move.

    Args:
        placements, joints: See the module.
        J: (6, nv) joint Jacobian in world axes at the world origin.
        centers: (2 p, 3) centres of the shapes, in the axes of their joints [m].
        reaches: (p, 2) largest distance of a point from them [m].
        moves: (2 p, nv) 1 for velocities that move the shape, else 0.
        peak: (2, nv) bounds of |v| and |v̇|.
        h: Length of the step [s].
        out: (p,) is overwritten with the bounds.
    """
    for k in range(len(joints)):
        total = 0.0
        for side in range(2):
            c1, c2, c3 = place(placements[joints[k, side]], centers[2 * k + side], 0)
            spin = 0.0
            for j in range(J.shape[1]):
                if moves[2 * k + side, j] != 0:
                    spin += math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2) * peak[0, j]
            path = bend = 0.0
            for _ in range(2):
                speed = bend = 0.0
                for j in range(J.shape[1]):
                    if moves[2 * k + side, j] == 0:
                        continue
                    u1, u2, u3 = column(J, j, c1, c2, c3)
                    turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
                    lever = math.sqrt(u1**2 + u2**2 + u3**2) + turn * (reaches[k, side] + path)
                    speed += lever * peak[0, j]
                    bend += lever * (peak[1, j] + 2.0 * spin * peak[0, j])
                path = h * speed
            total += bend
        out[k] = total


@declared(
    *(INTEGERS, FLOATS, FLOAT_ROWS, FLOAT_COLUMNS, INTEGER_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS),
    *(FLOAT_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOAT_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOATS),
    *(FLOAT_ROWS, float, FLOATS, FLAGS),
)
@jit
def stay_apart(
    calls, q, placements, J, joints, vertices, ranges, radii, centers, reaches, moves, least, directions,
    coefficients, charts, q0, v0, peak, h, bounds, apart,
):  # fmt: skip
    """Determine which pairs stay apart over a step, by (15.8) along given directions.

    Intervals are halved until the bound between their ends exceeds the least distance, or a pair is nearer at
    one of the times. Pairs that fail are tested once more along directions turned by `turn_to_gaps`. Other
    arguments are those of `separations` and `acceleration_bounds`.

    Args:
        calls: (4,) addresses, see `separations`; then those of the function that computes J and placements.
        q: (nq,) array from which both functions read q.
        least: (p,) distances that the pairs must keep [m].
        bounds: (p,) is overwritten with the result of `acceleration_bounds`.
        apart: (p,) is overwritten with whether the pairs stay apart.

    Returns:
        Whether the calls succeeded.
    """
    p = len(joints)
    found, wanted = np.empty((PIECES + 1, p)), np.ones(p, dtype=np.bool_)
    v = np.empty(len(v0))
    rows, stride, turned = np.array([0, PIECES]), len(found) - 1, False
    assign(q, q0)
    if not call(calls[2], calls[3]):
        return False
    acceleration_bounds(placements, joints, J, centers, reaches, moves, peak, h, bounds)
    while True:
        if not separations(
            *(calls, q, placements, joints, vertices, ranges, radii, directions),
            *(coefficients, charts, q0, v0, rows / PIECES, wanted, rows, found),
        ):
            return False
        left = False
        for k in range(p):
            if not wanted[k]:
                continue
            nearest = math.inf
            for i in range(0, PIECES + 1, stride):
                nearest = min(nearest, found[i, k])
            apart[k] = nearest - 0.125 * (h * stride / PIECES) ** 2 * bounds[k] > least[k]
            wanted[k] = not apart[k] and nearest > least[k]
            left = left or wanted[k]
        rows = np.arange(stride // 2, PIECES, stride)
        stride //= 2
        if stride > 0 and left:
            continue
        if turned or apart.all():
            return True
        for k in range(p):
            wanted[k] = not apart[k]
        state(coefficients, 0.5, charts, q0, v0, q, v)
        if not turn_to_gaps(calls, placements, joints, vertices, ranges, radii, directions, wanted, found[0]):
            return False
        rows, stride, turned = np.array([0, PIECES]), len(found) - 1, True
