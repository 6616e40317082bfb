"""Ids of names in a Pinocchio model, with errors that suggest similar names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from ..checks import as_tuple, coefficient, counted, near_matches, real_number, whole_number
from ..errors import InputError, ModelError, UnknownNameError

Stiffening: TypeAlias = float | Mapping[str, float] | None
"""Stiffening of all joints with one velocity, or by joint; None: of none."""


def frame_id(model: pin.Model, key: str | int, field: str = "frame") -> int:
    """Return the id of a frame given by name or id.

    Raises `UnknownNameError` if no frame has the name, with similar ones, or several have it, with their ids.
    """
    if not isinstance(key, str):
        if not 0 <= key < model.nframes:
            raise UnknownNameError(
                f"{field}: there is no frame {key}; this model's frames are 0 to {model.nframes - 1}",
                value=key,
            )
        return int(key)
    ids = [i for i, frame in enumerate(model.frames) if frame.name == key]
    if not ids:
        raise UnknownNameError(
            f"{field}: no frame is called {key!r}; {near_matches(key, (f.name for f in model.frames))}",
            value=key,
        )
    if len(ids) > 1:
        bearers = ", ".join(
            f"{i} ({str(model.frames[i].type).lower().replace('_', ' ')}, "
            f"on joint {model.names[model.frames[i].parentJoint]!r})"
            for i in ids
        )
        raise UnknownNameError(
            f"{field}: {len(ids)} frames are called {key!r}; give the id of one of them: {bearers}", value=key
        )
    return ids[0]


def coordinate_names(model: pin.Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names of the entries of q and of v: the joint's, with a suffix if it has several."""
    q: list[str] = []
    v: list[str] = []
    for joint, name in zip(list(model.joints)[1:], list(model.names)[1:], strict=True):
        turns = (joint.nq, joint.nv) == (2, 1)  # without limits
        numbers = tuple(map(str, range(joint.nq)))
        known = ("cos", "sin") if turns else numbers, numbers[: joint.nv]
        parts = _COORDINATES.get(joint.shortname().removeprefix("JointModel"), known)
        for entries, suffixes in zip((q, v), parts, strict=True):
            entries += [f"{name}.{suffix}" if len(suffixes) > 1 else name for suffix in suffixes]
    return tuple(q), tuple(v)


_TURN, _TURNING = ("qx", "qy", "qz", "qw"), ("wx", "wy", "wz")
_COORDINATES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "FreeFlyer": (("x", "y", "z", *_TURN), ("vx", "vy", "vz", *_TURNING)),
    "Spherical": (_TURN, _TURNING),
    "Planar": (("x", "y", "cos", "sin"), ("vx", "vy", "wz")),
    "Translation": (("x", "y", "z"), ("vx", "vy", "vz")),
}
"""Suffixes for Pinocchio's joints with several coordinates that have names."""


def motion_signs(model: pin.Model, joint: int, other: int) -> np.ndarray:
    """Return (nv,) 1 for velocities that move a joint and not the other, −1 for the reverse, else 0."""
    signs = np.zeros(model.nv)
    for end, sign in ((joint, 1.0), (other, -1.0)):
        for support in list(model.supports[end])[1:]:
            signs[model.idx_vs[support] : model.idx_vs[support] + model.nvs[support]] += sign
    return signs


def free_velocities(model: pin.Model, locked: Sequence[str | int]) -> np.ndarray:
    """Return (nv,) booleans: False for the velocities of the joints named (or numbered) in `locked`."""
    free = np.ones(model.nv, dtype=np.bool_)
    for key in joint_keys(locked):
        joint = joint_id(model, key, "locked")
        free[model.idx_vs[joint] : model.idx_vs[joint] + model.nvs[joint]] = False
    return free


