"""Placements, Jacobian and mass matrix of a kinematic tree, from the numbers of its model.

Composite rigid bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2). All vectors are in
world axes, relative to the first joint, so that the distance of the robot from the world's origin does not
matter.
"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.tolerances import HALF_DIGITS
from . import robot_workspace
from .placement import rotate, slide, turn_by, turn_by_quaternion

BODY = 22
"""Numbers of a joint: its placement, then mass, centre and inertia of its composite body."""


@inlined
def placed(body, placement, out):
    """Fill `out` with the product of a body's placement and a placement (12,) on it."""
    for k in (0, 3, 6):
        out[k], out[k + 1], out[k + 2] = rotate(body, placement[k], placement[k + 1], placement[k + 2])
    x, y, z = rotate(body, placement[9], placement[10], placement[11])
    out[9], out[10], out[11] = x + body[9], y + body[10], z + body[11]


@inlined
def _turn(R, axis, cos, sin):
    """Rotate a placement about one of its axes."""
    a, b = 3 * ((axis + 1) % 3), 3 * ((axis + 2) % 3)
    for i in range(3):
        x, y = R[a + i], R[b + i]
        R[a + i], R[b + i] = cos * x + sin * y, cos * y - sin * x


@inlined
def _turn_about(R, a, cos, sin):
    """Rotate a placement about a unit vector in its axes."""
    x, y, z = a[0], a[1], a[2]
    m = 1.0 - cos
    turn_by(
        R,
        *(cos + m * x * x, m * x * y + sin * z, m * x * z - sin * y),
        *(m * x * y - sin * z, cos + m * y * y, m * y * z + sin * x),
        *(m * x * z + sin * y, m * y * z - sin * x, cos + m * z * z),
    )


@inlined
def _move(work, j, q, R):
    """Move joint j's placement by its coordinates; return whether they are normalized."""
    kind, axis, at = work.joint_kind[j], work.joint_axis[j], work.joint_q[j]
    if kind in (robot_workspace.REVOLUTE, robot_workspace.UNBOUNDED):
        if kind == robot_workspace.REVOLUTE:
            cos, sin = math.cos(q[at]), math.sin(q[at])
        else:
            cos, sin = q[at], q[at + 1]
        if axis >= 0:
            _turn(R, axis, cos, sin)
        else:
            _turn_about(R, work.velocity_axis[work.joint_v[j]], cos, sin)
        return kind == robot_workspace.REVOLUTE or abs(math.sqrt(cos * cos + sin * sin) - 1.0) <= HALF_DIGITS
    if kind == robot_workspace.PRISMATIC:
        a = work.velocity_axis[work.joint_v[j]]
        slide(R, q[at] * a[0], q[at] * a[1], q[at] * a[2])
        return True
    if kind == robot_workspace.PLANAR:
        slide(R, q[at], q[at + 1], 0.0)
        _turn(R, 2, q[at + 2], q[at + 3])
        return abs(math.sqrt(q[at + 2] * q[at + 2] + q[at + 3] * q[at + 3]) - 1.0) <= HALF_DIGITS
    if kind in (robot_workspace.TRANSLATION, robot_workspace.FREE_FLYER):
        slide(R, q[at], q[at + 1], q[at + 2])
        at += 3
    if kind in (robot_workspace.SPHERICAL, robot_workspace.FREE_FLYER):
        x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
        turn_by_quaternion(R, x, y, z, w)
        return abs(math.sqrt(x * x + y * y + z * z + w * w) - 1.0) <= HALF_DIGITS
    return True


@inlined
def _add(parent, m, c1, c2, c3, xx, xy, yy, xz, yz, zz):
    """Add a rigid body (mass, centre, inertia about it) to the composite body."""
    old = parent[12]
    total = old + m
    if m == 0.0 or total == 0.0:
        part, reduced = 0.0, 0.0
    else:
        part, reduced = m / total, old * m / total
    d1, d2, d3 = c1 - parent[13], c2 - parent[14], c3 - parent[15]
    parent[12] = total
    parent[13] += part * d1
    parent[14] += part * d2
    parent[15] += part * d3
    parent[16] += xx + reduced * (d2 * d2 + d3 * d3)
    parent[17] += xy - reduced * d1 * d2
    parent[18] += yy + reduced * (d1 * d1 + d3 * d3)
    parent[19] += xz - reduced * d1 * d3
    parent[20] += yz - reduced * d2 * d3
    parent[21] += zz + reduced * (d1 * d1 + d2 * d2)


