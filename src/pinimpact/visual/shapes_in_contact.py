"""Collision shapes in contact: which of their contacts are drawn, and when a shape is highlighted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..geometry.collision_shapes import tips_of
from ..robot.contact import Contact
from ..scene.trajectory import Trajectory
from .impact_marks import short
from .page_file import packed

ROUND = 24
"""Number of points of a drawn circle."""


def contacts_to_draw(trajectory: Trajectory, contacts: Sequence[Contact]) -> list[Contact]:
    """Return contacts without those of collision shapes and at points of rims that are never closed.

    If a surface has only such contacts, one contact of each shape is kept.
    """
    touched = {mode.source for mode in trajectory.modes} | {impact.source for impact in trajectory.impacts}
    kept = [c for c in contacts if (c.shape is None and c.of_rim is None) or c.label in touched]
    met = {contact.plane for contact in kept}
    others = {(contact.shape, contact.plane): contact for contact in contacts if contact.plane not in met}
    return kept + list(others.values())


def bodies_of(contact: Contact) -> str:
    """Return the common name of all contact points of the same two bodies."""
    if contact.pair is not None:
        return contact.pair.label
    if contact.shape is None:
        return contact.of_rim or contact.label
    return f"{contact.shape} on {contact.plane.label}"


def lit_shapes(robot: Any, trajectory: Trajectory, contacts: Sequence[Contact]) -> list[dict[str, Any]]:
    """Return the collision shapes in contact as data for the player, with their times."""
    shapes = getattr(robot, "collision_model", None)
    if not isinstance(shapes, pin.GeometryModel):
        return []
    owners = {contact.label: contact.shape for contact in contacts if contact.shape is not None}
    found: dict[str, list[tuple[float, float]]] = {}
    for mode in trajectory.modes:
        if mode.source in owners:
            found.setdefault(owners[mode.source], []).append((mode.start, mode.end))
    for impact in trajectory.impacts:
        if impact.source in owners:
            found.setdefault(owners[impact.source], []).append((impact.time, impact.time))
    return [
        {
            "name": shape.name,
            "joint": int(shape.parentJoint),
            "matrix": short(shape.placement.homogeneous.T.ravel()),
            "triangles": packed(_triangles(shape.geometry)),
            "times": _joined(found[shape.name]),
        }
        for shape in shapes.geometryObjects
        if shape.name in found
    ]


def _joined(intervals: list[tuple[float, float]]) -> list[list[float]]:
    """Return intervals of time, with overlapping and adjacent ones merged."""
    joined: list[list[float]] = []
    for start, end in sorted(intervals):
        if joined and start <= joined[-1][1]:
            joined[-1][1] = max(joined[-1][1], end)
        else:
            joined.append([start, end])
    return joined


def _triangles(solid: Any) -> Array:
    """Return the surface of a shape, of the convex hull for a mesh, as corners of triangles (k, 3, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    points = surface_points(solid)
    try:
        corners: Array = points[ConvexHull(points).simplices]
    except QhullError:  # flat: it has no volume
        corners = points[: len(points) // 3 * 3].reshape(-1, 3, 3)
    return corners


def surface_points(solid: Any) -> Array:
    """Return points (n, 3) whose convex hull is a shape, approximately for round shapes."""
    if hasattr(solid, "vertices"):
        return np.array(solid.vertices(), dtype=np.float64)
    if hasattr(solid, "points"):
        return np.array(solid.points(), dtype=np.float64)
    if isinstance(solid, coal.Ellipsoid):
        return np.asarray(solid.radii) * surface_points(coal.Sphere(1.0))
    tips = tips_of(solid, ROUND)
    if tips.radius == 0.0:
        return tips.centres
    turns = 2.0 * np.pi * np.arange(ROUND) / ROUND
    heights = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ROUND // 2 + 1)
    ball = [[np.cos(z) * np.cos(a), np.cos(z) * np.sin(a), np.sin(z)] for z in heights for a in turns]
    return (tips.centres[:, None] + tips.radius * np.array(ball)).reshape(-1, 3)
