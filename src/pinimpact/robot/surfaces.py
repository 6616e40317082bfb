"""The surface that a contact meets: a plane, in the world or carried by a body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array
from ..errors import InputError

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """A plane fixed in the world, moving at a given rate, or carried by a body.

    With ``body=None`` all vectors are in world axes. With a frame as `body` they are in that frame's
    axes, `point` is from its origin, and the plane moves with the frame; `velocity` and
    `angular_velocity` are then what the surface does beyond that (a belt, a turntable on the body).

    Attributes:
        point: A point of the plane [m].
        normal: Points from the surface into free space; any length but zero. Kept as a unit vector.
        velocity: Velocity of the surface's material at `point` [m/s].
        angular_velocity: Angular velocity of the surface's material about `point` [rad/s].
        body: Frame that carries the plane, by name or id; None for the world.

    The velocities are rates of this instant: they do not move `point` or turn `normal`.

    Raises:
        InputError: A vector that is not three finite numbers, or a normal of zero length.
    """

    point: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    body: str | int | None = None

    def __post_init__(self) -> None:
        for field in ("point", "velocity", "angular_velocity"):
            object.__setattr__(self, field, vector(field, getattr(self, field)))
        object.__setattr__(self, "normal", unit_vector("normal", self.normal))
        check_frame_key("body", self.body, optional=True)


def vector(field: str, value: ArrayLike) -> Vector:
    """Return three finite floats, or raise `InputError` naming `field`."""
    x, y, z = finite_array(field, value, (3,)).tolist()
    return x, y, z


def unit_vector(field: str, value: ArrayLike) -> Vector:
    """Return `value` scaled to length one, or raise `InputError` naming `field`."""
    x, y, z = vector(field, value)
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        raise InputError(
            f"{field}: {(x, y, z)} has no direction; give the vector from the surface into free space",
            field=field,
            value=value,
        )
    _, exponent = math.frexp(largest)  # scaling by a power of two is exact and keeps squares in range
    x, y, z = math.ldexp(x, -exponent), math.ldexp(y, -exponent), math.ldexp(z, -exponent)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


def check_frame_key(field: str, value: object, *, optional: bool = False) -> None:
    """Refuse what cannot name a frame: a frame is given by name or by id."""
    if optional and value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (str, int, np.integer)):
        raise InputError(
            f"{field}: {value!r} is neither the name nor the id of a frame", field=field, value=value
        )


def contact_axes(normal: ArrayLike) -> NDArray[np.float64]:
    """Return the (3, 3) contact axes of a normal: t₁, t₂ and n as rows, right-handed, in the normal's axes.

    For n = z: t₁ = x, t₂ = y. For any other n: the axes to which the smallest rotation that takes z to n
    carries x and y; for n = −z half a turn about x. Accurate to rounding for every n.

    Raises:
        InputError: A normal that is not three finite numbers, or of zero length.
    """
    from ._kernels.contact_kinematics import contact_axes as kernel

    n = unit_vector("normal", normal)
    return np.array([*kernel(*n), *n]).reshape(3, 3)
