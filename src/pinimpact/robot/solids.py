"""Surfaces for contact with collision shapes only: a box, and a collision shape of the robot itself."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..checks import above_zero, in_short
from ..errors import InputError
from ..geometry import collision_shapes
from ..geometry._kernels.constants import SOLID
from ..geometry.convex_shape import ConvexShape, PlacedShape, box, hull, of_collision_geometry, sphere
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface, Vector, vector
from ..geometry.tolerances import COINCIDE
from .names import frame_id, model_of


@dataclass(frozen=True, eq=False)
class CarriedShape:
    """A convex shape attached to a frame."""

    shape: ConvexShape
    frame: int  # id of the frame; 0 is the world
    joint: int  # the joint that moves the frame
    in_frame: pin.SE3  # placement of the shape in the frame's axes
    in_joint: pin.SE3  # placement of the shape in the joint's axes
    name: str

    @cached_property
    def joint_in_frame(self) -> pin.SE3:
        """Placement of the joint in the frame's axes."""
        return self.in_frame * self.in_joint.inverse()

    def placed(self, data: pin.Data) -> PlacedShape:
        """Return the shape at its placement, with ``data.oMi`` up to date."""
        placement = data.oMi[self.joint] * self.in_joint
        return self.shape.at(placement.rotation, placement.translation)


def carried(
    model: pin.Model, shape: ConvexShape, key: str | int | None, placement: pin.SE3, name: str
) -> CarriedShape:
    """Return a shape attached to a frame (None: the world) at a placement in its axes.

    Raises `InputError` for a shape without a volume, whose sides coincide.
    """
    if shape.half_thickness <= COINCIDE * shape.reach:
        raise InputError(
            f"geometry: {name!r} has a size of {2.0 * shape.reach:.3g} m and a thickness of "
            f"{2.0 * shape.half_thickness:.3g} m; only shapes with a volume can make contact with another "
            "shape",
            value=name,
        )
    frame = 0 if key is None else frame_id(model, key, "body")
    body = model.frames[frame]
    return CarriedShape(shape, frame, int(body.parentJoint), placement, body.placement * placement, name)


def collision_shape(robot: Any, name: str, rim_points: int | None = None) -> CarriedShape:
    """Return a collision shape of a robot as a convex shape; for a mesh its hull.

    A cylinder or cone has `rim_points` on each rim. Raises `InputError` for a shape that cannot be made
    convex, or a robot without any, `UnknownNameError` with similar names.
    """
    model, shapes = model_of(robot), collision_shapes.collision_model(robot)
    found = collision_shapes.find_shape(shapes, name)
    frame = collision_shapes.shape_frame(model, found)
    placement = model.frames[frame].placement.actInv(found.placement)
    return carried(model, _known_shape(shapes, found, rim_points), frame, placement, name)


_known: collision_shapes.Remembered = {}


def _known_shape(shapes: pin.GeometryModel, found: pin.GeometryObject, rim_points: int | None) -> ConvexShape:
    """Return the convex shape of a collision shape; those of meshes are cached."""
    solid, name = found.geometry, found.name
    swept = collision_shapes.swept_radius(solid)
    if swept > 0.0:
        raise InputError(
            f"geometry: {name!r} has a swept-sphere radius of {swept:g} m, which is possible with "
            "planes only; set it to 0",
            value=name,
        )
    if type(solid).__name__ in ("Cylinder", "Cone"):
        if rim_points is None:
            raise InputError(
                f"rim_points: {name!r} is a {type(solid).__name__.lower()}, whose smooth rims can "
                "make contact with planes only; give rim_points=, the number of points of each "
                "rim (for instance 24), to the Contact or Shape that names it",
                value=None,
            )
        return hull(collision_shapes.shape_tips(shapes, found, rim_points).centres, name)
    if not hasattr(solid, "vertices"):
        return of_collision_geometry(solid, name)
    points = np.array(solid.vertices(), dtype=np.float64)
    shape: ConvexShape = collision_shapes.remembered(
        _known, shapes, name, points, lambda: of_collision_geometry(solid, name)
    )
    return shape


