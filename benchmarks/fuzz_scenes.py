"""Robots dropped onto planes: every run has to complete, obey the laws of contact and balance its energy.

Intervals that are crossed by time steps are counted. With --keep the summary is written to docs/figures.

python -m benchmarks.fuzz_scenes --seed 1 --seconds 60            # without control
python -m benchmarks.fuzz_scenes --controlled --seed 1 --count 100
python -m benchmarks.fuzz_scenes --others --seed 1 --count 100    # other robots, and random trees
"""

from __future__ import annotations

import argparse
import math
import signal
import time
from contextlib import suppress
from typing import NoReturn

import numpy as np
from tests import random_control, random_trees
from tests.lawful import law_violation
from tests.random_scenes import DURATION, draw, relative_energy_residual

from pinimpact import PinimpactError, Scene, Trajectory, simulate

from .timing import keep


class Slow(BaseException):
    """A run that takes too long."""


def too_slow(*_: object) -> NoReturn:
    raise Slow


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--controlled", action="store_true", help="robots under joint PD control")
    kinds.add_argument("--others", action="store_true", help="further robots, and random trees")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=float, default=math.inf, help="largest number of runs")
    parser.add_argument("--seconds", type=float, default=math.inf, help="largest time [s]")
    parser.add_argument("--each", type=int, default=60, help="largest processor time of a run [s]")
    parser.add_argument("--keep", action="store_true", help="write the summary to docs/figures")
    options = parser.parse_args()
    if math.isinf(options.count) and math.isinf(options.seconds):
        options.seconds = 60.0
    signal.signal(signal.SIGPROF, too_slow)
    end, seed = time.perf_counter() + options.seconds, 1_000_000 * options.seed
    runs = bad = impacts = jams = crossed = 0
    longest, worst = (0, 0), (0.0, 0)
    while runs < options.count and time.perf_counter() < end:
        seed += 1
        runs += 1
        name, scene, q, v, rtol = drawn(seed, options.controlled, options.others)
        try:
            trajectory = run(scene, q, v, rtol, options.each)
        except (PinimpactError, TimeoutError) as error:
            bad += 1
            print(f"{seed}: {name}, rtol {rtol:.0e}: {error}", flush=True)
            continue
        reason = random_control.violation_in(trajectory, rtol) or law_violation(scene, trajectory, rtol, seed)
        if reason:
            bad += 1
            print(f"{seed}: {name}, rtol {rtol:.0e}: {reason}", flush=True)
        impacts += len(trajectory.impacts)
        jams += sum("jam" in note.text for note in trajectory.notes)
        crossed += bool(trajectory.stepped)
        longest = max(longest, (trajectory.statistics["steps"], seed))
        worst = max(worst, (relative_energy_residual(trajectory) / rtol, seed))
    lines = [
        f"{runs} runs of {DURATION:g} s with {impacts} impacts and {jams} jams",
        f"{bad} failed, {crossed} took time steps",
        f"most steps: {longest[0]} (seed {longest[1]})",
        f"largest energy residual: {worst[0]:.1g} × rtol (seed {worst[1]})",
        "",
    ]
    if options.keep:
        kind = "_controlled" if options.controlled else "_others" if options.others else ""
        keep(f"fuzz_scenes{kind}", "\n".join(lines), {"seed": options.seed, "failed": bad})
    else:
        print("\n".join(lines), end="")


def drawn(seed: int, controlled: bool, others: bool) -> tuple[str, Scene, np.ndarray, np.ndarray, float]:
    """Return name, scene, state (q, v) and tolerance drawn by a seed."""
    if not controlled:
        return random_trees.draw(seed) if others else draw(seed)
    one = random_control.draw(seed)
    return one.name, one.scene, one.q, one.v, one.rtol


def run(scene: Scene, q: np.ndarray, v: np.ndarray, rtol: float, each: int) -> Trajectory:
    """Return the motion of `DURATION` seconds.

    Raises:
        TimeoutError: It took more than `each` seconds of processor time.
    """
    with suppress(PinimpactError):  # compiles kernels, which must not count
        simulate(scene, q, v, 1e-9)
    reached = [0.0]
    signal.setitimer(signal.ITIMER_PROF, each)
    try:
        return simulate(
            scene,
            q,
            v,
            DURATION,
            rtol=rtol,
            atol=1e-2 * rtol,
            progress=lambda t, _: reached.__setitem__(0, t),
        )
    except Slow:
        raise TimeoutError(f"{each} s for the first {reached[0]:.6g} s") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


if __name__ == "__main__":
    main()
