"""Ratios of run times: both sides alternate in one run, and the shortest time of each is used.

If the two sides run on different cores, the median of many ratios is used (`shared_rows`).
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from pinimpact.studies.cost import duration, machine

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
ROUNDS = 200


def best_of(
    calls: Mapping[str, Callable[[], Any]], rounds: int = ROUNDS, least: float = 2e-4
) -> dict[str, float]:
    """Return the shortest time of each call [s]; calls alternate so that all run under the same load."""
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


@contextlib.contextmanager
def _on(cores: set[int]) -> Iterator[None]:
    """Restrict this process to some cores within the context."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _taken(call: Callable[[int], Any], threads: int) -> float:
    begun = time.perf_counter()
    call(threads)
    return time.perf_counter() - begun


def shared_rows(what: str, call: Callable[[int], Any], goal: float, rounds: int = 50) -> list[dict[str, Any]]:
    """Compare work by two threads with one thread and with two processes; each round times all of them.

    The rate of one thread is the mean of its rates on both cores, since cores differ and their rates vary.
    The sum of the rates of two concurrent processes is the upper bound for two cores.

    Args:
        what: Name of the work.
        call: Function that does the work with the given number of threads.
        goal: Ratio wanted of two threads over one.
        rounds: Number of rounds.

    Returns:
        Lines with medians and quartiles of the ratios.
    """
    cores = sorted(os.sched_getaffinity(0))[:2]
    here, there = multiprocessing.Pipe()

    def serve() -> None:
        while there.recv():
            there.send(_taken(call, 1))

    def together() -> float:
        here.send(True)
        mine = _taken(call, 1)
        return 1.0 / (1.0 / mine + 1.0 / here.recv())

    call(2)
    other = multiprocessing.get_context("fork").Process(target=serve, daemon=True)
    other.start()
    together()
    times = np.empty((rounds, 4))
    for each in times:
        for k, core in enumerate(cores):
            with _on({core}):
                each[k] = _taken(call, 1)
        each[2:] = _taken(call, 2), together()
    here.send(False)
    other.join()
    one = 2.0 / (1.0 / times[:, :2]).sum(axis=1)
    lines = []
    for way, seconds, wanted in (("threads", times[:, 2], goal), ("processes", times[:, 3], None)):
        low, middle, high = np.percentile(seconds / one, (25, 50, 75)).tolist()
        line = row(f"{what}, two {way}", float(np.median(seconds)), wanted, "one", float(np.median(one)))
        lines.append(line | {"ratio": middle, "middle_half": [low, high]})
    return lines


def row(
    what: str, seconds: float, goal: float | None = None, against: str = "", reference: float = 1.0
) -> dict[str, Any]:
    """Return one line of a result: a time, its ratio to a reference (default 1 s), and the ratio wanted."""
    return {
        "what": what,
        "seconds": seconds,
        "against": against,
        "reference_seconds": reference,
        "ratio": seconds / reference,
        "goal": goal,
    }


def publish(name: str, rows: list[dict[str, Any]]) -> None:
    """Print rows as a table and save both."""
    lines = []
    for r in rows:
        line = f"{r['what']:<44}{duration(r['seconds']):>10}"
        if r["against"]:
            line += f"  = {r['ratio']:5.3g} × {duration(r['reference_seconds'])} of {r['against']}"
        if "middle_half" in r:
            line += " ({:.3g} to {:.3g} in the middle half)".format(*r["middle_half"])
        if r["goal"] is not None:
            line += f"   (goal: ≤ {r['goal']:g}{' ×' if r['against'] else ' s'})"
        lines.append(line)
    keep(name, "\n".join(lines) + "\n", {"rows": rows})


def keep(name: str, table: str, figures: Mapping[str, Any]) -> None:
    """Print a table, and save it with its figures, versions and machine in docs/figures."""
    print(table, end="")
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / f"{name}.txt").write_text(table, encoding="utf-8")
    record = machine()
    for other in ("mujoco", "drake"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            record["packages"][other] = metadata.version(other)
    text = json.dumps({"machine": record, **figures}, indent=1, ensure_ascii=False)
    (FIGURES / f"{name}.json").write_text(text + "\n", encoding="utf-8")
