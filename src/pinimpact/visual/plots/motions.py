"""Plots of a motion over time: gaps, modes, forces, energy, and all of them one above the other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ...arrays import Array
from ...errors import InputError
from ...robot.forest import data_of
from ...robot.names import model_of
from ...scene.trajectory import Trajectory
from ..shapes_in_contact import contacts_to_draw
from .style import (
    BLACK,
    COMPRESSION,
    CYCLE,
    FLOW,
    GREEN,
    RESTITUTION,
    RESUMED,
    SKY,
    STICK,
    axes_for,
    legend,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


POINTS = 800
"""Minimum number of points over a motion."""
WORKS = (("control", RESTITUTION), ("joints", SKY), ("friction", RESUMED), ("surface", GREEN))
MODES = {
    "slip": COMPRESSION,
    "stick": STICK,
    "held": GREEN,
    "closed": RESTITUTION,
    "stuck": SKY,
    "saturated": RESUMED,
}
"""Colours of the modes of `ModeInterval`."""


def gaps(trajectory: Trajectory, robot: pin.RobotWrapper | pin.Model, *, ax: Axes | None = None) -> Axes:
    """Draw the gaps of the trajectory's contacts over time.

    Args:
        trajectory: The motion.
        robot: The robot, or its model.
        ax: Axes to draw into.

    Raises:
        InputError: A trajectory without contacts.
        UnknownNameError: A robot without a contact's frame.
    """
    if not trajectory.contacts:
        raise InputError("trajectory: it has no contacts, so there are no gaps to draw")
    model = model_of(robot)
    ax = axes_for(ax, (8.0, 3.0))
    times, sides = moments(trajectory)
    states = [trajectory.at(t, side)[0] for t, side in zip(times, sides, strict=True)]
    data = data_of(model)
    for k, contact in enumerate(contacts_to_draw(trajectory, trajectory.contacts)):
        values = [contact.gap(model, data, q) for q in states]
        ax.plot(times, values, color=CYCLE[k % len(CYCLE)], ls=_dash(k), label=plain(contact.label))
    ax.axhline(0.0, color=BLACK, lw=0.5)
    _over_time(ax, trajectory, "gap [m]")
    return ax


def modes(trajectory: Trajectory, *, ax: Axes | None = None) -> Axes:
    """Draw the modes of each contact, joint limit, joint and drive over time, and the impacts."""
    drawn = contacts_to_draw(trajectory, trajectory.contacts)
    names = list(dict.fromkeys([*(c.label for c in drawn), *_active(trajectory)]))
    ax = axes_for(ax, (8.0, 1.2 + 0.3 * len(names)))
    for interval in trajectory.modes:
        row, width = names.index(interval.source), interval.end - interval.start
        ax.barh(row, width, 0.7, interval.start, color=MODES[interval.mode], label=interval.mode)
    for impact in trajectory.impacts:
        ax.plot(impact.time, names.index(impact.source), "|", color=BLACK, ms=11, mew=0.9, label="impact")
    ax.set_yticks(range(len(names)), [plain(name) for name in names])
    ax.set_ylim(len(names) - 0.4, -0.6)
    _over_time(ax, trajectory, "", lines=False)
    return ax


def forces(trajectory: Trajectory, contact: str, *, ax: Axes | None = None) -> Axes:
    """Draw the normal and the tangential force of a sustained contact over time; slip is shaded.

    Impulses of impacts are not included; thin lines mark their times.

    Args:
        trajectory: The motion.
        contact: Name of the contact.
        ax: Axes to draw into.

    Raises:
        UnknownNameError: A contact that the scene does not have.
    """
    times, sides = moments(trajectory)
    found = np.array(
        [trajectory.forces(contact, t, side) for t, side in zip(times.tolist(), sides, strict=True)]
    )
    ax = axes_for(ax, (8.0, 3.0))
    ax.plot(times, found[:, 2], color=BLACK, lw=1.4, label="normal")
    ax.plot(times, np.hypot(found[:, 0], found[:, 1]), color=RESTITUTION, lw=1.4, label="friction")
    for interval in trajectory.modes:
        if interval.source == contact and interval.mode == "slip":
            ax.axvspan(interval.start, interval.end, color=COMPRESSION, alpha=0.2, lw=0.0, label="slip")
    _over_time(ax, trajectory, f"{plain(contact)}\n[N]", contact)
    return ax


def energy(trajectory: Trajectory, *, ax: Axes | None = None) -> Axes:
    """Draw the change of kinetic plus potential energy over time, and the work of each cause.

    Work is integrated with the motion and known between samples. The energy differs from the sum of the work
    by the energy residual, which is interpolated between samples.
    """
    ax = axes_for(ax, (8.0, 4.0))
    times, sides = moments(trajectory)
    works = np.array([trajectory.work_at(t, side) for t, side in zip(times.tolist(), sides, strict=True)])
    last = np.searchsorted(trajectory.t, times, side="right") - 1
    first = np.maximum(np.searchsorted(trajectory.t, times, side="left") - 1, 0)
    before = np.array([side == "left" for side in sides])
    since = np.where(before, first, last)
    until = np.minimum(since + 1, len(trajectory.t) - 1)
    length = trajectory.t[until] - trajectory.t[since]
    part = np.divide(times - trajectory.t[since], length, out=np.zeros_like(times), where=length > 0.0)
    impacts, residual = trajectory.energy.impacts[since], trajectory.energy.residual
    total = works.sum(axis=1) + impacts + residual[since] + part * (residual[until] - residual[since])
    ax.plot(times, total, color=BLACK, lw=2.2, label="kinetic + potential")
    for k, (name, color) in enumerate(WORKS):
        if np.any(works[:, k]):
            ax.plot(times, works[:, k], "--", color=color, label=f"work of {name}")
    if np.any(impacts):
        ax.plot(times, impacts, "-.", color=COMPRESSION, label="impacts")
    ax.axhline(0.0, color=BLACK, lw=0.5, zorder=0)
    _over_time(ax, trajectory, "change of energy [J]")
    return ax


def overview(
    trajectory: Trajectory, robot: pin.RobotWrapper | pin.Model, *, ax: Sequence[Axes] | None = None
) -> Any:
    """Draw gaps, modes, normal forces and energy over time, one above the other.

    Args:
        trajectory: The motion.
        robot: The robot, or its model.
        ax: Four axes to draw into.

    Returns:
        The four axes, from the top.

    Raises:
        InputError: Another number of axes; the errors of `gaps` and `forces`.
    """
    if ax is None:
        from matplotlib import pyplot

        count = len(
            {c.label for c in contacts_to_draw(trajectory, trajectory.contacts)} | set(_active(trajectory))
        )
        heights = (2.2, 0.8 + 0.28 * count, 2.2, 2.4)
        figure = pyplot.figure(figsize=(9.0, sum(heights) + 0.6), layout="constrained")
        ax = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    if len(ax) != 4:
        raise InputError(f"ax: {len(ax)} axes given, 4 expected", value=ax)
    gaps(trajectory, robot, ax=ax[0])
    modes(trajectory, ax=ax[1])
    times, sides = moments(trajectory)
    for k, contact in enumerate(contacts_to_draw(trajectory, trajectory.contacts)):
        found = [
            trajectory.forces(contact.label, t, side)[2]
            for t, side in zip(times.tolist(), sides, strict=True)
        ]
        ax[2].plot(times, found, color=CYCLE[k % len(CYCLE)], ls=_dash(k), label=plain(contact.label))
    _over_time(ax[2], trajectory, "normal force [N]")
    energy(trajectory, ax=ax[3])
    for above in ax[:3]:
        above.set_xlabel("")
    return ax


def moments(trajectory: Trajectory) -> tuple[Array, list[Any]]:
    """Return times at which to draw, with their sides: points in each step, and its ends from within."""
    edges = np.unique(trajectory.t)
    if len(edges) == 1:
        return edges, ["right"]
    inside = max(2, -(-POINTS // (len(edges) - 1)) + 1)
    pieces = [np.linspace(a, b, inside) for a, b in pairwise(edges)]
    return np.concatenate(pieces), (["right"] * (inside - 1) + ["left"]) * len(pieces)


def _active(trajectory: Trajectory) -> list[str]:
    return [*(interval.source for interval in trajectory.modes), *(i.source for i in trajectory.impacts)]


def _dash(k: int) -> str:
    return ("-", "--", "-.", ":")[k // len(CYCLE) % 4]


def _over_time(
    ax: Axes, trajectory: Trajectory, label: str, contact: str | None = None, lines: bool = True
) -> None:
    """Mark impacts (of one contact, or all), and label the axes."""
    for impact in trajectory.impacts if lines else ():
        if contact in (None, impact.source):
            ax.axvline(impact.time, color=FLOW, lw=0.6, zorder=0, label="impact")
    ax.set(
        xlabel="t [s]",
        ylabel=label,
        xlim=(trajectory.t[0], trajectory.t[-1]) if trajectory.duration else None,
    )
    legend(ax)
