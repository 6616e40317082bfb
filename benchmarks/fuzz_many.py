"""Hold impacts at many contacts against mechanics: random problems, regular and not.

    python -m benchmarks.fuzz_many --seed 1 --count 100000

Run from the root of the repository. Problems have one to five contacts, W of any rank, coefficients of their
own or equal, some of them zero; every fourth is drawn to be hard (flat bodies, ties, e = 0 beside e > 0).
Checked are energy, its ledger, friction's cones, no pull, no approach left, and that impulses and velocities
belong together. What ends by a bound on events or steps tells so, and is counted.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from benchmarks.timing import keep
from numpy.typing import NDArray

import pinimpact

Array = NDArray[np.float64]


def draw(seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return J (3n, k), M (k, k), u (k,), and μ and e (n,)."""
    rng = np.random.default_rng(seed)
    hard = rng.integers(4) == 0
    n = int(rng.integers(1, 6))
    k = int(rng.integers(2, 3 * n + 4))
    jacobian, u = rng.normal(size=(3 * n, k)), rng.normal(size=k)
    friction, restitution = rng.uniform(0, 1, n), rng.uniform(0, 1, n)
    if not hard:
        kind = rng.integers(4)
        restitution = restitution * 0.0 if kind == 0 else restitution
        if kind == 1:
            friction[:], restitution[:] = friction[0], restitution[0]
    else:
        friction = rng.choice([0.0, 0.3, 0.5, 1.0, friction[0]], n)
        restitution = rng.choice([0.0, 0.5, 1.0, restitution[0], 0.1 * restitution[0]], n)
        shape = rng.integers(3)
        if shape == 0:
            jacobian, u = np.round(2 * jacobian) / 2, np.round(2 * u) / 2
        elif shape == 1:  # a rigid body on corners, on a plane or not
            points = rng.normal(size=(n, 3))
            points[:, 2] = -1.0 if rng.random() < 0.5 else points[:, 2]
            jacobian = np.concatenate([np.hstack([np.eye(3), -_cross(point)]) for point in points])
            u = rng.normal(size=6) * (1.0 if rng.random() < 0.5 else np.eye(6)[2])
        else:
            jacobian[1::3] = 0.0
    root = rng.normal(size=(jacobian.shape[1],) * 2)
    mass = root @ root.T / len(root) + 0.3 * np.eye(len(root))
    return jacobian, mass, u, friction, restitution


def _cross(r: Array) -> Array:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def check(seed: int) -> tuple[list[str], str, int, float]:
    """Return what is violated in a problem, how it ended, its events per contact, and what it took [s]."""
    jacobian, mass, u, friction, restitution = draw(seed)
    delassus = jacobian @ np.linalg.solve(mass, jacobian.T)
    velocity = (jacobian @ u).reshape(-1, 3)
    if not (velocity[:, 2] < 0).any():  # it would part
        u, velocity = -u, -velocity
    problem = pinimpact.ImpactProblem(
        0.5 * (delassus + delassus.T), velocity, friction, restitution, "energetic"
    )
    start = time.perf_counter()
    try:
        solution = pinimpact.solve_impact(problem, simultaneous="propagate")
    except pinimpact.PinimpactError as error:
        return [], f"refused: {type(error).__name__}", 0, time.perf_counter() - start
    taken = time.perf_counter() - start
    p = solution.impulse
    after = u + np.linalg.solve(mass, jacobian.T @ p.ravel())
    scale, push = np.abs(velocity).max(), max(np.abs(p).max(), 1e-300)
    rounding = 1e-9 * scale + 1e-12 * push * np.abs(delassus).max()
    if solution.notes:  # a convex program has ended it
        rounding *= 1e2
    before, later = 0.5 * u @ mass @ u, 0.5 * after @ mass @ after
    checks = {
        "energy made": later > before + 1e-9 * before + push * rounding,
        "works do not add up": abs(later - before - solution.work.total.sum())
        > 1e-8 * before + push * rounding,
        "friction beyond its cone": (np.hypot(p[:, 0], p[:, 1]) > friction * p[:, 2] + 1e-9 * push).any(),
        "pull": (p[:, 2] < -1e-12 * push).any(),
        "approach left": (solution.velocity[:, 2] < -10.0 * rounding).any(),
        "impulses do not give velocities": np.abs((jacobian @ after).reshape(-1, 3) - solution.velocity).max()
        > 10.0 * rounding,
    }
    ended = "by itself" if not solution.notes else solution.notes[-1].split(" ")[0]
    kinds = {"by itself": ended, "After": "at a bound, noted", "Events": "by short steps, noted"}
    kind = kinds.get(ended, "all at once, noted")
    return [what for what, wrong in checks.items() if wrong], kind, solution.events // len(p), taken


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=10_000)
    options = parser.parse_args()
    ends: Counter[str] = Counter()
    wrong, most, times = 0, (0, 0), []
    check(0)  # compiles
    for seed in range(1_000_000 * options.seed, 1_000_000 * options.seed + options.count):
        violations, ended, events, taken = check(seed)
        ends[ended] += 1
        wrong += bool(violations)
        most = max(most, (events, seed))
        times.append(taken)
        if violations:
            print(f"{seed}: {', '.join(violations)}", flush=True)
    lines = [f"{options.count} random problems, {wrong} with a violation", ""]
    lines += [f"{number:8d} {what}" for what, number in ends.most_common()]
    lines += ["", f"most events per contact: {most[0]} (seed {most[1]})"]
    lines += [f"time: median {1e3 * np.median(times):.2g} ms, longest {max(times):.2g} s", ""]
    keep("fuzz_many", "\n".join(lines), ends)
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
