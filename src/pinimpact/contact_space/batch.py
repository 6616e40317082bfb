"""Many impacts at once."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .inputs import Array
from .laws import law_code
from .solution import Work


class BatchSolution:
    """The answers to N impact problems, row by row, in contact axes.

    Attributes:
        velocity: (N, 3) post-impact contact velocities [m/s].
        impulse: (N, 3) impulses on the robot [N s].
        compression_impulse: (N,) normal impulses of compression [N s].
        status: (N,) integer values of `Status`; a row without answer holds NaN.
        flags: (N,) integer values of `Flag`.
        iterations: (N,) steps taken.
    """

    def __init__(self, inputs: tuple[Array, Array, Array, Array, int, Array]) -> None:
        self._inputs = inputs
        numbers, codes, _ = self._solve(0)
        self.velocity = numbers[:, 0:3]
        self.impulse = numbers[:, 3:6]
        self.compression_impulse = numbers[:, 6]
        self.status = codes[:, 0]
        self.flags = codes[:, 1]
        self.iterations = codes[:, 2]

    def _solve(self, works: int) -> tuple[Array, NDArray[np.int64], Array]:
        from ._kernels.batch import solve_rows

        count = len(self._inputs[1])
        result = np.empty((count, 7)), np.empty((count, 3), dtype=np.int64), np.empty((works, 3))
        solve_rows(*self._inputs, *result)
        return result

    @cached_property
    def work(self) -> Work:
        """The `Work` ledgers, arrays (N,) [J]; computed on first access. Surfaces at rest."""
        works = self._solve(len(self._inputs[1]))[2]
        return Work(works[:, 0], works[:, 1], works[:, 2], np.zeros(len(works)))

    def __len__(self) -> int:
        return len(self.velocity)


def solve_impacts(
    delassus: ArrayLike,
    velocity: ArrayLike,
    friction: ArrayLike,
    restitution: ArrayLike,
    law: str = "poisson",
    velocity_scale: ArrayLike | None = None,
) -> BatchSolution:
    """Resolve N frictional impacts with the method "exact".

    Args:
        delassus: (N, 3, 3) inverse inertias W [1/kg], formed in double precision.
        velocity: (N, 3) pre-impact contact velocities [m/s].
        friction: Coefficient μ, a number or (N,).
        restitution: Coefficient e, a number or (N,).
        law: The restitution law of all of them.
        velocity_scale: Sizes of the numbers that the velocities were formed from, a number or (N,); see
            `ImpactProblem`.

    Returns:
        A `BatchSolution`. A row whose numbers are unusable gets its status and NaN, and spoils no other.

    Raises:
        InputError: Shapes that do not fit.
        UnknownNameError: No such law.
    """
    matrices = _numbers("delassus", delassus)
    velocities = _numbers("velocity", velocity)
    if velocities.ndim != 2 or velocities.shape[1] != 3:
        raise InputError(
            f"velocity: shape {velocities.shape} given, (N, 3) expected", field="velocity", value=velocity
        )
    count = len(velocities)
    if matrices.shape != (count, 3, 3):
        raise InputError(
            f"delassus: shape {matrices.shape} given, ({count}, 3, 3) expected to match velocity",
            field="delassus",
            value=delassus,
        )
    coefficients = []
    scale = 0.0 if velocity_scale is None else velocity_scale
    for name, value in (("friction", friction), ("restitution", restitution), ("velocity_scale", scale)):
        array = _numbers(name, value)
        if array.shape not in ((), (count,)):
            raise InputError(
                f"{name}: shape {array.shape} given, a number or ({count},) expected", field=name, value=value
            )
        coefficients.append(np.ascontiguousarray(np.broadcast_to(array, (count,))))
    mu, e, scales = coefficients
    return BatchSolution((matrices, velocities, mu, e, law_code(law), scales))


def _numbers(field: str, value: ArrayLike) -> Array:
    try:
        if value is None:  # which NumPy takes for NaN
            raise TypeError
        return np.asarray(value, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise InputError(f"{field}: {value!r} is not an array of numbers", field=field, value=value) from None
