"""Success rate and run time of the solver of contact problems.

    python -m benchmarks.contact_problems recorded.npz
    python -m benchmarks.contact_problems

Recorded problems are read from a file of concatenated arrays, whose sizes are in `contacts` and `scalars`.
Random ones have four contacts, some of which slip, with or without three joints with dry friction, of full
rank, with two equal normals, or redundant.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pinimpact._numeric.augmented_newton import coulomb_law
from pinimpact._numeric.coulomb_problem import CoulombProblem, solve_coulomb
from pinimpact._numeric.tolerances import USABLE

Problem = tuple[Any, ...]
"""W, accelerations, velocities of slip, friction, held, and lower and upper bounds of scalar rows."""


@numba.njit
def alone(delassus, free, velocity, mu, held, lower, upper, x):
    """Call the kernel from Python."""
    law = coulomb_law(mu, velocity, held, lower, upper)
    return solve_coulomb(CoulombProblem(delassus, free, law), x)


def recorded(path: Path) -> Iterator[tuple[bool, Problem]]:
    """Yield recorded problems, and whether the iterations of the run have failed to solve them."""
    data = dict(np.load(path))
    slip, at = data["slip"].reshape(-1, 2), np.zeros(4, dtype=int)
    for nc, ns, hard in zip(data["contacts"], data["scalars"], data["hard"], strict=True):
        n = 3 * nc + ns
        a, b, c, s = (slice(start, start + size) for start, size in zip(at, (n * n, n, nc, ns), strict=True))
        contacts = slip[c].copy(), data["friction"][c], data["held"][c]
        yield (
            bool(hard),
            (
                data["delassus"][a].reshape(n, n),
                data["free"][b],
                *contacts,
                data["lower"][s],
                data["upper"][s],
            ),
        )
        at += n * n, n, nc, ns


def drawn(seed: int) -> Problem:
    """Draw a random problem of four contacts."""
    rng = np.random.default_rng(seed)
    joints = 3 * (seed % 2)
    rows = 12 + joints
    speeds = rows - 1 if seed % 8 < 6 else 9
    jacobian, factor = rng.normal(size=(rows, speeds)), rng.normal(size=(speeds, speeds))
    if seed % 4 >= 2:
        jacobian[9] = jacobian[6]
    delassus = jacobian @ (factor @ factor.T / speeds + 0.1 * np.eye(speeds)) @ jacobian.T
    free = jacobian @ rng.normal(size=speeds)
    if speeds > 9:
        free -= np.array([0, 0, 1] * 4 + [0] * joints)
    velocity, slips = np.zeros((4, 2)), int(rng.integers(0, 5))
    velocity[:slips] = rng.normal(size=(slips, 2))
    bound = np.full(joints, rng.uniform(0.05, 0.5))
    return delassus, free, velocity, rng.uniform(0.2, 1.2, size=4), np.zeros(4, dtype=bool), -bound, bound


def measure(problems: list[Problem]) -> tuple[np.ndarray, np.ndarray]:
    """Return which problems are solved (n,), and the run times [ms] (n,)."""
    found, times = np.empty(len(problems), dtype=bool), np.empty(len(problems))
    for k, problem in enumerate(problems):
        x = np.zeros(len(problem[1]))
        start = time.perf_counter()
        found[k] = alone(*problem, x) <= USABLE
        times[k] = 1e3 * (time.perf_counter() - start)
    return found, times


def main() -> None:
    """Print a line for each kind of problem and way to solve it."""
    kinds: dict[str, list[Problem]] = {"drawn": [drawn(seed) for seed in range(1600)]}
    if len(sys.argv) > 1:
        problems = list(recorded(Path(sys.argv[1])))
        kinds["recorded, hard"] = [problem for hard, problem in problems if hard]
        kinds["recorded, others"] = [problem for hard, problem in problems if not hard]
    else:
        print("recorded problems are left out: no file is given")
    for kind, problems in kinds.items():
        measure(problems[:1])
        found, times = measure(problems)
        print(
            f"{kind}: {found.sum()} of {len(problems)}, {times.mean():.3f} ms as a mean, "
            f"{np.median(times):.3f} as a median, {times.max():.2f} at most"
        )


if __name__ == "__main__":
    main()
