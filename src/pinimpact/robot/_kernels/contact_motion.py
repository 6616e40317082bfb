"""Motion of one contact point relative to its plane: gap, velocity, acceleration, Jacobian.

Bodies are given by the placement of their joint (12,), the rotation column by column and the translation,
and by spatial vectors (linear over angular), as Pinocchio leaves them in its data. The acceleration may
include gravity, for only differences of two bodies enter.

The contact point is the point of the tip that is closest to the plane, so on a sphere it is not a material
point: with c the centre, p = c − r n and ṗ = ċ − r ṅ. The contact velocity is that of the two bodies'
    material at p.
"""

from __future__ import annotations

import math

from ..._numeric.jit import inner

CONSTANTS = 22
"""Length of the constants of a contact, in the axes of the two joints.

Centre of the tip (3) and radius; then of the plane its point (3), axes t₁, t₂, n (9), and the velocity and
angular velocity of its material (3 + 3).
"""


@inner
def cross(a1, a2, a3, b1, b2, b3):
    return a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1


@inner
def rotate(R, a, b, c):
    """Rotate a vector by the placement R."""
    return (
        R[0] * a + R[3] * b + R[6] * c,
        R[1] * a + R[4] * b + R[7] * c,
        R[2] * a + R[5] * b + R[8] * c,
    )


@inner
def direction(R, k, i):
    """Rotate the vector that stands at k[i:i + 3]."""
    return rotate(R, k[i], k[i + 1], k[i + 2])


@inner
def place(R, k, i):
    """Move the point that stands at k[i:i + 3]."""
    a, b, c = rotate(R, k[i], k[i + 1], k[i + 2])
    return a + R[9], b + R[10], c + R[11]


@inner
def gap_and_rate(R, V, S, U, k):
    """Return the gap [m] and its rate [m/s].

    Args:
        R, V: Placement of the tip's joint, and its velocity in its own axes at its own origin.
        S, U: Those of the joint that carries the plane.
        k: (22,) see `CONSTANTS`.
    """
    c1, c2, c3 = place(R, k, 0)
    x1, x2, x3 = place(S, k, 4)
    n1, n2, n3 = direction(S, k, 13)
    a1, a2, a3 = cross(V[3], V[4], V[5], k[0], k[1], k[2])
    v1, v2, v3 = rotate(R, V[0] + a1, V[1] + a2, V[2] + a3)
    w1, w2, w3 = rotate(S, U[3], U[4], U[5])
    b1, b2, b3 = cross(w1, w2, w3, c1 - S[9], c2 - S[10], c3 - S[11])
    u1, u2, u3 = rotate(S, U[0], U[1], U[2])
    rate = n1 * (v1 - u1 - b1) + n2 * (v2 - u2 - b2) + n3 * (v3 - u3 - b3)
    return n1 * (c1 - x1) + n2 * (c2 - x2) + n3 * (c3 - x3) - k[3], rate


@inner
def curvature(J, weights, group, R, k, peak, h):
    """Return bounds of |d²gap/dt²| over a step of length h, and of how much d²gap/dt² varies in it.

    With J_k the column of velocity k for the tip's centre, d²p/dt² = Σ J_k v̇_k + Σ H_jk v_j v_k. H_jk is ω
    × J of the inner and the outer joint, so |H_jk| ≤ |ω_inner||J_outer|, and its own derivative has one more
    factor ω. The |J_k| are the present ones, lengthened by the way the point can go.

    Args:
        J, weights, R, k: As in `contact_motion`.
        group: (nv,) number of the joint that each velocity belongs to.
        peak: (4, nv) the largest |ξ̇| and |v̇| of the step, and how far they get from those at its start.
        h: Its length [s].
    """
    n = len(weights)
    c1, c2, c3 = place(R, k, 0)
    all_v = all_a = all_d = 0.0
    carried = False
    for j in range(n):
        if weights[j] != 0.0:
            turn = math.sqrt(J[3, j] ** 2 + J[4, j] ** 2 + J[5, j] ** 2)
            all_v += turn * peak[0, j]
            all_a += turn * peak[1, j]
            all_d += turn * peak[2, j]
            carried = carried or weights[j] < 0.0
    way = straight = bent = changed = mixed = drifted = 0.0
    for _ in range(2):
        speed = straight = bent = changed = mixed = drifted = 0.0
        inner_v = inner_a = inner_d = own_v = own_a = own_d = 0.0
        single = True
        for m in range(n):
            if weights[m] == 0.0:
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
            u1, u2, u3 = cross(J[3, m], J[4, m], J[5, m], c1, c2, c3)
            turn = math.sqrt(J[3, m] ** 2 + J[4, m] ** 2 + J[5, m] ** 2)
            lever = math.sqrt((J[0, m] + u1) ** 2 + (J[1, m] + u2) ** 2 + (J[2, m] + u3) ** 2) + way * turn
            v, a, d, e = peak[0, m], peak[1, m], peak[2, m], peak[3, m]
            if carried:  # seen from the plane's carrier any rotation may be the inner one
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
        way = h * speed
    return straight + bent, changed + h * mixed + 2.0 * drifted + 2.0 * h * all_v * bent


