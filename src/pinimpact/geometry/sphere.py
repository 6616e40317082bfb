"""A sphere, in the world or attached to a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..checks import above_zero
from ._kernels.constants import SPHERE
from .surfaces import Surface, Vector, vector


@dataclass(frozen=True, repr=False)
class Sphere(Surface):
    """A sphere, fixed in the world or attached to a body; the normal points outwards.

    With ``body=None`` all vectors are in world axes. With a frame as `body` they are in the frame's
    axes, `center` is relative to its origin, and the sphere moves with the frame; `velocity` and
    `angular_velocity` are then relative to the body.

    The gap of a contact with a tip of radius r and centre c is |c − center| − `radius` − r. If c is at
    `center`, the normal is not unique, and z is used.

    Attributes:
        center: Its centre [m].
        radius: > 0 [m]; required.
        velocity: Velocity of the surface's material at `center` [m/s].
        angular_velocity: Angular velocity of the surface's material about `center` [rad/s].
        body: Frame to which the sphere is attached, by name or id; None for the world.
        name: Name in reports, as in "hand on table"; None for "sphere" or the name of the body.

    The velocities do not move `center`.

    Raises:
        InputError: A vector that is not three finite numbers, or a radius that is not positive.
    """

    code: ClassVar[int] = SPHERE
    center: Vector = (0.0, 0.0, 0.0)
    radius: float = 0.0
    checks: ClassVar[dict[str, Any]] = {"center": vector, "radius": above_zero}
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    body: str | int | None = None
    name: str | None = None

    @property
    def origin(self) -> Vector:
        """The centre."""
        return self.center

    def distance(self, point: ArrayLike) -> float:
        """Return the signed distance of a point from the sphere, negative inside [m]."""
        return float(np.linalg.norm(np.subtract(point, self.center))) - self.radius

    def departure(self) -> str | None:
        """Return how the material leaves its place; None for a spin about the centre."""
        if not any(self.velocity):
            return None
        return f"moves at {float(np.linalg.norm(self.velocity)):.6g} m/s"
