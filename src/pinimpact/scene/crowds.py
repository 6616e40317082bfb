"""Limits of impacts at many contacts, beyond which they are part of time steps. (theory.md, 16)"""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import IrregularMotionError

CROWD = 16
"""Number of contacts above which an impact whose waves last long is left to time steps, with `scheme="auto"`.
The cost of its events grows steeply with their number."""

FEW = 8
"""Number of contacts up to which adaptive steps integrate an impact: with more they take seconds, and rarely
find a limit e → 0. It applies in time steps, and to impacts without restitution with `scheme="auto"`."""

BRIEF = 10
"""Largest number of steps per contact, between events, of an impact at many contacts during time steps: it
then takes about as long as a time step. Balls in a row need three."""

MOST_IMPACTS = 20
"""Largest number of instants with impacts in a step; contacts that close later do so without restitution."""

ISLANDS = 5
"""Number of islands above which more than `CROWD` touching contacts are left to time steps. The event-driven
scheme solves for the forces of all contacts at once, at a cost cubic in their number; time steps solve each
island alone."""

AT_REST = 40
"""The same number of contacts for bodies that are at rest when the motion starts, such as ten boxes: without
events a single step may cover all of it, which takes as long as some thirty time steps."""

UNLOCATED = f"More than {MOST_IMPACTS} impacts in a time step: further ones are without restitution."
"""Note on the first contact whose restitution is lost because of `MOST_IMPACTS`."""

CROWDED = "An impact at many contacts is part of a time step, by Newton's law; further ones are not noted."
"""Note on the first impact whose waves time steps do not follow."""


class CrowdError(IrregularMotionError):
    """An impact at too many contacts to follow its waves.

    Args:
        sources: Numbers of its contacts and limits.
        e: Their coefficients of restitution.

    Attributes:
        left: Coefficient of restitution of each of its contacts and limits, by number.
    """

    def __init__(self, sources: Sequence[int], e: Sequence[float]) -> None:
        text = f"scene: {len(sources)} contacts take part in an impact that is not resolved"
        super().__init__(text, value=len(sources))
        self.left = dict(zip(sources, e, strict=True))
