"""Check that errors of random scenes, robots dropped onto planes, decrease with rtol.

    python -m benchmarks.convergence --seed 92 --count 200
    python -m benchmarks.convergence --controlled --seed 93 --count 20 --duration 0.2

Each scene is run at each power of ten from 10⁻⁶ to 10⁻¹¹. If the error of the configuration at one of them is
above `ALLOWED` times rtol, and not five times smaller than at a hundred times this rtol, the seed is
reported, with the first such time. Some motions are sensitive to their initial state (a hundred bounces).
With --keep the summary is written to docs/figures.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
import pinocchio as pin

from pinimpact import PinimpactError, simulate

from .fuzz_scenes import drawn
from .timing import keep

POWERS = range(6, 12)
ALLOWED = 100.0
"""Ratio of the error to rtol above which a scene may be reported."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--controlled", action="store_true", help="robots under joint PD control")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--duration", type=float, default=0.4, help="of each run [s]")
    parser.add_argument("--keep", action="store_true", help="write the summary to docs/figures")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    told, ended, errors = 0, 0, []
    for seed in range(1_000_000 * options.seed + 1, 1_000_000 * options.seed + options.count + 1):
        try:
            times, found = errors_of(seed, options.controlled, options.duration)
        except PinimpactError as error:
            ended += 1
            print(f"{seed}: {error}", flush=True)
            continue
        errors.append(found[:, -1])
        for k in range(2, len(found)):
            high = (found[k] > ALLOWED * 10.0 ** -POWERS[k]) & (found[k] > 0.2 * found[k - 2])
            if high.any():
                told += 1
                since = f"rtol 1e-{POWERS[k]} from {times[high][0]:.3g} s on"
                print(f"{seed}: {since}: errors {found[:, -1]}", flush=True)
                break
    lines = [
        f"{len(errors)} scenes of {options.duration:g} s; {told} without convergence, {ended} stopped",
        "",
        "rtol      median error",
    ]
    lines += [f"1e-{p:02d}     {x:.1e}" for p, x in zip(POWERS, np.median(errors, axis=0), strict=False)]
    if options.keep:
        keep("convergence", "\n".join([*lines, ""]), {"seed": options.seed, "not decreasing": told})
    else:
        print("\n".join(lines))


def errors_of(seed: int, controlled: bool, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times (m,), and the largest errors of q up to each, (powers − 1, m)."""
    _, scene, q, v, _ = drawn(seed, controlled, others=False)
    model = scene.model
    runs = [simulate(scene, q, v, duration, rtol=10.0**-p, atol=10.0 ** -(p + 2)) for p in POWERS]
    times = np.linspace(0.0, duration, 401)
    exact = [runs[-1].at(t)[0] for t in times]
    errors = [
        [np.abs(pin.difference(model, run.at(t)[0], q)).max() for t, q in zip(times, exact, strict=True)]
        for run in runs[:-1]
    ]
    return times, np.maximum.accumulate(errors, axis=1)


if __name__ == "__main__":
    main()
