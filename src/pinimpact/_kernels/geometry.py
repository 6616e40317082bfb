"""Contact axes, and the contact point, gap and Jacobian in them."""

from __future__ import annotations

import math

from .jit import jit

SURFACE_CONSTANTS = 16
"""Length of the vector of constants that `locate` and `jacobian` read: the offset (3) and radius of the
contact, then point, normal, velocity and angular velocity (3 each) of its plane."""


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
        carrier: (4, 4) placement of the frame that carries the plane.
        constants: (16,) see `SURFACE_CONSTANTS`.

    Returns:
        The signed distance, n (3), the contact point (3), all in world axes.
    """
    f, s, k = frame, carrier, constants
    n1 = s[0, 0] * k[7] + s[0, 1] * k[8] + s[0, 2] * k[9]
    n2 = s[1, 0] * k[7] + s[1, 1] * k[8] + s[1, 2] * k[9]
    n3 = s[2, 0] * k[7] + s[2, 1] * k[8] + s[2, 2] * k[9]
    x1 = f[0, 3] + f[0, 0] * k[0] + f[0, 1] * k[1] + f[0, 2] * k[2] - k[3] * n1
    x2 = f[1, 3] + f[1, 0] * k[0] + f[1, 1] * k[1] + f[1, 2] * k[2] - k[3] * n2
    x3 = f[2, 3] + f[2, 0] * k[0] + f[2, 1] * k[1] + f[2, 2] * k[2] - k[3] * n3
    d1 = x1 - s[0, 3] - (s[0, 0] * k[4] + s[0, 1] * k[5] + s[0, 2] * k[6])
    d2 = x2 - s[1, 3] - (s[1, 0] * k[4] + s[1, 1] * k[5] + s[1, 2] * k[6])
    d3 = x3 - s[2, 3] - (s[2, 0] * k[4] + s[2, 1] * k[5] + s[2, 2] * k[6])
    return n1 * d1 + n2 * d2 + n3 * d3, n1, n2, n3, x1, x2, x3


@jit
def jacobian(frame, frame_jacobian, carrier, carrier_jacobian, constants, out, axes):
    """Fill the contact Jacobian Jᵀ = [K h] and the contact axes, and return the surface's own velocity.

    Args:
        frame: (4, 4) placement of the contact's frame.
        frame_jacobian: (6, nv) its Jacobian in world axes at its origin, linear over angular.
        carrier: (4, 4) placement of the frame that carries the plane.
        carrier_jacobian: (6, nv) its Jacobian, likewise.
        constants: (16,) see `SURFACE_CONSTANTS`.
        out: (nv, 3) takes Jᵀ.
        axes: (3, 3) takes t₁, t₂, n as its rows, in world axes.

    Returns:
        The velocity of the surface at the contact point that does not come from its carrier, in contact axes.
    """
    k = constants
    _, n1, n2, n3, x1, x2, x3 = locate(frame, carrier, constants)
    a1, a2, a3, b1, b2, b3 = contact_axes(n1, n2, n3)
    axes[0, 0], axes[0, 1], axes[0, 2] = a1, a2, a3
    axes[1, 0], axes[1, 1], axes[1, 2] = b1, b2, b3
    axes[2, 0], axes[2, 1], axes[2, 2] = n1, n2, n3
    r1, r2, r3 = x1 - frame[0, 3], x2 - frame[1, 3], x3 - frame[2, 3]
    s1, s2, s3 = x1 - carrier[0, 3], x2 - carrier[1, 3], x3 - carrier[2, 3]
    f, c = frame_jacobian, carrier_jacobian
    for j in range(out.shape[0]):
        u1 = f[0, j] + f[4, j] * r3 - f[5, j] * r2 - (c[0, j] + c[4, j] * s3 - c[5, j] * s2)
        u2 = f[1, j] + f[5, j] * r1 - f[3, j] * r3 - (c[1, j] + c[5, j] * s1 - c[3, j] * s3)
        u3 = f[2, j] + f[3, j] * r2 - f[4, j] * r1 - (c[2, j] + c[3, j] * s2 - c[4, j] * s1)
        out[j, 0] = a1 * u1 + a2 * u2 + a3 * u3
        out[j, 1] = b1 * u1 + b2 * u2 + b3 * u3
        out[j, 2] = n1 * u1 + n2 * u2 + n3 * u3
    s = carrier
    y1 = s[0, 0] * s1 + s[1, 0] * s2 + s[2, 0] * s3 - k[4]
    y2 = s[0, 1] * s1 + s[1, 1] * s2 + s[2, 1] * s3 - k[5]
    y3 = s[0, 2] * s1 + s[1, 2] * s2 + s[2, 2] * s3 - k[6]
    w1 = k[10] + k[14] * y3 - k[15] * y2
    w2 = k[11] + k[15] * y1 - k[13] * y3
    w3 = k[12] + k[13] * y2 - k[14] * y1
    u1 = s[0, 0] * w1 + s[0, 1] * w2 + s[0, 2] * w3
    u2 = s[1, 0] * w1 + s[1, 1] * w2 + s[1, 2] * w3
    u3 = s[2, 0] * w1 + s[2, 1] * w2 + s[2, 2] * w3
    return a1 * u1 + a2 * u2 + a3 * u3, b1 * u1 + b2 * u2 + b3 * u3, n1 * u1 + n2 * u2 + n3 * u3
