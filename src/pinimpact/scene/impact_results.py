"""What the impacts of a scene come to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..contact_space.many_solution import ManySolution
from ..contact_space.problem import ImpactProblem
from ..robot.robot_impact import Hit
from .records import ImpactGroup


class Impact(NamedTuple):
    """What an impact comes to.

    Attributes:
        v: (nv,) velocity after it.
        resting: The bounce would have been slower than the resting speed, so restitution was left out.
        contact_space: Makes the problem and the impulse in world axes.
        notes: What a reader should know of it.
    """

    v: Array
    resting: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]
    notes: tuple[str, ...] = ()


class Struck(NamedTuple):
    """What has had an impulse in an impact at several contacts and limits at one instant.

    Attributes:
        source: Which contact or limit.
        place: In the problem of all.
        resting: It bounces slower than the resting speed.
        contact_space: Makes its own problem and the impulse in world axes.
    """

    source: int
    place: int
    resting: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]


class GroupImpact(NamedTuple):
    """What an impact at several contacts and limits at one instant comes to.

    Attributes:
        v: (nv,) velocity after it.
        struck: What has had an impulse.
        group: What the records of these share.
        notes: What a reader should know of it.
        bounded: Whether a bound on steps or events was reached.
    """

    v: Array
    struck: tuple[Struck, ...]
    group: ImpactGroup
    notes: tuple[str, ...]
    bounded: bool


class Solved(NamedTuple):
    """The solution of an impact at many contacts, which of them bounce slowly, and the problem."""

    solution: ManySolution
    resting: list[bool]
    group: ImpactGroup


def group_impact(
    v: Array, response: Array, solved: Solved, sources: Sequence[int], axes: Sequence[Array], least: float
) -> GroupImpact:
    """Return what a solution comes to, from v (nv,) before it and the response (nv, 3n), Δq̇ per unit impulse.

    Sources are the contacts and limits, with the contact axes of each; below the part `least` of the largest
    one an impulse is none.
    """
    impulses = solved.solution.impulse
    pressed = impulses[:, 2].tolist()
    group = replace(solved.group, sources=tuple(sources))
    struck = []
    for place, source in enumerate(sources):
        if pressed[place] > least * max(pressed):
            make = partial(_of_group, group, place, impulses[place], axes[place])
            struck.append(Struck(source, place, solved.resting[place], make))
    v_after, found = v + response @ impulses.ravel(), solved.solution
    return GroupImpact(v_after, tuple(struck), group, found.notes, found.story.bounded)


def of_hit(hit: Hit) -> tuple[ImpactProblem, Array]:
    """Return the problem of an impact and its impulse (3,) in world axes."""
    return hit.problem, hit.impulse_world


def of_limit(c: float, rate: float, e: float) -> tuple[ImpactProblem, Array]:
    """Return the same of a joint limit, from its inverse inertia, its rate and the restitution."""
    return ImpactProblem(np.diag([0.0, 0.0, c]), np.array([0.0, 0.0, rate]), 0.0, e), np.zeros(3)


def _of_group(group: ImpactGroup, place: int, impulse: Array, axes: Array) -> tuple[ImpactProblem, Array]:
    return group.part(place), impulse @ axes
