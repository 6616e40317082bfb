"""The result of an impact: status, flags, and conversion from the axes and units of the `View`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOAT_ROWS, THREE, declared
from ..._compile.jit import inlined, inlined_bitcode
from . import codes
from .contact_problem import Problem, View, halves
from .delassus import EPS


class Result(NamedTuple):
    """Result of a solver, which returns it as a plain tuple: numba converts that four times as fast.

    Attributes:
        status, flags, iterations: Values of `Status` and `Flag`, and the number of moves or steps.
        v1, v2, v3: v⁺ [m/s].
        p1, p2, p3: P [N s].
        compression_impulse: Normal impulse of all compression [N s].
        figure: The number for the error message of a failure.
        trace_rows, path_points: Numbers of rows of the trace and of points of the path that were filled.
    """

    status: np.int64
    flags: np.int64
    iterations: np.int64
    v1: float
    v2: float
    v3: float
    p1: float
    p2: float
    p3: float
    compression_impulse: float
    figure: float
    trace_rows: np.int64
    path_points: np.int64


@inlined
def plain(result):
    """Return a `Result` as a plain tuple."""
    status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, figure, rows, points = result
    return status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, figure, rows, points


@inlined
def no_result(status, figure):
    """Return the `Result` of a problem without solution."""
    nan, no = math.nan, np.int64(0)
    return Result(status, codes.NO_FLAG, no, nan, nan, nan, nan, nan, nan, nan, figure, no, no)


@inlined
def not_begun(begins, figure, flags, v1, v2, v3):
    """Return the values of the `Result` if `prepare` finds no impact or no solution; v is that before."""
    if begins == codes.NO_IMPACT:
        no = np.int64(0)
        return plain(Result(codes.NO_IMPACT, flags, no, v1, v2, v3, 0.0, 0.0, 0.0, 0.0, 0.0, no, no))
    return plain(no_result(begins, figure))


@inlined
def _creates_energy(v1, v2, v3, w1, w2, w3, p1, p2, p3):
    """Return whether the kinetic energy gained from v to w, ½ P·(v + w), exceeds its rounding. (1.5)"""
    gained = p1 * (v1 + w1) + p2 * (v2 + w2) + p3 * (v3 + w3)
    size = abs(p1) * (abs(v1) + abs(w1)) + abs(p2) * (abs(v2) + abs(w2)) + abs(p3) * (abs(v3) + abs(w3))
    return gained > 64.0 * EPS * size


@inlined
def turn_back(view, x1, x2):
    """Rotate a tangential vector from the axes of a leaning `View` back to those before."""
    return view.lean2 * x1 + view.lean1 * x2, view.lean2 * x2 - view.lean1 * x1


@declared(*(View, Problem, int, int, int, THREE, THREE, float), *(FLOAT_ROWS, int, FLOAT_ROWS, int))
@inlined_bitcode
def finish(
    view, problem, status, flags, iterations, velocity, impulse, compressed, trace, rows, path, points
):
    """Set the final status and flags, and convert to the caller's axes and units.

    Args:
        view, problem: The `View` and the `Problem`.
        status, flags, iterations: Of the impact so far.
        velocity, impulse, compressed: v⁺ (3), P (3) and the compression impulse, in the `View`.
        trace, rows: The trace, of which the first `rows` are converted in place.
        path, points: Likewise the path.

    Returns:
        The `Result`.
    """
    v1, v2, v3 = velocity
    p1, p2, p3 = impulse
    if v3 <= 0.0:
        v3 = 0.0
        status = codes.LOCKED if flags & codes.LOCKS else codes.ENDED_AT_REST
    if _creates_energy(problem.v1, problem.v2, problem.v3, v1, v2, v3, p1, p2, p3):
        flags |= codes.ENERGY_CREATED
    if view.leaning:
        v1, v2 = turn_back(view, v1, v2)
        p1, p2 = turn_back(view, p1, p2)
    if view.diagonal:
        v1 = v2 = 0.5 * (v1 + v2)
        p1 = p2 = 0.5 * (p1 + p2)

    if view.swapped:
        v1, v2, p1, p2 = v2, v1, p2, p1
    scale_v, scale_p = view.scale_v, view.scale_v - view.scale_w
    sign1, sign2 = view.sign1, view.sign2
    fv1, fv2 = halves(scale_v)
    fp1, fp2 = halves(scale_p)
    # adding zero turns −0 into 0
    v1, v2, v3 = sign1 * v1 * fv1 * fv2 + 0.0, sign2 * v2 * fv1 * fv2 + 0.0, v3 * fv1 * fv2
    p1, p2, p3 = sign1 * p1 * fp1 * fp2 + 0.0, sign2 * p2 * fp1 * fp2 + 0.0, p3 * fp1 * fp2
    compressed = compressed * fp1 * fp2
    if not (abs(v1) + abs(v2) + abs(v3) + abs(p1) + abs(p2) + abs(p3) < math.inf):
        return no_result(codes.OUT_OF_RANGE, 0.0)
    fw1, fw2 = halves(scale_p + scale_v)
    for i in range(rows):
        trace[i, 2] *= fp1
        trace[i, 2] *= fp2
        trace[i, 3] *= fp1
        trace[i, 3] *= fp2
        trace[i, 4] *= fw1
        trace[i, 4] *= fw2
        trace[i, 5] *= fw1
        trace[i, 5] *= fw2
    for i in range(points):
        x1, x2, y1, y2 = path[i, 1], path[i, 2], path[i, 4], path[i, 5]
        if view.leaning:
            x1, x2 = turn_back(view, x1, x2)
            y1, y2 = turn_back(view, y1, y2)
        if view.swapped:
            x1, x2, y1, y2 = x2, x1, y2, y1
        path[i, 0] = math.ldexp(path[i, 0], scale_p)
        path[i, 1] = math.ldexp(sign1 * x1 + 0.0, scale_v)
        path[i, 2] = math.ldexp(sign2 * x2 + 0.0, scale_v)
        path[i, 3] = math.ldexp(path[i, 3], scale_v)
        path[i, 4] = math.ldexp(sign1 * y1 + 0.0, scale_p)
        path[i, 5] = math.ldexp(sign2 * y2 + 0.0, scale_p)
    return Result(status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, 0.0, rows, points)


@inlined
def followed(
    view, problem, status, figure, flags, iterations, velocity, impulse, ledger, trace, rows, path, points
):
    """Return the values of the `Result` of an integrated impact.

    Args:
        status, figure: SEPARATED or LOCKED; else that of a failure, with the number for its message.
        ledger: The `Ledger` at the end.
        view … points: Otherwise as for `finish`.
    """
    if status not in (codes.SEPARATED, codes.LOCKED):
        return plain(no_result(status, math.ldexp(figure, view.scale_v)))
    v1, v2, v3 = velocity
    if problem.counts == codes.VELOCITY and status != codes.LOCKED:
        v3 = ledger.goal
    return plain(
        finish(
            *(view, problem, status, flags, iterations, (v1, v2, v3), impulse, ledger.compressed),
            *(trace, rows, path, points),
        )
    )
