"""Reach of a robot: lengths of its chains, and contacts that can never touch their surface."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ..robot.contact import Contact
from ..robot.names import frame_id


def out_of_reach(model: pin.Model, contact: Contact, limited: bool) -> bool:
    """Return whether a contact can reach its surface at no configuration.

    False means that it may. It is returned if a body carries the surface. A collision shape that cannot move
    relative to its surface never reaches it, even if the two overlap. `limited` is whether joint limits act.
    """
    surface = contact.plane
    tip = model.frames[frame_id(model, contact.frame)]
    if surface.body is not None:
        carrier = model.frames[frame_id(model, surface.body, "body")]
        return contact.shape is not None and bool(tip.parentJoint == carrier.parentJoint)
    support = list(model.supports[tip.parentJoint])
    if len(support) == 1:
        away = surface.distance(tip.placement.act(np.array(contact.offset))) - contact.radius - contact.rim
        return contact.shape is not None or away > 0.0
    reach = chain_length(model, link_lengths(model), contact) + sliding_travel(model, contact, limited)
    return surface.distance(model.jointPlacements[support[1]].translation) - reach > 0.0


def link_lengths(model: pin.Model) -> list[float]:
    """Return the distance of each joint from its parent joint [m]; zero if the parent is the world."""
    parents = list(model.parents)
    return [
        math.hypot(*placement.translation.tolist()) if parent > 0 else 0.0
        for parent, placement in zip(parents, model.jointPlacements, strict=True)
    ]


def chain_length(model: pin.Model, links: list[float], contact: Contact) -> float:
    """Return the length of the chain from a contact's first joint to its point [m], at zero travel.

    It is zero for a contact fixed in the world.
    """
    frame = model.frames[frame_id(model, contact.frame)]
    if frame.parentJoint == 0:
        return 0.0
    tip = math.hypot(*frame.placement.act(np.array(contact.offset)).tolist())
    return (
        tip
        + contact.radius
        + contact.rim
        + sum(links[joint] for joint in list(model.supports[frame.parentJoint])[2:])
    )


def sliding_travel(model: pin.Model, contact: Contact, limited: bool) -> float:
    """Return the total sliding travel of the joints of a contact's chain [m]; infinite if unbounded."""
    total = 0.0
    for joint in list(model.supports[model.frames[frame_id(model, contact.frame)].parentJoint])[1:]:
        kind = model.joints[joint].shortname()
        if any(word in kind for word in ("RX", "RY", "RZ", "RUB", "Revolute", "Spherical", "Universal")):
            continue
        i = model.idx_qs[joint]
        bound = max(abs(float(model.lowerPositionLimit[i])), abs(float(model.upperPositionLimit[i])))
        straight = any(word in kind for word in ("PX", "PY", "PZ", "Prismatic"))
        if not (straight and limited and 0.0 < bound < 1e300):
            return math.inf
        total += bound
    return total
