"""The record of a motion: steps, samples, impacts, events, modes and notes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..robot.forest import potential_energy
from ..robot.pinocchio_bridge import kinetic_energy
from .dense_step import DenseStep
from .mode_intervals import ModeIntervals
from .records import Energy, EventRecord, ImpactRecord, ModeInterval, Note
from .trajectory import Trajectory


class Mark(NamedTuple):
    """Length of a record, to which it can be cut.

    Attributes:
        lengths: Lengths of `Recorder.lists`.
        present: The modes at that time, see `ModeIntervals`.
    """

    lengths: tuple[int, ...]
    present: Mapping[str, tuple[str, float]]


class Recorder:
    """The record of a motion.

    Attributes:
        dense_steps, impacts, events, notes: As in the trajectory.
        samples: Time, q, v, work and impact energy of each sample.
        modes: The contact modes.
        lists: All lists of the record, of which the last one has the intervals of modes that have ended.
        bound_reached, stepping_warned: Whether a `BoundReachedWarning`, a `SteppedWarning` has been issued.
        keeps_steps: Whether time steps keep the data from which their derivatives are computed.
    """

    def __init__(self, model: pin.Model, data: Any, modes: ModeIntervals) -> None:
        self._model, self._data = model, data
        self.dense_steps: list[DenseStep] = []
        self.samples: list[tuple[float, Array, Array, Array, float]] = []
        self.impacts: list[ImpactRecord] = []
        self.events: list[EventRecord] = []
        self.notes: list[Note] = []
        self.modes = modes
        others: list[list[Any]] = [self.impacts, self.events, self.notes, modes.ended]
        self.lists: tuple[list[Any], ...] = (self.dense_steps, self.samples, *others)
        self.bound_reached = self.stepping_warned = self.keeps_steps = False

    def note_once(self, t: float, text: str) -> None:
        """Add a note at time t [s] unless the record has it."""
        if all(note.text != text for note in self.notes):
            self.notes.append(Note(t, text))

    def mark(self) -> Mark:
        """Return the present length of the record."""
        return Mark(tuple(map(len, self.lists)), self.modes.present)

    def cut(self, mark: Mark) -> None:
        """Remove all entries after a mark."""
        for rows, length in zip(self.lists, mark.lengths, strict=True):
            del rows[length:]
        self.modes.return_to(mark.present)

    def values(self) -> tuple[Any, ...]:
        """Return the contents of the record, for `restore`."""
        warned = self.bound_reached, self.stepping_warned
        return [rows.copy() for rows in self.lists], self.modes.present, warned

    def restore(self, values: tuple[Any, ...]) -> None:
        """Replace the contents by the `values` of a record of the same scene."""
        lists, present, (self.bound_reached, self.stepping_warned) = values
        for rows, others in zip(self.lists, lists, strict=True):
            rows[:] = others
        self.modes.return_to(present)

    def trajectory(self, mark: Mark, **others: Any) -> Trajectory:
        """Return the trajectory up to a mark; `others` are the remaining arguments of `Trajectory`."""
        steps, rows, impacts, events, notes, ended = (
            rows[:length] for rows, length in zip(self.lists, mark.lengths, strict=True)
        )
        t, q, v, w, impacts_work = (np.array(column) for column in zip(*rows, strict=True))
        kinetic, potential = np.empty((2, len(t)))
        for k in range(len(t)):
            kinetic[k] = kinetic_energy(self._model, self._data, q[k], v[k])
            potential[k] = potential_energy(self._model, self._data, q[k])
        present = [
            ModeInterval(source, mode, start, float(t[-1])) for source, (mode, start) in mark.present.items()
        ]
        return Trajectory(
            segments=steps,
            samples=(t, q, v),
            impacts=impacts,
            events=events,
            modes=ended + present,
            energy=Energy(kinetic, potential, w[:, 0], w[:, 1], w[:, 2], w[:, 3], impacts_work),
            notes=notes,
            **others,
        )
