"""Pictures of one impact: the hodograph of slip, the path over the normal impulse, where the energy went."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Path as RecordedPath
from ..contact_space.solution import Solution, Work
from ..errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..scene.trajectory import Trajectory

COMPRESSION, RESTITUTION, STICK, FLOW = "#c0392b", "#1f6fb2", "#f0b429", "#b8bec5"


def impact_figure(problem: ImpactProblem, solution: Solution, title: str = "") -> Figure:
    """Return a figure with the hodograph, the path over the normal impulse, and the energy by cause.

    Args:
        problem: What was solved; its flow of slip is drawn behind the hodograph.
        solution: Its answer, solved with ``record=True``.
        title: Above the figure.

    Raises:
        InputError: A solution without a path.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1.0))
    draw_hodograph(figure.add_subplot(grid[:, 0]), problem, solution)
    path_axes, work_axes = figure.add_subplot(grid[:2, 1]), figure.add_subplot(grid[2, 1])
    draw_path(path_axes, solution)
    draw_work(work_axes, solution.work)
    return figure


def draw_hodograph(axes: Axes, problem: ImpactProblem, solution: Solution) -> None:
    """Draw the sliding velocity's path in the tangential plane over the flow of slip.

    Raises:
        InputError: A solution without a path.
    """
    path = _path_of(solution)
    v1, v2 = path.velocity[:, 0], path.velocity[:, 1]
    radius = 1.15 * max(float(np.abs(path.velocity[:, :2]).max()), 1e-12)
    _draw_flow(axes, problem, radius)
    cut = _end_of_compression(solution)
    before = path.normal_impulse <= cut
    after = path.normal_impulse >= cut
    axes.plot(v1[before], v2[before], color=COMPRESSION, lw=2.2, label="compression")
    axes.plot(v1[after], v2[after], color=RESTITUTION, lw=2.2, label="restitution")
    axes.plot(v1[0], v2[0], "o", color=COMPRESSION, ms=7, label="first touch")
    axes.plot(v1[-1], v2[-1], "s", color=RESTITUTION, ms=7, label="separation")
    if any(segment.mode == "stick" for segment in solution.segments):
        axes.plot(0.0, 0.0, "D", mfc=STICK, mec="black", ms=9, label="stick")
    axes.axhline(0.0, color="black", lw=0.5)
    axes.axvline(0.0, color="black", lw=0.5)
    axes.set(xlim=(-radius, radius), ylim=(-radius, radius), xlabel="v₁ [m/s]", ylabel="v₂ [m/s]")
    axes.set_title("Sliding velocity (hodograph)")
    axes.set_aspect("equal")
    axes.legend(fontsize="small", loc="best")


def draw_path(axes: Axes, solution: Solution) -> None:
    """Draw the contact velocity over the normal impulse; stick is shaded, the end of compression marked.

    Raises:
        InputError: A solution without a path.
    """
    path = _path_of(solution)
    for row, (name, color) in enumerate((("v₁", "#16a085"), ("v₂", "#8e44ad"), ("v₃ (normal)", "black"))):
        axes.plot(path.normal_impulse, path.velocity[:, row], color=color, label=name)
    for segment in solution.segments:
        if segment.mode == "stick":
            axes.axvspan(segment.start, segment.end, color=STICK, alpha=0.25, lw=0.0, label="stick")
    axes.axvline(_end_of_compression(solution), color=COMPRESSION, ls="--", lw=1.0, label="compression ends")
    axes.axhline(0.0, color="black", lw=0.5)
    axes.set(xlabel="normal impulse P₃ [N s]", ylabel="[m/s]")
    axes.set_title("Contact velocity")
    axes.legend(fontsize="small", loc="best")


def draw_work(axes: Axes, work: Work) -> None:
    """Draw a bar of work for each cause [J]."""
    names = ("compression", "restitution", "friction", "surface", "total")
    values = [float(getattr(work, name)) for name in names]
    colors = (COMPRESSION, RESTITUTION, "#7f5539", "#16a085", "black")
    axes.barh(names[::-1], values[::-1], color=colors[::-1])
    for row, value in enumerate(values[::-1]):
        axes.annotate(
            f" {value:.3g} ", (value, row), ha="left" if value >= 0.0 else "right", va="center", size=8
        )
    axes.margins(x=0.2)
    axes.axvline(0.0, color="black", lw=0.5)
    axes.set(xlabel="work [J]")


