"""Rims in a motion: one that comes to lie flat stops it, for it touches all round."""

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
from ._kernels.tolerances import NEARLY_SINGULAR
from .dynamics import SceneDynamics
from .hybrid_state import HybridState


class Rims:
    """The rims of a motion."""

    def __init__(self, model: pin.Model, data: Any, dynamics: SceneDynamics, state: HybridState) -> None:
        self._model, self._data, self._dynamics, self._state = model, data, dynamics, state
        self._rims = [k for k, contact in enumerate(dynamics.contacts) if contact.rim > 0.0]

    def jump(self, q: Array, later: Array) -> bool:
        """Whether the lowest point of a closed rim goes round by a right angle or more from q to another.

        It does where the rim has come to lie flat and goes on beyond, however short the step is.
        """
        closed = [k for k in self._rims if self._dynamics.work.modes[k] != FREE]
        if not closed:
            return False
        tilts = [self._tilts(closed, at) for at in (q, later)]
        return any(float(one @ other) <= 0.0 for one, other in zip(*tilts, strict=True))

    def refuse_flat(self) -> None:
        """Stop where a closed rim has come to lie flat, as nearly as steps can tell.

        Raises:
            SimulationError: See above.
        """
        closed = [k for k in self._rims if self._dynamics.work.modes[k] != FREE]
        self._refuse_flat(closed, NEARLY_SINGULAR)

    def check(self, where: Integers) -> None:
        """Stop where a rim touches all round, within the tolerance of touching."""
        touching = [k for k in self._rims if where[k] != APART]
        self._refuse_flat(touching, 0.0)

    def _refuse_flat(self, rims: list[int], least: float) -> None:
        """Stop where a rim lies flat, or the sine of its tilt is below `least`."""
        for k, tilt in zip(rims, self._tilts(rims, self._state.q), strict=True):
            contact, size = self._dynamics.contacts[k], float(np.linalg.norm(tilt))
            if 2.0 * contact.rim * size <= self._dynamics.work.touching_gap or size < least:
                raise SimulationError(
                    f"contacts: at t = {self._state.t:.6g} s {flat_rim(contact)}", value=contact
                )

    def _tilts(self, rims: list[int], q: Array) -> list[Array]:
        """Return u × n (3,) of rims, see `tilt_of_rim`."""
        if not rims:
            return []
        placed = PlacedRobot(self._model, self._data, q)
        return [tilt_of_rim(placed, self._dynamics.contacts[k]) for k in rims]
