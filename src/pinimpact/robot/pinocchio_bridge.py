"""All assumptions about Pinocchio beyond its documentation, and their checks.

An impact takes microseconds and kernels evaluate dynamics thousands of times, so they read Pinocchio's
results in place and obtain several of them from one call. This assumes that

- `aba` in the world convention fills ``data.J``, ``data.oMi``, ``data.ov`` and ``data.oa_gf``, and
  `computeMinverse` without a configuration continues from there;
- a result has one address as long as its Data exist, and the placements and motions of the joints are
  consecutive in memory;
- a Python object can be called by its address and that of its tuple of arguments;
- placements and inertias of a model's joints are consecutive in memory, and the kind of a joint is
  identified by its name and axes (`tree_numbers`).

None of this is documented. It is checked once for each model against documented calls on other Data;
addresses are checked for each Data before use. If a check fails, as it may in another version of Pinocchio,
the same results come from documented calls and are copied, which is slower, and a `PinocchioLayoutWarning` is
given once.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import RANK
from ..arrays import Array, Integers
from ..errors import ModelError
from ._kernels import tree
from ._kernels.free_bodies import BODY as BODIES
from ._kernels.free_bodies import accelerate_bodies, move_bodies
from .articulated_bodies import eliminate, inverse_of, is_accurate
from .forest import Forest, crba, data_of, parts_of
from .names import singular_mass
from .once import Known, once
from .tolerances import AGREEMENT

_WORLD = pin.Convention.WORLD


class PinocchioLayoutWarning(UserWarning):
    """The memory layout of this version of Pinocchio is unknown; results are copied, which is slower."""


class Call(NamedTuple):
    """A function and its arguments, called by kernels by their addresses."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def call_addresses(calls: Sequence[Call]) -> Integers:
    """Return (2 n,) addresses of n functions and their arguments, alternating, for `python_calls.call`.

    The caller keeps the calls alive.
    """
    return np.array([id(item) for call in calls for item in call], dtype=np.int64)


def check_inertia(model: pin.Model, data: pin.Data, q: Array) -> None:
    """Raise `ModelError` if a joint has zero inertia at q, since its acceleration would be infinite."""
    for part in parts_of(model, data):
        _check_inertia(part.model, part.data, q[part.q])


def _check_inertia(model: pin.Model, data: pin.Data, q: Array) -> None:
    mass = crba(model, data, q)
    with contextlib.suppress(np.linalg.LinAlgError):  # sufficient in most cases, without compiling a kernel
        pivots = np.diag(np.linalg.cholesky(mass[::-1, ::-1]))[::-1] ** 2
        if np.log(np.diag(mass) / pivots).sum() < -math.log(RANK):
            return
    parents = np.array(data.parents_fromRow, dtype=np.int64)
    stopped = tree.factor(mass, parents, np.zeros_like(mass))
    if stopped >= 0:
        if flaw(model) is not None:  # the mass matrix is wrong
            refuse(model)
        raise singular_mass(model, stopped)


# ---- scenes


class RobotDynamics:
    """Forward dynamics of a robot for kernels: calls that read q, v, tau and fill arrays."""

    forward_dynamics: Call  # fills `acceleration`, `placements`, `velocities` … `joint_jacobian`
    inverse_mass: Call  # fills `minverse`; only after `forward_dynamics` at the same state
    forward_kinematics: Call  # fills `placements` and `local_velocities`
    acceleration: Array  # (nv,) v̇
    minverse: Array  # (nv, nv) M⁻¹
    placements: Array  # (nj, 12) of the joints, the world first: rotation column by column, translation
    local_velocities: Array  # (nj, 6) of the joints in their own axes, linear over angular
    velocities: Array  # (nj, 6) of the joints, spatial, in world axes at the world's origin
    accelerations: Array  # (nj, 6) likewise, less the acceleration of gravity
    joint_jacobian: Array  # (6, nv) in world axes at the world's origin; Fortran-contiguous

    def __init__(self, model: pin.Model) -> None:
        self.model = model
        self.q, self.v, self.tau = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)


def robot_dynamics(model: pin.Model) -> RobotDynamics:
    """Return the forward dynamics of a robot, with results in place if this version of Pinocchio allows it.

    Raises `ModelError` if Pinocchio has no forward dynamics for it: mimic joints, no joints, or not
    depth-first.
    """
    _check_joints(model)
    forest = data_of(model)
    if isinstance(forest, Forest):
        return _OfParts(model, forest)
    if not is_accurate(model):
        return _Eliminated(model)
    if trusted(model, _disagreement_of_dynamics):
        with contextlib.suppress(ElsewhereError):
            return _InPlace(model)
    return _Copied(model)


