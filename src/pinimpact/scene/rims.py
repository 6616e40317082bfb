"""Contacts that are rims. A rim that lies flat touches along the whole circle, which raises an error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..errors import SimulationError
from ..robot.placed_robot import PlacedRobot
from ..robot.touching import flat_rim, tilt_of_rim
from ._kernels.approach import APART
from ._kernels.contact_forces import FREE
from ._kernels.step_rows import StepResult, StepRows
from ._kernels.tolerances import NEARLY_SINGULAR
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .hybrid_state import HybridState


class Rims:
    """The rims of a motion; checks raise a `SimulationError` if one lies flat."""

    def __init__(self, model: pin.Model, data: Any, dynamics: SceneDynamics, state: HybridState) -> None:
        self._model, self._data, self._dynamics, self._state = model, data, dynamics, state
        self._rims = [k for k, contact in enumerate(dynamics.contacts) if contact.rim > 0.0]

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._rims)

    def jump(self, q: Array, later: Array) -> bool:
        """Whether the lowest point of an active rim turns by a right angle or more from q to `later`.

        However short the step is, it does if the rim passes through a flat position.
        """
        closed = [k for k in self._rims if self._dynamics.work.modes[k] != FREE]
        if not closed:
            return False
        tilts = [self._tilts(closed, at) for at in (q, later)]
        return any(float(one @ other) <= 0.0 for one, other in zip(*tilts, strict=True))

    def refuse_flat(self) -> None:
        """Check that no active rim lies flat, within the resolution of steps."""
        closed = [k for k in self._rims if self._dynamics.work.modes[k] != FREE]
        self._refuse_flat(closed, self._dynamics.work.touching_gap, NEARLY_SINGULAR)

    def check(self, where: Integers, touching: float) -> None:
        """Check that no touching rim touches along its whole circle, to a distance [m]."""
        self._refuse_flat([k for k in self._rims if where[k] != APART], touching, 0.0)

    def check_step(self, rows: StepRows, found: StepResult, step: DenseStep) -> None:
        """Check that no rim with an impulse in a time step lies flat in it: its lowest point would jump."""
        if not self._rims:
            return
        pressed = rows.contacts[found.impulse[rows.normals[: len(rows.contacts)]] > 0.0]
        rims = [k for k in self._rims if k in pressed]
        tilts = [self._tilts(rims, at) for at in (step.q, step.at(step.end)[0])]
        for k, one, other in zip(rims, *tilts, strict=True):
            if float(one @ other) <= 0.0:
                self._refuse(k)

    def _refuse_flat(self, rims: list[int], touching: float, least: float) -> None:
        """Check that no whole rim is within a distance [m], and no sine of a tilt below `least`."""
        for k, tilt in zip(rims, self._tilts(rims, self._state.q), strict=True):
            size = float(np.linalg.norm(tilt))
            if 2.0 * self._dynamics.contacts[k].rim * size <= touching or size < least:
                self._refuse(k)

    def _refuse(self, rim: int) -> None:
        contact = self._dynamics.contacts[rim]
        raise SimulationError(f"contacts: at t = {self._state.t:.6g} s {flat_rim(contact)}", value=contact)

    def _tilts(self, rims: list[int], q: Array) -> list[Array]:
        """Return u × n (3,) for each rim, see `tilt_of_rim`."""
        if not rims:
            return []
        placed = PlacedRobot(self._model, self._data, q)
        return [tilt_of_rim(placed, self._dynamics.contacts[k]) for k in rims]
