"""Test whether solids may pass through each other unnoticed within a time step. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import jit
from ...robot._kernels.placement import cross, place, rotate
from .dynamics import compute_kinematics, set_state
from .workspace import SceneWorkspace

REACH, ARM, THICKNESS, SOLID_NUMBERS = 3, 4, 5, 6
"""Columns of a solid after its centre in joint axes: its radius about the centre; the radius again, or zero
for a ball, whose surface does not move when it turns; half its least thickness [m]."""


@declared(SceneWorkspace, FLOATS, FLOATS, float, INTEGERS, FLOAT_ROWS, INTEGER_ROWS, result=bool)
@jit
def may_pass(work, q, v, h, joints, solids, pairs):
    """Return whether two near solids may move by more than their half thicknesses in half a step.

    Args:
        work: The workspace.
        q, v: State at the midpoint of the step.
        h: Length of the step [s].
        joints: (k,) joints that carry the solids.
        solids: (k, `SOLID_NUMBERS`) see `REACH`.
        pairs: (p, 2) indices of the solids of each pair.
    """
    set_state(work, q, v)
    compute_kinematics(work)
    centres, rates, turns = np.empty((len(solids), 3)), np.empty((len(solids), 3)), np.empty(len(solids))
    speeds, fastest, thinnest = np.empty(len(solids)), 0.0, math.inf
    for k in range(len(solids)):
        one, pose, motion = solids[k], work.placements[joints[k]], work.local_velocities[joints[k]]
        x, y, z = cross(motion[3], motion[4], motion[5], one[0], one[1], one[2])
        x, y, z = rotate(pose, motion[0] + x, motion[1] + y, motion[2] + z)
        rates[k, 0], rates[k, 1], rates[k, 2] = x, y, z
        centres[k, 0], centres[k, 1], centres[k, 2] = place(pose, one, 0)
        turns[k] = one[ARM] * math.sqrt(motion[3] ** 2 + motion[4] ** 2 + motion[5] ** 2)
        speeds[k] = math.sqrt(x * x + y * y + z * z) + turns[k]
        fastest, thinnest = max(fastest, speeds[k]), min(thinnest, one[THICKNESS])
    if h * fastest <= 2.0 * thinnest:
        return False
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        thickness = solids[a, THICKNESS] + solids[b, THICKNESS]
        if 0.5 * h * (speeds[a] + speeds[b]) <= thickness:
            continue
        square, rate = 0.0, 0.0
        for e in range(3):
            square += (centres[a, e] - centres[b, e]) ** 2
            rate += (rates[a, e] - rates[b, e]) ** 2
        speed = math.sqrt(rate) + turns[a] + turns[b]
        near = solids[a, REACH] + solids[b, REACH] + h * speed
        if 0.5 * h * speed > thickness and square <= near * near:
            return True
    return False
