"""Local charts of a configuration space, q = q₀ ⊕ ξ, and their rates ξ̇. (9.1)

The space is described by a table (k, 4) of integers with one row per joint: kind, first index in q, first
index in v, number of velocities. Rotations use the exponential map about q₀, translations of floating bodies
the axes of q₀: R = R₀ exp(φ), p = p₀ + R₀ ρ.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOATS, INTEGER_ROWS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign
from .tolerances import TURN

VECTOR, CIRCLE, PLANAR, ROTATION, RIGID = range(5)
"""Kinds: plain numbers; (cos, sin); (x, y, cos, sin); quaternion (x, y, z, w); position and quaternion."""

ASTRAY = 1e50
"""Bound on coordinates and velocities: larger ones come from too long a step, and squares may overflow."""


@inlined
def half_turn(angle):
    """Return sin(θ/2)/θ, cos(θ/2) and (1 − (θ/2) cot(θ/2))/θ² for an angle θ [rad]."""
    h = 0.5 * angle
    if angle < TURN:
        s = h * h
        return (
            0.5 * (1.0 - s / 6.0 * (1.0 - s / 20.0)),
            math.cos(h),
            (1.0 + s / 15.0 * (1.0 + 2.0 * s / 21.0)) / 12.0,
        )
    return math.sin(h) / angle, math.cos(h), (1.0 - h / math.tan(h)) / (angle * angle)


@inlined
def rotate(x, y, z, w, a, b, c):
    """Return the vector (a, b, c) rotated by a unit quaternion."""
    u, v, t = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * u + y * t - z * v, b + w * v + z * u - x * t, c + w * t + x * v - y * u


@declared(INTEGER_ROWS, FLOATS, FLOATS, FLOATS)
@jit
def advance(joints, q0, xi, q):
    """Fill q = q₀ ⊕ ξ, normalised."""
    for k in range(joints.shape[0]):
        kind, i, j, n = joints[k, 0], joints[k, 1], joints[k, 2], joints[k, 3]
        if kind == VECTOR:
            for m in range(n):
                q[i + m] = q0[i + m] + xi[j + m]
        elif kind in (CIRCLE, PLANAR):
            i2, j2 = i, j
            if kind == PLANAR:
                i2, j2 = i + 2, j + 2
                q[i] = q0[i] + q0[i2] * xi[j] - q0[i2 + 1] * xi[j + 1]
                q[i + 1] = q0[i + 1] + q0[i2 + 1] * xi[j] + q0[i2] * xi[j + 1]
            c, s = math.cos(xi[j2]), math.sin(xi[j2])
            a, b = q0[i2] * c - q0[i2 + 1] * s, q0[i2] * s + q0[i2 + 1] * c
            r = math.sqrt(a * a + b * b)
            q[i2], q[i2 + 1] = a / r, b / r
        else:
            i2, j2 = i, j
            if kind == RIGID:
                i2, j2 = i + 3, j + 3
            x, y, z, w = q0[i2], q0[i2 + 1], q0[i2 + 2], q0[i2 + 3]
            if kind == RIGID:
                d1, d2, d3 = rotate(x, y, z, w, xi[j], xi[j + 1], xi[j + 2])
                q[i], q[i + 1], q[i + 2] = q0[i] + d1, q0[i + 1] + d2, q0[i + 2] + d3
            f1, f2, f3 = xi[j2], xi[j2 + 1], xi[j2 + 2]
            s, c, _ = half_turn(math.sqrt(f1 * f1 + f2 * f2 + f3 * f3))
            f1, f2, f3 = s * f1, s * f2, s * f3
            x, y, z, w = (
                w * f1 + x * c + y * f3 - z * f2,
                w * f2 + y * c + z * f1 - x * f3,
                w * f3 + z * c + x * f2 - y * f1,
                w * c - x * f1 - y * f2 - z * f3,
            )
            r = math.sqrt(x * x + y * y + z * z + w * w)
            q[i2], q[i2 + 1], q[i2 + 2], q[i2 + 3] = x / r, y / r, z / r, w / r


@declared(INTEGER_ROWS, FLOATS, FLOATS, FLOATS)
@jit
def chart_rate(joints, xi, v, rate):
    """Fill rate = ξ̇ for the velocity v at ξ; valid while no rotation of the chart reaches 2π. (9.1)"""
    for k in range(joints.shape[0]):
        kind, j, n = joints[k, 0], joints[k, 2], joints[k, 3]
        if kind in (VECTOR, CIRCLE):
            for m in range(n):
                rate[j + m] = v[j + m]
        elif kind == PLANAR:
            c, s = math.cos(xi[j + 2]), math.sin(xi[j + 2])
            rate[j] = c * v[j] - s * v[j + 1]
            rate[j + 1] = s * v[j] + c * v[j + 1]
            rate[j + 2] = v[j + 2]
        else:
            j2 = j + 3 if kind == RIGID else j
            f1, f2, f3 = xi[j2], xi[j2 + 1], xi[j2 + 2]
            s, c, e = half_turn(math.sqrt(f1 * f1 + f2 * f2 + f3 * f3))
            if kind == RIGID:
                rate[j], rate[j + 1], rate[j + 2] = rotate(
                    s * f1, s * f2, s * f3, c, v[j], v[j + 1], v[j + 2]
                )
            w1, w2, w3 = v[j2], v[j2 + 1], v[j2 + 2]
            x1, x2, x3 = f2 * w3 - f3 * w2, f3 * w1 - f1 * w3, f1 * w2 - f2 * w1
            rate[j2] = w1 + 0.5 * x1 + e * (f2 * x3 - f3 * x2)
            rate[j2 + 1] = w2 + 0.5 * x2 + e * (f3 * x1 - f1 * x3)
            rate[j2 + 2] = w3 + 0.5 * x3 + e * (f1 * x2 - f2 * x1)


@declared(INTEGER_ROWS, FLOATS, FLOATS, FLOATS)
@jit
def turn_axes(joints, turn, v, out):
    """Fill out (nv,) with v in axes of free bodies that have turned by exp(φ), φ from `turn` (nv,)."""
    assign(out, v)
    for k in range(joints.shape[0]):
        kind, j = joints[k, 0], joints[k, 2]
        if kind == PLANAR:
            c, s = math.cos(turn[j + 2]), math.sin(turn[j + 2])
            out[j], out[j + 1] = c * v[j] + s * v[j + 1], c * v[j + 1] - s * v[j]
        elif kind == RIGID:
            f1, f2, f3 = turn[j + 3], turn[j + 4], turn[j + 5]
            s, c, _ = half_turn(math.sqrt(f1 * f1 + f2 * f2 + f3 * f3))
            out[j], out[j + 1], out[j + 2] = rotate(-s * f1, -s * f2, -s * f3, c, v[j], v[j + 1], v[j + 2])


@declared(INTEGER_ROWS, float, float, FLOATS, FLOATS, FLOATS)
@jit
def velocity_within(joints, h, part, start, v_end, out):
    """Fill the velocity within a time step: linear in time, for free bodies in fixed axes. (theory.md, 16)

    Args:
        joints: Table of the configuration space.
        h: Length of the step [s].
        part: Fraction of the step.
        start: (nv,) velocity at the start.
        v_end: (nv,) velocity at the end, in the axes of the midpoint.
        out: (nv,) is overwritten with the velocity, in the axes of that time.
    """
    turn, last = np.empty((2, len(start)))
    for m in range(len(start)):
        turn[m] = -0.5 * h * start[m]
    turn_axes(joints, turn, v_end, last)
    for m in range(len(start)):
        turn[m] = part * h * (start[m] + 0.5 * part * (last[m] - start[m]))
        last[m] = (1.0 - part) * start[m] + part * last[m]
    turn_axes(joints, turn, last, out)


@inlined
def add_turning(joints, v, factor, out):
    """Add `factor` times ω × v of free bodies to out (nv,): acceleration in fixed axes minus v̇."""
    for k in range(joints.shape[0]):
        kind, j = joints[k, 0], joints[k, 2]
        if kind == PLANAR:
            out[j] -= factor * v[j + 2] * v[j + 1]
            out[j + 1] += factor * v[j + 2] * v[j]
        elif kind == RIGID:
            a, b, c, x, y, z = v[j], v[j + 1], v[j + 2], v[j + 3], v[j + 4], v[j + 5]
            out[j] += factor * (y * c - z * b)
            out[j + 1] += factor * (z * a - x * c)
            out[j + 2] += factor * (x * b - y * a)


@inlined
def diverged(xi, v):
    """Return whether chart coordinates or velocities exceed `ASTRAY` or are not finite."""
    exceeded = False
    for m in range(len(v)):
        exceeded |= not (abs(xi[m]) < ASTRAY and abs(v[m]) < ASTRAY)
    return exceeded


@declared(INTEGER_ROWS, FLOATS)
@jit
def turned_too_far(joints, xi):
    """Return whether a rotation of the chart reaches 3 rad, so that the step is too long for the chart."""
    for k in range(joints.shape[0]):
        if joints[k, 0] >= ROTATION:
            j = joints[k, 2] + joints[k, 3] - 3
            if not xi[j] ** 2 + xi[j + 1] ** 2 + xi[j + 2] ** 2 < 9.0:
                return True
    return False


@declared(INTEGER_ROWS, FLOATS, FLOATS)
@jit
def magnitudes(joints, q, out):
    """Fill out (nv,) with magnitudes for relative tolerances: |q| of plain coordinates, 1 of rotations."""
    for k in range(joints.shape[0]):
        kind, i, j, n = joints[k, 0], joints[k, 1], joints[k, 2], joints[k, 3]
        for m in range(n):
            if kind == VECTOR or (kind == RIGID and m < 3) or (kind == PLANAR and m < 2):
                out[j + m] = abs(q[i + m])
            else:
                out[j + m] = 1.0
