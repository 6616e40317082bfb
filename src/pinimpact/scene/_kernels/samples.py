"""Samples, at the stages of a step, of functions that must not fall below zero within it. (theory.md, 11.6)

A function passes the test if parabolas with `SAFETY` times the largest curvature of the samples stay above
zero between them; otherwise its roots are searched along the dense output.
"""

from __future__ import annotations

from ..._compile.jit import inlined
from ...geometry.tolerances import SAFETY
from .contact_forces import SLIP


@inlined
def speed_along(work, k, velocity):
    """Return the speed of active contact k along its reference direction, for contact velocities (nc, 3)."""
    reference = work.slip_reference
    return reference[k, 0] * velocity[k, 0] + reference[k, 1] * velocity[k, 1]


@inlined
def record_sample(work, slot, fraction):
    """Store force margin and slip at the state last evaluated as sample `slot`, at a fraction of the step."""
    work.sample_times[slot], work.sample_margins[slot] = fraction, work.force_margin
    mode, velocity, slip = work.active_mode, work.contact_velocity, work.sample_slip
    for k in range(len(mode)):
        if mode[k] == SLIP:
            slip[slot, k] = speed_along(work, k, velocity)


@inlined
def clear_of_zero(times, values, count):
    """Return whether a function stays above zero, judged by `count` samples at ascending times in [0, 1]."""
    bend = 0.0
    for i in range(1, count - 1):
        left, right = times[i] - times[i - 1], times[i + 1] - times[i]
        second = (values[i + 1] - values[i]) / right - (values[i] - values[i - 1]) / left
        bend = max(bend, abs(second) / (left + right))
    for i in range(count - 1):
        width = times[i + 1] - times[i]
        if not min(values[i], values[i + 1]) > 0.25 * SAFETY * bend * width * width:
            return False
    return True
