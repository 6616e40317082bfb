"""The normal where edges or corners of two convex shapes meet, which have many normals. (theory.md, 15)"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..arrays import Array
from .convex_pair import ties
from .convex_shape import PlacedShape
from .tolerances import CLOSE, LOCAL


def normal_of_meeting(a: PlacedShape, b: PlacedShape, normal: Array, approach: Callable[[], Array]) -> Array:
    """Return the normal (3,) of contact of two shapes that touch: `normal`, unless edges or corners meet.

    Where parallel edges meet, or a corner meets an edge or a corner, all positive combinations of several
    directions separate the shapes. Of these it is the one closest to the direction of approach, as for edges
    that are rounded with a small radius. It does not depend on the order of the shapes or of their faces.
    Shapes that do not approach each other along one of the directions stay apart along it: a box that slides
    from one face onto another, level with it, does not strike its side.

    Args:
        a: The first shape, A.
        b: The second shape, B.
        normal: (3,) one of the separating directions, from B to A.
        approach: Returns the velocity (3,) of B relative to A at the point of contact [m/s].
    """
    gap = float((a.vertices @ normal).min() - (b.vertices @ normal).max())
    if a.shape.radius + b.shape.radius > 0.0 or abs(gap) > CLOSE * min(a.shape.reach, b.shape.reach):
        return normal
    directions = np.array([one.normal for one in ties(a, b, normal)])
    if np.abs(directions - normal).max() <= LOCAL:  # one face, or two that lie on each other
        return normal
    velocity = approach()
    closing, rounding = directions @ velocity, ROUNDING * float(np.linalg.norm(velocity))
    if closing.min() <= rounding:  # they stay apart along this direction
        return normal if normal @ velocity <= rounding else directions[int(np.argmin(closing))]
    from scipy.optimize import nnls  # takes a tenth of a second to import, and is rarely needed

    weights, _ = nnls(directions.T, velocity)
    found = weights @ directions
    return np.asarray(found / np.linalg.norm(found))
