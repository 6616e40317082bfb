"""When the modes that hold end although least-norm forces do not tell."""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import jit
from . import dense_output
from .contact_modes import find_modes

PARTS = 10
"""Parts of a step at which to ask whether modes still hold."""


@jit
def end_of_modes(work, t, h, end, q0, v0, coefficients):
    """Return the first time in a step from which no forces exist for the modes that hold; infinite if none.

    Where forces are not unique, those of least norm may leave their bounds while others do not.

    Args:
        work: The workspace.
        t: Start of the step [s].
        h: Its length [s].
        end: The time up to which to look.
        q0, v0: The state at its start.
        coefficients: Its dense output, see `dense_output.interpolate`.
    """
    modes = work.modes
    found = np.empty(len(modes), dtype=np.int64)
    reference = np.empty((work.contacts, 2))
    q, v, breaking = np.empty(len(q0)), np.empty(len(v0)), np.empty(len(v0))
    earlier, later, part = t, math.inf, 1
    while not work.callback_failed:
        if later == math.inf:
            time = end if part == PARTS else t + (end - t) * part / PARTS
        else:
            time = 0.5 * (earlier + later)
            if not earlier < time < later:
                break
        dense_output.state(coefficients, (time - t) / h, work.joint_charts, q0, v0, q, v)
        find_modes(work, time, q, v, modes, found, reference, breaking)
        changed = False
        for i in range(len(found)):
            changed |= found[i] != modes[i]
        if changed:
            later = time
        elif time == end:
            break
        else:
            earlier, part = time, part + 1
    return later
