"""The answer to an impact at many contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..status import Flag, Status
from .inputs import Array
from .solution import Segment, Work

RESTS = 1e-9
"""Part of the largest velocity below which a normal velocity counts as zero in `ManySolution.statuses`."""


@dataclass(frozen=True, slots=True)
class ManyPath:
    """The recorded path of an impact at n contacts.

    Attributes:
        clock: (m,) the clock that all contacts share; only its order means anything.
        velocity: (m, n, 3) contact velocities [m/s].
        impulse: (m, n, 3) impulses so far [N s].
    """

    clock: Array
    velocity: Array
    impulse: Array

    @property
    def normal_impulse(self) -> Array:
        """(m, n) P₃ of each contact, never falling [N s]."""
        return self.impulse[:, :, 2]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ManySolution:
    """What an impact at n contacts came to, in the contact axes (t₁, t₂, n) of each.

    Attributes:
        velocity: (n, 3) post-impact contact velocities [m/s].
        impulse: (n, 3) impulses on the robot [N s].
        work: The `Work` ledger of each contact, arrays (n,) [J].
        segments: Of each contact, its `Segment`s in order, in terms of its own P₃; empty where the policy
            has no path.
        flags: What was special about it.
        iterations: Steps that were taken.
        events: How often contacts changed their modes, or single impacts, or phases.
        simultaneous: The policy.
        law: The restitution law that was used.
        notes: What a reader should know of the answer.
        path: The recorded `ManyPath`, or None.
    """

    velocity: Array
    impulse: Array
    work: Work
    segments: tuple[tuple[Segment, ...], ...]
    flags: Flag
    iterations: int
    events: int
    simultaneous: str
    law: str
    notes: tuple[str, ...] = ()
    path: ManyPath | None = None

    @property
    def compression_impulse(self) -> Array:
        """(n,) normal impulses of compression [N s]; NaN where the policy has no path."""
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
        """How each contact ended."""
        rest = RESTS * float(np.abs(self.velocity).max(initial=0.0))

        def status(velocity: Array, impulse: Array) -> Status:
            if impulse[2] == 0.0:
                return Status.NO_IMPACT
            return Status.SEPARATED if velocity[2] > rest else Status.ENDED_AT_REST

        return tuple(map(status, self.velocity, self.impulse))

    @property
    def status(self) -> Status:
        """How the impact ended: the least of `statuses`, so separated if any contact has."""
        return min(self.statuses, default=Status.NO_IMPACT)

    def __repr__(self) -> str:
        return (
            f"ManySolution({self.simultaneous}: velocity={self.velocity.tolist()}, "
            f"impulse={self.impulse.tolist()}, status={self.status.name}, events={self.events})"
        )


def segments_of(rows: Array, count: int, impulse_scale: float) -> tuple[tuple[Segment, ...], ...]:
    """Return the segments of each contact from rows contact, mode, phase, P₃ at start and end."""
    modes: tuple[Literal["slip", "stick"], ...] = ("slip", "stick")
    phases: tuple[Literal["compression", "restitution"], ...] = ("compression", "restitution")
    found: list[list[Segment]] = [[] for _ in range(count)]
    for contact, mode, phase, start, end in rows.tolist():
        found[int(contact)].append(
            Segment(modes[int(mode)], phases[int(phase)], start * impulse_scale, end * impulse_scale)
        )
    return tuple(map(tuple, found))


def flags_of(segments: tuple[tuple[Segment, ...], ...], energy: float, size: float, singular: bool) -> Flag:
    """Return what was special about an impact.

    Args:
        segments: Of each contact.
        energy: Work of all impulses [J].
        size: The sum of its parts' sizes [J].
        singular: Whether W is.
    """
    flags = Flag.NONE
    for parts in segments:
        if any(part.mode == "stick" for part in parts):
            flags |= Flag.STICK
        phases = [part.phase for part in parts]
        if "restitution" in phases and "compression" in phases[phases.index("restitution") :]:
            flags |= Flag.SECOND_COMPRESSION
    if energy > 1e-12 * size:
        flags |= Flag.ENERGY_CREATED
    if singular:
        flags |= Flag.SINGULAR_DELASSUS
    return flags
