"""The contact-space problem and the checks of its values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._numeric.tolerances import HALF_DIGITS
from ..checks import at_least_zero, finite_array, float_array, real_number
from ..display import short_repr
from ..errors import InputError
from .inputs import NO_FACTOR, Array, Inputs
from .laws import law_code

ZERO = 32.0 * 2.0**-52
"""Asymmetry of W, relative to its largest entry, that is taken as rounding; also for its eigenvalues."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ImpactProblem:
    """A frictional impact in contact axes (t₁, t₂, n), without a robot.

    For one contact the shapes are those below. For n contacts at one instant the velocity is (n, 3) and W is
    (3n, 3n); coefficients are numbers or arrays (n,). `solve_impact` checks the values.

    Attributes:
        delassus: (3, 3) inverse inertia W at the contact [1/kg], symmetric positive semidefinite, computed in
            double precision.
        velocity: (3,) pre-impact contact velocity v relative to the surface [m/s].
        friction: Coulomb coefficient μ ≥ 0.
        restitution: Coefficient of restitution, 0 ≤ e ≤ 1.
        law: One of `pinimpact.LAWS`.
        surface_velocity: (3,) velocity of the surface at the contact point [m/s]; only the work
            ``solution.work.surface`` depends on it.
        velocity_scale: Size of the terms that v is the sum of [m/s]; for a robot Σ|J||q̇| + |v_surface|.
            Components of v that W cannot produce are zero within 32 ε of it. None: |v₁| + |v₂| + |v₃|.
        factor: (3, m) X with W = XXᵀ; for a robot J L⁻¹ with M = LᵀL. It has the small eigenvalues and the
            null space of W to twice as many digits, and is used if W is nearly singular. None: not known.
        factor_scale: Size of the terms that the factor is the sum of; entries within 4 ε of it are taken as
            zero. None: eight times the size of the factor.
        stiffness: For n contacts, (n,) or a number > 0; only ratios matter. None: equal.
    """

    delassus: ArrayLike
    velocity: ArrayLike
    friction: Any
    restitution: Any
    law: str = "poisson"
    surface_velocity: ArrayLike = (0.0, 0.0, 0.0)
    velocity_scale: float | None = None
    stiffness: ArrayLike | None = None
    factor: ArrayLike | None = None
    factor_scale: float | None = None

    __repr__ = short_repr

    def part(self, place: int) -> ImpactProblem:
        """Return the problem of one of n contacts, by its index, without impulses at the others."""
        rows, count = slice(3 * place, 3 * place + 3), len(np.asarray(self.velocity))
        mu, e = (float(np.broadcast_to(x, count)[place]) for x in (self.friction, self.restitution))
        surface = np.broadcast_to(np.asarray(self.surface_velocity, dtype=float), (count, 3))[place]
        velocity = np.asarray(self.velocity, dtype=float)[place]
        return ImpactProblem(np.asarray(self.delassus)[rows, rows], velocity, mu, e, self.law, surface)


def contact_inputs(problem: ImpactProblem) -> Inputs:
    """Return the `Inputs` of a problem after checks of shapes and types.

    The solver checks the values; `one_contact.raise_for_status` raises the error for its status.

    Raises:
        InputError: Not numbers, a wrong shape, or a W that is not symmetric.
        UnknownNameError: An unknown law.
    """
    v1, v2, v3 = float_array("velocity", problem.velocity, (3,)).tolist()
    mu = real_number("friction", problem.friction)
    e = real_number("restitution", problem.restitution)
    scale = 0.0 if problem.velocity_scale is None else at_least_zero("velocity_scale", problem.velocity_scale)
    upper = delassus_upper(problem.delassus)
    factor = NO_FACTOR if problem.factor is None else _factor(problem, upper)
    return (*upper, v1, v2, v3, mu, e, law_code(problem.law), scale, factor)


def _factor(problem: ImpactProblem, upper: tuple[float, ...]) -> Array:
    """Return the factor (FACTOR,) of a problem: C with CCᵀ = XXᵀ, and its scale; check that XXᵀ is W."""
    given: Any = problem.factor
    X = finite_array("factor", given, (3, max(np.shape(given)[-1:] or (3,))))
    made = (X @ X.T)[np.triu_indices(3)]
    if not np.abs(made - upper).max() <= HALF_DIGITS * np.abs(upper).max():
        raise InputError(
            f"factor: X Xᵀ = {made.tolist()} (upper triangle), which is not W; for a robot "
            "X = J L⁻¹ with M = LᵀL",
            value=given,
        )
    C = np.zeros((3, 3))
    lower = np.asarray(np.linalg.qr(X.T, mode="r")).T
    C[:, : lower.shape[1]] = lower
    scale = problem.factor_scale
    size = 0.0 if scale is None else at_least_zero("factor_scale", scale)
    if not (C.any() or size):
        return NO_FACTOR
    return np.array([*C[np.tril_indices(3)], size])


def delassus_upper(delassus: Any) -> tuple[float, float, float, float, float, float]:
    """Return the upper triangle of a (3, 3) W, row by row, or raise `InputError` if W is not symmetric."""
    rows = float_array("delassus", delassus, (3, 3)).tolist()
    (w11, w12, w13), (w21, w22, w23), (w31, w32, w33) = rows
    if not (w12 == w21 and w13 == w31 and w23 == w32):
        asymmetry = max(abs(w12 - w21), abs(w13 - w31), abs(w23 - w32))
        largest = max(abs(x) for row in rows for x in row)
        if asymmetry > ZERO * largest:  # False for NaN, which the solver rejects
            raise InputError(
                f"delassus: W must be symmetric to {ZERO:.1e} of its largest entry {largest:.6g}, "
                f"but W and its transpose differ by {asymmetry:.6g}{single_precision_hint(delassus)}",
                value=delassus,
            )
        w12, w13, w23 = 0.5 * (w12 + w21), 0.5 * (w13 + w31), 0.5 * (w23 + w32)
    return w11, w12, w13, w22, w23, w33


def single_precision_hint(delassus: Any) -> str:
    """Return a hint for the error message of a W in less than double precision, or ""."""
    kind = getattr(delassus, "dtype", None)
    if kind in (np.float32, np.float16):
        return f"; its entries are {kind}, with rounding errors of this size: compute W in double precision"
    return ""
