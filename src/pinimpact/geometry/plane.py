"""A plane, in the world or attached to a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .._numeric.tolerances import ROUNDING
from ._kernels.constants import PLANE
from .surfaces import Surface, Vector, unit_vector, vector


@dataclass(frozen=True, repr=False)
class Plane(Surface):
    """A plane, fixed in the world or attached to a body; its surface can move within itself.

    With ``body=None`` all vectors are in world axes. With a frame as `body` they are in the frame's
    axes, `point` is relative to its origin, and the plane moves with the frame; `velocity` and
    `angular_velocity` are then relative to the body (a belt or a turntable on the body).

    Attributes:
        point: A point of the plane [m].
        normal: Normal from the surface into free space, of any nonzero length. Stored as a unit vector.
        velocity: Velocity of the surface's material at `point` [m/s].
        angular_velocity: Angular velocity of the surface's material about `point` [rad/s].
        body: Frame to which the plane is attached, by name or id; None for the world.
        name: Name in reports, as in "hand on table"; None for "plane" or the name of the body.

    The velocities do not move `point` or rotate `normal`.

    Raises:
        InputError: A vector that is not three finite numbers, or a normal of zero length.
    """

    code: ClassVar[int] = PLANE
    checks: ClassVar[dict[str, Any]] = {"point": vector, "normal": unit_vector}
    point: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    body: str | int | None = None
    name: str | None = None

    def distance(self, point: ArrayLike) -> float:
        """Return the signed distance of a point from the plane, negative below it [m]."""
        return float(np.dot(self.normal, np.subtract(point, self.point)))

    @property
    def origin(self) -> Vector:
        """The point of the plane."""
        return self.point

    def departure(self) -> str | None:
        """Return how the material rises or tilts; None if it moves within the plane."""
        rise = float(np.dot(self.normal, self.velocity))
        tilt = float(np.linalg.norm(np.cross(self.normal, self.angular_velocity)))
        speed, spin = np.linalg.norm(self.velocity), np.linalg.norm(self.angular_velocity)
        if abs(rise) <= ROUNDING * speed and tilt <= ROUNDING * spin:
            return None
        return f"moves along its normal at {rise:.6g} m/s or tilts at {tilt:.6g} rad/s"
