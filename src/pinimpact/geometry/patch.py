"""The contact patch of two convex shapes: its corners, each with its own gap.

With a face as the reference, the corners are those of the other shape's face, clipped by the sides of the
reference face (Sutherland and Hodgman 1974), and their gaps are heights over its plane: they vary smoothly as
the faces tilt. For edges, points or round shapes, the closest points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..arrays import Array
from .convex_pair import gap, touches
from .convex_shape import PlacedShape, cross
from .tolerances import COINCIDE, FACE, NEAREST


class Patch(NamedTuple):
    """Opposite points of two shapes."""

    normal: Array  # (3,) from the second shape to the first
    points: Array  # (k, 3) of the first shape [m]
    others: Array  # (k, 3) of the second, opposite to them
    gaps: Array  # (k,) between them along the normal [m], negative where the shapes overlap


def patch(a: PlacedShape, b: PlacedShape, within: float) -> Patch | None:
    """Return the contact patch of two shapes within a distance [m], None if they are apart."""
    found = gap(a, b)
    if found.value > within:
        return None
    normal = found.normal
    facing_a = -a.normals @ normal if len(a.shape.faces) else np.zeros(0)
    facing_b = b.normals @ normal if len(b.shape.faces) else np.zeros(0)
    best_a, best_b = facing_a.max(initial=0.0), facing_b.max(initial=0.0)
    if max(best_a, best_b) >= FACE:
        if best_b >= best_a:
            face = int(np.argmax(facing_b))
            return _on_face(a, b, face, within, facing_a)
        mirrored = _on_face(b, a, int(np.argmax(facing_a)), within, facing_b)
        if mirrored is None:
            return None
        return Patch(-mirrored.normal, mirrored.others, mirrored.points, mirrored.gaps)
    if len(a.shape.edges) and len(b.shape.edges):
        near = [_nearest_of_edges(_foremost_edge(a, -normal), _foremost_edge(b, normal))]
    else:  # a ball against anything
        size = a.shape.reach + b.shape.reach
        found_points = touches(a, b, normal, NEAREST * size + abs(found.value))
        near = [(touch.point, touch.other) for touch in found_points]
    if not near:
        return None
    points = np.array([point for point, _ in near]) - a.shape.radius * normal
    others = np.array([other for _, other in near]) + b.shape.radius * normal
    return Patch(normal, points, others, (points - others) @ normal)


def _foremost_edge(shape: PlacedShape, direction: Array) -> Array:
    """Return the ends (2, 3) of the extreme edge along a direction."""
    heights = shape.vertices @ direction
    edges = shape.shape.edges
    return shape.vertices[edges[int(np.argmax(heights[edges].sum(axis=1)))]]


def _nearest_of_edges(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the closest points of two segments, each (2, 3)."""
    u, w, r = first[1] - first[0], second[1] - second[0], first[0] - second[0]
    uu, uw, ww, ur, wr = u @ u, u @ w, w @ w, u @ r, w @ r
    determinant = uu * ww - uw * uw
    s = min(max((uw * wr - ww * ur) / determinant, 0.0), 1.0) if determinant > ROUNDING * uu * ww else 0.5
    t = min(max((uw * s + wr) / ww, 0.0), 1.0)
    s = min(max((uw * t - ur) / uu, 0.0), 1.0)
    return first[0] + s * u, second[0] + t * w


def _on_face(a: PlacedShape, b: PlacedShape, face: int, within: float, facing: Array) -> Patch | None:
    """Return the patch of a shape A over a face of another, with gaps up to `within` [m].

    `facing` has how much each face of A faces that face; it is empty where A has none.
    """
    normal = b.normals[face]
    plane = float(b.offsets[face]) + b.shape.radius
    polygon = a.vertices[a.shape.faces[int(np.argmax(facing))]] if len(facing) else a.vertices
    corners = b.vertices[b.shape.faces[face]]
    sides = cross(np.roll(corners, -1, axis=0) - corners, normal)
    for side, corner in zip(sides, corners, strict=True):
        polygon = _clipped(polygon, side, float(side @ corner))
        if not len(polygon):
            return None
    apart = np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1) > COINCIDE * a.shape.reach
    polygon = polygon[apart] if apart.any() else polygon[:1]
    points = polygon - a.shape.radius * normal
    gaps = points @ normal - plane
    near = gaps <= within
    if not near.any():
        return None
    points, gaps = points[near], gaps[near]
    return Patch(normal, points, points - gaps[:, None] * normal, gaps)


def _clipped(polygon: Array, outward: Array, offset: float) -> Array:
    """Return the part of a polygon, a segment or a point on the inner side of a plane."""
    heights = polygon @ outward - offset
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
