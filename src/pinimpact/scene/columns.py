"""Tables of impacts and modes as arrays of equal length, by the names of their columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Bools
from ..contact_space.solution import CAUSES
from ..tables import AXES, by_component
from .records import ImpactRecord, ModeInterval


def impact_columns(rows: Sequence[ImpactRecord], velocities: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Return the columns of impacts of a robot whose velocities have these names."""

    def stack(values: Sequence[Any], *shape: int) -> Array:
        return np.array(values, dtype=float).reshape(len(rows), *shape)

    works = [i.solution.work for i in rows]
    found: dict[str, NDArray[Any]] = {
        "time": stack([i.time for i in rows]),
        "source": np.array([i.source for i in rows], dtype=object),
        "approach": stack([-np.asarray(i.problem.velocity)[2] for i in rows]),
    }
    found |= by_component("impulse", AXES, stack([i.solution.impulse for i in rows], 3))
    for cause in (*CAUSES, "total"):
        found[f"work.{cause}"] = stack([getattr(work, cause) for work in works])
    for name in ("friction", "restitution"):
        found[name] = stack([getattr(i.problem, name) for i in rows])
    for name in ("v_before", "v_after"):
        found |= by_component(name, velocities, stack([getattr(i, name) for i in rows], len(velocities)))
    return found


def mode_columns(rows: Sequence[ModeInterval]) -> dict[str, NDArray[Any]]:
    """Return the columns of modes."""
    kinds = {"source": object, "mode": object, "start": float, "end": float}
    return {name: np.array([getattr(m, name) for m in rows], dtype=kind) for name, kind in kinds.items()}


def modes_at(modes: Sequence[ModeInterval], source: str, t: Array, before: Bools) -> NDArray[Any]:
    """Return the mode (m,) of a contact at times t (m,), some of them `before` a jump at that time."""
    found = np.full(len(t), "free", dtype=object)
    for interval in modes:
        if interval.source == source:
            start, end = interval.start, interval.end
            inside = np.where(before, (start < t) & (t <= end), (start <= t) & (t < end))
            inside[-1] |= end == t[-1]
            found[inside] = interval.mode
    return found
