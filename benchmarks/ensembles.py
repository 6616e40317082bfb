"""Measure ensembles: overhead over a loop, workers, cold starts, landings of a quadruped, killed processes.

    python -m benchmarks.ensembles --kills 20

Run from the root of the repository, on an idle machine with two processors. Ratios are medians over rounds in
which both alternatives run in turn.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from tests.interrupted_study import differences, kill_and_finish, undisturbed

import pinimpact
from pinimpact.app.scene_loader import LoadedScene, load_scene
from pinimpact.studies.cost import duration
from pinimpact.studies.ensembles import final_state

from .timing import FIGURES

ROOT = Path(__file__).parents[1]
SEED = 1
CORES, LANDINGS = 64, 100_000
OVER = {
    "friction": stats.uniform(0.4, 0.4),
    "restitution": stats.uniform(0.1, 0.2),
    "v0:root_joint.vz": stats.norm(0.0, 0.1),
}
COLD = (
    "from pinimpact import simulate; from pinimpact.app.scene_loader import load_scene;"
    "loaded = load_scene('solo12_landing');"
    "simulate(loaded.scene, loaded.q, loaded.v, loaded.file.duration)"
)


def land(loaded: LoadedScene, samples: int, executor: Any = None) -> pinimpact.Ensemble:
    """Return an ensemble of landings."""
    return pinimpact.ensemble(
        loaded.scene,
        loaded.q,
        loaded.v,
        loaded.file.duration,
        over=OVER,
        samples=samples,
        seed=SEED,
        executor=executor,
    )


def loop(loaded: LoadedScene, samples: int) -> list[dict[str, Any]]:
    """Return the rows of the same landings by `simulate`."""
    rows = []
    for i in range(samples):
        rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(i,)))
        mu, e, kick = (float(distribution.rvs(random_state=rng)) for distribution in OVER.values())
        contacts = [replace(c, friction=mu, restitution=e) for c in loaded.scene.contacts]
        scene = replace(loaded.scene, contacts=contacts)
        v = loaded.v.copy()
        v[2] += kick
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows.append(final_state(pinimpact.simulate(scene, loaded.q, v, loaded.file.duration)))
    return rows


def seconds(call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    begun = clock()
    call()
    return clock() - begun


def middle(ratios: list[float]) -> str:
    low, median, high = np.percentile(ratios, (25, 50, 75))
    return f"{median:.3f} ({low:.3f} to {high:.3f} in the middle half)"


def overhead(loaded: LoadedScene, samples: int, rounds: int) -> list[str]:
    """Compare `ensemble` with a loop of `simulate`, by processor time."""
    rows = land(loaded, samples).columns
    by_hand = loop(loaded, samples)
    assert all(rows["v.root_joint.vz"][i] == row["v.root_joint.vz"] for i, row in enumerate(by_hand))
    times = np.array(
        [
            [seconds(partial(call, loaded, samples), time.process_time) for call in (land, loop)]
            for _ in range(rounds)
        ]
    )
    ratio = middle((times[:, 0] / times[:, 1]).tolist())
    each = float(np.median(times[:, 0])) / samples
    return [
        f"landing of solo12 ({loaded.file.duration:g} s of motion), processor time: {duration(each)}",
        f"ensemble over a loop of simulate, {samples} landings: {ratio} ×   (goal: ≤ 1.02 ×)",
        f"{LANDINGS:,} landings on {CORES} cores, extrapolated: {duration(each * LANDINGS / CORES)}"
        "   (goal: ≤ 300 s)",
    ]


def workers(loaded: LoadedScene, samples: int, rounds: int) -> list[str]:
    """Compare two worker processes with one, all of them started before."""
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as one,
        ProcessPoolExecutor(2, get_context("spawn")) as two,
    ):
        for pool in (one, two):
            land(loaded, 40, pool)
        times = np.array(
            [[seconds(partial(land, loaded, samples, pool)) for pool in (one, two)] for _ in range(rounds)]
        )
    ratio = middle((times[:, 0] / times[:, 1]).tolist())
    return [f"two workers over one, {samples} landings: {ratio} ×   (goal: ≥ 1.9 ×)"]


def cold(count: int) -> float:
    """Return the seconds in which processes start with an empty cache and finish a landing each."""
    with tempfile.TemporaryDirectory() as folder:
        env = dict(os.environ, NUMBA_CACHE_DIR=folder)
        begun = time.perf_counter()
        running = [
            subprocess.Popen([sys.executable, "-c", COLD], cwd=ROOT, env=env, stderr=subprocess.DEVNULL)
            for _ in range(count)
        ]
        assert all(process.wait() == 0 for process in running)
        return time.perf_counter() - begun


def cold_starts(rounds: int) -> list[str]:
    """Compare 16 processes with an empty cache with one; the times include those of the simulations."""
    one, many = np.median([[cold(1), cold(16)] for _ in range(rounds)], axis=0)
    return [
        f"16 processes with an empty cache, each a landing: {duration(many)} = {many / one:.2f} × "
        f"{duration(one)} of one, on {os.cpu_count()} processors   (goal: ≤ 2 ×)"
    ]


def kills(count: int) -> list[str]:
    """Kill workers and the main process of a study, and compare its bits with those without."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        columns, done = kill_and_finish(root, count)
        differs = differences(columns, undisturbed(root))
    return [
        f"{sum(done.values())} kills ({done['worker']} of workers, {done['main']} of the main process): "
        + (f"{', '.join(differs)} differ" if differs else "the same bits as without")
    ]


def main() -> None:
    """Print and write the results."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    loaded = load_scene("solo12_landing")
    lines = overhead(loaded, options.samples, options.rounds)
    lines += workers(loaded, 4 * options.samples, options.rounds // 2)
    lines += cold_starts(1)
    lines += kills(options.kills)
    text = "\n".join(lines) + "\n"
    print(text)
    (FIGURES / "ensembles.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
