"""Robots dropped onto planes without control: every run has to reach its end with its energy accounted for.

python -m benchmarks.fuzz_scenes --seed 1 --seconds 60
"""

from __future__ import annotations

import argparse
import time

from tests.random_scenes import DURATION, draw, unaccounted

from pinimpact import PinimpactError, simulate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    failed, runs, impacts, jams, longest, worst = 0, 0, 0, 0, (0, 0), (0.0, 0)
    end = time.perf_counter() + options.seconds
    seed = 1_000_000 * options.seed
    while time.perf_counter() < end:
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


if __name__ == "__main__":
    main()
