"""Other motions of a robot, drawn translucently beside one that is replayed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..scene.trajectory import Trajectory
from .film import FRAMES_PER_SECOND
from .page_file import packed
from .robot_shapes import joint_poses

MOST = 240
"""Largest number of frames of a translucent motion, to limit the file."""


def cloud_as_data(
    model: pin.Model, others: Sequence[Trajectory], start: float, end: float
) -> dict[str, Any] | None:
    """Return motions as data for the player, and their last configurations; None without any.

    From the start to the end of the replay [s]; a motion that ended earlier stays where it is.
    """
    if not others:
        return None
    count = int(np.clip(np.ceil((end - start) * FRAMES_PER_SECOND), 1, MOST)) + 1
    times = np.linspace(start, end, count)
    robots = []
    for other in others:
        poses = joint_poses(model, [other.at(min(float(t), float(other.t[-1])))[0] for t in times])
        moving = [joint for joint in range(1, model.njoints) if np.ptp(poses[:, joint], axis=0).any()]
        robots.append({str(joint): packed(poses[:, joint]) for joint in moving})
    return {"times": packed(times, np.float64), "robots": robots, "ends": [other.q[-1] for other in others]}
