"""Impacts at contacts of which some are not coupled: each group is an impact of its own. (theory.md, 14.1)"""

from __future__ import annotations

from functools import partial, wraps
from typing import Any

import numpy as np

from .inputs import Array
from .many_inputs import ManyInputs, coupled_groups, solution_of
from .many_solution import ManyPath, ManySolution, Run, Segments


def by_groups(run: Run) -> Run:
    """Return a policy that solves each group of coupled contacts with its own scales."""

    @wraps(run)
    def run_each(inputs: ManyInputs, record: bool, **options: Any) -> ManySolution:
        if len(coupled_groups(inputs.delassus)) < 2:
            return run(inputs, record, **options)
        parts = tuple((at, run(one, record, **options)) for at, one in inputs.groups())
        return _joined(inputs, parts, record)

    return run_each


def _joined(inputs: ManyInputs, parts: tuple[tuple[Any, ManySolution], ...], record: bool) -> ManySolution:
    """Return the solution that consists of those of all groups."""
    n = len(inputs.velocity)
    velocity, impulse, works = np.empty((3, n, 3))
    for at, part in parts:
        velocity[at] = part.velocity if part.impulse.any() else inputs.velocity[at]
        impulse[at], works[at] = part.impulse, part.story.works
    found = [part for _, part in parts]
    whole = solution_of(
        inputs,
        (found[0].simultaneous, found[0].law),
        *(velocity, impulse, works),
        (sum(part.iterations for part in found), sum(part.events for part in found)),
        partial(_segments, parts, n),
        tuple(dict.fromkeys(note for part in found for note in part.notes)),
        _joined_path(parts, n) if record else None,
        any(part.story.bounded for part in found),
    )
    resolved = all(part.story.resolved for part in found)
    return whole.with_story(resolved=resolved, parts=parts)


def _segments(parts: tuple[tuple[Any, ManySolution], ...], n: int) -> Segments:
    """Return the segments of each of n contacts."""
    found: dict[int, Any] = {}
    for at, part in parts:
        found.update(zip(at.tolist(), part.segments, strict=True))
    return tuple(found[j] for j in range(n))


def _joined_path(parts: tuple[tuple[Any, ManySolution], ...], n: int) -> ManyPath | None:
    """Return the paths of all groups on one clock, each from 0 to 1; None if the policy has no path."""
    paths = [(at, part.path) for at, part in parts]
    clocks: list[Array] = []
    for _, path in paths:
        if path is None:
            return None
        elapsed = path.clock - path.clock[0]
        clocks.append(elapsed / (elapsed[-1] or 1.0))
    clock = np.unique(np.concatenate(clocks))
    velocity, impulse = np.empty((2, len(clock), n, 3))
    for (at, path), own in zip(paths, clocks, strict=True):
        assert path is not None
        for k, j in enumerate(at.tolist()):
            for i in range(3):
                velocity[:, j, i] = np.interp(clock, own, path.velocity[:, k, i])
                impulse[:, j, i] = np.interp(clock, own, path.impulse[:, k, i])
    return ManyPath(clock, velocity, impulse)