def energy_figure(trajectory: Trajectory, title: str = "") -> Figure:
    """Return a figure of a run's energies and works over time, with its impacts marked."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    energy = trajectory.energy
    axes.plot(trajectory.t, energy.total, color="black", lw=2.0, label="kinetic + potential")
    for name in ("control", "joints", "friction", "surface", "impacts"):
        work = getattr(energy, name)
        if np.any(work):
            axes.plot(trajectory.t, work, ls="--", label=f"work of {name}")
    for impact in trajectory.impacts:
        axes.axvline(impact.time, color=FLOW, lw=0.6, zorder=0)
    axes.set(xlabel="t [s]", ylabel="[J]", title=title)
    axes.legend(fontsize="small", loc="best")
    return figure


def forces_figure(trajectory: Trajectory, contacts: Sequence[str], title: str = "") -> Figure:
    """Return a figure of the forces of sustained contacts over time, one row a contact; slip is shaded.

    Args:
        trajectory: The motion; impulses of impacts are not in it but marked.
        contacts: Names of the contacts.
        title: Above the figure.

    Raises:
        UnknownNameError: A contact that the scene does not have.
    """
    from matplotlib.figure import Figure

    times = np.unique(np.concatenate([trajectory.t, np.linspace(trajectory.t[0], trajectory.t[-1], 400)]))
    rows = np.concatenate([times, times])
    order = np.argsort(rows, kind="stable")  # before a jump, then after it
    figure = Figure(figsize=(9.0, 1.2 + 1.7 * len(contacts)), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(len(contacts), 1, sharex=True, squeeze=False)[:, 0]
    for row, contact in zip(axes, contacts, strict=True):
        forces = np.concatenate([trajectory.forces(contact, times, side) for side in ("left", "right")])[
            order
        ]
        row.plot(rows[order], forces[:, 2], color="black", lw=1.4, label="normal")
        row.plot(
            rows[order], np.hypot(forces[:, 0], forces[:, 1]), color=RESTITUTION, lw=1.4, label="friction"
        )
        for interval in trajectory.modes:
            if interval.source == contact and interval.mode == "slip":
                row.axvspan(interval.start, interval.end, color=COMPRESSION, alpha=0.2, lw=0.0, label="slip")
        for impact in trajectory.impacts:
            if impact.source == contact:
                row.axvline(impact.time, color=FLOW, lw=0.6, zorder=0, label="impact")
        row.set(ylabel=f"{contact}\n[N]")
    names: dict[str, Any] = {}
    for row in axes:
        handles, labels = row.get_legend_handles_labels()
        names |= dict(zip(labels, handles, strict=True))
    figure.legend(names.values(), names.keys(), fontsize="small", loc="outside lower center", ncols=4)
    axes[-1].set(xlabel="t [s]")
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG and return its path."""
    figure.savefig(path, dpi=130)
    return Path(path)


def _path_of(solution: Solution) -> RecordedPath:
    if solution.path is None:
        raise InputError(
            "solution: it has no recorded path to draw; solve with record=True",
            field="solution",
            value=solution,
        )
    return solution.path


def _end_of_compression(solution: Solution) -> float:
    """Return the normal impulse at which the (first) compression ends."""
    first_restitution = (segment.start for segment in solution.segments if segment.phase == "restitution")
    return next(first_restitution, float(_path_of(solution).normal_impulse[-1]))


def _draw_flow(axes: Axes, problem: ImpactProblem, radius: float) -> None:
    """Draw the streamlines of dv_t/dP₃ = b − μ A v_t/|v_t|."""
    w = np.asarray(problem.delassus, dtype=float)
    ticks = np.linspace(-radius, radius, 40)
    slip = np.array(np.meshgrid(ticks, ticks))
    direction = slip / np.hypot(*slip)
    rate = w[:2, 2, None, None] - problem.friction * np.einsum("ij,jkl->ikl", w[:2, :2], direction)
    if np.any(rate):
        axes.streamplot(ticks, ticks, rate[0], rate[1], color=FLOW, linewidth=0.7, arrowsize=0.7, density=0.9)
