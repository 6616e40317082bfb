"""The sums of the normal direction, and what an event brings: phases end, the law is met. (theory.md, 2)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.jit import inlined
from . import codes
from .laws import left_of_goal, restitution_goal
from .tolerances import CLOSE_TO_JUMP


class Ledger(NamedTuple):
    """Where the impact stands.

    Attributes:
        phase: COMPRESSION or RESTITUTION.
        phase_start: P₃ at which the present compression began.
        compressed, restored: Normal impulses of all closed compressions and of all restitution.
        compression_work, restitution_work: Normal works so far.
        goal: What restitution has to reach, once there is one.
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
    """Return the ledger of an impact that begins."""
    return Ledger(codes.COMPRESSION, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def left_to_gain(ledger, counts, v3):
    """Return what is left of the restitution's goal."""
    return left_of_goal(counts, ledger.goal, v3, ledger.restored, ledger.restitution_work)


@inlined
def close_move(ledger, problem, event, span, work, rate, left, p3):
    """Enter a move into the ledger and do what its event brings.

    Args:
        event: What ended the move.
        span, work, rate: Its normal impulse, its normal work, and dv₃/dP₃ at its end.
        left: What was left of the goal at its start.
        p3: Normal impulse at its end.

    Returns:
        the ledger, the event (LAW_MET also where compression ends and nothing is to be restored), and flags
        to be set.
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
            # v₃ rose to `peak` and came back; had the approach been a little slower the rise had been higher,
            # lasted longer in the proportion of the root, and perhaps long enough
            peak = -0.25 * rate * restored
            higher = 1.0 - CLOSE_TO_JUMP * problem.v3 / peak if peak > 0.0 else math.inf
            longer = math.sqrt(higher)
            gained, more = (span, longer) if problem.counts == codes.IMPULSE else (work, longer * higher)
            if left - gained < CLOSE_TO_JUMP * goal or goal < more * (goal - (left - gained)):
                flags |= codes.NEAR_JUMP
    ledger = Ledger(phase, phase_start, compressed, restored, compression_work, restitution_work, goal)
    return ledger, event, flags
