"""The mass matrix of a time step, with the terms of damping and drives. (theory.md, 16.1)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..errors import IrregularMotionError
from ..robot.forest import has_constant_mass, mass_matrix
from ._kernels.step_impulses import invert_trees
from ._kernels.workspace import SceneWorkspace


def diverged(t: float) -> IrregularMotionError:
    """Return the error of velocities or coordinates that overflow at a time t [s]."""
    return IrregularMotionError(
        f"scene: the velocities are not finite at t = {t:.6g} s; the control may be unstable, "
        "for instance with gains that are too high for its period"
    )


class Terms(NamedTuple):
    """Terms of damping and drives, see `StepSystem`; each (nv,)."""

    softened: Array
    damping: Array
    theta: Array


class StepMass:
    """M and its inverse with terms added to its diagonal.

    Args:
        model: The model.
        data: Its data.
        work: The workspace, with the damping of joints and drives.
        tree: (nv,) number of the tree that each velocity belongs to.

    Attributes:
        matrix, inverse: (nv, nv) M with the terms last added, and its inverse.
    """

    def __init__(self, model: pin.Model, data: pin.Data, work: SceneWorkspace, tree: Integers) -> None:
        self._model, self._data, self._work, self._tree = model, data, work, tree
        self.matrix, self.inverse = np.zeros((2, model.nv, model.nv))
        self._constant, self._added = has_constant_mass(model, data), np.full(model.nv, math.nan)

    def compute(self, t: float, q: Array, h: float) -> Terms:
        """Compute M at q (nq,) with the terms of a step of size h [s] from t [s].

        Velocities whose damping would make them alternate in sign get θ = 1.

        Raises:
            IrregularMotionError: M is not finite.
        """
        work = self._work
        damping, sprung, theta = h * work.damping, np.zeros(work.nv), np.full(work.nv, 0.5)
        if work.driven > 0:
            follows = work.drive_side == 0
            damping = damping + np.where(follows, h * work.drive_damping, 0.0)
            sprung = np.where(follows, 0.25 * h * h * work.drive_stiffness, 0.0)
        damped = np.flatnonzero(damping)
        root = np.sqrt(damping[damped])
        while True:
            softened = theta * damping + sprung
            self.invert(t, q, softened)
            part = np.abs(self.inverse[np.ix_(damped, damped)])
            alternate = damped[(theta[damped] < 1.0) & (root * (part @ root) > 1.0)]
            if not len(alternate):
                return Terms(softened, damping, theta)
            theta[alternate] = 1.0

    def invert(self, t: float, q: Array, added: Array) -> None:
        """Compute M at q (nq,) plus diag(`added`), and its inverse, unless both are unchanged.

        Raises:
            IrregularMotionError: M is not finite.
        """
        if self._constant and np.array_equal(added, self._added):
            return
        self._added = added
        upper = mass_matrix(self._model, self._data, q)
        if not invert_trees(upper, added, self._tree, self.matrix, self.inverse):
            raise diverged(t)
