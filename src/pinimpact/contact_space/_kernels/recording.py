"""What is written down on request: rows of the trace, and points of the path."""

from __future__ import annotations

from ..._compile.jit import inlined
from .slip_series import SETTLED, point

TRACE_ROWS = 32
"""Rows of a trace that hold every impact: its mode changes once or twice, its phase at most three times."""

POINTS = 64
"""Points recorded on one series of turning slip, so that straight lines between them look smooth; four times
as many on one around an invariant direction, which spans `SETTLED` e-folds."""


@inlined
def record_move(trace, rows, mode, phase, start, end, normal_work, friction_work):
    """Append a move to the trace, or lengthen the last row if it goes on or there is room for no other.

    Args:
        trace: (m, 6) rows mode, phase, P₃ at start and end, normal work, friction work; m = 0: not wanted.
        rows: How many there are.
    """
    full = rows == trace.shape[0]
    if rows > 0 and (full or (trace[rows - 1, 0] == mode and trace[rows - 1, 1] == phase)):
        trace[rows - 1, 3] = end
        trace[rows - 1, 4] += normal_work
        trace[rows - 1, 5] += friction_work
        return rows
    if end > start and not full:
        trace[rows, 0] = mode
        trace[rows, 1] = phase
        trace[rows, 2] = start
        trace[rows, 3] = end
        trace[rows, 4] = normal_work
        trace[rows, 5] = friction_work
        return rows + 1
    return rows


@inlined
def record_point(path, points, p3, v1, v2, v3, p1, p2):
    """Append a point to the path, (m, 6) rows P₃, v₁, v₂, v₃, P₁, P₂, if there is room; m = 0: not wanted.

    A point with the P₃ of the last one takes its place, but the first point stays.
    """
    if points > 0 and points <= path.shape[0] and path[points - 1, 0] == p3:
        if points == 1:
            return points
        points -= 1
    if points < path.shape[0]:
        path[points, 0] = p3
        path[points, 1] = v1
        path[points, 2] = v2
        path[points, 3] = v3
        path[points, 4] = p1
        path[points, 5] = p2
        return points + 1
    return points


@inlined
def record_series(path, points, series, x, d1, d2, p1, p2, p3):
    """Append the points of turning slip between 0 and x, both excluded.

    Args:
        series: The `SlipSeries`.
        d1, d2: Its first axis.
        p1, p2, p3: Impulse at its start.
    """
    end, count = (min(x, SETTLED), 4 * POINTS) if series.around_invariant else (x, POINTS)
    for i in range(1, count):
        normal, along, across, dv3, ratio, t, _, _ = point(series, end * i / count)
        radius = series.speed * ratio / (1.0 + t * t)
        u1, u2 = radius * (1.0 - t * t), radius * 2.0 * t
        points = record_point(
            path,
            points,
            p3 + normal,
            d1 * u1 - d2 * u2,
            d2 * u1 + d1 * u2,
            series.v3 + dv3,
            p1 + d1 * along - d2 * across,
            p2 + d2 * along + d1 * across,
        )
    return points
