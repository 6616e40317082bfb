"""Sums of normal impulse and work, and transitions between phases at events. (theory.md, 2)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.jit import inlined
from . import codes
from .laws import left_of_goal, restitution_goal
from .tolerances import CLOSE_TO_JUMP


class Ledger(NamedTuple):
    """Phase of the impact and sums so far.

    Attributes:
        phase: COMPRESSION or RESTITUTION.
        phase_start: P₃ at the start of the present compression.
        compressed, restored: Normal impulses of all completed compressions and of all restitution.
        compression_work, restitution_work: Normal work.
        goal: Impulse, work or velocity at which restitution ends, by (2.4)–(2.6); 0 before the first
            restitution.
    """

    phase: np.int64
    phase_start: float
    compressed: float
    restored: float
    compression_work: float
    restitution_work: float
    goal: float


@inlined
def new_ledger():
    """Return the `Ledger` at the start of an impact."""
    return Ledger(codes.COMPRESSION, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def left_to_gain(ledger, counts, v3):
    """Return the remainder of the goal of restitution; `counts` is the quantity of the law."""
    return left_of_goal(counts, ledger.goal, v3, ledger.restored, ledger.restitution_work)


@inlined
def close_move(ledger, problem, event, span, work, rate, left, p3):
    """Add a move to the ledger and change the phase at its event.

    Args:
        ledger, problem: The `Ledger` before the move, and the `Problem`.
        event: The event that ends the move.
        span, work, rate: Its normal impulse, its normal work, and dv₃/dP₃ at its end.
        left: Remainder of the goal at its start.
        p3: P₃ at its end.

    Returns:
        The `Ledger`; the event, with LAW_MET for an end of compression without restitution; flags to be set.
    """
    phase, phase_start, compressed, restored, compression_work, restitution_work, goal = ledger
    flags = codes.NO_FLAG
    if phase == codes.COMPRESSION:
        compression_work += work
    else:
        restitution_work += work
        restored += span
    if event == codes.COMPRESSION_ENDS:
        compressed += p3 - phase_start
        phase = codes.RESTITUTION
        goal = restitution_goal(problem.law, problem.e, compressed, compression_work, problem.v3)
        if goal == 0.0:
            event = codes.LAW_MET
    elif event == codes.COMPRESSION_RESUMES:
        flags |= codes.SECOND_COMPRESSION
        phase = codes.COMPRESSION
        phase_start = p3
        if problem.counts != codes.VELOCITY:
            # v₃ rose to `peak` and fell back; a slightly slower approach gives a higher peak, which lasts
            # longer in proportion to its root, and might reach the goal (theory.md, 2)
            peak = -0.25 * rate * restored
            higher = 1.0 - CLOSE_TO_JUMP * problem.v3 / peak if peak > 0.0 else math.inf
            longer = math.sqrt(higher)
            gained, more = (span, longer) if problem.counts == codes.IMPULSE else (work, longer * higher)
            if left - gained < CLOSE_TO_JUMP * goal or goal < more * (goal - (left - gained)):
                flags |= codes.NEAR_JUMP
    ledger = Ledger(phase, phase_start, compressed, restored, compression_work, restitution_work, goal)
    return ledger, event, flags
