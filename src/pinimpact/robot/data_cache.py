"""Data of a model and its Data that do not change between calls, cached."""

from __future__ import annotations

import weakref
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import HALF_DIGITS
from ..arrays import Integers
from ..checks import finite_array
from ..errors import InputError
from ._kernels.robot_workspace import RobotWorkspace
from .forest import Forest
from .inertias import check_inertias
from .joint_limits import bounds, warn_of_limits
from .names import frame_id, motion_signs
from .once import Known, once
from .pinocchio_bridge import flaw
from .tolerances import SLACK
from .tree_numbers import UNALIGNED, Tree, tree_of


class DataCache:
    """Cached data of a model and its Data, with weak references to both; see `data_cache`.

    Attributes:
        parents: (nv,) next velocity towards the root, or −1.
        mimics: Whether joints mimic others; the joint Jacobian then has different columns.
        flaw: Why results of Pinocchio would be wrong for this model; None if they are not.
        curved: Whether nq differs from nv.
        bounds: (2, nq) joint limits; a warning is given beyond them.
        joints: Joint of each velocity, and parent joints; None until they are needed.
        workspaces: Contact and workspace by the id of the contact, see `struck`.
    """

    def __init__(self, model: pin.Model, data: Any) -> None:
        self.parents = data.parents() if isinstance(data, Forest) else _parents(model, data)
        self.mimics = len(self.parents) != model.nv
        if self.mimics:  # M has no tree's pattern, so take it as a chain
            self.parents = np.arange(-1, model.nv - 1)
        self.model = weakref.ref(model)
        forget, key = _caches.pop, id(data)  # bound now: at exit module globals may be gone before `data`
        self.data = weakref.ref(data, lambda _: forget(key, None))
        self.nframes = self.frames_seen = model.nframes
        self.njoints = model.njoints
        self.nv = model.nv
        self.q_shape = (model.nq,)
        self.v_shape = (model.nv,)
        self.curved = model.nq != model.nv
        self.flaw = flaw(model)
        check_inertias(model)
        self.bounds = bounds(model) + np.array([[-SLACK], [SLACK]])
        self.joints: tuple[Integers, Integers] | None = None
        self.frames: dict[Any, int] = {}
        self.contacts: dict[Any, tuple[int, int, np.ndarray]] = {}
        self._ends: dict[Any, tuple[int, int]] = {}
        self.workspaces: dict[int, tuple[Any, RobotWorkspace | None]] = {}

    @cached_property
    def tree(self) -> Tree | None:
        """The numbers of the model for `tree_matrices`, or None if it does not support some joints."""
        model, data = self.model(), self.data()
        return tree_of(model, [part.model for part in data.parts] if isinstance(data, Forest) else [model])

    def warn_of_limits(self, q: np.ndarray, rows: str = "", stacklevel: int = 4) -> None:
        """Warn of a configuration outside the joint limits, once."""
        self.ignore_limits()
        warn_of_limits(self.model(), q, rows, stacklevel)

    def check_limits(self, q: np.ndarray, stacklevel: int) -> None:
        """Warn of a configuration (nq,) outside the joint limits."""
        if ((q < self.bounds[0]) | (q > self.bounds[1])).any():
            self.warn_of_limits(q, stacklevel=stacklevel + 1)

    def ignore_limits(self) -> None:
        """Disable warnings of joint limits."""
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
        found = self.contacts.get((frame, body))
        if found is None:
            model: Any = self.model()
            ends = self.frame(frame), 0 if body is None else self.frame(body, "body")
            signs = np.ones(self.nv)  # with mimic joints columns already are differences of the two frames
            if not self.mimics:
                signs = motion_signs(model, *(model.frames[end].parentJoint for end in ends))
            found = self.contacts[frame, body] = (*ends, signs)
        return found

    def ends(self, frame: str | int, body: str | int | None) -> tuple[int, int]:
        """Return the joints of a contact's frame and of the frame to which its surface is attached."""
        found = self._ends.get((frame, body))
        if found is None:
            model: Any = self.model()
            tip, base = (model.frames[end].parentJoint for end in self.contact(frame, body)[:2])
            found = self._ends[frame, body] = tip, base
        return found


class _Joints(NamedTuple):
    """The fields of Data that depend on their model: parents of the velocities, kinds and axes of joints."""

    parents: list[int]
    kinds: list[str]
    axes: list[Any]


def _joints(data: pin.Data) -> _Joints:
    joints = list(data.joints)
    kinds = [joint.shortname().removeprefix("JointData") for joint in joints]
    axes = [
        joint.S.tolist() if kind in UNALIGNED else None for joint, kind in zip(joints, kinds, strict=True)
    ]
    return _Joints(data.parents_fromRow.tolist(), kinds, axes)


def _parents(model: pin.Model, data: Any) -> np.ndarray:
    """Return the parents of velocities; raise an error for Data of another model."""
    if not isinstance(data, pin.Data):
        raise InputError(
            f"data: {type(data).__name__} given, pinocchio Data expected: model.createData(), or a "
            "RobotWrapper's .data",
            value=data,
        )
    if len(data.oMi) != model.njoints or len(data.oMf) != model.nframes or len(data.M) != model.nv:
        raise outdated(model, data)
    own, given = once(_known, model, lambda model: _joints(model.createData())), _joints(data)
    if given.parents != own.parents:
        raise _foreign(data, "whose kinematic tree is another")
    for name, kind, other, axis, its in zip(
        model.names, own.kinds, given.kinds, own.axes, given.axes, strict=True
    ):
        if kind != other:
            raise _foreign(data, f"whose joint {name!r} is {other}, not {kind}")
        if axis != its:
            raise _foreign(data, f"whose joint {name!r} has another axis")
    return np.array(own.parents, dtype=np.int64)


def _foreign(data: pin.Data, how: str) -> InputError:
    return InputError(
        f"data: made for another robot, {how}; make new data with model.createData()", value=data
    )


def outdated(model: pin.Model, data: Any) -> InputError:
    """Return the error for data that do not match their model."""
    return InputError(
        f"data: made for another model or before this one was changed "
        f"({len(data.oMi)} joints, {len(data.oMf)} frames, {len(data.M)} velocities; the model has "
        f"{model.njoints}, {model.nframes}, {model.nv}); make new data with model.createData()",
        value=data,
    )


_caches: dict[int, DataCache] = {}
_known: Known = {}


def data_cache(model: pin.Model, data: pin.Data) -> DataCache:
    """Return the cache of `data`, created on the first call and kept as long as `data` exists.

    Frame placements, inertias and rotor inertias may change between calls. Adding a frame requires new data;
    a frame that is renamed in place is known by its first name.
    """
    found = _caches.get(id(data))
    if found is None or found.data() is not data or found.model() is not model:
        found = _caches[id(data)] = DataCache(model, data)
    return found


def checked_configuration(cache: DataCache, model: pin.Model, q: Any) -> np.ndarray:
    """Return q as an (nq,) array, or raise `InputError`: wrong length, not finite, or not normalized.

    The tolerance of the length of a quaternion or (cos, sin) pair is `HALF_DIGITS`.
    """
    q = finite_array("q", q, cache.q_shape)
    if cache.curved and not pin.isNormalized(model, q, HALF_DIGITS):
        raise not_normalized(q)
    return q


def not_normalized(q: np.ndarray) -> InputError:
    """Return the error for a configuration in which a quaternion is not of unit length."""
    return InputError(
        "q: a quaternion or (cos, sin) pair is not of unit length; use pinocchio.normalize(model, q)", value=q
    )
