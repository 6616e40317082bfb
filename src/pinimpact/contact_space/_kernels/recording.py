"""Optional records of an impact: rows of the trace, and points of the path."""

from __future__ import annotations

from ..._compile.jit import inlined
from .slip_series import SETTLED, point

TRACE_ROWS = 32
"""Rows that suffice for any trace: the mode changes once or twice, the phase at most three times."""

MOVE = 16
"""Number of columns of a trace with a row for each move, for derivatives; see `record_course`."""

POINTS = 64
"""Points of the path on one series of turning slip, enough for a smooth plot; four times as many on a series
around an invariant direction, which spans `SETTLED` e-folds."""


@inlined
def record_move(trace, rows, mode, phase, start, end, normal_work, friction_work):
    """Append a move to the trace of `solve_into`, or extend its last row; return the number of rows."""
    if rows > 0 and trace[rows - 1, 0] == mode and trace[rows - 1, 1] == phase:
        trace[rows - 1, 3] = end
        trace[rows - 1, 4] += normal_work
        trace[rows - 1, 5] += friction_work
        return rows
    if end > start and rows < trace.shape[0]:
        trace[rows, 0], trace[rows, 1] = mode, phase
        trace[rows, 2], trace[rows, 3] = start, end
        trace[rows, 4], trace[rows, 5] = normal_work, friction_work
        return rows + 1
    return rows


@inlined
def record_course(trace, row, mode, phase, start, end, move):
    """Write a move to its row of a trace with MOVE columns, and the state after it to the next row.

    Args:
        trace: (m, MOVE) rows mode, phase, P₃ at start and end, normal work, 0, the event that ends it;
            σ₁, σ₂, speed and p₀ at its start; length, root and rate of the `Move`; P₁, P₂ at its start.
        row: Index of the row, not the last one.
        mode, phase: Mode and phase of the move.
        start, end: `State` before and after it.
        move: The `Move`.

    Returns:
        The index of the next row.
    """
    trace[row, 0], trace[row, 1] = mode, phase
    trace[row, 2], trace[row, 3] = start.p3, end.p3
    trace[row, 4], trace[row, 5], trace[row, 6] = move.work, 0.0, move.event
    trace[row, 11], trace[row, 12], trace[row, 13] = move.length, move.root, move.rate
    record_state(trace, row, start)
    record_state(trace, row + 1, end)
    return row + 1


@inlined
def record_state(trace, row, state):
    """Write a `State` into a row of a trace with MOVE columns."""
    trace[row, 7], trace[row, 8] = state.s1, state.s2
    trace[row, 9], trace[row, 10] = state.speed, state.turn
    trace[row, 14], trace[row, 15] = state.p1, state.p2


@inlined
def record_point(path, points, p3, v1, v2, v3, p1, p2):
    """Append a point to the path of `solve_into`, if it is not full; return the number of points.

    A point with the P₃ of the last one replaces it, unless that is the first point.
    """
    if points > 0 and path[points - 1, 0] == p3:
        if points == 1:
            return points
        points -= 1
    if points < path.shape[0]:
        path[points, 0] = p3
        path[points, 1], path[points, 2], path[points, 3] = v1, v2, v3
        path[points, 4], path[points, 5] = p1, p2
        return points + 1
    return points


@inlined
def record_series(path, points, series, x, d1, d2, p1, p2, p3):
    """Append points of turning slip strictly between 0 and x to the path; return the number of points.

    (d1, d2) is the first axis of the `SlipSeries`, (p1, p2, p3) the impulse at x = 0.
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
