"""Collision shapes of a robot: by name, and as points, spheres and rims that can touch a plane.

Only the extreme points of a convex shape can touch a plane: the corners of a box, the vertices of the hull of
a mesh, the spheres at the two ends of a capsule, the two rims of a cylinder. So a mesh and its convex hull
touch a plane in the same way.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..checks import as_tuple, in_short, near_matches, whole_number
from ..errors import InputError, ModelError, UnknownNameError
from .tolerances import COINCIDE


class ShapeTips(NamedTuple):
    """The parts of a shape that can touch a plane, in the shape's own axes."""

    kind: str  # kind of the shape, in a word
    centres: Array  # (m, 3) [m]
    radius: float  # radius of the sphere about each [m]
    rims: Array  # (m,) radius of the circle about each, 0 for none [m]
    parts: tuple[str, ...]  # names of the parts; empty for a single one


def collision_model(robot: Any) -> pin.GeometryModel:
    """Return the collision shapes of a RobotWrapper, or raise `InputError`: there are none."""
    shapes = getattr(robot, "collision_model", None)
    if isinstance(shapes, pin.GeometryModel) and shapes.ngeoms > 0:
        return shapes
    what = "the robot has no collision shapes; its URDF needs <collision> elements"
    if isinstance(robot, pin.Model):
        what = (
            "a pinocchio Model has no collision shapes; give the RobotWrapper that has them, or "
            "pinocchio.RobotWrapper(model, collision_model)"
        )
    raise InputError(f"geometry: {what}", value=robot)


def find_shape(shapes: pin.GeometryModel, name: str) -> pin.GeometryObject:
    """Return a collision shape by name, or raise `UnknownNameError`, with similar names."""
    found = [shape for shape in shapes.geometryObjects if shape.name == name]
    if len(found) != 1:
        what = f"{len(found)} collision shapes are called {name!r}; rename them"
        if not found:
            names = (shape.name for shape in shapes.geometryObjects)
            what = f"no collision shape is called {name!r}; {near_matches(name, names)}"
        raise UnknownNameError(f"geometry: {what}", value=name)
    return found[0]


def shape_frame(model: pin.Model, shape: pin.GeometryObject) -> int:
    """Return the id of the frame of a shape: that of its link, else one of its joint, which must have one."""
    frame, joint = int(shape.parentFrame), int(shape.parentJoint)
    if frame < model.nframes and model.frames[frame].parentJoint == joint:
        return frame
    for number, other in enumerate(model.frames):
        if other.parentJoint == joint:
            return number
    raise ModelError(
        f"geometry: {shape.name!r} is attached to joint {joint}, which has no frame; add one: "
        f"model.addJointFrame({joint})",
        value=shape.name,
    )


def shape_tips(shapes: pin.GeometryModel, shape: pin.GeometryObject, rim_points: int | None) -> ShapeTips:
    """Return the parts of a shape that can touch a plane, or raise `InputError`: it has none.

    `rim_points` is the number of points of each rim, None for the rim itself.
    """
    solid = shape.geometry
    kind = type(solid).__name__
    if kind in _MAKERS:
        tips = tips_of(solid, rim_points)
    elif hasattr(solid, "vertices") or hasattr(solid, "points"):  # a mesh, whatever its tree of volumes
        mesh = hasattr(solid, "vertices")
        points, name = np.array(solid.vertices() if mesh else solid.points(), dtype=np.float64), shape.name
        corners = remembered(_hulls, shapes, name, points, lambda: extreme_points(points, name))
        tips = _points("mesh" if mesh else "convex shape", corners, "vertex")
    else:
        raise InputError(
            f"geometry: {shape.name!r} is a {kind}, which is not supported; a box, sphere, capsule, "
            "cylinder, cone, triangle, convex shape or mesh can touch a surface",
            value=shape.name,
        )
    return tips._replace(radius=tips.radius + swept_radius(solid))


def tips_of(solid: Any, rim_points: int | None) -> ShapeTips:
    """Return `shape_tips` of a coal geometry other than a mesh or hull."""
    tips = _MAKERS[type(solid).__name__](solid)
    return tips if rim_points is None else _with_points(tips, rim_points)


def swept_radius(solid: Any) -> float:
    """Return the radius of the swept sphere of a coal geometry [m]."""
    return float(solid.getSweptSphereRadius()) if hasattr(solid, "getSweptSphereRadius") else 0.0


def check_rim_points(value: Any) -> None:
    """Raise `InputError` for a number of rim points that is neither None nor a whole number of at least 3."""
    if value is not None:
        whole_number("rim_points", value, 3)


