"""Loops over a kernel call, to measure its run time without the overhead of a call from Python."""

from __future__ import annotations

import numpy as np

from ..._compile.jit import jit
from .path import SCRATCH, solve_into
from .stepping import solve_stepping


@jit
def repeat_exact(count, w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law):
    """Solve one problem `count` times by "exact", each call dependent on the previous one."""
    scratch, empty, none = np.empty(SCRATCH), np.empty((0, 6)), np.empty(0)
    last = 0.0
    for _ in range(count):
        v = v1 + 0.0 * last
        last = solve_into(
            w11, w12, w13, w22, w23, w33, v, v2, v3, mu, e, law, 0.0, none, scratch, empty, empty
        )[3]
    return last


@jit
def repeat_stepping(count, w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, table, steps, rtol):
    """Solve one problem `count` times by steps in P₃, each call dependent on the previous one."""
    empty, none = np.empty((0, 6)), np.empty(0)
    last = 0.0
    for _ in range(count):
        v = v1 + 0.0 * last
        last = solve_stepping(
            w11, w12, w13, w22, w23, w33, v, v2, v3, mu, e, law, 0.0, none, table, steps, rtol, empty, empty
        )[3]
    return last
