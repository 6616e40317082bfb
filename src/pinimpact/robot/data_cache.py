"""Data of a model and its Data that do not change between calls, cached."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..checks import finite_array
from ..errors import InputError
from .forest import Forest, forward_kinematics, joint_jacobian
from .joint_limits import slack_bounds, warn_of_limits
from .names import frame_id, motion_signs
from .pinocchio_bridge import MassAndColumns, Tree, tree_of


class DataCache:
    """Data of a model and its Data that do not change between calls; see `data_cache`."""

    __slots__ = (
        *(
            "bounds",
            "columns",
            "struck",
            "_tree",
            "contacts",
            "curved",
            "data",
            "forward_kinematics",
            "frames",
            "joint_jacobian",
        ),
        *("frames_seen", "mass_matrix", "model", "nframes", "njoints", "nv", "parents", "q_shape", "v_shape"),
    )

    def __init__(self, model: pin.Model, data: pin.Data) -> None:
        self._read(model, data)
        self.model = weakref.ref(model)
        self.data = weakref.ref(data, _forget(_caches, id(data)))
        self.nframes = self.frames_seen = model.nframes
        self.njoints = model.njoints
        self.nv = model.nv
        self.q_shape = (model.nq,)
        self.v_shape = (model.nv,)
        self.curved = model.nq != model.nv
        self.bounds = slack_bounds(model)
        self.frames: dict[Any, int] = {}
        self.contacts: dict[Any, tuple[int, int, np.ndarray]] = {}
        self.struck: dict[int, Any] = {}
        self._tree: Tree | bool | None = False

    def _read(self, model: pin.Model, data: pin.Data) -> None:
        """Set the fields that are read from the Data."""
        tree = _tree(model)
        _check_data(tree, model, data)
        self.parents = np.array(tree.parents, dtype=np.int64)
        if len(self.parents) != model.nv:  # mimic joints: M has no tree's pattern, so take it as a chain
            self.parents = np.arange(-1, model.nv - 1)
        bridge = MassAndColumns(model, data)
        self.columns = bridge.columns
        self.mass_matrix = self._first("mass_matrix", bridge.mass_matrix)
        self.joint_jacobian = self._first("joint_jacobian", bridge.joint_jacobian)
        self.forward_kinematics = self._first("forward_kinematics", pin.forwardKinematics)

    @property
    def tree(self) -> Tree | None:
        """The numbers of the model for `tree_matrices`, or None if it does not support some joints."""
        if isinstance(self._tree, bool):  # nobody has asked yet
            self._tree = self._make_tree()
        return self._tree

    def _make_tree(self) -> Tree | None:
        model: Any = self.model()
        return tree_of(model, (model,))

    def _first(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return a call that, on its first use, detects data of a model with other joints."""

        def checked(model: pin.Model, data: pin.Data, *arguments: Any) -> Any:
            try:
                found = call(model, data, *arguments)
            except RuntimeError as error:  # boost::bad_get
                difference = _joint_that_differs(model, data)
                if difference:
                    raise _foreign(data, difference) from error
                raise
            setattr(self, name, call)
            return found

        return checked

    def warn_of_limits(self, q: np.ndarray, rows: str = "", stacklevel: int = 4) -> None:
        """Warn of a configuration outside the joint limits, once."""
        self.ignore_limits()
        warn_of_limits(self.model(), q, rows, stacklevel)

    def check_limits(self, q: np.ndarray, stacklevel: int) -> None:
        """Warn of a configuration (nq,) outside the joint limits."""
        if ((q < self.bounds[0]) | (q > self.bounds[1])).any():
            self.warn_of_limits(q, stacklevel=stacklevel + 1)

    def ignore_limits(self) -> None:
        """Give no warnings of joint limits."""
        self.bounds[:] = [[-np.inf], [np.inf]]  # in place, where kernels read them

    def frame(self, key: str | int, field: str = "frame") -> int:
        """Return the id of a frame given by name or id; see `frame_id`."""
        found = self.frames.get(key)
        if found is None:
            model: Any = self.model()
            found = frame_id(model, key, field)
            if found >= self.nframes:
                raise outdated(model, self.data())
            self.frames[key] = found
        return found

    def contact(self, frame: str | int, body: str | int | None) -> tuple[int, int, np.ndarray]:
        """Return the ids of a contact's frame and of the frame to which its surface is attached, and signs.

        The id for the world is 0. The signs (nv,) are 1 for a velocity that moves the contact's frame alone,
        −1 the carrier alone, else 0.
        """
        model: Any = self.model()
        ends = self.frame(frame), 0 if body is None else self.frame(body, "body")
        if self.columns is None:  # with mimic joints each column holds what it does to either
            signs = np.ones(self.nv)
        else:
            signs = motion_signs(model, *(model.frames[end].parentJoint for end in ends))
        found = self.contacts[frame, body] = (*ends, signs)
        return found


