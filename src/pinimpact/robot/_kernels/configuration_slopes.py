"""Derivatives of M x, J x and JᵀP by the configuration. (derivatives.md, 5)

A change δq_k displaces all bodies carried by joint k by the motion J_k. At fixed x the velocity V of such a
body changes by J_k × (V − V_below), with V_below that of the parent of k. All vectors are in world axes;
motions and forces are (linear, angular) at the origin.
"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign
from ..._numeric.products import add
from ...geometry._kernels import constants as layout
from ...geometry._kernels.contact_axes import contact_axes
from .contact_kinematics import at_contact, distance, relative
from .contact_motion import rates_at_contact
from .placement import cross, direction, place, pose

AXES, POINT, ORIGIN, MATERIAL, SPIN, TURNS, PLACE = 0, 9, 12, 15, 18, 21, 22
"""Layout of the place of a contact: axes as rows (9); contact point, point of the surface, velocity of the
surface material relative to its carrier there, and its angular velocity (3 each); whether components of
vectors are along the contact axes (1) or the world axes (0)."""

TURN, TIP, CARRIER, SHIFT = 6, 9, 10, 11
"""Layout of its derivatives by each q_k: motion of the contact point and of the point of the surface, and
rotation of the axes (3 each); whether q_k moves the tip and the surface, 1 or 0."""


@declared(
    *(FLOATS, FLOATS, FLOATS, FLOATS, bool, FLOAT_COLUMNS, INTEGERS, INTEGERS, int, int, FLOATS),
    *(FLOAT_ROWS,),
)
@jit
def fill_place(R, S, k, axes, turns, J, joint, parent, tip, base, at, shifts):
    """Compute the place of a contact and its derivatives by q. (D19)

    Args:
        R, S: (12,) placements of the bodies of tip and surface.
        k: Constants of the contact in their axes.
        axes: (9,) t₁, t₂, n in world axes.
        turns: Whether components of vectors are along the contact axes.
        J, joint, parent: As for `fill_motions`.
        tip, base: Joints of tip and surface.
        at: (PLACE,) is overwritten with the place.
        shifts: (nv, SHIFT) is overwritten with its derivatives; (0, SHIFT): not needed.
    """
    c1, c2, c3, x1, x2, x3 = relative(R, S, k)
    _, l1, l2, l3 = distance(R, S, k, x1, x2, x3)
    assign(at[AXES : AXES + 9], axes)
    n1, n2, n3, r = axes[6], axes[7], axes[8], k[layout.RADIUS]
    at[POINT], at[POINT + 1], at[POINT + 2] = c1 - r * n1, c2 - r * n2, c3 - r * n3
    o1, o2, o3 = place(S, k, layout.POINT)
    at[ORIGIN], at[ORIGIN + 1], at[ORIGIN + 2] = o1, o2, o3
    at[MATERIAL], at[MATERIAL + 1], at[MATERIAL + 2] = direction(S, k, layout.VELOCITY)
    at[SPIN], at[SPIN + 1], at[SPIN + 2] = direction(S, k, layout.SPIN)
    at[TURNS] = 1.0 if turns else 0.0
    where, motions = (c1, c2, c3, x1, x2, x3, l1, l2, l3, n1, n2, n3), np.empty((2, 6))
    for i in range(len(shifts)):
        shift = shifts[i]
        shift[TIP] = 1.0 if _carries(parent, joint[i], tip) else 0.0
        shift[CARRIER] = 1.0 if _carries(parent, joint[i], base) else 0.0
        if shift[TIP] + shift[CARRIER] == 0.0:
            shift[:TIP] = 0.0
            continue
        V, U = motions[0], motions[1]
        for m in range(6):
            V[m], U[m] = shift[TIP] * J[m, i], shift[CARRIER] * J[m, i]
        _, _, _, m1, m2, m3, shift[0], shift[1], shift[2] = rates_at_contact(R, V, S, U, k, where)
        a1, a2, a3 = cross(U[3], U[4], U[5], o1, o2, o3)
        shift[3], shift[4], shift[5] = U[0] + a1, U[1] + a2, U[2] + a3
        shift[TURN], shift[TURN + 1], shift[TURN + 2] = cross(n1, n2, n3, m1, m2, m3)


@declared(
    *(FLOAT_ROWS, FLOAT_ROWS, FLOATS, bool, FLOAT_COLUMNS, INTEGERS, INTEGERS, int, int, FLOATS),
    *(FLOAT_ROWS,),
)
@jit
def fill_place_at(frame, carrier, k, turns, J, joint, parent, tip, base, at, shifts):
    """Compute the place of a contact like `fill_place`, for placements (4, 4) of its frame and carrier."""
    R, S, axes = np.array(pose(frame)), np.array(pose(carrier)), np.empty(9)
    _, axes[6], axes[7], axes[8], _, _, _ = at_contact(R, S, k)
    axes[0], axes[1], axes[2], axes[3], axes[4], axes[5] = contact_axes(axes[6], axes[7], axes[8])
    fill_place(R, S, k, axes, turns, J, joint, parent, tip, base, at, shifts)


@inlined
def motion_cross(J, k, v1, v2, v3, w1, w2, w3):
    """Return J_k × (v, w) (6)."""
    a1, a2, a3, b1, b2, b3 = J[0, k], J[1, k], J[2, k], J[3, k], J[4, k], J[5, k]
    x1, x2, x3 = cross(b1, b2, b3, v1, v2, v3)
    y1, y2, y3 = cross(a1, a2, a3, w1, w2, w3)
    z1, z2, z3 = cross(b1, b2, b3, w1, w2, w3)
    return x1 + y1, x2 + y2, x3 + y3, z1, z2, z3


@inlined
def _turned_by(J, k, f1, f2, f3, n1, n2, n3):
    """Return the change (6) of a force f that is displaced by J_k: (J_k × x)·f = −x·(the change)."""
    n1, n2, n3, f1, f2, f3 = motion_cross(J, k, n1, n2, n3, f1, f2, f3)
    return f1, f2, f3, n1, n2, n3


@declared(FLOAT_COLUMNS, INTEGERS, INTEGERS, FLOATS, FLOAT_ROWS)
@jit
def fill_motions(J, joint, parent, x, out):
    """Compute the motions of all joints for the velocities x (nv,).

    Args:
        J: (6, nv) motion of each velocity, the joint Jacobian.
        joint: (nv,) joint of each velocity.
        parent: (joints,) parent joints.
        x: (nv,) velocities.
        out: (joints, 6) is overwritten with the motions; the first is that of the world.
    """
    out[0, :] = 0.0
    k = 0
    for i in range(1, len(parent)):
        assign(out[i], out[parent[i]])
        while k < len(joint) and joint[k] == i:
            add(out[i], x[k], J[:, k])
            k += 1


@inlined
def _momentum(inertia, i, v1, v2, v3, w1, w2, w3):
    """Return the momentum (6) of a motion, for an inertia (mass, first moment, xx, xy, yy, xz, yz, zz)."""
    m, c1, c2, c3 = inertia[i, 0], inertia[i, 1], inertia[i, 2], inertia[i, 3]
    x1, x2, x3 = cross(w1, w2, w3, c1, c2, c3)
    y1, y2, y3 = cross(c1, c2, c3, v1, v2, v3)
    xx, xy, yy = inertia[i, 4], inertia[i, 5], inertia[i, 6]
    xz, yz, zz = inertia[i, 7], inertia[i, 8], inertia[i, 9]
    z1, z2, z3 = xx * w1 + xy * w2 + xz * w3, xy * w1 + yy * w2 + yz * w3, xz * w1 + yz * w2 + zz * w3
    return m * v1 + x1, m * v2 + x2, m * v3 + x3, y1 + z1, y2 + z2, y3 + z3


@inlined
def _of_velocity(J, joint, inertia, k, x):
    """Return the momentum (6) of all bodies that velocity k carries, for the motion J_k x."""
    return _momentum(
        *(inertia, joint[k], J[0, k] * x, J[1, k] * x, J[2, k] * x, J[3, k] * x, J[4, k] * x, J[5, k] * x)
    )


@inlined
def fill_momenta(J, joint, parent, inertia, x, motions, out):
    """Fill the momentum (joints, 6) of all bodies that each joint carries, for velocities x (nv,).

    `motions` (joints, 6) are those of x; other arguments as for `mass_slopes`.
    """
    out[:, :] = 0.0
    last = len(joint) - 1
    for i in range(len(parent) - 1, 0, -1):  # descendants first
        beyond = out[parent[i]]
        add(beyond, 1.0, out[i])
        while last >= 0 and joint[last] == i:
            f = _of_velocity(J, joint, inertia, last, x[last])
            add(beyond, 1.0, f)
            last -= 1
        b = motions[i]
        f = _momentum(inertia, i, b[0], b[1], b[2], b[3], b[4], b[5])
        add(out[i], 1.0, f)


@inlined
def _carries(parent, i, j):
    """Return whether joint i is joint j or an ancestor of it."""
    while j > i:
        j = parent[j]
    return j == i


@inlined
def mass_slopes(J, joint, parent, before, inertia, motions, momenta, out):
    """Compute ∂(M x)/∂q. (D18)

    Args:
        J, joint, parent: As for `fill_motions`.
        before: (nv,) next velocity towards the root, or −1.
        inertia: (joints, 10) mass, first moment, xx, xy, yy, xz, yz, zz of all bodies that each joint
            carries.
        motions, momenta: (joints, 6) those of x.
        out: (nv, nv) is overwritten with the derivative.
    """
    out[:, :] = 0.0
    bends = np.empty((len(joint), 6))
    for k in range(len(joint)):
        i = joint[k]
        b, h = motions[parent[i]], momenta[i]
        bend = motion_cross(J, k, b[0], b[1], b[2], b[3], b[4], b[5])
        assign(bends[k], bend)
        g1, g2, g3, g4, g5, g6 = _momentum(inertia, i, *bend)
        t1, t2, t3, t4, t5, t6 = _turned_by(J, k, h[0], h[1], h[2], h[3], h[4], h[5])
        f1, f2, f3, f4, f5, f6 = _of_velocity(J, joint, inertia, k, 1.0)
        m = k
        while m >= 0:
            own, a = 0.0 if joint[m] == i else 1.0, bends[m]
            out[m, k] = (
                J[0, m] * (own * t1 - g1)
                + J[1, m] * (own * t2 - g2)
                + J[2, m] * (own * t3 - g3)
                + J[3, m] * (own * t4 - g4)
                + J[4, m] * (own * t5 - g5)
                + J[5, m] * (own * t6 - g6)
            )
            if m != k:
                out[k, m] = -(f1 * a[0] + f2 * a[1] + f3 * a[2] + f4 * a[3] + f5 * a[4] + f6 * a[5])
            m = before[m]


@declared(*(FLOAT_COLUMNS, INTEGERS, INTEGERS, int, int, FLOATS, FLOAT_ROWS, FLOAT_ROWS, bool, FLOAT_ROWS))
@jit
def velocity_slopes(J, joint, parent, tip, base, at, shifts, motions, relative, out):
    """Compute ∂(J x)/∂q, or with `relative` ∂(J x − v_surface)/∂q. (D19)

    Args:
        J, joint, parent: As for `fill_motions`.
        tip, base, at, shifts: As for `fill_place`.
        motions: (joints, 6) those of x.
        relative: Whether the velocity of the surface is subtracted.
        out: (3, nv) is overwritten with the derivative.
    """
    moving, carrying = motions[tip], motions[base]
    p1, p2, p3 = at[POINT], at[POINT + 1], at[POINT + 2]
    w1, w2, w3 = moving[3] - carrying[3], moving[4] - carrying[4], moving[5] - carrying[5]
    x1, x2, x3 = cross(w1, w2, w3, p1, p2, p3)
    u1, u2, u3 = moving[0] - carrying[0] + x1, moving[1] - carrying[1] + x2, moving[2] - carrying[2] + x3
    y1, y2, y3 = p1 - at[ORIGIN], p2 - at[ORIGIN + 1], p3 - at[ORIGIN + 2]
    s1, s2, s3 = at[SPIN], at[SPIN + 1], at[SPIN + 2]
    if relative:
        x1, x2, x3 = cross(s1, s2, s3, y1, y2, y3)
        u1, u2, u3 = u1 - at[MATERIAL] - x1, u2 - at[MATERIAL + 1] - x2, u3 - at[MATERIAL + 2] - x3
    for k in range(len(joint)):
        i, shift = joint[k], shifts[k]
        tips, carries = shift[TIP] > 0.0, shift[CARRIER] > 0.0
        if not (tips or carries):
            out[0, k] = out[1, k] = out[2, k] = 0.0
            continue
        q1, q2, q3 = shift[0], shift[1], shift[2]
        d1, d2, d3 = cross(w1, w2, w3, q1, q2, q3)
        b = motions[parent[i]]
        for end in range(2):
            if carries if end else tips:
                v, f = carrying if end else moving, 1.0 - 2.0 * end
                a1, a2, a3, a4, a5, a6 = motion_cross(
                    J, k, v[0] - b[0], v[1] - b[1], v[2] - b[2], v[3] - b[3], v[4] - b[4], v[5] - b[5]
                )
                x1, x2, x3 = cross(a4, a5, a6, p1, p2, p3)
                d1, d2, d3 = d1 + f * (a1 + x1), d2 + f * (a2 + x2), d3 + f * (a3 + x3)
        if relative:
            x1, x2, x3 = cross(s1, s2, s3, q1 - shift[3], q2 - shift[4], q3 - shift[5])
            d1, d2, d3 = d1 - x1, d2 - x2, d3 - x3
            if carries:
                m1, m2, m3 = J[3, k], J[4, k], J[5, k]
                x1, x2, x3 = cross(m1, m2, m3, at[MATERIAL], at[MATERIAL + 1], at[MATERIAL + 2])
                z1, z2, z3 = cross(m1, m2, m3, s1, s2, s3)
                z1, z2, z3 = cross(z1, z2, z3, y1, y2, y3)
                d1, d2, d3 = d1 - x1 - z1, d2 - x2 - z2, d3 - x3 - z3
        if at[TURNS] > 0.0:
            x1, x2, x3 = cross(shift[TURN], shift[TURN + 1], shift[TURN + 2], u1, u2, u3)
            d1, d2, d3 = d1 - x1, d2 - x2, d3 - x3
            for e in range(3):
                out[e, k] = at[3 * e] * d1 + at[3 * e + 1] * d2 + at[3 * e + 2] * d3
        else:
            out[0, k], out[1, k], out[2, k] = d1, d2, d3


@declared(FLOAT_COLUMNS, INTEGERS, INTEGERS, FLOATS, FLOAT_ROWS, float, float, float, FLOAT_ROWS)
@jit
def force_slopes(J, joint, parent, at, shifts, f1, f2, f3, out):
    """Add ∂(JᵀP)/∂q to `out` (nv, nv), for an impulse (f1, f2, f3) in world axes. (D20)

    The impulse rotates with the contact axes if `at[TURNS]` is 1. Other arguments as for `velocity_slopes`.
    """
    nv = len(joint)
    p1, p2, p3 = at[POINT], at[POINT + 1], at[POINT + 2]
    n1, n2, n3 = cross(p1, p2, p3, f1, f2, f3)
    for k in range(nv):
        i, shift = joint[k], shifts[k]
        if shift[TIP] + shift[CARRIER] == 0.0:
            continue
        e1, e2, e3 = cross(shift[0], shift[1], shift[2], f1, f2, f3)
        g1 = g2 = g3 = 0.0
        if at[TURNS] > 0.0:
            g1, g2, g3 = cross(shift[TURN], shift[TURN + 1], shift[TURN + 2], f1, f2, f3)
        h1, h2, h3 = cross(p1, p2, p3, g1, g2, g3)
        h1, h2, h3 = h1 + e1, h2 + e2, h3 + e3
        t1, t2, t3, t4, t5, t6 = _turned_by(J, k, f1, f2, f3, n1, n2, n3)
        for m in range(nv):
            sign = shifts[m, TIP] - shifts[m, CARRIER]
            if sign == 0.0:
                continue
            own = 1.0 if _carries(parent, i, joint[m]) else 0.0
            out[m, k] += sign * (
                J[0, m] * (g1 - own * t1)
                + J[1, m] * (g2 - own * t2)
                + J[2, m] * (g3 - own * t3)
                + J[3, m] * (h1 - own * t4)
                + J[4, m] * (h2 - own * t5)
                + J[5, m] * (h3 - own * t6)
            )


@inlined
def turn_slopes(shifts, f1, f2, f3, out):
    """Fill the derivative by q (3, nv), in world axes, of a vector f (3) fixed in the contact axes. (D19)"""
    for k in range(len(shifts)):
        out[0, k], out[1, k], out[2, k] = cross(
            shifts[k, TURN], shifts[k, TURN + 1], shifts[k, TURN + 2], f1, f2, f3
        )
