"""Identify the tossed cube of ContactNets from recordings, and predict tosses that are left out.

    python -m benchmarks.recorded_cubes ../shared/data/cube_tosses

Run from the root of the repository, which does not contain the data. Lengths are in the unit of the data.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.test_identification import cross_validated, cube_scene, cube_states, names_of
from tests.test_recorded_impacts import cube_motions

from pinimpact import Plane, Scene, studies
from pinimpact.contact_space.laws import LAWS
from pinimpact.studies.one_step import ONE_STEP
from pinimpact.studies.recordings import gaps

from .timing import FIGURES

WIDTH = 0.1017
"""Width of the cube [m]."""


def row(what: str, fit: studies.Identified, index: int, unit: str = "") -> str:
    """Return a line with a parameter and its standard error."""
    error = fit.standard_errors[index]
    interval = f"± {error:.4f}" if np.isfinite(error) else "no interval"
    return f"{what:<52}{fit.x[index]:>9.4f} {interval}{unit}"


def other_laws(given: studies.FoundImpacts, scene: Scene) -> list[str]:
    """Return lines with the mean error of each law, and its excess over that of Poisson's law."""
    fits = {law: studies.identify(given, scene, law=law) for law in (*LAWS, *ONE_STEP)}
    unit = np.sqrt(scene.model.inertias[1].mass)
    lines = ["mean errors of fits, and differences from Poisson's law"]
    for law, fit in fits.items():
        found = studies.compare(fit, fits["poisson"])
        low, high = found.interval[0] / unit
        error = np.linalg.norm(fit.fun.reshape(len(given), -1), axis=1).mean() / unit
        coefficients = " and ".join(f"{x:.3f}" for x in fit.x)
        lines.append(f"  {law:<10} μ and e {coefficients:<32}{error:>9.4f} m/s, {low:+.4f} to {high:+.4f}")
    return lines


def averages(errors: np.ndarray) -> list[str]:
    """Return lines with mean and median of errors (n, 2) of position and rotation."""
    return [
        f"{'  ' + name:<52}{100 * position / WIDTH:>7.1f} % of the width, {np.degrees(rotation):.1f}°"
        for name, (position, rotation) in (
            ("mean", errors.mean(axis=0)),
            ("median", np.median(errors, axis=0)),
        )
    ]


def whole_motions(scene: Scene, motions: list[studies.Motion]) -> list[str]:
    """Return lines with coefficients fitted to every sixth toss as a whole, and errors of the others."""
    rest = np.array([gaps(scene, motion.q[-1:])[0] for motion in motions])
    height = float(np.sort(rest, axis=1)[:, :4].mean())  # of the board, from the corners on which cubes rest
    board = Plane(point=(0.0, 0.0, height))
    scene = replace(scene, contacts=[replace(contact, plane=board) for contact in scene.contacts])
    free = {"friction": (0.05, 0.4), "restitution": (0.05, 0.6), "sliding_friction": (0.1, 0.4)}
    flights, fit = (
        studies.identify(scene=scene, free=free, trajectories=motions[::6], restart=restart)
        for restart in (True, False)
    )
    held_out = [motion for k, motion in enumerate(motions) if k % 6]
    errors = studies.rollouts(fit.apply(scene), held_out).mean()
    lines = []
    for one, what in ((flights, "the flights of"), (fit, "all of")):
        lines.append(f"coefficients from {what} {one.groups} tosses, with the board at {1e3 * height:.2f} mm")
        lines += [row(f"  {name.replace('_', ' ')}", one, j) for j, name in enumerate(one.names)]
    return [*lines, f"errors of the other {len(held_out)} tosses, averaged over time", *averages(errors)]


def main() -> None:
    """Print and write the results."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    d, recordings = (dict(np.load(folder / name)) for name in ("impacts.npz", "trajectories.npz"))
    scene = cube_scene(d)
    scene.model.gravity.linear = np.array([0.0, 0.0, -9.81 / float(d["scale_to_si"])])
    given = studies.FoundImpacts(*cube_states(d), names_of(d), d["toss"], scene=scene)
    pair = studies.identify(given, scene)
    lines = [f"{len(given)} impacts found by others, {pair.groups} tosses"]
    lines += [row("  friction", pair, 0), row("  restitution", pair, 1)]
    lines += [f"{'  error of impacts left out of the fit':<52}{cross_validated(d):>9.4f} m/s"]
    lines += other_laws(given, scene)
    motions = cube_motions(d, recordings, len(recordings["toss"]))
    found = studies.impacts(scene, motions)
    own = studies.identify(found, scene)
    lines += [f"{len(found)} impacts found in {len(motions)} recordings, {len(found.dropped)} dropped"]
    lines += [row("  friction", own, 0), row("  restitution", own, 1)]
    for slowest in (0.02, 0.3):
        slid = studies.identify_sliding(motions, scene, slowest=slowest)
        lines.append(row(f"friction of sliding faster than {slowest:g} m/s, {slid.groups} tosses", slid, 0))
    labels = np.array([motion.group for motion in motions])
    errors = np.zeros((len(motions), 2))
    for fold in range(4):  # each fourth of the tosses is predicted from the others
        out = np.arange(len(motions)) % 4 == fold
        kept = ~np.isin(found.group, labels[out])
        model = studies.identify(found[kept], scene).apply(scene)
        others = [motion for motion, left in zip(motions, out, strict=True) if not left]
        model = studies.identify_sliding(others, model, ("sliding_friction",)).apply(model)
        test = studies.rollouts(model, [motion for motion, left in zip(motions, out, strict=True) if left])
        errors[out] = test.mean()
    lines += ["whole tosses left out of the fit, errors averaged over time", *averages(errors)]
    lines += whole_motions(scene, motions)
    text = "\n".join(lines) + "\n"
    print(text)
    (FIGURES / "recorded_cubes.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
