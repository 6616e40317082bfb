"""Run all benchmarks, or those named as arguments, and update tables and figures of the documentation.

    python benchmarks/run_all.py

Each benchmark runs in a separate process on one thread.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
NAMES = (
    "speed",
    "many_contacts",
    "startup",
    "exchange_rate",
    "other_model",
    "scene_cost",
    "scene_ladder",
    "persistent_contact",
    "geometry",
    "everyday",
    "motion_cost",
    "identification",
    "ensembles",
    "recorded_cubes",
)
RECORDINGS = ROOT.parent / "shared" / "data" / "cube_tosses"
"""Recorded tosses, which are not in the repository; without them "recorded_cubes" is omitted."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


if __name__ == "__main__":
    for name in sys.argv[1:] or NAMES:
        print(f"== {name}", flush=True)
        recorded = [str(RECORDINGS)] if name == "recorded_cubes" else []
        if recorded and not RECORDINGS.is_dir():
            print(f"omitted: {RECORDINGS} is missing")
            continue
        subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}", *recorded],
            cwd=ROOT,
            env=dict(os.environ, **ONE_THREAD),
            check=True,
        )
    subprocess.run([sys.executable, "-m", "tools.figures"], cwd=ROOT, check=True)
