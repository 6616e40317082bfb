"""All assumptions about Pinocchio beyond its documentation, and their checks.

An impact takes microseconds and kernels evaluate dynamics thousands of times, so they read Pinocchio's
results in place and obtain several of them from one call. This assumes that

- `crba` and `aba` in the world convention fill ``data.J`` and ``data.oMi``, `aba` also ``data.ov`` and
  ``data.oa_gf``, and `computeMinverse` without a configuration continues from there;
- a result has one address as long as its Data exist, and the placements and motions of the joints are
  consecutive in memory;
- a Python object can be called by its address and that of its tuple of arguments;
- placements and inertias of a model's joints are consecutive in memory, and the kind of a joint is
  identified by its name and axes.

None of this is documented. It is checked once for each model against documented calls on other Data;
addresses are checked for each Data before use. If a check fails, as it may in another version of Pinocchio,
the same results come from documented calls and are copied, which is slower, and a `PinocchioLayoutWarning` is
given once.
"""

from __future__ import annotations

import contextlib
import ctypes
import warnings
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .._compile.jit import compile_all
from ..errors import ModelError
from ..geometry._kernels.contact_axes import contact_axes
from ._kernels import tree
from ._kernels.free_bodies import BODY as BODIES
from ._kernels.free_bodies import accelerate_bodies, move_bodies
from ._kernels.robot_impact import robot_impact, room_for
from ._kernels.robot_workspace import (
    FREE_FLYER,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    TRANSLATION,
    UNBOUNDED,
    RobotWorkspace,
)
from ._kernels.tree_matrices import BODY, evaluate_tree
from .forest import Forest, data_of, states
from .names import singular_mass

Array = NDArray[np.float64]
_WORLD = pin.Convention.WORLD

AGREEMENT = 1e-6
"""Relative difference up to which results agree. Another layout differs by as much as the numbers themselves;
rounding is far below, since the links of the check have well-conditioned inertias."""

CLEARLY_POSITIVE = 1e-10
"""Smallest effective inertia of a joint, relative to its inertia, that is not rounding."""


class PinocchioLayoutWarning(UserWarning):
    """The memory layout of this version of Pinocchio is unknown; results are copied, which is slower."""


