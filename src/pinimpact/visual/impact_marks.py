"""Data of an impact for a replay: the impulse and the path of the velocity of each contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..arrays import Array
from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Solution
from .smooth_path import invariant_directions, smooth_path

EVERY = 3
"""Stride: a page contains every third point of a smooth path."""


class OneImpact(Protocol):
    """The common interface of `Hit` and `ImpactRecord`."""

    @property
    def problem(self) -> ImpactProblem:
        """The problem."""

    @property
    def solution(self) -> Solution:
        """Its solution."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactMark:
    """One contact of an impact, in contact axes unless stated otherwise."""

    name: str
    point: Array  # (3,) contact point, in world axes [m]
    axes: Array  # (3, 3) t₁, t₂, n as rows, in world axes
    friction: float  # μ
    delassus: Array | None  # (3, 3) W, or None for several contacts, which are coupled
    velocity: Array  # (m, 3) contact velocity along the impact [m/s]
    impulse: Array  # (m, 3) accumulated impulse at the same points [N s]
    segments: Sequence[tuple[str, str, float, float]]  # mode, phase, and P₃ at start and end of each
    clock: Array | None = None  # (m,) progress of the impact, 0 to 1; None: P₃ relative to its final value

    def as_data(self) -> dict[str, Any]:
        """Return the data for JSON."""
        p3, clock = self.impulse[:, 2], self.clock
        if clock is None:
            clock = p3 / p3[-1] if p3[-1] > 0.0 else np.linspace(0.0, 1.0, len(p3))
        delassus, invariant = np.zeros((3, 3)), np.empty(0)
        if self.delassus is not None:
            delassus = self.delassus
            invariant = invariant_directions(ImpactProblem(delassus, self.velocity[0], self.friction, 0.0))
        return {
            "name": self.name,
            "point": short(self.point),
            "axes": short(self.axes.ravel()),
            "mu": self.friction,
            "delassus": short(delassus.ravel()),
            "invariant": short(invariant),
            "clock": short(clock),
            "velocity": [short(row) for row in self.velocity],
            "impulse": [short(row) for row in self.impulse],
            "segments": [list(segment) for segment in self.segments],
        }


@dataclass(frozen=True, slots=True, eq=False)
class ImpactMark:
    """An impact of a replay."""

    time: float  # time [s]
    source: str  # name of the contact, or of the joint limit
    law: str  # restitution law
    restitution: float | None  # coefficient e, or None if contacts differ
    friction: float | None  # coefficient μ, or None if contacts differ
    lost: float  # loss of kinetic energy [J], < 0 if a moving surface adds energy
    contacts: Sequence[ContactMark]  # the contacts that take part, none for a joint limit
    slow: bool  # whether the replay slows down for it

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
        """Return the data for JSON."""
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
    """Return the data of one contact, with the whole path if `along`, else its ends."""
    clock, whole = None, solution.part_of
    if along and (whole is None or solution.path is not None):
        path = smooth_path(problem, solution)
        every = EVERY if whole is None else 1
        shown = np.unique(np.append(np.arange(0, len(path.velocity), every), len(path.velocity) - 1))
        velocity, impulse = path.velocity[shown], path.impulse[shown]
        if whole is not None:  # all contacts share the progress of the impact
            clock = whole.path.clock - whole.path.clock[0]
            clock = clock / clock[-1] if clock[-1] > 0.0 else np.linspace(0.0, 1.0, len(clock))
    else:
        velocity = np.array([problem.velocity, solution.velocity], dtype=float)
        impulse = np.array([np.zeros(3), solution.impulse])
    segments = [(s.mode, s.phase, s.start, s.end) for s in solution.segments] if along else []
    delassus = None if whole is not None else np.asarray(problem.delassus, dtype=float)
    mu = float(problem.friction)
    return ContactMark(name, point, axes, mu, delassus, velocity, impulse, segments, clock)


def impact_mark(
    parts: Sequence[tuple[str, OneImpact, tuple[Array, Array] | None]],
    source: str,
    time: float = 0.0,
    slow: bool = True,
) -> ImpactMark:
    """Return the data of an impact for a replay, with the whole path if it is `slow`.

    Args:
        parts: For each contact its name, its impact, and point (3,) and axes (3, 3), or None if not drawn.
        source: Name of the contact or joint limit, or of all contacts.
        time: Time of the impact [s].
        slow: Whether the replay slows down for it.
    """
    impacts = [impact for _, impact, _ in parts]
    problems = [impact.problem for impact in impacts]
    marks = [
        contact_mark(name, *place, impact.problem, impact.solution, slow)
        for name, impact, place in parts
        if place is not None
    ]
    return ImpactMark(
        time,
        source,
        problems[0].law if len(parts) == 1 else impacts[0].solution.part_of.law,
        _same([problem.restitution for problem in problems]),
        _same([problem.friction for problem in problems]),
        -sum(float(impact.solution.work.total) for impact in impacts),
        marks,
        slow,
    )


def _same(values: Any) -> float | None:
    found = np.unique(np.asarray(values, dtype=float))
    return float(found[0]) if len(found) == 1 else None


def short(values: Array) -> list[float]:
    """Return numbers rounded to seven digits, which is enough for display."""
    return [float(f"{value:.7g}") for value in np.asarray(values, dtype=float)]
