"""Slip of a contact ends: its speed along the reference direction falls below zero. (theory.md, 11.6)"""

from __future__ import annotations

import math

import numpy as np

from ...._compile.declared import declared
from ...._compile.jit import external, inlined
from ..contact_forces import SLIP
from ..dynamics import evaluate
from ..event_location import sampled, search_for_fall, search_for_root
from ..samples import clear_of_zero, speed_along
from ..slip import reversal_tolerance, set_directions_within
from ..workspace import SceneWorkspace
from .consequences import MODE_CHANGE

CONSEQUENCE = MODE_CHANGE


@inlined
def value(work, k, t):
    """Return the speed of contact k along its reference direction at the state set in the workspace [m/s]."""
    evaluate(work, t, np.empty(len(work.v) + 4))
    return speed_along(work, k, work.contact_velocity), 0.0


value_at, first_fall, root = sampled(value), search_for_fall(value), search_for_root(value)


@inlined
def first_against(work, k):
    """Return the first sample time within a step of `step_radau` at which slip is reversed, or infinity."""
    slip, times = work.sample_slip, work.sample_times
    least = reversal_tolerance(work)
    for i in range(1, work.samples - 1):
        if slip[i, k] < -least:
            return work.step_start + times[i] * work.step_length
    return math.inf


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time before `end` at which a slip ends, or infinity; and its active contact.

    Minus infinity requests a shorter step: the direction of slip has turned too far within the step to be
    followed. Slip that is already reversed at the start of the step ends there, so that it gets another
    direction.
    """
    mode, mu, velocity = work.active_mode, work.active_friction, work.contact_velocity
    start, last = work.step_start, work.step_start + work.step_length
    time, which = math.inf, 0
    for k in range(len(mode)):
        if mode[k] != SLIP or mu[k] == 0.0:
            continue
        set_directions_within(work, 1.0)
        end_speed = speed_along(work, k, work.end_velocity)
        if work.step_turns:
            # incipient slip may turn by any angle in its first step: only reversal counts
            later, until = last, first_against(work, k)
            if end_speed >= -reversal_tolerance(work) and until == math.inf:
                continue
            start_speed = value_at(work, k, start)[0]
            if start_speed > 0.0 and until < last:
                later, end_speed = until, value_at(work, k, until)[0]
                if end_speed >= 0.0:
                    return -math.inf, k
            elif end_speed >= -reversal_tolerance(work):
                continue
            if start_speed <= 0.0:
                # slip of a previous step, or fast enough, has reversed; incipient slip needs a shorter step
                speed = math.hypot(velocity[k, 0], velocity[k, 1])
                moved = work.previous_length > 0.0 or speed > work.certain_speed
                return (start if moved else -math.inf), k
            found = root(work, k, start, later, start_speed, end_speed)
        else:
            if clear_of_zero(work.sample_times, work.sample_slip[:, k], work.samples):
                continue
            found = first_fall(work, k, end, reversal_tolerance(work))
        if found < end:
            time, end, which = found, found, k
    return time, which
