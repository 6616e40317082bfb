"""Two convex shapes at an instant: their gap, its normal, and their contact points.

The first shape is A, the second B: the normal points from B to A, as from a surface into free space.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .convex_shape import PlacedShape, cross

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CLOSE = 1e-6
"""Part of the shapes' size below which GJK's distance is replaced by one that is exact to rounding."""

COAL_ERROR = 1e-10
"""Part of the shapes' size by which coal's distance may be too large."""

TOUCHING = 1e-9
"""Part of the shapes' size up to which all edges are tried."""

LOCAL = 1e-5
"""Part of a shape's size by which a corner may be behind the extreme one and belong to the closest
feature."""

TIE = 1e-13
"""Tolerance for equal separations, relative to the shapes' size."""

FACING = 0.9
"""Cosine of the angle within which a face faces a direction."""

PARALLEL = 1e-9
"""Sine of the angle below which two edges do not determine a normal."""


class Gap(NamedTuple):
    """The gap of two shapes.

    Attributes:
        value: The gap [m], negative if they overlap.
        normal: (3,) unit vector of the separation, from B to A, in world axes.
    """

    value: float
    normal: Array


class Touch(NamedTuple):
    """A contact point of two shapes, an elementary contact.

    Attributes:
        kind: ``"vertex-face"`` (a vertex of A on a face of B), ``"face-vertex"``, ``"edge-edge"``,
            ``"vertex-edge"``, ``"edge-vertex"`` or ``"vertex-vertex"``, of the cores.
        point: (3,) of A's core, in world axes; for a face, B's point on it.
        other: (3,) of B's core.
        features: Numbers of A's vertex, edge or face and of B's; an edge's is its row in `edges`.
    """

    kind: str
    point: Array
    other: Array
    features: tuple[int, int]


def gap(a: PlacedShape, b: PlacedShape, near: Array | None = None) -> Gap:
    """Return the gap of two shapes, or a lower bound of it if it is not small.

    To rounding up to `CLOSE` of their size; beyond, less than the distance by at most coal's error, which
    makes boxes larger by 1e-10. Cores that are that close and have no radius around them are apart by at
    least the gap, see `separation`.

    Args:
        a: The one shape.
        b: The other.
        near: (3,) a recent direction of separation, if known.
    """
    size = a.shape.reach + b.shape.reach
    radius = a.shape.radius + b.shape.radius
    value, normal = _gjk(a, b)
    if value > CLOSE * size:
        return Gap(value - COAL_ERROR * size, normal)
    if radius > 0.0:
        found = _between_cores(a, b, normal)
        if found is not None:
            return Gap(found.value - radius, found.normal)
    best = separation(a, b, normal if near is None else near)
    if best.value <= max(0.1 * value, TOUCHING * size):  # the edges that hold them apart may be others
        best = max(best, separation(a, b), key=lambda one: one.value)
    return Gap(best.value - radius, best.normal)


def _gjk(a: PlacedShape, b: PlacedShape) -> tuple[float, Array]:
    """Return distance and normal computed by coal: 0 or less if the shapes overlap."""
    import coal

    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-12
    request.enable_signed_distance = False
    result = coal.DistanceResult()
    value = coal.distance(
        a.shape.collision,
        coal.Transform3s(a.rotation, a.translation),
        b.shape.collision,
        coal.Transform3s(b.rotation, b.translation),
        request,
        result,
    )
    return float(value), -np.array(result.normal)


def separation(a: PlacedShape, b: PlacedShape, near: Array | None = None) -> Gap:
    """Return the separation of the cores along the best of the directions of faces and edges.

    It is positive if and only if the cores are apart, and then at most their distance; if negative, it is the
    depth of their overlap. Of equal directions, faces of B precede faces of A, and these pairs of edges.

    Args:
        a: The one shape.
        b: The other.
        near: (3,) a direction along which they are nearly apart, so that only faces and edges there are
            tried; None for all.
    """
    size = a.shape.reach + b.shape.reach
    best, normal = -math.inf, np.array([0.0, 0.0, 1.0])
    outward_b, outward_a = b.normals, -a.normals
    if near is not None:
        outward_b, outward_a = outward_b[outward_b @ near > FACING], outward_a[outward_a @ near > FACING]
    for axes in (outward_b, outward_a, _crossed(a, b, near)[0]):
        if len(axes) == 0:
            continue
        values = (axes @ a.vertices.T).min(axis=1) - (axes @ b.vertices.T).max(axis=1)
        k = int(values.argmax())
        if values[k] > best + TIE * size:
            best, normal = float(values[k]), axes[k]
    return Gap(best, normal)


