"""Measured impacts of a robot: states before and after, with contact and group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .._numeric.tolerances import ROUNDOFF
from ..arrays import Array
from ..checks import choice, counted, finite_array, in_short, real_numbers
from ..errors import InputError
from ..robot.matrices import ContactMatrices, contact_matrices
from ..robot.names import free_base
from ..scene.scene import Scene


@dataclass(frozen=True, eq=False, repr=False)
class FoundImpacts:
    """N measured impacts, at one contact each; ``found[rows]`` selects rows.

    Attributes:
        q: (N, nq) configurations.
        v_before, v_after: (N, nv) velocities before and after the impacts.
        contact: (N,) names of the contacts.
        group: (N,) labels of groups, such as tosses.
        time: (N,) times in their recordings [s].
        covariance: (N, 2 nv, 2 nv) covariance matrices of (v_before, v_after), or None.
        dropped: Reasons why other impacts of the recordings were omitted, one sentence each.
        scene: The scene with which they were identified in the recordings.
    """

    q: Array
    v_before: Array
    v_after: Array
    contact: NDArray[Any]
    group: NDArray[Any]
    time: Array | None = None
    covariance: Array | None = None
    dropped: tuple[str, ...] = ()
    scene: Scene | None = None

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, rows: Any) -> FoundImpacts:
        one = np.atleast_1d(np.arange(len(self))[rows])
        chosen: dict[str, Any] = {}
        for name in ("q", "v_before", "v_after", "contact", "group", "time", "covariance"):
            column = getattr(self, name)
            chosen[name] = None if column is None else column[one]
        return replace(self, **chosen)

    def __repr__(self) -> str:
        groups = counted(len(np.unique(self.group)), "group")
        return f"FoundImpacts({counted(len(self), 'impact')} in {groups}, {len(self.dropped)} dropped)"


def as_found(found: Any, scene: Scene, contact: Any) -> FoundImpacts:
    """Return impacts as checked `FoundImpacts`.

    Args:
        found: `FoundImpacts`, or arrays (q, v_before, v_after).
        scene: The scene of the robot.
        contact: With arrays, the name of the contact or (N,) names; None if the scene has one contact.

    Raises:
        InputError: Wrong shapes, or numbers that are not finite.
        UnknownNameError: A contact that the scene does not have.
    """
    labels = [one.label for one in scene.contacts]
    if not isinstance(found, FoundImpacts):
        q, before, after = arrays_of(found, "(q, v_before, v_after)")
        count = len(q)
        if contact is None:
            if len(labels) != 1:
                raise InputError(
                    f"contact: the scene has {counted(len(labels), 'contact')}; give the name of the one "
                    "that collides, or an array of names",
                    value=contact,
                )
            contact = labels[0]
        names = np.full(count, contact) if isinstance(contact, str) else np.asarray(contact)
        found = FoundImpacts(q, before, after, names, np.arange(count))
    count, model = len(found), scene.model
    if count == 0:
        raise InputError("found: no impacts given, at least one expected; see found.dropped", value=found)
    finite_array("q", found.q, (count, model.nq))
    finite_array("v_before", found.v_before, (count, model.nv))
    finite_array("v_after", found.v_after, (count, model.nv))
    if found.contact.shape != (count,):
        raise InputError(
            f"contact: shape {found.contact.shape} given, ({count},) names expected", value=found.contact
        )
    for name in dict.fromkeys(found.contact.tolist()):
        choice("contact", name, labels, "a contact of the scene")
    return found


def arrays_of(given: Any, what: str) -> tuple[Array, Array, Array]:
    """Return three arrays whose first axes have the same length, or raise `InputError`."""
    if isinstance(given, FoundImpacts) or not isinstance(given, Sequence) or len(given) != 3:
        raise InputError(f"found: {in_short(given)} given; {what} expected", value=given)
    first, before, after = (real_numbers("found", part) for part in given)
    count = len(before) if before.ndim else 0
    if before.ndim != 2 or before.shape != after.shape or not first.ndim or len(first) != count:
        shapes = ", ".join(str(part.shape) for part in (first, before, after))
        raise InputError(
            f"found: shapes {shapes} given; {what} with one row for each impact expected", value=given
        )
    return first, before, after


def matrices_of(found: FoundImpacts, scene: Scene) -> list[ContactMatrices]:
    """Return the `contact_matrices` of each impact."""
    data, contacts = scene.model.createData(), {one.label: one for one in scene.contacts}
    return [
        contact_matrices(scene.model, data, q, contacts[name], scene.held, scene.locked)
        for q, name in zip(found.q, found.contact.tolist(), strict=True)
    ]


def free_body(scene: Scene, what: str) -> pin.Inertia:
    """Return the inertia of the only body of a scene, which is free, or raise `InputError`.

    Recorded configurations are poses in the world, so the axes of the free joint must be those of the world.
    """
    model = scene.model
    if model.njoints != 2 or not free_base(model):
        raise InputError(
            f"scene: {what} is for one free body; {model.name!r} has {model.njoints - 1} joints", value=scene
        )
    rotation = model.jointPlacements[1].rotation
    if np.abs(rotation - np.eye(3)).max() > ROUNDOFF:
        raise InputError(
            f"scene: the free joint {model.names[1]!r} is rotated relative to the world; {what} needs "
            "model.jointPlacements[1] without rotation, and recordings in world axes",
            value=scene,
        )
    return model.inertias[1]
