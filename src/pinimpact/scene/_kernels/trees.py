"""Kinematic trees as ranges of velocities."""

from __future__ import annotations

from ..._compile.jit import inlined


@inlined
def end_of_tree(parents, first):
    """Return the velocity after the last one of the tree that begins with the velocity `first`.

    `parents` (nv,) is `velocity_parent` of the workspace; velocities are numbered depth first.
    """
    stop = first + 1
    while stop < len(parents) and parents[stop] >= 0:
        stop += 1
    return stop
