"""Checks of held contacts in an impact: at rest before it, and no pull."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import ROUNDING
from ..arrays import Array
from ..checks import finite_array
from ..errors import InputError
from .contact import Contact, check_held
from .names import model_of
from .placed_robot import ContactGeometry, PlacedRobot
from .tolerances import HELD_TOLERANCE


class HeldContactWarning(UserWarning):
    """A held contact pulls on its surface during an impact."""


def moves(geometry: ContactGeometry, v: Array, scale: float) -> bool:
    """Return whether a held contact moves relative to its surface; `scale` is that of velocities [m/s]."""
    scale = max(scale, geometry.velocity_scale(v))
    return float(np.linalg.norm(geometry.velocity(v))) > HELD_TOLERANCE * scale


def pull(geometry: ContactGeometry, push: Array, impulse: Array) -> float:
    """Return the tensile impulse of a held contact in an impact [N s], 0 for none.

    `push` (3,) is the impulse on the robot at the held contact, in world axes; `impulse` (any shape) is that
    of the impact, for the scale.
    """
    found = -float(geometry.axes[2] @ push)
    return found if found > ROUNDING * float(np.linalg.norm(impulse)) else 0.0


def held_at_rest(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact, held: Sequence[Contact]
) -> tuple[Contact, ...]:
    """Return the contacts held in the impact of one; raise an error for those that move."""
    held = check_held(held)
    if held:
        placed = PlacedRobot(model_of(model), data, q)
        v = finite_array("v", v, (placed.model.nv,))
        scale = placed.geometry(contact).velocity_scale(v) if contact.geometry is None else 0.0
        check_at_rest([placed.geometry(anchor) for anchor in held], held, v, scale)
    return held


def check_at_rest(
    geometries: Sequence[ContactGeometry], held: Sequence[Contact], v: Array, scale: float
) -> None:
    """Raise an error for held contacts that move relative to their surfaces; see `moves`."""
    for anchor, geometry in zip(held, geometries, strict=True):
        if moves(geometry, v, scale):
            speed = float(np.linalg.norm(geometry.velocity(v)))
            raise InputError(
                f"held: {anchor.label!r} moves at {speed:.3g} m/s relative to its surface before "
                "the impact; a held contact must be at rest there: correct v, or remove it from "
                "held",
                value=anchor,
            )


def warn_of_pulls(
    geometries: Sequence[ContactGeometry], held: Sequence[Contact], impulses: Array, impulse: Array
) -> None:
    """Warn of held contacts that pull on their surfaces, at the line that called `impact`; see `pull`."""
    for anchor, geometry, push in zip(held, geometries, impulses, strict=True):
        needed = pull(geometry, push, impulse)
        if needed > 0.0:
            warnings.warn(
                f"held: {anchor.label!r} pulls on its surface with {needed:.3g} N s; if it can lift "
                "off, remove it from held",
                HeldContactWarning,
                stacklevel=5,
            )
