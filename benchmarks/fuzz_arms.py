"""Check impacts of arms with one to three joints against mechanics and multiple precision.

    python -m benchmarks.fuzz_arms --seed 1 --count 1000 --many 1000000

Run from the root of the repository. Bases and planes have random orientations, or are aligned within
1e-15 … 1e-3; some tips move parallel to the plane, and some contact velocities are small by cancellation.
`--count` of them are compared with multiple precision, computed from the numbers of the URDF; the tolerance
is eight times the effect of rounding errors of these numbers. `--many` are checked against mechanics, and
against the same arm and plane in rotated axes; doubtful ones are compared with multiple precision too.
tests/random_arms.py and tests/many_arms.py draw and check the impacts; the tests run fewer. With --keep the
results are written to docs/figures.
"""

from __future__ import annotations

import argparse

from tests import many_arms, random_arms

from pinimpact import Status

from .timing import keep


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--many", type=int, default=100_000)
    parser.add_argument("--keep", action="store_true", help="write the results to docs/figures")
    args = parser.parse_args()
    few, many = random_arms.run(args.seed, args.count), many_arms.run(args.seed, args.many)
    violations = [*few.violations, *many.violations, *many.judged.violations]
    lines = ["compared with multiple precision", *_lines(few), "", "checked against mechanics"]
    lines += [f"{number:9} {Status(status).name}" for status, number in sorted(many.statuses.items())]
    lines += [
        f"{len(many.violations):9} violations",
        "",
        "of these doubtful, compared with multiple precision",
    ]
    table = "\n".join([*lines, *_lines(many.judged), ""])
    if args.keep:
        keep("fuzz_arms", table, {"seed": args.seed, "violations": len(violations)})
    else:
        print(table, end="")
    for what, case in violations:
        print(f"{what}: {case}")
    raise SystemExit(bool(violations))


def _lines(report: random_arms.Report) -> list[str]:
    return [
        f"{report.impacts:9} impacts",
        f"{report.refused:9} refused",
        f"{report.uncovered:9} without a reference",
        f"{len(report.violations):9} violations",
        f"{report.worst:9.2g} largest disagreement over sensitivity",
    ]


if __name__ == "__main__":
    main()
