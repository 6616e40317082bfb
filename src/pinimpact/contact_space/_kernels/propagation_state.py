"""Parameters and state of n contacts during an impact. (theory.md, section 14)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FloatRows, Floats, IntegerRows, Integers
from ..._compile.jit import inlined
from .codes import BOUND, FREE, HELD, LOADING, OPEN, SLIPPING, STUCK
from .tolerances import NEGLIGIBLE, SLIP_SPEED

NOT_SHARED, SHARED, UNEVEN = 0, 1, 2
"""`State.shared`. SHARED: other contacts can bear the friction of this one. UNEVEN: likewise, and the
friction (14.4) of the series leaves the friction bounds within the coming step, so that it is
redistributed."""

BEGUN, TIED, AT_BOUND = 1, 2, 3
"""`State.fresh`. BEGUN: slip has just begun. TIED: it begins together with that of other contacts that share
friction, (14.14). AT_BOUND: friction has reached its bound."""


class System(NamedTuple):
    """Parameters of n contacts, constant during an impact.

    Attributes:
        w: (3n, 3n) W.
        filled: (3n, 3n) column indices of the nonzero entries of each row of W.
        filled_count: (3n,) number of these entries.
        friction: (n,) μ.
        unloading: (n,) ρ = 1/e², or 0 if e = 0.
        stiffness: (n,) κ.
        exponent: η.
    """

    w: FloatRows
    filled: IntegerRows
    filled_count: Integers
    friction: Floats
    unloading: Floats
    stiffness: Floats
    exponent: float


class State(NamedTuple):
    """State of an impact.

    Attributes:
        v: (3n,) velocities.
        impulse: (3n,) P.
        indentation: (n,) δ, negative for a gap.
        deepest: (n,) the largest δ since the contact closed.
        normal: (n,) normal modes OPEN, LOADING, RISING, SINKING, HELD.
        tangent: (n,) tangential modes FREE, SLIPPING, STUCK, BOUND.
        direction: (2n,) direction of incipient slip where friction is at its bound.
        fresh: (n,) `BEGUN`, `TIED`, `AT_BOUND`, or 0.
        shared: (n,) `NOT_SHARED`, `SHARED` or `UNEVEN`.
        share: (2n,) friction of a sticking contact over its normal force, g of (14.4).
        pressed: (n,) force of a held contact to which the solution of its equations is added.
        last: (n,) mean force F̄ of a held contact when its modes were last chosen.
        ringing: (n,) amplitude of the oscillation of a held contact's force about F̄.
    """

    v: Floats
    impulse: Floats
    indentation: Floats
    deepest: Floats
    normal: Integers
    tangent: Integers
    direction: Floats
    fresh: Integers
    shared: Integers
    share: Floats
    pressed: Floats
    last: Floats
    ringing: Floats


@inlined
def new_state(v, impulse):
    """Return the `State` of n open contacts with velocities and impulses (3n,), which it refers to."""
    n = len(v) // 3
    return State(
        *(v, impulse, np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)),
        *(np.zeros(2 * n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(2 * n)),
        *(np.zeros(n), np.zeros(n), np.zeros(n)),
    )


@inlined
def loads(mode):
    """Return whether the force of a contact in this mode follows from its indentation."""
    return mode != OPEN and mode != HELD


@inlined
def rate(system, mode, j):
    """Return ρ of (14.2), the ratio of dδ/ds to −v₃."""
    return 1.0 if mode in (OPEN, LOADING) or system.unloading[j] == 0.0 else system.unloading[j]


@inlined
def friction_share(system, state, unit, j):
    """Return the friction force that is proportional to the normal force of contact j, over that force."""
    tangent, x, y = state.tangent[j], 2 * j, 2 * j + 1
    if tangent == STUCK:
        return state.share[x], state.share[y]
    if tangent in (SLIPPING, BOUND):
        return -system.friction[j] * unit[x], -system.friction[j] * unit[y]
    return 0.0, 0.0


@inlined
def stored(system, j, indentation):
    """Return κ δ^(η + 1)/(η + 1), the energy of loading contact j to an indentation δ."""
    depth = max(indentation, 0.0)
    if system.exponent == 1.0:
        return 0.5 * system.stiffness[j] * depth * depth
    order = system.exponent + 1.0
    return system.stiffness[j] * depth**order / order


@inlined
def close(system, state, j):
    """Start loading a contact."""
    state.normal[j] = LOADING
    state.indentation[j] = 0.0
    state.deepest[j] = 0.0
    state.tangent[j] = FREE
    if system.friction[j] > 0.0:
        state.tangent[j] = SLIPPING
        if math.hypot(state.v[3 * j], state.v[3 * j + 1]) <= NEGLIGIBLE:
            stick(state, j)


@inlined
def begin_to_slip(state, j):
    """Start slip of a contact along `State.direction`, at the negligible speed `SLIP_SPEED`."""
    state.tangent[j] = SLIPPING
    state.fresh[j] = BEGUN
    state.v[3 * j] = SLIP_SPEED * state.direction[2 * j]
    state.v[3 * j + 1] = SLIP_SPEED * state.direction[2 * j + 1]


@inlined
def stick(state, j):
    """End the slip of a contact."""
    state.tangent[j] = STUCK
    state.v[3 * j] = 0.0
    state.v[3 * j + 1] = 0.0


@inlined
def open_contact(state, j):
    """Separate a contact."""
    state.normal[j] = OPEN
    state.tangent[j] = FREE
    state.indentation[j] = 0.0
    state.deepest[j] = 0.0