class Turning(NamedTuple):
    """A separating direction of two cores, and the features that it follows.

    Attributes:
        value: The separation [m].
        normal: (3,) from B to A.
        edges: (2, 3) directions of the edges to which it is perpendicular; None for that of a face.
        of_a: Whether it is the normal of a face of A, else of B.
    """

    value: float
    normal: Array
    edges: Array | None
    of_a: bool


def ties(a: PlacedShape, b: PlacedShape, near: Array) -> list[Turning]:
    """Return the separations along all directions that are as good as the best, for cores in contact.

    Args:
        a: The one shape.
        b: The other.
        near: (3,) a direction along which they are nearly apart.
    """
    crossed, u, w = _crossed(a, b, near)
    axes = np.concatenate([b.normals, -a.normals, crossed])
    values = (axes @ a.vertices.T).min(axis=1) - (axes @ b.vertices.T).max(axis=1)
    best = float(values.max())
    tie = max(TOUCHING * (a.shape.reach + b.shape.reach), 2.0 * abs(best))
    found = []
    for k in np.flatnonzero(values >= best - tie).tolist():
        edge = k - len(b.normals) - len(a.normals)
        edges = np.array([u[edge], w[edge]]) if edge >= 0 else None
        found.append(Turning(float(values[k]), axes[k], edges, k >= len(b.normals)))
    return found


def _crossed(a: PlacedShape, b: PlacedShape, near: Array | None) -> tuple[Array, Array, Array]:
    """Return the (k, 3) directions perpendicular to an edge of each, both ways, and the edges."""
    u = a.directions if near is None else _edges_near(a, near)
    w = b.directions if near is None else _edges_near(b, -near)
    u, w = np.repeat(u, len(w), axis=0), np.tile(w, (len(u), 1))
    normals = cross(u, w)
    lengths = np.linalg.norm(normals, axis=1)
    some = lengths > PARALLEL
    normals, u, w = normals[some] / lengths[some, None], u[some], w[some]
    if near is not None:
        return np.where((normals @ near)[:, None] < 0.0, -normals, normals), u, w
    return np.concatenate([normals, -normals]), np.tile(u, (2, 1)), np.tile(w, (2, 1))


def _edges_near(shape: PlacedShape, normal: Array) -> Array:
    """Return the (k, 3) directions of the edges with an extreme end against a normal."""
    if len(shape.shape.edges) <= 12:
        return shape.directions
    foremost = _foremost(shape, normal, LOCAL)
    edges = shape.shape.edges[foremost[shape.shape.edges].any(axis=1)]
    found = shape.vertices[edges[:, 1]] - shape.vertices[edges[:, 0]]
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def _foremost(shape: PlacedShape, normal: Array, part: float) -> NDArray[np.bool_]:
    """Return which vertices are extreme against a normal, to a part of the shape's size."""
    depth = shape.vertices @ normal
    return np.asarray(depth <= depth.min() + part * shape.shape.reach)


def _between_cores(a: PlacedShape, b: PlacedShape, normal: Array) -> Gap | None:
    """Return the distance of the cores from their closest features along a normal; None if it is zero."""
    touches = nearest_features(a, b, normal, LOCAL)
    if not touches:
        return None
    between = [touch.point - touch.other for touch in touches]
    lengths = [float(np.linalg.norm(difference)) for difference in between]
    k = int(np.argmin(lengths))
    if lengths[k] <= 1e-9 * (a.shape.reach + b.shape.reach) or between[k] @ normal < 0.0:
        return None
    return Gap(lengths[k], between[k] / lengths[k])


