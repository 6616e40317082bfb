"""What does not change about a model and its Data from one call to the next, remembered."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import pinocchio as pin

from ..checks import finite_array
from ..errors import InputError
from .names import frame_id, motion_signs
from .pinocchio_bridge import MassAndColumns


class DataCache:
    """What does not change about a model and its data from one call to the next; see `data_cache`."""

    __slots__ = (
        *(
            "columns",
            "contacts",
            "curved",
            "data",
            "frames",
            "joint_jacobian",
            "mass_matrix",
            "model",
            "nframes",
            "nv",
        ),
        *("parents", "q_shape", "v_shape"),
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
        self.contacts: dict[Any, tuple[int, int, np.ndarray]] = {}
        bridge = MassAndColumns(model, data)
        self.columns = bridge.columns
        self.mass_matrix = bridge.mass_matrix
        self.joint_jacobian = bridge.joint_jacobian

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
        """Return the ids of a contact's frame and of the frame that carries its surface, and signs.

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


def outdated(model: pin.Model, data: Any) -> InputError:
    """Return the error for data that do not fit their model."""
    return InputError(
        f"data: made for another model or before this one was changed "
        f"({len(data.oMi)} joints, {len(data.oMf)} frames, {len(data.M)} velocities; the model has "
        f"{model.njoints}, {model.nframes}, {model.nv}); make new data with model.createData()",
        field="data",
        value=data,
    )


_caches: dict[int, DataCache] = {}


def _forget(key: int) -> Any:
    forget = _caches.pop  # bound now: at exit the module may be gone before the data
    return lambda _: forget(key, None)


def data_cache(model: pin.Model, data: pin.Data) -> DataCache:
    """Return the cache of `data`, made on the first call and remembered as long as `data` lives.

    Frame placements, inertias and rotor inertias may be changed between calls. Adding a frame calls for
    new data; a frame that is renamed in place keeps answering to the name first asked for.
    """
    found = _caches.get(id(data))
    if found is None or found.data() is not data or found.model() is not model:
        found = _caches[id(data)] = DataCache(model, data)
    return found


def checked_configuration(cache: DataCache, model: pin.Model, q: Any) -> np.ndarray:
    """Return q as a checked (nq,) array.

    Raises:
        InputError: Wrong length, not finite, or a quaternion or (cos, sin) pair that is not of unit length
            to within 1e-8.
    """
    q = finite_array("q", q, cache.q_shape)
    if cache.curved and not pin.isNormalized(model, q, 1e-8):
        raise InputError(
            "q: a quaternion or (cos, sin) pair is not of unit length; use pinocchio.normalize(model, q)",
            field="q",
            value=q,
        )
    return q
