"""The limits of a model's joints, for single coordinates."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import JointLimitWarning

NO_BOUND = 1e300
"""A bound of at least this size is infinite."""


@dataclass(frozen=True, slots=True)
class JointLimit:
    """One bound of one joint coordinate: sign · (q[index_q] − bound) ≥ 0."""

    name: str  # "joint_name lower" or "joint_name upper"
    index_q: int  # indices of the coordinate in q and in v
    index_v: int
    sign: float  # 1 for a lower bound, −1 for an upper one
    bound: float  # its value [rad or m]


def joint_limits(model: pin.Model) -> tuple[JointLimit, ...]:
    """Return the finite bounds of the coordinates that are plain numbers."""
    joints = zip(model.names, model.nqs, model.nvs, model.idx_qs, model.idx_vs, strict=True)
    lowest, highest = model.lowerPositionLimit.tolist(), model.upperPositionLimit.tolist()
    found = []
    for label, nq, nv, first_q, first_v in list(joints)[1:]:
        if nq != nv:
            continue
        for k in range(nq):
            i, j = first_q + k, first_v + k
            name = label + (f"[{k}]" if nq > 1 else "")
            lower, upper = lowest[i], highest[i]
            if lower == upper == 0.0:
                continue  # as read from a URDF whose <limit> has no bounds
            if abs(lower) < NO_BOUND:
                found.append(JointLimit(f"{name} lower", i, j, 1.0, lower))
            if abs(upper) < NO_BOUND:
                found.append(JointLimit(f"{name} upper", i, j, -1.0, upper))
    return tuple(found)


def bounds(model: pin.Model) -> Array:
    """Return (2, nq) the lower and the upper bound of each coordinate, infinite if it has none."""
    found = np.full((2, model.nq), np.inf)
    found[0] = -np.inf
    for limit in joint_limits(model):
        found[0 if limit.sign > 0.0 else 1, limit.index_q] = limit.bound
    return found


def degrees_hint(value: float) -> str:
    """Return an addition to a message if a coordinate outside its limits looks like an angle in degrees."""
    return "; angles are in radians, and this looks like degrees" if abs(value) > 2.0 * math.pi else ""


def warn_of_limits(model: pin.Model, q: Array, rows: str, stacklevel: int) -> None:
    """Warn that q (nq,) is outside the limits of a joint; `rows` is added to the message, as " in 3 rows"."""
    low, high = bounds(model)
    beyond = np.maximum(low - q, q - high)
    i = int(np.argmax(beyond))
    name = next(limit.name.rpartition(" ")[0] for limit in joint_limits(model) if limit.index_q == i)
    warnings.warn(
        f"q: joint {name!r} is at {q[i]:.6g}, beyond its limits {low[i]:.6g} to {high[i]:.6g}{rows}"
        f"{degrees_hint(q[i])}",
        JointLimitWarning,
        stacklevel=stacklevel,
    )
