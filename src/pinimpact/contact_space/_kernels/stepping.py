"""Time stepping in the normal impulse: the Euler scheme of the paper, and Runge–Kutta methods.

After v_t = 0 all rates are constant, so the rest of a phase is one exact step.
"""

from __future__ import annotations

import numpy as np

from ..._compile.jit import always_inlined, jit
from ..._numeric.tolerances import ROUNDOFF
from . import codes
from .contact_problem import PROCEEDS, prepare
from .ending import followed, not_begun
from .ledger import close_move, left_to_gain, new_ledger
from .moves import State, frictionless_course, leave_zero_slip, mode_flag, straight_move, tangential_velocity
from .recording import record_move, record_point
from .slip_steps import At, Stepping, slip_move
from .stiff_step import STAGES
from .tolerances import CLOSE_TO_JUMP

MAX_SCALES = 1000
"""Largest P₃ of an impact with fixed steps, over the scale of P₃."""

MAX_CHOSEN = 100_000
"""Largest number of adaptive steps."""


@jit
def solve_stepping(
    w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor, table, steps, rtol, trace,
    path,
):  # fmt: skip
    """Solve an impact at one contact by steps in P₃.

    Args:
        w11 … factor: As for `path.solve_into`.
        table: The Runge–Kutta method.
        steps: Number of steps over the scale of P₃: |v₃°|/c, or if that is zero the impulse that ends slip.
        rtol: 0 for steps of this size. Otherwise steps are adaptive, with a tolerance rtol μ P₃ of P_t, and
            slip ends where an impulse of that size would end it.
        trace, path: As for `path.solve_into`, without rows of MOVE columns.

    Returns:
        The values of a `Result`; the path has one point more than there are steps, or is full.
    """
    begins, figure, flags, view, problem = prepare(
        w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor
    )
    if begins != PROCEEDS:
        return not_begun(begins, figure, flags, v1, v2, v3)

    status, figure, flags, iterations, at, ledger, rows, points = _follow(
        problem, flags, table, steps, rtol, trace, path
    )
    velocity, impulse = (at.v1, at.v2, at.v3), (at.p1, at.p2, at.p3)
    return followed(
        *(view, problem, status, figure, flags, iterations, velocity, impulse, ledger),
        *(trace, rows, path, points),
    )


@always_inlined
def _stepping_of(problem, table, rtol):
    """Return the `Stepping` of an impact; arguments as for `solve_stepping`."""
    a11, a12, a22, b1, b2, c = problem.a11, problem.a12, problem.a22, problem.b1, problem.b2, problem.c
    mu, v1, v2, v3, speed = problem.mu, problem.v1, problem.v2, problem.v3, problem.speed
    scale = -v3 / c
    if v3 == 0.0:
        along = b1 * problem.s1 + b2 * problem.s2
        braking = mu * (a11 * v1 * v1 + 2.0 * a12 * v1 * v2 + a22 * v2 * v2) / (speed * speed) - along
        scale = speed / braking
    # slip across the range of A never ends
    lasting = (problem.flat and not problem.planar) or a11 + a22 == 0.0
    negligible = rtol if rtol > 0.0 else ROUNDOFF if table.grading > 0.0 else 0.0
    return Stepping(
        *(table, (a11, a12, a22, b1, b2), c, mu, problem.flat, lasting, problem.counts, rtol, scale),
        *(negligible, np.empty((max(len(table.b), STAGES), 4))),
    )


@always_inlined
def _follow(problem, flags, table, steps, rtol, trace, path):
    """Integrate an impact step by step.

    Args:
        problem, flags: As `prepare` returns them.
        table, steps, rtol, trace, path: As for `solve_stepping`.

    Returns:
        Status and the number for its error message; flags; number of steps; `At` and `Ledger` at the end;
        numbers of rows and points.
    """
    stepping = _stepping_of(problem, table, rtol)
    stride = stepping.scale / steps
    most = MAX_CHOSEN if rtol > 0.0 else MAX_SCALES * steps
    counts, ledger, course = problem.counts, new_ledger(), frictionless_course(problem)
    mode, rate = codes.IN_SLIP, problem.c - problem.mu * (problem.b1 * problem.s1 + problem.b2 * problem.s2)
    state = State(problem.s1, problem.s2, problem.speed, problem.v3, 0.0, 0.0, 0.0, 0.0)
    at = At(problem.v1, problem.v2, problem.v3, problem.speed, 0.0, 0.0, 0.0, ledger.phase, 0.0)
    settled = problem.mu == 0.0  # all rates are constant from here on
    rows, iterations = codes.NONE_YET, 0
    points = record_point(path, codes.NONE_YET, at.p3, at.v1, at.v2, at.v3, at.p1, at.p2)
    while True:
        iterations += 1
        if iterations > most:
            return codes.NOT_CONVERGED, 0.0, flags, iterations, at, ledger, rows, points
        v1, v2, v3, speed, p1, p2, p3, _, _ = at
        if not settled and v1 == 0.0 and v2 == 0.0:
            settled = True
            course, state, new_flags = leave_zero_slip(problem, State(1.0, 0.0, 0.0, v3, 0.0, p1, p2, p3))
            flags |= new_flags
            mode, v3 = course.mode, state.v3
        phase, left = ledger.phase, left_to_gain(ledger, counts, v3)
        at = At(v1, v2, v3, speed, p1, p2, p3, phase, left)
        if settled:
            move, state = straight_move(problem, 1.0, course, state, phase, left)
            if move.event == codes.NEVER:
                status, figure = codes.UNSTOPPABLE, v3
                if phase != codes.COMPRESSION:
                    status, figure = (codes.LOCKED if flags & codes.LOCKS else codes.LAW_UNREACHABLE), left
                return status, figure, flags, iterations, at, ledger, rows, points
            v1, v2 = tangential_velocity(problem, state)
            at = At(v1, v2, state.v3, state.speed, state.p1, state.p2, state.p3, phase, left)
        else:
            taken, stride, move, at, new_flags = slip_move(stepping, problem, at, rate, stride)
            flags |= new_flags
            if not taken:
                continue
        rate, h = move.rate, move.span
        flags |= mode_flag(mode, h, at.p3)
        rows = record_move(trace, rows, mode, phase, at.p3 - h, at.p3, move.work, move.friction_work)
        points = record_point(path, points, at.p3, at.v1, at.v2, at.v3, at.p1, at.p2)
        ledger, event, new_flags = close_move(ledger, problem, move.event, h, move.work, rate, left, at.p3)
        flags |= new_flags
        if event == codes.LAW_MET:
            break
    v3 = ledger.goal if counts == codes.VELOCITY else at.v3
    if rate < 0.0 and v3 < -CLOSE_TO_JUMP * at.p3 * rate:
        flags |= codes.NEAR_JUMP
    return codes.SEPARATED, 0.0, flags, iterations, at, ledger, rows, points
