"""Batches of impacts at one contact."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .._compile.threads import in_threads, thread_count
from ..arrays import Integers
from ..checks import real_numbers
from ..errors import InputError
from ..status import Status
from .derivatives import Derivatives, empty_results, named_derivatives
from .inputs import FACTOR, Array
from .laws import law_code
from .solution import Work


class BatchSolution:
    """The results of N impact problems, row by row, in contact axes.

    Attributes:
        velocity: (N, 3) post-impact contact velocities [m/s].
        impulse: (N, 3) impulses on the robot [N s].
        compression_impulse: (N,) normal impulses of compression [N s].
        status: (N,) integer values of `Status`; rows without a solution are NaN.
        flags: (N,) integer values of `Flag`.
        iterations: (N,) numbers of steps.
        derivatives: `Derivatives` with a first axis (N,), or None without ``derivatives=True``.
    """

    def __init__(
        self,
        inputs: tuple[Array, Array, Array, Array, int, Array, Array],
        threads: int,
        work: bool = False,
        derivatives: bool = False,
    ) -> None:
        self._inputs = inputs
        self._threads = threads
        self._works: Array | None = None
        self.derivatives: Derivatives | None = None
        if derivatives:
            numbers, codes = self._differentiate()
        else:
            numbers, codes, works = self._solve(work)
            self._works = works if work else None
        self.velocity = numbers[:, 0:3]
        self.impulse = numbers[:, 3:6]
        self.compression_impulse = numbers[:, 6]
        self.status = codes[:, 0]
        self.flags = codes[:, 1]
        self.iterations = codes[:, 2]

    def _solve(self, work: bool) -> tuple[Array, Integers, Array]:
        from ._kernels.batch import solve_rows

        count = len(self._inputs[1])
        numbers, codes = np.empty((count, 7)), np.empty((count, 3), dtype=np.int64)
        works = np.empty((count if work else 0, 3))
        self._fill(solve_rows, numbers, codes, works)
        return numbers, codes, works

    def _differentiate(self) -> tuple[Array, Integers]:
        from ._kernels.derivatives import differentiate_rows

        numbers, codes, slopes, boundaries = results = empty_results(len(self._inputs[1]))
        self._fill(differentiate_rows, *results)
        self.derivatives = named_derivatives(slopes, boundaries)
        return numbers, codes

    def _fill(self, kernel: Callable[..., None], *results: Array | Integers) -> None:
        """Fill the rows of `results` by a kernel, in threads."""
        matrices, velocities, mu, e, law, scales, factors = self._inputs

        def fill(rows: slice) -> None:
            given = matrices[rows], velocities[rows], mu[rows], e[rows], law, scales[rows], factors[rows]
            kernel(*given, *(part[rows] for part in results))

        in_threads(fill, len(velocities), self._threads)

    @cached_property
    def work(self) -> Work:
        """The `Work` of the rows, arrays (N,) [J], for surfaces at rest; computed on first access."""
        works = self._solve(True)[2] if self._works is None else self._works
        return Work(works[:, 0], works[:, 1], works[:, 2], np.zeros(len(works)))

    def __len__(self) -> int:
        return len(self.velocity)

    def __repr__(self) -> str:
        return (
            f"BatchSolution({len(self)} impact{'' if len(self) == 1 else 's'}: {status_counts(self.status)})"
        )


def status_counts(status: Integers) -> str:
    """Return the number of rows of each status, as "990 SEPARATED, 10 NO_IMPACT"."""
    values, counts = np.unique(status, return_counts=True)
    counted = zip(values.tolist(), counts.tolist(), strict=True)
    return ", ".join(f"{count} {Status(value).name}" for value, count in counted)


def solve_impacts(
    delassus: ArrayLike,
    velocity: ArrayLike,
    friction: ArrayLike,
    restitution: ArrayLike,
    law: str = "poisson",
    velocity_scale: ArrayLike | None = None,
    threads: int = 1,
    work: bool = False,
    derivatives: bool = False,
) -> BatchSolution:
    """Solve N frictional impacts with the method "exact".

    Args:
        delassus: (N, 3, 3) inverse inertias W [1/kg], computed in double precision, or (3, 3) for all rows.
        velocity: (N, 3) pre-impact contact velocities [m/s], or (3,) for all rows.
        friction: Coefficient μ, a number or (N,).
        restitution: Coefficient e, a number or (N,).
        law: The restitution law of all rows.
        velocity_scale: Sizes of the terms that the velocities are the sum of, a number or (N,); see
            `ImpactProblem`.
        threads: Number of threads. The results do not depend on it.
        work: Whether to compute the work at once; otherwise it is computed on first access, by solving again.
        derivatives: Whether to compute ``batch.derivatives``; rows without a solution are NaN.

    Returns:
        A `BatchSolution`. A row with invalid numbers has its status and NaN, and does not affect other rows.

    Raises:
        InputError: Shapes that do not match, or an invalid number of threads.
        UnknownNameError: Unknown law.
    """
    matrices = np.ascontiguousarray(real_numbers("delassus", delassus))
    velocities = np.ascontiguousarray(real_numbers("velocity", velocity))
    if velocities.ndim not in (1, 2) or velocities.shape[-1] != 3:
        raise InputError(f"velocity: shape {velocities.shape} given, (N, 3) or (3,) expected", value=velocity)
    lengths = [len(a) for a, once in ((velocities, 1), (matrices, 2)) if a.ndim > once]
    scale = 0.0 if velocity_scale is None else velocity_scale
    named = {"friction": friction, "restitution": restitution, "velocity_scale": scale}
    numbers = {name: real_numbers(name, value) for name, value in named.items()}
    lengths += [len(a) for a in numbers.values() if a.ndim == 1]
    count = lengths[0] if lengths else 1
    if velocities.ndim == 1:
        velocities = np.tile(velocities, (count, 1))
    if matrices.shape == (3, 3):
        matrices = np.tile(matrices, (count, 1, 1))
    if matrices.shape != (count, 3, 3):
        raise InputError(
            f"delassus: shape {matrices.shape} given, ({count}, 3, 3) expected to match velocity",
            value=delassus,
        )
    coefficients = []
    for name, array in numbers.items():
        if array.shape not in ((), (count,)):
            raise InputError(
                f"{name}: shape {array.shape} given, a number or ({count},) expected", value=named[name]
            )
        coefficients.append(np.array(np.broadcast_to(array, (count,))))
    mu, e, scales = coefficients
    none = np.empty((0, FACTOR))
    inputs = matrices, velocities, mu, e, law_code(law), scales, none
    return BatchSolution(inputs, thread_count(threads), work, derivatives)


def solve_factored(
    delassus: Array,
    velocity: Array,
    mu: Array,
    e: Array,
    law: str,
    scales: Array,
    factors: Array,
    threads: int = 1,
    work: bool = False,
) -> BatchSolution:
    """Solve N problems like `solve_impacts`, from arrays (N, …) with factors (N, FACTOR) of W."""
    # strided views are copied, or the kernel would be compiled for them too
    w, v, mu, e, scales = map(np.ascontiguousarray, (delassus, velocity, mu, e, scales))
    return BatchSolution((w, v, mu, e, law_code(law), scales, factors), threads, work)
