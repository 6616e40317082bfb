"""The contact-space problem: nine numbers of a contact, its friction and its restitution law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, UnknownNameError
from .outcome import LAWS


@dataclass(frozen=True, slots=True, eq=False)
class ImpactProblem:
    """One frictional impact in contact axes (t₁, t₂, n); knows nothing of robots.

    Inputs are checked where they are used, in `solve_impact`.

    Attributes:
        delassus: (3, 3) inverse inertia W felt at the contact [1/kg], symmetric positive semidefinite.
        velocity: (3,) pre-impact contact velocity v relative to the surface [m/s].
        friction: Coulomb coefficient μ ≥ 0.
        restitution: Coefficient 0 ≤ e ≤ 1 of the law.
        law: ``"poisson"``, ``"energetic"`` or ``"newton"``.
        surface_velocity: (3,) velocity of the surface at the contact point [m/s]; only the work
            ``solution.work.surface`` depends on it.
    """

    delassus: ArrayLike
    velocity: ArrayLike
    friction: float
    restitution: float
    law: str = "poisson"
    surface_velocity: ArrayLike = (0.0, 0.0, 0.0)


def law_code(law: str) -> int:
    """Return the kernels' code of a law, or raise `UnknownNameError`."""
    try:
        return LAWS.index(law)
    except ValueError:
        raise UnknownNameError(
            f"law: {law!r} is not a restitution law; the laws are {', '.join(map(repr, LAWS))}",
            field="law",
            value=law,
        ) from None


def float_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return `value` as a contiguous float64 array of `shape`, or raise `InputError` naming `field`."""
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"{field}: {value!r} is not an array of numbers; an array of shape {shape} is expected",
            field=field,
            value=value,
        ) from None
    if array.shape != shape:
        raise InputError(f"{field}: shape {array.shape} given, {shape} expected", field=field, value=value)
    return array


def finite_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Like `float_array`, and refuse NaN and infinity."""
    array = float_array(field, value, shape)
    if not np.isfinite(array).all():
        raise InputError(
            f"{field}: {array.tolist()} holds numbers that are not finite", field=field, value=value
        )
    return array
