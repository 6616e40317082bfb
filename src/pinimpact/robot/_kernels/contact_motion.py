"""Kinematics of a contact: gap and its rate, acceleration, and bounds over a step.

Bodies are given by the placement of their joint and by spatial vectors (linear over angular), as in
Pinocchio's data. Accelerations may include gravity, since only differences of two bodies matter.

The contact point p is the point of the tip closest to the surface and not fixed to the tip: for a sphere with
centre c, p = c − r n and ṗ = ċ − r ṅ; for a rim the lowest point c moves along the rim too, see
`towards_plane`. The contact velocity is the relative velocity of the material points of the two bodies at p.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ...geometry._kernels import constants as layout
from ...geometry._kernels import surfaces
from . import contact_kinematics
from .placement import cross, direction, place, rotate, rotate_back


@declared(*5 * [FLOATS])
@external
def gap_and_rate(R, V, S, U, k):
    """Return the gap [m] and its rate [m/s].

    Args:
        R, V: (12,) placement of the joint of the tip, and its velocity (6,) in its own axes at its origin.
        S, U: Those of the joint of the surface.
        k: (CONSTANTS,) constants of the contact in the axes of these joints.
    """
    c1, c2, c3, x1, x2, x3 = contact_kinematics.relative(R, S, k)
    d, n1, n2, n3 = contact_kinematics.distance(R, S, k, x1, x2, x3)
    t1, t2, t3 = k[layout.TIP], k[layout.TIP + 1], k[layout.TIP + 2]
    if k[layout.RIM] > 0.0 or k[layout.KIND] >= layout.EDGE:
        t1, t2, t3 = rotate_back(R, c1 - R[9], c2 - R[10], c3 - R[11])
    a1, a2, a3 = cross(V[3], V[4], V[5], t1, t2, t3)
    a1, a2, a3 = rotate(R, V[0] + a1, V[1] + a2, V[2] + a3)
    a1, a2, a3 = rotate_back(S, a1, a2, a3)
    b1, b2, b3 = cross(
        U[3], U[4], U[5], x1 + k[layout.POINT], x2 + k[layout.POINT + 1], x3 + k[layout.POINT + 2]
    )
    rate = n1 * (a1 - U[0] - b1) + n2 * (a2 - U[1] - b2) + n3 * (a3 - U[2] - b3)
    return d - k[layout.RADIUS], rate


@inlined
def bounds(J, signs, group, R, k, peak, h, reach):
    """Return bounds of the motion of the tip's centre c relative to the carrier of the surface over a step.

    With J_k the column of velocity k for c, d²c/dt² = Σ J_k v̇_k + Σ H_jk v_j v_k. H_jk is ω × J of the inner
    and the outer joint, so |H_jk| ≤ |ω_inner||J_outer|, and its derivative has one more factor ω. Bounds of
    |J_k| over the step are the present values plus |ω_k| times the distance that c can move.

    Args:
        J: (6, nv) joint Jacobian.
        signs: (nv,) as in `contact_kinematics.fill_jacobian`.
        group: (nv,) joint of each velocity.
        R, k: As for `gap_and_rate`.
        peak: (4, nv) largest |ξ̇| and |v̇| of the step, and their largest changes from its start.
        h: Step size [s].
        reach: The bounds hold for all points of the tip's body within this distance of c [m].

    Returns:
        The largest acceleration [m/s²], its largest variation, and the largest speed [m/s]; see `gap_bounds`.
    """
    n = len(signs)
    c1, c2, c3 = place(R, k, layout.TIP)
    all_v = all_a = all_d = 0.0
    carried = False
    for j in range(n):
        if signs[j] != 0.0:
            turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
            all_v += turn * peak[0, j]
            all_a += turn * peak[1, j]
            all_d += turn * peak[2, j]
            carried = carried or signs[j] < 0.0
    way, speed = reach, 0.0
    straight = bent = changed = mixed = drifted = 0.0
    for _ in range(2):
        speed = straight = bent = changed = mixed = drifted = 0.0
        inner_v = inner_a = inner_d = own_v = own_a = own_d = 0.0
        single = True
        for m in range(n):
            if signs[m] == 0.0:
                continue
            if m == 0 or group[m] != group[m - 1]:
                inner_v, inner_a, inner_d = inner_v + own_v, inner_a + own_a, inner_d + own_d
                own_v = own_a = own_d = 0.0
                for j in range(m, n):
                    if group[j] != group[m]:
                        break
                    turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
                    own_v += turn * peak[0, j]
                    own_a += turn * peak[1, j]
                    own_d += turn * peak[2, j]
                single = m + 1 == n or group[m + 1] != group[m]
            u1, u2, u3 = contact_kinematics.column(J, m, c1, c2, c3)
            turn = math.sqrt(J[3, m] ** 2 + J[4, m] ** 2 + J[5, m] ** 2)
            lever = math.sqrt(u1**2 + u2**2 + u3**2) + way * turn
            v, a, d, e = peak[0, m], peak[1, m], peak[2, m], peak[3, m]
            if carried:  # relative to the carrier of the surface any rotation may be the inner one
                in_v, in_a, in_d = all_v, all_a, all_d
            else:
                share = 0.5 if single else 1.0
                in_v, in_a, in_d = inner_v + share * own_v, inner_a + share * own_a, inner_d + share * own_d
            speed += lever * v
            straight += lever * a
            bent += lever * 2.0 * v * in_v
            changed += lever * e
            mixed += lever * (v * in_a + a * in_v)
            drifted += lever * (v * in_d + d * in_v)
        way = reach + h * speed
    change = changed + h * mixed + 2.0 * drifted + 2.0 * h * all_v * bent
    return straight + bent, change, speed


@declared(*6 * [FLOATS])
@external
def rim_and_rates(R, V, S, U, k, out):
    """Compute the terms of the gap of a rim over a plane, and their rates.

    The gap is the height of the centre minus the radius of the rim times |u × n|.

    Args:
        R, V, S, U, k: As for `gap_and_rate`.
        out: (8,) is overwritten with the height and its rate, and u × n and its rate (3 + 3) in the axes of
            the carrier of the plane.
    """
    x1, x2, x3 = place(R, k, layout.TIP)
    x1, x2, x3 = rotate_back(S, x1 - S[9], x2 - S[10], x3 - S[11])
    n1, n2, n3 = k[layout.AXES + 6], k[layout.AXES + 7], k[layout.AXES + 8]
    d = n1 * (x1 - k[layout.POINT]) + n2 * (x2 - k[layout.POINT + 1]) + n3 * (x3 - k[layout.POINT + 2])
    a1, a2, a3 = cross(V[3], V[4], V[5], k[layout.TIP], k[layout.TIP + 1], k[layout.TIP + 2])
    a1, a2, a3 = rotate(R, V[0] + a1, V[1] + a2, V[2] + a3)
    a1, a2, a3 = rotate_back(S, a1, a2, a3)
    b1, b2, b3 = cross(U[3], U[4], U[5], x1, x2, x3)
    out[0] = d - k[layout.RADIUS]
    out[1] = n1 * (a1 - U[0] - b1) + n2 * (a2 - U[1] - b2) + n3 * (a3 - U[2] - b3)
    u1, u2, u3 = direction(R, k, layout.RIM_AXIS)
    u1, u2, u3 = rotate_back(S, u1, u2, u3)
    out[2], out[3], out[4] = cross(u1, u2, u3, n1, n2, n3)
    a1, a2, a3 = cross(V[3], V[4], V[5], k[layout.RIM_AXIS], k[layout.RIM_AXIS + 1], k[layout.RIM_AXIS + 2])
    a1, a2, a3 = rotate(R, a1, a2, a3)
    a1, a2, a3 = rotate_back(S, a1, a2, a3)
    b1, b2, b3 = cross(U[3], U[4], U[5], u1, u2, u3)
    out[5], out[6], out[7] = cross(a1 - b1, a2 - b2, a3 - b3, n1, n2, n3)


@inlined
def turning_bound(J, signs, R, k, peak, h):
    """Return the largest second derivative of the axis of a rim over a step, times the radius of the rim.

    Like `bounds`, for the end of the axis relative to the centre; any rotation may be the inner one.
    """
    n = len(signs)
    x1, x2, x3 = direction(R, k, layout.RIM_AXIS)
    turning = way = size = 0.0
    for j in range(n):
        if signs[j] != 0.0:
            turning += math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2) * peak[0, j]
    for _ in range(2):
        speed = size = 0.0
        for j in range(n):
            if signs[j] != 0.0:
                u1, u2, u3 = cross(J[3, j], J[4, j], J[5, j], x1, x2, x3)
                turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
                lever = math.sqrt(u1**2 + u2**2 + u3**2) + way * turn
                speed += lever * peak[0, j]
                size += lever * (peak[1, j] + 2.0 * peak[0, j] * turning)
        way = h * speed
    return k[layout.RIM] * size


@declared(*7 * [FLOATS], FLOAT_COLUMNS, FLOATS, FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS)
@external
def contact_motion(R, V, A, S, U, B, k, J, signs, jacobian, velocity, acceleration, turning, surface):
    """Compute the kinematics of a closed contact, in the axes of `carried_axes`; return the gap [m].

    Args:
        R, V, A: Placement (12,), velocity and acceleration (6,) of the joint of the tip, in world axes at the
            origin of the world.
        S, U, B: Those of the joint of the surface.
        k: Constants of the contact in the axes of the two joints.
        J: (6, nv) joint Jacobian in world axes at the origin of the world.
        signs: (nv,) as in `contact_kinematics.fill_jacobian`.
        jacobian: (3, nv) is overwritten with the contact Jacobian.
        velocity: (3,) is overwritten with the contact velocity v.
        acceleration: (3,) is overwritten with dv/dt of the components of v.
        turning: (3,) is overwritten with ω × v, for the angular velocity ω of the contact axes.
        surface: (3,) is overwritten with the velocity of the surface relative to its carrier.
    """
    c1, c2, c3, x1, x2, x3 = contact_kinematics.relative(R, S, k)
    d, l1, l2, l3 = contact_kinematics.distance(R, S, k, x1, x2, x3)
    n1, n2, n3 = rotate(S, l1, l2, l3)
    p1, p2, p3 = c1 - k[layout.RADIUS] * n1, c2 - k[layout.RADIUS] * n2, c3 - k[layout.RADIUS] * n3
    w1, w2, w3 = V[3] - U[3], V[4] - U[4], V[5] - U[5]
    at = c1, c2, c3, x1, x2, x3, l1, l2, l3, n1, n2, n3
    m1, m2, m3, _, _, _, dp1, dp2, dp3 = rates_at_contact(R, V, S, U, k, at)
    s1, s2, s3 = contact_kinematics.carried_spin(k, l1, l2, l3, m1, m2, m3)
    s1, s2, s3 = rotate(S, s1, s2, s3)
    s1, s2, s3 = U[3] + s1, U[4] + s2, U[5] + s3
    o1, o2, o3 = place(S, k, layout.POINT)
    a1, a2, a3 = cross(U[3], U[4], U[5], o1, o2, o3)
    dy1, dy2, dy3 = dp1 - U[0] - a1, dp2 - U[1] - a2, dp3 - U[2] - a3
    # relative velocity of the material points at p, and its rate
    a1, a2, a3 = cross(w1, w2, w3, p1, p2, p3)
    v1, v2, v3 = V[0] - U[0] + a1, V[1] - U[1] + a2, V[2] - U[2] + a3
    a1, a2, a3 = cross(A[3] - B[3], A[4] - B[4], A[5] - B[5], p1, p2, p3)
    b1, b2, b3 = cross(w1, w2, w3, dp1, dp2, dp3)
    g1, g2, g3 = A[0] - B[0] + a1 + b1, A[1] - B[1] + a2 + b2, A[2] - B[2] + a3 + b3
    # motion of the surface relative to its carrier, u = u₀ + Ω × y, and its rate
    y1, y2, y3 = p1 - o1, p2 - o2, p3 - o3
    u1, u2, u3, o1, o2, o3 = contact_kinematics.material_velocity(S, k, y1, y2, y3)
    a1, a2, a3 = cross(o1, o2, o3, y1, y2, y3)
    a1, a2, a3 = cross(U[3], U[4], U[5], u1 - a1, u2 - a2, u3 - a3)
    e1, e2, e3 = cross(U[3], U[4], U[5], o1, o2, o3)
    b1, b2, b3 = cross(e1, e2, e3, y1, y2, y3)
    d1, d2, d3 = cross(o1, o2, o3, dy1, dy2, dy3)
    g1, g2, g3 = g1 - a1 - b1 - d1, g2 - a2 - b2 - d2, g3 - a3 - b3 - d3
    v1, v2, v3 = v1 - u1, v2 - u2, v3 - u3
    # rotation of the axes
    a1, a2, a3 = cross(s1, s2, s3, v1, v2, v3)
    g1, g2, g3 = g1 - a1, g2 - a2, g3 - a3
    e1, e2, e3 = a1, a2, a3
    a1, a2, a3, b1, b2, b3 = contact_kinematics.carried_axes(k, l1, l2, l3)
    a1, a2, a3 = rotate(S, a1, a2, a3)
    b1, b2, b3 = rotate(S, b1, b2, b3)
    _in_axes(a1, a2, a3, b1, b2, b3, n1, n2, n3, v1, v2, v3, velocity)
    _in_axes(a1, a2, a3, b1, b2, b3, n1, n2, n3, g1, g2, g3, acceleration)
    _in_axes(a1, a2, a3, b1, b2, b3, n1, n2, n3, e1, e2, e3, turning)
    _in_axes(a1, a2, a3, b1, b2, b3, n1, n2, n3, u1, u2, u3, surface)
    contact_kinematics.fill_jacobian(J, signs, p1, p2, p3, a1, a2, a3, b1, b2, b3, n1, n2, n3, jacobian)
    contact_kinematics.drop_rounding(J, signs, k, p1, p2, p3, jacobian)
    return d - k[layout.RADIUS]


@inlined
def rates_at_contact(R, V, S, U, k, at):
    """Return ṅ relative to the carrier, in its axes (3), and ṅ and ṗ in world axes (3 + 3).

    Args:
        R, V: Placement (12,) and velocity (6,) of the body of the tip, in world axes at the origin of the
            world.
        S, U: Those of the carrier of the surface.
        k: Constants of the contact in their axes.
        at: (12,) c in world axes, c relative to the point of the surface and n in the axes of the carrier, n
            in world axes; see `relative`.
    """
    c1, c2, c3, x1, x2, x3, l1, l2, l3, n1, n2, n3 = at
    r = k[layout.RADIUS]
    w1, w2, w3 = V[3] - U[3], V[4] - U[4], V[5] - U[5]
    if k[layout.KIND] == layout.TIP_PLANE:
        l1, l2, l3 = cross(w1, w2, w3, n1, n2, n3)
        l1, l2, l3 = rotate_back(S, l1, l2, l3)
        m1, m2, m3 = cross(V[3], V[4], V[5], n1, n2, n3)
        r = k[layout.SIZE]
        a1, a2, a3 = cross(U[3], U[4], U[5], c1 - r * n1, c2 - r * n2, c3 - r * n3)
        return l1, l2, l3, m1, m2, m3, U[0] + a1 + r * m1, U[1] + a2 + r * m2, U[2] + a3 + r * m3
    a1, a2, a3 = cross(w1, w2, w3, c1, c2, c3)
    a1, a2, a3 = rotate_back(S, V[0] - U[0] + a1, V[1] - U[1] + a2, V[2] - U[2] + a3)
    along = 0.0
    if k[layout.KIND] == layout.EDGE:
        l1, l2, l3, along = _edges_turn(R, S, k, w1, w2, w3, x1, x2, x3, a1, a2, a3, l1, l2, l3)
    elif k[layout.KIND] == layout.FACE_EDGE:
        along = _along_edge(R, S, k, a1, a2, a3, l1, l2, l3)
        l1 = l2 = l3 = 0.0
    else:
        l1, l2, l3 = surfaces.normal_rate(k, x1, x2, x3, a1, a2, a3)
    # the normal turns with the carrier and with the motion of the centre along the surface
    a1, a2, a3 = rotate(S, l1, l2, l3)
    m1, m2, m3 = cross(U[3], U[4], U[5], n1, n2, n3)
    m1, m2, m3 = m1 + a1, m2 + a2, m3 + a3
    a1, a2, a3 = cross(V[3], V[4], V[5], c1, c2, c3)
    p1, p2, p3 = V[0] + a1 - r * m1, V[1] + a2 - r * m2, V[2] + a3 - r * m3
    if k[layout.RIM] > 0.0:
        a1, a2, a3 = _along_rim(R, V, k, n1, n2, n3, m1, m2, m3)
        p1, p2, p3 = p1 + a1, p2 + a2, p3 + a3
    if k[layout.KIND] == layout.EDGE or k[layout.KIND] == layout.FACE_EDGE:
        a1, a2, a3 = direction(R, k, layout.RIM_AXIS)
        p1, p2, p3 = p1 + along * a1, p2 + along * a2, p3 + along * a3
    return l1, l2, l3, m1, m2, m3, p1, p2, p3


@inlined
def _edges_turn(R, S, k, w1, w2, w3, x1, x2, x3, v1, v2, v3, n1, n2, n3):
    """Return the rate (3) of the normal of two edges, and the speed of the closest point on the tip's edge.

    With u and e the edges, N = u × e and n = N/|N|: ṅ = (Ṅ − n n·Ṅ)/|N|, Ṅ = u̇ × e. The closest point x of
    the tip's edge, relative to the surface's, satisfies (n × e)·x = 0, so it moves along u at
    −((ṅ × e)·x + (n × e)·v)/((n × e)·u), with v the velocity of the material of the tip there.

    Args:
        R, S: Placements of the joints.
        k: Constants of the contact in their axes.
        w1, w2, w3: Angular velocity of the tip relative to the carrier of the surface, in world axes.
        x1, x2, x3, v1, v2, v3, n1, n2, n3: x, v and n, in the axes of the carrier and relative to it.
    """
    u1, u2, u3 = contact_kinematics.edge_axis(R, S, k)
    e1, e2, e3 = k[layout.LINE_AXIS], k[layout.LINE_AXIS + 1], k[layout.LINE_AXIS + 2]
    a1, a2, a3 = rotate_back(S, w1, w2, w3)
    a1, a2, a3 = cross(a1, a2, a3, u1, u2, u3)
    m1, m2, m3 = cross(a1, a2, a3, e1, e2, e3)
    b1, b2, b3 = cross(u1, u2, u3, e1, e2, e3)
    s = math.sqrt(b1 * b1 + b2 * b2 + b3 * b3)
    f = n1 * m1 + n2 * m2 + n3 * m3
    m1, m2, m3 = (m1 - f * n1) / s, (m2 - f * n2) / s, (m3 - f * n3) / s
    a1, a2, a3 = cross(m1, m2, m3, e1, e2, e3)
    b1, b2, b3 = cross(n1, n2, n3, e1, e2, e3)
    f = a1 * x1 + a2 * x2 + a3 * x3 + b1 * v1 + b2 * v2 + b3 * v3
    return m1, m2, m3, -f / (b1 * u1 + b2 * u2 + b3 * u3)


@inlined
def _along_edge(R, S, k, v1, v2, v3, n1, n2, n3):
    """Return the speed of the crossing on the tip's edge, −(n × e)·v/(n × e)·u, for a fixed normal."""
    u1, u2, u3 = contact_kinematics.edge_axis(R, S, k)
    b1, b2, b3 = cross(n1, n2, n3, k[layout.LINE_AXIS], k[layout.LINE_AXIS + 1], k[layout.LINE_AXIS + 2])
    return -(b1 * v1 + b2 * v2 + b3 * v3) / (b1 * u1 + b2 * u2 + b3 * u3)


