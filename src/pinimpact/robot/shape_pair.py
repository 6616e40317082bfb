"""A contact of two convex shapes, and its contact points as contacts of single points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array, with_valid
from ..errors import InputError
from ..geometry._kernels.constants import EDGE, FACE_EDGE, LINE, PLANE, TIP_PLANE
from ..geometry.convex_pair import CODES, Gap, Touch, at_one_place, gap, touches
from ..geometry.convex_shape import PlacedShape, cross
from ..geometry.lines import Edge, FacingEdge, Line
from ..geometry.meeting_edges import last_separated, normal_of_meeting
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface, Vector
from ..geometry.tolerances import NEAREST
from .contact import Contact
from .forest import forward_kinematics
from .names import model_of, motion_signs
from .placed_robot import PlacedRobot
from .solids import CarriedShape, two_shapes

_PLANE = Plane()


@dataclass(frozen=True, eq=False)
class ShapePair:
    """Two convex shapes that can make contact."""

    contact: Contact  # the contact, with its coefficients
    a: CarriedShape  # the shape of the robot; impulses and forces act on it
    b: CarriedShape  # the other shape; normals point from it to `a`

    @property
    def radius(self) -> float:
        """Sum of the radii that round both cores [m]."""
        return self.a.shape.radius + self.b.shape.radius

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
        return self.a.placed(data), self.b.placed(data)

    def normal_of_contact(
        self,
        data: Any,
        normal: Array,
        points: Array,
        slow: float = 0.0,
        depth: float = 0.0,
        close: float = 0.0,
    ) -> tuple[Array, bool]:
        """Return the normal (3,) of A and B in contact at points (k, 3), see `normal_of_meeting`.

        Args:
            data: With ``oMi`` and the velocities ``v`` up to date.
            normal: (3,) one of the separating directions; it is returned itself unless edges or corners meet.
            points: (k, 3) the points of contact, k > 0 [m].
            slow: Speed up to which they do not approach each other [m/s].
            depth: Overlap up to which they stay apart along a direction without approach [m].
            close: Gap or overlap up to which they meet, if it is larger than `CLOSE` [m].
        """

        def approach() -> Array:
            return -self.relative_velocity(data)(points)

        return normal_of_meeting(*self.placed(data), normal, approach, slow, depth, close)

    def overlap(self, data: Any, normal: Array, depth: float) -> Gap:
        """Return the overlap of A and B, which overlap along `normal` (3,) too; see `last_separated`."""
        return last_separated(*self.placed(data), normal, depth, self.relative_velocity(data))

    def relative_velocity(self, data: Any) -> Callable[[Array], Array]:
        """Return the velocity of A's material relative to B's [m/s] as a function of the point [m]."""
        a, b = (data.oMi[side.joint].act(data.v[side.joint]).vector for side in (self.a, self.b))
        linear, angular = np.split(a - b, 2)
        return lambda point: np.asarray(linear + cross(angular, point))


def places(robot: Any, contact: Contact) -> tuple[Contact, ...]:
    """Return a contact for each possible contact point of two shapes.

    They have no position until the shapes touch; see `point_contact`.
    """
    pair = shape_pair(robot, contact)
    count = pair.most_points
    label = contact.label
    first = replace(pair.basis, plane=Plane(name=pair.b.name), pair=contact, name=label)
    return (first, *(_called(first, f"{label} {k + 1}") for k in range(1, count)))


def _called(contact: Contact, name: str) -> Contact:
    """Return a contact with another name, without checking it again."""
    other = copy(contact)
    object.__setattr__(other, "name", name)
    return other


def shape_pair(robot: Any, contact: Contact) -> ShapePair:
    """Return the two shapes of a contact with a `geometry`, and a solid or a sphere as its `plane`.

    Raises `InputError` if there are none, if they are not convex, or if they cannot move relative to each
    other; `UnknownNameError`, with similar names, for an unknown shape.
    """
    a, b = two_shapes(robot, contact.geometry or "", contact.rim_points, contact.plane)
    if not motion_signs(model_of(robot), a.joint, b.joint).any():
        raise InputError(
            f"contacts: {a.name!r} and {b.name!r} cannot move relative to each other: they belong "
            "to the same body",
            value=contact,
        )
    return ShapePair(contact, a, b)


class PointContact(NamedTuple):
    """A contact point of two shapes, as contacts of single points."""

    touch: Touch  # the features in contact
    instant: Contact  # the contact now, a point of A on a plane attached to B: its Jacobian is correct
    lasting: Contact | None  # as long as these features touch; None for two corners, or a corner and an edge
    swapped: bool  # whether the point of `lasting` belongs to B, so that its force acts on B
    met: bool = False  # whether edges or corners have just met, so that the normal depends on the velocity


def point_contact(
    pair: ShapePair,
    data: pin.Data,
    placed: Sequence[PlacedShape],
    normal: Array,
    touch: Touch,
    basis: Contact,
    facing: bool = False,
) -> PointContact:
    """Return the contacts of a contact point of two shapes, at the configuration of `data`.

    The shapes are `placed` there, with a normal (3,) from B to A; the basis has coefficients and name.
    `facing` is whether two edges cross there that bound faces in one plane, see `between_faces`.
    """
    one, other = _Side(pair.a, data, basis), _Side(pair.b, data, basis)
    instant = one.tip(touch.point, other.plane(touch.other, normal))
    swapped, seen = False, touch
    if touch.kind in ("face-vertex", "edge-vertex") or (
        touch.kind == "vertex-vertex" and not other.radius > 0.0
    ):
        swapped, one, other, seen = True, other, one, touch.mirrored
        normal, placed = -normal, placed[::-1]
    kind, p, q, _ = seen
    if kind == "vertex-face" and not swapped:
        return PointContact(touch, instant, instant, False)
    if kind not in ("vertex-face", "edge-edge") and one.radius + other.radius == 0.0:
        return PointContact(touch, instant, None, False)
    lasting = _of_features(
        FACE_EDGE if facing else CODES[kind], one, other, (p, q), normal, seen.edges(*placed)
    )
    return PointContact(touch, instant, lasting, swapped)


def feature_contact(
    pair: ShapePair,
    data: pin.Data,
    normal: Array,
    cores: tuple[Array, Array],
    kind: int,
    edges: Array,
    basis: Contact,
) -> Contact:
    """Return the contact of two shapes with given features in contact, by the code of their kind.

    Its tip is on B for the kind `TIP_PLANE`. `cores` are the points (3,) of the cores, `edges` (2, 3) the
    directions of the edges; other arguments as for `point_contact`.
    """
    one, other = _Side(pair.a, data, basis), _Side(pair.b, data, basis)
    if kind == TIP_PLANE:
        return _of_features(PLANE, other, one, cores[::-1], -normal, edges)
    return _of_features(kind, one, other, cores, normal, edges)


def _of_features(
    kind: int, one: _Side, other: _Side, cores: tuple[Array, Array], normal: Array, edges: Array
) -> Contact:
    """Return the contact of a point or an edge of one side with a face, edge or point of the other."""
    p, q = cores
    if kind == PLANE:
        return one.tip(p, other.plane(q, normal))
    u, w = edges
    if kind in (EDGE, FACE_EDGE):
        u, w = u - (u @ normal) * normal, w - (w @ normal) * normal
        edge = (FacingEdge if kind == FACE_EDGE else Edge)(
            **other.line(q, w if cross(u, w) @ normal > 0.0 else -w, normal)
        )
        return replace(one.tip(p, edge), axis=one.turn(u / np.linalg.norm(u)))
    if kind == LINE:
        return one.tip(p, Line(**other.line(q, w, normal)))
    return one.tip(p, Sphere(other.place(q), other.radius, body=other.body, name=other.shape.name))


class _Side:
    """One of two shapes that touch, and the contacts of points on it."""

    def __init__(self, shape: CarriedShape, data: pin.Data, basis: Contact) -> None:
        self.shape, self._basis = shape, basis
        self.radius, self.body = shape.shape.radius, shape.frame or None
        self._joint, self._in_frame = data.oMi[shape.joint], shape.joint_in_frame

    def place(self, point: Array) -> Vector:
        """Return a point of the world in the axes of the frame."""
        x, y, z = self._in_frame.act(self._joint.actInv(point)).tolist()
        return x, y, z

    def turn(self, direction: Array) -> Vector:
        """Return a direction in the world in the axes of the frame."""
        x, y, z = (self._in_frame.rotation @ (self._joint.rotation.T @ direction)).tolist()
        return x, y, z

    def tip(self, point: Array, surface: Surface) -> Contact:
        """Return the contact of a point of the core with a surface."""
        place, frame = self.place(point), self.shape.frame
        return with_valid(self._basis, frame=frame, offset=place, radius=self.radius, plane=surface)

    def plane(self, point: Array, outward: Array) -> Plane:
        """Return the tangent plane of the shape at a point of its core."""
        place = self.place(point + self.radius * outward)
        given = {"point": place, "normal": self.turn(outward), "body": self.body, "name": self.shape.name}
        return with_valid(_PLANE, **given)

    def line(self, point: Array, along: Array, outward: Array) -> dict[str, Any]:
        """Return the fields of the line along an edge."""
        return {
            "point": self.place(point),
            "line": self.turn(along / np.linalg.norm(along)),
            "normal": self.turn(outward),
            "radius": self.radius,
            "body": self.body,
            "name": self.shape.name,
        }


def closest_points(
    robot: Any, data: pin.Data, q: ArrayLike, pair: ShapePair, v: ArrayLike | None = None
) -> list[list[PointContact]]:
    """Return the closest points of two shapes at q (nq,), each as contacts of all features there.

    If the velocity v (nv,) is given, edges and corners in contact meet with it. (theory.md, 15.3)
    Changes ``data.oMi``, ``data.liMi`` and, with a velocity, ``data.v``.
    """
    at = PlacedRobot(robot, data, q)
    placed = pair.placed(data)
    value, normal = gap(*placed)
    size = pair.a.shape.reach + pair.b.shape.reach
    tolerance = NEAREST * size + abs(value)
    touching = touches(*placed, normal, tolerance)
    if v is not None and touching:
        forward_kinematics(at.model, data, at.q, finite_array("v", v, (at.model.nv,)))
        met, _ = pair.normal_of_contact(data, normal, np.array([touch.point for touch in touching]))
        if met is not normal:
            points = (point_contact(pair, data, placed, met, touch, pair.basis) for touch in touching)
            return [[one._replace(lasting=None, met=True)] for one in points]
    return [
        [
            point_contact(pair, data, placed, normal, one, pair.basis)
            for one in at_one_place(touch, *placed, normal, tolerance)
        ]
        for touch in touching
    ]


def known(place: list[PointContact]) -> PointContact:
    """Return the contact at a place; `lasting` is None if several features are in contact there."""
    return place[0] if len(place) == 1 else place[0]._replace(lasting=None)


def contact_now(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact, pair: ShapePair | None
) -> tuple[Contact, Contact | None, bool, bool]:
    """Return `instant`, `lasting`, `swapped`, `met` of a contact at q (nq,) and v (nv,), see `PointContact`.

    `pair` are its two shapes, if any. `lasting` is None if they touch at several places.
    """
    if pair is None:
        return contact, contact, False, False
    places = closest_points(model, data, q, pair, v)
    _, instant, lasting, swapped, met = known(places[0])
    return instant, lasting if len(places) == 1 else None, swapped, met


def touching_points(
    robot: Any, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact
) -> list[Contact]:
    """Return the contacts of `closest_points` at this instant, for a contact of two shapes."""
    return [place[0].instant for place in closest_points(robot, data, q, shape_pair(robot, contact), v)]
