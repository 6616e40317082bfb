"""Robots dropped onto planes: every run has to reach its end with its energy accounted for.

python -m benchmarks.fuzz_scenes --seed 1 --seconds 60            # without control
python -m benchmarks.fuzz_scenes --controlled --seed 1 --count 100
"""

from __future__ import annotations

import argparse
import math
import signal
import time
from contextlib import suppress
from typing import NoReturn

from tests import random_control
from tests.random_scenes import DURATION, draw, unaccounted

from pinimpact import PinimpactError, simulate


class Slow(BaseException):
    """A run that takes too long."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--controlled", action="store_true", help="robots under joint PD control")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=float, default=math.inf, help="runs at most")
    parser.add_argument("--seconds", type=float, default=math.inf, help="time at most")
    parser.add_argument(
        "--each", type=int, default=30, help="processor time at most of each controlled run [s]"
    )
    options = parser.parse_args()
    if math.isinf(options.count) and math.isinf(options.seconds):
        options.seconds = 60.0
    end = time.perf_counter() + options.seconds
    if options.controlled:
        controlled(1_000_000 * options.seed, options.count, end, options.each)
    else:
        passive(1_000_000 * options.seed, options.count, end)


def passive(seed: int, count: float, end: float) -> None:
    """Run robots without control, and print what is to tell of them."""
    failed, runs, impacts, jams, longest, worst = 0, 0, 0, 0, (0, 0), (0.0, 0)
    while runs < count and time.perf_counter() < end:
        seed += 1
        runs += 1
        name, scene, q, v, rtol = draw(seed)
        try:
            trajectory = simulate(scene, q, v, DURATION, rtol=rtol, atol=1e-2 * rtol)
        except PinimpactError as error:
            failed += 1
            print(f"{seed}: {name}, rtol {rtol:.0e}: {error}", flush=True)
            continue
        impacts += len(trajectory.impacts)
        jams += sum("jam" in note.text for note in trajectory.notes)
        longest = max(longest, (trajectory.statistics["steps"], seed))
        worst = max(worst, (unaccounted(trajectory) / rtol, seed))
    print(f"{runs} runs, {failed} of them without an end; {impacts} impacts, {jams} jams")
    print(f"most steps: {longest[0]} (seed {longest[1]})")
    print(f"most energy unaccounted for: {worst[0]:.1g} × rtol (seed {worst[1]})")


def controlled(seed: int, count: float, end: float, each: int) -> None:
    """Run robots under joint PD control, and print those that do not end well, and why."""

    def too_slow(*_: object) -> NoReturn:
        raise Slow

    signal.signal(signal.SIGPROF, too_slow)
    runs, bad = 0, 0
    while runs < count and time.perf_counter() < end:
        seed += 1
        runs += 1
        run = random_control.draw(seed)
        time_reached = [0.0]
        with suppress(PinimpactError):  # kernels are compiled before its time counts
            simulate(run.scene, run.q, run.v, 1e-9)
        signal.setitimer(signal.ITIMER_PROF, each)
        try:
            trajectory = simulate(
                run.scene,
                run.q,
                run.v,
                random_control.DURATION,
                rtol=run.rtol,
                atol=1e-2 * run.rtol,
                progress=lambda t, _, reached=time_reached: reached.__setitem__(0, t),
            )
            reason = random_control.wrong_in(trajectory, run.rtol)
        except PinimpactError as error:
            reason = str(error)
        except Slow:
            reason = f"{each} s for the first {time_reached[0]:.6g} s"
        signal.setitimer(signal.ITIMER_PROF, 0)
        if reason:
            bad += 1
            print(f"{seed}: {run.name}, rtol {run.rtol:.0e}: {reason}", flush=True)
    print(f"{runs} runs, {bad} of them not to a good end")


if __name__ == "__main__":
    main()
