"""Several robots in one model, each with its placement and names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError


@dataclass(frozen=True, eq=False)
class Placed:
    """A robot to be merged with others."""

    robot: pin.RobotWrapper
    prefix: str  # prefix of the names of its joints and frames
    placement: pin.SE3  # placement of its base in the world


def assemble(parts: Sequence[Placed]) -> pin.RobotWrapper:
    """Return one robot that consists of all parts, with their ``q0``.

    They need different prefixes and the same gravity.
    """
    prefixes = [part.prefix for part in parts]
    if not parts or len(set(prefixes)) < len(prefixes):
        raise InputError(
            f"robot: {len(parts)} robots with the prefixes {prefixes}; give each its own prefix",
            value=prefixes,
        )
    gravities = [tuple(np.array(part.robot.model.gravity.linear).tolist()) for part in parts]
    if len(set(gravities)) > 1:
        raise InputError(
            f"robot: robots with gravity {' and '.join(map(str, dict.fromkeys(gravities)))} given; give all "
            "of them the same, or set that of the scene (gravity = [...])",
            value=gravities,
        )
    if len(parts) == 1 and not parts[0].prefix and parts[0].placement.isIdentity():
        return parts[0].robot
    model = pin.Model()
    collision, visual = pin.GeometryModel(), pin.GeometryModel()
    for part in parts:
        added, *shapes = _renamed(part)
        _, visual = pin.appendModel(model, added, visual, shapes[1], 0, part.placement)
        model, collision = pin.appendModel(model, added, collision, shapes[0], 0, part.placement)
    model.name = ", ".join(part.prefix + part.robot.model.name for part in parts)
    # appendModel leaves these as they were
    model.armature = np.concatenate([part.robot.model.armature for part in parts])
    model.gravity = parts[0].robot.model.gravity
    whole = _Assembled(model, collision, visual)
    whole.q0 = np.concatenate([part.robot.q0 for part in parts])
    return whole


class _Assembled(pin.RobotWrapper):
    """A robot whose Data are created on first access: those of many parts are large."""

    def __init__(self, model: pin.Model, collision: pin.GeometryModel, visual: pin.GeometryModel) -> None:
        super().__init__()
        del self.data, self.collision_data, self.visual_data
        self.model, self.collision_model, self.visual_model = model, collision, visual
        self.v0 = np.zeros(model.nv)

    def __getattr__(self, name: str) -> Any:
        models = {"data": "model", "collision_data": "collision_model", "visual_data": "visual_model"}
        if name not in models:
            raise AttributeError(name)
        created = getattr(self, models[name]).createData()
        setattr(self, name, created)
        return created


def _renamed(part: Placed) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Return copies of a robot's model and shapes with prefixed names, except that of the universe."""
    model = part.robot.model.copy()
    for joint in range(1, model.njoints):
        model.names[joint] = part.prefix + model.names[joint]
    for frame in range(1, model.nframes):
        model.frames[frame].name = part.prefix + model.frames[frame].name
    copies = []
    for shapes in (part.robot.collision_model, part.robot.visual_model):
        copies.append(shapes.copy())
        for shape in copies[-1].geometryObjects:
            shape.name = part.prefix + shape.name
    return model, *copies
