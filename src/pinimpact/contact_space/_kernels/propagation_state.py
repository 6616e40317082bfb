"""What n contacts are during an impact, and where it has come to. (theory.md, section 14)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FloatRows, Floats, IntegerRows, Integers
from ..._compile.jit import inlined
from .codes import BOUND, FREE, HELD, LOADING, OPEN, SLIPPING, STUCK
from .tolerances import NEGLIGIBLE, SLIP_SPEED

NOT_SHARED, SHARED, UNEVEN = 0, 1, 2
"""`State.shared`: whether others can bear what friction at a contact does; and whether in the step to come
that of the series, (14.4), leaves its bounds, so that they do."""

BEGUN, TIED, AT_BOUND = 1, 2, 3
"""`State.fresh` of a slip that has just begun, of one that does as friction that is shared comes to all its
bounds, and where friction has come to its bound."""


class System(NamedTuple):
    """What n contacts are during an impact.

    Attributes:
        w: (3n, 3n) W.
        filled: (3n, 3n) where its rows are not zero, the first
        filled_count: (3n,) of them.
        friction: (n,) μ.
        unloading: (n,) ρ = 1/e², and 0 for a contact that restores nothing.
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
    """Where an impact has come to.

    Attributes:
        v: (3n,) velocities.
        impulse: (3n,) P.
        indentation: (n,) δ, negative for a gap.
        deepest: (n,) the largest δ since the contact closed.
        normal: (n,) modes OPEN, LOADING, RISING, SINKING, HELD.
        tangent: (n,) modes FREE, SLIPPING, STUCK, BOUND.
        direction: (2n,) of the slip that a contact at the bound of its friction would take.
        fresh: (n,) `BEGUN`, `TIED`, `AT_BOUND`, or 0.
        shared: (n,) whether others can bear what friction at a contact does, see `propagation_sharing`.
        share: (2n,) what friction that holds is, beyond what the equations ask for, in parts of the force.
        pressed: (n,) what the force of a held contact is, beyond what the equations ask for.
        last: (n,) the force of a held contact as its modes were last chosen.
        ringing: (n,) by how much the force of a held contact oscillates about its mean.
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
    """Return the `State` of n contacts that are open, with velocities and impulses (3n,)."""
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
    """Return ρ: how fast the indentation follows the velocity."""
    return 1.0 if mode in (OPEN, LOADING) or system.unloading[j] == 0.0 else system.unloading[j]


@inlined
def friction_share(system, state, unit, j):
    """Return the friction of a contact that goes with its normal force, in parts of it."""
    tangent, x, y = state.tangent[j], 2 * j, 2 * j + 1
    if tangent == STUCK:
        return state.share[x], state.share[y]
    if tangent in (SLIPPING, BOUND):
        return -system.friction[j] * unit[x], -system.friction[j] * unit[y]
    return 0.0, 0.0


@inlined
def stored(system, j, indentation):
    """Return the energy of a contact's spring in loading."""
    order = system.exponent + 1.0
    return system.stiffness[j] * max(indentation, 0.0) ** order / order


@inlined
def close(system, state, j):
    """Let a contact begin to load."""
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
    """Let a contact slip along its direction, at a speed that does not matter."""
    state.tangent[j] = SLIPPING
    state.fresh[j] = BEGUN
    state.v[3 * j] = SLIP_SPEED * state.direction[2 * j]
    state.v[3 * j + 1] = SLIP_SPEED * state.direction[2 * j + 1]


@inlined
def stick(state, j):
    """Let the slip of a contact be at its end."""
    state.tangent[j] = STUCK
    state.v[3 * j] = 0.0
    state.v[3 * j + 1] = 0.0


@inlined
def open_contact(state, j):
    """Let a contact part."""
    state.normal[j] = OPEN
    state.tangent[j] = FREE
    state.indentation[j] = 0.0
    state.deepest[j] = 0.0
