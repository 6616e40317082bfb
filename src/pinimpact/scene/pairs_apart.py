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
    """Separating directions of p pairs of convex shapes.

    Along a fixed direction the distance of two vertices has a bounded second derivative. Over a step of size
    h it is at least min(σ₀, σ₁) − β h²/8, and so is the gap along that direction. (15.8)

    Attributes:
        directions: (p, 3) separating direction of each pair: the only state of this object.
        bends: (p,) bound of the relative acceleration of two points of each pair in the last step [m/s²].
    """

    def __init__(self, model: pin.Model, layout: SceneLayout, pairs: Sequence[Contact]) -> None:
        _compile()
        self._dynamics = layout.dynamics_for(self, model)
        self._tables = layout.pair_tables(tuple(pairs))
        self._calls = call_addresses([self._dynamics.forward_kinematics, self._dynamics.forward_dynamics])
        self.directions = np.tile([0.0, 0.0, 1.0], (len(pairs), 1))
        self.bends = np.zeros(len(pairs))

    def at(self, q: Array) -> Array:
        """Return (p,) lower bounds of the gaps at a configuration [m], and update the directions."""
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
        """Return (p,) whether each pair provably stays apart over a step, along its direction.

        Args:
            step: The step.
            peak: (2, nv) bounds of |v| and |v̇| in it.
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
