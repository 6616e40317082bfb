"""Times of the frames of a replay: evenly spaced, closer where it slows down, twice at an impact."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .._numeric.tolerances import LITTLE
from ..arrays import Array

FRAMES_PER_SECOND = 60
MAX_FRAMES = 2000
"""Largest number of evenly spaced frames; longer replays have wider spacing, to limit the file."""
SLOWED = 20
"""Impacts with the largest work of compression at which a replay slows down, unless their work is little."""
EXTRA = 30
"""Additional frames on either side of an impact at which the replay slows down."""


def width_of_slowness(duration: float, speed: float, slowdown: float) -> float:
    """Return the time before and after an impact during which the replay is slow [s of the motion].

    The replay is slower by the factor 1 + (slowdown − 1) exp(−x²), x the distance in widths. The width adds
    about one second to the replay on either side.
    """
    return min(speed / max(slowdown - 1.0, 10.0) / (0.5 * math.sqrt(math.pi)), 0.25 * duration)


def slowed(stopped: Sequence[float]) -> list[bool]:
    """Return the impacts at which a replay slows down, from the work of compression of each [J]."""
    least = LITTLE * max(stopped, default=0.0)
    hardest = sorted(range(len(stopped)), key=lambda i: -stopped[i])[:SLOWED]
    return [i in hardest and stopped[i] >= least > 0.0 for i in range(len(stopped))]


def frame_times(
    start: float, end: float, speed: float, impacts: Sequence[float], slow: Sequence[float], width: float
) -> Array:
    """Return the times of the frames, in order; that of an impact occurs twice, before and after it.

    From `start` to `end` of the motion [s], at a speed away from impacts in seconds of motion per second of
    replay. `slow` are the times of the impacts at which it slows down; for the width see `width_of_slowness`.
    """
    count = math.ceil((end - start) * FRAMES_PER_SECOND / speed) + 1
    even = np.linspace(start, end, max(2, min(count, MAX_FRAMES)))
    near = 2.5 * width * np.linspace(-1.0, 1.0, 2 * EXTRA + 1)
    close = [near + time for time in sorted(set(slow))]
    at = np.unique(impacts)
    times = np.unique(np.concatenate([even, *close, at]))
    times = times[(times >= start) & (times <= end)]
    return np.sort(np.concatenate([times, at]))
