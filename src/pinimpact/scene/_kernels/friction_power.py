"""The invariant of friction, at what a step has sampled: it does no positive work on what it rubs against."""

from __future__ import annotations

import math

from ..._compile.jit import inlined
from .contact_forces import SLIP, STICK
from .radau import STAGES as TURNING
from .slip import CERTAIN
from .step_dop853 import LAST, method

ROUNDING = 1e-9
"""Part of the power of a contact or joint that is rounding."""


@inlined
def friction_drives(work, explicit):
    """Return the largest power that friction gives in the step last completed, up to its first event [W].

    At the stages, as their rates and samples tell: of all contacts together, and of each by the direction of
    its slip; of joints, with their damping, at the stages, and of each at the end. Where contacts stick, the
    mean over the step, for stages are off by more than that. Zero but for more than rounding, what the
    tolerance allows, and slip so slow that it counts as rest.
    """
    end, start, h = work.event_time, work.step_start, work.step_length
    mode, mu, sliding, v1 = work.active_mode, work.active_friction, work.sliding_friction, work.v1
    rates, slip, times = work.stage_rates, work.sample_slip, work.sample_times
    n, given = len(v1), 0.0
    slow = work.stick_speed + work.atol
    rubbing, sticking, load, sliding_load = False, False, 0.0, 0.0
    for k in range(len(mode)):
        sticking |= mode[k] == STICK
        pushed = 0.0
        for d in range(3):
            pushed += abs(work.contact_force[k, d])
        load += pushed
        sliding_load += pushed if mode[k] == SLIP else 0.0
        if mode[k] == SLIP and mu[k] != 0.0:
            rubbing, force = True, abs(mu[k] * work.contact_force[k, 2])
            for i in range(1, work.samples):
                speed = abs(slip[i, k])
                if slip[i, k] < -slow - work.rtol * speed and start + times[i] * h < end:
                    given = max(given, force * speed)
    joints = False
    for j in range(n):
        if sliding[j] != 0.0:
            joints = True
            if v1[j] * sliding[j] < 0.0 and end > start + h:
                against = abs(v1[j]) - slow - 2.0 * work.rtol * max(abs(work.v0[j]), abs(v1[j]))
                given = max(given, against * abs(sliding[j]))
    if (rubbing or sticking or joints) and end > start + h:
        largest = most = of_joints = most_of_joints = -math.inf
        for i in range(1, 1 + (LAST[method(work)] if explicit else TURNING)):
            power, damped = rates[i, 2 * n + 2], rates[i, 2 * n + 1]
            largest, most = max(largest, power), max(most, abs(power))
            of_joints, most_of_joints = max(of_joints, damped), max(most_of_joints, abs(damped))
        speeds = 0.0
        for j in range(n):
            speeds += abs(sliding[j]) * (slow + work.rtol * max(abs(work.v0[j]), abs(v1[j])))
        if rubbing and largest > ROUNDING * most + 2.0 * load * (slow + work.touching_gap):
            given = max(given, largest)
        mean, least = work.dense_coefficients[0, 2 * n + 2] / h, ROUNDING * most + 2.0 * sliding_load * slow
        if sticking and mean > least and mean > least + power_of_errors(work):
            given = max(given, mean)
        if joints and of_joints > ROUNDING * most_of_joints + 2.0 * speeds:
            given = max(given, of_joints)
    return given


@inlined
def power_of_errors(work):
    """Return the most power that what does not slip has by the errors of the joints' velocities [W]."""
    mode, jacobian, force, v0, v1 = (
        work.active_mode,
        work.contact_jacobian,
        work.contact_force,
        work.v0,
        work.v1,
    )
    pulling = fastest = 0.0
    for j in range(len(v1)):
        pull = 0.0
        for k in range(len(mode)):
            if mode[k] != SLIP:
                for d in range(3):
                    pull += jacobian[k, d, j] * force[k, d]
        pulling, fastest = pulling + abs(pull), max(fastest, abs(v0[j]), abs(v1[j]))
    return CERTAIN * pulling * (work.atol + work.rtol * fastest)
