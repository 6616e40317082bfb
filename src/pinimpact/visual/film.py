"""Times of the frames of a replay: even, denser in slow film and fast rotation, twice at each impact."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .._numeric.tolerances import LITTLE
from ..arrays import Array

FRAMES_PER_SECOND = 60
MAX_FRAMES = 2000
"""Maximum number of evenly spaced frames; longer replays have a wider spacing, to limit the file size."""
MAX_TURN = 1.0
"""Maximum rotation of a body between frames [rad]; the player turns it the shorter way, right up to π."""
MAX_TURNING = 10_000
"""Maximum number of additional frames for rotation, to limit the file size."""
SLOWED = 20
"""Maximum number of impacts at which a replay slows down: those with the largest work of compression."""
EXTRA = 30
"""Additional frames on either side of an impact at which the replay slows down."""


def width_of_slowness(duration: float, speed: float, slowdown: float) -> float:
    """Return the time before and after an impact during which the replay is slow [s of the motion].

    The replay is slower by the factor 1 + (slowdown − 1) exp(−x²), where x is the time to the impact divided
    by this width. The width is such that the replay takes about one second longer on either side.
    """
    return min(speed / max(slowdown - 1.0, 10.0) / (0.5 * math.sqrt(math.pi)), 0.25 * duration)


def slowed(absorbed: Sequence[float]) -> list[bool]:
    """Return whether a replay slows down at each impact, from the energy absorbed in compression [J]."""
    least = LITTLE * max(absorbed, default=0.0)
    largest = sorted(range(len(absorbed)), key=lambda i: -absorbed[i])[:SLOWED]
    return [i in largest and absorbed[i] >= least > 0.0 for i in range(len(absorbed))]


def frame_times(
    start: float, end: float, speed: float, impacts: Sequence[float], slow: Sequence[float], width: float
) -> Array:
    """Return the times of the frames in order [s]; the time of an impact occurs twice, for before and after.

    Args:
        start: Start of the motion [s].
        end: End of the motion [s].
        speed: Seconds of motion per second of replay, away from impacts.
        impacts: Times of all impacts [s].
        slow: Times of the impacts at which the replay slows down [s].
        width: Result of `width_of_slowness` [s].
    """
    count = math.ceil((end - start) * FRAMES_PER_SECOND / speed) + 1
    even = np.linspace(start, end, max(2, min(count, MAX_FRAMES)))
    near = 2.5 * width * np.linspace(-1.0, 1.0, 2 * EXTRA + 1)
    close = [near + time for time in sorted(set(slow))]
    at = np.unique(impacts)
    times = np.unique(np.concatenate([even, *close, at]))
    times = times[(times >= start) & (times <= end)]
    return np.sort(np.concatenate([times, at]))


def turning_times(times: Array, moments: Array, speeds: Array) -> tuple[Array, bool]:
    """Return the times of frames, with further ones where a body turns by more than `MAX_TURN` between two.

    Args:
        times: (m,) times of frames in order [s].
        moments: (n,) times of a motion in order [s].
        speeds: (n,) bound of the angular speeds of all bodies at these [rad/s].

    Returns:
        The times, and whether they are too few, because of `MAX_TURNING`.
    """
    turns = np.diff(moments) * np.maximum(speeds[1:], speeds[:-1])
    angles = np.interp(times, moments, np.concatenate([[0.0], np.cumsum(turns)]))
    more = np.maximum(np.ceil(np.diff(angles) / MAX_TURN) - 1.0, 0.0)
    share = MAX_TURNING / max(float(more.sum()), MAX_TURNING)
    parts = 1 + (share * more).astype(int)
    spans = zip(times[:-1], times[1:], parts, strict=True)
    pieces = [np.linspace(a, b, count, endpoint=False) for a, b, count in spans]
    return np.concatenate([*pieces, times[-1:]]), share < 1.0
