"""Contacts of one collision shape, which a scene looks at together: one after the other, in one sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..robot.contact import Contact
from ._kernels.tolerances import ROUNDING

LEAST = 4
"""Contacts of a shape that are worth a sphere."""


def runs(contacts: Sequence[Contact]) -> list[tuple[int, int]]:
    """Return first and last + 1 of the contacts, one after the other, that are of one shape and surface.

    A contact that is of no shape, or of a shape with less than `LEAST` of them, is a run alone.
    """
    found: list[tuple[int, int]] = []
    first = 0
    for i in range(1, len(contacts) + 1):
        if i < len(contacts) and _together(contacts[first], contacts[i]):
            continue
        found += [(first, i)] if i - first >= LEAST else [(k, k + 1) for k in range(first, i)]
        first = i
    return found


def _together(one: Contact, other: Contact) -> bool:
    same = one.shape is not None and one.shape == other.shape and one.frame == other.frame
    return same and one.pair is None and one.plane == other.plane


def bounding_sphere(contacts: Sequence[Contact]) -> Contact | None:
    """Return a sphere that bounds the tips of a run, as a contact of its own; None for one alone."""
    if len(contacts) == 1:
        return None
    centres = np.array([contact.offset for contact in contacts])
    centre = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
    away = np.linalg.norm(centres - centre, axis=1)
    radius = float(max(d + c.radius + c.rim for d, c in zip(away.tolist(), contacts, strict=True)))
    x, y, z = centre.tolist()
    return replace(
        contacts[0],
        offset=(x, y, z),
        radius=radius * (1.0 + ROUNDING),
        rim=0.0,
        name=f"{contacts[0].shape} on {contacts[0].plane.label}",
    )
