"""The invariant of friction, at what a step has sampled: it does no positive work on what it rubs against."""

from __future__ import annotations

import math

from ..._numeric.jit import inner
from .contact_forces import SLIP
from .radau import STAGES as TURNING
from .step_dop853 import LAST, method

ROUNDING = 1e-9
"""Part of the power of a contact or joint that is rounding."""


@inner
def friction_drives(work, explicit):
    """Return the largest power that friction gives in the step last completed, up to its first event [W].

    At the stages, as their rates and samples tell: of all contacts together, and of each by the direction of
    its slip; of joints, with their damping, at the stages, and of each at the end. Zero but for more than
    rounding, what the tolerance allows, and motion so slow that it counts as rest.
    """
    end, start, h = work.event_time, work.step_start, work.step_length
    mode, mu, sliding, v1 = work.closed_mode, work.closed_friction, work.sliding_friction, work.v1
    rates, slip, times = work.stage_rates, work.sample_slip, work.sample_times
    n, given = len(v1), 0.0
    slow = work.stick_speed + work.atol
    rubbing, load = False, 0.0
    for k in range(len(mode)):
        for d in range(3):
            load += abs(work.contact_force[k, d])
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
    if (rubbing or joints) and end > start + h:
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
        if joints and of_joints > ROUNDING * most_of_joints + 2.0 * speeds:
            given = max(given, of_joints)
    return given
