"""What a scene takes from a model beside its inertia: gravity, damping, dry friction and bounds of joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Bools
from ..errors import ModelError
from ..robot.names import joint_of_velocity


def check_numbers(model: pin.Model) -> None:
    """Refuse numbers of a model that no robot has.

    Raises:
        ModelError: Gravity that is not finite, damping or dry friction of a joint that is not finite or
            negative, a bound of a joint that is NaN.
    """
    gravity = model.gravity.vector
    if not np.isfinite(gravity).all():
        raise _refused("gravity", gravity.tolist(), "finite numbers [m/s²]")
    for field, unit in (("damping", "N m s/rad or N s/m"), ("friction", "N m or N")):
        values = np.asarray(getattr(model, field))
        for k in _first(~(np.isfinite(values) & (values >= 0.0))):
            joint = joint_of_velocity(model, k)
            raise _refused(f"{field}[{k}]", values[k], f"a finite number ≥ 0 [{unit}] for joint {joint!r}")
    for field in ("lowerPositionLimit", "upperPositionLimit"):
        values = np.asarray(getattr(model, field))
        for k in _first(np.isnan(values)):
            raise _refused(f"{field}[{k}]", values[k], "a bound [rad or m], infinite where there is none,")


def _first(faults: Bools) -> list[int]:
    return np.flatnonzero(faults)[:1].tolist()


def _refused(field: str, value: object, expected: str) -> ModelError:
    return ModelError(f"model.{field}: {value} given, {expected} expected", value=value)