@inlined
def _own_inertia(body, inertia):
    """Initialize the composite body of a joint with its own link."""
    c1, c2, c3 = rotate(body, inertia[1], inertia[2], inertia[3])
    xx, xy, yy, xz, yz, zz = inertia[4], inertia[5], inertia[6], inertia[7], inertia[8], inertia[9]
    r1, r2, r3, r4, r5, r6, r7, r8, r9 = (
        *(body[0], body[1], body[2], body[3], body[4], body[5], body[6], body[7], body[8]),
    )
    # R I, column by column
    a1, a2, a3 = r1 * xx + r4 * xy + r7 * xz, r2 * xx + r5 * xy + r8 * xz, r3 * xx + r6 * xy + r9 * xz
    b1, b2, b3 = r1 * xy + r4 * yy + r7 * yz, r2 * xy + r5 * yy + r8 * yz, r3 * xy + r6 * yy + r9 * yz
    d1, d2, d3 = r1 * xz + r4 * yz + r7 * zz, r2 * xz + r5 * yz + r8 * zz, r3 * xz + r6 * yz + r9 * zz
    body[12] = inertia[0]
    body[13], body[14], body[15] = c1 + body[9], c2 + body[10], c3 + body[11]
    body[16] = a1 * r1 + b1 * r4 + d1 * r7
    body[17] = a1 * r2 + b1 * r5 + d1 * r8
    body[18] = a2 * r2 + b2 * r5 + d2 * r8
    body[19] = a1 * r3 + b1 * r6 + d1 * r9
    body[20] = a2 * r3 + b2 * r6 + d2 * r9
    body[21] = a3 * r3 + b3 * r6 + d3 * r9


@declared(robot_workspace.RobotWorkspace, FLOATS, FLOAT_ROWS, FLOAT_COLUMNS, FLOAT_ROWS, result=bool)
@external
def tree_matrices(work, q, bodies, columns, mass):
    """Evaluate a kinematic tree at q (nq,); return whether q is normalized.

    Args:
        work: The workspace.
        q: (nq,) configuration.
        bodies: (bodies, BODY); the first twelve columns are overwritten with the placements of the joints,
            the world first.
        columns: (6, nv) is overwritten with the joint Jacobian at the reference point.
        mass: (nv, nv); the entries of each velocity and its ancestors are overwritten with those of M.
    """
    n = work.bodies
    bodies[0, :] = 0.0
    bodies[0, 0] = bodies[0, 4] = bodies[0, 8] = 1.0
    normalized = True
    for j in range(1, n):
        body = bodies[j]
        placed(bodies[work.joint_parent[j]], work.joint_placements[j], body)
        if not _move(work, j, q, body):
            normalized = False
        if j == 1:
            for i in range(9, 12):
                bodies[0, i] = -body[i]
                body[i] = 0.0
        _own_inertia(body, work.inertias[j])
    for i in range(work.nv):
        body, a = bodies[work.velocity_joint[i]], work.velocity_axis[i]
        x, y, z = rotate(body, a[0], a[1], a[2])
        if work.velocity_turns[i] > 0:
            columns[0, i] = body[10] * z - body[11] * y
            columns[1, i] = body[11] * x - body[9] * z
            columns[2, i] = body[9] * y - body[10] * x
            columns[3, i], columns[4, i], columns[5, i] = x, y, z
        else:
            columns[0, i], columns[1, i], columns[2, i] = x, y, z
            columns[3, i] = columns[4, i] = columns[5, i] = 0.0
    for j in range(n - 1, 0, -1):
        body, parent = bodies[j], work.joint_parent[j]
        m, c1, c2, c3, xx, xy, yy, xz, yz, zz = (
            *(body[12], body[13], body[14], body[15], body[16], body[17]),
            *(body[18], body[19], body[20], body[21]),
        )
        first = work.joint_v[j]
        last = work.joint_v[j + 1] if j + 1 < n else work.nv
        for i in range(first, last):
            u1, u2, u3, w1, w2, w3 = (
                *(columns[0, i], columns[1, i], columns[2, i]),
                *(columns[3, i], columns[4, i], columns[5, i]),
            )
            f1 = m * (u1 + w2 * c3 - w3 * c2)
            f2 = m * (u2 + w3 * c1 - w1 * c3)
            f3 = m * (u3 + w1 * c2 - w2 * c1)
            t1 = xx * w1 + xy * w2 + xz * w3 + c2 * f3 - c3 * f2
            t2 = xy * w1 + yy * w2 + yz * w3 + c3 * f1 - c1 * f3
            t3 = xz * w1 + yz * w2 + zz * w3 + c1 * f2 - c2 * f1
            k = i
            while k >= 0:
                mass[i, k] = (
                    columns[0, k] * f1
                    + columns[1, k] * f2
                    + columns[2, k] * f3
                    + (columns[3, k] * t1 + columns[4, k] * t2 + columns[5, k] * t3)
                )
                k = work.velocity_parent[k]
            mass[i, i] += work.armature[i]
        if parent > 0:
            _add(bodies[parent], m, c1, c2, c3, xx, xy, yy, xz, yz, zz)
    return normalized


@declared(robot_workspace.RobotWorkspace, FLOATS, FLOAT_ROWS, FLOAT_COLUMNS, FLOAT_ROWS)
@jit
def evaluate_tree(work, q, bodies, columns, mass):
    """Call `tree_matrices` from Python."""
    return tree_matrices(work, q, bodies, columns, mass)
