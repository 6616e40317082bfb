"""Tips of a collision shape that touch a surface first, and rims that lie flat on it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import ROUNDING
from ..arrays import Array
from ..errors import InputError
from ..geometry.tolerances import NEAREST
from .contact import Contact
from .placed_robot import PlacedRobot


def touching_tips(robot: Any, data: pin.Data, q: ArrayLike, contact: Contact) -> list[Contact]:
    """Return the tips of a contact of a collision shape with the smallest gap at q (nq,).

    `Contact.gap` lists the fields of `data` that change.
    """
    tips, placed = contact.tips(robot), PlacedRobot(robot, data, q)
    found = [placed.locate(tip) for tip in tips]
    gaps = np.array([gap for gap, _, _ in found])
    largest = max(float(np.abs(point).max()) for _, _, point in found)
    return [tips[k] for k in np.flatnonzero(gaps <= gaps.min() + NEAREST * (1.0 + largest))]


def check_rims(placed: PlacedRobot, contacts: Iterable[Contact]) -> None:
    """Raise `InputError` for an impact at a rim that lies flat on its plane."""
    for contact in contacts:
        if contact.rim > 0.0 and float(np.linalg.norm(tilt_of_rim(placed, contact))) <= ROUNDING:
            raise InputError(f"contact: {flat_rim(contact)}", value=contact)


def tilt_of_rim(placed: PlacedRobot, contact: Contact) -> Array:
    """Return u × n (3,) in the axes of the plane's carrier.

    Its length is the sine of the angle between a rim and its plane; its lowest point is perpendicular to it.
    """
    frame, carrier = placed.placements(contact)
    axis = carrier[:3, :3].T @ (frame[:3, :3] @ contact.axis)
    return np.cross(axis, contact.plane.axes[2])


def flat_rim(contact: Contact) -> str:
    """Return the message for a rim that lies flat."""
    return (
        f"{contact.label!r} lies flat on its surface: a smooth rim then has no unique contact "
        "point; set rim_points= of the collision shape, or give contacts at single points"
    )
