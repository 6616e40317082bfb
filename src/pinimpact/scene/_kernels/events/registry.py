"""The events that end a smooth motion, in the order of their search."""

from __future__ import annotations

import math
from types import ModuleType

from ...._compile.jit import inlined
from . import force_bound, friction_reversal, gap, joint_limit, saturation, slip_end

EVENTS: tuple[ModuleType, ...] = (gap, joint_limit, saturation, friction_reversal, slip_end, force_bound)
"""`gap` is first, since its bounds use the kinematics at the end of the step.

Of two simultaneous events the later one in this order is reported: if contact forces leave their bounds just
when a gap closes, the modes are chosen again first.
"""

GAP, JOINT_LIMIT, SATURATION, FRICTION_REVERSAL, SLIP_END, FORCE_BOUND = range(len(EVENTS))


@inlined
def _store(work, kind, found):
    """Store an event (time, index) if there is one."""
    time, which = found
    if time < math.inf:
        work.event_time, work.event_kind, work.event_index = time, kind, which


@inlined
def _end(work):
    """Return the end of the search: the event found so far, or the end of the step."""
    return min(work.event_time, work.step_start + work.step_length)


@inlined
def find_first_event(work):
    """Set `event_time`, `event_kind` and `event_index` for the first event in the last completed step."""
    work.event_time = math.inf
    _store(work, GAP, gap.first(work, _end(work)))
    _store(work, JOINT_LIMIT, joint_limit.first(work, _end(work)))
    _store(work, SATURATION, saturation.first(work, _end(work)))
    _store(work, FRICTION_REVERSAL, friction_reversal.first(work, _end(work)))
    _store(work, SLIP_END, slip_end.first(work, _end(work)))
    if work.event_time > -math.inf:  # else a shorter step is required
        _store(work, FORCE_BOUND, force_bound.first(work, _end(work)))
