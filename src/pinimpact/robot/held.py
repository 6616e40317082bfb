"""Checks of held contacts in an impact: at rest before it, and no pull."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .contact import Contact
from .matrices import ContactGeometry

Array = NDArray[np.float64]

HELD_TOLERANCE = 1e-6
"""Tolerance of the velocity of a held point before the impact, relative to the sum of the joints'
contributions."""

PULL = 1e-12
"""Smallest pull that is reported, relative to the impulse of the impact."""


class HeldContactWarning(UserWarning):
    """A held contact pulls on its surface during an impact."""


def check_at_rest(geometries: Sequence[ContactGeometry], held: Sequence[Contact], v: Array) -> None:
    """Raise an error for held contacts that move relative to their surfaces."""
    for anchor, geometry in zip(held, geometries, strict=True):
        speed = float(np.linalg.norm(geometry.velocity(v)))
        scale = float(np.linalg.norm(np.abs(geometry.jacobian) @ np.abs(v)))
        scale += float(np.linalg.norm(geometry.surface_velocity))
        if speed > HELD_TOLERANCE * scale:
            raise InputError(
                f"held: {anchor.label!r} moves at {speed:.3g} m/s relative to its surface before "
                "the impact; a held contact must be at rest there: correct v, or remove it from "
                "held",
                field="held",
                value=anchor,
            )


def warn_of_pulls(
    geometries: Sequence[ContactGeometry],
    held: Sequence[Contact],
    impulses: Array,
    impulse: Array,
    stacklevel: int,
) -> None:
    """Warn of held contacts that pull on their surfaces.

    Args:
        geometries: Geometry of the held contacts.
        held: The held contacts.
        impulses: (k, 3) on the robot at them, in world axes.
        impulse: Impulse of the impact, of any shape.
        stacklevel: As in `warnings.warn`, seen from the caller.
    """
    for anchor, geometry, push in zip(held, geometries, impulses, strict=True):
        pull = -float(geometry.axes[2] @ push)
        if pull > PULL * float(np.linalg.norm(impulse)):
            warnings.warn(
                f"held: {anchor.label!r} pulls on its surface with {pull:.3g} N s; if it can lift "
                "off, remove it from held",
                HeldContactWarning,
                stacklevel=stacklevel + 1,
            )
