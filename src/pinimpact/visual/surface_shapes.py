"""Surfaces as plates, balls and blocks, in the world or attached to a body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface, contact_axes
from ..robot.names import frame_id
from ..robot.solids import Box
from .impact_marks import short

MARGIN, THICKNESS = 0.12, 0.015
"""Margin of a plate beyond the paths of the contacts, and its thickness, relative to the size of the
scene."""
REACH = 0.1
"""A plate covers points within this distance of it, relative to the size of the scene."""


def carrier(model: pin.Model, surface: Surface) -> tuple[int, pin.SE3]:
    """Return the joint to which a surface is attached, 0 for the world, and its placement in the joint."""
    if surface.body is None:
        return 0, pin.SE3.Identity()
    frame = model.frames[frame_id(model, surface.body, "body")]
    return int(frame.parentJoint), frame.placement


def surface_as_data(
    model: pin.Model, surface: Surface, poses: Array, points: Array, scale: float
) -> dict[str, Any]:
    """Return a surface as data for the player.

    "slide" [m/s] is the velocity of the material at the centre of the drawn shape, and "spin" [rad/s] its
    angular velocity, both in the axes of that shape.

    Args:
        model: The robot.
        surface: The surface.
        poses: (frames, joints, 7) poses of the joints.
        points: (k, frames, 3) contact points on the surface, in world axes.
        scale: Size of the scene [m].
    """
    joint, place = carrier(model, surface)
    views = [
        (pin.XYZQUATToSE3(pose) * place).inverse()
        for pose in (poses[:, joint] if joint else poses[:1, 0].repeat(poses.shape[0], axis=0))
    ]
    local = np.array([[at.act(p) for at, p in zip(views, path, strict=True)] for path in points]).reshape(
        -1, 3
    )
    kind, size, inner = _SOLIDS[type(surface)](surface, local, scale)
    matrix = place.homogeneous @ inner
    spin = np.asarray(surface.angular_velocity)
    slide = np.asarray(surface.velocity) + np.cross(spin, inner[:3, 3] - np.asarray(surface.origin))
    return {
        "kind": kind,
        "size": size,
        "joint": joint,
        "matrix": short(matrix.T.ravel()),
        "slide": short(slide @ inner[:3, :3]),
        "spin": short(spin @ inner[:3, :3]),
    }


def _plate(plane: Plane, points: Array, scale: float) -> tuple[str, list[float], Array]:
    """Return the part of a plane near the points, as a thin plate with a margin, and its placement."""
    axes = contact_axes(plane.normal)
    local = (points - np.asarray(plane.point)) @ axes.T
    near = local[np.abs(local[:, 2]) < REACH * scale]
    local = np.vstack([near, np.zeros(3)]) if plane.body is not None or not len(near) else near
    low, high = local.min(axis=0) - MARGIN * scale, local.max(axis=0) + MARGIN * scale
    thickness = THICKNESS * scale
    matrix = np.eye(4)
    matrix[:3, :3] = axes.T
    middle = np.array([*(0.5 * (low + high))[:2], -0.5 * thickness])
    matrix[:3, 3] = np.asarray(plane.point) + middle @ axes
    return "plane", short(np.array([*(high - low)[:2], thickness])), matrix


def _ball(sphere: Sphere, *_: Any) -> tuple[str, list[float], Array]:
    """Return a sphere and its placement."""
    matrix = np.eye(4)
    matrix[:3, 3] = sphere.center
    return "sphere", [sphere.radius, sphere.radius, sphere.radius], matrix


def _block(box: Box, *_: Any) -> tuple[str, list[float], Array]:
    """Return a box and its placement."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pin.rpy.rpyToMatrix(*box.rpy), box.center
    return "plane", list(box.size), matrix


_SOLIDS: dict[type[Surface], Callable[[Any, Array, float], tuple[str, list[float], Array]]] = {
    Plane: _plate,
    Sphere: _ball,
    Box: _block,
}
"""Drawn shape of each kind of surface: (surface, points in its axes, scale) -> kind, size, placement."""
