"""Motion of a corner of the patch of two convex shapes with the configuration. (derivatives.md, 12)"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import InputError
from ..geometry._kernels.constants import PLANE, SPHERE, TIP_PLANE
from ..geometry.convex_pair import CODES, Touch
from ..geometry.convex_shape import PlacedShape
from ..geometry.tolerances import COINCIDE, FACE
from ._kernels import configuration_slopes as places
from .contact import Contact
from .placed_robot import PlacedRobot
from .shape_pair import ShapePair, closest_points, feature_contact, point_contact


class Corner(NamedTuple):
    """A corner of a patch at one configuration."""

    pair: ShapePair
    normal: Array  # (3,) from the second shape to the first
    point: Array  # (3,) on the first shape, in world axes
    other: Array  # (3,) on the second shape
    kind: int  # code of the features in contact: `PLANE` on a face of the second, `TIP_PLANE` of the first
    edges: Array  # (2, 3) directions of the edges in contact of the two shapes, if any

    @property
    def on_face(self) -> bool:
        """Whether it is on a face of one of the shapes; otherwise its features determine its position."""
        return self.kind in (PLANE, TIP_PLANE)

    @property
    def _cores(self) -> tuple[Array, Array]:
        n = self.normal
        return self.point + self.pair.a.shape.radius * n, self.other - self.pair.b.shape.radius * n

    @property
    def _unknown(self) -> InputError:
        return InputError(
            f"sensitivities: not available in time steps for {self.pair.contact.label!r}, whose contact "
            "point is on an edge or a corner; for a ball on an edge, give the ball as the robot's shape"
        )

    def contact(self, data: pin.Data, basis: Contact) -> Contact:
        """Return the corner as a contact of a point of the shape without the face on a plane of the other."""
        p, q = self._cores
        if self.kind == TIP_PLANE:
            p = p + self.other - self.point
        touch = Touch("vertex-face", p, q, (0, 0))
        return point_contact(self.pair, data, (), self.normal, touch, basis).instant

    def carried(self, data: pin.Data, basis: Contact) -> Contact:
        """Return the contact of its features; its tip is on the second shape for a face of the first.

        Raises `InputError` for a ball on a corner.
        """
        if self.kind == SPHERE and self.pair.b.shape.radius == 0.0:
            raise self._unknown
        return feature_contact(self.pair, data, self.normal, self._cores, self.kind, self.edges, basis)

    def follow(self, data: pin.Data, columns: Array, shifts: Array) -> tuple[Array, bool]:
        """Set in `shifts` the motion of a corner on a face and of the normal, which `contact` takes as fixed.

        The normal is that of either face: of nearly parallel ones it need not be that of `kind`.

        Args:
            data: Data of the robot with up-to-date joint placements.
            columns: (6, nv) joint Jacobian at the origin of the world.
            shifts: (nv, SHIFT) of `configuration_slopes`, for `contact`; is updated.

        Returns:
            (nv,) changes of the gap in addition to those by the Jacobian, as the corner moves over a face
            with a different normal; and whether the corner is a vertex on an edge of the other shape, so that
            its motion differs by side.

        Raises:
            InputError: The motion of the features is not known.
        """
        a, b = self.pair.placed(data)
        n = self.normal
        p, q = self._cores
        one = _Side(a, _motions(columns, shifts[:, places.TIP]), p)
        two = _Side(b, _motions(columns, shifts[:, places.CARRIER]), q)
        moved = _over_face(one, two, n) if self.kind == PLANE else _over_face(two, one, -n)
        if moved is None:
            raise self._unknown
        face, opposite, turning, radius = two.facing(n), -one.facing(-n), two, a.shape.radius
        opens = moved - two.moves(q)
        if self.kind == TIP_PLANE:
            face, opposite, turning, radius = opposite, face, one, -b.shape.radius
            opens = one.moves(p) - moved
        if np.linalg.norm(opposite - n) < np.linalg.norm(face - n):
            turning = one if turning is two else two
        turn = turning.motions[1] @ pin.skew(n)
        shifts[:, :3] = moved - radius * turn
        shifts[:, places.TURN : places.TURN + 3] = -turn @ pin.skew(n)
        slides = opens @ face / (face @ n) - (one.moves(p) - two.moves(q)) @ n
        return slides, any(s.at_vertex and o.edge is not None for s, o in ((one, two), (two, one)))


def closest_corners(robot: Any, data: pin.Data, q: Array, pair: ShapePair) -> list[tuple[Corner, Contact]]:
    """Return the closest points of two shapes at q (nq,) as corners, with their contacts.

    Places where several features are in contact are left out. Afterwards ``data.oMi`` is up to date.
    """
    places = closest_points(robot, data, q, pair)
    found, placed = [], PlacedRobot(robot, data, q)
    for touch, instant, lasting, *_ in (place[0] for place in places if len(place) == 1):
        if lasting is None or touch.kind not in CODES:
            continue
        n = placed.geometry(instant).axes[2]
        ends = touch.point - pair.a.shape.radius * n, touch.other + pair.b.shape.radius * n
        features = CODES[touch.kind], touch.edges(*pair.placed(data))
        found.append((Corner(pair, n, *ends, *features), instant))
    return found


def _motions(columns: Array, carried: Array) -> tuple[Array, Array]:
    """Return linear and angular motions (nv, 3) of the bodies that the velocities `carried` (nv,) move."""
    return (carried * columns[:3]).T, (carried * columns[3:]).T


class _Side(NamedTuple):
    """One of the shapes at a corner."""

    placed: PlacedShape
    motions: tuple[Array, Array]  # of the joints that carry it
    point: Array  # (3,) of its core at the corner

    def moves(self, point: Array) -> Array:
        """Return the velocities (nv, 3) of a point that moves with it."""
        return np.asarray(self.motions[0] + self.motions[1] @ pin.skew(point))

    def facing(self, normal: Array) -> Array:
        """Return the outward normal (3,) of its face closest to a direction; the direction without faces."""
        normals = self.placed.normals
        return np.asarray(normals[int(np.argmax(normals @ normal))]) if len(normals) else normal

    @property
    def _near(self) -> float:
        return _NEAR * COINCIDE * self.placed.shape.reach

    @property
    def at_vertex(self) -> bool:
        """Whether the corner is a vertex of it."""
        distances = np.linalg.norm(self.placed.vertices - self.point, axis=1)
        return bool(distances.min() <= self._near)

    @property
    def edge(self) -> Array | None:
        """The direction (3,) of an edge on which the corner is, None if there is none."""
        ends = self.placed.vertices[self.placed.shape.edges]
        if len(ends) == 0:  # a ball
            return None
        along = ends[:, 1] - ends[:, 0]
        arms, along = self.point - ends[:, 0], along / np.linalg.norm(along, axis=1)[:, None]
        distances = np.linalg.norm(arms - (arms * along).sum(axis=1)[:, None] * along, axis=1)
        k = int(np.argmin(distances))
        if distances[k] > self._near:
            return None
        return np.asarray(along[k])


_NEAR = 1e3
"""Tolerance of computed distances of corners from edges and vertices, over `COINCIDE`."""


def _over_face(a: _Side, b: _Side, normal: Array) -> Array | None:
    """Return the motion (nv, 3) of a corner of A's face clipped by B's; B's point is its projection.

    None if the normal is not that of a face of B, as for an edge on a ball, or the corner is not on an edge.
    """
    if not len(b.placed.shape.faces) or (b.placed.normals @ normal).max() <= FACE:
        return None
    moved = a.moves(a.point)
    if a.at_vertex:
        return moved
    carried = b.moves(a.point)
    if b.at_vertex:  # along the normal it moves with the face of A
        facing = a.facing(-normal)
        return carried + np.outer((moved - carried) @ facing / (facing @ normal), normal)
    edge, side = a.edge, b.edge
    if edge is None or side is None:
        return None
    outward = pin.skew(side) @ normal
    return moved + np.outer((carried - moved) @ outward / (edge @ outward), edge)
