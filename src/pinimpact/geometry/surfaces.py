"""Surfaces of contacts: the base class, and contact axes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array, in_short
from ..display import short_repr
from ..errors import InputError

Vector = tuple[float, float, float]


class Surface(ABC):
    """A surface for contacts, in the world or attached to a body.

    A kind of surface is a subclass, a frozen dataclass, and a kernel module with its signed distance. All
    vectors are in the axes of the body to which the surface is attached.

    Attributes:
        code: Code of the kind in kernels, see `pinimpact.geometry._kernels.constants`.
        checks: Functions that return the checked value of a field of the kind, by its name.
        radius: Radius of a sphere, or about a line; 0 for others [m].
        line: The unit direction of a surface that is a line; zero for others.
        normal: The unit normal n of `axes`.
        velocity: Velocity of the surface's material at `origin`, relative to its body [m/s].
        angular_velocity: Angular velocity of the surface's material, relative to its body [rad/s].
        body: Frame to which the surface is attached, by name or id; None for the world.
        name: Name in reports; None for that of the kind or of the body.
    """

    code: ClassVar[int]
    checks: ClassVar[dict[str, Callable[[str, Any], Any]]] = {}
    radius: float = 0.0
    line: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    body: str | int | None
    name: str | None

    __repr__ = short_repr

    @property
    @abstractmethod
    def origin(self) -> Vector:
        """The centre of rotation of the surface's material [m]."""

    @property
    def axes(self) -> Array:
        """(3, 3) axes t₁, t₂, n at one point of the surface, as rows: the initial contact axes of a scene."""
        return contact_axes(self.normal)

    @abstractmethod
    def distance(self, point: ArrayLike) -> float:
        """Return the signed distance of a point from the surface, negative inside [m]."""

    def departure(self) -> str | None:
        """Return in words how the material leaves the surface's place, or None if it stays within it."""
        return None

    @property
    def constants(self) -> tuple[float, ...]:
        """The surface's part of the constants of a contact, see `pinimpact.geometry._kernels.constants`."""
        axes = self.axes.ravel().tolist()
        return *self.origin, *axes, *self.velocity, *self.angular_velocity, float(self.code), self.radius

    @property
    def kind(self) -> str:
        """The name of the kind in reports."""
        return type(self).__name__.lower()

    @property
    def label(self) -> str:
        """The name, or the default name."""
        if self.name is not None:
            return self.name
        return self.kind if self.body is None else str(self.body)

    def at_rest(self) -> Surface:
        """Return the surface with its material at rest relative to its body."""
        if not any((*self.velocity, *self.angular_velocity)):
            return self
        surface: Any = self  # subclasses are dataclasses
        return cast(Surface, replace(surface, velocity=(0.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.0)))

    def __post_init__(self) -> None:
        """Check the fields, and store them as numbers."""
        for field, check in {**self.checks, "velocity": vector, "angular_velocity": vector}.items():
            object.__setattr__(self, field, check(field, getattr(self, field)))
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
            f"{field}: {(x, y, z)} has no direction; give {meaning}, of any length but zero", value=value
        )
    _, exponent = math.frexp(largest)  # scaling by a power of two is exact and keeps squares in range
    x, y, z = math.ldexp(x, -exponent), math.ldexp(y, -exponent), math.ldexp(z, -exponent)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


def check_frame_key(field: str, value: object, *, optional: bool = False) -> None:
    """Check that a frame is given by name or by id."""
    if optional and value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (str, int, np.integer)):
        raise InputError(f"{field}: {in_short(value)} is neither the name nor the id of a frame", value=value)


def contact_axes(normal: ArrayLike) -> Array:
    """Return the (3, 3) contact axes of a normal: t₁, t₂ and n as rows, right-handed, in the normal's axes.

    For n = z: t₁ = x, t₂ = y. For any other n: the axes to which the smallest rotation that takes z to n
    carries x and y; for n = −z half a turn about x. Accurate to rounding for every n.

    Raises:
        InputError: A normal that is not three finite numbers, or of zero length.
    """
    from ._kernels.contact_axes import contact_axes as kernel

    n = unit_vector("normal", normal)
    return np.array([*kernel(*n), *n]).reshape(3, 3)
