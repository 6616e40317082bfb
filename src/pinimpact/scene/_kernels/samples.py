"""What the stages of a step tell of functions that must not fall below zero within it.

The stages are taken as samples, and a function counts as clear of zero where not even a parabola with half as
much curvature again as the samples show could bring it there; otherwise it is searched along the step.
"""

from __future__ import annotations

from ..._compile.jit import inlined
from .contact_forces import SLIP

SAFETY = 1.5
"""Factor on the curvature between samples."""


@inlined
def along(work, k, velocity):
    """Return the speed along the direction last known of contact velocities (nc, 3)."""
    reference = work.slip_reference
    return reference[k, 0] * velocity[k, 0] + reference[k, 1] * velocity[k, 1]


@inlined
def record_sample(work, slot, fraction):
    """Keep margin and slip at the state last evaluated as a sample at a fraction of the step."""
    work.sample_times[slot], work.sample_margins[slot] = fraction, work.force_margin
    mode, velocity, slip = work.active_mode, work.contact_velocity, work.sample_slip
    for k in range(len(mode)):
        if mode[k] == SLIP:
            slip[slot, k] = along(work, k, velocity)


@inlined
def clear_of_zero(times, values, count):
    """Return whether a function stays above zero between its first samples, as far as they tell.

    They are the first `count` of the values at rising times (m,), from 0 to 1.
    """
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