class Solid(Surface):
    """A surface that is a convex body, for contacts with `geometry` only."""

    code: ClassVar[int] = SOLID

    @abstractmethod
    def carried_by(self, robot: Any) -> CarriedShape:
        """Return the convex shape, and the frame to which it is attached, for a RobotWrapper."""

    @property
    def origin(self) -> Vector:
        """A point of it."""
        return (0.0, 0.0, 0.0)

    def distance(self, point: ArrayLike) -> float:
        """Raise `InputError`: it is not known without the robot."""
        raise InputError(f"plane: {self.label!r} has no distance function for points", value=self)


def _sides(field: str, value: Any) -> Vector:
    x, y, z = vector(field, value)
    return above_zero(field, x), above_zero(field, y), above_zero(field, z)


@dataclass(frozen=True, repr=False)
class Box(Solid):
    """A box, fixed in the world or attached to a body, for contact with collision shapes.

    Attributes:
        size: Lengths of its sides [m].
        center: Its centre [m], in world axes or those of `body`.
        rpy: Roll, pitch and yaw of its sides about the fixed axes x, y, z, as in a URDF [rad].
        body: Frame to which it is attached, by name or id; None for the world.
        name: Name in reports; None for "box" or the name of the body.

    Raises:
        InputError: A vector that is not three finite numbers, or a side that is not positive.
    """

    size: Vector = (0.0, 0.0, 0.0)
    center: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    body: str | int | None = None
    name: str | None = None

    checks: ClassVar[dict[str, Any]] = {"size": _sides, "center": vector, "rpy": vector}

    def carried_by(self, robot: Any) -> CarriedShape:
        """See `Solid`."""
        placement = pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.center))
        return carried(model_of(robot), box(self.size), self.body, placement, self.label)


@dataclass(frozen=True, repr=False)
class Shape(Solid):
    """A collision shape of the robot, for contact with another of its shapes.

    Attributes:
        geometry: Name of the collision shape.
        name: Name in reports; None for the same.
        rim_points: Number of points, ≥ 3, of each rim of a cylinder or cone; required for these.

    Raises:
        InputError: An invalid name, or fewer than 3 points.
    """

    geometry: str = ""
    name: str | None = None
    rim_points: int | None = None
    body: None = None

    def __post_init__(self) -> None:
        if not isinstance(self.geometry, str) or not self.geometry:
            raise InputError(
                f"geometry: {in_short(self.geometry)} is not the name of a collision shape",
                value=self.geometry,
            )
        collision_shapes.check_rim_points(self.rim_points)

    @property
    def label(self) -> str:
        """The name, or the name of the shape."""
        return self.name or self.geometry

    def carried_by(self, robot: Any) -> CarriedShape:
        """See `Solid`."""
        return collision_shape(robot, self.geometry, self.rim_points)


def solid_sphere(robot: Any, surface: Sphere) -> CarriedShape:
    """Return a sphere as a convex shape, or raise `InputError`: its surface has a velocity."""
    if any(surface.velocity) or any(surface.angular_velocity):
        raise InputError(
            f"plane: {surface.label!r} has a surface velocity, which is possible with points and "
            "spheres only; attach the surface to a moving body instead",
            value=surface,
        )
    placement = pin.SE3(np.eye(3), np.array(surface.center))
    return carried(model_of(robot), sphere(surface.radius), surface.body, placement, surface.label)


def two_shapes(
    robot: Any, name: str, rim_points: int | None, surface: Surface
) -> tuple[CarriedShape, CarriedShape]:
    """Return a collision shape of a robot, see `collision_shape`, and a solid or sphere, as convex shapes."""
    one = collision_shape(robot, name, rim_points)
    if isinstance(surface, Sphere):
        return one, solid_sphere(robot, surface)
    assert isinstance(surface, Solid)
    return one, surface.carried_by(robot)
