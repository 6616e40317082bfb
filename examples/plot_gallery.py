"""Draw every plot of ``pinimpact.visual.plots`` once, and a replay, as docs/seeing.md shows them.

Run it as ``python examples/plot_gallery.py [folder]``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot

import pinimpact
from pinimpact.app.demo import run_demo
from pinimpact.visual.browser import find_browser, open_page

plots = pinimpact.visual.plots


def rod_strikes() -> pinimpact.Hit:
    """Return the impact of Zhao and Liu's figure 7: slip stops, and resumes across its first direction."""
    robot = pinimpact.load_robot("rod")
    tip = pinimpact.Contact("tip", pinimpact.Plane(), friction=0.7, restitution=0.8)
    velocity = [0.2, 0.2 * math.sqrt(3), -2, 0, 0]
    return pinimpact.impact(robot.model, robot.data, [0, 0, 0, 0, 0.46], velocity, tip)


def panda_strikes() -> pinimpact.Hit:
    """Return the impact of README.md."""
    robot = pinimpact.load_robot("panda")
    table = pinimpact.Plane(point=(0, 0, 0.6))
    hand = pinimpact.Contact("panda_hand_tcp", table, friction=0.3, restitution=0.5)
    v = [0.4, 2.1, 0.4, -0.6, 0.25, 1.2, 0, 0, 0]
    return pinimpact.impact(robot.model, robot.data, robot.q0, v, hand)


def planar_jam() -> pinimpact.ImpactProblem:
    """Return a planar impact whose normal acceleration is negative until slip stops."""
    delassus = np.array([[1.2, 0.0, 0.9], [0.0, 1.0, 0.0], [0.9, 0.0, 1.0]])
    return pinimpact.ImpactProblem(delassus, (0.8, 0.0, -1.0), friction=1.3, restitution=0.6)


def falling_rod() -> tuple[Any, pinimpact.Trajectory]:
    """Return the motion of a rod that falls, bounces, topples and slides."""
    robot = pinimpact.load_robot("rod")
    floor = pinimpact.Plane()
    tip = pinimpact.Contact("tip", floor, friction=0.4, restitution=0.4, name="tip")
    scene = pinimpact.Scene(robot, [tip], without=["joint limits"])
    return robot, pinimpact.simulate(scene, [0, 0, 0.65, 0, 0.5], [0.6, 0.1, 0, 0.5, 0], 0.75)


def gallery() -> Iterator[tuple[str, Any]]:
    """Yield the name of each plot, and its axes."""
    rod, panda, planar = rod_strikes(), panda_strikes(), planar_jam()
    yield "hodograph", plots.hodograph(rod)
    yield "velocities", plots.velocities(panda)
    yield "impulses", plots.impulses(panda)
    yield "impulse_space", plots.impulse_space(panda)
    yield "impulse_plane", plots.impulse_space(planar)
    yield "regimes_angle", plots.regime_map(rod)
    yield "regimes_restitution", plots.regime_map(planar, "restitution")
    yield "energy_ledger", plots.energy_ledger(panda)
    robot, trajectory = falling_rod()
    yield "forces", plots.forces(trajectory, "tip")
    yield "overview", plots.overview(trajectory, robot)


def replays(folder: Path) -> Iterator[Path]:
    """Write pictures of the replays of a motion and of an impact, if there is a browser."""
    browser = find_browser()
    if browser is None:
        return
    demo = run_demo("panda")
    shown = (("replay", demo.trajectory, "impact=1"), ("replay_hit", demo.impact, "film=4"))
    for name, motion, place in shown:
        page = pinimpact.replay(demo.robot, motion, folder / "x.html", contacts=demo.contacts, speed=0.2)
        open_page(browser, page, place, size=(1100, 680), screenshot=folder / f"{name}.png")
        Path(page).unlink()
        yield folder / f"{name}.png"


def main(folder: Path) -> None:
    """Write the plots as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, axes in gallery():
        figure = np.ravel(axes)[0].figure
        path = plots.save_figure(figure, folder / f"plot_{name}.png")
        pyplot.close(figure)
        print(path)
    for path in replays(folder):
        print(path)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
