"""Names to ids in a Pinocchio model, with errors that offer what was meant."""

from __future__ import annotations

import ctypes
import difflib
import weakref
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..checks import finite_array
from ..errors import InputError, UnknownNameError


def near_matches(name: str, names: Iterable[str]) -> str:
    """Return a clause that offers the names closest to `name`, or how many there are if none is close."""
    names = sorted(set(names))
    lowered = {known.lower(): known for known in names}
    close = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=5, cutoff=0.5)]
    close += [known for known in names if name and name.lower() in known.lower() and known not in close][:5]
    if close:
        return "did you mean " + ", ".join(map(repr, close[:5])) + "?"
    shown = ", ".join(map(repr, names[:8])) + (", …" if len(names) > 8 else "")
    return f"the names are {shown}"


def frame_id(model: pin.Model, key: str | int, field: str = "frame") -> int:
    """Return the id of a frame given by name or id.

    Raises:
        UnknownNameError: No frame bears the name (near matches are offered), several do (their ids are
            offered), or the id is out of range.
    """
    if not isinstance(key, str):
        if not 0 <= key < model.nframes:
            raise UnknownNameError(
                f"{field}: there is no frame {key}; this model's frames are 0 to {model.nframes - 1}",
                field=field,
                value=key,
            )
        return int(key)
    ids = [i for i, frame in enumerate(model.frames) if frame.name == key]
    if not ids:
        raise UnknownNameError(
            f"{field}: no frame is called {key!r}; {near_matches(key, (f.name for f in model.frames))}",
            field=field,
            value=key,
        )
    if len(ids) > 1:
        bearers = ", ".join(
            f"{i} ({str(model.frames[i].type).lower().replace('_', ' ')}, "
            f"on joint {model.names[model.frames[i].parentJoint]!r})"
            for i in ids
        )
        raise UnknownNameError(
            f"{field}: {len(ids)} frames are called {key!r}; give the id of the one that is meant: {bearers}",
            field=field,
            value=key,
        )
    return ids[0]


def free_velocities(model: pin.Model, locked: Sequence[str | int]) -> np.ndarray:
    """Return (nv,) booleans: False for the velocities of the joints named (or numbered) in `locked`.

    Raises:
        UnknownNameError: A name that no joint bears, or a number out of range.
    """
    free = np.ones(model.nv, dtype=np.bool_)
    if isinstance(locked, (str, int)):
        locked = (locked,)
    for key in locked:
        joint = key
        if isinstance(key, str):
            joint = model.getJointId(key)
            if joint == model.njoints:
                raise UnknownNameError(
                    f"locked: no joint is called {key!r}; {near_matches(key, list(model.names)[1:])}",
                    field="locked",
                    value=key,
                )
        elif not 0 < key < model.njoints:
            raise UnknownNameError(
                f"locked: there is no joint {key}; this model's joints are 1 to {model.njoints - 1}",
                field="locked",
                value=key,
            )
        free[model.idx_vs[joint] : model.idx_vs[joint] + model.nvs[joint]] = False
    return free


class Workspace:
    """What does not change about a model and its data from one call to the next; see `workspace`."""

    __slots__ = (
        *("columns", "curved", "data", "frames", "model", "nframes", "nv", "parents", "q_shape", "supports"),
        "v_shape",
    )

    def __init__(self, model: pin.Model, data: pin.Data) -> None:
        if len(data.oMi) != model.njoints or len(data.oMf) != model.nframes or len(data.M) != model.nv:
            raise outdated(model, data)
        self.model = weakref.ref(model)
        self.data = weakref.ref(data, _forget(id(data)))
        self.nframes = model.nframes
        self.nv = model.nv
        self.q_shape = (model.nq,)
        self.v_shape = (model.nv,)
        self.curved = model.nq != model.nv
        self.parents = np.array(data.parents_fromRow, dtype=np.int64)
        if len(self.parents) != model.nv:  # mimic joints: M has no tree's pattern, so take it as a chain
            self.parents = np.arange(-1, model.nv - 1)
        self.frames: dict[Any, int] = {}
        self.supports: dict[int, np.ndarray] = {}
        # what crba and computeJointJacobians write; with mimic joints it has columns of its own
        self.columns = _unowned(data.J, (6, model.nv)) if data.J.size == 6 * model.nv else None

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

    def support(self, frame: int) -> np.ndarray:
        """Return (nv,) booleans: the velocities that move a frame given by id."""
        found = self.supports.get(frame)
        if found is None:
            model: Any = self.model()
            # with mimic joints a column holds what the frame's own joints do, and nothing else
            found = self.supports[frame] = np.full(self.nv, self.columns is None)
            for joint in list(model.supports[model.frames[frame].parentJoint])[1:]:
                found[model.idx_vs[joint] : model.idx_vs[joint] + model.nvs[joint]] = True
        return found


def _unowned(array: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a view of an array, column by column, that does not keep its owner alive."""
    numbers = (ctypes.c_double * array.size).from_address(array.__array_interface__["data"][0])
    return np.ctypeslib.as_array(numbers).reshape(shape, order="F")


def outdated(model: pin.Model, data: Any) -> InputError:
    """Return the error for data that do not fit their model."""
    return InputError(
        f"data: made for another model or before this one was changed "
        f"({len(data.oMi)} joints, {len(data.oMf)} frames, {len(data.M)} velocities; the model has "
        f"{model.njoints}, {model.nframes}, {model.nv}); make new data with model.createData()",
        field="data",
        value=data,
    )


_workspaces: dict[int, Workspace] = {}


def _forget(key: int) -> Any:
    forget = _workspaces.pop  # bound now: at exit the module may be gone before the data
    return lambda _: forget(key, None)


def workspace(model: pin.Model, data: pin.Data) -> Workspace:
    """Return the workspace of `data`, made on the first call and remembered as long as `data` lives.

    Frame placements, inertias and rotor inertias may be changed between calls. Adding a frame calls for
    new data; a frame that is renamed in place keeps answering to the name first asked for.
    """
    found = _workspaces.get(id(data))
    if found is None or found.data() is not data or found.model() is not model:
        found = _workspaces[id(data)] = Workspace(model, data)
    return found


def model_of(robot: Any) -> pin.Model:
    """Return the model of a RobotWrapper, or the model itself.

    Raises:
        InputError: Neither of the two.
    """
    if isinstance(robot, pin.Model):
        return robot
    model = getattr(robot, "model", None)
    if not isinstance(model, pin.Model):
        raise InputError(
            f"model: a pinocchio Model or RobotWrapper is expected, not {type(robot).__name__}",
            field="model",
            value=robot,
        )
    return model


def configuration(space: Workspace, model: pin.Model, q: Any) -> np.ndarray:
    """Return q as a checked (nq,) array.

    Raises:
        InputError: Wrong length, not finite, or a quaternion or (cos, sin) pair that is not of unit length
            to within 1e-8.
    """
    q = finite_array("q", q, space.q_shape)
    if space.curved and not pin.isNormalized(model, q, 1e-8):
        raise InputError(
            "q: a quaternion or (cos, sin) pair is not of unit length; use pinocchio.normalize(model, q)",
            field="q",
            value=q,
        )
    return q