def mobilities(model: pin.Model, locked: Sequence[str | int], stiffening: Stiffening = None) -> np.ndarray:
    """Return (nv,) √(1 − s) for the stiffening s of each velocity: 1 where it is free, 0 where locked. (1.7)

    Raises `InputError` for a stiffening that is not between 0 and 1, or of a joint that has not one velocity.
    """
    stiff = np.zeros(model.nv)
    if isinstance(stiffening, Mapping):
        for key, value in stiffening.items():
            joint = joint_id(model, key, "stiffening")
            if model.nvs[joint] != 1:
                raise _not_stiffened(f"joint {key!r} has {counted(model.nvs[joint], 'velocity')}", key)
            stiff[model.idx_vs[joint]] = coefficient(f"stiffening[{key!r}]", value)
    elif is_stiff(stiffening):
        joints = single_joints(model)
        if not joints:
            raise _not_stiffened("the model has no such joint", stiffening)
        stiff[list(joints.values())] = coefficient("stiffening", stiffening)
    return np.where(free_velocities(model, locked), np.sqrt(1.0 - stiff), 0.0)


def is_stiff(stiffening: Stiffening) -> bool:
    """Return whether a stiffening may stiffen joints, that is, is neither None nor 0."""
    if stiffening is None or isinstance(stiffening, Mapping):
        return stiffening is not None
    return real_number("stiffening", stiffening) != 0.0


def free_base(model: pin.Model) -> bool:
    """Return whether the first joint of a robot is free."""
    return model.njoints > 1 and model.joints[1].shortname() == "JointModelFreeFlyer"


def single_joints(model: pin.Model) -> dict[str, int]:
    """Return the index of the velocity of each joint that has one, by name."""
    joints = zip(model.names, model.idx_vs, model.nvs, strict=True)
    return {name: v for name, v, count in joints if count == 1}


def _not_stiffened(what: str, value: Any) -> InputError:
    """Return the error for a stiffening of joints that do not have one velocity."""
    return InputError(
        f"stiffening: {what}; it is for joints with one velocity, others can only be locked", value=value
    )


def joint_id(model: pin.Model, key: Any, field: str) -> int:
    """Return the id of a joint given by name or id."""
    joint = model.getJointId(key) if isinstance(key, str) else whole_number(field, key, 0)
    if isinstance(key, str) and joint == model.njoints:
        raise UnknownNameError(
            f"{field}: no joint is called {key!r}; {near_matches(key, list(model.names)[1:])}", value=key
        )
    if not 0 < joint < model.njoints:
        raise UnknownNameError(
            f"{field}: there is no joint {key}; this model's joints are 1 to {model.njoints - 1}", value=key
        )
    return int(joint)


def joint_keys(locked: Any) -> tuple[str | int, ...]:
    """Return joints, by name or id, as a tuple; one alone need not be wrapped."""
    return as_tuple("locked", locked, (str, int, np.integer), "the name or id of a joint")


def joint_of_velocity(model: pin.Model, velocity: int) -> str:
    """Return the name of the joint of a velocity index."""
    return str(
        model.names[max(j for j in range(1, model.njoints) if model.idx_vs[j] <= velocity and model.nvs[j])]
    )


def model_of(robot: Any) -> pin.Model:
    """Return the model of a RobotWrapper, or the model itself, or raise `InputError`."""
    if isinstance(robot, pin.Model):
        return robot
    model = getattr(robot, "model", None)
    if not isinstance(model, pin.Model):
        raise InputError(
            f"model: a pinocchio Model or RobotWrapper is expected, not {type(robot).__name__}", value=robot
        )
    return model


class ShapedRobot(NamedTuple):
    """A model and its collision shapes, as in a RobotWrapper, without a Data."""

    model: pin.Model
    collision_model: pin.GeometryModel | None  # its shapes, if there are any


def singular_mass(model: pin.Model, velocity: int) -> ModelError:
    """Return the error for a mass matrix whose factorization stops at a velocity."""
    name = joint_of_velocity(model, velocity)
    reason = (
        f"moves no inertia; give its links inertia or model.armature[{velocity}] a rotor inertia, or lock "
        "the joint"
    )
    for carried in model.subtrees[model.getJointId(name)]:
        mass = model.inertias[carried].mass
        if not np.isfinite(model.inertias[carried].toDynamicParameters()).all():
            reason = (
                f"moves joint {model.names[carried]!r}, whose mass, center of mass or inertia is not finite "
                f"(mass {mass:.6g} kg); give it finite numbers"
            )
        elif mass < 0.0:
            reason = (
                f"moves the negative mass {mass:.6g} kg of joint {model.names[carried]!r}; give it one ≥ 0"
            )
    return ModelError(
        f"model: the mass matrix is not positive definite: joint {name!r} (velocity {velocity}) {reason}",
        value=name,
    )
