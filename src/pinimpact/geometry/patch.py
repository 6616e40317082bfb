"""The contact patch of two convex shapes: its corners, each with its own gap.

With a face as the reference, the corners are those of the other shape's face, clipped by the sides of the
reference face (Sutherland and Hodgman 1974), and their gaps are heights over its plane: they vary smoothly as
the faces tilt. For edges, points or round shapes, and beyond the sides of a face, the closest points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDING, TINY
from ..arrays import Array, Bools, Integers
from ._kernels.constants import EDGE, LINE, PLANE, TIP_PLANE
from .convex_pair import CODES, Gap, gap, nearest_features
from .convex_shape import PlacedShape, coincidence, cross
from .tolerances import FACE, LOCAL, TIE


class Patch(NamedTuple):
    """Opposite points of two shapes."""

    normal: Array  # (3,) from the second shape to the first
    points: Array  # (k, 3) of the first shape [m]
    others: Array  # (k, 3) of the second, opposite to them
    gaps: Array  # (k,) between them along the normal [m], negative where the shapes overlap
    kinds: Integers  # (k,) codes of the features in contact, see `box_patch`
    edges: Array  # (2, 3) unit directions of the edges in contact of the two shapes, if any


def patch(a: PlacedShape, b: PlacedShape, within: float) -> Patch | None:
    """Return the contact patch of two shapes within a distance [m], None if they are apart."""
    found = gap(a, b)
    return None if found.value > within else patch_along(a, b, found, within)


def patch_along(a: PlacedShape, b: PlacedShape, found: Gap, within: float) -> Patch | None:
    """Return the contact patch of two shapes along the direction of their gap or overlap; see `patch`."""
    normal = found.normal
    facing_a = -a.normals @ normal if len(a.shape.faces) else np.zeros(0)
    facing_b = b.normals @ normal if len(b.shape.faces) else np.zeros(0)
    best_a, best_b = facing_a.max(initial=0.0), facing_b.max(initial=0.0)
    if max(best_a, best_b) >= FACE:
        if best_b >= best_a - TIE:
            faces = _on_face(a, b, int(np.argmax(facing_b)), within, facing_a, PLANE)
        else:
            faces = _on_face(b, a, int(np.argmax(facing_a)), within, facing_b, TIP_PLANE)
            if faces is not None:
                faces = Patch(-faces.normal, faces.others, faces.points, *faces[3:])
        if faces is not None:
            return faces
    if max(best_a, best_b) >= FACE or not (len(a.shape.edges) and len(b.shape.edges)):
        return _at_closest_points(a, b, found, within)
    kind, edges = PLANE, np.zeros((2, 3))
    pair = _foremost_edge(a, -normal), _foremost_edge(b, normal)
    *ends, crosses = _nearest_of_edges(*pair)
    if crosses:
        kind, edges = EDGE, _directions(np.array([one[1] - one[0] for one in pair]), normal)
    return _of_one_point(a, b, normal, ends, kind, edges)


def _at_closest_points(a: PlacedShape, b: PlacedShape, found: Gap, within: float) -> Patch | None:
    """Return the patch of a ball, or of a shape beyond the sides of a face; None if the cores overlap."""
    normal, radius = found.normal, a.shape.radius + b.shape.radius
    if found.value + radius < 0.0:
        return None
    every = nearest_features(a, b, normal, LOCAL)
    touch = min(every, key=lambda one: float(np.linalg.norm(one.point - one.other)))
    between = touch.point - touch.other
    length = float(np.linalg.norm(between))
    if length - radius > within:
        return None
    if length > coincidence(a.shape, b.shape):
        normal = between / length
    code = CODES.get(touch.kind, PLANE)
    edges = _directions(touch.edges(a, b), normal) if code in (LINE, EDGE) else np.zeros((2, 3))
    return _of_one_point(a, b, normal, [touch.point, touch.other], code, edges)


def _of_one_point(
    a: PlacedShape, b: PlacedShape, normal: Array, ends: list[Array], kind: int, edges: Array
) -> Patch:
    """Return the patch of one point; `ends` are those of the cores of A and B."""
    points, others = (ends[0] - a.shape.radius * normal)[None], (ends[1] + b.shape.radius * normal)[None]
    return Patch(normal, points, others, (points - others) @ normal, np.array([kind]), edges)


def _foremost_edge(shape: PlacedShape, direction: Array) -> Array:
    """Return the ends (2, 3) of the extreme edge along a direction."""
    heights = shape.vertices @ direction
    edges = shape.shape.edges
    return shape.vertices[edges[int(np.argmax(heights[edges].sum(axis=1)))]]


def _directions(edges: Array, normal: Array) -> Array:
    """Return the unit directions (2, 3) of edges, u × e of two along the normal; zeros stay zeros."""
    found = edges / np.maximum(np.linalg.norm(edges, axis=1), TINY)[:, None]
    found[0] *= np.copysign(1.0, cross(found[0], found[1]) @ normal)
    return np.asarray(found)


def _nearest_of_edges(first: Array, second: Array) -> tuple[Array, Array, bool]:
    """Return the closest points of two segments, each (2, 3), and whether they are within both."""
    u, w, r = first[1] - first[0], second[1] - second[0], first[0] - second[0]
    uu, uw, ww, ur, wr = u @ u, u @ w, w @ w, u @ r, w @ r
    determinant = uu * ww - uw * uw
    s = min(max((uw * wr - ww * ur) / determinant, 0.0), 1.0) if determinant > ROUNDING * uu * ww else 0.5
    t = min(max((uw * s + wr) / ww, 0.0), 1.0)
    s = min(max((uw * t - ur) / uu, 0.0), 1.0)
    within = determinant > ROUNDING * uu * ww and 0.0 < s < 1.0 and 0.0 < t < 1.0
    return first[0] + s * u, second[0] + t * w, within


def _on_face(
    a: PlacedShape, b: PlacedShape, face: int, within: float, facing: Array, kind: int
) -> Patch | None:
    """Return the patch of a shape A over a face of another, with gaps up to `within` [m].

    `facing` are cosines of the angles at which the faces of A face that face, empty if A has none; `kind` is
    the code of points of A on that face.
    """
    normal = b.normals[face]
    plane = float(b.offsets[face]) + b.shape.radius
    polygon = a.vertices[a.shape.faces[int(np.argmax(facing))]] if len(facing) else a.vertices
    corners = b.vertices[b.shape.faces[face]]
    sides = cross(np.roll(corners, -1, axis=0) - corners, normal)
    tolerance = coincidence(a.shape, b.shape)
    for side, corner in zip(sides, corners, strict=True):
        polygon = _clipped(polygon, side, float(side @ corner), tolerance * float(np.linalg.norm(side)))
        if not len(polygon):
            return None
    apart = np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1) > tolerance
    polygon = polygon[apart] if apart.any() else polygon[:1]
    points = polygon - a.shape.radius * normal
    gaps = points @ normal - plane
    near = gaps <= within
    if not near.any():
        return None
    kinds = np.full(len(polygon), kind)
    if facing.max(initial=0.0) >= 1.0 - TIE:  # parallel faces: the same result whichever is clipped
        of_a, of_b = (_among(polygon, ends, normal, tolerance) for ends in (a.vertices, corners))
        kinds[~of_a] = PLANE
        kinds[of_b & ~of_a] = TIP_PLANE if kind == PLANE else PLANE
    points, gaps = points[near], gaps[near]
    return Patch(normal, points, points - gaps[:, None] * normal, gaps, kinds[near], np.zeros((2, 3)))


def _among(points: Array, others: Array, normal: Array, distance: float) -> Bools:
    """Return which points (k, 3) coincide with one of `others` after projection along a normal."""
    apart = points[:, None] - others
    apart -= (apart @ normal)[:, :, None] * normal
    return np.asarray((np.linalg.norm(apart, axis=2) <= distance).any(axis=1))


def _clipped(polygon: Array, outward: Array, offset: float, tolerance: float) -> Array:
    """Return the part of a polygon, a segment or a point on the inner side of a plane.

    Points beyond the plane by less than the tolerance lie in it, so that edges in the plane do not cross it.
    """
    heights = polygon @ outward - offset
    heights[(heights > 0.0) & (heights <= tolerance)] = 0.0
    inside = heights <= 0.0
    if inside.all():
        return polygon
    if not inside.any():
        return polygon[:0]
    kept: list[Array] = []
    count = len(polygon)
    for k in range(count):
        following = (k + 1) % count
        if inside[k]:
            kept.append(polygon[k])
        if inside[k] != inside[following] and not (count == 2 and k == 1):
            share = heights[k] / (heights[k] - heights[following])
            kept.append(polygon[k] + share * (polygon[following] - polygon[k]))
    return np.array(kept)
