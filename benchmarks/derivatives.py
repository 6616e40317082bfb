"""Check derivatives of random impacts and motions by difference quotients, and measure their run time.

    python -m benchmarks.derivatives --count 100000 --motions 200 --seed 0

Run from the root of the repository. Difference quotients at two steps are along a random direction of v°, W,
μ and e. If they agree with each other, and on both sides, but not with a derivative without a flag of
`Boundary`, difference quotients in multiple precision decide. They also decide if such a derivative violates
an identity (scaling of all velocities or masses, rotation of the axes) or the closed form without friction.
Derivatives of motions, and of as many impacts at several contacts, are compared with difference quotients at
two steps. With --keep the counts of impacts are written to docs/figures.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from tests.random_scenes import plane_below
from tests.reference.problems import RECIPES
from tests.reference.slopes import slopes
from tests.robot_cases import FRAMES, load

import pinimpact
from pinimpact import LAWS, Status

from .timing import best_of, keep

REGIMES = ("smooth slip", "slip to stick", "resumed slip", "jam", "no collision", "second compression")
REGIMES += ("no slip", "near-invariant start", "isotropic", "straight", "high friction", "frictionless")
STEPS = (1e-5, 3e-6)
LENGTH = 0.25
EXACT: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-14, "scheme": "event-driven"}
ROWS = 40
"""Number of rows of a timed batch; few, so that other processes seldom interrupt it."""

IDENTITY = 1e-9
"""Error of an identity, relative to its terms, above which multiple precision decides."""

ROW = "{:<22}{:>9}{:>9}{:>10}{:>7}"

UPPER = np.triu_indices(3)
AGREED = 1e-5
"""Relative difference of the two quotients below which they are taken as the derivative."""


def problems(rng: np.random.Generator, regime: str, count: int) -> tuple[np.ndarray, ...]:
    """Return W, v, μ and e of random problems."""
    W, v, mu = (np.array(x) for x in zip(*(RECIPES[regime](rng) for _ in range(count)), strict=True))
    return W, v, mu, rng.uniform(0.02, 0.98, count)


def identity_errors(W: np.ndarray, v: np.ndarray, mu: np.ndarray, e: np.ndarray, batch: Any) -> np.ndarray:
    """Return relative errors of the identities after (D15), or of the closed form at μ = 0."""
    d, P = batch.derivatives, batch.impulse
    Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    changes = (v, 0.0 * W, P), (0.0 * v, W, -P), (v @ Z.T, Z @ W - W @ Z, P @ Z.T)
    size = np.linalg.norm(P, axis=1) + np.linalg.norm(d.dP_dv, axis=(1, 2)) * np.linalg.norm(v, axis=1)
    size += np.sqrt((d.dP_ddelassus**2).sum(axis=(1, 2, 3)) * (W**2).sum(axis=(1, 2)))
    worst = np.zeros(len(v))
    for dv, dW, dP in changes:
        found = np.einsum("nij,nj->ni", d.dP_dv, dv) + np.einsum("nkij,nij->nk", d.dP_ddelassus, dW)
        worst = np.maximum(worst, np.linalg.norm(found - dP, axis=1) / (size + (size == 0.0)))
    closed = np.eye(3) - (1.0 + e)[:, None, None] * W[:, :, 2:] / W[:, 2:, 2:] * np.eye(3)[2]
    error = np.abs(d.dv_dv - closed).max(axis=(1, 2)) / np.abs(closed).max(axis=(1, 2))
    return np.where((mu == 0.0) & (batch.status != Status.NO_IMPACT), np.maximum(worst, error), worst)


def check(rng: np.random.Generator, regime: str, law: str, count: int) -> tuple[int, int, int]:
    """Return the numbers of derivatives that have a flag, are compared, and are wrong without a flag."""
    W, v, mu, e = problems(rng, regime, count)
    batch = pinimpact.solve_impacts(W, v, mu, e, law, derivatives=True)
    d = batch.derivatives
    size = np.linalg.norm(v, axis=1)
    direction = rng.normal(size=(count, 3)) * size[:, None]
    if regime == "no collision":
        # there is an impact for v₃ ≤ 0 only, so no derivative by v₃
        direction[:, 2], d.dv_dv[:, :, 2], d.dP_dv[:, :, 2] = 0.0, 0.0, 0.0
    change = rng.normal(size=W.shape) * 0.3
    change = change @ W + W @ change.transpose(0, 2, 1)  # relative to W in every direction
    slope_mu, slope_e = rng.normal(size=count) * mu, rng.normal(size=count) * 0.01
    found = np.einsum("nij,nj->ni", d.dv_dv, direction) + np.einsum("nkij,nij->nk", d.dv_ddelassus, change)
    found += d.dv_dfriction * slope_mu[:, None] + d.dv_drestitution * slope_e[:, None]
    by_steps, sides = [], np.zeros(count)
    for h in STEPS:
        ends = [
            pinimpact.solve_impacts(
                W + s * change, v + s * direction, mu + s * slope_mu, e + s * slope_e, law
            )
            for s in (-2 * h, -h, h, 2 * h)
        ]
        a, b, c, f = (end.velocity for end in ends)
        by_steps.append((a - 8 * b + 8 * c - f) / (12 * h))
        sides = np.maximum(sides, np.linalg.norm((f - c) - (b - a), axis=1) / h)
    scale = np.linalg.norm(by_steps[1], axis=1) + size
    apart = np.linalg.norm(by_steps[0] - by_steps[1], axis=1)
    error = np.linalg.norm(found - by_steps[1], axis=1)
    flagged = ~np.isfinite(found).all(axis=1) | (d.boundary & pinimpact.Boundary.EVENTS_COINCIDE > 0)
    missed = ~flagged & (batch.status <= 3) & ~(identity_errors(W, v, mu, e, batch) < IDENTITY)
    compared = ~flagged & (apart < AGREED * scale) & (sides < 1e-3 * scale) & (batch.status <= 3)
    suspected = missed | (compared & ~(error < 10.0 * AGREED * scale))
    wrong = 0
    for k in np.flatnonzero(suspected):  # wrong, or a kink near the steps
        by_delassus = d.dv_ddelassus[k] * (2.0 - np.eye(3))
        mine = np.column_stack(
            [d.dv_dv[k], by_delassus[:, UPPER[0], UPPER[1]], d.dv_dfriction[k], d.dv_drestitution[k]]
        )
        known = [i for i in range(11) if i != 2 or regime != "no collision"]
        exact = slopes(W[k], v[k], mu[k], e[k], law, known)[:3]
        if not np.linalg.norm(mine - exact) < 1e-9 * np.linalg.norm(exact):
            print(f"  wrong: {regime}, {law}: {W[k].tolist()}, {v[k].tolist()}, {mu[k]!r}, {e[k]!r}")
            wrong += 1
    return int(flagged.sum()), int(compared.sum()), wrong


def motion(rng: np.random.Generator) -> tuple[pinimpact.Scene, np.ndarray, np.ndarray]:
    """Return a random scene of a robot with one contact, and a state above its plane."""
    name = str(rng.choice(["panda", "ur5", "solo12"]))
    model = load(name)[0]
    if name != "solo12":
        model.damping = rng.uniform(0, 1, model.nv)
        model.friction = rng.choice([0, 1]) * rng.uniform(0, 3, model.nv)
    q = np.array(pinimpact.load_robot(name).q0)
    q = pin.integrate(model, q, 0.3 * rng.normal(size=model.nv) * (np.arange(model.nv) < 7))
    tip, radius = FRAMES[name], rng.choice([0.0, 0.02])
    plane = plane_below(rng, model, q, [tip], (0.5, 0.1), lambda: rng.uniform(0.03, 0.1))
    mu, e = rng.choice([0.0, 0.1, 0.3, 0.8]), rng.choice([0.0, 0.0, 0.3, 0.6])
    contact = pinimpact.Contact(tip, plane, mu, e, str(rng.choice(LAWS)), radius=radius, name="tip")
    v = rng.normal(size=model.nv) * rng.choice([0.3, 1.0])
    return pinimpact.Scene(model, [contact], without=["joint limits"]), q, v


def difference_quotient(
    scene: pinimpact.Scene, q: np.ndarray, v: np.ndarray, step: float, direction: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return the difference quotient of a motion's end along a direction, and whether its events change."""
    nv, ends, events = len(v), [], []
    for s in (-2, -1, 0, 1, 2):
        e = s * step * direction
        contact = replace(scene.contacts[0], friction=max(scene.contacts[0].friction + e[-1], 0.0))
        start = pin.integrate(scene.model, q, e[:nv]), v + e[nv : 2 * nv]
        run = pinimpact.simulate(replace(scene, contacts=[contact]), *start, LENGTH, **EXACT)
        ends.append((run.q[-1], run.v[-1]))
        events.append((len(run.impacts), sorted((one.source, one.mode) for one in run.modes)))
    middle = ends[2][0]
    a, b, _, c, d = (np.append(pin.difference(scene.model, middle, x), y) for x, y in ends)
    return (a - 8 * b + 8 * c - d) / (12 * step), any(one != events[2] for one in events)


