"""What one wants to know of a robot before it strikes: its joints, its frames, which of them may touch."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import numpy as np
import pinocchio as pin

from ..robot.joint_limits import bounds

TOOLS = r"tcp|tool|\bee\b|\beef\b|end.?effector|gripper|hand\b"
FEET = r"foot|feet|sole|toe|contact|paw|ankle"
TIPS = r"tip|finger|nub|jaw|palm|wrist|ball"
SENSORS = (
    r"imu|cam(era)?\b|laser|lidar|sonar|radar|optical|sensor|rgb|depth|\bcom\b|inertia|rotor|propeller|screen"
    r"|display|velodyne|ultrasound|\bdh\b|battery|world"
)


def suggested_frames(model: pin.Model) -> list[int]:
    """Return the ids of frames that may touch something, what most likely does first.

    They are the outermost ones: of each joint that carries no other the frame that is called a tool, a foot
    or a tip, or else the one farthest from the joint, but no sensor; and tools further inside. A free base
    has its feet first, a fixed one its tools.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    names = Counter(frame.name for frame in model.frames)
    outer = {j for j in range(1, model.njoints) if not len(model.children[j])}
    order = (FEET, TOOLS, TIPS) if free_base(model) else (TOOLS, FEET, TIPS)
    best: dict[Any, tuple[tuple[float, ...], int]] = {}
    for i, frame in enumerate(model.frames):
        joint = frame.parentJoint
        name = re.sub(r"[^a-z]+", " ", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", frame.name).lower())
        if joint == 0 or re.search(SENSORS, name):
            continue
        kind = next((k for k, words in enumerate(order) if re.search(words, name)), len(order))
        tool = kind == order.index(TOOLS)
        if joint not in outer and not tool:
            continue
        reach = float(np.linalg.norm(frame.placement.translation))
        body = frame.type == pin.FrameType.BODY
        depth = float(len(model.supports[joint]))
        rank = (kind, 0.0 if body and names[frame.name] == 1 else 1.0, -depth, -reach)
        place = joint if joint in outer else f"tool of {joint}"
        if place not in best or rank < best[place][0]:
            best[place] = rank, i
    return [i for _, i in sorted(best.values())]


def free_base(model: pin.Model) -> bool:
    """Return whether the robot's base flies freely."""
    return model.njoints > 1 and model.joints[1].shortname() == "JointModelFreeFlyer"


def frame_label(model: pin.Model, i: int) -> str | int:
    """Return what a `Contact` is told of a frame: its name, or its id where others bear the name too."""
    name = model.frames[i].name
    return str(name) if sum(frame.name == name for frame in model.frames) == 1 else i


def robot_facts(name: str, robot: pin.RobotWrapper) -> dict[str, Any]:
    """Return what there is to know of a robot, as plain data: lists, numbers [SI] and text."""
    model = robot.model
    low, high = bounds(model)
    joints = []
    for j in range(1, model.njoints):
        at, count = model.idx_qs[j], model.nqs[j]
        plain = count == model.nvs[j]
        first = model.idx_vs[j]
        joints.append(
            {
                "name": model.names[j],
                "kind": _kind(model.joints[j].shortname()),
                "coordinates": count,
                "velocities": model.nvs[j],
                "lower": [None if not plain or x == -np.inf else float(x) for x in low[at : at + count]],
                "upper": [None if not plain or x == np.inf else float(x) for x in high[at : at + count]],
                "damping": model.damping[first : first + model.nvs[j]].tolist(),
                "friction": model.friction[first : first + model.nvs[j]].tolist(),
            }
        )
    frames = [
        {
            "id": i,
            "name": frame.name,
            "joint": model.names[frame.parentJoint],
            "kind": str(frame.type).lower(),
        }
        for i, frame in enumerate(model.frames)
    ]
    return {
        "robot": name,
        "free_base": free_base(model),
        "nq": model.nq,
        "nv": model.nv,
        "mass": float(pin.computeTotalMass(model)),
        "q0": np.asarray(robot.q0).tolist(),
        "shapes": {
            "visual": robot.visual_model.ngeoms if robot.visual_model is not None else 0,
            "collision": len(_collision_shapes(robot)),
        },
        "collision_shapes": [shape.name for shape in _collision_shapes(robot)],
        "contact_frames": [frame_label(model, i) for i in suggested_frames(model)],
        "joints": joints,
        "frames": frames,
    }


def _collision_shapes(robot: pin.RobotWrapper) -> list[pin.GeometryObject]:
    return [] if robot.collision_model is None else list(robot.collision_model.geometryObjects)


_KINDS = (
    ("FreeFlyer", "free"),
    ("Spherical", "spherical"),
    ("Planar", "planar"),
    ("Translation", "translation"),
    ("Composite", "composite"),
    ("RUB", "continuous"),
    ("RevoluteUnbounded", "continuous"),
    ("Universal", "universal"),
    ("Helical", "helical"),
    ("H", "helical"),
    ("R", "revolute"),
    ("P", "prismatic"),
    ("Mimic", "mimic"),
)


def _kind(shortname: str) -> str:
    """Return what a joint of Pinocchio's is called in a URDF."""
    kind = shortname.removeprefix("JointModel")
    return next((word for start, word in _KINDS if kind.startswith(start)), kind.lower())
