"""Make all figures of docs/accuracy.md anew, one after the other, each in its own process on one thread.

python benchmarks/run_all.py
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

NAMES = ("speed", "startup", "exchange_rate")
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}

if __name__ == "__main__":
    for name in NAMES:
        print(f"== {name}", flush=True)
        subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}"],
            cwd=Path(__file__).parents[1],
            env=dict(os.environ, **ONE_THREAD),
            check=True,
        )
