"""Contact axes, contact point, gap and Jacobian of a contact, for impacts and for scenes.

The tip is a sphere of radius r (0 for a point) about c, the surface is given by its signed distance d. With n
= ∇d at c the gap is d(c) − r and the contact point p = c − r n. Two tips have another c:

- a rim, a circle of radius ρ and axis u about c₀, in contact with planes only: c is its lowest point
  c₀ − ρ n_u/|n_u| with n_u = n − (n·u)u;
- an edge, a line of direction u through c₀, in contact with an edge of direction e on the surface: c is its
point
  closest to the other edge, and n = u × e/|u × e|.

Placements are twelve numbers, see `placement`; k are the constants of the contact, see `constants`.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, READONLY, declared
from ..._compile.jit import inlined, jit
from ..._numeric.tolerances import EPS
from ...geometry._kernels import constants as layout
from ...geometry._kernels import surfaces
from ...geometry._kernels.contact_axes import contact_axes
from .placement import cross, direction, place, pose, rotate, rotate_back


@inlined
def carried_axes(k, n1, n2, n3):
    """Return t₁ and t₂ (3 + 3) in the axes of the carrier: a₁ and a₂ after the smallest rotation a₃ → n.

    a₁, a₂, a₃ are the axes in the constants, which `follow` updates. So the axes of a scene are continuous
    along the surface and move with it; those of an impact, `contact_axes` of n in world axes, jump where n
    passes −z.
    """
    a1, a2, a3 = k[layout.AXES], k[layout.AXES + 1], k[layout.AXES + 2]
    b1, b2, b3 = k[layout.AXES + 3], k[layout.AXES + 4], k[layout.AXES + 5]
    e1, e2, e3 = k[layout.AXES + 6], k[layout.AXES + 7], k[layout.AXES + 8]
    w = max(1.0 + e1 * n1 + e2 * n2 + e3 * n3, EPS)
    f, g = (a1 * n1 + a2 * n2 + a3 * n3) / w, (b1 * n1 + b2 * n2 + b3 * n3) / w
    m1, m2, m3 = e1 + n1, e2 + n2, e3 + n3
    return a1 - f * m1, a2 - f * m2, a3 - f * m3, b1 - g * m1, b2 - g * m2, b3 - g * m3


@inlined
def carried_spin(k, n1, n2, n3, m1, m2, m3):
    """Return the angular velocity (3) of `carried_axes` for ṅ = m, n × ṅ − n (a₃·(n × ṅ))/(1 + a₃·n).

    It follows from the axis of their rotation being perpendicular to a₃.
    """
    e1, e2, e3 = k[layout.AXES + 6], k[layout.AXES + 7], k[layout.AXES + 8]
    w1, w2, w3 = cross(n1, n2, n3, m1, m2, m3)
    f = (e1 * w1 + e2 * w2 + e3 * w3) / max(1.0 + e1 * n1 + e2 * n2 + e3 * n3, EPS)
    return w1 - f * n1, w2 - f * n2, w3 - f * n3


@inlined
def follow(R, S, k):
    """Replace the axes in the constants by the present ones if n has turned more than 60° from them.

    Components along the present axes do not change; those along axes at other places change slightly.
    """
    _, _, _, x1, x2, x3 = relative(R, S, k)
    _, n1, n2, n3 = distance(R, S, k, x1, x2, x3)
    c = k[layout.AXES + 6] * n1 + k[layout.AXES + 7] * n2 + k[layout.AXES + 8] * n3
    if c >= 0.5:
        return
    axes = carried_axes(k, n1, n2, n3) if c > -0.99 else contact_axes(n1, n2, n3)
    for i in range(6):
        k[layout.AXES + i] = axes[i]
    k[layout.AXES + 6], k[layout.AXES + 7], k[layout.AXES + 8] = n1, n2, n3


@inlined
def towards_plane(R, S, k):
    """Return n_u (3), the component of a plane's normal in the plane of a rim, and its length.

    It is computed as (u × n) × u, without cancellation as the rim becomes parallel to the plane.
    """
    u1, u2, u3 = direction(R, k, layout.RIM_AXIS)
    n1, n2, n3 = direction(S, k, layout.AXES + 6)
    w1, w2, w3 = cross(u1, u2, u3, n1, n2, n3)
    e1, e2, e3 = cross(w1, w2, w3, u1, u2, u3)
    return e1, e2, e3, math.sqrt(e1 * e1 + e2 * e2 + e3 * e3)


@inlined
def relative(R, S, k):
    """Return c (3) in world axes, and relative to the point of the surface in the axes of the carrier (3)."""
    c1, c2, c3 = place(R, k, layout.TIP)
    if k[layout.RIM] > 0.0:
        e1, e2, e3, s = towards_plane(R, S, k)
        if s > 0.0:
            c1, c2, c3 = c1 - k[layout.RIM] / s * e1, c2 - k[layout.RIM] / s * e2, c3 - k[layout.RIM] / s * e3
    if k[layout.KIND] == layout.EDGE or k[layout.KIND] == layout.FACE_EDGE:
        u1, u2, u3 = direction(R, k, layout.RIM_AXIS)
        e1, e2, e3 = direction(S, k, layout.LINE_AXIS)
        f1, f2, f3 = cross(u1, u2, u3, e1, e2, e3)
        w1, w2, w3 = cross(f1, f2, f3, e1, e2, e3)
        o1, o2, o3 = place(S, k, layout.POINT)
        s = (w1 * (o1 - c1) + w2 * (o2 - c2) + w3 * (o3 - c3)) / (w1 * u1 + w2 * u2 + w3 * u3)
        c1, c2, c3 = c1 + s * u1, c2 + s * u2, c3 + s * u3
    if k[layout.KIND] == layout.TIP_PLANE:
        n1, n2, n3 = direction(R, k, layout.RIM_AXIS)
        c1, c2, c3 = place(S, k, layout.POINT)
        c1, c2, c3 = c1 + k[layout.SIZE] * n1, c2 + k[layout.SIZE] * n2, c3 + k[layout.SIZE] * n3
    x1, x2, x3 = rotate_back(S, c1 - S[9], c2 - S[10], c3 - S[11])
    return c1, c2, c3, x1 - k[layout.POINT], x2 - k[layout.POINT + 1], x3 - k[layout.POINT + 2]


@inlined
def edge_axis(R, S, k):
    """Return the direction (3) of a tip that is an edge, in the axes of the carrier of the surface."""
    u1, u2, u3 = direction(R, k, layout.RIM_AXIS)
    return rotate_back(S, u1, u2, u3)


@inlined
def distance(R, S, k, x1, x2, x3):
    """Return the signed distance of c at x from the surface, and n (3), in the axes of the carrier."""
    if k[layout.KIND] == layout.EDGE:
        u1, u2, u3 = edge_axis(R, S, k)
        n1, n2, n3 = cross(u1, u2, u3, k[layout.LINE_AXIS], k[layout.LINE_AXIS + 1], k[layout.LINE_AXIS + 2])
        s = math.sqrt(n1 * n1 + n2 * n2 + n3 * n3)
        n1, n2, n3 = n1 / s, n2 / s, n3 / s
        return n1 * x1 + n2 * x2 + n3 * x3 - k[layout.SIZE], n1, n2, n3
    if k[layout.KIND] == layout.TIP_PLANE:
        n1, n2, n3 = edge_axis(R, S, k)
        c1, c2, c3 = place(R, k, layout.TIP)
        c1, c2, c3 = rotate_back(S, c1 - S[9], c2 - S[10], c3 - S[11])
        d = n1 * (c1 - k[layout.POINT]) + n2 * (c2 - k[layout.POINT + 1]) + n3 * (c3 - k[layout.POINT + 2])
        return d - k[layout.SIZE], n1, n2, n3
    return surfaces.distance(k, x1, x2, x3)


@inlined
def at_contact(R, S, k):
    """Return the gap, n (3) and the contact point (3), in world axes."""
    c1, c2, c3, x1, x2, x3 = relative(R, S, k)
    d, n1, n2, n3 = distance(R, S, k, x1, x2, x3)
    n1, n2, n3 = rotate(S, n1, n2, n3)
    r = k[layout.RADIUS]
    return d - r, n1, n2, n3, c1 - r * n1, c2 - r * n2, c3 - r * n3


@inlined
def material_velocity(S, k, y1, y2, y3):
    """Return the velocity (3) of the surface material relative to its carrier, and its angular velocity (3).

    y is the position relative to the point of the surface; all vectors are in world axes.
    """
    u1, u2, u3 = direction(S, k, layout.VELOCITY)
    o1, o2, o3 = direction(S, k, layout.SPIN)
    a1, a2, a3 = cross(o1, o2, o3, y1, y2, y3)
    return u1 + a1, u2 + a2, u3 + a3, o1, o2, o3


@inlined
def column(J, j, p1, p2, p3):
    """Return the velocity (3) of a point for column j of a (6, nv) Jacobian at the world's origin."""
    a1, a2, a3 = cross(J[3, j], J[4, j], J[5, j], p1, p2, p3)
    return J[0, j] + a1, J[1, j] + a2, J[2, j] + a3


