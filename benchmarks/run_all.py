"""Make all figures of docs/accuracy.md and docs/many-contacts.md anew, one after the other.

    python benchmarks/run_all.py

or, with names of benchmarks as arguments, only theirs. Each runs in its own process on one thread. The tables
in the pages are replaced by those just measured.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "accuracy.md", ROOT / "docs" / "many-contacts.md"
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
)
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def refresh(page: Path) -> None:
    """Put the tables in docs/figures between the marks that name them."""

    def table(mark: re.Match[str]) -> str:
        text = (page.parent / "figures" / mark[1]).read_text(encoding="utf-8").rstrip()
        return f"<!-- {mark[1]} -->\n```text\n{text}\n```\n<!-- end -->"

    text = page.read_text(encoding="utf-8")
    page.write_text(
        re.sub(r"<!-- (\w+\.txt) -->\n.*?<!-- end -->", table, text, flags=re.DOTALL), encoding="utf-8"
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or NAMES:
        print(f"== {name}", flush=True)
        subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}"],
            cwd=ROOT,
            env=dict(os.environ, **ONE_THREAD),
            check=True,
        )
    for page in PAGES:
        refresh(page)
