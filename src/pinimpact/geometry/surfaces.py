"""The surfaces that contacts meet: what all of them are, and their axes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array
from ..errors import InputError

Vector = tuple[float, float, float]


class Surface(ABC):
    """What a contact meets: a surface in the world or carried by a body.

    A kind of surface is one class of this, a frozen dataclass, and one kernel module with its signed
    distance.
    All vectors are in the axes of what carries the surface.

    Attributes:
        code: What the kernels know the kind by, see `pinimpact.geometry._kernels.constants`.
        velocity: Velocity of the surface's material at `origin`, beyond its carrier's [m/s].
        angular_velocity: Angular velocity of the surface's material, beyond its carrier's [rad/s].
        body: Frame that carries the surface, by name or id; None for the world.
        name: How reports call it; None for what it is, or for what carries it.
    """

    code: ClassVar[int]
    velocity: Vector
    angular_velocity: Vector
    body: str | int | None
    name: str | None

    @property
    @abstractmethod
    def origin(self) -> Vector:
        """The point that the surface's material turns about [m]."""

    @property
    @abstractmethod
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) axes t₁, t₂, n somewhere on the surface, as rows: a scene's contact axes start from here."""

    @property
    def size(self) -> float:
        """The number that a kind needs beyond its place and axes; 0 if none."""
        return 0.0

    @property
    def direction(self) -> Vector:
        """The unit direction of a surface that is a line; zero of another one."""
        return (0.0, 0.0, 0.0)

    @abstractmethod
    def distance(self, point: ArrayLike) -> float:
        """Return the signed distance of a point from the surface, negative inside [m]."""

    @abstractmethod
    def departure(self) -> str | None:
        """Return in words how the material leaves the surface's place, or None if it keeps to it."""

    @property
    def constants(self) -> tuple[float, ...]:
        """The surface's part of the constants of a contact, see `pinimpact.geometry._kernels.constants`."""
        axes = self.axes.ravel().tolist()
        return *self.origin, *axes, *self.velocity, *self.angular_velocity, float(self.code), self.size

    @property
    def kind(self) -> str:
        """What reports call such a surface."""
        return type(self).__name__.lower()

    @property
    def label(self) -> str:
        """The name, or what stands in for it."""
        if self.name is not None:
            return self.name
        return self.kind if self.body is None else str(self.body)

    def at_rest(self) -> Surface:
        """Return the surface with its material at rest on its carrier."""
        surface: Any = self  # subclasses are dataclasses
        return cast(Surface, replace(surface, velocity=(0.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.0)))

    def _check(self) -> None:
        """Check the fields that all surfaces have, and keep them as numbers."""
        for field in ("velocity", "angular_velocity"):
            object.__setattr__(self, field, vector(field, getattr(self, field)))
        check_frame_key("body", self.body, optional=True)


def vector(field: str, value: ArrayLike) -> Vector:
    """Return three finite floats, or raise `InputError` naming `field`."""
    x, y, z = finite_array(field, value, (3,)).tolist()
    return x, y, z


def unit_vector(
    field: str, value: ArrayLike, meaning: str = "the vector from the surface into free space"
) -> Vector:
    """Return `value` scaled to length one, or raise `InputError` naming `field` and what it means."""
    x, y, z = vector(field, value)
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        raise InputError(
            f"{field}: {(x, y, z)} has no direction; give {meaning}, of any length but zero",
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
    from ._kernels.contact_axes import contact_axes as kernel

    n = unit_vector("normal", normal)
    return np.array([*kernel(*n), *n]).reshape(3, 3)
