"""Tips of a collision shape that touch a surface first, and rims that lie flat on it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import ROUNDING
from ..errors import InputError
from ..geometry.tolerances import NEAREST
from .contact import Contact, points_of_rim
from .placed_robot import PlacedRobot


def touching_tips(robot: Any, data: pin.Data, q: ArrayLike, contact: Contact) -> list[Contact]:
    """Return the tips of a contact of a collision shape with the smallest gap at q (nq,).

    A rim that lies flat is replaced by points of its circle, see `points_of_rim`.

    `Contact.gap` lists the fields of `data` that change.
    """
    placed, tips = PlacedRobot(robot, data, q), list[Contact]()
    for tip in contact.tips(robot):
        tips += points_of_rim(tip) if lies_flat(placed, tip) else [tip]
    found = [placed.locate(tip) for tip in tips]
    gaps = np.array([gap for gap, _, _ in found])
    largest = max(float(np.abs(point).max()) for _, _, point in found)
    return [tips[k] for k in np.flatnonzero(gaps <= gaps.min() + NEAREST * (1.0 + largest))]


def check_rims(placed: PlacedRobot, contacts: Iterable[Contact]) -> None:
    """Raise `InputError` for an impact at a rim that lies flat on its plane."""
    for contact in contacts:
        if lies_flat(placed, contact):
            raise InputError(f"contact: {flat_rim(contact)}", value=contact)


def lies_flat(placed: PlacedRobot, contact: Contact) -> bool:
    """Return whether a contact is a rim parallel to its plane: |u × n|, the sine of its tilt, is zero."""
    if contact.rim == 0.0:
        return False
    frame, carrier = placed.placements(contact)
    axis = carrier[:3, :3].T @ (frame[:3, :3] @ contact.axis)
    return float(np.linalg.norm(np.cross(axis, contact.plane.axes[2]))) <= ROUNDING


def flat_rim(contact: Contact) -> str:
    """Return the message for a rim that lies flat."""
    return (
        f"{contact.label!r} lies flat on its surface: a smooth rim then has no unique contact "
        "point; set rim_points= of the collision shape, or give contacts at single points"
    )
