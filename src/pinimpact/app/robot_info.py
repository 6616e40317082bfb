"""Information about a robot: joints, frames, and suggested contact frames."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import numpy as np
import pinocchio as pin

from ..robot.joint_limits import bounds
from ..robot.names import free_base

TOOLS = r"tcp|tool|\bee\b|\beef\b|end.?effector|gripper|hand\b"
FEET = r"foot|feet|sole|toe|contact|paw|ankle"
TIPS = r"tip|finger|nub|jaw|palm|wrist|ball"
SENSORS = (
    r"imu|fsr|cam(era)?\b|laser|lidar|sonar|radar|optical|sensor|rgb|depth|\bcom\b|inertia|rotor|propeller|screen"
    r"|display|velodyne|ultrasound|\bdh\b|battery|world"
)


def suggested_frames(model: pin.Model) -> list[int]:
    """Return the ids of suggested contact frames, the most likely first.

    For each joint without children this is the frame whose name is that of a tool, a foot or a tip, or else
    the frame farthest from the joint; sensors are excluded. Tools at other joints are added. A link at the
    end of a chain is classified by the links to which it is fixed: the end of a hand is a tool. Feet come
    first for a free base, tools for a fixed base.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    names = Counter(frame.name for frame in model.frames)
    outer = {j for j in range(1, model.njoints) if not len(model.children[j])}
    order = (FEET, TOOLS, TIPS) if free_base(model) else (TOOLS, FEET, TIPS)
    kinds = [
        next((k for k, words in enumerate(order) if re.search(words, _words(frame.name))), len(order))
        for frame in model.frames
    ]
    for i in _chain_ends(model):
        joint, parent, passed = model.frames[i].parentJoint, model.frames[i].parentFrame, {i}
        # in reduced models the parents of frames can form a cycle
        while parent not in passed and model.frames[parent].parentJoint == joint:
            kinds[i] = min(kinds[i], kinds[parent])
            passed.add(parent)
            parent = model.frames[parent].parentFrame
    best: dict[Any, tuple[tuple[float, ...], int]] = {}
    for i, frame in enumerate(model.frames):
        joint = frame.parentJoint
        if joint == 0 or re.search(SENSORS, _words(frame.name)):
            continue
        kind = kinds[i]
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


def _chain_ends(model: pin.Model) -> list[int]:
    """Return the ids of moving links without children, except sensors."""
    parents = {frame.parentFrame for frame in model.frames}
    return [
        i
        for i, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint != 0
        and i not in parents
        and not len(model.children[frame.parentJoint])
        and not re.search(SENSORS, _words(frame.name))
    ]


def _words(name: str) -> str:
    """Return a name in lower case, with spaces between its words."""
    return re.sub(r"[^a-z]+", " ", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())


def frame_label(model: pin.Model, i: int) -> str | int:
    """Return the key of a frame for a `Contact`: its name, or its id if the name is not unique."""
    name = model.frames[i].name
    return str(name) if sum(frame.name == name for frame in model.frames) == 1 else i


def robot_facts(name: str, robot: pin.RobotWrapper) -> dict[str, Any]:
    """Return information about a robot as plain data: lists, numbers [SI] and text."""
    model = robot.model
    low, high = bounds(model)
    joints = []
    for j in range(1, model.njoints):
        at, count = model.idx_qs[j], model.nqs[j]
        plain = count == model.nvs[j]
        first, kind = model.idx_vs[j], model.joints[j].shortname().removeprefix("JointModel")
        joints.append(
            {
                "name": model.names[j],
                "kind": next((word for start, word in _KINDS if kind.startswith(start)), kind.lower()),
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
            "place": frame.placement.translation.tolist(),
        }
        for i, frame in enumerate(model.frames)
    ]
    ends = [i for i in _chain_ends(model) if np.any(model.frames[i].placement.translation)]
    solids = [] if robot.collision_model is None else robot.collision_model.geometryObjects
    shapes = [shape.name for shape in solids]
    return {
        "robot": name,
        "free_base": free_base(model),
        "nq": model.nq,
        "nv": model.nv,
        "mass": float(pin.computeTotalMass(model)),
        "q0": np.asarray(robot.q0).tolist(),
        "shapes": {
            "visual": robot.visual_model.ngeoms if robot.visual_model is not None else 0,
            "collision": len(shapes),
        },
        "collision_shapes": shapes,
        "contact_frames": [frame_label(model, i) for i in dict.fromkeys([*suggested_frames(model), *ends])],
        "joints": joints,
        "frames": frames,
    }


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
"""URDF names of joints by the first letters of Pinocchio's names; the first match applies."""