class Call(NamedTuple):
    """A function and its arguments, called by kernels by their addresses."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def call_addresses(calls: Sequence[Call]) -> NDArray[np.int64]:
    """Return (2 n,) addresses of n functions and their arguments, alternating, for `python_calls.call`.

    The caller keeps the calls alive.
    """
    return np.array([id(item) for call in calls for item in call], dtype=np.int64)


# ---- impacts


class MassAndColumns:
    """The mass matrix and the joint Jacobian of a Data, from one call.

    Attributes:
        columns: (6, nv) ``data.J`` in place, column by column: motion of the world's origin, as if fixed to
            the bodies that each velocity moves, in world axes; it does not keep the Data alive. None for a
            model with mimic joints, where ``data.J`` has its own columns.
        mass_matrix: Called with model, data, q and the world convention, returns M (nv, nv) and updates
            `columns` and ``data.oMi``.
        joint_jacobian: Called with model, data and q, updates `columns` and ``data.oMi``.
    """

    __slots__ = ("columns", "joint_jacobian", "mass_matrix")

    def __init__(self, model: pin.Model, data: pin.Data) -> None:
        self.columns: Array | None = None
        self.mass_matrix: Callable[..., Array] = pin.crba
        self.joint_jacobian: Callable[..., Any] = pin.computeJointJacobians
        if _flaw(model) is not None:
            self.mass_matrix = self.joint_jacobian = _refuse
            return
        whole = data.J.size == 6 * model.nv
        if _trusted(model, _disagreement_of_crba):
            if whole:
                self.columns = _unowned(data.J, (6, model.nv))
            return
        self.mass_matrix, self.joint_jacobian = self._mass_matrix_alone, self._joint_jacobian_copied
        if whole:
            self.columns = np.zeros((6, model.nv), order="F")

    def _mass_matrix_alone(self, model: pin.Model, data: pin.Data, q: Array, _: Any) -> Array:
        mass = np.array(pin.crba(model, data, q))
        self._joint_jacobian_copied(model, data, q)
        return mass

    def _joint_jacobian_copied(self, model: pin.Model, data: pin.Data, q: Array) -> None:
        pin.forwardKinematics(model, data, q)
        jacobian = pin.computeJointJacobians(model, data, q)
        if self.columns is not None:
            self.columns[:] = jacobian.reshape(6, -1)


_ALONG = np.eye(3)
_AXES = {"X": 0, "Y": 1, "Z": 2}
_ONE_AXIS = {"R": REVOLUTE, "RUB": UNBOUNDED, "P": PRISMATIC}
_UNALIGNED = {
    "RevoluteUnaligned": REVOLUTE,
    "RevoluteUnboundedUnaligned": UNBOUNDED,
    "PrismaticUnaligned": PRISMATIC,
}
_MANY_AXES = {  # kind, and of each velocity whether it is a rotation, and its axis
    "FreeFlyer": (FREE_FLYER, (0, 0, 0, 1, 1, 1), (0, 1, 2, 0, 1, 2)),
    "Spherical": (SPHERICAL, (1, 1, 1), (0, 1, 2)),
    "Translation": (TRANSLATION, (0, 0, 0), (0, 1, 2)),
    "Planar": (PLANAR, (0, 0, 1), (0, 1, 2)),
}


class Tree(NamedTuple):
    """The numbers of a kinematic tree for `RobotWorkspace`: sizes, arrays in place, copies."""

    sizes: dict[str, int]
    given: dict[str, Array]
    copied: dict[str, NDArray[Any]]


def tree_of(model: pin.Model, parts: Sequence[pin.Model]) -> Tree | None:
    """Return the numbers of a model for `tree_matrices`, or None if it does not support some joints.

    Args:
        model: The model.
        parts: Models of its trees, used in the check, or the model itself.
    """
    if _flaw(model) is not None:
        return None
    compile_all((robot_impact,), (evaluate_tree,), (contact_axes,))  # what an impact needs, at once
    if not all(_trusted(part, _disagreement_of_tree) for part in parts):
        return None
    with contextlib.suppress(_ElsewhereError):
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
        elif name in _UNALIGNED or name[:-1] in _ONE_AXIS:
            kinds[j] = _UNALIGNED[name] if name in _UNALIGNED else _ONE_AXIS[name[:-1]]
            axes[j] = _AXES.get(name[-1], -1) if name not in _UNALIGNED else -1
            turns[rows] = kinds[j] != PRISMATIC
            along[rows] = joint.S.ravel()[3:] if kinds[j] != PRISMATIC else joint.S.ravel()[:3]
        else:
            return None
        joint_of[rows] = j
    if len(joint_of) != sum(model.nvs[j] for j in range(1, joints)):
        return None
    given = {
        "joint_placements": _rows(model.jointPlacements, model.jointPlacements, "jointPlacements"),
        "inertias": _inertias(model),
        "armature": _in_place(model.armature, model.armature, "armature"),
    }
    copied = {
        "joint_kind": kinds,
        "joint_parent": np.array(list(model.parents), dtype=np.int64),
        "joint_q": np.array([max(x, 0) for x in model.idx_qs], dtype=np.int64),
        "joint_v": np.array([max(x, 0) for x in model.idx_vs], dtype=np.int64),
        "joint_axis": axes,
        "velocity_joint": joint_of,
        "velocity_turns": turns,
        "velocity_axis": along,
    }
    sizes = {"nq": model.nq, "nv": nv, "bodies": joints, "room": room_for(nv, joints)}
    return Tree(sizes, given, copied)


def _inertias(model: pin.Model) -> Array:
    """Return (nj, 10) mass, centre and inertia of a model's joints in place."""
    count = model.njoints
    start = model.inertias[0].lever.__array_interface__["data"][0] - 8
    for k in (0, min(1, count - 1), count - 1):
        levers = model.inertias[k].lever, model.inertias[k].lever
        if any(lever.__array_interface__["data"][0] != start + 80 * k + 8 for lever in levers):
            raise _ElsewhereError("model.inertias")
    return _at(start, 10 * count).reshape(count, 10)


