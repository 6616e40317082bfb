"""Reference directions of slip from step to step, and the rate at which they settle. (theory.md, 11.6)"""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_ROWS, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import assign
from ..._numeric.tolerances import TINY
from .contact_forces import SLIP
from .tolerances import STILL
from .workspace import SceneWorkspace

CERTAIN = 10.0
"""Ratio of slip speed to the error η of a step above which a contact keeps sliding."""


@inlined
def fastest_of(metres, v):
    """Return the largest κ|v| [m/s] of velocities v (nv,), with κ (nv,) of (10.6) in `metres`."""
    fastest = 0.0
    for j in range(len(v)):
        fastest = max(fastest, metres[j] * abs(v[j]))
    return fastest


@inlined
def error_of_step(work, v):
    """Return the error η of a step in a velocity v (nv,) [m/s]. (theory.md, 11.5)"""
    return work.atol + work.rtol * fastest_of(work.joint_metres, v)


@inlined
def certain(work):
    """Return the speed 10 η at the start of the step above which a contact keeps sliding [m/s]."""
    return CERTAIN * error_of_step(work, work.v0)


@inlined
def set_certain_speed(work):
    """Set `certain_speed`, which never exceeds the sticking speed."""
    work.certain_speed = min(certain(work), work.stick_speed)


@inlined
def reversal_tolerance(work):
    """Return the speed of reversed slip that is attributed to the error of a step [m/s]."""
    return min(STILL * work.stick_speed, work.certain_speed / CERTAIN)


@declared(SceneWorkspace, FLOAT_ROWS)
@external
def turn_references(work, velocity):
    """Turn reference directions to those of contact velocities (nc, 3), but not at a reversal (an event)."""
    mode, reference = work.active_mode, work.slip_reference
    for k in range(len(mode)):
        if mode[k] == SLIP:
            x, y = velocity[k, 0], velocity[k, 1]
            speed = math.hypot(x, y)
            if speed > work.direction_speed and x * reference[k, 0] + y * reference[k, 1] > 0.0:
                reference[k, 0], reference[k, 1] = x / speed, y / speed
        assign(work.start_directions[k], reference[k])
        assign(work.end_directions[k], reference[k])


@inlined
def set_directions_within(work, fraction):
    """Interpolate the reference directions of slip at a fraction of the step."""
    reference, start, end = work.slip_reference, work.start_directions, work.end_directions
    for k in range(len(reference)):
        x = (1.0 - fraction) * start[k, 0] + fraction * end[k, 0]
        y = (1.0 - fraction) * start[k, 1] + fraction * end[k, 1]
        length = math.hypot(x, y)
        if length > 0.0:
            reference[k, 0], reference[k, 1] = x / length, y / length


@inlined
def restore_directions(work):
    """Reset the reference directions of slip to those at the start of the step."""
    for k in range(len(work.slip_reference)):
        assign(work.slip_reference[k], work.start_directions[k])
        assign(work.end_directions[k], work.start_directions[k])


@declared(SceneWorkspace)
@external
def stiffness_of_slip(work):
    """Return an estimate of the largest rate at which a direction of slip settles [1/s], see `step_radau`."""
    mode, mu = work.active_mode, work.active_friction
    velocity, reference = work.contact_velocity, work.slip_reference
    jacobian, minverse, force = work.contact_jacobian, work.minverse, work.contact_force
    n = minverse.shape[0]
    fastest = 0.0
    for k in range(len(mode)):
        if mode[k] == SLIP and mu[k] > 0.0:
            speed = math.hypot(velocity[k, 0], velocity[k, 1])
            s1, s2 = reference[k, 0], reference[k, 1]
            if speed > 0.0:
                s1, s2 = velocity[k, 0] / speed, velocity[k, 1] / speed
            total = 0.0
            for i in range(n):
                a = s1 * jacobian[k, 1, i] - s2 * jacobian[k, 0, i]
                for j in range(n):
                    total += a * minverse[i, j] * (s1 * jacobian[k, 1, j] - s2 * jacobian[k, 0, j])
            fastest = max(fastest, mu[k] * abs(force[k, 2]) * total / max(speed, TINY))
    return fastest
