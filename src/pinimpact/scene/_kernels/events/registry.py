"""The events that end a smooth motion, in the order in which they are looked for."""

from __future__ import annotations

import math
from types import ModuleType

from ...._compile.jit import inlined
from . import force_bound, friction_reversal, gap, joint_limit, saturation, slip_end

EVENTS: tuple[ModuleType, ...] = (gap, joint_limit, saturation, friction_reversal, slip_end, force_bound)
"""`gap` is first, for its bound needs the kinematics that the step has left.

Of two at the same time the later one here counts: where the forces of what is closed fail just when a gap
closes, the modes are set again first.
"""


GAP, JOINT_LIMIT, SATURATION, FRICTION_REVERSAL, SLIP_END, FORCE_BOUND = range(len(EVENTS))


@inlined
def _take(work, kind, found):
    """Keep an event that comes before the end of the search."""
    time, which = found
    if time < math.inf:
        work.event_time, work.event_kind, work.event_index = time, kind, which


@inlined
def _end(work):
    """Return where the search ends: at the end of the step, or at the event found so far."""
    return min(work.event_time, work.step_start + work.step_length)


@inlined
def find_first_event(work):
    """Leave time, kind and index of the first event in the step last completed; see `event_time`."""
    work.event_time = math.inf
    _take(work, GAP, gap.first(work, _end(work)))
    _take(work, JOINT_LIMIT, joint_limit.first(work, _end(work)))
    _take(work, SATURATION, saturation.first(work, _end(work)))
    _take(work, FRICTION_REVERSAL, friction_reversal.first(work, _end(work)))
    _take(work, SLIP_END, slip_end.first(work, _end(work)))
    if work.event_time > -math.inf:  # else a shorter step is asked for
        _take(work, FORCE_BOUND, force_bound.first(work, _end(work)))
