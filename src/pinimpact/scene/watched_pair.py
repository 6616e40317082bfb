"""A pair of convex shapes in an event-driven run, and its points in contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array, Bools
from ..geometry.convex_pair import Touch
from ..geometry.convex_shape import coincidence
from ..robot.shape_pair import PointContact, ShapePair
from .hybrid_state import HybridState, Touching
from .level_faces import points_between

NOTHING = Touching({}, {})
"""The contact of shapes that do not touch."""


@dataclass(frozen=True, eq=False)
class Watched:
    """A pair of convex shapes in a run.

    Attributes:
        number: Number of the pair.
        pair: The shapes A and B.
        places: Numbers of the contacts reserved for its points.
        supports: (2, nv) whether each velocity moves A, and whether it moves B.
        state: The state of the motion.
    """

    number: int
    pair: ShapePair
    places: list[int]
    supports: Bools
    state: HybridState

    @property
    def label(self) -> str:
        """The name of its contact."""
        return self.pair.contact.label

    @property
    def now(self) -> Touching:
        """The present contact of the pair."""
        return self.state.touching.get(self.number, NOTHING)

    @property
    def size(self) -> float:
        """Size of the smaller shape [m]."""
        return min(self.pair.a.shape.reach, self.pair.b.shape.reach)

    @property
    def coincidence(self) -> float:
        """Distance below which points of the shapes coincide [m]."""
        return coincidence(self.pair.a.shape, self.pair.b.shape)

    @property
    def points(self) -> dict[int, PointContact]:
        """The points in contact, by number of the contact."""
        return self.now.points

    @property
    def acting(self) -> dict[int, PointContact]:
        """Those of them that are contacts: all but the points between others."""
        now = self.now
        return {i: point for i, point in now.points.items() if i not in now.between}

    @property
    def normals(self) -> dict[int, Array]:
        """The normal (3,) of each point, from B to A, by number of the contact."""
        return self.now.normals

    def update(self, **changes: Any) -> None:
        """Replace fields of the present contact in the state of the motion."""
        others = {number: one for number, one in self.state.touching.items() if number != self.number}
        now = self.now._replace(**changes)
        self.state.touching = others | {self.number: now} if now.points else others


class Located(NamedTuple):
    """A point of contact in one configuration, with the number of its contact, or −1."""

    watched: Watched
    number: int
    touch: Touch
    normal: Array


def between_others(group: list[Watched], every: list[Located]) -> list[Located]:
    """Return the points of pairs with common faces that lie between others."""
    if len(group) < 2:
        return []
    first = group[0].pair.a.joint
    normals = [one.normal if one.watched.pair.a.joint == first else -one.normal for one in every]
    points = np.array([one.touch.point for one in every])
    lies = points_between(np.array(normals), points, np.zeros(len(every)))
    return [one for one, between in zip(every, lies.tolist(), strict=True) if between]