def motions(rng: np.random.Generator, count: int) -> None:
    """Compare sensitivities of random motions with difference quotients at two steps; print the errors."""
    counts: Counter[str] = Counter()
    errors: list[float] = []
    while len(errors) < count:
        scene, q, v = motion(rng)
        direction = rng.normal(size=2 * len(v) + 1) * 0.5
        direction[-1] *= scene.contacts[0].friction > 0.0
        run = pinimpact.simulate(scene, q, v, LENGTH, **EXACT, sensitivities=("state", "friction:tip"))
        found = run.sensitivity(LENGTH)
        mine = found.state @ direction[:-1] + found.parameters["friction:tip"] * direction[-1]
        if not np.isfinite(mine).all():
            counts[f"flagged {found.boundary!r}"] += 1
            continue
        (a, kinks), (b, more) = (difference_quotient(scene, q, v, step, direction) for step in (2e-5, 1e-5))
        size = float(np.linalg.norm(b))
        if kinks or more or np.linalg.norm(a - b) > 1e-6 * size:
            counts["without differences"] += 1
            continue
        errors.append(float(np.linalg.norm(mine - b)) / size)
        if errors[-1] > 1e-6:
            counts["beyond 1e-6"] += 1
            print(f"  error {errors[-1]:.1e}: {scene}, {scene.contacts}, {q.tolist()}, {v.tolist()}")
    print(f"{len(errors)} motions compared, errors: median {np.median(errors):.1e}, max. {max(errors):.1e}")
    print(f"others: {dict(counts)}")