def nearest_features(a: PlacedShape, b: PlacedShape, normal: Array, part: float) -> list[Touch]:
    """Return the pairs of features of the cores that face each other along a normal, with their points.

    Only features whose corners are all extreme along the normal, to a part of the shape's size, and only
    pairs whose closest points lie within both.
    """
    mask_a, mask_b = _foremost(a, normal, part), _foremost(b, -normal, part)
    slack = 1e-12 * (a.shape.reach + b.shape.reach)
    found = []
    for i in np.flatnonzero(mask_a):
        p = a.vertices[i]
        for k, face in enumerate(b.shape.faces):
            if mask_b[face].all() and within_face(b, k, p, slack):
                foot = p - (b.normals[k] @ p - b.offsets[k]) * b.normals[k]
                found.append(Touch("vertex-face", p, foot, (int(i), k)))
    for j in np.flatnonzero(mask_b):
        p = b.vertices[j]
        for k, face in enumerate(a.shape.faces):
            if mask_a[face].all() and within_face(a, k, p, slack):
                foot = p - (a.normals[k] @ p - a.offsets[k]) * a.normals[k]
                found.append(Touch("face-vertex", foot, p, (k, int(j))))
    edges_a = [m for m, edge in enumerate(a.shape.edges) if mask_a[edge].all()]
    edges_b = [m for m, edge in enumerate(b.shape.edges) if mask_b[edge].all()]
    for m in edges_a:
        for k in edges_b:
            points = _crossing(a.vertices[a.shape.edges[m]], b.vertices[b.shape.edges[k]])
            if points is not None:
                found.append(Touch("edge-edge", *points, (m, k)))
    for i in np.flatnonzero(mask_a):
        for k in edges_b:
            foot = _foot(a.vertices[i], b.vertices[b.shape.edges[k]])
            if foot is not None:
                found.append(Touch("vertex-edge", a.vertices[i], foot, (int(i), k)))
    for j in np.flatnonzero(mask_b):
        for m in edges_a:
            foot = _foot(b.vertices[j], a.vertices[a.shape.edges[m]])
            if foot is not None:
                found.append(Touch("edge-vertex", foot, b.vertices[j], (m, int(j))))
        for i in np.flatnonzero(mask_a):
            found.append(Touch("vertex-vertex", a.vertices[i], b.vertices[j], (int(i), int(j))))
    return found


def within_face(shape: PlacedShape, k: int, point: Array, slack: float) -> bool:
    """Return whether a point lies above a face, within its sides to a tolerance [m]."""
    return beyond_sides(shape, k, point) <= slack


def beyond_sides(shape: PlacedShape, k: int, point: Array) -> float:
    """Return how far a point is beyond the sides of a face, negative above it [m]."""
    corners = shape.vertices[shape.shape.faces[k]]
    along = np.roll(corners, -1, axis=0) - corners
    outward = cross(along, shape.normals[k])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return float(np.einsum("ij,ij->i", outward, point - corners).max())


class Followed(NamedTuple):
    """A pair of features at a later time.

    Attributes:
        touch: The pair, with its points now.
        normal: (3,) from B to A.
        beyond: Distance of the closest points beyond the ends or sides of the features [m], negative within.
    """

    touch: Touch
    normal: Array
    beyond: float


def follow(touch: Touch, a: PlacedShape, b: PlacedShape, normal: Array) -> Followed:
    """Return a pair of features at the present placements, extended beyond their ends.

    Args:
        touch: The pair.
        a: The one shape.
        b: The other.
        normal: (3,) a recent normal.
    """
    i, j = touch.features
    if touch.kind == "vertex-face":
        p = a.vertices[i]
        foot = p - (b.normals[j] @ p - b.offsets[j]) * b.normals[j]
        return Followed(touch._replace(point=p, other=foot), b.normals[j], beyond_sides(b, j, p))
    if touch.kind == "face-vertex":
        p = b.vertices[j]
        foot = p - (a.normals[i] @ p - a.offsets[i]) * a.normals[i]
        return Followed(touch._replace(point=foot, other=p), -a.normals[i], beyond_sides(a, i, p))
    if touch.kind == "edge-edge":
        first, second = a.vertices[a.shape.edges[i]], b.vertices[b.shape.edges[j]]
        u, w = first[1] - first[0], second[1] - second[0]
        across = cross(u, w)
        squared = float(across @ across)
        if squared == 0.0:  # parallel: they cross nowhere, and other features are nearest
            middle = 0.5 * (first[0] + first[1])
            foot, _ = _foot_on_line(middle, second)
            length = float(np.linalg.norm(u) + np.linalg.norm(w))
            return Followed(touch._replace(point=middle, other=foot), normal, length)
        s = float(cross(second[0] - first[0], w) @ across) / squared
        r = float(cross(second[0] - first[0], u) @ across) / squared
        beyond = max(_beyond(s, u), _beyond(r, w))
        turned = across / math.copysign(math.sqrt(squared), float(across @ normal))
        return Followed(touch._replace(point=first[0] + s * u, other=second[0] + r * w), turned, beyond)
    beyond = -math.inf
    if touch.kind == "vertex-edge":
        p = a.vertices[i]
        q, beyond = _foot_on_line(p, b.vertices[b.shape.edges[j]])
    elif touch.kind == "edge-vertex":
        q = b.vertices[j]
        p, beyond = _foot_on_line(q, a.vertices[a.shape.edges[i]])
    else:
        p, q = a.vertices[i], b.vertices[j]
    between = p - q
    length = float(np.linalg.norm(between))
    turned = between / length if length > 0.0 else normal
    return Followed(touch._replace(point=p, other=q), turned, beyond)


