"""The impulsive wrenches through the joints of a robot during an impact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import InputError
from .contact import Contact, check_held
from .forest import Forest
from .placed_robot import PlacedRobot


def held_of_impact(held: Sequence[Contact], count: int) -> tuple[Contact, ...]:
    """Return the held contacts of an impact with `count` of them, or raise `InputError`."""
    contacts = check_held(held)
    if len(contacts) != count:
        raise InputError(f"held: {len(contacts)} given, {count} of the impact expected", value=held)
    return contacts


def joint_reactions(placed: PlacedRobot, change: Array, contacts: Sequence[Contact], pushes: Array) -> Array:
    """Return the impulsive wrenches through the joints (joints, 6), see `Hit.joint_reactions`.

    They are the inverse dynamics, without gravity, of the velocity change (nv,), with the impulses `pushes`
    (k, 3) at the contacts, in world axes, as external forces.
    """
    model, data = placed.model, placed.data
    if isinstance(data, Forest):
        raise InputError("data: a Forest given; a pinocchio Data is expected", value=data)
    outside = [pin.Force.Zero() for _ in range(model.njoints)]
    for contact, push in zip(contacts, pushes, strict=True):
        at = placed.geometry(contact).point
        wrench = pin.Force(push, np.cross(at, push))
        ends = placed.cache.contact(contact.frame, contact.plane.body)[:2]
        for frame, sign in zip(ends, (1.0, -1.0), strict=True):
            joint = model.frames[frame].parentJoint
            outside[joint] += data.oMi[joint].actInv(sign * wrench)
    still, nothing = np.zeros(len(change)), [pin.Force.Zero()] * model.njoints
    wrenches = np.zeros((model.njoints, 6))
    for sign, acceleration, forces in ((1.0, change, outside), (-1.0, still, nothing)):  # less gravity
        pin.rnea(model, data, placed.q, still, acceleration, forces)
        wrenches[1:] += [sign * data.f[joint].vector for joint in range(1, model.njoints)]
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            wrenches[0] -= data.oMi[joint].act(pin.Force(wrenches[joint])).vector
    return wrenches
