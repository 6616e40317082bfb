"""The scene of a Panda above a table for the benchmarks of scenes."""

from __future__ import annotations

from typing import Any

import numpy as np

import pinimpact

TABLE = 0.2
START = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])
STILL = np.zeros(9)


def panda(restitution: float = 0.5, friction: float = 0.4, **options: Any) -> pinimpact.Scene:
    """Return the Panda over a table, without control."""
    robot = pinimpact.load_robot("panda")
    table = pinimpact.Plane(point=(0, 0, TABLE))
    hand = pinimpact.Contact("panda_hand_tcp", table, friction=friction, restitution=restitution, name="hand")
    return pinimpact.Scene(robot, [hand], **options)