def _in_place(array: Array, again: Array, name: str) -> Array:
    """Return the array of a property, if two accesses have the same memory."""
    start = array.__array_interface__["data"][0]
    if again.__array_interface__["data"][0] != start or not _by_row(array):
        raise _ElsewhereError(name)
    return _at(start, array.size)


def placement_of_frame(model: pin.Model, frame: int) -> Array:
    """Return (12,) the placement of a frame on its joint, in place.

    Raises:
        _ElsewhereError: Its memory layout is not the expected one.
    """
    return _rows([model.frames[frame].placement], [model.frames[frame].placement], "frames")[0]


def _disagreement_of_tree(model: pin.Model) -> str | None:
    """Return which result of `tree_matrices` differs from Pinocchio's, or None."""
    model, q, _, _ = _probe(model)
    model.armature = np.linspace(0.1, 0.2, model.nv)
    try:
        tree = _tree(model)
    except _ElsewhereError as place:
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
    if not _agree(bodies[:, :12], expected):
        return "the placements of joints"
    jacobian = _columns(model, q)
    jacobian[:3] += np.cross(jacobian[3:], origin, axis=0)
    if not _agree(columns, jacobian):
        return "the joint Jacobian"
    expected = np.tril(pin.crba(model, data, q))
    for i in range(model.nv):
        above, k = [], i
        while k >= 0:
            above.append(k)
            k = parents[k]
        expected[i, [j for j in range(model.nv) if j not in above]] = 0.0
    return None if _agree(mass, expected) else "the mass matrix"


def workspace_of(
    tree: Tree,
    frame: int,
    carrier: int,
    model: pin.Model,
    bounds: Array,
    parents: NDArray[np.int64],
    signs: Array,
) -> RobotWorkspace:
    """Return the workspace of a contact, without the contact's constants.

    Args:
        tree: The numbers of the model.
        frame: Id of the contact's frame.
        carrier: Id of the frame to which the surface is attached, 0 for the world.
        model: Pinocchio model.
        bounds: (2, nq) of the coordinates.
        parents: (nv,) the next velocity towards the root, or −1.
        signs: (nv,) see `contact_kinematics.fill_jacobian`.
    """
    arrays = tree.given | {
        "frame": placement_of_frame(model, frame),
        "carrier": placement_of_frame(model, carrier),
        "velocity_parent": parents,
        "bounds": bounds,
        "signs": signs,
    }
    work = RobotWorkspace(tree.sizes, arrays)
    for name, values in tree.copied.items():
        work.whole(RobotWorkspace.fields[name])[...] = values  # type: ignore[arg-type]
    work.frame_joint = model.frames[frame].parentJoint
    work.carrier_joint = model.frames[carrier].parentJoint
    return work


