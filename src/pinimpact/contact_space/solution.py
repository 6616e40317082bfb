"""The result of an impact at one contact; segments and work are computed on first access."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ..checks import counted
from ..display import html_lines, html_table, in_a_line
from ..status import EFFECTS, Flag, Status
from .derivatives import Derivatives
from .inputs import NO_ROWS, Array, Inputs
from .methods import load_method


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of an impact with one contact mode in one phase; resumed slip is a separate segment.

    Attributes:
        mode: "slip" or "stick".
        phase: "compression" (v₃ < 0) or "restitution".
        start: Normal impulse P₃ at the start of the segment [N s].
        end: Normal impulse at its end [N s].
    """

    mode: Literal["slip", "stick"]
    phase: Literal["compression", "restitution"]
    start: float
    end: float


CAUSES = ("compression", "restitution", "friction", "surface")
"""The attributes of `Work`."""


@dataclass(frozen=True, slots=True)
class Work:
    """The work of an impact by cause [J]; floats, or arrays (N,) in a batch.

    Attributes:
        compression: Work of the normal impulse during compression, ≤ 0.
        restitution: Work of the normal impulse during restitution, ≥ 0.
        friction: Work of the tangential impulse on the slip velocity, ≤ 0.
        surface: P · v_surface, the work of a moving surface.
    """

    compression: Any
    restitution: Any
    friction: Any
    surface: Any

    @property
    def total(self) -> Any:
        """Sum of the four: the change of the robot's kinetic energy."""
        return self.compression + self.restitution + self.friction + self.surface


@dataclass(frozen=True, slots=True, repr=False)
class Path:
    """The recorded path of an impact.

    Attributes:
        normal_impulse: (m,) P₃, not decreasing [N s].
        velocity: (m, 3) contact velocity [m/s].
        impulse: (m, 3) contact impulse [N s].
    """

    normal_impulse: Array
    velocity: Array
    impulse: Array

    def __repr__(self) -> str:
        end = float(self.normal_impulse[-1]) if len(self.normal_impulse) else 0.0
        return f"Path({counted(len(self.normal_impulse), 'point')}, normal impulse to {end:.6g} N s)"


class Solution:
    """The result of an impact, in contact axes (t₁, t₂, n).

    It can be pickled and copied. `segments` and `work` are computed on first access, by the method that
    solved the impact; that method must then be registered.
    """

    def __init__(
        self,
        result: tuple[Any, ...],
        inputs: Inputs,
        method: str = "exact",
        options: Mapping[str, Any] | None = None,
        path: Path | None = None,
        surface_velocity: Any = (0.0, 0.0, 0.0),
    ) -> None:
        self._result = result
        self._inputs = inputs
        self._method = method
        self._options = options
        self._surface_velocity = surface_velocity
        self.part_of: Any = None
        """The `ManySolution` that this is one contact's part of, or None."""
        self.path: Path | None = path
        """The recorded `Path`, or None where ``record=True`` was not asked for."""
        self.derivatives: Derivatives | None = None
        """The `Derivatives`, or None where ``derivatives=True`` was not asked for."""

    @cached_property
    def velocity(self) -> Array:
        """(3,) post-impact contact velocity [m/s]."""
        return np.array(self._result[3:6])

    @cached_property
    def impulse(self) -> Array:
        """(3,) impulse on the robot [N s]."""
        return np.array(self._result[6:9])

    @property
    def compression_impulse(self) -> float:
        """Normal impulse of all phases of compression [N s]."""
        return float(self._result[9])

    @property
    def status(self) -> Status:
        """Why the impact ended."""
        return Status(self._result[0])

    @property
    def flags(self) -> Flag:
        """Special events of the impact."""
        return Flag(self._result[1])

    @property
    def iterations(self) -> int:
        """Number of steps of the method."""
        return int(self._result[2])

    @cached_property
    def _rows(self) -> Array:
        from ._kernels.recording import TRACE_ROWS

        rows = np.empty((TRACE_ROWS, 6))
        run = load_method(self._method)
        return rows[: run(self._inputs, rows, NO_ROWS, **(self._options or {}))[11]]

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """The `Segment`s of the impact in order; empty if there was no impact."""
        modes: tuple[Literal["slip", "stick"], ...] = ("slip", "stick", "slip")  # the last: resumed
        phases: tuple[Literal["compression", "restitution"], ...] = ("compression", "restitution")
        return tuple(
            Segment(modes[int(row[0])], phases[int(row[1])], float(row[2]), float(row[3]))
            for row in self._rows
        )

    @cached_property
    def work(self) -> Work:
        """The `Work` of the impact [J]."""
        rows = self._rows
        restoring = rows[:, 1] == 1.0
        return Work(
            compression=float(rows[~restoring, 4].sum()),
            restitution=float(rows[restoring, 4].sum()),
            friction=float(rows[:, 5].sum()),
            surface=float(self.impulse @ np.asarray(self._surface_velocity, dtype=float)),
        )

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that occurred, with names of `pinimpact.EFFECTS`."""
        flags = self.flags
        _, _, w13, _, w23, _, _, _, _, mu, e, _, _, _ = self._inputs
        impact = self.status != Status.NO_IMPACT
        computed = (
            mu > 0.0 and impact,
            e > 0.0 and impact,
            (w13 != 0.0 or w23 != 0.0) and impact,
            Flag.SLIP_TURNED in flags,
            Flag.STICK in flags,
            Flag.SLIP_RESUMED in flags,
            Flag.JAM in flags,
            Flag.SECOND_COMPRESSION in flags,
            self.path is not None,
        )
        return tuple(name for name, present in zip(EFFECTS, computed, strict=True) if present)

    def _repr_html_(self) -> str:
        work = self.work
        causes = [(cause, getattr(work, cause)) for cause in (*CAUSES, "total")]
        return (
            html_table(
                "Impact, in contact axes",
                ("", "t₁", "t₂", "n"),
                [
                    ("velocity before [m/s]", *self._inputs[6:9]),
                    ("velocity after [m/s]", *self.velocity.tolist()),
                    ("impulse [N s]", *self.impulse.tolist()),
                ],
            )
            + html_table(
                "Segments",
                ("mode", "phase", "P₃ from", "to [N s]"),
                [(s.mode, s.phase, s.start, s.end) for s in self.segments],
            )
            + html_table("Work [J]", ("", ""), causes)
            + html_lines([str(self.status), *self.flags.describe()])
        )

    def __repr__(self) -> str:
        return (
            f"Solution(velocity={in_a_line(self.velocity)}, impulse={in_a_line(self.impulse)}, "
            f"status={self.status.name}, flags={self.flags.names() or 'NONE'})"
        )
