"""Checks that the inertias of a model are physically possible."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import NOISE
from ..errors import InertiaWarning, ModelError
from .names import joint_of_velocity
from .tolerances import ROUNDED_INERTIA


def check_inertias(model: pin.Model) -> None:
    """Raise `ModelError` for negative masses and rotor inertias; warn of moments that no body can have.

    For a density ρ ≥ 0 the largest principal moment is at most the sum of the others; so none is negative.
    """
    check_coefficients(model, "armature", "kg m² or kg")
    for name, inertia in list(zip(model.names, model.inertias, strict=True))[1:]:
        if inertia.mass < 0.0:
            raise ModelError(
                f"model: the negative mass {inertia.mass:.6g} kg of joint {name!r}; a mass is at least 0",
                value=name,
            )
        if not np.isfinite(inertia.toDynamicParameters()).all():
            continue  # rejected with the mass matrix
        least, middle, largest = np.linalg.eigvalsh(inertia.inertia).tolist()
        rounding = NOISE * inertia.mass * float(inertia.lever @ inertia.lever)  # for sums of several links
        if largest - least - middle > ROUNDED_INERTIA * largest + rounding:
            warnings.warn(
                f"model: no body can have the inertia of joint {name!r}: its principal moments are "
                f"{least:.6g}, {middle:.6g} and {largest:.6g} kg m², and the largest must be at most the sum "
                "of the others; correct the inertias of its links",
                InertiaWarning,
                stacklevel=2,
            )


def check_coefficients(model: pin.Model, field: str, unit: str) -> None:
    """Raise `ModelError` for a coefficient of a joint's velocity that is negative or not finite."""
    values = np.asarray(getattr(model, field))
    for k in np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))[:1].tolist():
        raise ModelError(
            f"model.{field}[{k}]: {values[k]} given, a finite number ≥ 0 [{unit}] for joint "
            f"{joint_of_velocity(model, k)!r} expected",
            value=values[k],
        )
