"""Tips of a collision shape that touch a surface first, and rims that lie flat on it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ._kernels import contact_kinematics
from .contact import WORLD, Contact
from .data_cache import checked_configuration, data_cache
from .forest import frame_placement
from .names import model_of

Array = NDArray[np.float64]

TIE = 4e-12
"""Tips whose gaps differ by less than this part of 1 m and the largest coordinate touch together."""

FLAT = 1e-12
"""Sine of the angle between a rim and its plane that is taken as zero."""


def touching_tips(robot: Any, data: pin.Data, q: ArrayLike, contact: Contact) -> list[Contact]:
    """Return the tips of a contact of a collision shape with the smallest gap at a configuration.

    Args:
        robot: The RobotWrapper.
        data: Its data; `Contact.gap` lists the fields that change.
        q: (nq,) configuration.
        contact: The contact.
    """
    tips = contact.tips(robot)
    model = model_of(robot)
    cache = data_cache(model, data)
    cache.forward_kinematics(model, data, checked_configuration(cache, model, q))
    frame, carrier = _placements(model, data, tips[0])
    places = np.array([contact_kinematics.locate(frame, carrier, tip.constants) for tip in tips])
    gaps = places[:, 0]
    near = gaps <= gaps.min() + TIE * (1.0 + float(np.abs(places[:, 4:]).max()))
    return [tips[k] for k in np.flatnonzero(near)]


def check_rims(model: pin.Model, data: pin.Data, q: ArrayLike, contacts: Iterable[Contact]) -> None:
    """Raise an error for an impact at a rim that lies flat on its plane.

    Raises:
        InputError: A rim lies flat; the message has the contact.
    """
    rims = [contact for contact in contacts if contact.rim > 0.0]
    if not rims:
        return
    cache = data_cache(model, data)
    cache.forward_kinematics(model, data, checked_configuration(cache, model, q))
    for contact in rims:
        if float(np.linalg.norm(tilt_of_rim(model, data, contact))) <= FLAT:
            raise InputError(f"contact: {flat_rim(contact)}", field="contact", value=contact)


def tilt_of_rim(model: pin.Model, data: pin.Data, contact: Contact) -> Array:
    """Return u × n (3,) in the axes of the plane's carrier, with ``data.oMi`` up to date.

    Its length is the sine of the angle between a rim and its plane; its lowest point is perpendicular to it.
    """
    frame, carrier = _placements(model, data, contact)
    axis = carrier[:3, :3].T @ (frame[:3, :3] @ contact.axis)
    return np.cross(axis, contact.plane.axes[2])


def flat_rim(contact: Contact) -> str:
    """Return the message for a rim that lies flat."""
    return (
        f"{contact.label!r} lies flat on its surface: a smooth rim then has no unique contact "
        "point; set rim_points= of the collision shape, or give contacts at single points"
    )


def _placements(model: pin.Model, data: pin.Data, contact: Contact) -> tuple[Array, Array]:
    cache = data_cache(model, data)
    frame = frame_placement(model, data, cache.frame(contact.frame)).homogeneous
    if contact.plane.body is None:
        return frame, WORLD
    return frame, frame_placement(model, data, cache.frame(contact.plane.body, "body")).homogeneous