@inlined
def fill_jacobian(J, signs, p1, p2, p3, a1, a2, a3, b1, b2, b3, n1, n2, n3, out):
    """Fill the contact Jacobian `out` (3, nv) at the point p, in the axes a, b, n.

    Args:
        J: (6, nv) joint Jacobian: linear over angular velocity of the bodies that each velocity moves, at the
            origin of the world, in world axes.
        signs: (nv,) 1 for velocities that move the tip only, −1 the surface only, 0 neither or both.
        p1 … n3: p, a, b and n in world axes.
        out: (3, nv) is overwritten with the Jacobian.
    """
    for j in range(len(signs)):
        f = signs[j]
        u1 = u2 = u3 = 0.0
        if f != 0.0:
            u1, u2, u3 = column(J, j, p1, p2, p3)
        out[0, j] = f * (a1 * u1 + a2 * u2 + a3 * u3)
        out[1, j] = f * (b1 * u1 + b2 * u2 + b3 * u3)
        out[2, j] = f * (n1 * u1 + n2 * u2 + n3 * u3)


ROUNDED = 8.0 * EPS
"""Component of the velocity of a point, over the size of its terms, that is taken as rounding: along the axis
of the joint (6.8), or along an axis of a contact of a scene."""


@inlined
def size_of_terms(J, j, reach):
    """Return the size of the numbers from which `column` j is computed, at a distance from the origin."""
    turning = math.sqrt(J[3, j] * J[3, j] + J[4, j] * J[4, j] + J[5, j] * J[5, j])
    return abs(J[0, j]) + abs(J[1, j]) + abs(J[2, j]) + reach * turning


