"""Hold planar arms of one to three joints against multiple precision, from the numbers of their URDF.

    python -m benchmarks.fuzz_arms --seed 1 --count 1000

Run from the root of the repository. Bases and planes are turned at random, or aligned within 1e-15 … 1e-3;
some tips move parallel to the plane, and some contact velocities are small by cancellation. An impact may
disagree with the answer of its exact numbers by eight times what a few roundings of those numbers change.
What is drawn and checked stands in tests/random_arms.py; the tests run a few of them.
"""

from __future__ import annotations

import argparse

from tests.random_arms import run


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    args = parser.parse_args()
    report = run(args.seed, args.count)
    print(f"{report.impacts} impacts, {report.refused} refused, {report.uncovered} without a reference")
    print(f"worst disagreement over sensitivity: {report.worst:.2g}")
    print(f"{len(report.violations)} violations")
    for what, case in report.violations:
        print(f"{what}: {case}")
    raise SystemExit(bool(report.violations))


if __name__ == "__main__":
    main()
