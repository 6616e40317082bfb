"""How far a robot reaches: the lengths of its chains, and contacts that can never touch."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ..robot.contact import Contact
from ..robot.names import frame_id


def out_of_reach(model: pin.Model, contact: Contact, limited: bool) -> bool:
    """Return whether a contact can never reach its plane, whatever the joints do.

    False is the safe answer; it is given where the plane is carried by a body.

    Args:
        model: The robot.
        contact: The contact.
        limited: Whether the joint limits act.
    """
    plane = contact.plane
    if plane.body is not None:
        return False
    tip = model.frames[frame_id(model, contact.frame)]
    support = list(model.supports[tip.parentJoint])
    root = model.jointPlacements[support[1]].translation if len(support) > 1 else np.zeros(3)
    normal, point = np.array(plane.normal), np.array(plane.point)
    height = float(normal @ (root - point))
    if len(support) == 1:
        height += float(normal @ tip.placement.act(np.array(contact.offset))) - contact.radius
        return height > 0.0
    travel = sliding_travel(model, contact, limited)
    return height - chain_length(model, link_lengths(model), contact) - travel > 0.0


def link_lengths(model: pin.Model) -> list[float]:
    """Return each joint's distance from the joint before it [m], zero where that is the world."""
    parents = list(model.parents)
    return [
        math.hypot(*placement.translation.tolist()) if parent > 0 else 0.0
        for parent, placement in zip(parents, model.jointPlacements, strict=True)
    ]


def chain_length(model: pin.Model, links: list[float], contact: Contact) -> float:
    """Return the length of the chain from a contact's first joint to its point, joints at zero travel [m]."""
    frame = model.frames[frame_id(model, contact.frame)]
    tip = math.hypot(*frame.placement.act(np.array(contact.offset)).tolist())
    return tip + contact.radius + sum(links[joint] for joint in list(model.supports[frame.parentJoint])[2:])


def sliding_travel(model: pin.Model, contact: Contact, limited: bool) -> float:
    """Return how far the joints of a contact's chain can slide in all [m]; infinite where one has no end.

    Args:
        model: The robot.
        contact: The contact.
        limited: Whether the joint limits act.
    """
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
