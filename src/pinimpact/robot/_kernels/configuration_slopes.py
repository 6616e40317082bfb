"""How M x, J x and JᵀP change with the configuration. (derivatives.md, 5)

A change δq_k turns all that joint k carries by the motion J_k, at fixed x. So a velocity of a body beyond k
changes by J_k × (V − V_below), where V_below is that of the joint that k stands on. All vectors are in world
axes; motions and forces are (linear, angular) at the world's origin.
"""

from __future__ import annotations

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from .placement import cross

AXES, TIP, POINT, ORIGIN, MATERIAL, SPIN, RADIUS, ROUND, TURNS = 0, 9, 12, 15, 18, 21, 24, 25, 26
PLACE = 27
"""Where a contact is: its axes as rows (9); the tip's centre, the contact point, the surface's point, what
its material does there beyond its carrier, and its spin (3 each); the radius of the tip; for a sphere the
inverse distance of the centres with the sign of the side, else 0; whether vectors have components along the
axes, or in the world."""


@inlined
def _motion_cross(J, k, v1, v2, v3, w1, w2, w3):
    """Return J_k × (v, w) (6)."""
    a1, a2, a3, b1, b2, b3 = J[0, k], J[1, k], J[2, k], J[3, k], J[4, k], J[5, k]
    x1, x2, x3 = cross(b1, b2, b3, v1, v2, v3)
    y1, y2, y3 = cross(a1, a2, a3, w1, w2, w3)
    z1, z2, z3 = cross(b1, b2, b3, w1, w2, w3)
    return x1 + y1, x2 + y2, x3 + y3, z1, z2, z3


@inlined
def _velocities(J, joint, parent, x, out):
    """Fill the motions (joints, 6) of all joints for the velocities x (nv,); the first is the world's."""
    out[:, :] = 0.0
    k = 0
    for i in range(1, len(parent)):
        for r in range(6):
            out[i, r] = out[parent[i], r]
        while k < len(joint) and joint[k] == i:
            for r in range(6):
                out[i, r] += J[r, k] * x[k]
            k += 1


@inlined
def _momentum(inertia, i, v1, v2, v3, w1, w2, w3):
    """Return the force (6) that an inertia (mass, first moment, xx, xy, yy, xz, yz, zz) makes of a motion."""
    m, c1, c2, c3 = inertia[i, 0], inertia[i, 1], inertia[i, 2], inertia[i, 3]
    x1, x2, x3 = cross(w1, w2, w3, c1, c2, c3)
    y1, y2, y3 = cross(c1, c2, c3, v1, v2, v3)
    xx, xy, yy = inertia[i, 4], inertia[i, 5], inertia[i, 6]
    xz, yz, zz = inertia[i, 7], inertia[i, 8], inertia[i, 9]
    z1, z2, z3 = xx * w1 + xy * w2 + xz * w3, xy * w1 + yy * w2 + yz * w3, xz * w1 + yz * w2 + zz * w3
    return m * v1 + x1, m * v2 + x2, m * v3 + x3, y1 + z1, y2 + z2, y3 + z3


@inlined
def _carries(parent, i, j):
    """Whether joint i is joint j or one that it stands on."""
    while j > i:
        j = parent[j]
    return j == i


