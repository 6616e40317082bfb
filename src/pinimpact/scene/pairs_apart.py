"""Which pairs of shapes provably stay apart over a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .._numeric.jit import compile_all
from ..robot.names import motion_signs
from ..robot.pinocchio_bridge import robot_dynamics
from ..robot.shape_pair import ShapePair
from ._kernels.pair_bounds import bends, separations
from .dense_step import DenseStep

Array = NDArray[np.float64]

ROUNDING = 1e-8
"""Part of a pair's size by which it has to stay apart."""

PIECES = 8
"""Parts of a step, at most, over which the direction known is tried; a power of two."""

SHORTEST = 1.0 / 65.0
"""Part of a step below which conservative advancement goes on."""


class PairsApart:
    """What is known of each pair: a direction along which it is apart, and how its points move in a step.

    Along a fixed direction the distance σ of two vertices has a bounded second derivative, so over a step of
    length h it is at least min(σ₀, σ₁) − β h²/8, and so is the least of them. (15.8)

    Attributes:
        bends: (p,) what the acceleration of a point against one of the other shape does not exceed over the
            step last looked at [m/s²].

    Args:
        model: The robot.
        pairs: The pairs.
    """

    def __init__(self, model: pin.Model, pairs: Sequence[ShapePair]) -> None:
        compile_all((separations,), (bends,))
        self._dynamics = robot_dynamics(model)
        count = len(pairs)
        sides = [side for pair in pairs for side in (pair.a, pair.b)]
        placed = [
            side.shape.vertices @ side.in_joint.rotation.T + side.in_joint.translation for side in sides
        ]
        last = np.cumsum([len(vertices) for vertices in placed])
        self._vertices = np.concatenate(placed)
        self._ranges = np.column_stack([np.concatenate([[0], last[1:-1:2]]), last[::2], last[1::2]])
        self._joints = np.array([side.joint for side in sides], dtype=np.int64).reshape(count, 2)
        self._radii = np.array([pair.a.shape.radius + pair.b.shape.radius for pair in pairs])
        self._centers = np.array([side.in_joint.act(side.shape.center) for side in sides])
        self._reaches = np.array([side.shape.reach for side in sides]).reshape(count, 2)
        self._moves = np.array([motion_signs(model, side.joint, 0) != 0.0 for side in sides], dtype=np.int64)
        self._least = ROUNDING * self._reaches.sum(axis=1)
        self._directions = np.zeros((count, 3))
        self.bends = np.zeros(count)

    def take_over(self, other: PairsApart) -> None:
        """Become what is known of the same pairs elsewhere."""
        self._directions[:] = other._directions

    def over(self, step: DenseStep, peak: Array) -> NDArray[np.bool_]:
        """Return (p,) whether each pair stays apart over a step, along the direction last known.

        Args:
            step: The step.
            peak: (2, nv) what |v| and |v̇| do not exceed in it.
        """
        dynamics, every = self._dynamics, slice(None)
        at_end = self._separations(every, step, step.start + step.h)
        dynamics.q[:] = step.q
        dynamics.forward_dynamics.function(*dynamics.forward_dynamics.arguments)
        bends(
            dynamics.placements,
            self._joints,
            dynamics.joint_jacobian,
            self._centers,
            self._reaches,
            self._moves,
            peak,
            step.h,
            self.bends,
        )
        found = [self._separations(every, step, step.start), at_end]
        while True:
            pieces = len(found) - 1
            sagging = 0.125 * (step.h / pieces) ** 2 * self.bends
            apart: NDArray[np.bool_] = np.min(found, axis=0) - sagging > self._least
            if pieces == PIECES or apart.all():
                return apart
            between = [step.start + (k + 0.5) * step.h / pieces for k in range(pieces)]
            for k, t in reversed(list(enumerate(between, start=1))):
                found.insert(k, self._separations(every, step, t))

    def until(self, pair: int, step: DenseStep, normal: Callable[[float], Array]) -> float:
        """Return until when a pair stays apart in the step last looked at [s], as far as that is easily seen.

        Args:
            pair: Which.
            step: The step.
            normal: Returns the direction (3,) of the gap at a time.
        """
        one, t, end, width = slice(pair, pair + 1), step.start, step.start + step.h, step.h
        while t < end:
            self._directions[pair] = normal(t)
            here = self._separations(one, step, t)[0]
            while width > SHORTEST * step.h:
                later = min(t + width, end)
                least = min(here, self._separations(one, step, later)[0])
                if least - 0.125 * (later - t) ** 2 * self.bends[pair] > self._least[pair]:
                    break
                width *= 0.5
            else:
                return t
            t, width = later, 2.0 * width
        return end

    def _separations(self, which: slice, step: DenseStep, t: float) -> Array:
        """Return how far pairs are apart at a time, along the directions known [m]."""
        dynamics = self._dynamics
        dynamics.q[:], _ = step.at(t)
        dynamics.forward_kinematics.function(*dynamics.forward_kinematics.arguments)
        ranges, radii, directions = self._ranges[which], self._radii[which], self._directions[which]
        found = np.empty(len(radii))
        separations(
            dynamics.placements, self._joints[which], self._vertices, ranges, radii, directions, found
        )
        return found
