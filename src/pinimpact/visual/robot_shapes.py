"""A robot as what moves with each of its joints: its meshes, or lines where it has none."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .impact_marks import short
from .page_file import Recorder, packed

Array = NDArray[np.float64]


def send_meshes(model: pin.Model, shapes: pin.GeometryModel, recorder: Recorder) -> None:
    """Have the viewer make each shape once, at its place in the axes of its joint ("robot/JOINT")."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # meshcat imports a retired module of pyzmq
        import meshcat
        from pinocchio.visualize import MeshcatVisualizer
    view = meshcat.Visualizer(window=recorder)
    number = {shape.name: k for k, shape in enumerate(shapes.geometryObjects)}

    class ByJoint(MeshcatVisualizer):
        def getViewerNodeName(self, shape: Any, _: Any) -> str:
            return f"robot/{shape.parentJoint}/{number[shape.name]}"

    display = ByJoint(model, None, shapes)
    display.initViewer(viewer=view)
    with warnings.catch_warnings():
        # Pinocchio asks for the truth value of XML elements of Collada meshes, deprecated since Python 3.12;
        # as an error it would leave the mesh out
        warnings.simplefilter("ignore", DeprecationWarning)
        display.loadViewerModel()
    for shape in shapes.geometryObjects:
        place = shape.placement.homogeneous @ np.diag([*np.ravel(shape.meshScale), 1.0])
        view[display.getViewerNodeName(shape, None)].set_transform(place)


def send_background(recorder: Recorder, grid: bool) -> None:
    """Have the viewer show a light background, and its grid at z = 0 if wanted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    view = meshcat.Visualizer(window=recorder)
    view["/Background"].set_property("top_color", [0.93, 0.95, 0.97])
    view["/Background"].set_property("bottom_color", [0.75, 0.78, 0.82])
    view["/Axes"].set_property("visible", False)
    view["/Grid"].set_property("visible", grid)


def joint_poses(model: pin.Model, configurations: Sequence[Array]) -> Array:
    """Return (frames, joints, 7) positions and unit quaternions x, y, z, w of all joints in world axes."""
    data = model.createData()
    poses = np.empty((len(configurations), model.njoints, 7))
    for frame, q in enumerate(configurations):
        pin.forwardKinematics(model, data, q)
        for joint, placement in enumerate(data.oMi):
            poses[frame, joint] = pin.SE3ToXYZQUAT(placement)
    for frame in range(1, len(configurations)):  # a quaternion and its negative turn alike: take the nearer
        away = np.sum(poses[frame, :, 3:] * poses[frame - 1, :, 3:], axis=1) < 0.0
        poses[frame, away, 3:] *= -1.0
    return poses


def joints_as_data(poses: Array, wanted: Sequence[int]) -> dict[str, Any]:
    """Return the poses of joints as the player reads them, those that move apart from those that do not."""
    moves = {joint: bool(np.ptp(poses[:, joint], axis=0).any()) for joint in wanted}
    return {
        "joints": {str(joint): packed(poses[:, joint]) for joint in wanted if moves[joint]},
        "still": {str(joint): short(poses[0, joint]) for joint in wanted if not moves[joint]},
    }


def skeleton(model: pin.Model) -> tuple[list[tuple[int, int]], list[list[float]]]:
    """Return a robot without shapes as lines.

    Returns:
        Pairs of joints, each with the one it hangs from, but for a base that moves away from the world's
        origin; and each frame that is away from its joint as the joint and a point in its axes.
    """
    data, q = model.createData(), pin.neutral(model)
    links = [
        (int(model.parents[joint]), joint)
        for joint in range(1, model.njoints)
        if model.parents[joint] > 0 or not pin.computeJointJacobian(model, data, q, joint)[:3].any()
    ]
    spots = {
        (int(frame.parentJoint), *short(frame.placement.translation))
        for frame in model.frames
        if frame.parentJoint > 0 and np.linalg.norm(frame.placement.translation) > 1e-6
    }
    return links, [list(spot) for spot in sorted(spots)]
