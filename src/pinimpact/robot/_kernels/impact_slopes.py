"""Derivatives of the impact of a robot at one contact. (derivatives.md, 5)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_COLUMNS, FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign, filled, largest
from ..._numeric.products import add
from ..._numeric.tolerances import EPS
from ...contact_space._kernels.codes import INVALID_NUMBERS, LOCKED, SLIP_RESUMED, STICKS
from ...contact_space._kernels.derivatives import SLOPES, WITHIN_RANGE, differentiate_into
from ...contact_space._kernels.path import MAX_MOVES, SCRATCH
from ...contact_space._kernels.recording import MOVE
from ...contact_space._kernels.slip_panels import ROOM
from ...contact_space.inputs import FACTOR
from .configuration_slopes import (
    AXES,
    ORIGIN,
    PLACE,
    POINT,
    SHIFT,
    fill_momenta,
    fill_motions,
    fill_place,
    force_slopes,
    mass_slopes,
    motion_cross,
    turn_slopes,
    velocity_slopes,
)
from .contact_kinematics import fill_by_axes
from .placement import cross, rotate, rotate_back
from .robot_impact import NOT_NORMALIZED, SINGULAR_MASS, all_finite, evaluate, evaluate_contact, parts
from .robot_workspace import RobotWorkspace
from .tree import factor, solve, solve_mass

SURFACE, FRICTION, RESTITUTION, VALUE, MORE = 0, 6, 7, 8, 9
"""Columns of the results after those of q and q̇: surface velocity and angular velocity, μ and e, and the
values themselves. Rows are those of q̇⁺ and, in world axes, of P."""

AT_REST = 32.0 * EPS
"""Slip velocity before the impact, over the size of the terms that it is the sum of, below which it is taken
as zero: rounding decides its direction, and derivatives across that do not exist."""


@declared(
    *(FLOAT_COLUMNS, INTEGERS, INTEGERS, INTEGERS, FLOAT_ROWS, int, int, FLOATS, FLOAT_ROWS, FLOAT_ROWS),
    *(FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS),
)
@jit
def impact_slopes(
    J, joint, parent, before, inertia, tip, base, at, shifts, y, v, impulse, data, forces, turned
):  # fmt: skip
    """Compute the derivatives by q of the contact-space problem and of the generalized impulse. (D17)

    Args:
        J … inertia: As for `mass_slopes`.
        tip … shifts: As for `velocity_slopes`.
        y: (3, nv) Δq̇ per unit impulse along each contact axis.
        v: (nv,) pre-impact velocity.
        impulse: (3,) P in contact axes.
        data: (9, nv) is overwritten with ∂v°/∂q and the derivatives of w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃.
        forces: (nv, nv) is overwritten with ∂(JᵀP)/∂q − D(Δ).
        turned: (3, nv) is overwritten with the change of P in world axes for constant P in contact axes.
    """
    nv, joints = len(v), len(parent)
    motions, momenta = np.empty((4, joints, 6)), np.empty((4, joints, 6))
    moved, bends = np.empty((3, 3, nv)), np.empty((3, 6))
    fill_motions(J, joint, parent, v, motions[3])
    velocity_slopes(J, joint, parent, tip, base, at, shifts, motions[3], True, data[:3])
    motions[3, :, :] = 0.0
    momenta[3, :, :] = 0.0
    for a in range(3):
        fill_motions(J, joint, parent, y[a], motions[a])
        fill_momenta(J, joint, parent, inertia, y[a], motions[a], momenta[a])
        velocity_slopes(J, joint, parent, tip, base, at, shifts, motions[a], False, moved[a])
        for i in range(joints):
            add(motions[3, i], -impulse[a], motions[a, i])  # those of −Δ
            add(momenta[3, i], -impulse[a], momenta[a, i])
    for k in range(nv):
        i = joint[k]
        for a in range(3):
            x = motions[a, parent[i]]
            bend = motion_cross(J, k, x[0], x[1], x[2], x[3], x[4], x[5])
            assign(bends[a], bend)
        row = 3
        for a in range(3):
            for b in range(a, 3):
                total = moved[a, b, k] + moved[b, a, k]
                for r in range(6):
                    total += bends[a, r] * momenta[b, i, r] + bends[b, r] * momenta[a, i, r]
                data[row, k] = total
                row += 1
    mass_slopes(J, joint, parent, before, inertia, motions[3], momenta[3], forces)
    f1, f2, f3 = rotate(at, impulse[0], impulse[1], impulse[2])
    force_slopes(J, joint, parent, at, shifts, f1, f2, f3, forces)
    turn_slopes(shifts, f1, f2, f3, turned)


@inlined
def by(slope, change):
    """Return a slope times a change; 0 for a zero change, even if the slope is NaN."""
    return slope * change if change != 0.0 else 0.0


@declared(FLOAT_ROWS, FLOATS, float, float, bool, FLOAT_ROWS, FLOAT_ROWS)
@jit
def fill_kinks(delassus, velocity, still, friction, stops, data, kinks):
    """Fill the changes of q that move a contact where no impulse does, if its slip ends in the impact.

    Friction along such a tangential direction n takes the sign of the slightest slip, or tendency to slip. It
    moves nothing at q, but does at changed configurations: derivatives hold for δq with `kinks` δq = 0.
    n is in the null space of the tangential part of W, and turns with it.

    Args:
        delassus: (3, 3) Delassus matrix.
        velocity: (2,) slip before the impact [m/s].
        still: Slip up to which there is none [m/s].
        friction: Coefficient of friction.
        stops: Whether slip ends during the impact.
        data: (9, nv) as for `impact_slopes`.
        kinks: (4, nv) is overwritten with the changes of slip and of W₁₃ and W₂₃ along such directions,
            relative to the largest ones of their kind; zero if there are none.
    """
    filled(kinks, 0.0)
    v1, v2 = velocity[0], velocity[1]
    if friction == 0.0 or not (stops or math.hypot(v1, v2) <= still):
        return
    a11, a12, a22 = delassus[0, 0], delassus[0, 1], delassus[1, 1]
    zero = AT_REST * (a11 + a22 + delassus[2, 2])
    mean, half = 0.5 * (a11 + a22), math.hypot(0.5 * (a11 - a22), a12)
    if mean - half > zero:
        return
    n1, n2, larger = 1.0, 0.0, mean + half  # the direction n, and the eigenvalue of that across it
    if larger > zero:
        turn = 0.5 * math.atan2(a12, 0.5 * (a11 - a22))
        n1, n2 = -math.sin(turn), math.cos(turn)
        if abs(n1 * v1 + n2 * v2) > still:
            return
    elif math.hypot(v1, v2) > still:
        return
    speed, size = largest(data[:3].ravel()), largest(data[3:].ravel())
    across_v, across_b = n2 * v1 - n1 * v2, n2 * delassus[0, 2] - n1 * delassus[1, 2]
    for k in range(kinks.shape[1]):
        slip, pull = n1 * data[0, k] + n2 * data[1, k], n1 * data[5, k] + n2 * data[7, k]
        if larger > zero:  # n turns with q
            turned = n2 * (data[3, k] * n1 + data[4, k] * n2) - n1 * (data[4, k] * n1 + data[6, k] * n2)
            slip, pull = slip - across_v * turned / larger, pull - across_b * turned / larger
        else:
            kinks[1, k] = data[1, k] / speed if speed > 0.0 else 0.0
            kinks[3, k] = data[7, k] / size if size > 0.0 else 0.0
        kinks[0, k] = slip / speed if speed > 0.0 else 0.0
        kinks[2, k] = pull / size if size > 0.0 else 0.0


@declared(
    *(FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOATS, FLOATS, FLOAT_ROWS, float, bool, FLOAT_ROWS),
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS),
)
@jit
def assemble(at, carrier, jacobian, y, v, impulse, slopes, slope, by_q, data, responses, turned, out):
    """Compute the derivatives of an impact from those in contact space. (D17)

    Args:
        at, y, v, impulse, data, turned: As for `impact_slopes`.
        carrier: (12,) placement of the body in whose axes the surface velocities are.
        jacobian: (3, nv) J.
        slopes: (3, SLOPES) derivatives of P in contact axes.
        slope: de/d(approach speed) [s/m].
        by_q: Whether the columns of q are filled; if not, `data`, `responses` and `turned` are not read.
        responses: (nv, nv) M⁻¹ times the `forces` of `impact_slopes`.
        out: (nv + 3, 2 nv + MORE) is overwritten with the derivatives; for its columns see `SURFACE`.
    """
    nv = len(v)
    first, more = 0 if by_q else nv, 2 * nv
    rows = np.empty((3, more + MORE))
    x1, x2, x3 = at[POINT] - at[ORIGIN], at[POINT + 1] - at[ORIGIN + 1], at[POINT + 2] - at[ORIGIN + 2]
    moving = np.empty((6, 3))  # velocity of the point, in contact axes, per unit surface velocity and spin
    for j in range(3):
        d1, d2, d3 = carrier[3 * j], carrier[3 * j + 1], carrier[3 * j + 2]
        moving[j, 0], moving[j, 1], moving[j, 2] = rotate_back(at, d1, d2, d3)
        d1, d2, d3 = cross(d1, d2, d3, x1, x2, x3)
        moving[3 + j, 0], moving[3 + j, 1], moving[3 + j, 2] = rotate_back(at, d1, d2, d3)
    for i in range(3):
        row, s = rows[i], slopes[i]
        s1, s2, s3 = s[0], s[1], s[2] - slope * s[13]
        for k in range(first, nv):
            row[k] = by(s1, data[0, k]) + by(s2, data[1, k]) + by(s3, data[2, k])
            j = 3
            for a in range(3):
                for b in range(a, 3):
                    row[k] += by(s[3 + 3 * a + b] * (1.0 if a == b else 2.0), data[j, k])
                    j += 1
        for k in range(nv):
            row[nv + k] = by(s1, jacobian[0, k]) + by(s2, jacobian[1, k]) + by(s3, jacobian[2, k])
        for j in range(6):
            row[more + SURFACE + j] = -by(s1, moving[j, 0]) - by(s2, moving[j, 1]) - by(s3, moving[j, 2])
        row[more + FRICTION], row[more + RESTITUTION], row[more + VALUE] = s[12], s[13], impulse[i]
    for m in range(nv):
        y1, y2, y3 = y[0, m], y[1, m], y[2, m]
        for k in range(first, more + MORE):
            out[m, k] = y1 * rows[0, k] + y2 * rows[1, k] + y3 * rows[2, k]
        for k in range(first, nv):
            out[m, k] += responses[m, k]
        out[m, nv + m] += 1.0
        out[m, more + VALUE] += v[m]
    for i in range(3):
        a1, a2, a3 = at[AXES + i], at[AXES + 3 + i], at[AXES + 6 + i]
        for k in range(first, more + MORE):
            out[nv + i, k] = a1 * rows[0, k] + a2 * rows[1, k] + a3 * rows[2, k]
        for k in range(first, nv):
            out[nv + i, k] += turned[i, k]


@inlined
def _dynamic_parameters(bodies, out):
    """Fill mass, first moment and inertia about the origin (joints, 10) of composite bodies, see `BODY`."""
    for i in range(len(out)):
        m, c1, c2, c3 = bodies[i, 12], bodies[i, 13], bodies[i, 14], bodies[i, 15]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = m, m * c1, m * c2, m * c3
        out[i, 4] = bodies[i, 16] + m * (c2 * c2 + c3 * c3)
        out[i, 5] = bodies[i, 17] - m * c1 * c2
        out[i, 6] = bodies[i, 18] + m * (c1 * c1 + c3 * c3)
        out[i, 7] = bodies[i, 19] - m * c1 * c3
        out[i, 8] = bodies[i, 20] - m * c2 * c3
        out[i, 9] = bodies[i, 21] + m * (c1 * c1 + c2 * c2)


@declared(RobotWorkspace, FLOATS, FLOATS, float, float, bool, FLOAT_ROWS, FLOAT_ROWS)
@jit
def robot_slopes(work, q, v, e, slope, by_q, out, kinks):
    """Differentiate the impact of one contact; return the status of `robot_impact`, and flags of `Boundary`.

    v (nv,) is the pre-impact velocity, e the coefficient of restitution, kinks (4, nv) that of `fill_kinks`;
    other arguments as for `assemble`.
    """
    bodies, columns, mass, frame, carrier, room = parts(work, work.scratch)
    if not evaluate(work, q, bodies, columns, mass, frame, carrier):
        return NOT_NORMALIZED, 0
    if not (all_finite(q) and all_finite(v)):
        return INVALID_NUMBERS, 0
    nv, before = work.nv, work.velocity_parent
    lower, y = room[: nv * nv].reshape((nv, nv)), room[nv * nv : (nv + 3) * nv].reshape((3, nv))
    if factor(mass, before, lower) >= 0:
        return SINGULAR_MASS, 0
    numbers, codes, boundary = np.empty((1, 7)), np.empty((1, 3), dtype=np.int64), np.empty(1, dtype=np.int64)
    slopes, singular, jacobian = np.empty((6, SLOPES)), np.empty(FACTOR), np.empty((3, nv))
    at, axes = np.empty(PLACE), np.empty(9)
    geometry, w, relative, scale, known = evaluate_contact(
        frame, carrier, columns, work.signs, work.constants, v, lower, before, y, singular
    )
    w11, w12, w13, w22, w23, w33 = w
    v1, v2, v3 = relative
    if math.hypot(v1, v2) <= AT_REST * scale:
        v1 = v2 = 0.0
    differentiate_into(
        *(0, w11, w12, w13, w22, w23, w33, v1, v2, v3, work.friction, e, work.law, scale),
        *(singular[:known], np.empty(SCRATCH + ROOM), np.empty((MAX_MOVES + 1, MOVE))),
        *(numbers, codes, slopes, boundary),
    )
    status = codes[0, 0]
    if not 0 <= status <= LOCKED:
        return status, 0
    fill_by_axes(columns, work.signs, geometry[12], geometry[13], geometry[14], geometry[:9], jacobian)
    assign(axes, geometry)
    impulse, n = numbers[0][3:6], nv if by_q else 0
    shifts = np.empty((n, SHIFT))
    fill_place(
        *(frame, carrier, work.constants, axes, True, columns, work.velocity_joint, work.joint_parent),
        *(work.frame_joint, work.carrier_joint, at, shifts),
    )
    solve(lower, before, y)
    data, responses, turned = np.empty((9, n)), np.empty((n, n)), np.empty((3, n))
    if by_q:
        inertia = np.empty((work.bodies, 10))
        _dynamic_parameters(bodies, inertia)
        impact_slopes(
            *(columns, work.velocity_joint, work.joint_parent, before, inertia),
            *(work.frame_joint, work.carrier_joint, at, shifts, y, v, impulse, data, responses, turned),
        )
        solve_mass(lower, before, responses)
    assemble(at, carrier, jacobian, y, v, impulse, slopes[3:], slope, by_q, data, responses, turned, out)
    if by_q:
        delassus = np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]])
        stops = codes[0, 1] & (STICKS | SLIP_RESUMED) > 0
        fill_kinks(delassus, np.array([v1, v2]), AT_REST * scale, work.friction, stops, data, kinks)
    if boundary[0] & WITHIN_RANGE:  # surfaces can move in other directions
        boundary[0] -= WITHIN_RANGE
        for i in range(out.shape[0]):
            filled(out[i, 2 * nv + SURFACE : 2 * nv + FRICTION], math.nan)
    return status, boundary[0]
