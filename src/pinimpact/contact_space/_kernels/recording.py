"""What the exact method writes down on request: the moves of an impact, and points of its path."""

from __future__ import annotations

from ..._numeric.jit import inner
from .slip_series import SETTLED, point

POINTS = 8


@inner
def note(trace, rows, mode, phase, start, end, normal_work, friction_work):
    """Append a move to the trace, or lengthen the last row if it goes on or there is room for no other."""
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


@inner
def mark(path, rows, p3, v1, v2, v3, p1, p2):
    """Append a point to the path and return the number of rows."""
    if rows < path.shape[0]:
        path[rows, 0] = p3
        path[rows, 1] = v1
        path[rows, 2] = v2
        path[rows, 3] = v3
        path[rows, 4] = p1
        path[rows, 5] = p2
        return rows + 1
    return rows


@inner
def mark_stretch(path, rows, stretch, x, d1, d2, p1, p2, p3):
    """Append the points inside a stretch of turning slip from 0 to x, both excluded; d: its first axis."""
    v3, speed = stretch[9], stretch[10]
    end, count = (min(x, SETTLED), 2 * POINTS) if stretch[0] else (x, POINTS)
    for i in range(1, count):
        normal, along, across, dv3, ratio, t, _, _ = point(stretch, end * i / count)
        radius = speed * ratio / (1.0 + t * t)
        u1, u2 = radius * (1.0 - t * t), radius * 2.0 * t
        rows = mark(
            path,
            rows,
            p3 + normal,
            d1 * u1 - d2 * u2,
            d2 * u1 + d1 * u2,
            v3 + dv3,
            p1 + d1 * along - d2 * across,
            p2 + d2 * along + d1 * across,
        )
    return rows
