"""Results of the impacts of a scene."""

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
    """Result of an impact at one contact or limit.

    Attributes:
        v: (nv,) velocity after the impact.
        resting: Whether restitution was set to zero, since the bounce would be slower than the resting speed.
        contact_space: Returns the impact problem and the impulse (3,) in world axes.
        notes: Notes for the trajectory.
    """

    v: Array
    resting: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]
    notes: tuple[str, ...] = ()


class Struck(NamedTuple):
    """A contact or limit with an impulse in an impact at several contacts.

    Attributes:
        source: Number of the contact or limit.
        place: Its index in the problem of all.
        resting: Whether it bounces slower than the resting speed.
        contact_space: Returns its own problem and the impulse (3,) in world axes.
    """

    source: int
    place: int
    resting: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]


class GroupImpact(NamedTuple):
    """Result of an impact at several contacts and limits.

    Attributes:
        v: (nv,) velocity after the impact.
        struck: The contacts and limits with an impulse.
        group: The data that their records share.
        notes: Notes for the trajectory.
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
    """Return the result of an impact at several contacts from its solution.

    Args:
        v: (nv,) velocity before the impact.
        response: (nv, 3n) Δq̇ per unit impulse.
        solved: The solution.
        sources: Numbers of the contacts and limits.
        axes: Contact axes (3, 3) of each.
        least: Normal impulses up to this fraction of the largest one are taken as zero.
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
    """Return the problem of an impact at a joint limit, and zero for its impulse in world axes.

    Args:
        c: Inverse inertia of the joint.
        rate: Gap rate before the impact.
        e: Coefficient of restitution.
    """
    return ImpactProblem(np.diag([0.0, 0.0, c]), np.array([0.0, 0.0, rate]), 0.0, e), np.zeros(3)


def _of_group(group: ImpactGroup, place: int, impulse: Array, axes: Array) -> tuple[ImpactProblem, Array]:
    return group.problem.part(place), impulse @ axes
