"""Dynamics of free bodies in the world, each with its own free-flyer joint.

Newton's and Euler's equations about the centre of mass c, in the body's axes, with v and ω of its joint:

    m (v̇ + ω̇ × c + ω × (v + ω × c)) = f + m g,   I ω̇ + ω × I ω = n − c × f.
"""

from __future__ import annotations

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign
from .placement import along, cross, rotate, rotate_back, slide, turn_by_quaternion

MASS, CENTER, INERTIA, INVERSE, PLACEMENT, BODY = 0, 1, 4, 13, 22, 34
"""Layout of the numbers of a body: mass, centre, inertia about it and its inverse, placement."""


@inlined
def times(k, at, a, b, c):
    """Return the product of the symmetric (3, 3) matrix at k[at:at + 9] and a vector."""
    return along(k, at, a, b, c), along(k, at + 3, a, b, c), along(k, at + 6, a, b, c)


@inlined
def set_placement(k, q, i, out):
    """Fill the placement (12,) of a joint with the coordinates q[i:i + 7]."""
    assign(out[:12], k[PLACEMENT:])
    slide(out, q[i], q[i + 1], q[i + 2])
    turn_by_quaternion(out, q[i + 3], q[i + 4], q[i + 5], q[i + 6])


@inlined
def set_motion(R, a, b, c, d, e, f, out):
    """Fill a motion (6,), given in the axes that R places, in world axes at the world's origin."""
    w1, w2, w3 = rotate(R, d, e, f)
    v1, v2, v3 = rotate(R, a, b, c)
    x1, x2, x3 = cross(R[9], R[10], R[11], w1, w2, w3)
    out[0], out[1], out[2], out[3], out[4], out[5] = v1 + x1, v2 + x2, v3 + x3, w1, w2, w3


@declared(INTEGER_ROWS, FLOAT_ROWS, FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def move_bodies(joints, bodies, q, v, placements, velocities):
    """Compute placements and velocities of n bodies.

    Args:
        joints: (n, 3) joint of each body, and the indices of its first coordinate and velocity.
        bodies: (n, BODY) numbers of each body, see `MASS`.
        q, v: (nq,) configuration and (nv,) velocity.
        placements, velocities: (nj, 12), (nj, 6) are overwritten; velocities are in the axes of the joints.
    """
    for k in range(len(joints)):
        j = joints[k, 0]
        set_placement(bodies[k], q, joints[k, 1], placements[j])
        assign(velocities[j], v[joints[k, 2] :])


@declared(
    *(INTEGER_ROWS, FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS),
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_COLUMNS),
)
@jit
def accelerate_bodies(
    joints, bodies, gravity, q, v, tau, acceleration, placements, velocities, accelerations, jacobian
):
    """Compute v̇ and the kinematics of n bodies, like `RobotDynamics.forward_dynamics`.

    Args:
        joints, bodies, q, v: As for `move_bodies`.
        gravity: (3,) [m/s²].
        tau: (nv,) generalized forces.
        acceleration: (nv,) is overwritten with v̇.
        placements: (nj, 12) is overwritten.
        velocities, accelerations, jacobian: (nj, 6), (nj, 6), (6, nv) are overwritten with velocities,
            accelerations minus gravity and the joint Jacobian, in world axes at the origin of the world.
    """
    for i in range(len(joints)):
        j, a, k = joints[i, 0], joints[i, 2], bodies[i]
        R = placements[j]
        set_placement(k, q, joints[i, 1], R)
        v1, v2, v3, w1, w2, w3 = v[a], v[a + 1], v[a + 2], v[a + 3], v[a + 4], v[a + 5]
        f1, f2, f3 = tau[a], tau[a + 1], tau[a + 2]
        c1, c2, c3 = k[CENTER], k[CENTER + 1], k[CENTER + 2]
        x1, x2, x3 = cross(c1, c2, c3, f1, f2, f3)
        i1, i2, i3 = times(k, INERTIA, w1, w2, w3)
        y1, y2, y3 = cross(w1, w2, w3, i1, i2, i3)
        d1, d2, d3 = times(k, INVERSE, tau[a + 3] - x1 - y1, tau[a + 4] - x2 - y2, tau[a + 5] - x3 - y3)
        g1, g2, g3 = rotate_back(R, gravity[0], gravity[1], gravity[2])
        x1, x2, x3 = cross(d1, d2, d3, c1, c2, c3)
        y1, y2, y3 = cross(w1, w2, w3, c1, c2, c3)
        y1, y2, y3 = cross(w1, w2, w3, v1 + y1, v2 + y2, v3 + y3)
        # without gravity
        b1, b2, b3 = f1 / k[MASS] - x1 - y1, f2 / k[MASS] - x2 - y2, f3 / k[MASS] - x3 - y3
        acceleration[a], acceleration[a + 1], acceleration[a + 2] = b1 + g1, b2 + g2, b3 + g3
        acceleration[a + 3], acceleration[a + 4], acceleration[a + 5] = d1, d2, d3
        set_motion(R, v1, v2, v3, w1, w2, w3, velocities[j])
        set_motion(R, b1, b2, b3, d1, d2, d3, accelerations[j])
        for e in range(3):
            r1, r2, r3 = R[3 * e], R[3 * e + 1], R[3 * e + 2]
            x1, x2, x3 = cross(R[9], R[10], R[11], r1, r2, r3)
            jacobian[0, a + e], jacobian[1, a + e], jacobian[2, a + e] = r1, r2, r3
            jacobian[0, a + 3 + e], jacobian[1, a + 3 + e], jacobian[2, a + 3 + e] = x1, x2, x3
            jacobian[3, a + 3 + e], jacobian[4, a + 3 + e], jacobian[5, a + 3 + e] = r1, r2, r3
