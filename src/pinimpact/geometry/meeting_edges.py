"""The normal of two convex shapes that several directions separate equally well. (theory.md, 15.3)"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..arrays import Array
from .convex_pair import Gap, ties
from .convex_shape import PlacedShape, coincidence
from .tolerances import CLOSE, LOCAL


def normal_of_meeting(
    a: PlacedShape,
    b: PlacedShape,
    normal: Array,
    approach: Callable[[], Array],
    slow: float,
    depth: float,
    close: float,
) -> tuple[Array, bool]:
    """Return the normal (3,) of contact of two shapes that touch: `normal`, unless edges or corners meet.

    Where parallel edges meet, or a corner meets an edge or a corner, all positive combinations of several
    directions separate the shapes. Of these it is the one closest to the direction of approach, as for edges
    that are rounded with a small radius, in the mean of the points. It does not depend on the order of the
    shapes or of their faces. Shapes that do not approach each other along one of the directions stay apart
    along it: a box that slides from one face onto another, level with it, does not strike its side.

    Args:
        a: The first shape, A.
        b: The second shape, B.
        normal: (3,) one of the separating directions, from B to A.
        approach: Returns the velocities (k, 3) of B relative to A at the points of contact [m/s].
        slow: Speed up to which shapes in contact do not approach each other [m/s].
        depth: Overlap up to which they stay apart along such a direction [m].
        close: Gap or overlap up to which shapes meet [m], if it is larger than `CLOSE`.

    Returns:
        The normal, and whether edges or corners stay apart along it.
    """
    gap = float((a.vertices @ normal).min() - (b.vertices @ normal).max())
    close = max(close, CLOSE * min(a.shape.reach, b.shape.reach))
    if a.shape.radius + b.shape.radius > 0.0 or abs(gap) > close:
        return normal, False
    found = ties(a, b, normal, depth)
    directions, values = np.array([one.normal for one in found]), np.array([one.value for one in found])
    if _one_direction(directions, normal):
        return normal, False
    velocities = approach()
    closing = (velocities @ directions.T).max(axis=0)
    slow = max(slow, ROUNDING * float(np.abs(velocities).max()))
    if closing.min() <= slow:  # they stay apart along this direction
        kept = (velocities @ normal).max() <= slow
        return normal if kept else directions[int(np.argmin(closing))], True
    best = values.max()
    directions = directions[values >= best - max(coincidence(a.shape, b.shape), 2.0 * abs(best))]
    if _one_direction(directions, normal):
        return normal, False
    from scipy.optimize import nnls  # takes a tenth of a second to import, and is rarely needed

    # points of an edge that turns may approach along different directions, and their mean along none
    mean = np.mean([nnls(directions.T, velocity)[0] for velocity in velocities], axis=0) @ directions
    return np.asarray(mean / np.linalg.norm(mean)), False


def _one_direction(directions: Array, normal: Array) -> bool:
    """Return whether all directions (k, 3) are the normal: one face, or two that lie on each other."""
    return bool(np.abs(directions - normal).max() <= LOCAL)


def last_separated(
    a: PlacedShape, b: PlacedShape, normal: Array, depth: float, velocity: Callable[[Array], Array]
) -> Gap:
    """Return the overlap of two cores along the direction along which they were apart last.

    Args:
        a: The first shape, A.
        b: The second shape, B.
        normal: (3,) the direction of the least overlap, from B to A.
        depth: How much larger the overlap along other directions may be [m].
        velocity: Returns the velocity (3,) of A's material relative to B's at a point (3,) [m/s].
    """
    last, found = -math.inf, Gap(0.0, normal)
    for one in ties(a, b, normal, depth):
        tips, against = (b, -one.normal) if one.of_a and one.edges is None else (a, one.normal)
        heights = tips.vertices @ against
        tip = tips.vertices[heights <= heights.min() + LOCAL * tips.shape.reach].mean(axis=0)
        closing = -float(velocity(tip) @ one.normal)
        time = one.value / closing if closing > 0.0 else -math.inf
        if time > last:
            last, found = time, Gap(one.value, one.normal)
    return found