class MassAndFrames:
    """The mass matrix and the Jacobian of a contact for kernels: calls read a buffer and fill arrays.

    Args:
        model: Pinocchio model.
        data: Its data.
        frame: Id of the contact's frame.
        carrier: Id of the frame to which the surface is attached, 0 for the world.

    Attributes:
        q: (nq,) buffer that the calls read.
        calls: To be called in order; the arrays are then those of q.
        mass: (nv, nv) M, row by row, since it is symmetric.
        frame, carrier: (12,) placements: rotation column by column, translation.
        columns: (6, nv) as in `MassAndColumns`, or as returned by `contact_columns`.
    """

    def __init__(self, model: pin.Model, data: pin.Data, frame: int, carrier: int) -> None:
        self._arguments = model, data, frame, carrier
        self.q = pin.neutral(model)
        self._whole = data.J.size == 6 * model.nv
        if self._whole and _trusted(model, _disagreement_of_crba):
            with contextlib.suppress(_ElsewhereError):
                self._read_in_place()
                return
        self.mass = np.zeros((model.nv, model.nv))
        self.frame, self.carrier = np.zeros((2, 12))
        self.columns = np.zeros((6, model.nv), order="F")
        self.calls = [Call(self._copy, ())]

    def _read_in_place(self) -> None:
        model, data, *frames = self._arguments
        self.frame, self.carrier = (_rows([data.oMf[k]], [data.oMf[k]], "oMf")[0] for k in frames)
        self.mass = data.M.reshape(model.nv, model.nv, order="F").T
        self.columns = data.J.reshape(6, model.nv, order="F")
        self.calls = [Call(pin.crba, (model, data, self.q, _WORLD))]
        self.calls += [Call(pin.updateFramePlacement, (model, data, k)) for k in frames if k > 0]

    def _copy(self) -> None:
        model, data, *frames = self._arguments
        self.mass[:] = pin.crba(model, data, self.q)
        pin.forwardKinematics(model, data, self.q)
        for k, placement in zip(frames, (self.frame, self.carrier), strict=True):
            found = pin.updateFramePlacement(model, data, k)
            placement[:9], placement[9:] = found.rotation.T.ravel(), found.translation
        if self._whole:
            self.columns[:] = pin.computeJointJacobians(model, data, self.q).reshape(6, -1)
        else:
            self.columns[:] = contact_columns(model, data, self.q, *frames)


def contact_columns(model: pin.Model, data: pin.Data, q: Array, frame: int, carrier: int) -> Array:
    """Return (6, nv) a frame's Jacobian at the world's origin minus its carrier's; mimic joints summed."""
    columns = np.zeros((6, model.nv), order="F")
    for sign, k in ((1.0, frame), (-1.0, carrier)):
        if k > 0:
            rows = pin.computeFrameJacobian(model, data, q, k, pin.LOCAL_WORLD_ALIGNED)
            rows[:3] -= np.cross(rows[3:], data.oMf[k].translation, axisa=0, axisc=0)
            columns += sign * rows
    return columns


def _disagreement_of_crba(model: pin.Model) -> str | None:
    """Return what `crba` does not fill, or None."""
    model, q, _, _ = _probe(model)
    data = model.createData()
    whole = data.J.size == 6 * model.nv
    before = data.J.__array_interface__["data"][0]
    expected = pin.crba(model, model.createData(), q)
    if not _agree(pin.crba(model, data, q, _WORLD), expected):
        return "crba in the world convention"
    if whole and not _agree(data.J.reshape(6, -1), _columns(model, q)):
        return "data.J after crba"
    if whole and not (data.J.__array_interface__["data"][0] == before and _by_column(data.J)):
        return "the address of data.J"
    if not (_agree(data.M, expected) and _by_column(data.M)):
        return "data.M after crba"
    other = model.createData()
    pin.forwardKinematics(model, other, q)
    if not all(_agree(a.homogeneous, b.homogeneous) for a, b in zip(data.oMi, other.oMi, strict=True)):
        return "data.oMi after crba"
    return None


def check_inertia(model: pin.Model, data: pin.Data, q: Array) -> None:
    """Check that no joint has zero inertia at a configuration, since its acceleration would be infinite.

    Raises:
        ModelError: The mass matrix is not positive definite, or not correct.
    """
    for part in states(model, data, q):
        _check_inertia(*part)


def _check_inertia(model: pin.Model, data: pin.Data, q: Array) -> None:
    mass = pin.crba(model, data, q)
    with contextlib.suppress(np.linalg.LinAlgError):  # mostly clear, without a kernel
        pivots = np.diag(np.linalg.cholesky(mass[::-1, ::-1]))[::-1] ** 2
        if (pivots > CLEARLY_POSITIVE * np.diag(mass)).all():
            return
    parents = np.array(data.parents_fromRow, dtype=np.int64)
    stopped = tree.factor(mass, parents, np.zeros_like(mass))
    if stopped >= 0:
        if _flaw(model) is not None:  # which makes the mass matrix a wrong one
            _refuse(model)
        raise singular_mass(model, stopped)