@inlined
def drop_rounding(J, signs, k, p1, p2, p3, out):
    """Set the entries of a contact Jacobian `out` (3, nv) that are rounding errors to zero.

    A row of such entries, as the normal one of a slide that moves along its surface, would otherwise count as
    one that a force can accelerate, since ranks are relative to the rows. Where the surface is curved, the
    rounding errors of the contact point p turn the axes. Other arguments are those of `fill_jacobian`.
    """
    reach = math.sqrt(p1 * p1 + p2 * p2 + p3 * p3)
    radius = k[layout.RADIUS] + surfaces.least_radius(k)
    least = ROUNDED * (1.0 + reach / radius if radius > 0.0 else 1.0)
    for j in range(len(signs)):
        if signs[j] != 0.0:
            size = size_of_terms(J, j, reach)
            for i in range(3):
                if abs(out[i, j]) <= least * size:
                    out[i, j] = 0.0


@inlined
def fill_by_axes(J, signs, p1, p2, p3, axes, out):
    """Fill the contact Jacobian like `fill_jacobian`, with rows accurate to rounding of their own size. (6.8)

    A row is small where its axis is nearly parallel to the joint axes, such as the normal for an arm that
    lies along the floor.
    """
    reach = math.sqrt(p1 * p1 + p2 * p2 + p3 * p3)
    for j in range(len(signs)):
        if signs[j] == 0.0:
            out[0, j] = out[1, j] = out[2, j] = 0.0
            continue
        u1, u2, u3 = column(J, j, p1, p2, p3)
        w1, w2, w3 = J[3, j], J[4, j], J[5, j]
        square = w1 * w1 + w2 * w2 + w3 * w3
        along = w1 * u1 + w2 * u2 + w3 * u3
        if abs(along) <= ROUNDED * math.sqrt(square) * size_of_terms(J, j, reach):
            along = 0.0
        r1, r2, r3 = cross(u1, u2, u3, w1, w2, w3)
        for i in range(3):
            a1, a2, a3 = axes[3 * i], axes[3 * i + 1], axes[3 * i + 2]
            if square > 0.0:
                x1, x2, x3 = cross(a1, a2, a3, w1, w2, w3)
                part = x1 * r1 + x2 * r2 + x3 * r3 + (a1 * w1 + a2 * w2 + a3 * w3) * along
                out[i, j] = signs[j] * part / square
            else:
                out[i, j] = signs[j] * (a1 * u1 + a2 * u2 + a3 * u3)


