"""Measure the coverage of confidence intervals of friction and restitution, and the run time of a fit.

    python -m benchmarks.identification --count 1000

Run from the root of the repository. The friction of synthetic tosses varies from toss to toss, and their
velocities have noise.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from tests.test_identification import tosses

from pinimpact import studies
from pinimpact.studies.cost import duration

from .timing import FIGURES

TRUTH = np.array([0.16, 0.27])


def main() -> None:
    """Print and write the counts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    lines = [f"95 % intervals that contain the true value, of {options.count}", ""]
    lines += [f"{'tosses × impacts':<18}{'':<14}{'by toss':>10}{'by impact':>12}"]
    for groups, each in ((30, 3), (200, 2)):
        inside = np.zeros((2, 2))
        for _ in range(options.count):
            found, group = tosses(rng, groups, each)
            for row, labels in enumerate((group, None)):
                low, high = studies.identify(found, group=labels).interval(0.95).T
                inside[row] += (low <= TRUTH) & (high >= TRUTH)
        for k, name in enumerate(("friction", "restitution")):
            shares = "".join(f"{100 * part / options.count:>10.1f} %" for part in inside[:, k])
            lines.append(f"{f'{groups} × {each}' if k == 0 else '':<18}{name:<12}{shares}")
    found, group = tosses(rng, 250, 2)
    taken = []
    for _ in range(30):
        begun = time.process_time()
        studies.identify(found, group=group)
        taken.append(time.process_time() - begun)
    lines += ["", f"fit of {len(group)} impacts: {duration(min(taken))} of processor time"]
    text = "\n".join(lines) + "\n"
    print(text)
    (FIGURES / "identification.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
