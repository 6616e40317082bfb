"""Forward dynamics by elimination with M, where Pinocchio's articulated bodies lose their digits.

In chains of joints with several velocities (ropes of spherical joints), rounding errors of articulated
inertias grow about tenfold from joint to joint: after twenty joints v̇ of `aba` and M⁻¹ of `computeMinverse`
have no correct digit. M and the forces of `rnea` have no such error, and chains of hinges are not affected.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array
from .once import Known, once
from .tolerances import LOST_DIGITS

_known: Known = {}


def is_accurate(model: pin.Model) -> bool:
    """Return whether `aba` and `computeMinverse` are as accurate as elimination with M, but for a few digits.

    This is measured once for a model, at a random state, and again if it grows.
    """
    return once(_known, model, _measure)


def _measure(model: pin.Model) -> bool:
    nested = [j for j in range(1, model.njoints) if model.nvs[j] > 1 and model.parents[j] > 0]
    if len(nested) < 2 or len(model.mimicking_joints) > 0:
        return True
    rng, data = np.random.default_rng(0), model.createData()
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    v, expected = rng.normal(size=(2, model.nv))
    tau = pin.rnea(model, data, q, v, expected).copy()
    try:
        errors = [
            np.abs(found - expected).max()
            for found in (
                eliminate(model, data, q, v, tau)[0],
                pin.aba(model, model.createData(), q, v, tau, pin.Convention.WORLD),
                pin.computeMinverse(model, model.createData(), q) @ (pin.crba(model, data, q) @ expected),
            )
        ]
    except np.linalg.LinAlgError:  # a joint without inertia
        return True
    return bool(max(errors[1:]) <= LOST_DIGITS * errors[0])


def inverse_of(mass: Array) -> Array:
    """Return the inverse (nv, nv) of M, symmetric to the last bit."""
    inverse = np.linalg.inv(mass)
    return np.asarray(0.5 * (inverse + inverse.T))


def eliminate(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
    """Return v̇ (nv,) without contact forces, and M (nv, nv)."""
    mass = pin.crba(model, data, q)
    return np.linalg.solve(mass, tau - pin.nonLinearEffects(model, data, q, v)), mass
