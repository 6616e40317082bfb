"""How a corner of the patch of two convex shapes moves with the configuration. (derivatives.md, 12)"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.convex_pair import Touch
from ..geometry.convex_shape import PlacedShape
from ..geometry.tolerances import COINCIDE
from ._kernels import configuration_slopes as places
from .contact import Contact
from .placed_robot import PlacedRobot
from .shape_pair import ShapePair, closest_points, point_contact

Array = NDArray[np.float64]

ON_FACE = 1e-9
"""One minus the cosine between a normal and that of a face which it is."""


class Corner(NamedTuple):
    """A corner of a patch, where it was found.

    Attributes:
        pair: The shapes.
        normal: (3,) from the second one to the first.
        point, other: (3,) on the first and on the second, in the world.
    """

    pair: ShapePair
    normal: Array
    point: Array
    other: Array

    def contact(self, data: pin.Data, basis: Contact) -> Contact:
        """Return it as a contact of a point on a plane, at the configuration of `data`."""
        a, b, n = self.pair.a.shape, self.pair.b.shape, self.normal
        touch = Touch("vertex-face", self.point + a.radius * n, self.other - b.radius * n, (0, 0))
        return point_contact(self.pair, data, (), n, touch, basis).instant

    def follow(self, data: pin.Data, columns: Array, shifts: Array) -> bool:
        """Set in `shifts` how the corner and the normal move, which those of that contact fix to the shapes.

        Args:
            data: With joint placements up to date.
            columns: (6, nv) motions of the joints, at the origin of the world.
            shifts: (nv, SHIFT) of the contact, see `configuration_slopes`.

        Returns:
            Whether it is a vertex on an edge of the other shape, so that it moves in another way to one side.

        Raises:
            InputError: A rounded shape in contact with an edge or a corner: its motion is not known.
        """
        a, b = self.pair.placed(data)
        of_a, of_b = (_motions(columns, shifts[:, flag]) for flag in (places.TIP, places.CARRIER))
        n, point = self.normal, self.point + a.shape.radius * self.normal
        other = self.other - b.shape.radius * self.normal
        moved: Array | None = None
        if _is_of_face(b, n):
            moved, turn = _over_face(a, of_a, point, b, of_b, other, n), np.cross(of_b[1], n)
        elif _is_of_face(a, -n):
            moved, turn = _over_face(b, of_b, other, a, of_a, point, -n), np.cross(of_a[1], n)
            if moved is not None:  # the point of A is the foot of that of B on its face
                apart = moved - _at(of_a, other)
                moved = _at(of_a, point) + apart - np.outer(apart @ n, n)
        elif a.shape.radius + b.shape.radius == 0.0:
            moved, turn = _of_edges(a, of_a, point, b, of_b, other, n)
        if moved is None:
            raise InputError(
                f"sensitivities: {self.pair.contact.label!r} is of a rounded shape and an edge or a corner, "
                "where they are not known in time steps",
                field="sensitivities",
            )
        shifts[:, :3] = moved
        shifts[:, places.TURN : places.TURN + 3] = np.cross(n, turn)
        ends = (a, point, b, other), (b, other, a, point)
        return any(_is_vertex(one, at) and _edge_at(two, foot) is not None for one, at, two, foot in ends)


def closest_corners(robot: Any, data: pin.Data, q: Array, pair: ShapePair) -> list[tuple[Corner, Contact]]:
    """Return where two shapes are closest, with the contact at each place; none where features meet.

    Args:
        robot: The robot or its model.
        data: Its data; ``data.oMi`` is up to date afterwards.
        q: (nq,) configuration.
        pair: The two shapes.
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


def _at(motions: tuple[Array, Array], point: Array) -> Array:
    """Return the velocities (nv, 3) of a point."""
    return np.asarray(motions[0] + np.cross(motions[1], point))


def _is_of_face(shape: PlacedShape, normal: Array) -> bool:
    return len(shape.shape.faces) > 0 and bool((shape.normals @ normal).max() > 1.0 - ON_FACE)


def _is_vertex(shape: PlacedShape, point: Array) -> bool:
    distances = np.linalg.norm(shape.vertices - point, axis=1)
    return bool(distances.min() <= _NEAR * COINCIDE * shape.shape.reach)


def _edge_at(shape: PlacedShape, point: Array) -> Array | None:
    """Return the direction (3,) of an edge on which a point is, None if there is none."""
    ends = shape.vertices[shape.shape.edges]
    along = ends[:, 1] - ends[:, 0]
    off = np.cross(point - ends[:, 0], along / np.linalg.norm(along, axis=1)[:, None])
    distances = np.linalg.norm(off, axis=1)
    k = int(np.argmin(distances))
    if distances[k] > _NEAR * COINCIDE * shape.shape.reach:
        return None
    return np.asarray(along[k] / np.linalg.norm(along[k]))


_NEAR = 1e3
"""Distances of corners from edges and vertices, which come from some operations, in parts of `COINCIDE`."""


def _over_face(
    a: PlacedShape,
    of_a: tuple[Array, Array],
    point: Array,
    b: PlacedShape,
    of_b: tuple[Array, Array],
    other: Array,
    normal: Array,
) -> Array | None:
    """Return how a corner of A's face within the sides of B's moves, (nv, 3); `other` is its foot on B."""
    moved = _at(of_a, point)
    if _is_vertex(a, point):
        return moved
    if _is_vertex(b, other):
        facing = a.normals[int(np.argmin(a.normals @ normal))]
        carried = _at(of_b, point)  # along the normal with the face of A
        return carried + np.outer((moved - carried) @ facing / (facing @ normal), normal)
    edge, side = _edge_at(a, point), _edge_at(b, other)
    if edge is None or side is None:
        return None
    outward = np.cross(side, normal)
    return moved + np.outer((_at(of_b, point) - moved) @ outward / (edge @ outward), edge)


def _of_edges(
    a: PlacedShape,
    of_a: tuple[Array, Array],
    point: Array,
    b: PlacedShape,
    of_b: tuple[Array, Array],
    other: Array,
    normal: Array,
) -> tuple[Array | None, Array]:
    """Return how the point of A closest to an edge of B moves, and how their normal changes, (nv, 3)."""
    one, two = _edge_at(a, point), _edge_at(b, other)
    if one is None or two is None:
        return None, np.zeros_like(of_a[0])
    cross = np.cross(one, two)
    bent = np.cross(np.cross(of_a[1], one), two) + np.cross(one, np.cross(of_b[1], two))
    bent *= np.sign(cross @ normal) / np.linalg.norm(cross)
    bent -= np.outer(bent @ normal, normal)
    # the points move by s and t along their edges, so that they stay opposite each other along the normal
    moved, gap = _at(of_a, point), float((point - other) @ normal)
    apart = _at(of_b, other) - moved + gap * bent
    shares = np.linalg.lstsq(np.column_stack([one, -two]), apart.T, rcond=None)[0]
    return moved + np.outer(shares[0], one), bent
