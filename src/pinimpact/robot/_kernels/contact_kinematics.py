"""Contact axes, and the contact point, gap and Jacobian in them.

The 16 `constants` of a contact are its offset (3) and radius, then point, normal, velocity and angular
velocity (3 each) of its plane.
"""

from __future__ import annotations

import math

from ..._numeric.jit import jit


@jit
def contact_axes(nx, ny, nz):
    """Return t₁ and t₂ (3 + 3 scalars) of the unit normal n: where the smallest rotation z → n takes x and y.

    With n = (s u, nz), |u| = 1: t₁ = x − (1 − nz) u₁ (u, 0) − nx z, and t₂ alike. For nz > 0 the factor
    is s²/(1 + nz), so nothing cancels near n = ±z. For n = −z: half a turn about x.
    """
    s = math.hypot(nx, ny)
    if s == 0.0:
        return (1.0, 0.0, 0.0, 0.0, 1.0 if nz > 0.0 else -1.0, 0.0)
    u1, u2 = nx / s, ny / s
    f = s * (s / (1.0 + nz)) if nz > 0.0 else 1.0 - nz
    return 1.0 - f * u1 * u1, -f * u1 * u2, -nx, -f * u1 * u2, 1.0 - f * u2 * u2, -ny


@jit
def locate(frame, carrier, constants):
    """Place the contact in the world.

    Args:
        frame: (4, 4) placement of the contact's frame.
        carrier: (4, 4) placement of the frame that carries the plane; None for the world.
        constants: (16,) of the contact.

    Returns:
        The signed distance, n (3), the contact point (3), all in world axes.
    """
    f, k = frame, constants
    n1, n2, n3 = k[7], k[8], k[9]
    o1, o2, o3 = k[4], k[5], k[6]
    if carrier is not None:
        s = carrier
        n1, n2, n3 = (
            s[0, 0] * n1 + s[0, 1] * n2 + s[0, 2] * n3,
            s[1, 0] * n1 + s[1, 1] * n2 + s[1, 2] * n3,
            s[2, 0] * n1 + s[2, 1] * n2 + s[2, 2] * n3,
        )
        o1, o2, o3 = (
            s[0, 3] + s[0, 0] * o1 + s[0, 1] * o2 + s[0, 2] * o3,
            s[1, 3] + s[1, 0] * o1 + s[1, 1] * o2 + s[1, 2] * o3,
            s[2, 3] + s[2, 0] * o1 + s[2, 1] * o2 + s[2, 2] * o3,
        )
    x1 = f[0, 3] + f[0, 0] * k[0] + f[0, 1] * k[1] + f[0, 2] * k[2] - k[3] * n1
    x2 = f[1, 3] + f[1, 0] * k[0] + f[1, 1] * k[1] + f[1, 2] * k[2] - k[3] * n2
    x3 = f[2, 3] + f[2, 0] * k[0] + f[2, 1] * k[1] + f[2, 2] * k[2] - k[3] * n3
    return n1 * (x1 - o1) + n2 * (x2 - o2) + n3 * (x3 - o3), n1, n2, n3, x1, x2, x3


@jit
def surface_velocity(carrier, constants, x1, x2, x3):
    """Return the velocity at (x₁, x₂, x₃) that the surface has beyond its carrier's, in world axes."""
    k = constants
    if carrier is None:
        y1, y2, y3 = x1 - k[4], x2 - k[5], x3 - k[6]
        return (
            k[10] + k[14] * y3 - k[15] * y2,
            k[11] + k[15] * y1 - k[13] * y3,
            k[12] + k[13] * y2 - k[14] * y1,
        )
    s = carrier
    x1, x2, x3 = x1 - s[0, 3], x2 - s[1, 3], x3 - s[2, 3]
    y1 = s[0, 0] * x1 + s[1, 0] * x2 + s[2, 0] * x3 - k[4]
    y2 = s[0, 1] * x1 + s[1, 1] * x2 + s[2, 1] * x3 - k[5]
    y3 = s[0, 2] * x1 + s[1, 2] * x2 + s[2, 2] * x3 - k[6]
    w1 = k[10] + k[14] * y3 - k[15] * y2
    w2 = k[11] + k[15] * y1 - k[13] * y3
    w3 = k[12] + k[13] * y2 - k[14] * y1
    return (
        s[0, 0] * w1 + s[0, 1] * w2 + s[0, 2] * w3,
        s[1, 0] * w1 + s[1, 1] * w2 + s[1, 2] * w3,
        s[2, 0] * w1 + s[2, 1] * w2 + s[2, 2] * w3,
    )


@jit
def jacobian(frame, frame_columns, frame_support, carrier, carrier_columns, carrier_support, constants, out):
    """Fill the contact Jacobian J.

    Args:
        frame: (4, 4) placement of the contact's frame.
        frame_columns: (6, nv) motion of the world's origin, as if fixed to what each velocity moves, linear
            over angular, in world axes.
        frame_support: (nv,) booleans: the velocities that move the frame.
        carrier: (4, 4) placement of the frame that carries the plane; None for the world.
        carrier_columns: (6, nv) for the carrier, likewise.
        carrier_support: (nv,) likewise.
        constants: (16,) of the contact.
        out: (3, nv) takes J.

    Returns:
        t₁, t₂, n (9) in world axes, and what the surface does beyond its carrier (3), in contact axes.
    """
    _, n1, n2, n3, x1, x2, x3 = locate(frame, carrier, constants)
    a1, a2, a3, b1, b2, b3 = contact_axes(n1, n2, n3)
    f = frame_columns
    for j in range(out.shape[1]):
        u1 = u2 = u3 = 0.0
        if frame_support[j]:
            u1 = f[0, j] + f[4, j] * x3 - f[5, j] * x2
            u2 = f[1, j] + f[5, j] * x1 - f[3, j] * x3
            u3 = f[2, j] + f[3, j] * x2 - f[4, j] * x1
        if carrier is not None:
            c = carrier_columns
            if carrier_support[j]:
                u1 -= c[0, j] + c[4, j] * x3 - c[5, j] * x2
                u2 -= c[1, j] + c[5, j] * x1 - c[3, j] * x3
                u3 -= c[2, j] + c[3, j] * x2 - c[4, j] * x1
        out[0, j] = a1 * u1 + a2 * u2 + a3 * u3
        out[1, j] = b1 * u1 + b2 * u2 + b3 * u3
        out[2, j] = n1 * u1 + n2 * u2 + n3 * u3
    w1, w2, w3 = surface_velocity(carrier, constants, x1, x2, x3)
    return (
        *(a1, a2, a3, b1, b2, b3, n1, n2, n3),
        a1 * w1 + a2 * w2 + a3 * w3,
        b1 * w1 + b2 * w2 + b3 * w3,
        n1 * w1 + n2 * w2 + n3 * w3,
    )
