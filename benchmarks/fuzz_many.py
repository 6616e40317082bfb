"""Check random impacts at several contacts, regular and singular, against mechanics.

    python -m benchmarks.fuzz_many --seed 1 --count 100000
    python -m benchmarks.fuzz_many --landings --count 2000

Run from the root of the repository. Problems have one to five contacts, W of any rank, and equal or different
coefficients, some of them zero; every fourth is hard (flat bodies, ties, e = 0 next to e > 0). Checks are of
energy, which does not grow, the sum of all work, friction cones, normal impulses ≥ 0, no approach at the end,
and consistent impulses and velocities. Impacts that are integrated by steps, or reach a bound, are counted.
With --keep the table is written to docs/figures.

Landings are of rigid bodies on three to nine coplanar corners, symmetric or almost, flat or almost: boxes,
bricks, stools and quadrupeds with locked legs. Their velocities are also compared with the independent
integration of `tests/landing_reference.py`, unless a jump nearby is flagged. The tolerance, relative to the
largest velocity, is 1e-6 plus the error of that integration; for e = 0, a limit of small restitutions, 5e-3.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import time
from collections import Counter
from pathlib import Path
from typing import Any

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


def draw_landing(seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return J (3n, 6), M (6, 6), u (6,), and μ and e (n,)."""
    rng = np.random.default_rng(seed)
    kind = rng.integers(5)
    height = rng.uniform(0.02, 0.2)
    size = np.array([0.05, 0.05]) if kind == 0 else rng.uniform(0.02, 0.2, 2)
    signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=float)
    if kind in (0, 1):  # a cube, a brick
        flat = size * signs
    elif kind == 2:  # a plate on nine points
        flat = size * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)], dtype=float)
    elif kind == 3:  # a stool
        legs = int(rng.integers(3, 6))
        angles = 2.0 * np.pi * np.arange(legs) / legs
        flat = size[0] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    else:  # a quadruped with locked legs
        flat = size * signs + np.array([rng.uniform(-0.02, 0.02), 0.0])
    points = np.column_stack([flat, np.full(len(flat), -height)])
    mass = np.diag([1.0, 1.0, 1.0, *_box_inertia(*size, height)])
    u = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    if rng.random() < 0.8:
        u[:2] = rng.uniform(-1.0, 1.0, 2) * (1.0 if rng.random() < 0.5 else (1.0, 0.0))
    if rng.random() < 0.4:
        u[5] = rng.uniform(-5.0, 5.0)
    if rng.random() < 0.4:
        u[3:5] = rng.uniform(-2.0, 2.0, 2)
    deviation = 10.0 ** rng.uniform(-12, -2)  # from symmetric and flat landings
    if rng.random() < 0.4:
        points += deviation * height * rng.normal(size=points.shape)
    if rng.random() < 0.4:
        u += deviation * rng.normal(size=6)
    if kind == 4 or rng.random() < 0.2:
        turn = rng.normal(size=(3, 3)) * deviation
        mass[3:, 3:] = (np.eye(3) + turn) @ mass[3:, 3:] @ (np.eye(3) + turn).T
    jacobian = np.concatenate([np.hstack([np.eye(3), -_cross(point)]) for point in points])
    n = len(points)
    friction = np.full(n, 0.0 if rng.random() < 0.15 else rng.uniform(0.05, 1.2))
    return jacobian, mass, u, friction, np.full(n, 0.0 if rng.random() < 0.2 else rng.uniform(0.05, 0.95))


