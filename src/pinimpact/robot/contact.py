"""A contact of a robot: contact point, surface, friction and restitution; and its gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import above_zero, as_tuple, at_least_zero, coefficient, in_short, returned
from ..contact_space.laws import law_code
from ..display import short_repr
from ..errors import InputError
from ..geometry._kernels import constants as layout
from ..geometry.collision_shapes import (
    check_rim_points,
    collision_model,
    find_shape,
    shape_frame,
    shape_tips,
    unit_circle,
)
from ..geometry.convex_pair import gap
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface, Vector, check_frame_key, unit_vector, vector
from .names import frame_id, model_of
from .placed_robot import PlacedRobot
from .solids import Solid, two_shapes


@dataclass(frozen=True, repr=False)
class Contact:
    """A contact point or collision shape of a robot, and a surface, with friction and restitution.

    The contact point is the frame's origin + `offset` (in the frame's axes) − `radius`·n: a sphere of
    that radius about the offset touches the surface if the gap is zero. With `rim` it is the lowest
    point of a circle about the offset, such as a wheel or a coin, which rolls.

    With `geometry` instead of `frame` it is a collision shape: the contact is expanded into the points,
    spheres and rims of the shape that can touch the surface, see `tips`. (geometry.md)

    Attributes:
        frame: Frame of the point, by name or id; empty with `geometry`.
        plane: The surface, required: a `Plane` or a `Sphere`, with `geometry` also a `Box` or a `Shape`.
        friction: Coulomb coefficient μ ≥ 0 of impacts, and of sustained contact without `sliding_friction`.
            0 by default.
        restitution: Coefficient 0 ≤ e ≤ 1, or a function that returns it for an approach speed [m/s]. 0 by
            default: the bodies do not rebound.
        law: ``"poisson"``, ``"energetic"`` or ``"newton"``.
        offset: Position relative to the frame's origin, in the frame's axes [m].
        radius: Radius of a spherical tip [m], 0 for a point.
        name: Name in reports; None for "frame on surface", with the name of the surface, of the body to
            which it is attached, or "plane" or "sphere".
        sliding_friction: Coulomb coefficient μ ≥ 0 of sustained contact; None for `friction`.
        stiffness: Relative normal stiffness > 0, for several contacts that collide at one instant.
        geometry: Name of a collision shape of the robot, instead of a frame.
        rim_points: Number of points, ≥ 3, that replace each rim of a cylinder or cone, so that it can touch
            other surfaces than planes; None for smooth rims, which roll, and stand on `RIM_POINTS` points.
        rim: Radius of a circle about the offset, for contact with a plane [m], 0 for none.
        axis: Axis of that circle, in the frame's axes, of any nonzero length. Stored as a unit vector.
        shape: Name of the collision shape of the point; set by `tips`.
        of_rim: Label of the rim that it replaces, with other points, while the rim lies flat; set by a scene.
        pair: The contact of two shapes to which the point belongs; set by a scene.

    Raises:
        InputError: A number out of its range or not finite, a frame and a geometry or neither, a rim and a
            sphere.
        UnknownNameError: An unknown law.
    """

    frame: str | int = ""
    plane: Surface = None  # type: ignore[assignment]
    friction: float = 0.0
    restitution: float | Callable[[float], float] = 0.0
    law: str = "poisson"
    offset: Vector = (0.0, 0.0, 0.0)
    radius: float = 0.0
    name: str | None = None
    sliding_friction: float | None = None
    stiffness: float = 1.0
    geometry: str | None = None
    rim_points: int | None = None
    rim: float = 0.0
    axis: Vector = (0.0, 0.0, 1.0)
    shape: str | None = None
    of_rim: str | None = None
    pair: Contact | None = None
    law_code: int = field(init=False, repr=False, compare=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        self._check_kind()
        keep = object.__setattr__
        for name in ("friction", "radius", "rim"):
            keep(self, name, at_least_zero(name, getattr(self, name)))
        if self.sliding_friction is not None:
            keep(self, "sliding_friction", at_least_zero("sliding_friction", self.sliding_friction))
        keep(self, "stiffness", above_zero("stiffness", self.stiffness))
        if not callable(self.restitution):
            keep(self, "restitution", coefficient("restitution", self.restitution))
        keep(self, "law_code", law_code(self.law))
        keep(self, "offset", vector("offset", self.offset))
        keep(self, "axis", unit_vector("axis", self.axis, "the axis of the rim"))
        if self.rim > 0.0 and not isinstance(self.plane, Plane):
            raise InputError(
                f"rim: {self.rim:g} m given, but a rim can make contact with planes only, not "
                f"with a {self.plane.kind}",
                value=self.rim,
            )

    @cached_property
    def constants(self) -> Array:
        """The numbers of the contact for kernels, see `pinimpact.geometry._kernels.constants`."""
        constants = np.array(
            [*self.offset, self.radius, *self.plane.constants, self.rim, *self.axis, *self.plane.line]
        )
        constants.setflags(write=False)
        return constants

    def _check_kind(self) -> None:
        """Check the surface, and that there is either a frame or a collision shape."""
        check_frame_key("frame", self.frame)
        if not isinstance(self.name, (str, type(None))):
            raise InputError(f"name: {in_short(self.name)} given; text is expected", value=self.name)
        check_surface("plane", self.plane)
        if self.geometry is None and isinstance(self.plane, Solid):
            raise InputError(
                f"plane: only a collision shape can make contact with a {self.plane.kind}; give "
                "geometry= instead of a frame",
                value=self.plane,
            )
        if self.geometry is None:
            what = "neither a frame nor a geometry given" if self.frame == "" else ""
            if self.rim_points is not None:
                what = "rim_points applies to a geometry only"
        elif self.frame != "":
            what = f"the frame {in_short(self.frame)} and the geometry {in_short(self.geometry)} given"
        elif self.radius or self.rim or np.any(self.offset):
            what = "offset, radius and rim apply to a frame only"
        else:
            named = isinstance(self.geometry, str)
            what = "" if named else f"{in_short(self.geometry)} is not the name of a shape"
            check_rim_points(self.rim_points)
        if what:
            raise InputError(
                f"geometry: {what}; give frame, or geometry, the name of a collision shape",
                value=self.geometry,
            )

    def tips(self, robot: Any) -> tuple[Contact, ...]:
        """Return the contacts of points, spheres and rims of this one; itself with a frame.

        They belong to the link of the shape, with offsets in its axes, and are named after this contact or
        the shape, and the part: "box_0 corner 3 on floor".

        Args:
            robot: The RobotWrapper with the collision shapes; any robot for a frame.

        Raises:
            InputError: A robot without collision shapes, or a shape that is not supported with this surface.
            UnknownNameError: There is no shape of that name; the message suggests similar names.
            ModelError: A mesh without vertices.
        """
        if self.geometry is None:
            return (self,)
        return shape_contacts(model_of(robot), collision_model(robot), self)

    @property
    def label(self) -> str:
        """The name, or the default name."""
        if self.name is not None:
            return self.name
        return f"{self.frame if self.geometry is None else self.geometry} on {self.plane.label}"

    @property
    def sustained_friction(self) -> float:
        """The coefficient of friction of sustained contact."""
        return self.friction if self.sliding_friction is None else self.sliding_friction

    @property
    def unplaced(self) -> bool:
        """Whether it is a contact point of two shapes that do not touch: it then belongs to no body."""
        return self.pair is not None and self.frame == 0 and self.plane.body is None

    def restitution_at(self, speed: float) -> float:
        """Return e for an approach speed [m/s].

        Raises:
            InputError: The function of the contact fails, or does not return a number from 0 to 1.
        """
        if callable(self.restitution):
            e = returned("restitution", f"at an approach of {speed:.6g} m/s", self.restitution, speed)
            return coefficient(f"restitution({speed:.6g} m/s)", e)
        return self.restitution

    def gap(self, model: pin.Model, data: pin.Data, q: ArrayLike) -> float:
        """Return the signed distance of the contact point from the surface [m], negative inside.

        For a collision shape it is the smallest gap of its tips, or the distance of two shapes, also for a
        contact of two shapes in `Scene.contacts`; `model` must then be the RobotWrapper.
        Changes ``data.oMi``, ``data.liMi`` and ``data.oMf`` of the two frames.

        Raises:
            InputError: A q of the wrong length or not finite.
            UnknownNameError: A frame that the model does not have.
        """
        if self.unplaced and self.pair is not None:
            return self.pair.gap(model, data, q)
        if self.geometry is None:
            return PlacedRobot(model, data, q).locate(self)[0]
        if is_pair(model, self):
            a, b = two_shapes(model, self.geometry, self.rim_points, self.plane)
            PlacedRobot(model, data, q)
            return float(gap(a.placed(data), b.placed(data)).value)
        return min(tip.gap(model, data, q) for tip in self.tips(model))


RIM_POINTS = 16
"""Number of points that represent a rim while it lies flat: tipping takes at least cos(π/16) = .981 of the
torque that it takes on the circle. (theory.md, 15.1)"""


def points_of_rim(contact: Contact) -> list[Contact]:
    """Return the contacts of `RIM_POINTS` points of a rim, evenly spaced."""
    u = np.array(contact.axis)
    first = np.cross(u, np.eye(3)[np.abs(u).argmin()])
    first = np.cross(first / np.linalg.norm(first), u)
    x, y, _ = unit_circle(RIM_POINTS).T
    places = contact.offset + contact.rim * (np.outer(x, first) + np.outer(y, np.cross(u, first)))
    label = contact.label
    point = replace(contact, rim=0.0, axis=(0.0, 0.0, 1.0), of_rim=label)
    return [
        replace(point, offset=(x, y, z), name=f"{label} point {k}")
        for k, (x, y, z) in enumerate(places.tolist())
    ]


def is_pair(robot: Any, contact: Contact) -> bool:
    """Return whether a contact is between two convex shapes, other than a plane or two spheres."""
    if contact.geometry is None or isinstance(contact.plane, Solid):
        return contact.geometry is not None
    if not isinstance(contact.plane, Sphere):
        return False
    return type(find_shape(collision_model(robot), contact.geometry).geometry).__name__ != "Sphere"


Contacts: TypeAlias = Sequence[Contact]


def contact_constants(model: pin.Model, contact: Contact) -> tuple[int, int, Array]:
    """Return the joints of a contact's tip and surface, and its constants in their axes."""
    frame = model.frames[frame_id(model, contact.frame)]
    tip, base, carrier = frame.parentJoint, 0, pin.SE3.Identity()
    if contact.plane.body is not None:
        body = model.frames[frame_id(model, contact.plane.body, "body")]
        base, carrier = body.parentJoint, body.placement
    k = contact.constants.copy()
    k[layout.TIP : layout.RADIUS] = frame.placement.act(k[layout.TIP : layout.RADIUS])
    k[layout.POINT : layout.AXES] = carrier.act(k[layout.POINT : layout.AXES])
    directions = k[layout.AXES : layout.KIND].reshape(-1, 3)
    directions[:] = directions @ carrier.rotation.T
    k[layout.RIM_AXIS : layout.LINE_AXIS] = frame.placement.rotation @ k[layout.RIM_AXIS : layout.LINE_AXIS]
    k[layout.LINE_AXIS : layout.CONSTANTS] = carrier.rotation @ k[layout.LINE_AXIS : layout.CONSTANTS]
    return tip, base, k


