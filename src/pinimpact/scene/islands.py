"""Kinematic trees, and the islands that contacts form of them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers


def tree_roots(model: pin.Model) -> Integers:
    """Return the root joint (njoints,) of the tree of each joint; 0 for the world."""
    roots = np.arange(model.njoints)
    for joint, parent in enumerate(model.parents):
        if parent > 0:
            roots[joint] = roots[parent]
    return roots


def tree_masses(model: pin.Model) -> Array:
    """Return the mass (njoints,) of the tree of each joint [kg]; infinite for the world and without mass."""
    roots, total = tree_roots(model), np.zeros(model.njoints)
    for joint in range(1, model.njoints):
        total[roots[joint]] += model.inertias[joint].mass
    total[total == 0.0] = np.inf
    return np.asarray(total[roots])


def islands(roots: Integers, ends: Integers) -> Integers:
    """Return the island (njoints,) of each joint; contacts with the world connect nothing.

    Args:
        roots: (njoints,) see `tree_roots`.
        ends: (k, 2) the two joints of each contact, 0 for the world.
    """
    island = roots.copy()
    for a, b in ends[(ends > 0).all(axis=1)].tolist():
        island[island == island[a]] = island[b]
    return island
