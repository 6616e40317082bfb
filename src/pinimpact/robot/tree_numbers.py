"""Numbers of a model for the kernels of its tree, read in place under assumptions of `pinocchio_bridge`."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .._compile.jit import compile_all
from ..arrays import Array, Integers
from ..geometry._kernels.contact_axes import contact_axes
from . import pinocchio_bridge as bridge
from ._kernels import robot_workspace as joint_kinds
from ._kernels.robot_impact import robot_impact, room_for
from ._kernels.robot_workspace import RobotWorkspace
from ._kernels.tree_matrices import BODY, evaluate_tree

_ALONG = np.eye(3)
_AXES = {"X": 0, "Y": 1, "Z": 2}
_ONE_AXIS = {"R": joint_kinds.REVOLUTE, "RUB": joint_kinds.UNBOUNDED, "P": joint_kinds.PRISMATIC}
UNALIGNED = {
    "RevoluteUnaligned": joint_kinds.REVOLUTE,
    "RevoluteUnboundedUnaligned": joint_kinds.UNBOUNDED,
    "PrismaticUnaligned": joint_kinds.PRISMATIC,
}
_MANY_AXES = {  # kind, and of each velocity whether it is a rotation, and its axis
    "FreeFlyer": (joint_kinds.FREE_FLYER, (0, 0, 0, 1, 1, 1), (0, 1, 2, 0, 1, 2)),
    "Spherical": (joint_kinds.SPHERICAL, (1, 1, 1), (0, 1, 2)),
    "Translation": (joint_kinds.TRANSLATION, (0, 0, 0), (0, 1, 2)),
    "Planar": (joint_kinds.PLANAR, (0, 0, 1), (0, 1, 2)),
}


class Tree(NamedTuple):
    """The numbers of a robot for `RobotWorkspace`: sizes, and arrays that its contacts share."""

    sizes: dict[str, int]
    arrays: dict[str, NDArray[Any]]


def tree_of(model: pin.Model, parts: Sequence[pin.Model]) -> Tree | None:
    """Return the numbers of a model for `tree_matrices`, or None if it does not support some joints.

    `parts`, models of its trees or the model itself, are used in the check.
    """
    if bridge.flaw(model) is not None:
        return None
    compile_all((robot_impact,), (evaluate_tree,), (contact_axes,))  # all kernels of an impact, in parallel
    if not all(bridge.trusted(part, disagreement_of_tree) for part in parts):
        return None
    with contextlib.suppress(bridge.ElsewhereError):
        return _tree(model)
    return None


def _tree(model: pin.Model) -> Tree | None:
    joints, nv = model.njoints, model.nv
    kinds, axes = np.zeros((2, joints), dtype=np.int64)
    turns, joint_of, along = np.zeros(nv, dtype=np.int64), np.zeros(nv, dtype=np.int64), np.zeros((nv, 3))
    for j in range(1, joints):
        joint = model.joints[j].createData()
        name = joint.shortname().removeprefix("JointData").removesuffix("Tpl")
        first = model.idx_vs[j]
        rows = slice(first, first + model.nvs[j])
        axes[j] = -1
        if name in _MANY_AXES:
            kinds[j], turns[rows], places = _MANY_AXES[name]
            along[rows] = _ALONG[list(places)]
        elif name in UNALIGNED or name[:-1] in _ONE_AXIS:
            kinds[j] = UNALIGNED[name] if name in UNALIGNED else _ONE_AXIS[name[:-1]]
            axes[j] = _AXES.get(name[-1], -1) if name not in UNALIGNED else -1
            turns[rows] = kinds[j] != joint_kinds.PRISMATIC
            along[rows] = joint.S.ravel()[3:] if kinds[j] != joint_kinds.PRISMATIC else joint.S.ravel()[:3]
        else:
            return None
        joint_of[rows] = j
    if len(joint_of) != sum(model.nvs[j] for j in range(1, joints)):
        return None
    arrays = {
        "joint_placements": bridge.rows(model.jointPlacements, model.jointPlacements, "jointPlacements"),
        "inertias": _inertias(model),
        "armature": _in_place(model.armature, model.armature, "armature"),
        "joint_kind": kinds,
        "joint_parent": np.array(list(model.parents), dtype=np.int64),
        "joint_q": np.array([max(x, 0) for x in model.idx_qs], dtype=np.int64),
        "joint_v": np.array([max(x, 0) for x in model.idx_vs], dtype=np.int64),
        "joint_axis": axes,
        "velocity_joint": joint_of,
        "velocity_turns": turns,
        "velocity_axis": along,
        "scratch": np.zeros(room_for(nv, joints)),  # shared by all contacts, which use it one after another
    }
    sizes = {"nq": model.nq, "nv": nv, "bodies": joints, "room": room_for(nv, joints)}
    return Tree(sizes, arrays)


def _inertias(model: pin.Model) -> Array:
    """Return (nj, 10) mass, centre and inertia of a model's joints in place."""
    count = model.njoints
    start = model.inertias[0].lever.__array_interface__["data"][0] - 8
    for k in (0, min(1, count - 1), count - 1):
        levers = model.inertias[k].lever, model.inertias[k].lever
        if any(lever.__array_interface__["data"][0] != start + 80 * k + 8 for lever in levers):
            raise bridge.ElsewhereError("model.inertias")
    return bridge.at(start, 10 * count).reshape(count, 10)


