"""What a replay shows of an impact: at each contact that takes part the impulse and how the velocity goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Solution
from .smooth_path import invariant_directions, smooth_path

Array = NDArray[np.float64]

EVERY = 3
"""Of so many points of a smooth path a page has one."""


class OneImpact(Protocol):
    """What a `Hit` and an `ImpactRecord` have in common."""

    @property
    def problem(self) -> ImpactProblem:
        """What was solved."""

    @property
    def solution(self) -> Solution:
        """Its answer."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactMark:
    """One contact's part in an impact, in contact axes where nothing else is said.

    Attributes:
        name: Of the contact.
        point: (3,) where it is, in world axes [m].
        axes: (3, 3) t₁, t₂, n as rows, in world axes.
        friction: μ.
        delassus: (3, 3) its own block.
        velocity: (m, 3) along the impact, before it first and after it last [m/s].
        impulse: (m, 3) so far [N s].
        segments: Mode, phase, and P₃ at start and end of each.
    """

    name: str
    point: Array
    axes: Array
    friction: float
    delassus: Array
    velocity: Array
    impulse: Array
    segments: Sequence[tuple[str, str, float, float]]

    def as_data(self) -> dict[str, Any]:
        """Return it as JSON has it; `clock` is how much of the impact is over at each point, 0 to 1."""
        p3 = self.impulse[:, 2]
        clock = p3 / p3[-1] if p3[-1] > 0.0 else np.linspace(0.0, 1.0, len(p3))
        problem = ImpactProblem(self.delassus, self.velocity[0], self.friction, 0.0)
        return {
            "name": self.name,
            "point": short(self.point),
            "axes": short(self.axes.ravel()),
            "mu": self.friction,
            "delassus": short(self.delassus.ravel()),
            "invariant": short(invariant_directions(problem)),
            "clock": short(clock),
            "velocity": [short(row) for row in self.velocity],
            "impulse": [short(row) for row in self.impulse],
            "segments": [list(segment) for segment in self.segments],
        }


@dataclass(frozen=True, slots=True, eq=False)
class ImpactMark:
    """An impact of a replay.

    Attributes:
        time: When [s].
        source: Name of the contact, or of the joint limit.
        law, restitution, friction: What it was solved with.
        lost: Kinetic energy that it took [J], < 0 where a moving surface gave some.
        contacts: The contacts that take part, none for a joint limit.
        slow: Whether the replay slows down for it.
    """

    time: float
    source: str
    law: str
    restitution: float
    friction: float
    lost: float
    contacts: Sequence[ContactMark]
    slow: bool

    @property
    def strength(self) -> float:
        """The largest impulse of its contacts [N s]."""
        return max((float(np.linalg.norm(mark.impulse[-1])) for mark in self.contacts), default=0.0)

    @property
    def speed(self) -> float:
        """The largest velocity of its contacts, before or after [m/s]."""
        ends = [np.linalg.norm(mark.velocity[[0, -1]], axis=1).max() for mark in self.contacts]
        return float(max(ends, default=0.0))

    def as_data(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "time": self.time,
            "source": self.source,
            "law": self.law,
            "e": self.restitution,
            "mu": self.friction,
            "lost": self.lost,
            "slow": self.slow,
            "contacts": [mark.as_data() for mark in self.contacts],
        }


def contact_mark(
    name: str, point: Array, axes: Array, problem: ImpactProblem, solution: Solution, along: bool
) -> ContactMark:
    """Return the mark of one contact; `along` wants the way between before and after too."""
    if along:
        path = smooth_path(problem, solution)
        kept = np.unique(np.append(np.arange(0, len(path.velocity), EVERY), len(path.velocity) - 1))
        velocity, impulse = path.velocity[kept], path.impulse[kept]
        segments = [(s.mode, s.phase, s.start, s.end) for s in solution.segments]
    else:
        velocity = np.array([problem.velocity, solution.velocity], dtype=float)
        impulse = np.array([np.zeros(3), solution.impulse])
        segments = []
    delassus = np.asarray(problem.delassus, dtype=float)
    return ContactMark(name, point, axes, float(problem.friction), delassus, velocity, impulse, segments)


def impact_mark(
    impact: OneImpact,
    source: str,
    places: Mapping[str, tuple[Array, Array]],
    time: float = 0.0,
    slow: bool = True,
) -> ImpactMark:
    """Return what a replay shows of an impact.

    Args:
        impact: A `Hit` or an `ImpactRecord`.
        source: Name of the contact or joint limit.
        places: Point (3,) and axes (3, 3) of each contact that takes part, by name.
        time: When [s].
        slow: Whether the replay slows down for it; then it has the whole path.
    """
    problem, solution = impact.problem, impact.solution
    marks = [contact_mark(name, *place, problem, solution, slow) for name, place in places.items()]
    return ImpactMark(
        time,
        source,
        str(problem.law),
        float(problem.restitution),
        float(problem.friction),
        -float(solution.work.total),
        marks,
        slow,
    )


def short(values: Array) -> list[float]:
    """Return numbers with as many digits as a picture needs."""
    return [float(f"{value:.7g}") for value in np.asarray(values, dtype=float)]
