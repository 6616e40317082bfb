"""Reports of impacts, runs and robots: tables for the terminal, plain data for JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..checks import counted
from ..contact_space.solution import CAUSES
from ..robot.contact import Contact
from ..robot.forest import data_of
from ..robot.names import coordinate_names
from ..robot.pinocchio_bridge import kinetic_energy
from ..scene.records import ImpactRecord, by_impact, group_notes
from ..scene.trajectory import Trajectory
from ..status import Flag

LONGEST = 40
"""Maximum number of rows of a table, unless all are requested."""
ROUNDING = 32.0 * 2.0**-52
"""Sums below this fraction of their terms are rounding errors and shown as zero."""
CONDITION = 1e3
"""Amplification of rounding errors in joint velocities by the mass matrix of a robot with many bodies."""


def impact_report(
    model: pin.Model, contact: Contact, impact: ImpactRecord, remarks: Sequence[str] = ()
) -> RenderableType:
    """Return an impact as tables: velocities before and after, segments, impulse, energy, effects."""
    solution = impact.solution
    before = np.asarray(impact.problem.velocity)
    parts = np.abs(np.asarray(impact.problem.delassus)) @ np.abs(solution.impulse)
    size = max(impact.problem.velocity_scale or 0.0, float(np.abs(before).max()))
    heading = (
        f"{contact.label}: friction {contact.friction:g}, restitution {impact.problem.restitution:g} "
        f"({contact.law}), at t = {impact.time:.4f} s"
    )
    return Group(
        Text(heading, style="bold"),
        _columns(
            "Contact velocity [m/s]",
            ("", "before", "after"),
            zip(
                ("t₁", "t₂", "n"),
                rounded(before, size),
                rounded(solution.velocity, size + float(parts.max())),
                strict=True,
            ),
        ),
        _columns(
            "Joint velocities [rad/s or m/s]",
            ("", "before", "after"),
            zip(
                coordinate_names(model)[1],
                *(rounded(v, CONDITION * float(np.abs(v).max())) for v in (impact.v_before, impact.v_after)),
                strict=True,
            ),
        ),
        _columns(
            "Segments",
            ("mode", "phase", "normal impulse from", "to [N s]"),
            [(s.mode, s.phase, f"{s.start:.6f}", f"{s.end:.6f}") for s in solution.segments],
        ),
        _columns(
            "Impulse on the robot, world axes [N s]", ("x", "y", "z"), [tuple(rounded(impact.impulse_world))]
        ),
        _energy(model, impact),
        Text("Effects computed: " + (", ".join(solution.effects) or "none")),
        *(Text(sentence) for sentence in (str(solution.status), *solution.flags.describe(), *remarks)),
    )


def impact_facts(model: pin.Model, contact: Contact, impact: ImpactRecord) -> dict[str, Any]:
    """Return the contents of `impact_report` as plain data, in SI units and contact axes t₁, t₂, n."""
    solution, work = impact.solution, impact.solution.work
    return {
        "time": impact.time,
        "law": contact.law,
        "friction": impact.problem.friction,
        "restitution": impact.problem.restitution,
        "velocity_before": np.asarray(impact.problem.velocity).tolist(),
        "velocity_after": solution.velocity.tolist(),
        "joints": list(coordinate_names(model)[1]),
        "v_before": impact.v_before.tolist(),
        "v_after": impact.v_after.tolist(),
        "impulse": solution.impulse.tolist(),
        "impulse_world": impact.impulse_world.tolist(),
        "segments": [asdict(segment) for segment in solution.segments],
        "work": {cause: getattr(work, cause) for cause in (*CAUSES, "total")},
        "effects": list(solution.effects),
        "status": solution.status.name.lower(),
        "flags": [str(flag.name).lower() for flag in Flag if flag in solution.flags and flag],
    }


def run_report(trajectory: Trajectory, every: bool = False) -> RenderableType:
    """Return a run as tables: impacts, modes, energy, notes and the end; the first rows, or `every` row."""
    impacts, modes = trajectory.impacts, trajectory.modes
    shown = None if every else LONGEST
    return Group(
        _columns(
            f"Impacts: {_counts(impacts)}" + _cut(impacts, shown),
            ("t [s]", "contact or limit", "approach [m/s]", "impulse [N s]", "energy [J]", "special"),
            [_impact_row(impact) for impact in impacts[:shown]],
        ),
        _columns(
            f"Sustained contact: {counted(len(modes), 'interval')}" + _cut(modes, shown),
            ("contact, limit or joint", "mode", "from [s]", "to [s]"),
            [(i.source, i.mode, f"{i.start:.6f}", f"{i.end:.6f}") for i in modes[:shown]],
        ),
        *_stepped(trajectory, shown),
        _columns("Energy, change over the run [J]", ("", "J"), _energy_changes(trajectory)),
        *(Text(str(note)) for note in (trajectory.notes if every else group_notes(trajectory.notes))),
        *([Text("Switched off: " + ", ".join(trajectory.switched_off))] if trajectory.switched_off else []),
        Text(f"Ended at t = {trajectory.t[-1]:.4f} s: {trajectory.termination}", style="bold"),
    )


def run_facts(trajectory: Trajectory) -> dict[str, Any]:
    """Return a run as plain data, in SI units."""

    def impact(record: ImpactRecord) -> dict[str, Any]:
        row = dict(zip(("time", "source", "approach", "impulse", "work"), _impact_row(record), strict=False))
        return row | {"time": record.time, "special": record.remarks}

    return {
        "duration": trajectory.duration,
        "complete": trajectory.complete,
        "termination": trajectory.termination,
        "impacts": [impact(record) for record in trajectory.impacts],
        "modes": [asdict(interval) for interval in trajectory.modes],
        "stepped": [asdict(interval) for interval in trajectory.stepped],
        "energy": {name: float(change) for name, change in _energy_changes(trajectory)},
        "notes": [asdict(note) for note in trajectory.notes],
        "switched_off": list(trajectory.switched_off),
        "statistics": trajectory.statistics,
    }


def robot_report(facts: dict[str, Any], every: bool = False) -> RenderableType:
    """Return `robot_facts` as tables; `every` adds a table of all frames."""
    base = "free" if facts["free_base"] else "fixed"
    heading = (
        f"{facts['robot']}: {counted(facts['nv'], 'velocity')} (nq = {facts['nq']}), {base} base, "
        f"{facts['mass']:.4g} kg; visual shapes: {facts['shapes']['visual']}"
    )

    def limits(joint: dict[str, Any]) -> tuple[str, str]:
        low, high = joint["lower"], joint["upper"]
        if len(low) != 1:
            return "", ""
        return tuple("none" if x is None else f"{x:.4g}" for x in (low[0], high[0]))  # type: ignore[return-value]

    joints = [
        (joint["name"], joint["kind"], str(joint["velocities"]), *limits(joint)) for joint in facts["joints"]
    ]
    suggested = [
        facts["frames"][key]["name"] + f" (id {key})" if isinstance(key, int) else key
        for key in facts["contact_frames"]
    ]
    at_joint = {frame["name"] for frame in facts["frames"] if not any(frame["place"])}
    at_joint &= set(facts["contact_frames"])
    parts: list[RenderableType] = [
        Text(heading, style="bold"),
        _columns(
            "Joints, with their limits [rad or m]", ("joint", "kind", "velocities", "lower", "upper"), joints
        ),
        Text("Suggested contact frames: " + (", ".join(suggested) or "none (no joint moves)")),
        Text("Collision shapes: " + (", ".join(facts["collision_shapes"]) or "none")),
    ]
    if at_joint:
        parts.append(
            Text(f"At joint origins: {', '.join(sorted(at_joint))}; offset= of a Contact moves the point.")
        )
    if every:
        rows = [(str(f["id"]), f["name"], f["joint"], f["kind"]) for f in facts["frames"]]
        parts.append(_columns("Frames", ("id", "frame", "joint", "kind"), rows))
    else:
        names = dict.fromkeys(frame["name"] for frame in facts["frames"][1:])
        parts.append(Text(f"All frames (--all for details): {', '.join(names)}"))
    return Group(*parts)


def _energy_changes(trajectory: Trajectory) -> list[tuple[Any, ...]]:
    """Return the changes of energy by cause, and the energy residual, which is not rounded."""
    *causes, residual = trajectory.energy.changes().items()
    names, values = zip(*causes, strict=True)
    changes = rounded(values, float(np.abs(trajectory.energy.total).max()))
    return [*zip(names, changes, strict=True), residual]


def _stepped(trajectory: Trajectory, shown: int | None) -> list[RenderableType]:
    """Return a table of the intervals in time steps, if there are any."""
    stepped = trajectory.stepped
    if not stepped:
        return []
    rows = [
        (f"{i.start:.6f}", f"{i.end:.6f}", f"{i.dt:.3g}", f"{i.error:.1g}", i.reason) for i in stepped[:shown]
    ]
    heading = f"Time stepping: {counted(len(stepped), 'interval')}" + _cut(stepped, shown)
    return [_columns(heading, ("from [s]", "to [s]", "step [s]", "error", "reason"), rows)]


def _counts(records: Sequence[ImpactRecord]) -> str:
    """Return the number of impacts, as a replay counts them, and that of their records if it differs."""
    count = len(by_impact(records))
    rows = "" if count == len(records) else f" ({len(records)} rows, one for each contact or limit)"
    return f"{count}{rows}"


def _cut(rows: Sequence[Any], shown: int | None) -> str:
    return f"; first {shown} rows, --all shows all" if shown is not None and len(rows) > shown else ""


def _impact_row(impact: ImpactRecord) -> tuple[Any, ...]:
    time, *others = impact.summary
    return f"{time:.6f}", *others, ", ".join(impact.remarks)


def _energy(model: pin.Model, impact: ImpactRecord) -> Table:
    data = data_of(model)
    kinetic = [kinetic_energy(model, data, impact.q, v) for v in (impact.v_before, impact.v_after)]
    work = impact.solution.work
    rows = [("kinetic energy before", kinetic[0])]
    rows += [(cause, getattr(work, cause)) for cause in CAUSES if cause != "surface" or work.surface != 0.0]
    rows += [("total work", work.total), ("kinetic energy after", kinetic[1])]
    names, values = zip(*rows, strict=True)
    return _columns("Energy [J]", ("", "J"), zip(names, rounded(values), strict=True))


def rounded(values: Any, size: float = 0.0) -> list[float]:
    """Return numbers (n,), with zero for rounding errors of the largest one, or of terms of this size."""
    numbers = np.asarray(values, dtype=float)
    least = ROUNDING * max(size, float(np.abs(numbers).max(initial=0.0)))
    return [0.0 if abs(x) <= least else x for x in numbers.tolist()]


def _columns(title: str, head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> Table:
    """Return a table; numbers are aligned to the right and not split, names are wrapped if necessary."""
    lines = [tuple(cell if isinstance(cell, str) else _number(cell) for cell in row) for row in rows]
    table = Table(
        title=Text(title), title_justify="left", min_width=min(len(title), 80)
    )  # titles are not split
    for k, name in enumerate(head):
        numbers = bool(lines) and all(_is_number(line[k]) for line in lines)
        width = max([len(line[k]) for line in lines], default=0) if numbers else None
        justify: Literal["left", "right"] = "right" if numbers else "left"
        table.add_column(Text(name), justify=justify, overflow="fold", min_width=width)
    for line in lines:
        table.add_row(*map(Text, line))
    return table


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell in ("none", "")
    return True


def _number(value: float) -> str:
    if value == 0.0:
        return "0"
    return f"{value:+.6f}" if 1e-4 <= abs(value) < 1e5 else f"{value:+.4e}"