def _in_place(array: Array, again: Array, name: str) -> Array:
    """Return the array of a property, if two accesses have the same memory."""
    start = array.__array_interface__["data"][0]
    if again.__array_interface__["data"][0] != start or not bridge.by_row(array):
        raise bridge.ElsewhereError(name)
    return bridge.at(start, array.size)


def placement_of_frame(model: pin.Model, frame: int) -> Array:
    """Return (12,) the placement of a frame on its joint, in place, or raise `ElsewhereError`."""
    return bridge.rows([model.frames[frame].placement], [model.frames[frame].placement], "frames")[0]


def disagreement_of_tree(model: pin.Model) -> str | None:
    """Return which result of `tree_matrices` differs from Pinocchio's, or None."""
    model, q, _, _ = bridge.probe(model)
    model.armature = np.linspace(0.1, 0.2, model.nv)
    try:
        tree = _tree(model)
    except bridge.ElsewhereError as place:
        return f"the place of {place} in memory"
    if tree is None:
        return None
    data = model.createData()
    parents = np.array(data.parents_fromRow, dtype=np.int64)
    work = workspace_of(tree, 0, 0, model, np.zeros((2, model.nq)), parents, np.zeros(model.nv))
    bodies, columns, mass = (
        np.zeros((model.njoints, BODY)),
        np.zeros((model.nv, 6)).T,
        np.zeros((model.nv,) * 2),
    )
    evaluate_tree(work, q, bodies, columns, mass)
    pin.forwardKinematics(model, data, q)
    origin = data.oMi[1].translation
    expected = np.array([[*x.rotation.T.ravel(), *(x.translation - origin)] for x in data.oMi])
    if not bridge.agree(bodies[:, :12], expected):
        return "the placements of joints"
    jacobian = pin.computeJointJacobians(model, model.createData(), q).reshape(6, -1)
    jacobian[:3] += np.cross(jacobian[3:], origin, axis=0)
    if not bridge.agree(columns, jacobian):
        return "the joint Jacobian"
    expected = np.tril(pin.crba(model, data, q))
    for i in range(model.nv):
        above, k = [], i
        while k >= 0:
            above.append(k)
            k = parents[k]
        expected[i, [j for j in range(model.nv) if j not in above]] = 0.0
    return None if bridge.agree(mass, expected) else "the mass matrix"


def workspace_of(
    tree: Tree,
    frame: int,
    carrier: int,
    model: pin.Model,
    bounds: Array,
    parents: Integers,
    signs: Array,
) -> RobotWorkspace:
    """Return the workspace of a contact, without the constants of the contact.

    Args:
        tree: Numbers of the model.
        frame: Id of the frame of the contact.
        carrier: Id of the frame of the surface, 0 for the world.
        model: The model.
        bounds: (2, nq) joint limits.
        parents: (nv,) next velocity towards the root, or −1.
        signs: (nv,) as in `contact_kinematics.fill_jacobian`.
    """
    arrays = tree.arrays | {
        "frame": placement_of_frame(model, frame),
        "carrier": placement_of_frame(model, carrier),
        "velocity_parent": parents,
        "bounds": bounds,
        "signs": signs,
    }
    work = RobotWorkspace(tree.sizes, arrays)
    work.frame_joint = model.frames[frame].parentJoint
    work.carrier_joint = model.frames[carrier].parentJoint
    return work