class ElsewhereError(Exception):
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
        for call in (self.forward_dynamics, self.inverse_mass):  # results get their final size
            call.function(*call.arguments)
        if not (_by_column(data.ddq) and _by_column(data.J) and by_row(data.Minv)):
            raise ElsewhereError("ddq, J or Minv")
        self.placements, self.local_velocities, self.velocities, self.accelerations = (
            rows(getattr(data, name), getattr(data, name), name) for name in ("oMi", "v", "ov", "oa_gf")
        )
        self.acceleration = data.ddq.reshape(nv)
        self.minverse = data.Minv.reshape(nv, nv)
        self.joint_jacobian = data.J.reshape(6, nv, order="F")


class _Filled(RobotDynamics):
    """The arrays are filled by calls without arguments."""

    def __init__(self, model: pin.Model, *calls: Callable[[], None]) -> None:
        super().__init__(model)
        nj, nv = model.njoints, model.nv
        self.forward_dynamics, self.inverse_mass, self.forward_kinematics = (Call(one, ()) for one in calls)
        self.acceleration, self.minverse = np.zeros(nv), np.zeros((nv, nv))
        self.placements = np.zeros((nj, 12))
        self.local_velocities, self.velocities, self.accelerations = np.zeros((3, nj, 6))
        self.joint_jacobian = np.zeros((6, nv), order="F")


class _Copied(_Filled):
    """The arrays are copies of the results of documented calls, each on Data that no other call writes."""

    def __init__(self, model: pin.Model) -> None:
        super().__init__(model, self._accelerate, self._invert, self._move)
        self._accelerated, self._moving, self._turning, self._inverted = (
            model.createData() for _ in range(4)
        )

    def _accelerate(self) -> None:
        model, data = self.model, self._moving
        self.acceleration[:] = self._solve()
        pin.forwardKinematics(model, data, self.q, self.v, self.acceleration)
        self._copy_placements()
        for i, (placement, v, a) in enumerate(zip(data.oMi, data.v, data.a, strict=True)):
            self.velocities[i] = placement.act(v).vector
            self.accelerations[i] = (placement.act(a) - model.gravity).vector
        self.joint_jacobian[:] = pin.computeJointJacobians(model, self._turning, self.q).reshape(6, -1)

    def _solve(self) -> Array:
        return np.asarray(pin.aba(self.model, self._accelerated, self.q, self.v, self.tau))

    def _invert(self) -> None:
        self.minverse[:] = pin.computeMinverse(self.model, self._inverted, self.q)

    def _move(self) -> None:
        pin.forwardKinematics(self.model, self._moving, self.q, self.v)
        self._copy_placements()
        self.local_velocities[:] = [motion.vector for motion in self._moving.v]

    def _copy_placements(self) -> None:
        self.placements[:, :9] = [placement.rotation.T.ravel() for placement in self._moving.oMi]
        self.placements[:, 9:] = [placement.translation for placement in self._moving.oMi]


class _Eliminated(_Copied):
    """The same, by elimination with M."""

    _mass: Array

    def _solve(self) -> Array:
        acceleration, self._mass = eliminate(self.model, self._accelerated, self.q, self.v, self.tau)
        return acceleration

    def _invert(self) -> None:
        self.minverse[:] = inverse_of(self._mass)


class _OfParts(_Filled):
    """The arrays are filled by kernels for free bodies, else copied from each part of a `Forest`."""

    def __init__(self, model: pin.Model, forest: Forest) -> None:
        super().__init__(model, self._accelerate, self._invert, self._move)
        self.placements[0, [0, 4, 8]] = 1.0
        self.accelerations[0] = -model.gravity.vector
        free = [j for j in range(1, model.njoints) if _flies_freely(model, j)]
        starts = [(j, model.idx_qs[j], model.idx_vs[j]) for j in free]
        self._free = np.array(starts, dtype=np.int64).reshape(-1, 3)
        self._bodies, self._gravity = np.zeros((len(free), BODIES)), np.array(model.gravity.linear)
        self._parts = [
            (part, robot_dynamics(part.model))
            for part in forest.parts
            if not set(range(part.joints.start, part.joints.stop)) <= set(free)
        ]
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
    model, q, v, tau = probe(model)
    try:
        found, expected = _InPlace(model), _Copied(model)
    except ElsewhereError as place:
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
            if not agree(getattr(found, array), getattr(expected, array)):
                return f"{array} after {getattr(found, name).function.__name__}"
    return None


