"""Vectors and points transformed by a placement.

A placement is twelve numbers, the rotation column by column and then the translation: a tuple, or a row of
the array in which Pinocchio stores its placements.
"""

from __future__ import annotations

from ..._compile.jit import inlined


@inlined
def pose(matrix):
    """Return the placement of a homogeneous (4, 4) matrix."""
    m = matrix
    return (
        *(m[0, 0], m[1, 0], m[2, 0]),
        *(m[0, 1], m[1, 1], m[2, 1]),
        *(m[0, 2], m[1, 2], m[2, 2]),
        *(m[0, 3], m[1, 3], m[2, 3]),
    )


@inlined
def cross(a1, a2, a3, b1, b2, b3):
    """Return a × b (3)."""
    return a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1


@inlined
def rotate(R, a, b, c):
    """Return R x: the vector x = (a, b, c), given in the axes that R places, in the outer axes."""
    return (R[0] * a + R[3] * b + R[6] * c, R[1] * a + R[4] * b + R[7] * c, R[2] * a + R[5] * b + R[8] * c)


@inlined
def rotate_back(R, a, b, c):
    """Return Rᵀ x: the vector x = (a, b, c), given in the outer axes, in the axes that R places."""
    return along(R, 0, a, b, c), along(R, 3, a, b, c), along(R, 6, a, b, c)


@inlined
def along(k, i, a, b, c):
    """Return the dot product of the vector k[i:i + 3] and another."""
    return k[i] * a + k[i + 1] * b + k[i + 2] * c


@inlined
def direction(R, k, i):
    """Rotate the vector k[i:i + 3]."""
    return rotate(R, k[i], k[i + 1], k[i + 2])


@inlined
def place(R, k, i):
    """Transform the point k[i:i + 3]."""
    a, b, c = rotate(R, k[i], k[i + 1], k[i + 2])
    return a + R[9], b + R[10], c + R[11]


@inlined
def slide(R, x, y, z):
    """Translate a placement along its own axes."""
    x, y, z = rotate(R, x, y, z)
    R[9] += x
    R[10] += y
    R[11] += z


@inlined
def turn_by(R, l11, l21, l31, l12, l22, l32, l13, l23, l33):
    """Rotate a placement by a rotation matrix, given column by column."""
    x, y, z = rotate(R, l11, l21, l31), rotate(R, l12, l22, l32), rotate(R, l13, l23, l33)
    for i in range(3):
        R[i], R[3 + i], R[6 + i] = x[i], y[i], z[i]


@inlined
def turn_by_quaternion(R, x, y, z, w):
    """Rotate a placement by a unit quaternion."""
    turn_by(
        R,
        *(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        *(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        *(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
