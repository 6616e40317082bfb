"""Which pairs of shapes provably stay apart over a step."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from .._compile.jit import compile_all
from ..arrays import Array, Bools
from ..robot._kernels.python_calls import raise_kept_error
from ..robot.contact import Contact
from ..robot.pinocchio_bridge import call_addresses
from ._kernels.pair_bounds import stay_apart, turn_to_gaps
from .dense_step import DenseStep
from .layout import SceneLayout


@functools.cache
def _compile() -> None:
    compile_all((stay_apart,), (turn_to_gaps,))


class PairsApart:
    """What is known of each pair: a direction along which it is apart, and how its points move in a step.

    Along a fixed direction the distance σ of two vertices has a bounded second derivative, so over a step of
    length h it is at least min(σ₀, σ₁) − β h²/8, and so is the least of them. (15.8)

    Attributes:
        directions: (p, 3) the direction of each pair: all that a copy of the motion needs of this object.
        bends: (p,) what the acceleration of a point against one of the other shape does not exceed over the
            step last looked at [m/s²].
    """

    def __init__(self, model: pin.Model, layout: SceneLayout, pairs: Sequence[Contact]) -> None:
        _compile()
        self._dynamics = layout.dynamics_for(self, model)
        self._tables = layout.pair_tables(tuple(pairs))
        self._calls = call_addresses([self._dynamics.forward_kinematics, self._dynamics.forward_dynamics])
        self.directions = np.tile([0.0, 0.0, 1.0], (len(pairs), 1))
        self.bends = np.zeros(len(pairs))

    def at(self, q: Array) -> Array:
        """Return (p,) by what each pair is apart at a configuration, at the least [m]."""
        robot, tables = self._dynamics, self._tables
        robot.q[:] = q
        found = np.empty(len(self.bends))
        went_well = turn_to_gaps(
            *(self._calls, robot.placements, tables.joints, tables.vertices, tables.ranges),
            *(tables.radii, self.directions, np.ones(len(found), dtype=np.bool_), found),
        )
        if not went_well:
            raise_kept_error()
        return found

    def over(self, step: DenseStep, peak: Array) -> Bools:
        """Return (p,) whether each pair stays apart over a step, along the direction last known.

        In it |v| and |v̇| do not exceed `peak` (2, nv).
        """
        robot, tables = self._dynamics, self._tables
        apart = np.zeros(len(self.bends), dtype=np.bool_)
        went_well = stay_apart(
            *(self._calls, robot.q, robot.placements, robot.joint_jacobian, tables.joints, tables.vertices),
            *(tables.ranges, tables.radii, tables.centers, tables.reaches, tables.moves, tables.least),
            *(self.directions, step.coefficients, step.joints, step.q, step.v, peak, step.h),
            *(self.bends, apart),
        )
        if not went_well:
            raise_kept_error()
        return apart
