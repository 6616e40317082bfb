"""The answer of an impact: its form, what it is flagged with, and the way back from the `View`."""

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
    """What a solver finds; it returns it as a plain tuple, which Python gets in a quarter of the time.

    Attributes:
        status, flags, iterations: Values of `Status` and `Flag`, and the moves or steps taken.
        v1, v2, v3: v⁺ [m/s].
        p1, p2, p3: P [N s].
        compression_impulse: Normal impulse of all compression [N s].
        figure: The number that a failure's message gives.
        trace_rows: Rows of the trace that were filled,
        path_points: and points of the path.
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
    """Return an `Result` as a plain tuple."""
    status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, figure, rows, points = result
    return status, flags, iterations, v1, v2, v3, p1, p2, p3, compressed, figure, rows, points


@inlined
def no_result(status, figure):
    """Return the answer of a problem that has none."""
    nan, no = math.nan, np.int64(0)
    return Result(status, codes.NO_FLAG, no, nan, nan, nan, nan, nan, nan, nan, figure, no, no)


@inlined
def not_begun(begins, figure, flags, v1, v2, v3):
    """Return the values of the answer where `prepare` finds no impact, or a reason why there is no answer."""
    if begins == codes.NO_IMPACT:
        no = np.int64(0)
        return plain(Result(codes.NO_IMPACT, flags, no, v1, v2, v3, 0.0, 0.0, 0.0, 0.0, 0.0, no, no))
    return plain(no_result(begins, figure))


@inlined
def _creates_energy(v1, v2, v3, w1, w2, w3, p1, p2, p3):
    """Whether the kinetic energy gained from v to w, ½ P·(v + w), is beyond its rounding. (1.5)"""
    gained = p1 * (v1 + w1) + p2 * (v2 + w2) + p3 * (v3 + w3)
    size = abs(p1) * (abs(v1) + abs(w1)) + abs(p2) * (abs(v2) + abs(w2)) + abs(p3) * (abs(v3) + abs(w3))
    return gained > 64.0 * EPS * size


@inlined
def turn_back(view, x1, x2):
    """Turn a tangential vector back into the axes before leaning."""
    return view.lean2 * x1 + view.lean1 * x2, view.lean2 * x2 - view.lean1 * x1


@declared(*(View, Problem, int, int, int, THREE, THREE, float), *(FLOAT_ROWS, int, FLOAT_ROWS, int))
@inlined_bitcode
def finish(
    view, problem, status, flags, iterations, velocity, impulse, compressed, trace, rows, path, points
):
    """Close an impact: status and flags, and the way back to the user's axes and units.

    v⁺ (3) and P (3) are given in the `View`; the first `rows` of the trace and `points` of the path are
    turned back too.
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
    """Return the values of the `Result` of an impact that has been followed, or of why there is none.

    The status is SEPARATED or LOCKED, else that of an error, with the figure of its message; the `Ledger`
    is that at the end. Other arguments are as in `finish`.
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
