"""Lines as surfaces: edges of convex shapes and axes of capsules in contact with other shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ._kernels.constants import EDGE, FACE_EDGE, LINE
from .surfaces import Surface, Vector


@dataclass(frozen=True, repr=False)
class Line(Surface):
    """A line with a radius as a surface for a point or a sphere; n points away from it."""

    code: ClassVar[int] = LINE
    point: Vector = (0.0, 0.0, 0.0)  # a point of it [m], in the axes of its body, like all vectors
    line: Vector = (1.0, 0.0, 0.0)  # its unit direction
    normal: Vector = (0.0, 0.0, 1.0)  # a unit vector perpendicular to it: the initial n of the contact axes
    radius: float = 0.0  # radius about the line [m]
    body: str | int | None = None  # id of the frame to which it is attached; None for the world
    name: str | None = None

    @property
    def origin(self) -> Vector:
        """The point."""
        return self.point

    def distance(self, point: ArrayLike) -> float:
        """Return the distance of a point from the cylinder about the line, negative inside [m]."""
        return float(np.linalg.norm(np.cross(np.subtract(point, self.point), self.line))) - self.radius


class Edge(Line):
    """A line as a surface for another line: the tip's `axis` is its direction u; u × line points along n."""

    code: ClassVar[int] = EDGE


class FacingEdge(Edge):
    """An edge of a face for one of a face in the same plane: n is the normal of the face."""

    code: ClassVar[int] = FACE_EDGE