# ---- scenes


class RobotDynamics:
    """Forward dynamics of a robot for kernels: calls that read buffers and fill arrays, on separate Data.

    Attributes:
        model: The robot's model.
        q, v, tau: (nq,), (nv,), (nv,) buffers that the calls read: state, generalized forces.
        forward_dynamics: Fills `acceleration`, `placements`, `velocities`, `accelerations` and
            `joint_jacobian`.
        inverse_mass: Fills `minverse`; only after `forward_dynamics` at the same state.
        forward_kinematics: Fills `placements` and `local_velocities`.
        acceleration: (nv,) v̇.
        minverse: (nv, nv) M⁻¹.
        placements: (nj, 12) of the joints, the world first: rotation column by column, translation.
        local_velocities: (nj, 6) of the joints in their own axes, linear over angular.
        velocities: (nj, 6) of the joints, spatial, in world axes at the world's origin.
        accelerations: (nj, 6) likewise, less the acceleration of gravity.
        joint_jacobian: (6, nv) in world axes at the world's origin; Fortran-contiguous.
    """

    forward_dynamics: Call
    inverse_mass: Call
    forward_kinematics: Call
    acceleration: Array
    minverse: Array
    placements: Array
    local_velocities: Array
    velocities: Array
    accelerations: Array
    joint_jacobian: Array

    def __init__(self, model: pin.Model) -> None:
        self.model = model
        self.q, self.v, self.tau = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)

    def refresh(self) -> None:
        """Update numbers of the model, which may have changed, if they are not read in place."""


def robot_dynamics(model: pin.Model) -> RobotDynamics:
    """Return the forward dynamics of a robot, with results in place if this version of Pinocchio allows it.

    Raises:
        ModelError: No joints, joints that are not in depth-first order, or mimic joints, for which
            Pinocchio has no forward dynamics.
    """
    _check_joints(model)
    forest = data_of(model)
    if isinstance(forest, Forest):
        return _OfParts(model, forest)
    if _trusted(model, _disagreement_of_dynamics):
        with contextlib.suppress(_ElsewhereError):
            return _InPlace(model)
    return _Copied(model)


class _ElsewhereError(Exception):
    """The memory layout of results is not the expected one."""


class _InPlace(RobotDynamics):
    """The arrays are Pinocchio's own."""

    def __init__(self, model: pin.Model) -> None:
        super().__init__(model)
        nv = model.nv
        data = self._data = model.createData()
        self.forward_dynamics = Call(pin.aba, (model, data, self.q, self.v, self.tau, _WORLD))
        self.inverse_mass = Call(pin.computeMinverse, (model, data))
        self.forward_kinematics = Call(pin.forwardKinematics, (model, data, self.q, self.v))
        for call in (self.forward_dynamics, self.inverse_mass):  # so that all has the size it will have
            call.function(*call.arguments)
        if not (_by_column(data.ddq) and _by_column(data.J) and _by_row(data.Minv)):
            raise _ElsewhereError("ddq, J or Minv")
        self.placements, self.local_velocities, self.velocities, self.accelerations = (
            _rows(getattr(data, name), getattr(data, name), name) for name in ("oMi", "v", "ov", "oa_gf")
        )
        self.acceleration = data.ddq.reshape(nv)
        self.minverse = data.Minv.reshape(nv, nv)
        self.joint_jacobian = data.J.reshape(6, nv, order="F")


