"""Kernel data of a contact that collides, cached with the Data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ._kernels.robot_impact import room_to_resolve
from ._kernels.robot_workspace import RobotWorkspace
from .contact import Contact
from .data_cache import DataCache, outdated
from .pinocchio_bridge import MassAndFrames, workspace_of

MOST = 256
"""Largest number of cached contacts."""


class Struck(NamedTuple):
    """Kernel data of a contact that collides.

    Attributes:
        contact: The contact, kept so that no other one has its id.
        signs, constants: As in `contact_kinematics.jacobian`.
        work: For `robot_impact`; None if `tree_matrices` does not support some joint.
        parts: Mass matrix and Jacobian from Pinocchio in that case,
        room: and the work array of `resolve`.
    """

    contact: Contact
    signs: np.ndarray
    constants: np.ndarray
    work: RobotWorkspace | None
    parts: MassAndFrames | None
    room: np.ndarray


def strike(cache: DataCache, model: pin.Model, data: pin.Data, contact: Contact) -> Struck:
    """Return the kernel data of a contact, created on the first call and again if the model has grown."""
    if model.njoints != cache.njoints:
        raise outdated(model, data)
    if model.nframes != cache.frames_seen or len(cache.struck) >= MOST:
        cache.struck.clear()  # frames are elsewhere in memory now
        cache.frames_seen = model.nframes
    found: Struck | None = cache.struck.get(id(contact))
    if found is not None:
        return found
    frame, carrier, signs = cache.contact(contact.frame, contact.plane.body)
    cache.mass_matrix(model, data, pin.neutral(model), pin.Convention.WORLD)  # says what is wrong
    work = parts = None
    room = np.empty(0 if cache.tree else room_to_resolve(cache.nv))
    if cache.tree is None:
        parts = MassAndFrames(model, data, frame, carrier)
    else:
        work = workspace_of(cache.tree, frame, carrier, model, cache.bounds, cache.parents, signs)
        work.constants[:] = contact.constants
        work.friction, work.law = contact.friction, contact.law_code
    found = cache.struck[id(contact)] = Struck(contact, signs, contact.constants.copy(), work, parts, room)
    return found
