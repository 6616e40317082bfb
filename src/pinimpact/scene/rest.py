"""Islands at rest in time steps: they take no part until something moves them. (theory.md, section 16)"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ._kernels.workspace import SceneWorkspace
from .forces import StepForces
from .hybrid_state import HybridState
from .islands import tree_roots


class Rest:
    """The kinematic trees at rest, island by island, and the forces on them.

    Attributes:
        tree: (nv,) number of the tree of each velocity.
        joints: (nj,) whether each joint is at rest; the world always is.
    """

    def __init__(self, model: pin.Model, work: SceneWorkspace, state: HybridState) -> None:
        self._work, self._state = work, state
        roots = tree_roots(model)
        self._trees = np.searchsorted(np.unique(roots[1:]), roots)  # of each joint; the world's is unused
        self.tree: Integers = self._trees[work.velocity_joint]
        self.joints = np.arange(model.njoints) == 0
        self._none = np.full(int(self.tree.max()) + 1, -1)
        self.restart()

    def restart(self) -> None:
        """Restore the trees at rest from the state."""
        if self._state.islands is None:
            self._state.islands = self._none
        self._set_joints()

    def __bool__(self) -> bool:
        return self.forces is not None

    @property
    def forces(self) -> StepForces | None:
        """The forces on the trees at rest."""
        return self._state.resting_forces

    @property
    def _islands(self) -> Integers:
        islands = self._state.islands
        assert islands is not None
        return islands

    def trees_of(self, joints: Integers, limits: Integers) -> Integers:
        """Return the trees (n + m, 2) of pairs of joints (n, 2), −1 for the world, and of velocities (m,)."""
        pairs = np.where(joints > 0, self._trees[joints], -1)
        return np.concatenate([pairs, np.repeat(self.tree[limits][:, None], 2, axis=1)])

    def _set_joints(self) -> None:
        self.joints[1:] = self._islands[self._trees[1:]] >= 0

    @property
    def complete(self) -> bool:
        """Whether everything is at rest."""
        return bool(self.joints.all())

    def begin(self, islands: Integers, forces: StepForces) -> bool:
        """Set trees at rest; return whether any of them was moving.

        Args:
            islands: (trees,) island of each tree that has come to rest, −1 for others.
            forces: Forces of the step in which they have come to rest, with those on trees already at rest.
        """
        fresh = (islands >= 0) & (self._islands < 0)
        if not fresh.any():
            return False
        self._state.islands = np.where(fresh, islands, self._islands)
        self._set_forces(forces.together())
        return True

    def wake(self, joints: Integers) -> None:
        """Wake the islands to which some joints belong."""
        islands = self._islands[self._trees[joints[joints > 0]]]
        awake = np.isin(self._islands, islands[islands >= 0])
        self._state.islands = np.where(awake, -1, self._islands)
        if self.forces is not None:
            self._set_forces(self.forces)

    def wake_all(self) -> None:
        """Wake everything."""
        self._state.islands, self._state.resting_forces = self._none, None
        self._set_joints()

    def wake_moving(self, v: Array) -> None:
        """Wake the islands that have a nonzero velocity in v (nv,)."""
        moves = self._work.velocity_joint[v != 0.0]
        if self and self.joints[moves].any():
            self.wake(moves[self.joints[moves]])

    def _set_forces(self, forces: StepForces) -> None:
        """Set the joints at rest, and store the forces that act on them."""
        self._set_joints()
        work = self._work
        on_them = self.joints[work.contact_joints[forces.contacts]].all(axis=1)
        moving = ~self.joints[work.velocity_joint]
        self._state.resting_forces = None
        if self.joints[1:].any():
            parts = (part[on_them] for part in forces.of_contacts())
            self._state.resting_forces = forces.replaced(parts, np.where(moving, 0.0, forces.joints))
