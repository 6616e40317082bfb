"""Compute the table of reference solutions.

    python -m tests.reference.generate --seed 1 --count 3450 --out tests/reference/table.npz

Run from the root of the repository; it takes about 0.15 s per row. A row depends on the seed and its index
only. Rows that the closed form does not support, or without a solution, are omitted and counted.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
from mpmath import mp, mpf

from .problems import Problem, draw
from .reference import ReferenceSolution, UnsupportedProblemError, solve_reference
from .table import PATH, STATUSES, save

TRIALS = {
    "jam": 2,
    "no collision": 2,
    "second compression": 2,
    "near-critical friction": 2,
    "exactly critical friction": 2,
    "near-invariant start": 2,
    "slow approach": 2,
    "ill-conditioned": 16,
}
"""Number of perturbations for the sensitivity of a regime; for other regimes zero is stored."""

DIGITS = 22
"""Digits of the solutions of perturbed problems, which differ in the sixteenth digit."""


def sensitivity(problem: Problem, answer: ReferenceSolution, rng: np.random.Generator) -> tuple[float, float]:
    """Return the largest changes of v⁺ and of P for relative perturbations of ±2⁻⁵² of all inputs.

    A singular W keeps its rank: W and v are transformed by a diagonal matrix.
    """
    largest = [mpf(0), mpf(0)]
    for _ in range(TRIALS[problem.category]):
        sign = [mpf(int(x)) * mpf(2) ** -52 for x in rng.choice([-1, 1], 11)]
        with mp.workdps(DIGITS + 30):
            W = [[mpf(float(x)) for x in row] for row in problem.delassus]
            v = [mpf(float(x)) for x in problem.velocity]
            if "SINGULAR_DELASSUS" in answer.flags:
                W = [[W[i][j] * (1 + sign[i] / 2) * (1 + sign[j] / 2) for j in range(3)] for i in range(3)]
                v = [v[i] * (1 + sign[i] / 2) * (1 + sign[3]) for i in range(3)]
            else:
                for k, (i, j) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
                    W[i][j] = W[j][i] = W[i][j] * (1 + sign[k])
                v = [v[i] * (1 + sign[6 + i]) for i in range(3)]
            mu, e = problem.friction * (1 + sign[9]), problem.restitution * (1 + sign[10])
            if problem.restitution == 1:
                e = 1 - abs(sign[10])
            changed = solve_reference(W, v, mu, e, problem.law, DIGITS)
            for k, (new, old) in enumerate(
                [(changed.velocity, answer.velocity), (changed.impulse, answer.impulse)]
            ):
                largest[k] = max(largest[k], mp.norm([a - b for a, b in zip(new, old, strict=True)]))
    return float(largest[0]), float(largest[1])


def main() -> None:
    """Draw and solve the problems, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=3450, help="rows to draw")
    parser.add_argument("--out", type=Path, default=PATH)
    args = parser.parse_args()
    rows, left_out, began = [], Counter(), time.perf_counter()
    for index in range(args.count):
        problem = draw(args.seed, index)
        try:
            answer = solve_reference(
                problem.delassus, problem.velocity, problem.friction, problem.restitution, problem.law
            )
            if answer.status not in STATUSES:
                left_out[problem.category, answer.status] += 1
                continue
            if answer.defect > mpf(10) ** -48:
                raise ArithmeticError(
                    f"row {index}: the closed form and the quadrature differ: {answer.defect}"
                )
            change = (0.0, 0.0)
            if problem.category in TRIALS:
                change = sensitivity(problem, answer, np.random.default_rng((args.seed, index, 1)))
        except UnsupportedProblemError as error:
            left_out[problem.category, str(error)] += 1
            continue
        rows.append((problem, answer, change))
        if index % 300 == 299:
            save(args.out, rows)
            print(f"{index + 1} of {args.count}, {time.perf_counter() - began:.0f} s", flush=True)
    save(args.out, rows)
    print(f"{len(rows)} rows in {args.out}; left out: {dict(left_out)}")


if __name__ == "__main__":
    main()
