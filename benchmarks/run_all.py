"""Measure all figures of the pages, one benchmark after the other.

    python benchmarks/run_all.py

or, with names of benchmarks as arguments, only theirs. Each runs in its own process on one thread. The tables
and figures in the pages are replaced by those just measured.
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
"""Recorded tosses, which are no part of the repository; without them "recorded_cubes" is left out."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


if __name__ == "__main__":
    for name in sys.argv[1:] or NAMES:
        print(f"== {name}", flush=True)
        recorded = [str(RECORDINGS)] if name == "recorded_cubes" else []
        if recorded and not RECORDINGS.is_dir():
            print(f"left out: {RECORDINGS} is missing")
            continue
        subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}", *recorded],
            cwd=ROOT,
            env=dict(os.environ, **ONE_THREAD),
            check=True,
        )
    subprocess.run([sys.executable, "-m", "tools.figures"], cwd=ROOT, check=True)
