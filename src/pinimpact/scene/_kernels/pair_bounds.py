"""Pairs of convex shapes: how far they are apart along a direction, and whether they stay so over a step.

Arguments that several kernels take: the placements (nj, 12) of the joints, and the joints (p, 2) that carry
the first and the second shape of each pair.
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
"""Parts of a step, at most, over which the direction known is tried; a power of two."""

TURNS = 12
"""Directions that are tried on the way to that of a gap."""


@declared(
    *(INTEGERS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOAT_ROWS),
    *(FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOATS, FLOATS, FLAGS, INTEGERS, FLOAT_ROWS),
)
@external
def separations(
    calls, q, placements, joints, vertices, ranges, radii, directions,
    coefficients, charts, q0, v0, fractions, wanted, rows, out,
):  # fmt: skip
    """Fill how far pairs are apart along unit directions at some times of a step, (15.5) [m].

    Args:
        calls: Addresses of what computes placements at q, and of its arguments, see `python_calls`.
        q: (nq,) where it reads them.
        vertices: (m, 3) of the cores, in the axes of their joints.
        ranges: (p, 3) the first vertex of the first shape, of the second one, and the one after its last.
        radii: (p,) around both cores [m].
        directions: (p, 3) from the second shape to the first, in world axes.
        coefficients: Dense output of the step, see `dense_output.interpolate`.
        charts: Table of the configuration space.
        q0: (nq,) configuration at its start.
        v0: (nv,) velocity there.
        fractions: (k,) of the step.
        wanted: (p,) of which pairs.
        rows: (k,) where the distances of these go,
        out: (m, p) in this.

    Returns whether the calls went well.
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
    """Turn directions towards the gaps of pairs at the q that is set; fill how far they are apart (p,) [m].

    Arguments and result as of `separations`.
    """
    if not call(calls[0], calls[1]):
        return False
    for k in range(len(joints)):
        if wanted[k]:
            out[k] = turn_to_gap(placements, joints[k], vertices, ranges[k], directions[k]) - radii[k]
    return True


@inlined
def turn_to_gap(placements, joints, vertices, ranges, d):
    """Turn a direction towards the gap of a pair's cores; return how far they are apart along it [m].

    The direction sought is that of the point of A − B nearest to the origin. On the way from the point at
    hand to the lowest along its direction is a nearer one. (E. G. Gilbert, SIAM Journal on Control 4, 1966)
    The direction with the largest distance of those tried is kept.
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
    """Return how far the cores of a pair are apart along d [m]."""
    low, _ = lowest(placements[joints[0]], vertices[ranges[0] : ranges[1]], d[0], d[1], d[2])
    high, _ = lowest(placements[joints[1]], vertices[ranges[1] : ranges[2]], -d[0], -d[1], -d[2])
    return low + high


@inlined
def lowest(R, vertices, d1, d2, d3):
    """Return the height of the lowest of vertices, placed by R, along d, and which it is."""
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
def bends(placements, joints, J, centers, reaches, moves, peak, h, out):
    """Fill what the acceleration of a point of one shape against one of the other does not exceed [m/s²].

    That is over a step, in world axes for each shape: d²p/dt² = Σ J_k v̇_k + Σ H_jk v_j v_k with |H_jk| ≤
    |ω_inner||J_outer|, and levers |J_k| lengthened by the way that the points can go.

    Args:
        J: (6, nv) joint Jacobian in world axes at the world's origin.
        centers: (2 p, 3) of the shapes, in the axes of their joints.
        reaches: (p, 2) largest distance of a point from them [m].
        moves: (2 p, nv) 1 for the velocities that move the shape, else 0.
        peak: (2, nv) what |v| and |v̇| do not exceed.
        h: Length of the step [s].
        out: (p,) takes the bounds.
    """
    for k in range(len(joints)):
        total = 0.0
        for side in range(2):
            c1, c2, c3 = place(placements[joints[k, side]], centers[2 * k + side], 0)
            spin = 0.0
            for j in range(J.shape[1]):
                if moves[2 * k + side, j] != 0:
                    spin += math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2) * peak[0, j]
            way = bend = 0.0
            for _ in range(2):
                speed = bend = 0.0
                for j in range(J.shape[1]):
                    if moves[2 * k + side, j] == 0:
                        continue
                    u1, u2, u3 = column(J, j, c1, c2, c3)
                    turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
                    lever = math.sqrt(u1**2 + u2**2 + u3**2) + turn * (reaches[k, side] + way)
                    speed += lever * peak[0, j]
                    bend += lever * (peak[1, j] + 2.0 * spin * peak[0, j])
                way = h * speed
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
    """Tell which pairs stay apart over a step, along directions known. (15.8)

    A pair that is found too near at any time is given up; the others are looked at in halves, until the
    distance cannot sag below the least one between two times. Those given up are tried once more, along
    directions that are new.

    Args:
        calls: (4,) addresses, see `separations`, then those of what computes J and placements at q.
        q: (nq,) where both read them.
        least: (p,) by what the pairs have to stay apart [m].
        bounds: (p,) takes what `bends` finds.
        apart: (p,) takes whether they stay apart.

    Returns whether the calls went well.
    """
    p = len(joints)
    found, wanted = np.empty((PIECES + 1, p)), np.ones(p, dtype=np.bool_)
    v = np.empty(len(v0))
    rows, stride, turned = np.array([0, PIECES]), len(found) - 1, False
    assign(q, q0)
    if not call(calls[2], calls[3]):
        return False
    bends(placements, joints, J, centers, reaches, moves, peak, h, bounds)
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
