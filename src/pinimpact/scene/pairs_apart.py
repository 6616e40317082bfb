"""Which pairs of shapes provably stay apart over a step."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .._numeric.jit import compile_all
from ..robot._kernels.python_calls import raise_kept_error
from ..robot.contact import Contact
from ..robot.pinocchio_bridge import call_addresses
from ._kernels.pair_bounds import bends, separations
from .dense_step import DenseStep
from .layout import SceneLayout

Array = NDArray[np.float64]

PIECES = 8
"""Parts of a step, at most, over which the direction known is tried; a power of two."""

SHORTEST = 1.0 / 65.0
"""Part of a step below which conservative advancement goes on."""

_EVERY = slice(None)
_ONE, _FIRST = np.ones(1, dtype=np.bool_), np.zeros(1, dtype=np.int64)


def _samples(rows: range) -> tuple[Array, NDArray[np.int64]]:
    return np.array(rows) / PIECES, np.array(rows, dtype=np.int64)


_BETWEEN = [_samples(range(0, PIECES + 1, PIECES))]
"""Fractions of a step, its ends first, then what halves its pieces; and their places among all."""
_BETWEEN += [
    _samples(range(k // 2, PIECES, k)) for k in (PIECES >> n for n in range(PIECES.bit_length() - 1))
]


@functools.cache
def _compile() -> None:
    compile_all((separations,), (bends,))


class PairsApart:
    """What is known of each pair: a direction along which it is apart, and how its points move in a step.

    Along a fixed direction the distance σ of two vertices has a bounded second derivative, so over a step of
    length h it is at least min(σ₀, σ₁) − β h²/8, and so is the least of them. (15.8)

    Attributes:
        bends: (p,) what the acceleration of a point against one of the other shape does not exceed over the
            step last looked at [m/s²].

    Args:
        model: The robot.
        layout: Of the scene.
        pairs: The contacts of two shapes.
    """

    def __init__(self, model: pin.Model, layout: SceneLayout, pairs: Sequence[Contact]) -> None:
        _compile()
        self._dynamics = layout.dynamics_for(self, model)
        self._tables = layout.pair_tables(tuple(pairs))
        self._calls = call_addresses([self._dynamics.forward_kinematics])
        self._directions = np.zeros((len(pairs), 3))
        self.bends = np.zeros(len(pairs))

    def take_over(self, other: PairsApart) -> None:
        """Become what is known of the same pairs elsewhere."""
        self._directions[:] = other._directions

    def over(self, step: DenseStep, peak: Array) -> NDArray[np.bool_]:
        """Return (p,) whether each pair stays apart over a step, along the direction last known.

        Args:
            step: The step.
            peak: (2, nv) what |v| and |v̇| do not exceed in it.
        """
        dynamics, tables = self._dynamics, self._tables
        found = np.full((PIECES + 1, len(self.bends)), np.inf)
        apart = np.zeros(len(self.bends), dtype=np.bool_)
        self._separations(_EVERY, step, *_BETWEEN[0], ~apart, found)
        dynamics.q[:] = step.q
        dynamics.forward_dynamics.function(*dynamics.forward_dynamics.arguments)
        bends(
            dynamics.placements,
            tables.joints,
            dynamics.joint_jacobian,
            tables.centers,
            tables.reaches,
            tables.moves,
            peak,
            step.h,
            self.bends,
        )
        stride = PIECES
        for between in _BETWEEN[1:]:
            sagging = 0.125 * (step.h * stride / PIECES) ** 2 * self.bends
            apart |= found[::stride].min(axis=0) - sagging > tables.least
            if apart.all():
                return apart
            self._separations(_EVERY, step, *between, ~apart, found)
            stride //= 2
        sagging = 0.125 * (step.h / PIECES) ** 2 * self.bends
        apart |= found.min(axis=0) - sagging > tables.least
        return apart

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
            here = self._separation(one, step, t)
            while width > SHORTEST * step.h:
                later = min(t + width, end)
                least = min(here, self._separation(one, step, later))
                if least - 0.125 * (later - t) ** 2 * self.bends[pair] > self._tables.least[pair]:
                    break
                width *= 0.5
            else:
                return t
            t, width = later, 2.0 * width
        return end

    def _separation(self, one: slice, step: DenseStep, t: float) -> float:
        """Return how far a pair is apart at a time, along the direction known [m]."""
        found = np.empty((1, 1))
        self._separations(one, step, np.array([(t - step.start) / step.h]), _FIRST, _ONE, found)
        return float(found[0, 0])

    def _separations(
        self,
        which: slice,
        step: DenseStep,
        fractions: Array,
        rows: NDArray[np.int64],
        wanted: NDArray[np.bool_],
        found: Array,
    ) -> None:
        """Fill rows of `found` with how far pairs are apart at fractions of a step; see `separations`."""
        dynamics, tables = self._dynamics, self._tables
        went_well = separations(
            *(self._calls, dynamics.q, dynamics.placements, tables.joints[which], tables.vertices),
            *(tables.ranges[which], tables.radii[which], self._directions[which]),
            *(step.coefficients, step.joints, step.q, step.v, fractions, wanted, rows, found),
        )
        if not went_well:
            raise_kept_error()
