"""The energy of a scene, and the check that a time step adds none. (theory.md, 16.1)"""

from __future__ import annotations

import pinocchio as pin

from ..arrays import Array
from ..robot.forest import has_constant_mass, potential_energy
from ..robot.pinocchio_bridge import kinetic_energy
from .dense_step import DenseStep

GAINED = 0.01
"""Largest energy that the error of a step may add, relative to the kinetic energy at its end: the energy of a
body that turns by a fifth of a radian in a step is as inaccurate."""


class StepEnergy:
    """Energies at states, and energy balance of steps.

    Args:
        model: The model.
        data: Its data.
        resting_speed: Speed of a body at rest [m/s], whose energy is neglected.
    """

    def __init__(self, model: pin.Model, data: pin.Data, resting_speed: float) -> None:
        self._model, self._data = model, data
        self._constant = has_constant_mass(model, data)
        self._negligible = 0.5 * pin.computeTotalMass(model) * resting_speed**2

    def kinetic(self, q: Array, v: Array) -> float:
        """Return the kinetic energy [J] at q (nq,) and v (nv,)."""
        return kinetic_energy(self._model, self._data, q, v)

    def potential(self, q: Array) -> float:
        """Return the potential energy [J] at q (nq,)."""
        return potential_energy(self._model, self._data, q)

    def is_gained(self, step: DenseStep, lost: float) -> bool:
        """Return whether the error of a step adds energy; never where M is constant.

        Args:
            step: The step.
            lost: Change of energy by normal impulses in it [J].
        """
        if self._constant:
            return False
        q, v = step.at(step.end)
        kinetic = self.kinetic(q, v)
        change = kinetic - self.kinetic(step.q, step.v) + self.potential(q) - self.potential(step.q)
        control, joints, friction, surface = (step.work_at(step.end) - step.w).tolist()
        by_forces = control + min(joints, 0.0) + min(friction, 0.0) + surface + lost  # damping adds nothing
        return bool(change - by_forces > GAINED * kinetic + self._negligible)
