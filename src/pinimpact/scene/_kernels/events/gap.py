"""A contact that is open closes its gap."""

from __future__ import annotations

import math

from ...._numeric.ahead import ahead
from ...._numeric.jit import inner, separate
from ....robot._kernels import contact_motion
from ..contact_forces import FREE
from ..dynamics import compute_kinematics, contact_gap
from ..event_location import search_for_closing
from ..workspace import SceneWorkspace
from .consequences import ARRIVAL

CONSEQUENCE = ARRIVAL

SAFETY = 1.5
"""Factor on the bounds of a motion, which come from the stages of the step."""


@inner
def value(work, i, t):
    """Return gap and gap rate of a contact at the state that is set."""
    compute_kinematics(work)
    return contact_gap(work, i)


first_closing = search_for_closing(value)


@inner
def bound(work, i):
    """Fill the bounds of the motion over the step, see `gap_bounds.curvatures`."""
    tip, bounds = work.contact_joints[i, 0], work.gap_bounds
    size, change, speed, radius = contact_motion.bounds(
        work.joint_jacobian,
        work.velocity_signs[i],
        work.velocity_joint,
        work.placements[tip],
        work.contact_constants[i],
        work.rate_bounds,
        work.step_length,
    )
    bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = (
        SAFETY * size,
        SAFETY * change,
        SAFETY * speed,
        radius,
    )


@ahead(SceneWorkspace, float)
@separate
def first(work, end):
    """Return the first time until `end` at which a gap closes, infinite if none does; and whose."""
    modes, start_gaps, end_gaps = work.modes, work.start_gaps, work.end_gaps
    contacts = len(start_gaps)
    for i in range(contacts):  # before `value` moves the kinematics
        if modes[i] == FREE:
            bound(work, i)
    time, which = math.inf, 0
    for i in range(contacts):
        if modes[i] == FREE:
            found = first_closing(
                work,
                i,
                end,
                start_gaps[i, 0],
                start_gaps[i, 1],
                end_gaps[i, 0],
                end_gaps[i, 1],
                work.gap_bounds[i],
            )
            if found <= end:
                time, end, which = found, found, i
    return time, which