class _Copied(RobotDynamics):
    """The arrays are copies of the results of documented calls, each on Data that no other call writes."""

    def __init__(self, model: pin.Model) -> None:
        super().__init__(model)
        nj, nv = model.njoints, model.nv
        self.forward_dynamics = Call(self._copy_dynamics, ())
        self.inverse_mass = Call(self._copy_inverse, ())
        self.forward_kinematics = Call(self._copy_kinematics, ())
        self._accelerated, self._moving, self._turning, self._inverted = (
            model.createData() for _ in range(4)
        )
        self.acceleration, self.minverse = np.zeros(nv), np.zeros((nv, nv))
        self.placements = np.zeros((nj, 12))
        self.local_velocities, self.velocities, self.accelerations = np.zeros((3, nj, 6))
        self.joint_jacobian = np.zeros((6, nv), order="F")

    def _copy_dynamics(self) -> None:
        model, data = self.model, self._moving
        self.acceleration[:] = pin.aba(model, self._accelerated, self.q, self.v, self.tau)
        pin.forwardKinematics(model, data, self.q, self.v, self.acceleration)
        self._copy_placements()
        for i, (placement, v, a) in enumerate(zip(data.oMi, data.v, data.a, strict=True)):
            self.velocities[i] = placement.act(v).vector
            self.accelerations[i] = (placement.act(a) - model.gravity).vector
        self.joint_jacobian[:] = pin.computeJointJacobians(model, self._turning, self.q).reshape(6, -1)

    def _copy_inverse(self) -> None:
        self.minverse[:] = pin.computeMinverse(self.model, self._inverted, self.q)

    def _copy_kinematics(self) -> None:
        pin.forwardKinematics(self.model, self._moving, self.q, self.v)
        self._copy_placements()
        self.local_velocities[:] = [motion.vector for motion in self._moving.v]

    def _copy_placements(self) -> None:
        self.placements[:, :9] = [placement.rotation.T.ravel() for placement in self._moving.oMi]
        self.placements[:, 9:] = [placement.translation for placement in self._moving.oMi]


class _OfParts(RobotDynamics):
    """The arrays are filled by kernels for free bodies, else copied from each part of a `Forest`."""

    def __init__(self, model: pin.Model, forest: Forest) -> None:
        super().__init__(model)
        nj, nv = model.njoints, model.nv
        self._forest = forest
        self.forward_dynamics = Call(self._accelerate, ())
        self.inverse_mass = Call(self._invert, ())
        self.forward_kinematics = Call(self._move, ())
        self.acceleration, self.minverse = np.zeros(nv), np.zeros((nv, nv))
        self.placements = np.zeros((nj, 12))
        self.placements[0, [0, 4, 8]] = 1.0
        self.local_velocities, self.velocities, self.accelerations = np.zeros((3, nj, 6))
        self.accelerations[0] = -model.gravity.vector
        self.joint_jacobian = np.zeros((6, nv), order="F")
        free = [j for j in range(1, nj) if _flies_freely(model, j)]
        starts = [(j, model.idx_qs[j], model.idx_vs[j]) for j in free]
        self._free = np.array(starts, dtype=np.int64).reshape(-1, 3)
        self._bodies, self._gravity = np.zeros((len(free), BODIES)), np.array(model.gravity.linear)
        self._parts = [
            (part, robot_dynamics(part.model))
            for part in forest.parts
            if not set(range(part.joints.start, part.joints.stop)) <= set(free)
        ]
        self.refresh()

    def refresh(self) -> None:
        """See `RobotDynamics.refresh`."""
        self._forest.refresh()
        for body, (joint, _, first) in zip(self._bodies, self._free.tolist(), strict=True):
            inertia, base = self.model.inertias[joint], self.model.jointPlacements[joint]
            body[:] = [
                *(inertia.mass, *inertia.lever, *inertia.inertia.ravel()),
                *(*np.linalg.inv(inertia.inertia).ravel(), *base.rotation.T.ravel(), *base.translation),
            ]
            rows = slice(first, first + 6)
            self.minverse[rows, rows] = np.linalg.inv(inertia.matrix())

    def _accelerate(self) -> None:
        accelerate_bodies(
            *(self._free, self._bodies, self._gravity, self.q, self.v, self.tau, self.acceleration),
            *(self.placements, self.velocities, self.accelerations, self.joint_jacobian),
        )
        for part, robot in self._parts:
            robot.q[:], robot.v[:], robot.tau[:] = self.q[part.q], self.v[part.v], self.tau[part.v]
            robot.forward_dynamics.function(*robot.forward_dynamics.arguments)
            self.acceleration[part.v] = robot.acceleration
            self.joint_jacobian[:, part.v] = robot.joint_jacobian
            self.placements[part.joints] = robot.placements[1:]
            self.velocities[part.joints] = robot.velocities[1:]
            self.accelerations[part.joints] = robot.accelerations[1:]

    def _invert(self) -> None:
        for part, robot in self._parts:
            robot.inverse_mass.function(*robot.inverse_mass.arguments)
            self.minverse[part.v, part.v] = robot.minverse

    def _move(self) -> None:
        move_bodies(self._free, self._bodies, self.q, self.v, self.placements, self.local_velocities)
        for part, robot in self._parts:
            robot.q[:], robot.v[:] = self.q[part.q], self.v[part.v]
            robot.forward_kinematics.function(*robot.forward_kinematics.arguments)
            self.placements[part.joints] = robot.placements[1:]
            self.local_velocities[part.joints] = robot.local_velocities[1:]


