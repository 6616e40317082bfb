"""What there is to tell of a motion: steps, samples, impacts, events, modes and notes."""

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
    """How far a record had come.

    Attributes:
        lengths: Of `Recorder.lists`.
        present: The modes then, see `ModeIntervals`.
    """

    lengths: tuple[int, ...]
    present: Mapping[str, tuple[str, float]]


class Recorder:
    """The record of a motion.

    Attributes:
        dense_steps, impacts, events, notes: As in the trajectory.
        samples: Time, q, v, works and impact energy of each sample.
        modes: The modes of contact.
        bound_reached, stepping_warned: Whether a `BoundReachedWarning`, a `SteppedWarning` has been given.
        keeps_steps: Whether what time steps are computed from is kept, for their derivatives.
    """

    def __init__(self, model: pin.Model, data: Any, modes: ModeIntervals) -> None:
        self._model, self._data = model, data
        self.dense_steps: list[DenseStep] = []
        self.samples: list[tuple[float, Array, Array, Array, float]] = []
        self.impacts: list[ImpactRecord] = []
        self.events: list[EventRecord] = []
        self.notes: list[Note] = []
        self.modes = modes
        self.bound_reached = self.stepping_warned = self.keeps_steps = False

    @property
    def lists(self) -> tuple[list[Any], ...]:
        """All that grows: steps, samples, impacts, events, notes, modes that have ended."""
        return self.dense_steps, self.samples, self.impacts, self.events, self.notes, self.modes.ended

    def mark(self) -> Mark:
        """Return how far the record has come."""
        return Mark(tuple(map(len, self.lists)), self.modes.present)

    def cut(self, mark: Mark) -> None:
        """Return to where the record had come."""
        for rows, length in zip(self.lists, mark.lengths, strict=True):
            del rows[length:]
        self.modes.return_to(mark.present)

    def values(self) -> tuple[Any, ...]:
        """Return all that is recorded."""
        warned = self.bound_reached, self.stepping_warned
        return [rows.copy() for rows in self.lists], self.modes.present, warned

    def take(self, values: tuple[Any, ...]) -> None:
        """Take `values` of another record of the same scene."""
        lists, present, (self.bound_reached, self.stepping_warned) = values
        for rows, others in zip(self.lists, lists, strict=True):
            rows[:] = others
        self.modes.return_to(present)

    def trajectory(self, mark: Mark, **told: Any) -> Trajectory:
        """Return the motion until a mark; `told` is what else a `Trajectory` takes."""
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
            **told,
        )
