"""Time of the import and of first calls in a process: warm and cold, without a cache, and in parallel.

python -m benchmarks.startup
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.timing import publish, row

import pinimpact
from tools.fill_wheel import compile_into

FIRST = "import time; t = time.perf_counter(); {}; print(time.perf_counter() - t)"
PROBLEM = "pinimpact.solve_impact(pinimpact.ImpactProblem([[2,0,.5],[0,3,.4],[.5,.4,1]], (1,.5,-1), .3, .5))"
CALL = "import numpy, pinocchio, pinimpact, time; t = time.perf_counter(); {}; print(time.perf_counter() - t)"
PANDA = (
    "robot, table = pinimpact.load_robot('panda'), pinimpact.Plane(point=(0, 0, 0.2)); "
    "hand = pinimpact.Contact('panda_hand_tcp', table, friction=0.4, restitution=0.5); "
    "q = numpy.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])"
)
IMPACT = f"{PANDA}; pinimpact.impact(robot.model, robot.data, q, 0 * q - 0.1, hand)"
SCENE = f"{PANDA}; pinimpact.simulate(pinimpact.Scene(robot, [hand]), q, 0 * q, 0.01)"
"""A short free flight; kernels for later contacts are compiled nevertheless."""
TWO = SCENE.replace("[hand]", "[hand, pinimpact.Contact('panda_leftfinger', table)]")
"""The same with two contacts, which may collide simultaneously."""


def run(code: str, cache: str | None = None, package: str | None = None) -> float:
    """Run code in a new process and return the seconds that it prints; `package` replaces the package."""
    environment = dict(os.environ)
    if package is not None:
        environment["PYTHONPATH"] = package
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = cache
    command = [sys.executable, "-c", code]
    return float(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)


def with_kernels_of_a_wheel() -> list[dict]:
    """Time first calls with an empty cache and a package that contains compiled kernels, like a wheel."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        package = Path(pinimpact.__file__).parent
        shutil.copytree(package, Path(folder, "pinimpact"), ignore=shutil.ignore_patterns("__pycache__"))
        compile_into(Path(folder))
        for what, code in (("first impact of a robot", IMPACT), ("first scene", SCENE)):
            times = []
            for _ in range(3):
                with tempfile.TemporaryDirectory() as cache:
                    times.append(run(CALL.format(code), cache, folder))
            rows.append(row(f"{what}, cold cache, kernels of the wheel", min(times), 2.0))
    return rows


def measure() -> list[dict]:
    """Time import and first calls: warm, cold, with an unwritable cache, and in four processes at once."""
    bare = min(run(FIRST.format("import pinocchio, numpy")) for _ in range(7))
    full = min(run(FIRST.format("import pinocchio, numpy, pinimpact")) for _ in range(7))
    rows = [row("import pinimpact, over pinocchio and numpy", max(full - bare, 0.0), 0.3)]
    for what, code, goal in (
        ("first solve_impact", PROBLEM, 8.0),
        ("first impact of a robot", IMPACT, 8.0),
        ("first scene", SCENE, 20.0),
        ("first scene of several contacts", TWO, 20.0),
    ):
        with tempfile.TemporaryDirectory() as cache:
            rows.append(row(f"{what}, cold cache", run(CALL.format(code), cache), goal))
            warm = min(run(CALL.format(code), cache) for _ in range(5))
            rows.append(row(f"{what}, warm cache", warm, 1.0))
    rows += with_kernels_of_a_wheel()
    first = CALL.format(PROBLEM)
    with tempfile.TemporaryDirectory() as folder:
        closed = Path(folder, "closed")
        closed.write_text("a file where a folder is wanted")
        environment = dict(os.environ, NUMBA_CACHE_DIR=str(closed / "cache"))
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", first], env=environment, capture_output=True, check=True)
        rows.append(row("whole process, NUMBA_CACHE_DIR unusable", time.perf_counter() - begun))
    with tempfile.TemporaryDirectory() as cache:
        environment = dict(os.environ, NUMBA_CACHE_DIR=cache)
        begun = time.perf_counter()
        crowd = [
            subprocess.Popen([sys.executable, "-c", first], env=environment, stdout=subprocess.PIPE)
            for _ in range(4)
        ]
        if any(process.wait() for process in crowd):
            raise SystemExit("a parallel first run failed")
        rows.append(row("four first runs at once, cold cache", time.perf_counter() - begun))
    return rows


if __name__ == "__main__":
    publish("startup", measure())