def _flies_freely(model: pin.Model, joint: int) -> bool:
    """Return whether a joint is that of a free body without children and rotor inertia."""
    rows = slice(model.idx_vs[joint], model.idx_vs[joint] + 6)
    return (
        model.parents[joint] == 0
        and model.joints[joint].shortname() == "JointModelFreeFlyer"
        and len(model.subtrees[joint]) == 1
        and not model.armature[rows].any()
        and model.inertias[joint].mass > 0.0
    )


def _disagreement_of_dynamics(model: pin.Model) -> str | None:
    """Return which result has another address or value than expected, or None."""
    model, q, v, tau = _probe(model)
    try:
        found, expected = _InPlace(model), _Copied(model)
    except _ElsewhereError as place:
        return f"the place of {place} in memory"
    for dynamics in (found, expected):
        dynamics.q[:], dynamics.v[:], dynamics.tau[:] = q, v, tau
    left = ["acceleration", "placements", "velocities", "accelerations", "joint_jacobian"]
    for name, arrays in (
        ("forward_dynamics", left),
        ("inverse_mass", ["minverse", *left]),
        ("forward_kinematics", ["placements", "local_velocities"]),
    ):
        for dynamics in (found, expected):
            call: Call = getattr(dynamics, name)
            call.function(*call.arguments)
        for array in arrays:
            if not _agree(getattr(found, array), getattr(expected, array)):
                return f"{array} after {getattr(found, name).function.__name__}"
    return None


def _flaw(model: pin.Model) -> str | None:
    """Return why Pinocchio's algorithms give wrong results for a model, or None."""
    if model.nv == 0:
        return (
            "has no joints, so nothing can move; a free body has a free-flyer joint "
            "(load_robot(…, free_flyer=True))"
        )
    branch = [0]
    for j, parent in enumerate(list(model.parents)[1:], start=1):
        while branch and branch[-1] != parent:
            branch.pop()
        if not branch:
            return (
                f"has joint {model.names[j]!r} apart from the other joints below "
                f"{model.names[parent]!r}: joints must be added depth first, each branch "
                "completely before the next, or Pinocchio's crba returns a wrong mass matrix"
            )
        branch.append(j)
    return None


def _refuse(model: pin.Model, *_: Any) -> Any:
    """Raise an error for a model for which Pinocchio gives wrong results."""
    raise ModelError(f"model: {model.name!r} {_flaw(model)}", field="model", value=model.name)


def _check_joints(model: pin.Model) -> None:
    if _flaw(model) is not None:
        _refuse(model)
    mimics = [model.names[j] for j in range(1, model.njoints) if "Mimic" in model.joints[j].shortname()]
    if mimics:
        raise ModelError(
            f"model: Pinocchio has no forward dynamics of mimic joints ({', '.join(mimics)}), so "
            "a scene cannot have them; load the robot without them (load_robot(…, mimic=False)), "
            "or use impact() instead of a scene",
            field="model",
            value=mimics,
        )


# ---- the check


_verdicts: dict[tuple[int, Any], tuple[Any, tuple[int, int, int], bool]] = {}
_warned = False