@inner
def contact_motion(R, V, A, S, U, B, k, J, weights, rows, velocity, acceleration, surface):
    """Fill what a sustained contact needs, in the plane's axes t₁, t₂, n.

    Args:
        R, V, A: Placement of the tip's joint, its velocity and acceleration in world axes at the world's
            origin.
        S, U, B: Those of the joint that carries the plane.
        k: (22,) see `CONSTANTS`.
        J: (6, nv) joint Jacobian in world axes at the world's origin.
        weights: (nv,) 1 for velocities that move the tip only, −1 the plane only, 0 neither or both.
        rows: (3, nv) takes the contact Jacobian.
        velocity: (3,) takes the contact velocity v.
        acceleration: (3,) takes dv/dt for the accelerations given.
        surface: (3,) takes the velocity of the surface beyond its carrier's.

    Returns:
        The gap [m].
    """
    c1, c2, c3 = place(R, k, 0)
    x1, x2, x3 = place(S, k, 4)
    n1, n2, n3 = direction(S, k, 13)
    r = k[3]
    p1, p2, p3 = c1 - r * n1, c2 - r * n2, c3 - r * n3
    # rate of the contact point and of the plane's own point
    a1, a2, a3 = cross(V[3], V[4], V[5], c1, c2, c3)
    b1, b2, b3 = cross(U[3], U[4], U[5], n1, n2, n3)
    dp1, dp2, dp3 = V[0] + a1 - r * b1, V[1] + a2 - r * b2, V[2] + a3 - r * b3
    a1, a2, a3 = cross(U[3], U[4], U[5], x1, x2, x3)
    dr1, dr2, dr3 = dp1 - U[0] - a1, dp2 - U[1] - a2, dp3 - U[2] - a3
    # relative velocity of the bodies' material at p, and its rate
    w1, w2, w3 = V[3] - U[3], V[4] - U[4], V[5] - U[5]
    a1, a2, a3 = cross(w1, w2, w3, p1, p2, p3)
    v1, v2, v3 = V[0] - U[0] + a1, V[1] - U[1] + a2, V[2] - U[2] + a3
    a1, a2, a3 = cross(A[3] - B[3], A[4] - B[4], A[5] - B[5], p1, p2, p3)
    b1, b2, b3 = cross(w1, w2, w3, dp1, dp2, dp3)
    g1, g2, g3 = A[0] - B[0] + a1 + b1, A[1] - B[1] + a2 + b2, A[2] - B[2] + a3 + b3
    # the surface's own motion u = u₀ + Ω × (p − x), and its rate
    u1, u2, u3 = direction(S, k, 16)
    o1, o2, o3 = direction(S, k, 19)
    y1, y2, y3 = p1 - x1, p2 - x2, p3 - x3
    a1, a2, a3 = cross(U[3], U[4], U[5], u1, u2, u3)
    e1, e2, e3 = cross(U[3], U[4], U[5], o1, o2, o3)
    b1, b2, b3 = cross(e1, e2, e3, y1, y2, y3)
    d1, d2, d3 = cross(o1, o2, o3, dr1, dr2, dr3)
    g1, g2, g3 = g1 - a1 - b1 - d1, g2 - a2 - b2 - d2, g3 - a3 - b3 - d3
    a1, a2, a3 = cross(o1, o2, o3, y1, y2, y3)
    u1, u2, u3 = u1 + a1, u2 + a2, u3 + a3
    v1, v2, v3 = v1 - u1, v2 - u2, v3 - u3
    # the axes turn with the plane's carrier
    a1, a2, a3 = cross(U[3], U[4], U[5], v1, v2, v3)
    g1, g2, g3 = g1 - a1, g2 - a2, g3 - a3
    n = len(weights)
    for i in range(3):
        e1, e2, e3 = direction(S, k, 7 + 3 * i)
        velocity[i] = e1 * v1 + e2 * v2 + e3 * v3
        acceleration[i] = e1 * g1 + e2 * g2 + e3 * g3
        surface[i] = e1 * u1 + e2 * u2 + e3 * u3
        for m in range(n):
            rows[i, m] = 0.0
            if weights[m] != 0.0:
                a1, a2, a3 = cross(J[3, m], J[4, m], J[5, m], p1, p2, p3)
                rows[i, m] = weights[m] * (e1 * (J[0, m] + a1) + e2 * (J[1, m] + a2) + e3 * (J[2, m] + a3))
    return n1 * y1 + n2 * y2 + n3 * y3
