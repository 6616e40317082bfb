"""Check the contact-space solver with random problems near boundaries of its regimes.

    python -m benchmarks.fuzz --seed 1 --count 1000000

Run from the root of the repository. Prints a table with a line for each category: number of problems; number
of those refused (an unstoppable approach, or a law that cannot be satisfied; for singular W only); largest
number of iterations; and largest change of the solution in other axes or units, relative to the sensitivity
to rounding errors. All violations follow. tests/random_impacts.py draws and checks the problems; the tests
run fewer. With --keep the table is written to docs/figures.
"""

from __future__ import annotations

import argparse

from tests.random_impacts import run

from .timing import keep


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--show", type=int, default=10, help="violations to print in full")
    parser.add_argument("--keep", action="store_true", help="write the table to docs/figures")
    args = parser.parse_args()
    report = run(args.seed, args.count)
    if args.keep:
        keep("fuzz", report.table(), {"seed": args.seed, "violations": len(report.violations)})
    else:
        print(report.table(), end="")
    kinds: dict[tuple[str, str], int] = {}
    for name, category, _, _ in report.violations:
        kinds[name, category] = kinds.get((name, category), 0) + 1
    for (name, category), number in kinds.items():
        print(f"  {name}: {number} of {category}")
    for name, category, law, p in report.violations[: args.show]:
        print(f"{name} ({category}, {law}): W = {p.delassus.tolist()}, v = {p.velocity.tolist()}, ", end="")
        print(f"mu = {float(p.friction)!r}, e = {float(p.restitution)!r}")
    raise SystemExit(bool(report.violations))


if __name__ == "__main__":
    main()
