"""What the benchmarks of scenes share: timing, the machine's record, the Panda over its table."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import pinimpact

FIGURES = Path(__file__).resolve().parent.parent / "docs" / "figures"
TABLE = 0.2
PANDA_START = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])


def panda(restitution: float = 0.5, friction: float = 0.4, **options: Any) -> pinimpact.Scene:
    """Return the Panda over a table, without control."""
    robot = pinimpact.load_robot("panda")
    table = pinimpact.Plane(point=(0, 0, TABLE))
    hand = pinimpact.Contact("panda_hand_tcp", table, friction=friction, restitution=restitution, name="hand")
    return pinimpact.Scene(robot, [hand], **options)


def best(run: Callable[[], Any], seconds: float = 2.0) -> float:
    """Return the least time of one call [s], over as many as fit into `seconds` after a first one."""
    run()
    least, start = np.inf, time.perf_counter()
    while time.perf_counter() - start < seconds:
        begin = time.perf_counter()
        run()
        least = min(least, time.perf_counter() - begin)
    return least


def save(name: str, figures: dict[str, Any]) -> Path:
    """Write the figures as JSON, with the versions and the machine."""
    versions = {}
    for package in ("pinimpact", "pin", "numpy", "numba", "scipy", "mujoco"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "absent"
    machine = {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
    }
    FIGURES.mkdir(parents=True, exist_ok=True)
    path = FIGURES / f"{name}.json"
    path.write_text(json.dumps({"versions": versions, "machine": machine, **figures}, indent=1) + "\n")
    return path
