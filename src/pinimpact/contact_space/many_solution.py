"""The result of an impact at several contacts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..arrays import Integers
from ..checks import counted, finite_array, in_short, whole_number
from ..display import html_lines, html_table, in_a_line
from ..errors import InputError
from ..status import EFFECTS, Flag, Status
from ._kernels.tolerances import SLOW
from .derivatives import Derivatives
from .inputs import NO_FACTOR, Array
from .solution import CAUSES, Path, Segment, Solution, Work

Segments = tuple[tuple[Segment, ...], ...]

MODES: tuple[Literal["slip", "stick"], ...] = ("slip", "stick")
PHASES: tuple[Literal["compression", "restitution"], ...] = ("compression", "restitution")
"""Names of the codes of modes and phases in the rows of a trace."""

MOST_CORNERS = 6
"""Largest number of contacts for which `ManySolution.range` tries all combinations of extreme stiffnesses."""


@dataclass(frozen=True, slots=True, repr=False)
class ManyPath:
    """The recorded path of an impact at n contacts.

    Attributes:
        clock: (m,) the common internal clock; only its order has a meaning.
        velocity: (m, n, 3) contact velocities [m/s].
        impulse: (m, n, 3) contact impulses [N s].
    """

    clock: Array
    velocity: Array
    impulse: Array

    @property
    def normal_impulse(self) -> Array:
        """(m, n) P₃ of each contact, not decreasing [N s]."""
        return self.impulse[:, :, 2]

    def __repr__(self) -> str:
        count, contacts, _ = self.impulse.shape
        return f"ManyPath({counted(count, 'point')}, {counted(contacts, 'contact')})"


class VelocityRange(NamedTuple):
    """Range of the post-impact contact velocities.

    Attributes:
        low, high: (n, 3) smallest and largest value of each component [m/s].
    """

    low: Array
    high: Array

    def __repr__(self) -> str:
        return f"VelocityRange(low={in_a_line(self.low)}, high={in_a_line(self.high)})"


class ManyStory(NamedTuple):
    """Data for attributes of a `ManySolution` that are computed on first access.

    Attributes:
        segments: Returns the segments.
        works: (n, 3) work of compression, restitution and friction [J].
        surface_velocity: (n, 3) velocities of the surfaces [m/s].
        singular: Whether W is singular.
        bounded: Whether a bound on steps or events was reached.
        resolved: Whether the propagation was resolved; False for a plastic impact instead.
        again: Returns v⁺ (n, 3) with the stiffnesses multiplied by factors (n,).
        jumps: Returns whether v⁺ jumps under small changes of the data.
        parts: The solution of each group of coupled contacts, with their indices, if there are several.
    """

    segments: Callable[[], Segments]
    works: Array
    surface_velocity: Array
    singular: bool
    bounded: bool = False
    resolved: bool = True
    again: Callable[[Array], Array] | None = None
    jumps: Callable[[], bool] | None = None
    parts: tuple[tuple[Integers, ManySolution], ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class ManySolution:
    """The result of an impact at n contacts, in the contact axes (t₁, t₂, n) of each.

    Attributes:
        velocity: (n, 3) post-impact contact velocities [m/s].
        impulse: (n, 3) impulses on the robot [N s].
        iterations: Number of steps.
        events: Number of changes of contact modes, single impacts, or phases.
        simultaneous: The policy.
        law: The restitution law that was used.
        story: Data from which `work`, `segments` and `flags` are computed.
        notes: Sentences about limitations of the result.
        path: The recorded `ManyPath`, or None.
        derivatives: The `Derivatives`, or None where ``derivatives=True`` was not asked for.
    """

    velocity: Array
    impulse: Array
    iterations: int
    events: int
    simultaneous: str
    law: str
    story: ManyStory
    notes: tuple[str, ...] = ()
    path: ManyPath | None = None
    derivatives: Derivatives | None = None

    def with_story(self, **changes: Any) -> ManySolution:
        """Return a copy with other fields of `story`."""
        return replace(self, story=self.story._replace(**changes))

    @cached_property
    def work(self) -> Work:
        """The `Work` of each contact, arrays (n,) [J]."""
        works = self.story.works
        surface = np.sum(self.impulse * self.story.surface_velocity, axis=1)
        return Work(works[:, 0], works[:, 1], works[:, 2], surface)

    @cached_property
    def segments(self) -> Segments:
        """The `Segment`s of each contact in order, over its own P₃; empty if the policy has no path."""
        return self.story.segments()

    @cached_property
    def flags(self) -> Flag:
        """Special events of the impact.

        For `Flag.NEAR_JUMP` the impact is solved again, with data that differ by 10⁻¹² and 10⁻⁶, and with
        e = 10⁻³ and 10⁻⁴ in place of zero.
        """
        works, flags = self.story.works, Flag.NONE
        if not self.story.parts:
            flags = flags_of(self.segments, works.sum(), np.abs(works).sum(), self.story.singular)
        for _, part in self.story.parts:
            flags |= part.flags
        if self.story.bounded:
            return flags | Flag.BOUND_REACHED
        return flags | Flag.NEAR_JUMP if self.story.jumps is not None and self.story.jumps() else flags

    @property
    def compression_impulse(self) -> Array:
        """(n,) normal impulses of compression [N s]; NaN if the policy has no path."""
        return np.array(
            [
                sum(s.end - s.start for s in segments if s.phase == "compression")
                if segments or impulse[2] == 0.0
                else np.nan
                for segments, impulse in zip(self.segments, self.impulse, strict=True)
            ]
        )

    @property
    def statuses(self) -> tuple[Status, ...]:
        """The status of each contact."""
        if self.story.parts:
            found = [Status.NO_IMPACT] * len(self.velocity)
            for at, part in self.story.parts:
                for j, one in zip(at.tolist(), part.statuses, strict=True):
                    found[j] = one
            return tuple(found)
        rest = SLOW * float(np.abs(self.velocity).max(initial=0.0))

        def status(velocity: Array, impulse: Array) -> Status:
            if impulse[2] == 0.0:
                return Status.NO_IMPACT
            return Status.SEPARATED if velocity[2] > rest else Status.ENDED_AT_REST

        return tuple(map(status, self.velocity, self.impulse))

    @property
    def status(self) -> Status:
        """The status of the impact, the smallest of `statuses`: separated if any contact has separated."""
        return min(self.statuses, default=Status.NO_IMPACT)

    def range(self, stiffness: tuple[float, float], draws: int = 64, seed: int = 0) -> VelocityRange:
        """Return how much the result depends on the relative stiffnesses, which are seldom known.

        The impact is solved again with the stiffness of each contact multiplied by a factor: for up to six
        contacts by each combination of the smallest and the largest factor, and by random ones, distributed
        uniformly in their logarithm. The range covers these results; other factors may lead outside.

        Args:
            stiffness: The smallest and the largest factor.
            draws: Number of random combinations.
            seed: Seed of the random numbers.

        Returns:
            The smallest and the largest value of each velocity component, (n, 3) each.

        Raises:
            InputError: The factors are not two positive numbers in ascending order, or the number of draws or
                the seed is none from 0 on.
            PinimpactError: An error of `solve_impact` for one of these problems.
        """
        low, high = factors_of(stiffness)
        draws, seed = whole_number("draws", draws, 0), whole_number("seed", seed, 0)
        assert self.story.again is not None  # set by `solve_impact`
        n = len(self.velocity)
        corners = itertools.product((low, high), repeat=n) if n <= MOST_CORNERS else ()
        random = np.exp(np.random.default_rng(seed).uniform(np.log(low), np.log(high), (draws, n)))
        found = [self.velocity, *(self.story.again(np.array(one)) for one in (*corners, *random))]
        return VelocityRange(np.min(found, axis=0), np.max(found, axis=0))

    def part(self, j: int) -> Solution:
        """Return the result of contact j, with the attributes of the `Solution` of one contact."""
        return PartSolution(self, j)

    def as_html(self, names: Sequence[str]) -> str:
        """Return HTML tables for a notebook, with a name for each contact."""
        axes = ("", "t₁", "t₂", "n")

        def rows(of: Array) -> list[tuple[Any, ...]]:
            return [(name, *row) for name, row in zip(names, of.tolist(), strict=True)]

        causes = (*CAUSES, "total")
        works = np.column_stack([np.broadcast_to(getattr(self.work, c), len(names)) for c in causes])
        works = np.vstack([works, works.sum(axis=0)])
        return (
            html_table(f"Impact at {len(names)} contacts: velocity after [m/s]", axes, rows(self.velocity))
            + html_table("Impulse, in the axes of each [N s]", axes, rows(self.impulse))
            + html_table(
                "Work [J]",
                ("", *causes),
                [(name, *row) for name, row in zip((*names, "all"), works.tolist(), strict=True)],
            )
            + html_lines(
                [
                    f"Policy {self.simultaneous!r}, {self.law} law.",
                    *(f"{name}: {status}" for name, status in zip(names, self.statuses, strict=True)),
                    *self.flags.describe(),
                    *self.notes,
                ]
            )
        )

    def _repr_html_(self) -> str:
        return self.as_html([f"contact {j}" for j in range(len(self.velocity))])

    def __repr__(self) -> str:
        return (
            f"ManySolution({self.simultaneous}: velocity={in_a_line(self.velocity)}, "
            f"impulse={in_a_line(self.impulse)}, status={self.status.name}, events={self.events})"
        )


def factors_of(stiffness: tuple[float, float]) -> tuple[float, float]:
    """Return the least and the largest factor of stiffnesses, or raise `InputError`."""
    given = finite_array("stiffness", stiffness, (2,))
    low, high = given.tolist()
    if not 0.0 < low <= high:
        raise InputError(
            f"stiffness: {in_short(stiffness)} given, the least and the largest factor expected, such as "
            "(0.1, 10)",
            value=stiffness,
        )
    return low, high


Run = Callable[..., ManySolution]
"""run(inputs, record, **options): solves an impact at n contacts by a policy."""


class PartSolution(Solution):
    """The result at one contact of an impact at several contacts; `status` is its own, `flags` those of all.

    P₃ of its path is constant while only other contacts are pressed.
    """

    def __init__(self, whole: ManySolution, j: int) -> None:
        status = whole.statuses[j]
        own = (status, Flag.NONE, whole.iterations, *whole.velocity[j].tolist(), *whole.impulse[j].tolist())
        result = (*own, float(whole.compression_impulse[j]))
        unused = (0.0,) * 11
        super().__init__(result, (*unused, 0, 0.0, NO_FACTOR), method=whole.simultaneous)
        self.part_of = whole
        work = whole.work
        # the cached properties would solve again
        self.__dict__["segments"] = whole.segments[j]
        self.__dict__["work"] = Work(
            *(float(part[j]) for part in (work.compression, work.restitution, work.friction, work.surface))
        )
        if whole.path is not None:
            impulse = whole.path.impulse[:, j]
            self.path = Path(impulse[:, 2].copy(), whole.path.velocity[:, j].copy(), impulse.copy())

    @property
    def flags(self) -> Flag:
        """Special events of the whole impact."""
        return self.part_of.flags

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that occurred, with names of `pinimpact.EFFECTS`."""
        tangential = bool(self.impulse[:2].any())
        modes = {segment.mode for segment in self.segments}
        computed = (
            tangential,
            any(segment.phase == "restitution" for segment in self.segments),
            True,
            tangential,
            "stick" in modes,
            False,
            False,
            Flag.SECOND_COMPRESSION in self.flags,
            self.path is not None,
        )
        return tuple(name for name, present in zip(EFFECTS, computed, strict=True) if present)


def segments_of(rows: Array, count: int) -> Segments:
    """Return the segments of each contact from rows contact, mode, phase, P₃ at start and end."""
    found: list[list[Segment]] = [[] for _ in range(count)]
    for contact, mode, phase, start, end in rows.tolist():
        found[int(contact)].append(Segment(MODES[int(mode)], PHASES[int(phase)], start, end))
    return tuple(map(tuple, found))


def flags_of(segments: Segments, energy: float, size: float, singular: bool) -> Flag:
    """Return the flags of an impact; `energy` is the sum of all work, `size` that of absolute values [J]."""
    flags = Flag.NONE
    for parts in segments:
        if any(part.mode == "stick" for part in parts):
            flags |= Flag.STICK
        phases = [part.phase for part in parts]
        if "restitution" in phases and "compression" in phases[phases.index("restitution") :]:
            flags |= Flag.SECOND_COMPRESSION
    if energy > ROUNDING * size:
        flags |= Flag.ENERGY_CREATED
    if singular:
        flags |= Flag.SINGULAR_DELASSUS
    return flags