def _trusted(model: pin.Model, disagreement: Callable[[pin.Model], str | None]) -> bool:
    """Return whether results can be read in place, checked once for a model and again if it grows."""
    global _warned
    key, sizes = (id(model), disagreement.__name__), (model.njoints, model.nq, model.nv)
    known = _verdicts.get(key)
    if known is not None and known[0]() is model and known[1] == sizes:
        return known[2]
    found = disagreement(model)
    _verdicts[key] = weakref.ref(model, _forget(key)), sizes, found is None
    if found is not None and not _warned:
        _warned = True
        warnings.warn(
            f"Pinocchio {pin.__version__} differs from the known memory layout in {found}; "
            "results are copied instead, which is slower but gives the same values",
            PinocchioLayoutWarning,
            stacklevel=2,
        )
    return found is None


def kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> float:
    """Return ½ vᵀ M v [J].

    Pinocchio's own sum omits the rotor inertia of joints with slanted axes, which its M has.
    """
    return sum(_kinetic_energy(*part) for part in states(model, data, q, v))


def _kinetic_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> float:
    if not model.armature.any():
        return float(pin.computeKineticEnergy(model, data, q, v))
    upper = np.triu(pin.crba(model, data, q))
    return float(v @ (upper @ v) - 0.5 * (v * v) @ upper.diagonal())


def _forget(key: tuple[int, Any]) -> Any:
    forget = _verdicts.pop  # bound now: at exit the module may be gone before the model
    return lambda _: forget(key, None)


def _probe(model: pin.Model) -> tuple[pin.Model, Array, Array, Array]:
    """Return a copy whose links all have a well-conditioned inertia, and random q, v and τ."""
    model = model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia(1.0, np.array([0.1, 0.2, 0.3]), np.diag([0.4, 0.5, 0.6]))
    model.armature = np.zeros(model.nv)
    rng = np.random.default_rng(0)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    return model, q, rng.normal(size=model.nv), rng.normal(size=model.nv)


def _columns(model: pin.Model, q: Array) -> Array:
    return pin.computeJointJacobians(model, model.createData(), q).reshape(6, -1)


def _agree(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(
        np.abs(one - other).max(initial=0.0) <= AGREEMENT * (1.0 + np.abs(other).max(initial=0.0))
    )


def _by_column(array: Array) -> bool:
    return array.dtype == np.float64 and (array.ndim == 1 or bool(array.flags.f_contiguous))


def _by_row(array: Array) -> bool:
    return array.dtype == np.float64 and (array.ndim == 1 or bool(array.flags.c_contiguous))


def _rows(items: Sequence[Any], again: Sequence[Any], name: str) -> Array:
    """Return (n, 12) placements or (n, 6) motions of a Data in place.

    The first two elements and the last one determine the layout, since those of a vector are contiguous.

    Args:
        items: The elements of one of Pinocchio's vectors.
        again: The same from a second access: copies that exist at once would have two addresses each.
        name: Name of the vector.

    Raises:
        _ElsewhereError: They are not rows of an array.
    """
    count = len(items)
    taken = [(k, _parts(vector[k])) for vector in (items, again) for k in {0, min(1, count - 1), count - 1}]
    width = sum(part.size for part in taken[0][1])
    start = _parts(items[0])[0].__array_interface__["data"][0]
    for k, parts in taken:
        place = start + 8 * width * k
        for part in parts:
            if part.__array_interface__["data"][0] != place or not _by_column(part):
                raise _ElsewhereError(f"data.{name}")
            place += part.nbytes
    return _at(start, len(items) * width).reshape(count, width)


def _parts(item: Any) -> tuple[Array, Array]:
    return (item.rotation, item.translation) if isinstance(item, pin.SE3) else (item.linear, item.angular)


def _at(address: int, size: int) -> Array:
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))


def _unowned(array: Array, shape: tuple[int, int]) -> Array:
    """Return a view of an array, column by column, that does not keep its owner alive."""
    return _at(array.__array_interface__["data"][0], array.size).reshape(shape, order="F")
