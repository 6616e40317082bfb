"""Whole figures, without pyplot, as written by the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...checks import as_tuple, output_file
from ...contact_space.many_solution import ManySolution
from ...contact_space.problem import ImpactProblem
from ...contact_space.solution import Solution
from ...errors import InputError
from ...scene.trajectory import Trajectory
from .motions import energy, forces
from .one_impact import Solved, energy_ledger, hodograph, velocities
from .style import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def impact_figure(problem: ImpactProblem, solution: Solution | ManySolution, title: str = "") -> Figure:
    """Return a figure with the hodograph, the velocity over the normal impulse, and the energy by cause.

    For an impact at many contacts it has the hodograph and the velocity of each.

    Args:
        problem: The problem.
        solution: Its solution.
        title: Title of the figure.
    """
    from matplotlib.figure import Figure

    impact = Solved(problem, solution)
    if isinstance(solution, ManySolution):
        return _many_figure(impact, len(solution.velocity), title)
    figure = Figure(figsize=(11.5, 6.4), layout="constrained")
    figure.suptitle(plain(title))
    grid = figure.add_gridspec(3, 2, width_ratios=(1.25, 1.0))
    hodograph(impact, ax=figure.add_subplot(grid[:, 0]))
    velocities(impact, ax=figure.add_subplot(grid[:2, 1]))
    energy_ledger(impact, ax=figure.add_subplot(grid[2, 1]))
    return figure


def _many_figure(impact: Solved, count: int, title: str) -> Figure:
    """Return the figure of an impact at many contacts, one row per contact."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 4.6 * count + 2.2), layout="constrained")
    figure.suptitle(plain(title))
    heights = (*[4.6] * count, 2.2)
    grid = figure.add_gridspec(count + 1, 2, width_ratios=(1.0, 1.4), height_ratios=heights)
    for row in range(count):
        hodograph(impact, contact=row, ax=figure.add_subplot(grid[row, 0])).set_title(f"Contact {row}")
        velocities(impact, contact=row, ax=figure.add_subplot(grid[row, 1]))
    energy_ledger(impact, ax=figure.add_subplot(grid[count, :]))
    return figure


def energy_figure(trajectory: Trajectory, title: str = "") -> Figure:
    """Return a figure of the change of energy over time, by cause."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    energy(trajectory, ax=figure.add_subplot()).set_title(plain(title))
    return figure


def forces_figure(trajectory: Trajectory, contacts: str | Sequence[str], title: str = "") -> Figure:
    """Return a figure of the forces of sustained contacts over time, one row per contact.

    Raises:
        InputError: No contact is given.
        UnknownNameError: A contact that the scene does not have.
    """
    from matplotlib.figure import Figure

    contacts = as_tuple("contacts", contacts, str, "the name of a contact")
    if not contacts:
        raise InputError("contacts: none given; the figure has a row for each", value=contacts)
    figure = Figure(figsize=(9.0, 0.8 + 1.7 * len(contacts)), layout="constrained")
    figure.suptitle(plain(title))
    rows = figure.subplots(len(contacts), 1, sharex=True, squeeze=False)[:, 0]
    for ax, contact in zip(rows, contacts, strict=True):
        forces(trajectory, contact, ax=ax)
        if ax is not rows[-1]:
            ax.set_xlabel("")
    handles = {handle.get_label(): handle for ax in rows for handle in ax.get_legend_handles_labels()[0]}
    for ax in rows:
        if ax.get_legend() is not None:
            ax.get_legend().remove()
    figure.legend(
        handles=handles.values(), fontsize="small", loc="outside lower center", ncols=4, frameon=False
    )
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure in the format of the path's suffix (PNG, PDF, SVG) and return its path.

    Raises:
        InputError: A path in a folder that does not exist.
    """
    path = output_file("path", path)
    figure.savefig(path, dpi=130)
    return path