def several(rng: np.random.Generator, count: int) -> None:
    """Compare derivatives of impacts at two to four feet with difference quotients; print the errors."""
    counts: Counter[str] = Counter()
    errors: list[float] = []
    model, data = load("solo12")
    start, nv = np.array(pinimpact.load_robot("solo12").q0), model.nv
    for _ in range(count):
        n = int(rng.integers(2, 5))
        contacts = [
            pinimpact.Contact(
                *(f"{leg}_FOOT", pinimpact.Plane(normal=(*0.2 * rng.normal(size=2), 1.0))),
                *(rng.choice([0.0, 0.1, 0.4, 0.8]), rng.choice([0.0, 0.3, 0.6, 1.0]), "energetic"),
                radius=0.016,
            )
            for leg in rng.permutation(["FL", "FR", "HL", "HR"])[:n]
        ]
        q = pin.integrate(model, start, 0.2 * rng.normal(size=nv))
        v = rng.normal(size=nv) - 1.5 * np.eye(nv)[2]
        mu, e = (np.array([getattr(c, name) for c in contacts]) for name in ("friction", "restitution"))
        direction = [*rng.normal(size=(2, nv)), rng.normal(size=n) * mu, rng.normal(size=n) * e * (1.0 - e)]
        d = pinimpact.impact_derivatives(model, data, q, v, contacts)
        by = d.dv_dq, d.dv_dv, d.dv_dfriction, d.dv_drestitution
        mine = sum(columns[:, t != 0.0] @ t[t != 0.0] for columns, t in zip(by, direction, strict=True))

        def after(s: float, at: Any = (q, v, mu, e, contacts, direction)) -> np.ndarray:
            q, v, mu, e, contacts, direction = at
            changed = [
                replace(c, friction=m, restitution=b)
                for c, m, b in zip(contacts, mu + s * direction[2], e + s * direction[3], strict=True)
            ]
            return pinimpact.impact(
                model, data, pin.integrate(model, q, s * direction[0]), v + s * direction[1], changed
            ).v

        by_steps, size = [], float(np.linalg.norm(v))
        for h in (1e-4, 3e-5):
            a, b, c, f = (after(s) for s in (-2 * h, -h, h, 2 * h))
            by_steps.append((a - 8 * b + 8 * c - f) / (12 * h))
        agree = float(np.linalg.norm(by_steps[0] - by_steps[1])) < AGREED * size
        if not np.isfinite(mine).all():
            counts["flagged, differences agree" if agree else "flagged"] += 1
        elif not agree:
            counts["without differences"] += 1
        else:
            errors.append(float(np.linalg.norm(mine - by_steps[0])) / float(np.linalg.norm(by_steps[0])))
            if errors[-1] > 10.0 * AGREED:
                print(f"  error {errors[-1]:.1e}: {contacts}, {q.tolist()}, {v.tolist()}")
    print(
        f"{len(errors)} impacts at several contacts compared, errors: median {np.median(errors):.1e}, "
        f"max. {max(errors):.1e}; others: {dict(counts)}"
    )