class _ForestCache(DataCache):
    """Data of a model and its `Forest` that do not change."""

    __slots__ = ()

    def _read(self, model: pin.Model, data: Forest) -> None:
        self.parents = data.parents()
        self.columns = data.J

        def mass_matrix(model: pin.Model, data: Forest, q: np.ndarray, _: Any) -> np.ndarray:
            data.joint_jacobian(q)
            return data.mass_matrix(q)

        self.mass_matrix = mass_matrix
        self.joint_jacobian = joint_jacobian
        self.forward_kinematics = forward_kinematics

    def _make_tree(self) -> Tree | None:
        data: Any = self.data()
        return tree_of(self.model(), [part.model for part in data.parts])


class _Tree(NamedTuple):
    """Constant data of a model that its Data contain as well.

    Attributes:
        model: A weak reference to the model.
        sizes: nq, nv and numbers of joints and frames, to detect a model that has grown since.
        parents: (nv,) the next velocity towards the root, or −1, as in Data.
        axes: For joints whose axis is in their data: index and (6, 1) motion subspace.
    """

    model: Any
    sizes: tuple[int, int, int, int]
    parents: list[int]
    axes: list[tuple[int, np.ndarray]]


def _tree(model: pin.Model) -> _Tree:
    key, sizes = id(model), (model.nq, model.nv, model.njoints, model.nframes)
    found = _trees.get(key)
    if found is None or found.model() is not model or found.sizes != sizes:
        own = model.createData()
        axes = [
            (k, joint.S)
            for k, joint in enumerate(own.joints)
            if joint.shortname() in ("JointDataRevoluteUnaligned", "JointDataPrismaticUnaligned")
        ]
        found = _trees[key] = _Tree(
            weakref.ref(model, _forget(_trees, key)),
            sizes,
            own.parents_fromRow.tolist(),
            axes,
        )
    return found


def _check_data(tree: _Tree, model: pin.Model, data: Any) -> None:
    """Raise an error for Data of another model, detected by sizes, tree and axes; see `_first`."""
    if not isinstance(data, pin.Data):
        raise InputError(
            f"data: {type(data).__name__} given, pinocchio Data expected: model.createData(), or a "
            "RobotWrapper's .data",
            field="data",
            value=data,
        )
    if len(data.oMi) != model.njoints or len(data.oMf) != model.nframes or len(data.M) != model.nv:
        raise outdated(model, data)
    if data.parents_fromRow.tolist() != tree.parents:
        raise _foreign(data, "whose kinematic tree is another")
    if any(not np.array_equal(data.joints[k].S, axis) for k, axis in tree.axes):
        raise _foreign(data, _joint_that_differs(model, data) or "")


def _joint_that_differs(model: pin.Model, data: pin.Data) -> str | None:
    """Return a clause about the first joint of data that differs from the model."""
    axes = dict(_tree(model).axes)
    for k, (own, given) in enumerate(zip(model.createData().joints, data.joints, strict=True)):
        kind, other = (joint.shortname().removeprefix("JointData") for joint in (own, given))
        if kind != other:
            return f"whose joint {model.names[k]!r} is {other}, not {kind}"
        if k in axes and not np.array_equal(given.S, axes[k]):
            return f"whose joint {model.names[k]!r} has another axis"
    return None


def _foreign(data: pin.Data, how: str) -> InputError:
    return InputError(
        f"data: made for another robot, {how}; make new data with model.createData()",
        field="data",
        value=data,
    )


def outdated(model: pin.Model, data: Any) -> InputError:
    """Return the error for data that do not match their model."""
    return InputError(
        f"data: made for another model or before this one was changed "
        f"({len(data.oMi)} joints, {len(data.oMf)} frames, {len(data.M)} velocities; the model has "
        f"{model.njoints}, {model.nframes}, {model.nv}); make new data with model.createData()",
        field="data",
        value=data,
    )


_caches: dict[int, DataCache] = {}
_trees: dict[int, _Tree] = {}


def _forget(known: dict[int, Any], key: int) -> Any:
    forget = known.pop  # bound now: at exit the module may be gone before what it remembers
    return lambda _: forget(key, None)


def data_cache(model: pin.Model, data: pin.Data) -> DataCache:
    """Return the cache of `data`, created on the first call and kept as long as `data` exists.

    Frame placements, inertias and rotor inertias may change between calls. Adding a frame requires new data;
    a frame that is renamed in place keeps its first name here.
    """
    found = _caches.get(id(data))
    if found is None or found.data() is not data or found.model() is not model:
        kind = _ForestCache if isinstance(data, Forest) else DataCache
        found = _caches[id(data)] = kind(model, data)
    return found


def checked_configuration(cache: DataCache, model: pin.Model, q: Any) -> np.ndarray:
    """Return q as a checked (nq,) array.

    Raises:
        InputError: Wrong length, not finite, or a quaternion or (cos, sin) pair that is not of unit length
            to within 1e-8.
    """
    q = finite_array("q", q, cache.q_shape)
    if cache.curved and not pin.isNormalized(model, q, 1e-8):
        raise not_normalized(q)
    return q


def not_normalized(q: np.ndarray) -> InputError:
    """Return the error for a configuration in which a quaternion is not of unit length."""
    return InputError(
        "q: a quaternion or (cos, sin) pair is not of unit length; use pinocchio.normalize(model, q)",
        field="q",
        value=q,
    )
