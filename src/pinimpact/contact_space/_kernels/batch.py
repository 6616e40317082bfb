"""Batch of problems at one contact; invalid rows do not affect others."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGER_ROWS, declared
from ..._compile.jit import inlined, released
from .codes import INDEFINITE_DELASSUS, LOCKED
from .delassus import ZERO
from .ending import Result, no_result
from .path import SCRATCH, solve_into
from .recording import TRACE_ROWS


@inlined
def asymmetry(w):
    """Return whether W (3, 3) is asymmetric beyond rounding."""
    largest = max(
        max(abs(w[0, 0]), abs(w[1, 1]), abs(w[2, 2])), max(abs(w[0, 1]), abs(w[0, 2]), abs(w[1, 2]))
    )
    most = max(abs(w[0, 1] - w[1, 0]), abs(w[0, 2] - w[2, 0]), abs(w[1, 2] - w[2, 1]))
    return most > ZERO * largest


@inlined
def write_result(i, result, numbers, codes):
    """Write row i: v⁺, P and the compression impulse (7); status, flags and iterations (3)."""
    codes[i, 0], codes[i, 1], codes[i, 2] = result.status, result.flags, result.iterations
    numbers[i, 0], numbers[i, 1], numbers[i, 2] = result.v1, result.v2, result.v3
    numbers[i, 3], numbers[i, 4], numbers[i, 5] = result.p1, result.p2, result.p3
    numbers[i, 6] = result.compression_impulse


@declared(
    *(FLOAT_STACK, FLOAT_ROWS, FLOATS, FLOATS, int, FLOATS, FLOAT_ROWS),
    *(FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS),
)
@released
def solve_rows(
    delassus, velocity, friction, restitution, law, velocity_scale, factors, numbers, codes, works
):
    """Solve N problems.

    Args:
        delassus, velocity, friction, restitution: (N, 3, 3) W [1/kg], (N, 3) v [m/s], (N,) μ, (N,) e.
        law: Code of the law.
        velocity_scale: (N,) sizes of the terms that the velocities are the sums of [m/s]; 0: unknown.
        factors: (N, FACTOR) factors of W, see `inputs`, rows of zeros for none; or (0, FACTOR).
        numbers: (N, 7) is overwritten with v⁺, P and the compression impulse.
        codes: (N, 3) is overwritten with status, flags and iterations.
        works: (N, 3) is overwritten with the work of compression, restitution and friction; (0, 3): no work.
    """
    scratch, none = np.empty(SCRATCH), np.empty(0)
    path = np.empty((0, 6))
    trace = np.empty((TRACE_ROWS if works.shape[0] > 0 else 0, 6))
    for i in range(velocity.shape[0]):
        w = delassus[i]
        factor = none
        if len(factors) > 0 and factors[i, 6] > 0.0:
            factor = factors[i]
        result = Result(
            *solve_into(
                w[0, 0],
                0.5 * (w[0, 1] + w[1, 0]),
                0.5 * (w[0, 2] + w[2, 0]),
                w[1, 1],
                0.5 * (w[1, 2] + w[2, 1]),
                w[2, 2],
                velocity[i, 0],
                velocity[i, 1],
                velocity[i, 2],
                friction[i],
                restitution[i],
                law,
                velocity_scale[i],
                factor,
                scratch,
                trace,
                path,
            )
        )
        if asymmetry(w):
            result = no_result(INDEFINITE_DELASSUS, 0.0)
        write_result(i, result, numbers, codes)
        if works.shape[0] > 0:
            works[i, :] = 0.0 if result.status <= LOCKED else math.nan
            if result.status <= LOCKED:
                for j in range(result.trace_rows):
                    works[i, int(trace[j, 1])] += trace[j, 4]
                    works[i, 2] += trace[j, 5]