def shape_contacts(model: pin.Model, shapes: pin.GeometryModel, contact: Contact) -> tuple[Contact, ...]:
    """Return the tips of a contact of a collision shape; see `Contact.tips`."""
    shape = find_shape(shapes, contact.geometry or "")
    found = shape_tips(shapes, shape, contact.rim_points)
    if not isinstance(contact.plane, Plane) and (found.kind != "sphere" or isinstance(contact.plane, Solid)):
        raise InputError(
            f"geometry: {shape.name!r} is a {found.kind}, whose contact points with a {contact.plane.kind} "
            "depend on the configuration; tips exist for planes only",
            value=shape.name,
        )
    frame = shape_frame(model, shape)
    placed = model.frames[frame].placement.actInv(shape.placement)
    rotation = placed.rotation
    offsets = found.centres @ rotation.T + placed.translation
    axis = tuple(rotation[:, 2].tolist())
    contacts = []
    for offset, rim, part in zip(offsets.tolist(), found.rims.tolist(), found.parts, strict=True):
        name = f"{contact.label} {part}" if part else contact.label
        if part and contact.name is None:
            name = f"{shape.name} {part} on {contact.plane.label}"
        contacts.append(
            replace(
                contact,
                frame=frame,
                geometry=None,
                rim_points=None,
                shape=shape.name,
                name=name,
                offset=tuple(offset),
                radius=found.radius,
                rim=rim,
                axis=axis if rim > 0.0 else (0.0, 0.0, 1.0),
            )
        )
    return tuple(contacts)


