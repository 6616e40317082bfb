"""Hold arms of one to three joints against what must hold, and against multiple precision.

    python -m benchmarks.fuzz_arms --seed 1 --count 1000 --many 1000000

Run from the root of the repository. Bases and planes are turned at random, or aligned within 1e-15 … 1e-3;
some tips move parallel to the plane, and some contact velocities are small by cancellation. `--count` of them
are held against the answer of the numbers of their URDF in multiple precision: an impact may disagree by
eight times what a few roundings of those numbers change. `--many` are held against mechanics, and against the
same arm and plane in a world that is turned; what is in doubt then goes to multiple precision too. What is
drawn and checked stands in tests/random_arms.py and tests/many_arms.py; the tests run a few of them.
"""

from __future__ import annotations

import argparse

from tests import many_arms, random_arms

from pinimpact import Status


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--many", type=int, default=100_000)
    args = parser.parse_args()
    wrong = _print(random_arms.run(args.seed, args.count))
    report = many_arms.run(args.seed, args.many)
    print(f"\n{report.impacts} impacts against mechanics and in a turned world")
    for status, number in sorted(report.statuses.items()):
        print(f"  {number} {Status(status).name}")
    for what, case in report.violations:
        print(f"{what}: {case}")
    print(f"{len(report.violations)} violations; in doubt:")
    wrong += len(report.violations) + _print(report.judged)
    raise SystemExit(bool(wrong))


def _print(report: random_arms.Report) -> int:
    print(f"{report.impacts} impacts, {report.refused} refused, {report.uncovered} without a reference")
    print(f"worst disagreement over sensitivity: {report.worst:.2g}")
    print(f"{len(report.violations)} violations")
    for what, case in report.violations:
        print(f"{what}: {case}")
    return len(report.violations)


if __name__ == "__main__":
    main()