def _beyond(part: float, along: Array) -> float:
    return max(-part, part - 1.0) * float(np.linalg.norm(along))


def _foot_on_line(point: Array, segment: Array) -> tuple[Array, float]:
    """Return the projection of a point on the line of a segment (2, 3), and its distance beyond the ends."""
    along = segment[1] - segment[0]
    s = float((point - segment[0]) @ along) / float(along @ along)
    return segment[0] + s * along, _beyond(s, along)


def corners_of(touch: Touch, a: PlacedShape, b: PlacedShape) -> tuple[Integers, Integers]:
    """Return the numbers of the vertices of A's feature and of B's."""
    names = touch.kind.split("-")
    found = []
    for name, number, shape in zip(names, touch.features, (a.shape, b.shape), strict=True):
        if name == "face":
            found.append(shape.faces[number])
        elif name == "edge":
            found.append(shape.edges[number])
        else:
            found.append(np.array([number]))
    return found[0], found[1]


def _crossing(first: Array, second: Array) -> tuple[Array, Array] | None:
    """Return the closest points of two segments (2, 3) if both lie within, else None."""
    u, w = first[1] - first[0], second[1] - second[0]
    across = cross(u, w)
    squared = float(across @ across)
    if squared <= PARALLEL**2 * float((u @ u) * (w @ w)):
        return None
    between = second[0] - first[0]
    s = float(cross(between, w) @ across) / squared
    r = float(cross(between, u) @ across) / squared
    if not (0.0 < s < 1.0 and 0.0 < r < 1.0):
        return None
    return first[0] + s * u, second[0] + r * w


def _foot(point: Array, segment: Array) -> Array | None:
    """Return the projection of a point on a segment (2, 3) if it lies within, else None."""
    along = segment[1] - segment[0]
    s = float((point - segment[0]) @ along) / float(along @ along)
    return segment[0] + s * along if 0.0 < s < 1.0 else None


def touches(a: PlacedShape, b: PlacedShape, normal: Array, tolerance: float) -> list[Touch]:
    """Return the contact points of two shapes with a gap of about zero along a normal.

    For faces, or a face and an edge, that lie on each other these are the corners of their intersection:
    corners of one within the other, and crossings of their edges. Coincident points are returned once, and a
    pair of features with more corners precedes one with fewer.

    Args:
        a: The one shape.
        b: The other.
        normal: (3,) the normal, from B to A.
        tolerance: Distance by which features in contact may be behind the extreme ones [m].
    """
    size = a.shape.reach + b.shape.reach
    found = nearest_features(a, b, normal, 4.0 * tolerance / min(a.shape.reach, b.shape.reach))
    radius = a.shape.radius + b.shape.radius
    distinct: list[Touch] = []
    for touch in found:
        between = touch.point - touch.other
        off = abs(float(between @ normal) - radius)
        across = float(np.linalg.norm(between - (between @ normal) * normal))
        if off > 4.0 * tolerance or across > 1e-9 * size + math.sqrt(2.0 * tolerance * radius):
            continue
        if all(np.linalg.norm(touch.point - other.point) > 1e-9 * size for other in distinct):
            distinct.append(touch)
    return distinct