def check_surface(field: str, value: Any) -> None:
    """Raise `InputError` for a value that is not a surface."""
    if not isinstance(value, Surface):
        raise InputError(f"{field}: {in_short(value)} is not a Plane, Sphere, Box or Shape", value=value)


def check_contact(field: str, value: Any, placed: bool = True) -> None:
    """Raise an error for anything but a `Contact` of one point, which has a position if it must be placed."""
    if not isinstance(value, Contact):
        raise InputError(f"{field}: {in_short(value)} is not a Contact", value=value)
    if value.geometry is not None or (placed and value.unplaced):
        instead = "give those of its contact.tips(robot) that touch"
        if value.unplaced:  # of a scene
            instead = "impact() takes its contact.pair"
        elif not isinstance(value.plane, Plane):  # the contact points depend on the configuration
            instead = "impact() and scenes take it"
        raise InputError(
            f"{field}: {value.label!r} is a contact of a collision shape, which has no single point here; "
            f"{instead}",
            value=value,
        )


def check_held(held: Contact | Sequence[Contact]) -> tuple[Contact, ...]:
    """Return the held contacts as a tuple; one alone need not be wrapped."""
    anchors = as_tuple("held", held, (Contact, str), "a Contact")
    for anchor in anchors:
        check_contact("held", anchor)
    return anchors
