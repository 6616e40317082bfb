"""The shapes of a robot by joint: its meshes, or lines if it has none."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..robot.forest import data_of, forward_kinematics, frame_placement, joint_jacobian
from ..robot.names import motion_signs
from .impact_marks import short
from .page_file import Recorder, packed
from .shapes_in_contact import surface_points

NEUTRAL = (0.62, 0.64, 0.67)
"""Colour of shapes that have none."""
OUTLINES = 20
"""Approximate number of configurations that determine the outline of a motion."""
COUNT = np.arange(200.0)
TURN, RISE = np.pi * (1.0 + np.sqrt(5.0)) * COUNT, (2.0 * COUNT + 1.0) / len(COUNT) - 1.0
AROUND = np.column_stack([np.sqrt(1.0 - RISE**2) * np.cos(TURN), np.sqrt(1.0 - RISE**2) * np.sin(TURN), RISE])
"""Evenly distributed directions (200, 3), on a Fibonacci spiral."""
VIEWERS_GRID = 0.5
"""Size of the squares of the viewer's grid [m]."""


def send_meshes(model: pin.Model, shapes: pin.GeometryModel, recorder: Recorder) -> None:
    """Send each shape to the viewer once, at its place in the axes of its joint ("robot/JOINT")."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # meshcat imports a retired module of pyzmq
        import meshcat
        from pinocchio.visualize import MeshcatVisualizer
    shapes = _colored(shapes)
    view = meshcat.Visualizer(window=recorder)
    number = {shape.name: k for k, shape in enumerate(shapes.geometryObjects)}

    class ByJoint(MeshcatVisualizer):
        def getViewerNodeName(self, shape: Any, _: Any) -> str:
            return f"robot/{shape.parentJoint}/{number[shape.name]}"

    display = ByJoint(model, None, shapes)
    display.initViewer(viewer=view)
    with warnings.catch_warnings():
        # Pinocchio tests the truth value of XML elements of Collada meshes, deprecated since Python 3.12; if
        # the warning were an error, the mesh would be missing
        warnings.simplefilter("ignore", DeprecationWarning)
        display.loadViewerModel()
    for shape in shapes.geometryObjects:
        place = shape.placement.homogeneous @ np.diag([*np.ravel(shape.meshScale), 1.0])
        view[display.getViewerNodeName(shape, None)].set_transform(place)


def _colored(shapes: pin.GeometryModel) -> pin.GeometryModel:
    """Return shapes with a neutral grey for those without a colour, which Pinocchio reports as black."""
    colored = pin.GeometryModel()
    for shape in shapes.geometryObjects:
        copy = shape.copy()
        if not np.any(copy.meshColor[:3]):
            copy.meshColor = np.array([*NEUTRAL, copy.meshColor[3]])
        colored.addGeometryObject(copy)
    return colored


def outline(model: pin.Model, shapes: Any, configurations: Sequence[Array]) -> Array:
    """Return points (k, 3) in world axes whose convex hull contains a robot at some configurations."""
    data, found = data_of(model), [np.zeros((0, 3))]
    solids = [] if shapes is None else list(shapes.geometryObjects)
    corners = [_moved(shape.placement, extreme(surface_points(shape.geometry))) for shape in solids]
    every = max(1, len(configurations) // OUTLINES)
    for q in [*configurations[::every], *configurations[-1:]] if model.njoints > 1 else ():
        forward_kinematics(model, data, q)
        found += [
            _moved(data.oMi[shape.parentJoint], points) for shape, points in zip(solids, corners, strict=True)
        ]
        if not solids:
            found.append(
                np.array([frame_placement(model, data, k).translation for k in range(model.nframes)])
            )
    return np.vstack(found)


def _moved(place: pin.SE3, points: Array) -> Array:
    moved: Array = points @ place.rotation.T + place.translation
    return moved


def extreme(points: Array) -> Array:
    """Return the extreme points of (n, 3) in the directions of `AROUND`."""
    return points[np.unique((points @ AROUND.T).argmax(axis=0))]


def grid_square(size: float) -> float:
    """Return the size 1, 2 or 5 · 10ⁿ of a grid's squares for an object of this size [m]."""
    least = 0.1 * size
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least))


def send_background(recorder: Recorder, height: float, grid: float) -> None:
    """Send a light background, and a grid [m] at a height, to the viewer; no grid if its size is zero."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    view = meshcat.Visualizer(window=recorder)
    view["/Background"].set_property("top_color", [0.93, 0.95, 0.97])
    view["/Background"].set_property("bottom_color", [0.75, 0.78, 0.82])
    view["/Axes"].set_property("visible", False)
    view["/Grid"].set_property("visible", grid > 0.0)
    if grid > 0.0:
        place = np.diag([grid / VIEWERS_GRID] * 3 + [1.0])
        place[2, 3] = height
        view["/Grid"].set_transform(place)


def joint_poses(model: pin.Model, configurations: Sequence[Array]) -> Array:
    """Return (frames, joints, 7) positions and unit quaternions x, y, z, w of all joints in world axes."""
    data = data_of(model)
    poses = np.empty((len(configurations), model.njoints, 7))
    for frame, q in enumerate(configurations):
        forward_kinematics(model, data, q)
        for joint, placement in enumerate(data.oMi):
            poses[frame, joint] = pin.SE3ToXYZQUAT(placement)
    for frame in range(1, len(configurations)):  # ±quaternions are the same rotation: choose the nearer
        away = np.sum(poses[frame, :, 3:] * poses[frame - 1, :, 3:], axis=1) < 0.0
        poses[frame, away, 3:] *= -1.0
    return poses


def turning_speeds(model: pin.Model, velocities: Array) -> Array:
    """Return a bound of the angular speeds of all bodies at velocities (n, nv), (n,) [rad/s].

    It is the largest sum of the speeds of rotation along a chain of joints.
    """
    turns = joint_jacobian(model, data_of(model), pin.neutral(model))[3:].any(axis=0)
    chains = np.array([motion_signs(model, joint, 0) for joint in range(model.njoints)])
    return np.asarray((np.abs(velocities) @ (chains * turns).T).max(axis=1))


def joints_as_data(poses: Array, wanted: Sequence[int]) -> dict[str, Any]:
    """Return the poses of joints for the player, moving and fixed joints separately."""
    moves = {joint: bool(np.ptp(poses[:, joint], axis=0).any()) for joint in wanted}
    return {
        "joints": {str(joint): packed(poses[:, joint]) for joint in wanted if moves[joint]},
        "still": {str(joint): short(poses[0, joint]) for joint in wanted if not moves[joint]},
    }


def skeleton(model: pin.Model) -> tuple[list[tuple[int, int]], list[list[float]]]:
    """Return the lines by which a robot without shapes is drawn.

    These are links, as pairs of a joint and its parent (without links from the world to a translating base),
    and spots, as a joint and the position in its axes of each frame that is not at the joint's origin.
    """
    links = [
        (int(model.parents[joint]), joint)
        for joint in range(1, model.njoints)
        if model.parents[joint] > 0 or not model.joints[joint].createData().S[:3].any()
    ]
    spots = {
        (int(frame.parentJoint), *short(frame.placement.translation))
        for frame in model.frames
        if frame.parentJoint > 0 and not np.allclose(frame.placement.translation, 0.0)
    }
    return links, [list(spot) for spot in sorted(spots)]
