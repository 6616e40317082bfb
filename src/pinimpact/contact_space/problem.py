"""The contact-space problem: nine numbers of a contact, its friction and its restitution law."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from ..errors import UnknownNameError
from ..status import LAWS


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
