"""Limits beyond which impacts and motion at many contacts are left to time steps. (theory.md, 16)"""

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

AS_CHEAP = 10.0
"""Number of active contacts with which an event-driven step takes as long as a time step. The cost of
`cost_of_step` is right within a factor of four in stacks, walls and rows of boxes with 16 to 84 contacts."""

MANY = 40
"""Number of active contacts above which the motion is left to time steps, with `scheme="auto"`: an
event-driven step then takes as long as 64 of them. Ten separate boxes at rest have 40, and one event-driven
step covers all of their rest. It does not hold for one robot, such as a can with 96 points on its rim: its
impacts are few, and time steps of first order."""

UNLOCATED = f"More than {MOST_IMPACTS} impacts in a time step: further ones are without restitution."
"""Note on the first contact whose restitution is lost because of `MOST_IMPACTS`."""

CROWDED = "An impact at many contacts is part of a time step, by Newton's law; further ones are not noted."
"""Note on the first impact whose waves time steps do not follow."""


def cost_of_step(active: int) -> float:
    """Return the cost of an event-driven step with a number of active contacts, in time steps.

    It solves for the forces of all contacts at once, and its cost is cubic in their number.
    """
    return float((active / AS_CHEAP) ** 3)


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
