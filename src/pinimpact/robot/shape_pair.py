"""A contact of two convex shapes, and its contact points as contacts of single points."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.collision_shapes import collision_model, find_shape
from ..geometry.convex_pair import Touch, gap, touches
from ..geometry.convex_shape import PlacedShape, cross
from ..geometry.lines import Edge, Line
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface, Vector
from .contact import Contact
from .data_cache import checked_configuration, data_cache
from .names import model_of, motion_signs
from .solids import CarriedShape, Solid, collision_shape, solid_sphere

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShapePair:
    """Two convex shapes that can make contact.

    Attributes:
        contact: The contact, with its coefficients.
        a: The shape of the robot; impulses and forces act on it.
        b: The other shape; normals point from it to `a`.
    """

    contact: Contact
    a: CarriedShape
    b: CarriedShape

    @property
    def most_points(self) -> int:
        """Largest number of contact points of the two, including one that replaces another."""
        corners = [max([len(face) for face in one.shape.faces], default=0) for one in (self.a, self.b)]
        if all(corners):
            return sum(corners)
        return 2 if min(len(one.shape.vertices) for one in (self.a, self.b)) == 1 else 4

    @property
    def basis(self) -> Contact:
        """A contact of a point of A without a position, with the coefficients and the name."""
        return replace(
            self.contact, geometry=None, rim_points=None, frame=0, plane=Plane(), shape=self.a.name
        )

    @cached_property
    def bounding(self) -> Contact:
        """Bounding spheres of A and B, as a contact of a single point."""
        point = self.a.in_frame.act(self.a.shape.center)
        center = self.b.in_frame.act(self.b.shape.center)
        return replace(
            self.basis,
            frame=self.a.frame,
            offset=tuple(point.tolist()),
            radius=self.a.shape.reach,
            plane=Sphere(tuple(center.tolist()), self.b.shape.reach, body=self.b.frame or None),
        )

    def placed(self, data: pin.Data) -> tuple[PlacedShape, PlacedShape]:
        """Return both shapes at their placements, with ``data.oMi`` up to date."""
        return _placed(data, self.a), _placed(data, self.b)


def _placed(data: pin.Data, one: CarriedShape) -> PlacedShape:
    placement = data.oMi[one.joint] * one.in_joint
    return one.shape.at(placement.rotation, placement.translation)


def is_pair(robot: Any, contact: Contact) -> bool:
    """Whether a contact is one of two convex shapes: not of a shape and a plane, nor of two spheres.

    Args:
        robot: The RobotWrapper with the collision shapes.
        contact: The contact.
    """
    if contact.geometry is None or isinstance(contact.plane, Solid):
        return contact.geometry is not None
    if not isinstance(contact.plane, Sphere):
        return False
    return type(find_shape(collision_model(robot), contact.geometry).geometry).__name__ != "Sphere"


def places(robot: Any, contact: Contact) -> tuple[Contact, ...]:
    """Return a contact for each possible contact point of two shapes, initially far from any surface.

    Their positions are set when the shapes touch; see `point_contacts`.

    Args:
        robot: The RobotWrapper with the collision shapes.
        contact: The contact of two shapes.
    """
    pair = shape_pair(robot, contact)
    count = pair.most_points
    far = Plane((0.0, 0.0, -FAR), name=pair.b.name)
    label = contact.label
    first = replace(pair.basis, plane=far, pair=contact, name=label)
    return (first, *(_called(first, f"{label} {k + 1}") for k in range(1, count)))


def _called(contact: Contact, name: str) -> Contact:
    """Return a contact with another name, without checking it again."""
    other = copy(contact)
    object.__setattr__(other, "name", name)
    return other


FAR = 1e3
"""Distance from its surface of a contact without a position [m]."""


def shape_pair(robot: Any, contact: Contact) -> ShapePair:
    """Return the two shapes of a contact.

    Args:
        robot: The RobotWrapper with the collision shapes.
        contact: With a `geometry`, and a solid or a sphere as its `plane`.

    Raises:
        InputError: A robot without collision shapes, a shape that cannot be made convex, two shapes that
            cannot move relative to each other.
        UnknownNameError: There is no shape of that name; the message suggests similar names.
    """
    a = collision_shape(robot, contact.geometry or "", contact.rim_points)
    surface = contact.plane
    b = solid_sphere(robot, surface) if isinstance(surface, Sphere) else surface.carried_by(robot)  # type: ignore[attr-defined]
    if not motion_signs(model_of(robot), a.joint, b.joint).any():
        raise InputError(
            f"contacts: {a.name!r} and {b.name!r} cannot move relative to each other: they belong "
            "to the same body",
            field="contacts",
            value=contact,
        )
    return ShapePair(contact, a, b)


class PointContact(NamedTuple):
    """A contact point of two shapes, as contacts of single points.

    Attributes:
        touch: The features in contact.
        instant: The contact at this instant, a point of A on a plane attached to B: its Jacobian is correct.
        lasting: The contact as long as these features touch; None for corners of two polytopes, or a corner
            and an edge.
        swapped: Whether the point of `lasting` belongs to B, so that its force acts on B.
    """

    touch: Touch
    instant: Contact
    lasting: Contact | None
    swapped: bool


def point_contact(
    pair: ShapePair,
    data: pin.Data,
    placed: Sequence[PlacedShape],
    normal: Array,
    touch: Touch,
    basis: Contact,
) -> PointContact:
    """Return the contacts of a contact point of two shapes, at the configuration of `data`.

    Args:
        pair: The shapes.
        data: With joint placements up to date.
        placed: The shapes at their placements.
        normal: (3,) from B to A.
        touch: The point.
        basis: A contact with the coefficients and the name.
    """
    a, b = pair.a, pair.b
    radius_a, radius_b = a.shape.radius, b.shape.radius

    def place(one: CarriedShape, point: Array) -> Vector:
        x, y, z = (one.in_frame * one.in_joint.inverse() * data.oMi[one.joint].inverse()).act(point).tolist()
        return x, y, z

    def turn(one: CarriedShape, direction: Array) -> Vector:
        axes = (data.oMi[one.joint] * one.in_joint * one.in_frame.inverse()).rotation
        x, y, z = (axes.T @ direction).tolist()
        return x, y, z

    def body(one: CarriedShape) -> int | None:
        return one.frame or None

    def tip(one: CarriedShape, point: Array, surface: Surface) -> Contact:
        return replace(
            basis, frame=one.frame, offset=place(one, point), radius=one.shape.radius, plane=surface
        )

    def plane(one: CarriedShape, point: Array, outward: Array) -> Plane:
        return Plane(place(one, point), turn(one, outward), body=body(one), name=one.name)

    def ball(one: CarriedShape, point: Array) -> Sphere:
        return Sphere(place(one, point), one.shape.radius, body=body(one), name=one.name)

    def line(one: CarriedShape, point: Array, along: Array, outward: Array) -> dict[str, Any]:
        return {
            "point": place(one, point),
            "line": turn(one, along),
            "normal": turn(one, outward),
            "radius": one.shape.radius,
            "body": body(one),
            "name": one.name,
        }

    instant = tip(a, touch.point, plane(b, touch.other + radius_b * normal, normal))
    lasting, swapped = None, False
    if touch.kind == "vertex-face":
        lasting = instant
    elif touch.kind == "face-vertex":
        lasting, swapped = tip(b, touch.other, plane(a, touch.point, -normal)), True
    elif touch.kind == "edge-edge":
        along_a, along_b = _along(placed[0], touch.features[0]), _along(placed[1], touch.features[1])
        if cross(along_a, along_b) @ normal < 0.0:
            along_b = -along_b
        edge = Edge(**line(b, touch.other, along_b, normal))
        lasting = replace(tip(a, touch.point, edge), axis=turn(a, along_a))
    elif radius_a + radius_b > 0.0 and touch.kind == "vertex-edge":
        lasting = tip(
            a, touch.point, Line(**line(b, touch.other, _along(placed[1], touch.features[1]), normal))
        )
    elif radius_a + radius_b > 0.0 and touch.kind == "edge-vertex":
        along = _along(placed[0], touch.features[0])
        lasting, swapped = tip(b, touch.other, Line(**line(a, touch.point, along, -normal))), True
    elif radius_b > 0.0:
        lasting = tip(a, touch.point, ball(b, touch.other))
    elif radius_a > 0.0:
        lasting, swapped = tip(b, touch.other, ball(a, touch.point)), True
    return PointContact(touch, instant, lasting, swapped)


def _along(placed: PlacedShape, edge: int) -> Array:
    """Return the unit direction of an edge."""
    first, last = placed.vertices[placed.shape.edges[edge]]
    return np.asarray((last - first) / np.linalg.norm(last - first))


TIE = 4e-12
"""Tolerance for features that touch together, relative to the shapes' size."""


def touching_points(robot: Any, data: pin.Data, q: ArrayLike, contact: Contact) -> list[Contact]:
    """Return the contacts of single points for the closest points of two shapes at a configuration.

    Args:
        robot: The RobotWrapper.
        data: Its data; ``data.oMi`` and ``data.liMi`` change.
        q: (nq,) configuration.
        contact: The contact of two shapes.
    """
    pair = shape_pair(robot, contact)
    model = model_of(robot)
    cache = data_cache(model, data)
    cache.forward_kinematics(model, data, checked_configuration(cache, model, q))
    placed = pair.placed(data)
    found = gap(*placed)
    size = pair.a.shape.reach + pair.b.shape.reach
    points = touches(*placed, found.normal, TIE * size + max(found.value, 0.0))
    return [point_contact(pair, data, placed, found.normal, touch, pair.basis).instant for touch in points]
