"""Contact points of two bodies that lie between others in one plane, which are omitted. (theory.md, 15.3)"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..arrays import Array, Bools
from ..geometry.tolerances import CLOSE, COINCIDE, FACE
from ..robot.contact import Contact
from ..robot.shape_pair import ShapePair

OUT_OF_PLANE = COINCIDE / CLOSE
"""Factor on heights and gaps: points lie in one plane to within `CLOSE`, and coincide in it at `COINCIDE`."""


def law_of(contact: Contact) -> tuple[object, ...]:
    """Return the coefficients of a contact's laws, and the motion of its surface."""
    surface = contact.plane
    motion = surface.velocity, surface.angular_velocity, surface.origin * any(surface.angular_velocity)
    friction = contact.friction, contact.sustained_friction
    return *friction, contact.restitution, contact.law, contact.stiffness, *motion


def with_common_faces(pairs: Iterable[tuple[ShapePair, Contact]]) -> list[list[int]]:
    """Return the sets of pairs of shapes whose faces may lie in one plane, by their numbers.

    They are of the same two bodies, and their contacts have the same law. Round shapes are not among them.

    Args:
        pairs: The pairs, each with a contact of its points.
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for number, (pair, contact) in enumerate(pairs):
        if pair.radius == 0.0:
            joints = sorted((pair.a.joint, pair.b.joint))
            alike.setdefault((*joints, *law_of(contact)), []).append(number)
    return [numbers for numbers in alike.values() if len(numbers) > 1]


def points_between(normals: Array, points: Array, gaps: Array) -> Bools:
    """Return which contact points (k,) lie between others with the same normal.

    Their gaps and normal rates are weighted means of those of the others, which forces on the others limit.

    Args:
        normals: (k, 3) unit normals.
        points: (k, 3) points of contact [m].
        gaps: (k,) their gaps [m].
    """
    found = np.zeros(len(points), dtype=bool)
    rest = np.arange(len(points))
    while rest.size > 1:
        normal = normals[rest[0]]
        alike = normals[rest] @ normal >= FACE
        same, rest = rest[alike], rest[~alike]
        across = points[same] - points[same[0]]
        across -= (1.0 - OUT_OF_PLANE) * (across @ normal)[:, None] * normal
        found[same] = within_hull(np.column_stack([across, OUT_OF_PLANE * gaps[same]]))
    return found


def within_hull(points: Array) -> Bools:
    """Return which points (k, d) lie in the convex hull of the others; of several that coincide, all but one.

    Distances up to `COINCIDE`, relative to the extent of the points, are taken as zero.
    """
    from scipy.optimize import nnls  # takes a tenth of a second to import, and is rarely needed

    every = points - points[0]
    size = float(np.linalg.norm(every, axis=1).max())
    rows = np.vstack([every.T, np.full(len(every), size)])
    kept = np.ones(len(every), dtype=bool)
    for i in range(len(every)):
        kept[i] = False
        kept[i] = not kept.any() or nnls(rows[:, kept], rows[:, i])[1] > COINCIDE * size
    return ~kept