def _box_inertia(a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return the moments of inertia of a box of mass 1 with half sides a, b, c."""
    return (b * b + c * c) / 3.0, (a * a + c * c) / 3.0, (a * a + b * b) / 3.0


def _landing_reference() -> Any:
    path = Path(__file__).parents[1] / "tests" / "landing_reference.py"
    spec = importlib.util.spec_from_file_location("landing_reference", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.landing


REFERENCE_STEP = 5e-4
"""Step size of the independent integration, in units of its clock; reduced until its error is below 1e-7."""

LITTLE = 0.02, 0.01, 0.005, 0.0025, 0.00125
"""Restitutions from which the reference at e = 0 is extrapolated."""

ALLOWED, ALLOWED_LIMIT = 1e-6, 5e-3
"""Allowed errors relative to the largest velocity; the second one for e = 0."""


def _error(landing: Any, w: Array, velocity: Array, mu: Array, e: Array, after: Array) -> float:
    """Return the error of velocities, minus that of the reference, relative to the allowed one."""
    size = float(np.abs(velocity).max())
    numbers = w, velocity.ravel() / size, mu
    stiffness = np.full(len(mu), 1.0 / np.diag(w)[2::3].max())
    if not e.any():
        return _error_at_zero(landing, numbers, stiffness, after.ravel() / size)
    step = REFERENCE_STEP * min(1.0, 5.0 * float(e.min()))
    difference = error = np.inf
    for _ in range(3):
        by_steps, error = landing(*numbers, e, stiffness, step)
        difference = float(np.abs(after.ravel() / size - by_steps).max())
        if difference <= ALLOWED or error <= 0.1 * ALLOWED:
            break
        step *= 0.25
    return max(difference - error, 0.0) / ALLOWED


def _error_at_zero(landing: Any, numbers: tuple[Array, ...], stiffness: Array, after: Array) -> float:
    """Return the error of velocities at e = 0 relative to the allowed one.

    The reference is extrapolated from two small restitutions, smaller ones while the error is too large.
    """
    error, before = np.inf, None
    for little in LITTLE:
        step = 0.5 * REFERENCE_STEP * min(1.0, little / LITTLE[1])
        now = landing(*numbers, np.full(len(stiffness), little), stiffness, step)[0]
        if before is not None:
            error = float(np.abs(after - 2.0 * now + before).max())
        if error <= ALLOWED_LIMIT:
            break
        before = now
    return error / ALLOWED_LIMIT


def _cross(r: Array) -> Array:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def check(seed: int, landing: Any = None) -> tuple[list[str], str, int, float]:
    """Check a problem, or a landing if the reference `landing` is given.

    Returns:
        Its violations, how it was solved, its events per contact, and the run time [s].
    """
    jacobian, mass, u, friction, restitution = draw(seed) if landing is None else draw_landing(seed)
    delassus = jacobian @ np.linalg.solve(mass, jacobian.T)
    velocity = (jacobian @ u).reshape(-1, 3)
    if not (velocity[:, 2] < 0).any():  # separating
        u, velocity = -u, -velocity
    problem = pinimpact.ImpactProblem(
        0.5 * (delassus + delassus.T), velocity, friction, restitution, "energetic"
    )
    start = time.perf_counter()
    try:
        solution = pinimpact.solve_impact(problem, simultaneous="propagate")
    except pinimpact.PinimpactError as raised:
        return [], f"refused: {type(raised).__name__}", 0, time.perf_counter() - start
    taken = time.perf_counter() - start
    p = solution.impulse
    after = u + np.linalg.solve(mass, jacobian.T @ p.ravel())
    scale, push = np.abs(velocity).max(), max(np.abs(p).max(), 1e-300)
    rounding = 1e-9 * scale + 1e-12 * push * np.abs(delassus).max()
    if solution.notes:  # all at once, or by steps with the noted accuracy
        noted = re.search(r"velocities to about (\S+) of the largest", solution.notes[-1])
        rounding = max(1e2 * rounding, 1.05 * float(noted[1]) * scale if noted else 0.0)
    before, later = 0.5 * u @ mass @ u, 0.5 * after @ mass @ after
    checks = {
        "energy grows": later > before + 1e-9 * before + len(p) * push * rounding,
        "sum of all work": abs(later - before - solution.work.total.sum())
        > 1e-8 * before + len(p) * push * rounding,
        "outside the cone": (np.hypot(p[:, 0], p[:, 1]) > friction * p[:, 2] + 1e-9 * push).any(),
        "negative normal impulse": (p[:, 2] < -1e-12 * push).any(),
        "approach at the end": (solution.velocity[:, 2] < -10.0 * rounding).any(),
        "momentum": np.abs((jacobian @ after).reshape(-1, 3) - solution.velocity).max() > 10.0 * rounding,
    }
    if landing is not None:
        error = _error(landing, problem.delassus, velocity, friction, restitution, solution.velocity)
        flagged = pinimpact.Flag.NEAR_JUMP in solution.flags
        checks[f"{error:.1e} times the allowed error"] = error > 1.0 and not flagged
    kind = "by itself"
    if solution.notes:
        kind = "by steps, noted" if "adaptive steps" in solution.notes[-1] else "all at once, noted"
    return [what for what, wrong in checks.items() if wrong], kind, solution.events // len(p), taken


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--landings", action="store_true", help="flat and nearly flat landings")
    parser.add_argument("--keep", action="store_true", help="write the table to docs/figures")
    options = parser.parse_args()
    ends: Counter[str] = Counter()
    wrong, most, times = 0, (0, 0), []
    landing = _landing_reference() if options.landings else None
    check(0, landing)  # compiles
    for seed in range(1_000_000 * options.seed, 1_000_000 * options.seed + options.count):
        violations, ended, events, taken = check(seed, landing)
        ends[ended] += 1
        wrong += bool(violations)
        most = max(most, (events, seed))
        times.append(taken)
        if violations:
            print(f"{seed}: {', '.join(violations)}", flush=True)
    name = "landings" if options.landings else "problems"
    lines = [f"{options.count} random {name}, {wrong} with a violation", ""]
    lines += [f"{number:8d} {what}" for what, number in ends.most_common()]
    lines += ["", f"most events per contact: {most[0]} (seed {most[1]})"]
    lines += [f"time: median {1e3 * np.median(times):.2g} ms, longest {max(times):.2g} s", ""]
    if options.keep:
        keep("fuzz_landings" if options.landings else "fuzz_many", "\n".join(lines), ends)
    else:
        print("\n".join(lines), end="")
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