@inlined
def _along_rim(R, V, k, n1, n2, n3, m1, m2, m3):
    """Return the velocity (3) of the lowest point of a rim relative to the material of the rim, for ṅ = m.

    Relative to the material, u is constant and n changes at ṅ − ω × n, which moves the lowest point along
    t = u × e, with e = n_u/|n_u| of `towards_plane`. All vectors are in world axes.
    """
    u1, u2, u3 = direction(R, k, layout.RIM_AXIS)
    w1, w2, w3 = cross(u1, u2, u3, n1, n2, n3)
    s = w1 * w1 + w2 * w2 + w3 * w3
    if s == 0.0:
        return 0.0, 0.0, 0.0
    a1, a2, a3 = cross(V[3], V[4], V[5], n1, n2, n3)  # t = u × n/|u × n|, and |n_u| is |u × n| too
    f = -k[layout.RIM] / s**1.5 * (w1 * (m1 - a1) + w2 * (m2 - a2) + w3 * (m3 - a3))
    return f * w1, f * w2, f * w3


@inlined
def _in_axes(a1, a2, a3, b1, b2, b3, n1, n2, n3, x1, x2, x3, out):
    """Fill the components (3,) of a vector along three axes."""
    out[0] = a1 * x1 + a2 * x2 + a3 * x3
    out[1] = b1 * x1 + b2 * x2 + b3 * x3
    out[2] = n1 * x1 + n2 * x2 + n3 * x3
