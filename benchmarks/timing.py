"""Ratios of times taken in one run: the two sides alternate, and the best of many counts."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from pinimpact.studies.cost import duration, machine

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
ROUNDS = 200


def best_of(
    calls: Mapping[str, Callable[[], Any]], rounds: int = ROUNDS, least: float = 2e-4
) -> dict[str, float]:
    """Return the least seconds of each call, taken in turns so that all see the same machine."""
    counts, best = {}, {}
    for name, call in calls.items():
        call()
        begun = time.perf_counter()
        call()
        counts[name] = max(1, int(least / (time.perf_counter() - begun)))
        best[name] = float("inf")
    for _ in range(rounds):
        for name, call in calls.items():
            begun = time.perf_counter()
            for _ in range(counts[name]):
                call()
            best[name] = min(best[name], (time.perf_counter() - begun) / counts[name])
    return best


def row(
    what: str, seconds: float, goal: float | None = None, against: str = "", reference: float = 1.0
) -> dict[str, Any]:
    """Return one line of a result: a time, its ratio to a reference of the same run, and the ratio wanted.

    Without a reference the ratio is to one second.
    """
    return {
        "what": what,
        "seconds": seconds,
        "against": against,
        "reference_seconds": reference,
        "ratio": seconds / reference,
        "goal": goal,
    }


def publish(name: str, rows: list[dict[str, Any]]) -> None:
    """Print rows as a table and keep both."""
    lines = []
    for r in rows:
        line = f"{r['what']:<44}{duration(r['seconds']):>10}"
        if r["against"]:
            line += f"  = {r['ratio']:5.3g} × {duration(r['reference_seconds'])} of {r['against']}"
        if r["goal"] is not None:
            line += f"   (goal: ≤ {r['goal']:g}{' ×' if r['against'] else ' s'})"
        lines.append(line)
    keep(name, "\n".join(lines) + "\n", {"rows": rows})


def keep(name: str, table: str, figures: Mapping[str, Any]) -> None:
    """Print a table, and keep it and its figures, with versions and machine, in docs/figures."""
    print(table, end="")
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / f"{name}.txt").write_text(table, encoding="utf-8")
    record = machine()
    with contextlib.suppress(metadata.PackageNotFoundError):
        record["packages"]["mujoco"] = metadata.version("mujoco")
    text = json.dumps({"machine": record, **figures}, indent=1, ensure_ascii=False)
    (FIGURES / f"{name}.json").write_text(text + "\n", encoding="utf-8")
