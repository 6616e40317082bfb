"""The events that end a smooth motion, in the order in which they are looked for."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np

from ...._compile.jit import inner
from . import force_bound, friction_reversal, gap, joint_limit, saturation, slip_end

EVENTS: tuple[ModuleType, ...] = (gap, joint_limit, saturation, friction_reversal, slip_end, force_bound)
"""`gap` is first, for its bound needs the kinematics that the step has left.

Of two at the same time the later one here counts: where the forces of what is closed fail just when a gap
closes, the modes are set anew first.
"""


def _chain(kind: int):
    """Return the kernel that asks one event after the other, from the one of this kind on."""
    if kind == len(EVENTS):

        @inner
        def end_of_chain(work):
            pass

        return end_of_chain

    first, others, number = EVENTS[kind].first, _chain(kind + 1), np.int64(kind)

    @inner
    def search(work):
        time, which = first(work, min(work.event_time, work.step_start + work.step_length))
        if time < math.inf:
            work.event_time, work.event_kind, work.event_index = time, number, which
        if work.event_time > -math.inf:
            others(work)

    return search


_search = _chain(0)


@inner
def find_first_event(work):
    """Leave time, kind and index of the first event in the step last completed; see `event_time`."""
    work.event_time = math.inf
    _search(work)
