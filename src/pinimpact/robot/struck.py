"""Kernel data of a contact that collides, cached with the Data."""

from __future__ import annotations

import pinocchio as pin

from ._kernels.robot_workspace import RobotWorkspace
from .contact import Contact, check_contact
from .data_cache import DataCache, outdated
from .pinocchio_bridge import refuse
from .tree_numbers import workspace_of

MOST = 4096
"""Largest number of cached contacts, of some kilobytes each."""


def strike(
    cache: DataCache, model: pin.Model, data: pin.Data, contact: Contact
) -> tuple[Contact, RobotWorkspace | None]:
    """Return the workspace of a contact, None if `tree_matrices` does not support some joint.

    It is created on the first call and again if the model has grown, and stored with the contact, so that no
    other one has its id.
    """
    if model.njoints != cache.njoints:
        raise outdated(model, data)
    if model.nframes != cache.frames_seen or len(cache.workspaces) >= MOST:
        cache.workspaces.clear()  # frames are elsewhere in memory now
        cache.frames_seen = model.nframes
    found = cache.workspaces.get(id(contact))
    if found is not None:
        return found
    check_contact("contact", contact)
    frame, carrier, signs = cache.contact(contact.frame, contact.plane.body)
    if cache.flaw is not None:
        refuse(model)
    work = None
    if cache.tree is not None:
        work = workspace_of(cache.tree, frame, carrier, model, cache.bounds, cache.parents, signs)
        work.constants[:] = contact.constants
        work.friction, work.law = contact.friction, contact.law_code
    found = cache.workspaces[id(contact)] = contact, work
    return found
