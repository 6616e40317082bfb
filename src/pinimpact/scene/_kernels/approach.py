"""Classification of contacts and limits at an instant: approaching, touching, open. (theory.md, 11.3)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from .contact_forces import FREE, HELD
from .dynamics import all_gaps
from .workspace import SceneWorkspace

APART, TOUCHING, ARRIVING, STRUCK = range(4)
"""State of a contact or limit at an instant. Arriving: its gap closes now; struck: it has had an impulse."""

TOUCHES, PRESSED, SLIDES = 1, 2, 3
"""Candidates for the active set. Touches: is closed without bouncing; pressed: also was active, or has just
been struck; slides: is treated as sliding, however slowly."""


@inlined
def touches(work, gap, rate):
    """Return whether a gap [m] that hardly changes [m/s] is closed within the tolerance of positions.

    Corners of equal faces may have gaps of that size, through which no motion would ever bring them.
    """
    return gap <= max(work.touching_gap, work.atol) and abs(rate) <= work.stick_speed


@declared(SceneWorkspace, FLOATS, FLOATS, bool, float, INTEGERS, INTEGERS)
@jit
def fastest_approach(work, q, v, starting, parting, where, slow):
    """Return the contact or limit that approaches fastest and needs an impact, or −1, and its gap rate [m/s].

    If a gap closes now, approaching contacts whose gaps are as small, up to tolerance and constraint drift,
    arrive with it: gaps are not known more accurately. An example are the far corners of a box that turns
    about an edge onto its face. Likewise, contacts whose gaps hardly change touch with active ones.

    Args:
        work: The workspace.
        q, v: The state.
        starting: Whether the motion starts now: touching contacts have then just closed their gaps.
        parting: Separation speed above which a contact is open and takes no part in impacts of others [m/s].
        where: (n + nl,) `APART`, `TOUCHING`, `ARRIVING` or `STRUCK`; updated.
        slow: (n + nl,) is overwritten with `TOUCHES` or `PRESSED` for contacts and limits that touch and
            approach or separate at most at the resting speed, else 0.
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
        elif where[i] == APART and (gap <= near or modes[i] != FREE or touches(work, gap - drift, rate)):
            where[i] = ARRIVING if starting else TOUCHING
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