@declared(FLOAT_COLUMNS, FLOATS, FLOATS, FLOATS, FLOAT_ROWS)
@jit
def jacobian_by_axes(columns, signs, point, axes, out):
    """Call `fill_by_axes` from Python, with the contact point (3,) and its axes (9,), in the world."""
    fill_by_axes(columns, signs, point[0], point[1], point[2], axes, out)


@declared(FLOAT_ROWS, FLOAT_ROWS, READONLY)
@jit
def locate(frame, carrier, constants):
    """Return the gap, n (3) and the contact point (3), in world axes.

    `frame` and `carrier` (4, 4) are the placements of the frame of the tip and of the carrier of the surface.
    """
    return at_contact(pose(frame), pose(carrier), constants)


@inlined
def contact_rows(R, S, columns, signs, constants, on_surface, out):
    """Fill the contact Jacobian like `jacobian`, for placements R and S of the frame and of the carrier.

    Returns:
        t₁, t₂, n (9) in world axes, the velocity of the surface relative to its carrier (3) in contact axes,
        and the contact point (3).
    """
    gap, n1, n2, n3, p1, p2, p3 = at_contact(R, S, constants)
    if on_surface:
        p1, p2, p3 = p1 - gap * n1, p2 - gap * n2, p3 - gap * n3
    a1, a2, a3, b1, b2, b3 = contact_axes(n1, n2, n3)
    fill_jacobian(columns, signs, p1, p2, p3, a1, a2, a3, b1, b2, b3, n1, n2, n3, out)
    drop_rounding(columns, signs, constants, p1, p2, p3, out)
    o1, o2, o3 = place(S, constants, layout.POINT)
    w1, w2, w3, _, _, _ = material_velocity(S, constants, p1 - o1, p2 - o2, p3 - o3)
    return (
        *(a1, a2, a3, b1, b2, b3, n1, n2, n3),
        a1 * w1 + a2 * w2 + a3 * w3,
        b1 * w1 + b2 * w2 + b3 * w3,
        n1 * w1 + n2 * w2 + n3 * w3,
        *(p1, p2, p3),
    )


@declared(FLOAT_ROWS, FLOAT_ROWS, FLOAT_COLUMNS, FLOATS, READONLY, bool, FLOAT_ROWS)
@jit
def jacobian(frame, carrier, columns, signs, constants, on_surface, out):
    """Fill the contact Jacobian J (3, nv).

    Args:
        frame, carrier: (4, 4) placements of the frame of the tip and of the carrier of the surface.
        columns, signs: J and signs of `fill_jacobian`.
        constants: Constants of the contact in the axes of the two frames.
        on_surface: Whether J is taken at the point of the surface below the tip. The tangential velocities of
            the points of a body above one plane then have rank three, whatever their gaps.
        out: (3, nv) is overwritten with J.

    Returns:
        t₁, t₂, n (9) in world axes, and the velocity of the surface relative to its carrier (3) in contact
        axes.
    """
    return contact_rows(pose(frame), pose(carrier), columns, signs, constants, on_surface, out)[:12]
