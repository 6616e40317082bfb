"""Impacts and runs in words and tables, for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..robot.contact import Contact
from ..scene.records import ImpactRecord
from ..scene.trajectory import Trajectory

CAUSES = ("compression", "restitution", "friction", "surface")
WORKS = ("control", "joints", "friction", "surface", "impacts")
LONGEST = 40
"""Rows that a table shows at most."""


def impact_report(model: pin.Model, contact: Contact, impact: ImpactRecord) -> RenderableType:
    """Return an impact as tables: velocities before and after, segments, impulse, energy, effects."""
    solution = impact.solution
    before = np.asarray(impact.problem.velocity)
    heading = (
        f"{contact.label}: friction {contact.friction:g}, restitution {impact.problem.restitution:g} "
        f"({contact.law}), at t = {impact.time:.4f} s"
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
            zip(velocity_names(model), impact.v_before, impact.v_after, strict=True),
        ),
        _columns(
            "Segments",
            ("mode", "phase", "P₃ from", "to [N s]"),
            [(s.mode, s.phase, f"{s.start:.6f}", f"{s.end:.6f}") for s in solution.segments],
        ),
        _columns("Impulse on the robot, world axes [N s]", ("x", "y", "z"), [tuple(impact.impulse_world)]),
        _energy(model, impact),
        Text("Effects computed: " + (", ".join(solution.effects) or "none")),
        *(Text(sentence) for sentence in (str(solution.status), *solution.flags.describe())),
    )


def run_report(trajectory: Trajectory) -> RenderableType:
    """Return a run as tables: its impacts, its modes, its energy, and how it ended."""
    energy = trajectory.energy
    changes: list[tuple[Any, ...]] = [("kinetic and potential", energy.total[-1] - energy.total[0])]
    changes += [(f"work of {name}", getattr(energy, name)[-1]) for name in WORKS]
    changes.append(("not accounted for", energy.residual[-1]))
    return Group(
        _columns(
            f"Impacts: {len(trajectory.impacts)}" + _cut(trajectory.impacts),
            ("t [s]", "contact or limit", "approach [m/s]", "impulse [N s]", "energy [J]", "special"),
            [_impact_row(impact) for impact in trajectory.impacts[:LONGEST]],
        ),
        _columns(
            f"Sustained contact: {len(trajectory.modes)}" + _cut(trajectory.modes),
            ("contact, limit or joint", "mode", "from [s]", "to [s]"),
            [(i.source, i.mode, f"{i.start:.6f}", f"{i.end:.6f}") for i in trajectory.modes[:LONGEST]],
        ),
        _columns("Energy, change over the run [J]", ("", "J"), changes),
        *(Text(f"t = {note.time:.4f} s: {note.text}") for note in trajectory.notes[:LONGEST]),
        *([Text("Switched off: " + ", ".join(trajectory.switched_off))] if trajectory.switched_off else []),
        Text(f"Ended at t = {trajectory.t[-1]:.4f} s: {trajectory.termination}", style="bold"),
    )


def _cut(rows: Sequence[Any]) -> str:
    return f", the first {LONGEST}" if len(rows) > LONGEST else ""


def _impact_row(impact: ImpactRecord) -> tuple[Any, ...]:
    special = [
        word for word, on in (("resting", impact.resting), ("simultaneous", impact.simultaneous)) if on
    ]
    special += [effect for effect in ("stick", "resumed slip", "jam") if effect in impact.solution.effects]
    return (
        f"{impact.time:.6f}",
        impact.source,
        -float(np.asarray(impact.problem.velocity)[2]),
        float(np.linalg.norm(impact.solution.impulse)),
        impact.solution.work.total,
        ", ".join(special),
    )


def velocity_names(model: pin.Model) -> Iterator[str]:
    """Yield a name for each velocity: its joint's, numbered where the joint has several."""
    for joint in range(1, model.njoints):
        count = model.nvs[joint]
        for k in range(count):
            yield model.names[joint] + (f"[{k}]" if count > 1 else "")


def _energy(model: pin.Model, impact: ImpactRecord) -> Table:
    data = model.createData()
    mass = pin.crba(model, data, impact.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    kinetic = [0.5 * float(v @ mass @ v) for v in (impact.v_before, impact.v_after)]
    work = impact.solution.work
    rows: list[tuple[Any, ...]] = [("kinetic energy before", kinetic[0])]
    rows += [(cause, getattr(work, cause)) for cause in CAUSES if cause != "surface" or work.surface != 0.0]
    rows += [("sum of the works", work.total), ("kinetic energy after", kinetic[1])]
    return _columns("Energy [J]", ("", "J"), rows)


def _columns(title: str, head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> Table:
    """Return a table; cells are names, or numbers to be set to the right."""
    table = Table(title=Text(title), title_justify="left", min_width=min(len(title), 80))  # titles stay whole
    for name in head:
        table.add_column(Text(name))
    for row in rows:
        table.add_row(*(Text(c) if isinstance(c, str) else Text(_number(c), justify="right") for c in row))
    return table


def _number(value: float) -> str:
    return f"{value:+.6f}" if value == 0.0 or 1e-4 <= abs(value) < 1e5 else f"{value:+.4e}"