def _points(kind: str, points: Array, part: str) -> ShapeTips:
    parts = tuple(f"{part} {k + 1}" for k in range(len(points)))
    return ShapeTips(kind, points, 0.0, np.zeros(len(points)), parts)


def _box(solid: Any) -> ShapeTips:
    signs = np.array([[x, y, z] for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
    return _points("box", signs * np.asarray(solid.halfSide), "corner")


def _ends(solid: Any) -> Array:
    return np.array([[0.0, 0.0, -solid.halfLength], [0.0, 0.0, solid.halfLength]])


_MAKERS: dict[str, Callable[[Any], ShapeTips]] = {
    "Box": _box,
    "Sphere": lambda s: ShapeTips("sphere", np.zeros((1, 3)), float(s.radius), np.zeros(1), ("",)),
    "Capsule": lambda s: ShapeTips("capsule", _ends(s), float(s.radius), np.zeros(2), ("end 1", "end 2")),
    "Cylinder": lambda s: ShapeTips("cylinder", _ends(s), 0.0, np.full(2, s.radius), ("rim 1", "rim 2")),
    "Cone": lambda s: ShapeTips("cone", _ends(s), 0.0, np.array([float(s.radius), 0.0]), ("rim", "apex")),
    "TriangleP": lambda s: _points("triangle", np.array([s.a, s.b, s.c], dtype=np.float64), "corner"),
}


def unit_circle(count: int) -> Array:
    """Return (count, 3) points of the unit circle about z, evenly spaced from x."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])


def _with_points(tips: ShapeTips, count: int) -> ShapeTips:
    """Return tips with a number of points instead of each rim."""
    circle = unit_circle(count)
    centres, parts = [], []
    for centre, rim, part in zip(tips.centres, tips.rims, tips.parts, strict=True):
        centres += [*(centre + rim * circle)] if rim > 0.0 else [centre]
        parts += [f"{part} point {k + 1}" for k in range(count)] if rim > 0.0 else [part]
    return tips._replace(centres=np.array(centres), rims=np.zeros(len(centres)), parts=tuple(parts))


# ---- hulls


Remembered = dict[int, tuple[Any, dict[str, tuple[Array, Any]]]]
"""By collision model: objects computed from the vertices of its shapes."""

_hulls: Remembered = {}


def remembered(
    memory: Remembered, shapes: pin.GeometryModel, name: str, points: Array, make: Callable[[], Any]
) -> Any:
    """Return what `make` computes from the vertices of a shape, cached as long as its model exists.

    It is computed again if the vertices (m, 3) have changed.
    """
    key = id(shapes)
    known = memory.get(key)
    if known is None or known[0]() is not shapes:
        forget = memory.pop
        known = memory[key] = weakref.ref(shapes, lambda _: forget(key, None)), {}
    found = known[1].get(name)
    if found is None or not np.array_equal(found[0], points):
        found = known[1][name] = points, make()
    return found[1]


def extreme_points(points: Array, name: str) -> Array:
    """Return the corners of the convex hull, which may be flat, of (n, 3) points, in their order."""
    if len(points) == 0 or not np.isfinite(points).all():
        what = "has no vertices" if len(points) == 0 else "has vertices that are not finite"
        raise ModelError(f"geometry: the mesh of {name!r} {what}", value=name)
    from scipy.spatial import ConvexHull, QhullError

    points = np.unique(points, axis=0)
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    rank = int(np.count_nonzero(sizes > COINCIDE * sizes[0])) if sizes[0] > 0.0 else 0
    flat = points if rank == 3 else points @ axes[:rank].T
    if rank == 0:
        return points[:1]
    if rank == 1:
        return points[[int(flat.argmin()), int(flat.argmax())]]
    try:
        corners = ConvexHull(flat).vertices
    except QhullError:  # as good as flat, or too small for it: then each may be a corner
        return points
    return points[np.sort(corners)]


def shapes_of_links(
    model: pin.Model, shapes: pin.GeometryModel, links: str | Iterable[str]
) -> list[pin.GeometryObject]:
    """Return the collision shapes of links, given by the names of their frames, or of "all"."""
    found = [(model.frames[shape_frame(model, shape)].name, shape) for shape in shapes.geometryObjects]
    if isinstance(links, str) and links == "all":
        return [shape for _, shape in found]
    wanted = as_tuple("links", links, str, 'the name of a link, "all"')
    names = [name for name, _ in found]
    for link in wanted:
        if link not in names:
            raise UnknownNameError(
                f"links: no link {in_short(link)} has a collision shape; {near_matches(link, names)}",
                value=link,
            )
    return [shape for name, shape in found if name in wanted]