def cost() -> None:
    """Print run times of derivatives, absolute and relative to the solution."""
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
            "rows": lambda args=(model, data, q, v, contact, 1e-3): pinimpact.impact_rows(*args),
        }
        best = best_of(calls, rounds=20)
        ratio = best["derivatives"] / best["impact"]
        print(
            f"{name}: impact {1e6 * best['impact']:.1f} µs, derivatives {1e6 * best['derivatives']:.0f} µs, "
            f"{ratio:.1f} ×, rows for a controller {1e6 * best['rows']:.0f} µs"
        )


def standing(scheme: str) -> tuple[pinimpact.Stepper, Any]:
    """Return a stepper of a solo12 on four feet, and its control."""
    robot = pinimpact.load_robot("solo12")
    model, data, q = robot.model, robot.data, pin.neutral(robot.model)
    q[7:] = np.tile([0.0, 0.7, -1.4], 4)
    feet = [f"{leg}_FOOT" for leg in ("FL", "FR", "HL", "HR")]
    pin.framesForwardKinematics(model, data, q)
    q[2] -= min(data.oMf[model.getFrameId(foot)].translation[2] for foot in feet)
    contacts = [pinimpact.Contact(foot, pinimpact.Plane(), friction=0.6) for foot in feet]
    stepper = pinimpact.Stepper(pinimpact.Scene(model, contacts), q, np.zeros(model.nv), scheme=scheme)

    def control() -> np.ndarray:
        return np.append(np.zeros(6), 20.0 * (q[7:] - stepper.q[7:]) - 0.5 * stepper.v[6:])

    return stepper, control


def swinging(scheme: str) -> tuple[pinimpact.Stepper, Any]:
    """Return a stepper of a Panda that swings above a floor, and its control."""
    robot = pinimpact.load_robot("panda")
    floor = pinimpact.Plane(point=(0.0, 0.0, -1.0))
    scene = pinimpact.Scene(robot, pinimpact.Contact(FRAMES["panda"], floor), without=["joint limits"])
    stepper = pinimpact.Stepper(scene, robot.q0, np.zeros(9), scheme=scheme)
    return stepper, lambda: 5.0 * np.sin(100.0 * stepper.t + np.arange(9))


def cost_of_steps() -> None:
    """Print run times of derivatives of 1 ms steps, relative to steps with and without derivatives."""
    scenes = ("solo12 on four feet", standing), ("Panda in flight", swinging)
    for (name, make), scheme in itertools.product(scenes, ("auto", "time-stepping")):
        best = np.full(3, np.inf)
        for _ in range(5):
            times = np.empty((3, 100))
            for alone in (True, False):
                stepper, control = make(scheme)
                stepper.linearize(control(), 1e-3)
                for k in range(100):
                    tau, begun = control(), time.perf_counter()
                    if not alone:
                        stepper.linearize(tau, 1e-3)
                        times[0, k], begun = time.perf_counter() - begun, time.perf_counter()
                    stepper.step(tau, 1e-3)
                    times[1 + alone, k] = time.perf_counter() - begun
            best = np.minimum(best, 1e6 * np.median(times, axis=1))
        linear, step, alone_step = best.tolist()
        print(
            f"{name}, {scheme}: step {step:.0f} µs, linearize {linear:.0f} µs, {linear / step:.1f} × "
            f"({linear / alone_step:.1f} × {alone_step:.0f} µs of steps without it)"
        )


def main() -> None:
    """Check derivatives and measure run times."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--motions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", action="store_true", help="write the counts of impacts to docs/figures")
    arguments = parser.parse_args()
    total = np.zeros(3, dtype=int)
    each = -(-arguments.count // (len(REGIMES) * len(LAWS)))
    lines = [ROW.format("", "impacts", "flagged", "compared", "wrong")]
    for i, regime in enumerate(REGIMES):
        counts = np.zeros(3, dtype=int)
        for j, law in enumerate(LAWS):
            counts += check(np.random.default_rng((arguments.seed, i, j)), regime, law, each)
        lines.append(ROW.format(regime, each * len(LAWS), *counts.tolist()))
        total += counts
    number = each * len(LAWS) * len(REGIMES)
    lines.append(ROW.format("all", number, *total.tolist()))
    table = "\n".join(lines) + "\n"
    if arguments.keep:
        figures = dict(zip(("flagged", "compared", "wrong"), total.tolist(), strict=True))
        keep("derivatives", table, {"seed": arguments.seed, "derivatives": number, **figures})
    else:
        print(table, end="")
    motions(np.random.default_rng(arguments.seed), arguments.motions)
    several(np.random.default_rng(arguments.seed), arguments.motions)
    cost()
    cost_of_steps()


if __name__ == "__main__":
    main()