def flaw(model: pin.Model) -> str | None:
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


def refuse(model: pin.Model) -> NoReturn:
    """Raise an error for a model for which Pinocchio gives wrong results."""
    raise ModelError(f"model: {model.name!r} {flaw(model)}", value=model.name)


def _check_joints(model: pin.Model) -> None:
    if flaw(model) is not None:
        refuse(model)
    mimics = [model.names[j] for j in range(1, model.njoints) if "Mimic" in model.joints[j].shortname()]
    if mimics:
        raise ModelError(
            f"model: Pinocchio has no forward dynamics of mimic joints ({', '.join(mimics)}), so "
            "a scene cannot have them; load the robot without them (load_robot(…, mimic=False)), "
            "or use impact() instead of a scene",
            value=mimics,
        )


# ---- the check


_verdicts: Known = {}
_warned = False


def trusted(model: pin.Model, disagreement: Callable[[pin.Model], str | None]) -> bool:
    """Return whether results can be read in place, checked once for a model and again if it grows."""
    global _warned
    found = once(_verdicts, model, disagreement)
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
    total = 0.0
    for part in parts_of(model, data):
        state = part.model, part.data, q[part.q]
        own = v[part.v]
        if part.model.armature.any():
            total += 0.5 * float(own @ crba(*state) @ own)
        else:
            total += float(pin.computeKineticEnergy(*state, own))
    return total


def probe(model: pin.Model) -> tuple[pin.Model, Array, Array, Array]:
    """Return a copy whose links all have a well-conditioned inertia, and random q, v and τ."""
    model = model.copy()
    lengths = [float(np.linalg.norm(place.translation)) for place in list(model.jointPlacements)[2:]]
    size = max([1.0, *lengths])  # independent of the unit of length
    for joint in range(1, model.njoints):
        center, about_it = np.array([0.1, 0.2, 0.3]), np.diag([0.4, 0.5, 0.6])
        model.inertias[joint] = pin.Inertia(1.0, size * center, size**2 * about_it)
    model.gravity.linear = size * np.array([1.0, 2.0, -9.0])
    model.armature = np.zeros(model.nv)
    rng = np.random.default_rng(0)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    v, a = rng.normal(size=(2, model.nv))
    return model, q, v, pin.rnea(model, model.createData(), q, v, a)


def agree(one: Array, other: Array) -> bool:
    """Return whether two results are equal to `AGREEMENT`."""
    return one.shape == other.shape and bool(
        np.abs(one - other).max(initial=0.0) <= AGREEMENT * (1.0 + np.abs(other).max(initial=0.0))
    )


def _by_column(array: Array) -> bool:
    return array.dtype == np.float64 and (array.ndim == 1 or bool(array.flags.f_contiguous))


def by_row(array: Array) -> bool:
    """Return whether an array is in memory row by row."""
    return array.dtype == np.float64 and (array.ndim == 1 or bool(array.flags.c_contiguous))


def rows(items: Sequence[Any], again: Sequence[Any], name: str) -> Array:
    """Return (n, 12) placements or (n, 6) motions of a vector of a Data in place, or raise `ElsewhereError`.

    The first two elements and the last one determine the layout, since those of a vector are contiguous.
    `again` is from a second access: copies that exist at once would have two addresses each.
    """
    count = len(items)
    taken = [(k, _parts(vector[k])) for vector in (items, again) for k in {0, min(1, count - 1), count - 1}]
    width = sum(part.size for part in taken[0][1])
    start = _parts(items[0])[0].__array_interface__["data"][0]
    for k, parts in taken:
        place = start + 8 * width * k
        for part in parts:
            if part.__array_interface__["data"][0] != place or not _by_column(part):
                raise ElsewhereError(f"data.{name}")
            place += part.nbytes
    return at(start, len(items) * width).reshape(count, width)


def _parts(item: Any) -> tuple[Array, Array]:
    return (item.rotation, item.translation) if isinstance(item, pin.SE3) else (item.linear, item.angular)


def at(address: int, size: int) -> Array:
    """Return the numbers at an address; they do not keep their owner alive."""
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))
