"""Trees of joints, and the islands into which contacts connect them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Integers


def tree_roots(model: pin.Model) -> Integers:
    """Return the first joint (njoints,) of the tree of each joint; 0 of the world."""
    roots = np.arange(model.njoints)
    for joint, parent in enumerate(model.parents):
        if parent > 0:
            roots[joint] = roots[parent]
    return roots


def islands(roots: Integers, ends: Integers) -> Integers:
    """Return numbers (njoints,) of the islands into which contacts connect trees; the world connects none.

    For roots see `tree_roots`; ends (k, 2) are those of what each contact is between.
    """
    island = np.arange(len(roots))
    for a, b in ends[(ends > 0).all(axis=1)].tolist():
        island[island == island[a]] = island[b]
    return island
