"""Normal distributions of fitted or measured parameters, from which `ensemble` can draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array
from ..errors import InputError
from .estimate import Identified, symmetric

DRAWS = 10_000
"""Number of draws outside the bounds after which drawing from a distribution fails."""


@dataclass(frozen=True)
class Normal:
    """A normal distribution with the interface of those of `scipy.stats`."""

    mean: Array  # (n,) its mean
    root: Array  # (n, n) L with L Lᵀ its covariance

    def rvs(self, random_state: np.random.Generator) -> Array:
        """Return one draw (n,)."""
        drawn: Array = self.mean + self.root @ random_state.standard_normal(len(self.mean))
        return drawn


@dataclass(frozen=True)
class Posterior(Normal):
    """The distribution of fitted parameters, between their bounds."""

    fitted: Identified  # names, bounds, law and setters of the fit

    def rvs(self, random_state: np.random.Generator) -> Array:
        """Return one draw (n,) within the bounds."""
        low, high = self.fitted.bounds
        for _ in range(DRAWS):
            drawn = super().rvs(random_state)
            if (drawn >= low).all() and (drawn <= high).all():
                return drawn
        raise InputError(
            f"fitted: no draws around {self.mean.tolist()} are within the bounds; fit with wider bounds",
            value=self.mean,
        )


def posterior(fitted: Identified, spread: Array) -> Posterior:
    """Return the distribution of fitted parameters, with standard deviations (n,) added to the fit's."""
    root = covariance_root("fitted", fitted.covariance + np.diag(spread**2), len(spread))
    kept = Identified({name: fitted[name] for name in ("names", "bounds", "law", "setters")})
    return Posterior(np.asarray(fitted.x), root, kept)


def covariance_root(field: str, covariance: ArrayLike, size: int) -> Array:
    """Return L with L Lᵀ = the covariance, which may be singular, or raise `InputError`."""
    matrix = finite_array(field, covariance, (size, size))
    values, vectors = np.linalg.eigh(matrix)
    rounding = 32.0 * size * np.finfo(float).eps * np.abs(values).max()
    if not symmetric(matrix) or values.min() < -rounding:
        raise InputError(
            f"{field}: not a covariance; a symmetric matrix without negative eigenvalues expected",
            value=covariance,
        )
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
