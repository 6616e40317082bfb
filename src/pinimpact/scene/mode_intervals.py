"""Intervals of the contact modes of contacts, joint limits and joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from ..arrays import Integers
from ..robot.names import joint_of_velocity
from ._kernels.contact_forces import HELD, SLIP, STICK
from .records import ModeInterval

MODES = {SLIP: "slip", STICK: "stick", HELD: "held"}
"""Names of the modes of an active contact."""


class ModeIntervals:
    """The mode intervals of a run.

    Args:
        model: The model.
        contacts, limits: Names of the contacts and limits, in the order of the modes.

    Attributes:
        ended: Intervals that have ended, in order of their ends.
        present: Present mode of each contact, limit or joint that is not free, and its start [s]; the mapping
            is replaced, never changed in place.
    """

    def __init__(self, model: pin.Model, contacts: Sequence[str], limits: Sequence[str]) -> None:
        self.ended: list[ModeInterval] = []
        self.present: Mapping[str, tuple[str, float]] = {}
        self._model = model
        self._contacts = len(contacts)
        self._names = [*contacts, *limits]
        self._joints: dict[int, str] = {}
        self._drives: dict[int, str] = {}
        self._named = np.zeros(len(self._names), dtype=np.int64)
        self._others: bytes | None = None  # unknown: the next update compares all modes

    def update(self, t: float, modes: Integers, sides: Integers) -> None:
        """Set the modes from a time on: end the intervals of modes that change, and begin new ones.

        Args:
            t: Time [s].
            modes: (n + nl + nv,) modes of contacts, limits and joints.
            sides: (nv,) nonzero for drives at their effort limits.
        """
        others = modes[len(self._names) :].tobytes() + sides.tobytes()
        named = modes[: len(self._names)]
        if others == self._others:
            changed = np.flatnonzero(named != self._named).tolist()
            if changed:
                self._change(t, changed, named)
            return
        self._named, self._others = named.copy(), others
        active = np.flatnonzero(modes)
        now = dict(
            self._names_of(i, mode) for i, mode in zip(active.tolist(), modes[active].tolist(), strict=True)
        )
        now |= {self._drive(j): "saturated" for j, side in enumerate(sides.tolist()) if side}
        lasting = {}
        for source, (mode, start) in self.present.items():
            if now.get(source) == mode:
                lasting[source] = mode, start
            elif t > start:
                self.ended.append(ModeInterval(source, mode, start, t))
        self.present = lasting | {source: (mode, t) for source, mode in now.items() if source not in lasting}

    def _change(self, t: float, changed: list[int], named: Integers) -> None:
        """Set the modes (n + nl,) of contacts and limits from t [s] on; those in `changed` differ."""
        present = dict(self.present)
        for i in changed:
            source, mode = self._names[i], int(named[i])
            before = present.pop(source, None)
            if before is not None and t > before[1]:
                self.ended.append(ModeInterval(source, before[0], before[1], t))
            if mode:
                present[source] = self._names_of(i, mode)[1], t
        self.present, self._named = present, named.copy()

    def return_to(self, present: Mapping[str, tuple[str, float]]) -> None:
        """Restore an earlier `present`."""
        self.present, self._others = present, None

    def _drive(self, velocity: int) -> str:
        """Return the name of a drive."""
        if velocity not in self._drives:
            self._drives[velocity] = drive_name(self._model, velocity)
        return self._drives[velocity]

    def _names_of(self, i: int, mode: int) -> tuple[str, str]:
        """Return the names of a source and of its mode."""
        if i < self._contacts:
            return self._names[i], MODES[mode]
        if i < len(self._names):
            return self._names[i], "closed"
        velocity = i - len(self._names)
        if velocity not in self._joints:
            self._joints[velocity] = joint_of_velocity(self._model, velocity)
        return self._joints[velocity], "stuck"


def drive_name(model: pin.Model, velocity: int) -> str:
    """Return the name of the drive of a joint, by the index of its velocity."""
    return f"{joint_of_velocity(model, velocity)} drive"
