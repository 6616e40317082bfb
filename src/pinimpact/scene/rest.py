"""What is at rest in time steps: it takes no part in them until something moves it. (theory.md, 16)"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ._kernels.workspace import SceneWorkspace
from .forces import StepForces
from .hybrid_state import HybridState
from .islands import tree_roots


class Rest:
    """The trees of joints that are at rest, island by island, and the forces that hold them.

    Attributes:
        tree: (nv,) number of the tree that each velocity belongs to.
        joints: (nj,) which joints are at rest; the world always is.
    """

    def __init__(self, model: pin.Model, work: SceneWorkspace, state: HybridState) -> None:
        self._work, self._state = work, state
        roots = tree_roots(model)
        self._trees = np.searchsorted(np.unique(roots[1:]), roots)  # of each joint; the world's says nothing
        self.tree: Integers = self._trees[work.velocity_joint]
        self.joints = np.arange(model.njoints) == 0
        self._none = np.full(int(self.tree.max()) + 1, -1)
        self.restart()

    def restart(self) -> None:
        """Go on with what rests in the state."""
        if self._state.islands is None:
            self._state.islands = self._none
        self._set_joints()

    def __bool__(self) -> bool:
        return self.forces is not None

    @property
    def forces(self) -> StepForces | None:
        """The forces on what rests."""
        return self._state.resting_forces

    @property
    def _islands(self) -> Integers:
        islands = self._state.islands
        assert islands is not None
        return islands

    def _set_joints(self) -> None:
        self.joints[1:] = self._islands[self._trees[1:]] >= 0

    @property
    def complete(self) -> bool:
        """Whether everything rests."""
        return bool(self.joints.all())

    def begin(self, islands: Integers, forces: StepForces) -> bool:
        """Let trees come to rest; return whether any does that has not rested.

        Args:
            islands: (trees,) island of each one that does, −1 for others.
            forces: Of the step in which they have come to rest, with those on what rested before.
        """
        fresh = (islands >= 0) & (self._islands < 0)
        if not fresh.any():
            return False
        self._state.islands = np.where(fresh, islands, self._islands)
        self._keep(forces.together())
        return True

    def wake(self, joints: Integers) -> None:
        """Let what rests with some joints take part again."""
        islands = self._islands[self._trees[joints[joints > 0]]]
        awake = np.isin(self._islands, islands[islands >= 0])
        self._state.islands = np.where(awake, -1, self._islands)
        if self.forces is not None:
            self._keep(self.forces)

    def wake_all(self) -> None:
        """Let everything take part again."""
        self._state.islands, self._state.resting_forces = self._none, None
        self._set_joints()

    def wake_moving(self, v: Array) -> None:
        """Let what has a velocity (nv,) take part again, with what rests on it."""
        moves = self._work.velocity_joint[v != 0.0]
        if self and self.joints[moves].any():
            self.wake(moves[self.joints[moves]])

    def _keep(self, forces: StepForces) -> None:
        """Set which joints rest, and keep those of some forces that act on them."""
        self._set_joints()
        work = self._work
        on_them = self.joints[work.contact_joints[forces.contacts]].all(axis=1)
        contacts, world, points, normals, joints, _ = forces
        self._state.resting_forces = None
        if self.joints[1:].any():
            joints = np.where(self.joints[work.velocity_joint], joints, 0.0)
            self._state.resting_forces = StepForces(
                contacts[on_them], world[on_them], points[on_them], normals[on_them], joints
            )
