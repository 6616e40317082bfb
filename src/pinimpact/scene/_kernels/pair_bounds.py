"""Pairs of convex shapes: how far they are apart along a direction, and how fast that may bend.

Arguments that both kernels take: the placements (nj, 12) of the joints, and the joints (p, 2) that carry the
first and the second shape of each pair.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.ahead import FLAGS, FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, ahead
from ..._numeric.jit import inner, jit
from ...robot._kernels.contact_kinematics import column
from ...robot._kernels.placement import place, rotate_back
from ...robot._kernels.python_calls import call
from .dense_output import state


@ahead(
    *(INTEGERS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOAT_ROWS),
    *(FLOAT_ROWS, INTEGER_ROWS, FLOATS, FLOATS, FLOATS, FLAGS, INTEGERS, FLOAT_ROWS),
)
@jit
def separations(
    calls, q, placements, joints, vertices, ranges, radii, directions,
    coefficients, charts, q0, v0, fractions, wanted, rows, out,
):  # fmt: skip
    """Fill how far pairs are apart along unit directions at some times of a step, (15.5) [m].

    Args:
        calls: (2,) addresses of what computes placements at q, and of its arguments, see `python_calls`.
        q: (nq,) where it reads them.
        placements: See above, as of joints.
        joints: See above.
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

    Returns:
        Whether the calls went well.
    """
    v = np.empty(len(v0))
    for f in range(len(fractions)):
        state(coefficients, fractions[f], charts, q0, v0, q, v)
        if not call(calls[0], calls[1]):
            return False
        for k in range(len(joints)):
            if not wanted[k]:
                continue
            d = directions[k]
            first, middle, last = ranges[k, 0], ranges[k, 1], ranges[k, 2]
            low, _ = extremes(placements[joints[k, 0]], vertices[first:middle], d)
            _, high = extremes(placements[joints[k, 1]], vertices[middle:last], d)
            out[rows[f], k] = low - high - radii[k]
    return True


@inner
def extremes(R, vertices, d):
    """Return the lowest and the highest height of vertices, placed by R, along d."""
    a, b, c = rotate_back(R, d[0], d[1], d[2])
    low, high = math.inf, -math.inf
    for i in range(len(vertices)):
        height = a * vertices[i, 0] + b * vertices[i, 1] + c * vertices[i, 2]
        low, high = min(low, height), max(high, height)
    origin = d[0] * R[9] + d[1] * R[10] + d[2] * R[11]
    return origin + low, origin + high


@ahead(
    FLOAT_ROWS, INTEGER_ROWS, FLOAT_COLUMNS, FLOAT_ROWS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS, float, FLOATS
)
@jit
def bends(placements, joints, J, centers, reaches, moves, peak, h, out):
    """Fill what the acceleration of a point of one shape against one of the other does not exceed [m/s²].

    That is over a step, in world axes for each shape: d²p/dt² = Σ J_k v̇_k + Σ H_jk v_j v_k with |H_jk| ≤
    |ω_inner||J_outer|, and levers |J_k| lengthened by the way that the points can go.

    Args:
        placements, joints: See above.
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
