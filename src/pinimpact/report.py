"""Impacts and runs in words and tables, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from .contacts import Contact
from .trajectory import ImpactRecord, Trajectory

CAUSES = ("compression", "restitution", "friction", "surface")


def impact_report(model: pin.Model, contact: Contact, hit: ImpactRecord) -> RenderableType:
    """Return an impact as tables: velocities before and after, segments, impulse, energy, effects."""
    solution = hit.solution
    before = np.asarray(hit.problem.velocity)
    heading = (
        f"{contact.label}: friction {contact.friction:g}, restitution {hit.problem.restitution:g} "
        f"({contact.law}), at t = {hit.time:.4f} s"
    )
    return Group(
        Text(heading, style="bold"),
        _columns(
            "Contact velocity [m/s]",
            ("", "before", "after"),
            zip(("t₁", "t₂", "n"), before, solution.velocity, strict=True),
        ),
        _columns(
            "Joint velocities [rad/s or m/s]",
            ("", "before", "after"),
            zip(velocity_names(model), hit.v_before, hit.v_after, strict=True),
        ),
        _segments(hit),
        _columns("Impulse on the robot, world axes [N s]", ("x", "y", "z"), [tuple(hit.impulse_world)]),
        _energy(model, hit),
        Text("Effects computed: " + (", ".join(solution.effects) or "none")),
        *(Text(sentence) for sentence in (str(solution.status), *solution.flags.describe())),
    )


def run_report(trajectory: Trajectory) -> RenderableType:
    """Return a run as tables: its impacts, its modes, its energy, and how it ended."""
    table = Table("t [s]", "contact or limit", "approach [m/s]", "impulse [N s]", "loss [J]", "special")
    table.title = f"{len(trajectory.impacts)} impacts" + (
        "" if len(trajectory.impacts) <= 40 else ", first and last 20"
    )
    listed = list(trajectory.impacts)
    for hit in listed if len(listed) <= 40 else listed[:20] + listed[-20:]:
        marks = [word for word, on in (("resting", hit.resting), ("simultaneous", hit.simultaneous)) if on]
        table.add_row(
            f"{hit.time:.6f}",
            hit.source,
            _number(-float(np.asarray(hit.problem.velocity)[2])),
            _number(float(np.linalg.norm(hit.solution.impulse))),
            _number(-hit.solution.work.total),
            ", ".join([*marks, *(e for e in hit.solution.effects if e in ("stick", "resumed slip", "jam"))]),
        )
    modes = Table("contact, limit or joint", "mode", "from [s]", "to [s]", title="Sustained contact")
    for interval in trajectory.modes[-40:]:
        modes.add_row(interval.source, interval.mode, f"{interval.start:.6f}", f"{interval.end:.6f}")
    energy = trajectory.energy
    sums = [("kinetic and potential, change", energy.total[-1] - energy.total[0])]
    sums += [
        (f"work of {name}", getattr(energy, name)[-1])
        for name in ("control", "joints", "friction", "surface", "impacts")
    ]
    sums.append(("not accounted for", energy.residual[-1]))
    return Group(
        table,
        modes if trajectory.modes else Text("No contact was sustained."),
        _columns("Energy over the run [J]", ("", "J"), sums),
        *(Text(f"t = {note.time:.4f} s: {note.text}") for note in trajectory.notes[:20]),
        *([Text("Switched off: " + ", ".join(trajectory.switched_off))] if trajectory.switched_off else []),
        Text(f"Ended at t = {trajectory.t[-1]:.4f} s: {trajectory.termination}", style="bold"),
    )


def velocity_names(model: pin.Model) -> Iterator[str]:
    """Yield a name for each velocity: its joint's, numbered where the joint has several."""
    for joint in range(1, model.njoints):
        count = model.nvs[joint]
        for k in range(count):
            yield model.names[joint] + (f"[{k}]" if count > 1 else "")


def _segments(hit: ImpactRecord) -> Table:
    table = Table("mode", "phase", "P₃ from", Text("to [N s]"), title=Text("Segments"), title_justify="left")
    for segment in hit.solution.segments:
        table.add_row(segment.mode, segment.phase, f"{segment.start:.6f}", f"{segment.end:.6f}")
    return table


def _energy(model: pin.Model, hit: ImpactRecord) -> Table:
    data = model.createData()
    mass = pin.crba(model, data, hit.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    kinetic = [0.5 * float(v @ mass @ v) for v in (hit.v_before, hit.v_after)]
    work = hit.solution.work
    rows: list[tuple[Any, ...]] = [("kinetic energy before", kinetic[0])]
    rows += [(cause, getattr(work, cause)) for cause in CAUSES if cause != "surface" or work.surface != 0.0]
    rows += [("sum of the works", work.total), ("kinetic energy after", kinetic[1])]
    return _columns("Energy [J]", ("", "J"), rows)


def _columns(title: str, head: tuple[str, ...], rows: Any) -> Table:
    table = Table(title=Text(title), title_justify="left")
    for name in head:
        table.add_column(Text(name), justify="left" if not name else "right")
    for row in rows:
        table.add_row(*(cell if isinstance(cell, str) else _number(cell) for cell in row))
    return table


def _number(value: ArrayLike) -> str:
    return (
        f"{float(value):+.6f}" if 1e-4 <= abs(float(value)) < 1e5 or value == 0.0 else f"{float(value):+.4e}"
    )  # type: ignore[arg-type]
