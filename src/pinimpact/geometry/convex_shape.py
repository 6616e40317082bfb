"""Convex shapes: a polytope, or a polytope with a swept sphere, computed from coal geometries."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._numeric.tolerances import NOISE
from ..arrays import Array, Integers
from ..errors import InputError
from .tolerances import COINCIDE, NOT_CONVEX, SAME_DIRECTION


@dataclass(frozen=True, eq=False)
class ConvexShape:
    """A polytope, its core, and the radius of a swept sphere; all in the shape's own axes.

    A sphere is a point and its radius, a capsule a segment and its radius, a box or a hull a polytope and
    no radius.
    """

    vertices: Array  # (n, 3) of the core [m]
    faces: tuple[Integers, ...]  # corners of each face of the core, counter-clockwise from outside
    edges: Integers  # (m, 2) numbers of vertices
    normals: Array  # (f, 3) outward unit normals of the faces of the core
    radius: float  # radius of the swept sphere [m]
    collision: Any = field(repr=False)  # the same shape in coal

    @cached_property
    def center(self) -> Array:
        """(3,) the centre of the core's bounding box."""
        return 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))

    @cached_property
    def reach(self) -> float:
        """The largest distance of the shape's points from `center` [m]."""
        return float(np.linalg.norm(self.vertices - self.center, axis=1).max()) + self.radius

    @cached_property
    def half_thickness(self) -> float:
        """Half of the least distance of two parallel planes that have the shape between them [m]."""
        between = np.ptp(self.vertices @ self.normals.T, axis=0) if len(self.faces) else np.zeros(1)
        return 0.5 * float(between.min()) + self.radius

    @cached_property
    def directions(self) -> Array:
        """(k, 3) unit directions of the edges, parallel ones once."""
        found = self.vertices[self.edges[:, 1]] - self.vertices[self.edges[:, 0]]
        found /= np.linalg.norm(found, axis=1)[:, None]
        directions: list[Array] = []
        for direction in found:
            if not any(abs(direction @ other) > SAME_DIRECTION for other in directions):
                directions.append(direction)
        return np.array(directions).reshape(-1, 3)

    @cached_property
    def sides(self) -> list[tuple[Array, Array]]:
        """For each face the outward unit normals (k, 3) of its sides, and their offsets (k,) [m]."""
        found = []
        for face, normal in zip(self.faces, self.normals, strict=True):
            corners = self.vertices[face]
            outward = cross(np.roll(corners, -1, axis=0) - corners, normal)
            outward /= np.linalg.norm(outward, axis=1)[:, None]
            found.append((outward, np.einsum("ij,ij->i", outward, corners)))
        return found

    def at(self, rotation: Array, translation: Array) -> PlacedShape:
        """Return the shape at a placement."""
        return PlacedShape(self, rotation, translation)


class PlacedShape:
    """A convex shape at a placement, with the vertices (n, 3) of its core in world axes."""

    def __init__(self, shape: ConvexShape, rotation: Array, translation: Array) -> None:
        self.shape = shape
        self.rotation = np.asarray(rotation)
        self.translation = np.asarray(translation)
        self.vertices = shape.vertices @ self.rotation.T + self.translation

    @cached_property
    def normals(self) -> Array:
        """(f, 3) of its faces, in world axes."""
        return self.shape.normals @ self.rotation.T

    @cached_property
    def offsets(self) -> Array:
        """(f,) of the faces' planes n·x = offset [m]."""
        first = [face[0] for face in self.shape.faces]
        return np.einsum("ij,ij->i", self.normals, self.vertices[first]) if first else np.zeros(0)

    def edge(self, k: int) -> Array:
        """Return the vector (3,) from one end of an edge to the other, in world axes [m]."""
        first, last = self.vertices[self.shape.edges[k]]
        along: Array = last - first
        return along

    def beyond_sides(self, k: int, point: Array) -> float:
        """Return how far a point is beyond the sides of a face, negative above it [m]."""
        outward, offsets = self.shape.sides[k]
        return float((outward @ ((point - self.translation) @ self.rotation) - offsets).max())

    @cached_property
    def directions(self) -> Array:
        """(k, 3) directions of the edges, in world axes."""
        return self.shape.directions @ self.rotation.T


def coincidence(a: ConvexShape, b: ConvexShape) -> float:
    """Return the distance below which points of two shapes coincide [m]; see `COINCIDE`."""
    small, large = sorted((a.reach, b.reach))
    return COINCIDE * small + NOISE * large


def cross(a: Array, b: Array) -> Array:
    """Return a × b (…, 3), in a tenth of the time of `numpy.cross`."""
    (a1, a2, a3), (b1, b2, b3) = a.T, b.T
    return np.array([a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1]).T


def box(size: ArrayLike) -> ConvexShape:
    """Return a box about the origin with these (3,) lengths of its sides [m]."""
    x, y, z = np.asarray(size, dtype=np.float64).tolist()
    return _box(x, y, z)


@lru_cache(maxsize=64)
def _box(x: float, y: float, z: float) -> ConvexShape:
    import coal

    half = 0.5 * np.array([x, y, z])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    faces, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = np.zeros(3)
            normal[axis] = side
            faces.append(_around(corners, np.flatnonzero(corners[:, axis] == side), normal))
            normals.append(normal)
    return ConvexShape(
        corners * half, tuple(faces), _edges_of(faces), np.array(normals), 0.0, coal.Box(*(2.0 * half))
    )


