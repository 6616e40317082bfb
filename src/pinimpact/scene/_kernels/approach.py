"""What approaches at an instant, and what touches without bouncing."""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOATS, INTEGERS, declared
from ..._compile.jit import jit
from .contact_forces import FREE, HELD
from .dynamics import all_gaps
from .workspace import SceneWorkspace

APART, TOUCHING, ARRIVING, STRUCK = range(4)
"""Where a contact or limit is at an instant; arriving: its gap closes now; struck: it has had an impulse."""

TOUCHES, PRESSED, SLIDES = 1, 2, 3
"""What touches without bouncing; what of it is pressed: it was closed, or has just been struck; what of it
slips, however slowly."""


@declared(SceneWorkspace, FLOATS, FLOATS, bool, float, INTEGERS, INTEGERS)
@jit
def fastest_approach(work, q, v, starting, parting, where, slow):
    """Return which contact or limit to resolve an impact of, or −1, and its gap rate [m/s].

    What approaches arrives with what arrives if it is as near, to the tolerance and the constraint drift: no
    gap is known better, such as those of the far corners of a box that turns about an edge onto its face.

    Args:
        q, v: The state.
        starting: Whether the motion starts now, so that what touches has just closed its gap.
        parting: Speed above which what touches is open: it takes no part in impacts of others [m/s].
        where: (n + nl,) `APART`, `TOUCHING`, `ARRIVING` or `STRUCK`; what is near is added.
        slow: (n + nl,) takes `TOUCHES` or `PRESSED` for what touches and approaches or parts no faster than
            the resting speed.
    """
    bilateral, modes, near, resting_speed = work.bilateral, work.modes, work.touching_gap, work.resting_speed
    contacts = len(bilateral)
    found = np.empty((len(where), 2))
    all_gaps(work, q, v, found)
    arrives, drift = False, 0.0
    for i in range(len(where)):
        arrives = arrives or where[i] == ARRIVING
        if where[i] == ARRIVING or (modes[i] != FREE and modes[i] != HELD):
            drift = max(drift, abs(found[i, 0]))
    together = max(near, drift + work.atol) if arrives else near
    fastest, source = 0.0, -1
    for i in range(len(where)):
        gap, rate = found[i, 0], found[i, 1]
        slow[i] = 0
        if i < contacts and bilateral[i] != 0:
            slow[i] = PRESSED
            continue
        if rate > parting:
            where[i] = APART
        elif where[i] == APART and (gap <= near or modes[i] != FREE):
            where[i] = ARRIVING if starting and gap <= near else TOUCHING
        if where[i] == APART and gap <= together and rate < -work.least_approach:
            where[i] = ARRIVING
        if where[i] == APART:
            continue
        if (
            rate < -resting_speed or (where[i] == ARRIVING and rate < -work.least_approach)
        ) and rate < fastest:
            fastest, source = rate, i
        if resting_speed > 0.0 and abs(rate) <= resting_speed:
            slow[i] = PRESSED if where[i] == STRUCK or modes[i] != FREE else TOUCHES
    return source, fastest
