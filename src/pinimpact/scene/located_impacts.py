"""Contacts and limits whose impacts time steps locate, by the law of the scene. (theory.md, 16)"""

from __future__ import annotations

import numpy as np

from ..arrays import Bools, Integers
from ._kernels.step_rows import StepResult, StepRows
from .dynamics import SceneDynamics
from .rest import Rest
from .scene import Scene
from .switched_off import limit_restitution, locked_joints


class LocatedImpacts:
    """The contacts and limits of a time step that collide if they close fast.

    All others are stopped by the contact problem of the step, which is Moreau's law.

    Args:
        scene, dynamics, rest: Data of the motion.
        ties: (contacts,) which contacts have an undecided normal in this step; see `FacingShapes`.

    Attributes:
        always: (contacts + limits,) those whose impact law is not that of a step.
        now: (contacts + limits,) those of this step.
    """

    def __init__(self, scene: Scene, dynamics: SceneDynamics, rest: Rest, ties: Bools) -> None:
        work = dynamics.work
        alike = [c.restitution == 0.0 and c.friction == c.sustained_friction for c in dynamics.contacts]
        alike += [limit_restitution(scene) == 0.0] * len(dynamics.limits)
        self.always = ~np.array(alike, dtype=bool) | (len(locked_joints(scene)) > 0)
        self.now = self.always.copy()
        self._ends, self._ties = work.contact_joints, ties
        self._trees = rest.trees_of(work.contact_joints, work.limit_v)

    def restart(self) -> None:
        """Begin a step, with the contacts that have an undecided normal."""
        self.now[:] = self.always
        self.now[: len(self._ties)] |= self._ties

    def join(self, near: Integers, rows: StepRows, found: StepResult) -> bool:
        """Add contacts and limits to those of this step; return whether there are more.

        If an impact is located in the step, these are those that close in it in trees of joints that it hits,
        and all of bodies with an undecided normal.

        Args:
            near: Numbers of the near contacts and limits.
            rows: The rows of the step.
            found: Its result.
        """
        closing = near[found.arrives & (found.gap_end < 0.0)]
        if not closing.size:
            return False
        stopped = near[found.fast & ~found.arrives & (found.impulse[rows.normals] > 0.0)]
        others, hit = np.union1d(closing, stopped), self._trees[closing[self.now[closing]]]
        more = np.zeros(len(self.now), dtype=bool)
        more[others] = np.isin(self._trees[others], hit[hit >= 0]).any(axis=1)
        closing = closing[closing < len(self._ties)]
        undecided = self._ends[closing[self._ties[closing] & ~self.always[closing]]]
        more[: len(self._ties)] |= np.isin(self._ends, undecided[undecided > 0]).any(axis=1)
        more &= ~self.now
        self.now |= more
        return bool(more.any())
