"""The method "exact": slip by power series, everything else in closed form. (theory.md, sections 2 to 5)"""

from __future__ import annotations

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, FLOATS, declared, plain_tuple
from ..._compile.jit import always_inlined, inlined, jit
from . import codes, moves
from .contact_problem import PROCEEDS, prepare
from .ending import Result, followed, not_begun
from .ledger import close_move, left_to_gain, new_ledger
from .recording import MOVE, record_course, record_move, record_point
from .slip_equations import TERMS
from .slip_works import WORK_SCRATCH
from .tolerances import CLOSE_TO_JUMP
from .turning_slip import turning_move

SCRATCH = 2 * TERMS + 6 + WORK_SCRATCH
"""Length of the scratch array of an impact."""

MAX_MOVES = 1000
"""Largest number of moves of an impact; docs/hard-cases.md gives the numbers of the worst cases."""

VANISHED = 2.0**-80
"""Slip speed, of velocities scaled to one, that is taken as v_t = 0; the difference is below rounding.
(theory.md, 3.4)"""


@declared(*11 * [float], int, float, FLOATS, FLOATS, FLOAT_ROWS, FLOAT_ROWS, result=plain_tuple(Result))
@jit
def solve_into(
    w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor, scratch, trace, path
):
    """Solve an impact at one contact.

    Args:
        w11 … w33: Upper triangle of W, row by row [1/kg].
        v1, v2, v3: Pre-impact velocity [m/s].
        mu, e, law: μ, e and the code of the restitution law.
        velocity_scale: Size of the terms that v is the sum of [m/s]; 0 if unknown.
        factor: (FACTOR,) factor of W, or (0,).
        scratch: (SCRATCH,) scratch.
        trace: (m, 6) is filled with rows mode, phase, P₃ at start and end, normal work, friction work; m = 0:
            no trace. (m, MOVE) is filled with a row for each move, see `record_course`.
        path: (m, 6) is filled with rows P₃, v₁, v₂, v₃, P₁, P₂; m = 0: no path.

    Returns:
        The values of a `Result`.
    """
    factor, scratch, trace, path = borrowed(factor), borrowed(scratch), borrowed(trace), borrowed(path)
    begins, figure, flags, view, problem = prepare(
        w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor
    )
    if begins != PROCEEDS:
        return not_begun(begins, figure, flags, v1, v2, v3)

    status, figure, flags, iterations, state, ledger, rows, points = _follow(
        problem, flags, scratch, trace, path
    )
    u1, u2 = moves.tangential_velocity(problem, state)
    velocity, impulse = (u1, u2, state.v3), (state.p1, state.p2, state.p3)
    return followed(
        *(view, problem, status, figure, flags, iterations, velocity, impulse, ledger),
        *(trace, rows, path, points),
    )


@always_inlined
def _follow(problem, flags, scratch, trace, path):
    """Integrate an impact from move to move.

    Args:
        problem, flags: As `prepare` returns them.
        scratch, trace, path: As for `solve_into`.

    Returns:
        Status and the number for its error message; flags; number of moves; `State` and `Ledger` at the end;
        numbers of rows and points.
    """
    units = moves.slip_units(problem)
    coefficients, reciprocals = scratch[: TERMS + 1], scratch[TERMS + 1 : 2 * TERMS + 6]
    nodes = scratch[2 * TERMS + 6 :]
    each = trace.shape[1] == MOVE
    traced = trace.shape[0] > 0 and not each
    state = moves.State(problem.s1, problem.s2, problem.speed, problem.v3, 0.0, 0.0, 0.0, 0.0)
    ledger = new_ledger()
    course = moves.frictionless_course(problem)
    settled = problem.mu == 0.0  # all rates are constant from here on
    iterations, rows, points = 0, codes.NONE_YET, codes.NONE_YET
    if path.shape[0] > 0:
        points = record_point(path, points, 0.0, problem.v1, problem.v2, problem.v3, 0.0, 0.0)
    while True:
        iterations += 1
        if iterations > MAX_MOVES:
            return codes.NOT_CONVERGED, 0.0, flags, iterations, state, ledger, rows, points
        left = left_to_gain(ledger, problem.counts, state.v3)
        turns = False
        if not settled:
            if state.speed <= VANISHED:
                settled = True
                course, state, new_flags = moves.leave_zero_slip(problem, state)
                flags |= new_flags
                left = left_to_gain(ledger, problem.counts, state.v3)
            else:
                course, straight, state, polynomials, bl, bp = moves.slip_course(
                    problem, units, state, iterations == 1
                )
                flags |= moves.jams(course.rate)
                turns = not straight
        before = state
        if turns:
            flags |= codes.SLIP_TURNS
            move, state, new_flags, points = turning_move(
                coefficients, reciprocals, nodes, problem, units, state, polynomials, bl, bp,
                course.rate, ledger.phase, ledger.goal, left, traced, path, points,
            )  # fmt: skip
            flags |= new_flags | moves.jams(move.rate)
        else:
            move, state = moves.straight_move(problem, units.omega, course, state, ledger.phase, left)
        if move.event == codes.NEVER:
            status, figure = codes.UNSTOPPABLE, state.v3
            if ledger.phase == codes.RESTITUTION:
                status, figure = (codes.LOCKED if flags & codes.LOCKS else codes.LAW_UNREACHABLE), left
            return status, figure, flags, iterations, state, ledger, rows, points
        flags |= moves.mode_flag(course.mode, move.span, state.p3)
        if traced:
            start, work = state.p3 - move.span, (move.work, move.friction_work)
            rows = record_move(trace, rows, course.mode, ledger.phase, start, state.p3, *work)
        if each:
            rows = record_course(trace, rows, course.mode, ledger.phase, before, state, move)
        ledger, event, new_flags = close_move(
            ledger, problem, move.event, move.span, move.work, move.rate, left, state.p3
        )
        flags |= new_flags
        if path.shape[0] > 0:
            u1, u2 = moves.tangential_velocity(problem, state)
            points = record_point(path, points, state.p3, u1, u2, state.v3, state.p1, state.p2)
        if event == codes.LAW_MET:
            break
    flags |= _near_jump(problem, units, state, ledger, move.rate, turns)
    return codes.SEPARATED, 0.0, flags, iterations, state, ledger, rows, points


@inlined
def _near_jump(problem, units, state, ledger, rate, turns):
    """Return `NEAR_JUMP` if v₃ would not have reached a slightly larger goal."""
    v3, flags = state.v3, codes.NO_FLAG
    if problem.counts == codes.VELOCITY:
        v3 = ledger.goal
        # dv₃/dP₃ is decreasing towards a negative value
        fall = problem.mu * (state.s1 * problem.b2 - state.s2 * problem.b1) * units.omega * state.turn
        if turns and state.speed * rate * rate < 2.0 * CLOSE_TO_JUMP * ledger.goal * fall:
            flags |= codes.NEAR_JUMP
    if rate < 0.0 and v3 < -CLOSE_TO_JUMP * state.p3 * rate:
        flags |= codes.NEAR_JUMP
    return flags
