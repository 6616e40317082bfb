"""A contact that is open closes its gap."""

from __future__ import annotations

import math

from ...._compile.declared import FLOAT_ROWS, FLOATS, declared
from ...._compile.jit import external, inlined
from ....geometry._kernels import surfaces
from ....geometry._kernels.constants import RADIUS, RIM
from ....geometry.tolerances import SAFETY
from ....robot._kernels import contact_motion
from ..contact_forces import FREE
from ..dynamics import compute_kinematics, contact_gap, set_signs, set_state
from ..event_location import search_for_closing
from ..gap_bounds import clear, curvatures
from ..rim_location import first_touch_of_rim
from ..workspace import SceneWorkspace
from .consequences import ARRIVAL

CONSEQUENCE = ARRIVAL

CLEAR = -1.0
"""Value of `gap_bounds[i, 0]` for a gap that provably does not close."""


@inlined
def value(work, i, t):
    """Return gap [m] and gap rate [m/s] of contact i at the state set in the workspace."""
    compute_kinematics(work)
    return contact_gap(work, i)


first_closing = search_for_closing(value)


@declared(SceneWorkspace, int, FLOATS, float, FLOATS)
@external
def bound(work, i, constants, reach, out):
    """Fill out (4,) with the bounds of the motion of contact i over the step, see `gap_bounds.curvatures`.

    `constants` are those of the contact or of its bounding sphere; `reach` is zero, or the radius of the
    sphere for bounds that hold for all tips in it [m].
    """
    set_signs(work, i)
    size, change, speed = contact_motion.bounds(
        *(work.joint_jacobian, work.velocity_signs, work.velocity_joint),
        *(work.placements[work.contact_joints[i, 0]], constants, work.rate_bounds, work.step_length, reach),
    )
    out[0], out[1], out[2] = SAFETY * size, SAFETY * change, SAFETY * speed
    out[3] = surfaces.least_radius(constants)
    if reach == 0.0:
        out[3] += constants[RADIUS]


@inlined
def bound_contact(work, i):
    """Fill `gap_bounds` of contact i, and `turning_bounds` if it is a rim."""
    constants = work.contact_constants[i]
    bound(work, i, constants, 0.0, work.gap_bounds[i])
    if constants[RIM] > 0.0:
        work.turning_bounds[i] = SAFETY * contact_motion.turning_bound(
            *(work.joint_jacobian, work.velocity_signs, work.placements[work.contact_joints[i, 0]]),
            *(constants, work.rate_bounds, work.step_length),
        )


@inlined
def stays_off(work, first, k):
    """Return whether bounding sphere k, with first contact `first`, provably stays off its surface."""
    start, end, bounds = work.start_spheres[k], work.end_spheres[k], work.sphere_bounds[k]
    if start[0] <= 0.0 or end[0] <= 0.0:
        return False
    bound(work, first, work.sphere_constants[k], 0.0, bounds)
    fall, _ = curvatures(start[0], start[1], end[0], end[1], work.step_length, bounds)
    return clear(start[0], start[1], end[0], end[1], fall, work.step_length, 0.0)


@inlined
def tip_stays_off(work, i, bounds):
    """Return whether tip i, unless a rim, provably stays off its surface, by the bounds of its sphere."""
    start, end = work.start_gaps[i], work.end_gaps[i]
    if start[0] == math.inf or end[0] == math.inf or work.contact_constants[i, RIM] > 0.0:
        return False
    h, base = work.step_length, min(start[0], 0.0)
    fall, _ = curvatures(start[0] - base, start[1], end[0] - base, end[1], h, bounds)
    return clear(start[0] - base, start[1], end[0] - base, end[1], fall, h, work.gap_floor)


@inlined
def fill_bounds(work):
    """Fill bounds of the motion, and gaps at both ends of the step, of all contacts that may close.

    Contacts whose sphere stays off its surface, or that stay off by its bounds, need neither.
    """
    modes, blocks, clears, spheres = work.modes, work.contact_blocks, work.clear_blocks, work.sphere_bounds
    joints = work.contact_joints
    for b in range(len(blocks)):
        first, stop, k = blocks[b, 0], blocks[b, 1], blocks[b, 2]
        clears[b] = 0
        still = joints[first, 0] == joints[first, 1]  # for example reserved for shapes that are apart
        if still or (k >= 0 and stays_off(work, first, k)):
            clears[b] = 1
            continue
        if k >= 0:  # common bounds first: most of its tips are far from the surface
            bound(work, first, work.sphere_constants[k], work.sphere_constants[k, RADIUS], spheres[k])
        for i in range(first, stop):
            if modes[i] == FREE:
                if k >= 0 and tip_stays_off(work, i, spheres[k]):
                    work.gap_bounds[i, 0] = CLEAR
                else:
                    bound_contact(work, i)
    complete_gaps(work, work.q0, work.v0, work.start_gaps)
    complete_gaps(work, work.q1, work.v1, work.end_gaps)


@declared(SceneWorkspace, FLOATS, FLOATS, FLOAT_ROWS)
@external
def complete_gaps(work, q, v, gaps):
    """Fill the gaps (n, 2) at a state that `contact_gaps` has left out, of blocks that are not clear."""
    blocks, clears = work.contact_blocks, work.clear_blocks
    moved = False
    for b in range(len(blocks)):
        first, stop = blocks[b, 0], blocks[b, 1]
        if clears[b] != 0 or gaps[first, 0] < math.inf:
            continue
        if not moved:
            set_state(work, q, v)
            compute_kinematics(work)
            moved = True
        for i in range(first, stop):
            gaps[i, 0], gaps[i, 1] = contact_gap(work, i)


@declared(SceneWorkspace, float)
@external
def first(work, end):
    """Return the first time until `end` at which a gap closes, or infinity; and its contact."""
    modes, blocks, clears = work.modes, work.contact_blocks, work.clear_blocks
    start_gaps, end_gaps = work.start_gaps, work.end_gaps
    time, which = math.inf, 0
    if len(blocks) == 0:
        return time, which
    fill_bounds(work)  # before `value` changes the kinematics
    for b in range(len(blocks)):
        if clears[b] != 0:
            continue
        for i in range(blocks[b, 0], blocks[b, 1]):
            if modes[i] != FREE or work.gap_bounds[i, 0] == CLEAR:
                continue
            if work.contact_constants[i, RIM] > 0.0:
                found = first_touch_of_rim(work, i, end, start_gaps[i, 0])
            else:
                found = first_closing(
                    *(work, i, end, start_gaps[i, 0], start_gaps[i, 1]),
                    *(end_gaps[i, 0], end_gaps[i, 1], work.gap_bounds[i]),
                )
            if found <= end:
                time, end, which = found, found, i
    return time, which
