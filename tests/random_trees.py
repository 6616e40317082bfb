"""Random scenes: robots and random trees of all kinds of joints, dropped onto planes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin

from pinimpact import Contact, Plane, Scene, load_robot

SOLES = {
    "g1": (("left_ankle_roll_link", "right_ankle_roll_link"), (0.12, -0.05), 0.03, -0.03),
    "icub": (("l_sole", "r_sole"), (0.1, -0.05), 0.03, 0.0),
}
"""Frames of the feet; x of toe and heel, half the width, and z of the corners of the soles [m]."""
TIPS = {
    "ur10": ("tool0", "wrist_1_link"),
    "go2": ("FL_foot", "FR_foot", "RL_foot", "RR_foot"),
    "pr2": ("l_gripper_tool_frame", "r_gripper_tool_frame"),
}
BODIES = 9
"""Bound of the number of bodies of a random tree, exclusive."""


@cache
def _robot(name: str) -> tuple[pin.Model, np.ndarray, tuple[str, ...]]:
    """Return the model of a robot, a reference configuration, and the names of contact frames."""
    robot = load_robot(name)
    model, tips = robot.model, TIPS.get(name, ())
    if name in SOLES:
        feet, along, across, height = SOLES[name]
        for foot in feet:
            frame = model.frames[model.getFrameId(foot)]
            for k, corner in enumerate([(x, y, height) for x in along for y in (-across, across)]):
                placement = frame.placement * pin.SE3(np.eye(3), np.array(corner))
                tips += (f"{foot} {k}",)
                model.addFrame(pin.Frame(tips[-1], frame.parentJoint, placement, pin.FrameType.OP_FRAME))
    return model, pin.normalize(model, robot.q0), tips


def _unit(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


JOINTS: dict[str, Callable[[np.random.Generator], pin.JointModel]] = {
    "revolute": lambda rng: pin.JointModelRZ(),
    "slanted": lambda rng: pin.JointModelRevoluteUnaligned(_unit(rng)),
    "prismatic": lambda rng: pin.JointModelPrismaticUnaligned(_unit(rng)),
    "spherical": lambda rng: pin.JointModelSpherical(),
    "planar": lambda rng: pin.JointModelPlanar(),
    "unbounded": lambda rng: pin.JointModelRUBX(),
    "translation": lambda rng: pin.JointModelTranslation(),
}


def tree(rng: np.random.Generator) -> tuple[pin.Model, np.ndarray, tuple[str, ...]]:
    """Return a random tree of bodies, fixed or free, with a frame on the last body and on some others."""
    model, tips = pin.Model(), ()
    first = 0
    if rng.random() < 0.4:
        first = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        model.appendBodyToJoint(first, pin.Inertia.FromBox(3.0, 0.3, 0.2, 0.1), pin.SE3.Identity())
    count = int(rng.integers(1, BODIES))
    branch = [first]  # Pinocchio requires depth-first order of the joints
    for k in range(count):
        if rng.random() < 0.3:
            del branch[int(rng.integers(1, len(branch) + 1)) :]
        parent = branch[-1]
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * _unit(rng))
        joint = model.addJoint(parent, JOINTS[str(rng.choice(list(JOINTS)))](rng), placement, f"joint{k}")
        sizes = rng.uniform(0.03, 0.2, 3)
        inertia = pin.Inertia.FromBox(10 ** rng.uniform(-1.0, 0.7), *sizes)
        model.appendBodyToJoint(joint, inertia, pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * _unit(rng)))
        branch.append(joint)
        if k == count - 1 or rng.random() < 0.3:
            tips += (f"tip{k}",)
            placement = pin.SE3(np.eye(3), 0.2 * _unit(rng))
            model.addFrame(pin.Frame(tips[-1], joint, placement, pin.FrameType.OP_FRAME))
    return model, pin.neutral(model), tips


def draw(seed: int) -> tuple[str, Scene, np.ndarray, np.ndarray, float]:
    """Return a name, a scene, configuration and velocity above its plane, and a tolerance."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice([*TIPS, *SOLES, "tree"], p=[0.15, 0.1, 0.05, 0.05, 0.05, 0.6]))
    model, q0, tips = tree(rng) if name == "tree" else _robot(name)
    spread = 0.1 if name in SOLES else 0.3
    q = pin.normalize(model, pin.integrate(model, q0, spread * rng.normal(size=model.nv)))
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    bounded = (np.abs(lower) < 1e3) & (np.abs(upper) < 1e3) & (upper > lower)
    q[bounded] = np.clip(q[bounded], lower[bounded] + 1e-3, upper[bounded] - 1e-3)
    q = pin.normalize(model, q)  # bounds also apply to components of quaternions
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    normal = np.array([0.0, 0.0, 1.0])
    if rng.random() < 0.5:
        normal[:2] = 0.2 * rng.normal(size=2)
        normal /= np.linalg.norm(normal)
    heights = [normal @ data.oMf[model.getFrameId(tip)].translation for tip in tips]
    below = min(heights) - rng.uniform(1e-3, 0.3)
    plane = Plane(point=tuple(below * normal), normal=tuple(normal))
    friction, restitution = rng.choice([0.0, 0.2, 0.4, 0.8, 1.2]), rng.choice([0.0, 0.0, 0.3, 0.5, 0.9])
    contacts = [Contact(tip, plane, friction=friction, restitution=restitution) for tip in tips]
    scene = Scene(model, contacts, limit_restitution=float(rng.choice([0.0, 0.3])))
    v = rng.choice([0.0, 0.5, 2.0]) * rng.normal(size=model.nv)
    return f"{name} (nv = {model.nv})", scene, q, v, float(10 ** rng.uniform(-8, -3))