def sphere(radius: float) -> ConvexShape:
    """Return a sphere about the origin."""
    import coal

    no_edges = np.zeros((0, 2), dtype=np.int64)
    return ConvexShape(np.zeros((1, 3)), (), no_edges, np.zeros((0, 3)), float(radius), coal.Sphere(radius))


def capsule(radius: float, half_length: float) -> ConvexShape:
    """Return a capsule along z, with half the length of its straight part [m]; without a length, a sphere."""
    import coal

    if half_length <= COINCIDE * radius:
        return sphere(radius)
    ends = np.array([[0.0, 0.0, -half_length], [0.0, 0.0, half_length]])
    solid = coal.Capsule(radius, 2.0 * half_length)
    return ConvexShape(ends, (), np.array([[0, 1]]), np.zeros((0, 3)), float(radius), solid)


def hull(points: ArrayLike, name: str = "points") -> ConvexShape:
    """Return the convex hull of (n, 3) points, or raise `InputError`, with the name: they span no volume."""
    import coal
    from scipy.spatial import ConvexHull, QhullError

    points = np.asarray(points, dtype=np.float64)
    if not np.isfinite(points).all():
        raise InputError(f"geometry: {name!r} has points that are not finite", value=points)
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"geometry: the {len(points)} points of {name!r} have no convex hull with a volume "
            f"({reason}); only shapes with a volume can make contact with another shape",
            value=points,
        ) from None
    vertices = points[found.vertices]
    number = {int(old): new for new, old in enumerate(found.vertices)}
    faces, normals = [], []
    for group in _coplanar(found.equations[:, :3]):
        corners = sorted({number[int(i)] for i in found.simplices[group].ravel()})
        normal = found.equations[group, :3].mean(axis=0)
        normal /= np.linalg.norm(normal)
        faces.append(_around(vertices, np.array(corners), normal))
        normals.append(_fitted(vertices[faces[-1]], normal))
    pad = coal.StdVec_Vec3s()
    for point in vertices:
        pad.append(point)
    triangles = coal.StdVec_Triangle()
    for face in faces:
        for k in range(1, len(face) - 1):
            triangles.append(coal.Triangle(int(face[0]), int(face[k]), int(face[k + 1])))
    return ConvexShape(
        vertices, tuple(faces), _edges_of(faces), np.array(normals), 0.0, coal.Convex(pad, triangles)
    )


def of_collision_geometry(geometry: Any, name: str) -> ConvexShape:
    """Return the convex shape of a coal geometry, or raise `InputError`: it is of another kind.

    For a mesh it is the convex hull, with a warning if the mesh is not convex.
    """
    kind = type(geometry).__name__
    if kind == "Box":
        return box(2.0 * np.asarray(geometry.halfSide))
    if kind == "Sphere":
        return sphere(float(geometry.radius))
    if kind == "Capsule":
        return capsule(float(geometry.radius), float(geometry.halfLength))
    if kind == "Convex":
        return hull(np.asarray(geometry.points()), name)
    if kind.startswith("BVHModel"):
        points = np.array(geometry.vertices(), dtype=np.float64)
        found = hull(points, name)
        offsets = found.at(np.eye(3), np.zeros(3)).offsets[:, None]
        depth = float((offsets - found.normals @ points.T).min(axis=0).max())  # in the hull [m]
        if depth > NOT_CONVEX * found.reach:
            warnings.warn(
                f"geometry: the mesh of {name!r} is not convex: its convex hull is used, whose "
                f"surface is up to {depth:.3g} m from a vertex of the mesh",
                UserWarning,
                stacklevel=4,
            )
        return found
    what = "boxes, spheres, capsules, cylinders, cones, convex hulls and meshes (their hulls)"
    what = f"geometry: {name!r} is a {kind}; {what} can make contact with another shape"
    raise InputError(what, field="geometry", value=name)


def _coplanar(normals: Array) -> list[Integers]:
    """Return groups of facets of equal normals; those of a convex body lie in one plane."""
    groups, left = [], np.arange(len(normals))
    while len(left):
        same = np.linalg.norm(normals[left] - normals[left[0]], axis=1) < COINCIDE
        groups.append(left[same])
        left = left[~same]
    return groups


def _around(vertices: Array, corners: Integers, normal: Array) -> Integers:
    """Return the corners of a face in their order around its normal."""
    from_center = vertices[corners] - vertices[corners].mean(axis=0)
    first = from_center[0] / np.linalg.norm(from_center[0])
    second = cross(normal, first)
    order = np.argsort(np.arctan2(from_center @ second, from_center @ first), kind="stable")
    return np.asarray(corners)[order].astype(np.int64)


def _fitted(corners: Array, normal: Array) -> Array:
    """Return the unit normal of a face from its corners, in their order, by Newell's sum."""
    following = np.roll(corners, -1, axis=0)
    sum_of_areas = cross(corners - corners[0], following - corners[0]).sum(axis=0)
    found: Array = sum_of_areas / np.linalg.norm(sum_of_areas)
    return found if found @ normal > 0.0 else -found


def _edges_of(faces: list[Integers]) -> Integers:
    pairs = {tuple(sorted(pair)) for face in faces for pair in zip(face, np.roll(face, -1), strict=True)}
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)