@declared(FLOAT_ROWS, INTEGERS, INTEGERS, FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def mass_slopes(J, joint, parent, inertia, x, scratch, out):
    """Fill ∂(M x)/∂q. (D18)

    Args:
        J: (6, nv) motions.
        joint: (nv,) the joint of each velocity.
        parent: (joints,) the joint that each stands on; the first is the world.
        inertia: (joints, 10) of all that each carries, at the world's origin: mass, first moment, xx, xy, yy,
            xz, yz, zz.
        x: (nv,).
        scratch: (2 joints, 6).
        out: (nv, nv).
    """
    joints, nv = len(parent), len(joint)
    below, momenta = scratch[:joints], scratch[joints:]
    _velocities(J, joint, parent, x, below)
    momenta[:, :] = 0.0
    last = nv - 1
    for i in range(joints - 1, 0, -1):  # what is beyond i first, then with what i moves itself
        beyond = momenta[parent[i]]
        for r in range(6):
            beyond[r] += momenta[i, r]
        k = last
        while k >= 0 and joint[k] == i:
            f = _momentum(
                *(inertia, i, J[0, k] * x[k], J[1, k] * x[k], J[2, k] * x[k]),
                *(J[3, k] * x[k], J[4, k] * x[k], J[5, k] * x[k]),
            )
            for r in range(6):
                beyond[r] += f[r]
            k -= 1
        last = k
        b = below[i]
        f = _momentum(inertia, i, b[0], b[1], b[2], b[3], b[4], b[5])
        for r in range(6):
            momenta[i, r] += f[r]
    for k in range(nv):
        i = joint[k]
        b, h = below[parent[i]], momenta[i]
        a1, a2, a3, a4, a5, a6 = _motion_cross(J, k, b[0], b[1], b[2], b[3], b[4], b[5])
        g1, g2, g3, g4, g5, g6 = _momentum(inertia, i, a1, a2, a3, a4, a5, a6)
        for m in range(nv):
            x1, x2, x3, x4, x5, x6 = J[0, m], J[1, m], J[2, m], J[3, m], J[4, m], J[5, m]
            if _carries(parent, joint[m], i):
                total = -(x1 * g1 + x2 * g2 + x3 * g3 + x4 * g4 + x5 * g5 + x6 * g6)
                if joint[m] != i:
                    y1, y2, y3, y4, y5, y6 = _motion_cross(J, k, x1, x2, x3, x4, x5, x6)
                    total -= y1 * h[0] + y2 * h[1] + y3 * h[2] + y4 * h[3] + y5 * h[4] + y6 * h[5]
                out[m, k] = total
            elif _carries(parent, i, joint[m]):
                f1, f2, f3, f4, f5, f6 = _momentum(inertia, joint[m], x1, x2, x3, x4, x5, x6)
                out[m, k] = -(f1 * a1 + f2 * a2 + f3 * a3 + f4 * a4 + f5 * a5 + f6 * a6)
            else:
                out[m, k] = 0.0


@inlined
def _shift(J, k, tips, carries, at):
    """Return how the contact point and the surface's point move with q_k, and the axes turn. (D19)"""
    n1, n2, n3 = at[AXES + 6], at[AXES + 7], at[AXES + 8]
    c1 = c2 = c3 = o1 = o2 = o3 = w1 = w2 = w3 = 0.0
    if tips:
        x1, x2, x3 = cross(J[3, k], J[4, k], J[5, k], at[TIP], at[TIP + 1], at[TIP + 2])
        c1, c2, c3 = J[0, k] + x1, J[1, k] + x2, J[2, k] + x3
    if carries:
        w1, w2, w3 = J[3, k], J[4, k], J[5, k]
        x1, x2, x3 = cross(w1, w2, w3, at[ORIGIN], at[ORIGIN + 1], at[ORIGIN + 2])
        o1, o2, o3 = J[0, k] + x1, J[1, k] + x2, J[2, k] + x3
    if at[ROUND] != 0.0:
        # n turns with the line of centres
        x1, x2, x3 = at[ROUND] * (c1 - o1), at[ROUND] * (c2 - o2), at[ROUND] * (c3 - o3)
        w1, w2, w3 = cross(n1, n2, n3, x1, x2, x3)
    m1, m2, m3 = cross(w1, w2, w3, n1, n2, n3)
    r = at[RADIUS]
    return c1 - r * m1, c2 - r * m2, c3 - r * m3, o1, o2, o3, w1, w2, w3


@declared(FLOAT_ROWS, INTEGERS, INTEGERS, INTEGERS, FLOATS, FLOATS, bool, FLOAT_ROWS, FLOAT_ROWS)
@jit
def velocity_slopes(J, joint, parent, ends, at, x, relative, scratch, out):
    """Fill ∂(J x)/∂q (3, nv), or that of J x less what the surface does beyond its carrier. (D19)

    Args:
        J, joint, parent: As in `mass_slopes`.
        ends: (2,) the joints of the tip and of the surface.
        at: (PLACE,) where the contact is.
        x: (nv,).
        relative: Whether the surface's own velocity is taken off.
        scratch: (joints, 6).
        out: (3, nv).
    """
    _velocities(J, joint, parent, x, scratch)
    tip, base = scratch[ends[0]], scratch[ends[1]]
    p1, p2, p3 = at[POINT], at[POINT + 1], at[POINT + 2]
    w1, w2, w3 = tip[3] - base[3], tip[4] - base[4], tip[5] - base[5]
    x1, x2, x3 = cross(w1, w2, w3, p1, p2, p3)
    u1, u2, u3 = tip[0] - base[0] + x1, tip[1] - base[1] + x2, tip[2] - base[2] + x3
    y1, y2, y3 = p1 - at[ORIGIN], p2 - at[ORIGIN + 1], p3 - at[ORIGIN + 2]
    s1, s2, s3 = at[SPIN], at[SPIN + 1], at[SPIN + 2]
    if relative:
        x1, x2, x3 = cross(s1, s2, s3, y1, y2, y3)
        u1, u2, u3 = u1 - at[MATERIAL] - x1, u2 - at[MATERIAL + 1] - x2, u3 - at[MATERIAL + 2] - x3
    for k in range(len(joint)):
        i = joint[k]
        tips, carries = _carries(parent, i, ends[0]), _carries(parent, i, ends[1])
        q1, q2, q3, o1, o2, o3, r1, r2, r3 = _shift(J, k, tips, carries, at)
        d1, d2, d3 = cross(w1, w2, w3, q1, q2, q3)
        b = scratch[parent[i]]
        for end in range(2):
            if carries if end else tips:
                v, f = scratch[ends[end]], 1.0 - 2.0 * end
                a1, a2, a3, a4, a5, a6 = _motion_cross(
                    J, k, v[0] - b[0], v[1] - b[1], v[2] - b[2], v[3] - b[3], v[4] - b[4], v[5] - b[5]
                )
                x1, x2, x3 = cross(a4, a5, a6, p1, p2, p3)
                d1, d2, d3 = d1 + f * (a1 + x1), d2 + f * (a2 + x2), d3 + f * (a3 + x3)
        if relative:
            x1, x2, x3 = cross(s1, s2, s3, q1 - o1, q2 - o2, q3 - o3)
            d1, d2, d3 = d1 - x1, d2 - x2, d3 - x3
            if carries:
                m1, m2, m3 = J[3, k], J[4, k], J[5, k]
                x1, x2, x3 = cross(m1, m2, m3, at[MATERIAL], at[MATERIAL + 1], at[MATERIAL + 2])
                z1, z2, z3 = cross(m1, m2, m3, s1, s2, s3)
                z1, z2, z3 = cross(z1, z2, z3, y1, y2, y3)
                d1, d2, d3 = d1 - x1 - z1, d2 - x2 - z2, d3 - x3 - z3
        if at[TURNS] > 0.0:
            x1, x2, x3 = cross(r1, r2, r3, u1, u2, u3)
            d1, d2, d3 = d1 - x1, d2 - x2, d3 - x3
            for e in range(3):
                out[e, k] = at[3 * e] * d1 + at[3 * e + 1] * d2 + at[3 * e + 2] * d3
        else:
            out[0, k], out[1, k], out[2, k] = d1, d2, d3


@declared(FLOAT_ROWS, INTEGERS, INTEGERS, INTEGERS, FLOATS, FLOATS, FLOAT_ROWS)
@jit
def force_slopes(J, joint, parent, ends, at, force, out):
    """Add ∂(JᵀP)/∂q (nv, nv) for an impulse that turns with the axes, or stays in the world. (D20)

    Args:
        J, joint, parent, ends, at: As in `velocity_slopes`.
        force: (3,) the impulse in world axes.
        out: (nv, nv).
    """
    p1, p2, p3 = at[POINT], at[POINT + 1], at[POINT + 2]
    f1, f2, f3 = force
    n1, n2, n3 = cross(p1, p2, p3, f1, f2, f3)
    for k in range(len(joint)):
        i = joint[k]
        tips, carries = _carries(parent, i, ends[0]), _carries(parent, i, ends[1])
        q1, q2, q3, _, _, _, r1, r2, r3 = _shift(J, k, tips, carries, at)
        e1, e2, e3 = cross(q1, q2, q3, f1, f2, f3)
        g1 = g2 = g3 = 0.0
        if at[TURNS] > 0.0:
            g1, g2, g3 = cross(r1, r2, r3, f1, f2, f3)
        h1, h2, h3 = cross(p1, p2, p3, g1, g2, g3)
        for m in range(len(joint)):
            j = joint[m]
            moves_tip, moves_surface = _carries(parent, j, ends[0]), _carries(parent, j, ends[1])
            if moves_tip == moves_surface:
                continue
            sign = 1.0 if moves_tip else -1.0
            x1, x2, x3, x4, x5, x6 = J[0, m], J[1, m], J[2, m], J[3, m], J[4, m], J[5, m]
            total = x1 * g1 + x2 * g2 + x3 * g3 + x4 * (e1 + h1) + x5 * (e2 + h2) + x6 * (e3 + h3)
            if _carries(parent, i, j):
                y1, y2, y3, y4, y5, y6 = _motion_cross(J, k, x1, x2, x3, x4, x5, x6)
                total += y1 * f1 + y2 * f2 + y3 * f3 + y4 * n1 + y5 * n2 + y6 * n3
            out[m, k] += sign * total


@declared(FLOAT_ROWS, INTEGERS, INTEGERS, INTEGERS, FLOATS, FLOATS, FLOAT_ROWS)
@jit
def turn_slopes(J, joint, parent, ends, at, force, out):
    """Fill how a vector (3,) fixed in the contact axes changes with q, (3, nv) in world axes. (D19)"""
    for k in range(len(joint)):
        i = joint[k]
        tips, carries = _carries(parent, i, ends[0]), _carries(parent, i, ends[1])
        _, _, _, _, _, _, r1, r2, r3 = _shift(J, k, tips, carries, at)
        out[0, k], out[1, k], out[2, k] = cross(r1, r2, r3, force[0], force[1], force[2])
