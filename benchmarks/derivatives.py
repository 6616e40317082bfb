"""Check derivatives of random impacts by differences at two steps, and measure what they cost.

    python -m benchmarks.derivatives --count 100000 --seed 0

Run from the root of the repository. Each problem is changed along a random direction of v°, W, μ and e. Where
differences at both steps and to either side agree with each other and not with the derivative, and no flag of
`Boundary` is set, differences in multiple precision decide.
"""

from __future__ import annotations

import argparse

import numpy as np
from tests.reference.problems import RECIPES
from tests.reference.slopes import slopes
from tests.robot_cases import FRAMES, load

import pinimpact
from pinimpact import LAWS, Boundary

from .timing import best_of

REGIMES = ("smooth slip", "slip to stick", "resumed slip", "jam", "no collision", "second compression")
REGIMES += ("no slip", "near-invariant start", "isotropic", "straight", "high friction", "frictionless")
STEPS = (1e-5, 3e-6)
ROWS = 40
"""Of a batch whose time is taken: few, so that other processes seldom come in between."""

UPPER = np.triu_indices(3)
AGREED = 1e-5
"""Relative difference of the two differences up to which they count as one derivative."""


def problems(rng: np.random.Generator, regime: str, count: int) -> tuple[np.ndarray, ...]:
    """Return W, v, μ and e of random problems."""
    W, v, mu = (np.array(x) for x in zip(*(RECIPES[regime](rng) for _ in range(count)), strict=True))
    return W, v, mu, rng.uniform(0.02, 0.98, count)


def check(rng: np.random.Generator, regime: str, law: str, count: int) -> tuple[int, int, int]:
    """Return how many derivatives have a flag, are compared, and are wrong without one."""
    W, v, mu, e = problems(rng, regime, count)
    batch = pinimpact.solve_impacts(W, v, mu, e, law, derivatives=True)
    d = batch.derivatives
    size = np.linalg.norm(v, axis=1)
    towards = rng.normal(size=(count, 3)) * size[:, None]
    if regime == "no collision":
        towards[:, 2] = 0.0  # an impact on one side only
    change = rng.normal(size=W.shape) * 0.3
    change = change @ W + W @ change.transpose(0, 2, 1)  # as large as W in every direction
    slope_mu, slope_e = rng.normal(size=count) * mu, rng.normal(size=count) * 0.01
    found = np.einsum("nij,nj->ni", d.dv_dv, towards) + np.einsum("nkij,nij->nk", d.dv_ddelassus, change)
    found += d.dv_dfriction * slope_mu[:, None] + d.dv_drestitution * slope_e[:, None]
    by_steps, sides = [], np.zeros(count)
    for h in STEPS:
        ends = [
            pinimpact.solve_impacts(W + s * change, v + s * towards, mu + s * slope_mu, e + s * slope_e, law)
            for s in (-2 * h, -h, h, 2 * h)
        ]
        a, b, c, f = (end.velocity for end in ends)
        by_steps.append((a - 8 * b + 8 * c - f) / (12 * h))
        sides = np.maximum(sides, np.linalg.norm((f - c) - (b - a), axis=1) / h)
    scale = np.linalg.norm(by_steps[1], axis=1) + size
    apart = np.linalg.norm(by_steps[0] - by_steps[1], axis=1)
    error = np.linalg.norm(found - by_steps[1], axis=1)
    flagged = d.boundary & ~int(Boundary.BOUND) != 0
    compared = ~flagged & (apart < AGREED * scale) & (sides < 1e-3 * scale) & (batch.status <= 3)
    suspected = compared & ~(error < 10.0 * AGREED * scale)
    wrong = 0
    for k in np.flatnonzero(suspected):  # a kink between the steps, or slopes in multiple precision differ
        by_delassus = d.dv_ddelassus[k] * (2.0 - np.eye(3))
        mine = np.column_stack(
            [d.dv_dv[k], by_delassus[:, UPPER[0], UPPER[1]], d.dv_dfriction[k], d.dv_drestitution[k]]
        )
        exact = slopes(W[k], v[k], mu[k], e[k], law)[:3]
        if not np.linalg.norm(mine - exact) < 1e-9 * np.linalg.norm(exact):
            print(f"  wrong: {regime}, {law}: {W[k].tolist()}, {v[k].tolist()}, {mu[k]!r}, {e[k]!r}")
            wrong += 1
    return int(flagged.sum()), int(compared.sum()), wrong


def cost() -> None:
    """Print what derivatives cost, over the solution itself."""
    rng = np.random.default_rng(1)
    for regime in ("smooth slip", "slip to stick", "resumed slip"):
        W, v, mu, e = problems(rng, regime, ROWS)
        for law in LAWS:
            calls = {
                "solve": lambda args=(W, v, mu, e, law): pinimpact.solve_impacts(*args),
                "both": lambda args=(W, v, mu, e, law): pinimpact.solve_impacts(*args, derivatives=True),
            }
            best = best_of(calls, rounds=100)
            each = {name: 1e6 * seconds / ROWS for name, seconds in best.items()}
            ratio = each["both"] / each["solve"]
            print(f"{regime}, {law}: {each['solve']:.2f} µs, with slopes {each['both']:.2f}, {ratio:.1f} ×")
    for name in ("panda", "solo12", "talos"):
        model, data = load(name)
        contact = pinimpact.Contact(FRAMES[name], pinimpact.Plane(), friction=0.3, restitution=0.5)
        q = np.array(pinimpact.load_robot(name).q0)
        v = rng.normal(size=model.nv)
        v *= -np.sign(pinimpact.contact_matrices(model, data, q, contact).velocity(v)[2])
        calls = {
            "impact": lambda args=(model, data, q, v, contact): pinimpact.impact(*args),
            "derivatives": lambda args=(model, data, q, v, contact): pinimpact.impact_derivatives(*args),
        }
        best = best_of(calls, rounds=20)
        ratio = best["derivatives"] / best["impact"]
        print(
            f"{name}: impact {1e6 * best['impact']:.1f} µs, derivatives {1e6 * best['derivatives']:.0f} µs, "
            f"{ratio:.0f} ×"
        )


def main() -> None:
    """Check and measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    total = np.zeros(3, dtype=int)
    each = -(-arguments.count // (len(REGIMES) * len(LAWS)))
    for i, regime in enumerate(REGIMES):
        for j, law in enumerate(LAWS):
            counts = check(np.random.default_rng((arguments.seed, i, j)), regime, law, each)
            print(f"{regime}, {law}: {counts[0]} flagged, {counts[1]} compared, {counts[2]} wrong")
            total += counts
    print(f"of {each * len(REGIMES) * len(LAWS)}: {total[0]} flagged, {total[1]} compared, {total[2]} wrong")
    cost()


if __name__ == "__main__":
    main()
