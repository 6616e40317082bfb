"""A ball that rolls from a face over an edge, or from an edge over its end. (docs/derivatives.md, 9)"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..geometry._kernels.constants import (
    AXES,
    CONSTANTS,
    KIND,
    LINE,
    LINE_AXIS,
    PLANE,
    RADIUS,
    SPHERE,
    TIP,
    VELOCITY,
)
from ..robot.forest import joint_jacobian
from ..robot.names import motion_signs
from .dense_step import DenseStep

Array = NDArray[np.float64]


def rolls_over(model: pin.Model, data: Any, before: DenseStep, after: DenseStep) -> Array | None:
    """Return ∂g/∂q (nv,), up to a factor, of how far a ball is over, or None if it does not roll over.

    It is measured along n × e for an edge e of a face, along e for the end of an edge.

    Args:
        model: The robot.
        data: Its data, which change.
        before: The step that ends there.
        after: The next one.
    """
    one, other = before.closed, after.closed
    if one is None or other is None or not np.array_equal(one.modes, other.modes):
        return None
    apart = [*range(AXES), *range(KIND, CONSTANTS)]
    changed = np.flatnonzero((one.constants != other.constants)[:, apart].any(axis=1))
    if len(changed) != 1:
        return None
    k = int(changed[0])
    line, joints, beside, joints_beside = one.constants[k], one.joints[k], other.constants[k], other.joints[k]
    if line[KIND] != LINE:
        line, joints, beside, joints_beside = beside, joints_beside, line, joints
    along, flat = line[LINE_AXIS:CONSTANTS], beside[KIND] == PLANE
    known = np.array_equal(joints, joints_beside) if flat else beside[KIND] == SPHERE
    if line[KIND] != LINE or not known:
        return None
    if flat:
        along = np.cross(beside[AXES + 6 : VELOCITY], along)
    tip, base = joints.tolist()
    moves = joint_jacobian(model, data, after.q)
    centre, along = data.oMi[tip].act(line[TIP:RADIUS]), data.oMi[base].rotation @ along
    rows = along @ moves[:3] + np.cross(centre, along) @ moves[3:]
    return np.asarray(motion_signs(model, tip, base) * rows)
