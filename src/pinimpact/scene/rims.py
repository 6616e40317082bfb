"""Rims of a motion: tilted, each touches at its lowest point; flat, at the points of its circle. (15.1)"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Integers
from ..errors import SimulationError
from ..geometry._kernels.constants import ABSENT, KIND
from ..robot.contact import RIM_POINTS
from ..robot.touching import flat_rim
from ._kernels.approach import APART, ARRIVING
from ._kernels.contact_forces import FREE
from ._kernels.rim_location import rims_at
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .event_watch import crossing
from .hybrid_state import HybridState

SAGITTA = 1.0 - math.cos(math.pi / RIM_POINTS)
"""Largest distance of a rim from the polygon of its points, relative to its radius."""

PASSES = 2.0
"""Time steps: a rim lies flat if its tilt is less than this multiple of its change in the step: it may then
pass through zero."""


class Tilting(NamedTuple):
    """A rim that lies flat begins to tilt.

    Attributes:
        time: The time [s].
        rim: Number of the rim.
    """

    time: float
    rim: int


class Rims:
    """The contacts of a motion that are rims, and the contacts at points of their circles.

    Of each rim, either the contact at its lowest point is in the workspace or, while it lies flat, those at
    the points of its circle; `HybridState.flat` lists the rims that lie flat.
    """

    def __init__(self, dynamics: SceneDynamics, state: HybridState) -> None:
        self._dynamics, self._state, self._work = dynamics, state, dynamics.work
        every, work = dynamics.contacts, self._work
        self._rims = np.array([k for k, one in enumerate(every) if one.rim > 0.0], dtype=np.int64)
        self._points = {
            k: [i for i, one in enumerate(every) if one.of_rim == every[k].label] for k in self._rims.tolist()
        }
        self._radii = np.array([every[k].rim for k in self._rims])
        self._constants, self._joints = work.contact_constants.copy(), work.contact_joints.copy()
        self.place()

    def __bool__(self) -> bool:
        """Whether there are any."""
        return len(self._rims) > 0

    def place(self) -> None:
        """Set the contacts in the workspace by the rims that lie flat."""
        work, replaced = self._work, {rim: points for rim, points in self._points.items() if points}
        every = [i for rim, points in replaced.items() for i in (rim, *points)]
        absent = [i for k, points in replaced.items() for i in ([k] if k in self._state.flat else points)]
        work.contact_constants[every], work.contact_joints[every] = (
            self._constants[every],
            self._joints[every],
        )
        work.contact_constants[absent, KIND], work.contact_joints[absent] = ABSENT, 0
        work.modes[absent] = FREE

    def _change(self, flat: Iterable[int]) -> None:
        """Set which rims lie flat.

        Raises:
            SimulationError: A held rim, which has no other contact than its lowest point.
        """
        chosen = frozenset(flat)
        for rim in chosen:
            if not self._points[rim]:
                contact = self._dynamics.contacts[rim]
                raise SimulationError(
                    f"contacts: at t = {self._state.t:.6g} s {flat_rim(contact)}", value=contact
                )
        self._state.flat = chosen
        present = self._rims[self._work.contact_constants[self._rims, KIND] == ABSENT]
        if chosen != frozenset(present.tolist()):
            self.place()

    def _motion(self, q: Array, v: Array) -> Array:
        """Return the motion (k, 8) of all rims at a state, see `rims_at`."""
        found = np.empty((len(self._rims), 8))
        rims_at(self._work, q, v, self._constants[self._rims], self._joints[self._rims], found)
        self._dynamics.check()
        return found

    def _tilts(self, q: Array, v: Array) -> Array:
        """Return u × n (k, 3) of all rims, whose lengths are the sines of their tilts."""
        return self._motion(q, v)[:, 2:5]

    # ---- event-driven steps

    def lie_down(self, where: Integers) -> bool:
        """Replace the touching rims that lie flat by their points, and return whether there are any.

        `where` (n + nl,) is the state of the contacts and limits, see `approach`; it is updated.
        """
        parallel = self._flat(self._state.q, self._state.v)
        flat = [k for k in parallel if where[k] != APART or not self._points[k]]
        self._change(self._state.flat.union(flat))
        for k in flat:
            where[self._points[k]] = ARRIVING
            where[k] = APART
        return bool(flat)

    def _flat(self, q: Array, v: Array) -> list[int]:
        """Return the numbers of the rims that are parallel to their planes, within the tolerance of gaps."""
        heights = 2.0 * self._radii * np.linalg.norm(self._tilts(q, v), axis=1)
        return self._rims[heights <= self._work.drift_tolerance].tolist()

    def active(self) -> list[int]:
        """Return the numbers of the rims whose lowest points are in contact."""
        return [k for k in self._rims.tolist() if self._work.modes[k] != FREE]

    def fallen(self) -> list[int]:
        """Return the numbers of the active rims that have become flat."""
        active = self.active()
        if not active:
            return []
        flat = self._flat(self._state.q, self._state.v)
        return [k for k in active if k in flat]

    def turn(self) -> float:
        """Return the part of the present step to take instead, as an active rim passes through flat; 1: all.

        It is the part after which the rim would be flat within the tolerance if its tilt changed at a
        constant rate, and one half of a step over which the lowest point turns by a right angle or more.
        """
        work = self._work
        active = work.modes[self._rims] != FREE
        if not active.any():
            return 1.0
        before, after = self._tilts(work.q0, work.v0)[active], self._tilts(work.q1, work.v1)[active]
        along, size = (before * after).sum(axis=1), np.linalg.norm(before, axis=1)
        turned = along <= 0.0
        if not turned.any():
            return 1.0
        short = size - 0.25 * work.drift_tolerance / self._radii[active]
        part = float((short * size / (size * size - along))[turned].min())
        return part if part < 0.9 else 0.5

    def tilting(self, step: DenseStep, end: float) -> Tilting | None:
        """Return where the first flat rim tilts by more than the tolerance in a step up to a time [s]."""
        flat = np.isin(self._rims, list(self._state.flat))
        limits, found = self._work.drift_tolerance / (SAGITTA * self._radii), None

        def left(t: float) -> Array:
            return np.asarray(limits - np.linalg.norm(self._tilts(*step.at(t)), axis=1))

        for row in np.flatnonzero(flat & (left(end) <= 0.0)).tolist():

            def of_rim(t: float, row: int = row) -> float:
                return float(left(t)[row])

            time = crossing(of_rim, step.start, end, step.h)
            if found is None or time < found.time:
                found = Tilting(time, int(self._rims[row]))
        return found

    def stand_up(self, rim: int) -> list[int] | None:
        """Replace the points of a rim by its lowest point; return its number if any of them was active."""
        active = (self._work.modes[self._points[rim]] != FREE).any()
        self._change(self._state.flat - {rim})
        return [rim] if active else None

    # ---- time steps

    def choose(self, q: Array, v: Array, h: float, touching: float) -> None:
        """Set which rims lie flat in a time step: those whose tilt may pass through zero.

        Args:
            q: (nq,) configuration at the midpoint.
            v: (nv,) velocity.
            h: Step size [s].
            touching: Gap up to which contacts are closed [m].
        """
        motion = self._motion(q, v)
        tilt, rate = (np.linalg.norm(motion[:, part], axis=1) for part in (slice(2, 5), slice(5, 8)))
        flat = (tilt <= PASSES * h * rate) | (2.0 * self._radii * tilt <= touching)
        self._change(self._rims[flat].tolist())
