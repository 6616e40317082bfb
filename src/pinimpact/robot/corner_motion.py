"""How a corner of the patch of two convex shapes moves with the configuration. (derivatives.md, 12)"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import InputError
from ..geometry.convex_pair import Touch
from ..geometry.convex_shape import PlacedShape
from ..geometry.tolerances import COINCIDE, FACE
from ._kernels import configuration_slopes as places
from .contact import Contact
from .placed_robot import PlacedRobot
from .shape_pair import ShapePair, closest_points, point_contact


class Corner(NamedTuple):
    """A corner of a patch, where it was found."""

    pair: ShapePair
    normal: Array  # (3,) from the second one to the first
    point: Array  # (3,) on the first and on the second, in the world
    other: Array

    def contact(self, data: pin.Data, basis: Contact) -> Contact:
        """Return it as a contact of a point on a plane, at the configuration of `data`."""
        a, b, n = self.pair.a.shape, self.pair.b.shape, self.normal
        touch = Touch("vertex-face", self.point + a.radius * n, self.other - b.radius * n, (0, 0))
        return point_contact(self.pair, data, (), n, touch, basis).instant

    def follow(self, data: pin.Data, columns: Array, shifts: Array) -> bool:
        """Set in `shifts` how the corner and the normal move, which those of that contact fix to the shapes.

        Given columns (6, nv), the motions of the joints at the origin of the world, and shifts (nv, SHIFT) of
        the contact, see `configuration_slopes`; joint placements of `data` are up to date. Returns whether it
        is a vertex on an edge of the other shape, so that it moves in another way to one side. Raises
        `InputError` for a rounded shape in contact with an edge or a corner: its motion is not known.
        """
        a, b = self.pair.placed(data)
        n = self.normal
        one = _Side(a, _motions(columns, shifts[:, places.TIP]), self.point + a.shape.radius * n)
        two = _Side(b, _motions(columns, shifts[:, places.CARRIER]), self.other - b.shape.radius * n)
        moved: Array | None = None
        if one.rests_on(two, n):
            moved, turn = _over_face(one, two, n), np.cross(two.motions[1], n)
        elif two.rests_on(one, -n):
            moved, turn = _over_face(two, one, -n), np.cross(one.motions[1], n)
            if moved is not None:  # the point of A is the foot of that of B on its face
                apart = moved - one.moves(two.point)
                moved = one.moves(one.point) + apart - np.outer(apart @ n, n)
        elif a.shape.radius + b.shape.radius == 0.0:
            moved, turn = _of_edges(one, two, n)
        if moved is None:
            raise InputError(
                f"sensitivities: {self.pair.contact.label!r} is of a rounded shape and an edge or a corner, "
                "where they are not known in time steps"
            )
        shifts[:, :3] = moved
        shifts[:, places.TURN : places.TURN + 3] = np.cross(n, turn)
        return any(s.at_vertex and o.edge is not None for s, o in ((one, two), (two, one)))


def closest_corners(robot: Any, data: pin.Data, q: Array, pair: ShapePair) -> list[tuple[Corner, Contact]]:
    """Return where two shapes are closest at q (nq,), with the contact there; none where features meet.

    Afterwards ``data.oMi`` is up to date.
    """
    places = closest_points(robot, data, q, pair)
    found, placed = [], PlacedRobot(robot, data, q)
    for touch, instant, lasting, _ in (place[0] for place in places if len(place) == 1):
        if lasting is None:
            continue
        n = placed.geometry(instant).axes[2]
        ends = touch.point - pair.a.shape.radius * n, touch.other + pair.b.shape.radius * n
        found.append((Corner(pair, n, *ends), instant))
    return found


def _motions(columns: Array, carried: Array) -> tuple[Array, Array]:
    """Return linear and angular motions (nv, 3) of what some joints carry."""
    return (carried * columns[:3]).T, (carried * columns[3:]).T


class _Side(NamedTuple):
    """One of the shapes at a corner."""

    placed: PlacedShape
    motions: tuple[Array, Array]  # of the joints that carry it
    point: Array  # (3,) of its core at the corner

    def moves(self, point: Array) -> Array:
        """Return the velocities (nv, 3) of a point that moves with it."""
        return np.asarray(self.motions[0] + np.cross(self.motions[1], point))

    def rests_on(self, other: _Side, normal: Array) -> bool:
        """Whether a normal is that of a face of the other shape."""
        faces = other.placed
        return len(faces.shape.faces) > 0 and bool((faces.normals @ normal).max() > FACE)

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
        off = np.cross(self.point - ends[:, 0], along / np.linalg.norm(along, axis=1)[:, None])
        distances = np.linalg.norm(off, axis=1)
        k = int(np.argmin(distances))
        if distances[k] > self._near:
            return None
        return np.asarray(along[k] / np.linalg.norm(along[k]))


_NEAR = 1e3
"""Distances of corners from edges and vertices, which come from some operations, in parts of `COINCIDE`."""


def _over_face(a: _Side, b: _Side, normal: Array) -> Array | None:
    """Return how a corner of A's face within the sides of B's moves, (nv, 3); B's point is its foot on B."""
    moved = a.moves(a.point)
    if a.at_vertex:
        return moved
    carried = b.moves(a.point)
    if b.at_vertex:  # along the normal with the face of A
        facing = a.placed.normals[int(np.argmin(a.placed.normals @ normal))]
        return carried + np.outer((moved - carried) @ facing / (facing @ normal), normal)
    edge, side = a.edge, b.edge
    if edge is None or side is None:
        return None
    outward = np.cross(side, normal)
    return moved + np.outer((carried - moved) @ outward / (edge @ outward), edge)


def _of_edges(a: _Side, b: _Side, normal: Array) -> tuple[Array | None, Array]:
    """Return how the point of A closest to an edge of B moves, and how their normal changes, (nv, 3)."""
    one, two = a.edge, b.edge
    if one is None or two is None:
        return None, np.zeros_like(a.motions[0])
    cross = np.cross(one, two)
    bent = np.cross(np.cross(a.motions[1], one), two) + np.cross(one, np.cross(b.motions[1], two))
    bent *= np.sign(cross @ normal) / np.linalg.norm(cross)
    bent -= np.outer(bent @ normal, normal)
    # the points move by s and t along their edges, so that they stay opposite each other along the normal
    moved, gap = a.moves(a.point), float((a.point - b.point) @ normal)
    apart = b.moves(b.point) - moved + gap * bent
    shares = np.linalg.lstsq(np.column_stack([one, -two]), apart.T, rcond=None)[0]
    return moved + np.outer(shares[0], one), bent
