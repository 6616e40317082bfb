"""Two convex shapes at an instant: their gap, its normal, and their contact points.

The first shape is A, the second B: the normal points from B to A, as from a surface into free space.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..arrays import Array, Bools, Integers
from ._kernels.constants import EDGE, LINE, PLANE, SPHERE, TIP_PLANE
from .convex_shape import PlacedShape, coincidence, cross
from .tolerances import CLOSE, COAL_ERROR, COINCIDE, FACING, GJK, LOCAL, TIE


class Gap(NamedTuple):
    """The gap of two shapes."""

    value: float  # the gap [m], negative if they overlap
    normal: Array  # (3,) unit vector of the separation, from B to A, in world axes


class Touch(NamedTuple):
    """A contact point of two shapes, an elementary contact."""

    kind: str  # "vertex-face": of A on one of B; or another two of vertex, edge and face
    point: Array  # (3,) of A's core, in world axes; for a face, B's point on it
    other: Array  # (3,) of B's core
    features: tuple[int, int]  # numbers of A's vertex, edge or face and of B's; of an edge its row in `edges`

    @property
    def mirrored(self) -> Touch:
        """The same, with A and B exchanged."""
        first, second = self.kind.split("-")
        return Touch(f"{second}-{first}", self.other, self.point, self.features[::-1])

    def edges(self, a: PlacedShape, b: PlacedShape) -> Array:
        """Return the directions (2, 3) of the edges in contact of A and B; zeros for other features."""
        found = np.zeros((2, 3))
        for k, (shape, feature) in enumerate(zip((a, b), self.kind.split("-"), strict=True)):
            if feature == "edge":
                found[k] = shape.edge(self.features[k])
        return found


CODES = {
    "vertex-face": PLANE,
    "face-vertex": TIP_PLANE,
    "edge-edge": EDGE,
    "vertex-edge": LINE,
    "vertex-vertex": SPHERE,
}
"""Codes of kinds of `Touch`; `TIP_PLANE` with a face of A."""


def gap(a: PlacedShape, b: PlacedShape, near: Array | None = None) -> Gap:
    """Return the gap of two shapes, or a lower bound of it if it is not small.

    Up to `CLOSE` of their size the gap is exact to rounding, or for cores without a radius the separation, a
    lower bound of the distance. Beyond, it is a separation, too: along coal's normal if coal's distance, that
    of two points of the shapes, is the same; of boxes that are nearly parallel, or small, coal misses the
    closest points by up to 10⁻⁵ of the size. Spheres and capsules do not need coal. `near` (3,) is a recent
    direction of separation, if known.
    """
    size = a.shape.reach + b.shape.reach
    radius = a.shape.radius + b.shape.radius
    if len(a.vertices) <= 2 and len(b.vertices) <= 2:
        value, normal = _between_segments(a.vertices, b.vertices)
        value -= radius
        apart = value
    else:
        value, normal = _gjk(a, b)
        apart = float((a.vertices @ normal).min() - (b.vertices @ normal).max()) - radius
    if apart > CLOSE * size:
        along = Gap(apart, normal)
        if value - apart <= COAL_ERROR * size:
            return along
        best = separation(a, b, normal)
        return max(Gap(best.value - radius, best.normal), along, key=lambda one: one.value)
    if radius > 0.0:
        found = _between_cores(a, b, normal)
        if found is not None:
            return Gap(found.value - radius, found.normal)
    best = separation(a, b, normal if near is None else near)
    if best.value <= max(0.1 * value, coincidence(a.shape, b.shape)):  # other edges may separate them further
        best = max(best, separation(a, b), key=lambda one: one.value)
    return Gap(best.value - radius, best.normal)


def _between_segments(a: Array, b: Array) -> tuple[float, Array]:
    """Return the distance of two segments or points (1 or 2, 3), and the unit normal from b to a.

    coal treats segments as parallel if |u × w| < 1.5·10⁻⁷ m², so its distance of nearly parallel capsules of
    a centimetre is too large by a thousandth of their length.
    """
    (x, y), (u, w) = (a[0], b[0]), (a[-1] - a[0], b[-1] - b[0])
    between, uu, ww, uw = x - y, float(u @ u), float(w @ w), float(u @ w)
    on_u, on_w = float(u @ between), float(w @ between)
    across = uu * ww - uw * uw

    def on_b(s: float) -> tuple[float, float]:
        return s, min(max((on_w + s * uw) / ww, 0.0), 1.0) if ww > 0.0 else 0.0

    def on_a(t: float) -> tuple[float, float]:
        return min(max((t * uw - on_u) / uu, 0.0), 1.0) if uu > 0.0 else 0.0, t

    places = [on_b(0.0), on_b(1.0), on_a(0.0), on_a(1.0)]
    if across > 0.0:
        places.append(on_b(min(max((uw * on_w - ww * on_u) / across, 0.0), 1.0)))
    lines = [between + s * u - t * w for s, t in places]
    squares = [float(line @ line) for line in lines]
    square = min(squares)
    if square == 0.0:
        return 0.0, np.array([0.0, 0.0, 1.0])
    distance = math.sqrt(square)
    return distance, lines[squares.index(square)] / distance


def _gjk(a: PlacedShape, b: PlacedShape) -> tuple[float, Array]:
    """Return distance and normal computed by coal: 0 or less if the shapes overlap."""
    import coal

    request = coal.DistanceRequest()
    request.gjk_tolerance = GJK
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
    depth of their overlap. Of equal directions, faces of B precede faces of A, and these pairs of edges. With
    `near` (3,), a direction along which they are nearly apart, only faces and edges there are tried.
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
    """A separating direction of two cores, and the features that it follows."""

    value: float  # the separation [m]
    normal: Array  # (3,) from B to A
    edges: Array | None  # (2, 3) directions of the edges that it is perpendicular to; None for that of a face
    of_a: bool  # whether it is the normal of a face of A, else of B


def ties(a: PlacedShape, b: PlacedShape, near: Array, depth: float = 0.0) -> list[Turning]:
    """Return the separations along all directions that are as good as the best, for cores in contact.

    `near` (3,) is a direction along which they are nearly apart; separations that are less good by up to
    `depth` [m] are returned too.
    """
    crossed, u, w = _crossed(a, b, near)
    axes = np.concatenate([b.normals, -a.normals, crossed])
    values = (axes @ a.vertices.T).min(axis=1) - (axes @ b.vertices.T).max(axis=1)
    best = float(values.max())
    tie = max(coincidence(a.shape, b.shape), 2.0 * abs(best), depth)
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
    some = lengths > COINCIDE
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


def _foremost(shape: PlacedShape, normal: Array, part: float) -> Bools:
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
    if lengths[k] <= coincidence(a.shape, b.shape) or between[k] @ normal < 0.0:
        return None
    return Gap(lengths[k], between[k] / lengths[k])


def nearest_features(a: PlacedShape, b: PlacedShape, normal: Array, part: float) -> list[Touch]:
    """Return the pairs of features of the cores that face each other along a normal, with their points.

    Only features whose corners are all extreme along the normal, to a part of the shape's size, and only
    pairs whose closest points lie within both.
    """
    mask_a, mask_b = _foremost(a, normal, part), _foremost(b, -normal, part)
    slack = ROUNDING * (a.shape.reach + b.shape.reach)
    found = _on_faces(a, b, mask_a, mask_b, slack)
    found += [touch.mirrored for touch in _on_faces(b, a, mask_b, mask_a, slack)]
    edges_a = [m for m, edge in enumerate(a.shape.edges) if mask_a[edge].all()]
    edges_b = [m for m, edge in enumerate(b.shape.edges) if mask_b[edge].all()]
    for m in edges_a:
        for k in edges_b:
            s, r, points = _crossing(a, m, b, k)
            if 0.0 < s < 1.0 and 0.0 < r < 1.0:
                found.append(Touch("edge-edge", *points, (m, k)))
    found += _on_edges(a, b, mask_a, edges_b)
    found += [touch.mirrored for touch in _on_edges(b, a, mask_b, edges_a)]
    for j in np.flatnonzero(mask_b).tolist():
        for i in np.flatnonzero(mask_a).tolist():
            found.append(Touch("vertex-vertex", a.vertices[i], b.vertices[j], (i, j)))
    return found


def _on_faces(a: PlacedShape, b: PlacedShape, mask_a: Bools, mask_b: Bools, slack: float) -> list[Touch]:
    """Return vertices of A that lie above faces of B, within their sides to a tolerance [m]."""
    faces = [k for k, face in enumerate(b.shape.faces) if mask_b[face].all()]
    return [
        Touch("vertex-face", a.vertices[i], _foot_on_face(a.vertices[i], b, k), (i, k))
        for i in np.flatnonzero(mask_a).tolist()
        for k in faces
        if b.beyond_sides(k, a.vertices[i]) <= slack
    ]


def _on_edges(a: PlacedShape, b: PlacedShape, mask_a: Bools, edges: list[int]) -> list[Touch]:
    """Return vertices of A whose projections on edges of B lie within these."""
    found = []
    for i in np.flatnonzero(mask_a).tolist():
        for k in edges:
            foot, beyond = _foot_on_edge(a.vertices[i], b, k)
            if beyond < 0.0:
                found.append(Touch("vertex-edge", a.vertices[i], foot, (i, k)))
    return found


class Followed(NamedTuple):
    """A pair of features at a later time."""

    touch: Touch  # the pair, with its points now
    normal: Array  # (3,) from B to A
    beyond: float  # how far the closest points are beyond the ends or sides of the features [m]; < 0 within


def follow(touch: Touch, a: PlacedShape, b: PlacedShape, normal: Array) -> Followed:
    """Return a pair of features at the present placements, extended beyond their ends; see `Followed`."""
    i, j = touch.features
    if touch.kind in ("face-vertex", "edge-vertex"):
        found = follow(touch.mirrored, b, a, -normal)
        return Followed(found.touch.mirrored, -found.normal, found.beyond)
    if touch.kind == "vertex-face":
        p = a.vertices[i]
        foot = _foot_on_face(p, b, j)
        return Followed(touch._replace(point=p, other=foot), b.normals[j], b.beyond_sides(j, p))
    if touch.kind == "edge-edge":
        u, w = a.edge(i), b.edge(j)
        across = cross(u, w)
        if float(across @ across) == 0.0:  # parallel edges do not cross; other features are closest
            middle = a.vertices[a.shape.edges[i]].mean(axis=0)
            foot, _ = _foot_on_edge(middle, b, j)
            length = float(np.linalg.norm(u) + np.linalg.norm(w))
            return Followed(touch._replace(point=middle, other=foot), normal, length)
        s, r, (p, q) = _crossing(a, i, b, j, 0.0)
        turned = between_faces(touch, a, b, normal)
        if turned is None:
            turned = across / math.copysign(float(np.linalg.norm(across)), float(across @ normal))
        return Followed(touch._replace(point=p, other=q), turned, max(_beyond(s, u), _beyond(r, w)))
    p = a.vertices[i]
    q, beyond = _foot_on_edge(p, b, j) if touch.kind == "vertex-edge" else (b.vertices[j], -math.inf)
    between = p - q
    length = float(np.linalg.norm(between))
    turned = between / length if length > coincidence(a.shape, b.shape) else normal
    return Followed(touch._replace(point=p, other=q), turned, beyond)


def between_faces(touch: Touch, a: PlacedShape, b: PlacedShape, normal: Array) -> Array | None:
    """Return the normal (3,) of B's face for a crossing of edges of two faces in one plane, else None.

    That of the edges has the error of the faces' directions, divided by the angle between the edges. (15.3)
    """
    if touch.kind != "edge-edge" or a.shape.radius + b.shape.radius > 0.0:
        return None
    i, j = int((a.normals @ normal).argmin()), int((b.normals @ normal).argmax())
    if np.abs(a.normals[i] + b.normals[j]).max() > COINCIDE:
        return None
    edges = ((a.shape, touch.features[0], i), (b.shape, touch.features[1], j))
    lie = all(np.isin(shape.edges[edge], shape.faces[face]).all() for shape, edge, face in edges)
    return b.normals[j] if lie else None


def _beyond(part: float, along: Array) -> float:
    return max(-part, part - 1.0) * float(np.linalg.norm(along))


def _foot_on_face(point: Array, shape: PlacedShape, k: int) -> Array:
    """Return the projection of a point on the plane of a face."""
    foot: Array = point - (shape.normals[k] @ point - shape.offsets[k]) * shape.normals[k]
    return foot


def _foot_on_edge(point: Array, shape: PlacedShape, k: int) -> tuple[Array, float]:
    """Return the projection of a point on the line of an edge, and its distance beyond the ends [m]."""
    first, along = shape.vertices[shape.shape.edges[k, 0]], shape.edge(k)
    s = float((point - first) @ along) / float(along @ along)
    return first + s * along, _beyond(s, along)


def _crossing(
    a: PlacedShape, m: int, b: PlacedShape, k: int, parallel: float = COINCIDE
) -> tuple[float, float, tuple[Array, Array]]:
    """Return the closest points of the lines of two edges, as fractions of the edges and as points.

    Both fractions are NaN if the sine of the angle between them is no larger than `parallel`.
    """
    u, w = a.edge(m), b.edge(k)
    first, second = a.vertices[a.shape.edges[m, 0]], b.vertices[b.shape.edges[k, 0]]
    across, between = cross(u, w), second - first
    squared = float(across @ across)
    if squared <= parallel**2 * float((u @ u) * (w @ w)):
        return math.nan, math.nan, (first, second)
    s, r = float(cross(between, w) @ across) / squared, float(cross(between, u) @ across) / squared
    return s, r, (first + s * u, second + r * w)


def corners_of(touch: Touch, a: PlacedShape, b: PlacedShape) -> tuple[Integers, Integers]:
    """Return the numbers of the vertices of A's feature and of B's."""
    first, second = (
        np.array([k]) if name == "vertex" else shape.faces[k] if name == "face" else shape.edges[k]
        for name, k, shape in zip(touch.kind.split("-"), touch.features, (a.shape, b.shape), strict=True)
    )
    return first, second


def touches(a: PlacedShape, b: PlacedShape, normal: Array, tolerance: float) -> list[Touch]:
    """Return the contact points of two shapes with a gap of about zero along a normal (3,), from B to A.

    For faces, or a face and an edge, that lie on each other these are the corners of their intersection:
    corners of one within the other, and crossings of their edges. Coincident points are returned once, and a
    pair of features with more corners precedes one with fewer. Features in contact may be behind the extreme
    ones by the tolerance [m].
    """
    near = coincidence(a.shape, b.shape)
    found = nearest_features(a, b, normal, 4.0 * tolerance / min(a.shape.reach, b.shape.reach))
    radius = a.shape.radius + b.shape.radius
    distinct: list[Touch] = []
    for touch in found:
        between = touch.point - touch.other
        height = abs(float(between @ normal) - radius)
        across = float(np.linalg.norm(between - (between @ normal) * normal))
        if height > 4.0 * tolerance or across > near + math.sqrt(2.0 * tolerance * radius):
            continue
        if all(np.linalg.norm(touch.point - other.point) > near for other in distinct):
            distinct.append(touch)
    return distinct


def at_one_place(
    touch: Touch, a: PlacedShape, b: PlacedShape, normal: Array, tolerance: float
) -> list[Touch]:
    """Return a contact point that `touches` returns, and other features that are as close at its place."""
    near = coincidence(a.shape, b.shape)
    found = nearest_features(a, b, normal, 4.0 * tolerance / min(a.shape.reach, b.shape.reach))
    if touch.kind == "vertex-vertex":  # the closest point of an edge may be its end
        i, j = touch.features
        found += _ending(a, i, b, j, near) + [other.mirrored for other in _ending(b, j, a, i, near)]
    others = [one for one in found if (one.kind, one.features) != (touch.kind, touch.features)]
    apart = [np.append(one.point - touch.point, one.other - touch.other) for one in others]
    return [touch, *(one for one, by in zip(others, apart, strict=True) if np.linalg.norm(by) <= near)]


def _ending(a: PlacedShape, i: int, b: PlacedShape, j: int, near: float) -> list[Touch]:
    """Return a vertex of A with edges of B that end in a vertex, if its projection is near it or within."""
    point, edges = a.vertices[i], np.flatnonzero((b.shape.edges == j).any(axis=1)).tolist()
    return [
        Touch("vertex-edge", point, b.vertices[j], (i, k))
        for k in edges
        if _foot_on_edge(point, b, k)[1] <= near
    ]
