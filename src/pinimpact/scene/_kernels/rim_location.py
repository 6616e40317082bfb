"""Location of the first touch of a rim on its plane within the last completed step. (theory.md, 15)

`event_location.search_for_closing` does not apply, since the lowest point can run around the rim arbitrarily
fast, so that g̈ has no lower bound. The terms of the gap have bounded curvature, see `gap_bounds.rim_clear`.
g̈ is bounded from above, since the gap is the least of the gaps of all points of the rim.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGER_ROWS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign
from ..._numeric.tolerances import EPS
from ...geometry._kernels.constants import RIM
from ...robot._kernels import contact_motion
from .dense_output import set_state_within
from .dynamics import compute_kinematics, set_state
from .event_location import search_for_touch
from .gap_bounds import curvatures, rim_clear, rim_gap
from .workspace import SceneWorkspace

DEPTH = 80
"""Largest number of halvings of a step."""


@inlined
def fill_terms(work, constants, joints, out):
    """Fill out (8,), see `contact_motion.rim_and_rates`, of a rim at the state last evaluated."""
    placements, velocities, tip, carrier = work.placements, work.local_velocities, joints[0], joints[1]
    contact_motion.rim_and_rates(
        placements[tip], velocities[tip], placements[carrier], velocities[carrier], constants, out
    )


@declared(SceneWorkspace, FLOATS, FLOATS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS)
@jit
def rims_at(work, q, v, constants, joints, out):
    """Fill out (k, 8), see `contact_motion.rim_and_rates`, for rims at a state.

    `constants` (k, …) and `joints` (k, 2), of tip and surface, are those of the rims.
    """
    set_state(work, q, v)
    compute_kinematics(work)
    for i in range(len(out)):
        fill_terms(work, constants[i], joints[i], out[i])


@inlined
def rim_at(work, i, t, base, out):
    """Fill out (8,), see `gap_bounds.rim_clear`, of rim i at a time within the step, with y − base for y."""
    set_state_within(work, (t - work.step_start) / work.step_length)
    compute_kinematics(work)
    fill_terms(work, work.contact_constants[i], work.contact_joints[i], out)
    out[0] -= base


@inlined
def gap_at(work, i, t):
    """Return gap [m] and gap rate [m/s] of rim i at a time within the step."""
    row = np.empty(8)
    rim_at(work, i, t, 0.0, row)
    return rim_gap(row, work.contact_constants[i, RIM])


root = search_for_touch(gap_at)


@declared(SceneWorkspace, int, float, float)
@external
def first_touch_of_rim(work, i, end, gap):
    """Return the first time until `end` at which rim i touches its plane; infinity if it does not.

    If `gap`, that at the start of the step, is negative, all gaps of the step are taken relative to it.
    """
    floor, radius, bounds = work.gap_floor, work.contact_constants[i, RIM], work.gap_bounds[i]
    base, turning = min(gap, 0.0), work.turning_bounds[i]
    now, rows, later = np.empty(8), np.empty((DEPTH, 8)), np.empty(DEPTH)
    time = work.step_start
    later[0] = end
    rim_at(work, i, time, base, now)
    rim_at(work, i, end, base, rows[0])
    depth = 0
    while depth >= 0:
        row = rows[depth]
        width = later[depth] - time
        fall, bend = curvatures(now[0], now[1], row[0], row[1], width, bounds)
        passed = rim_clear(now, row, radius, fall + turning, width, floor)
        later_gap, later_rate = rim_gap(row, radius)
        if not passed:
            start_gap, rate = rim_gap(now, radius)
            if start_gap > 0.0 and later_gap < 0.0 and rate + (bend + turning) * width < 0.0:
                return root(work, i, base, time, later[depth], later_gap, later_rate)
            middle = time + 0.5 * width
            if time < middle < later[depth] and width > 2.0 * EPS * later[depth] and depth + 1 < DEPTH:
                depth += 1
                later[depth] = middle
                rim_at(work, i, middle, base, rows[depth])
                continue
            if later_gap < -floor:
                return later[depth]
        time = later[depth]
        assign(now, row)
        now[0] += max(-later_gap, 0.0)
        depth -= 1
    return math.inf
