"""Chatter: a control that jumps back and forth without end, so that no step of it is smooth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import IrregularMotionError
from ..robot.names import joint_of_velocity
from .controls import Control, asked
from .dense_step import DenseStep

Array = NDArray[np.float64]

LOOKED_AT = 20
"""Steps in a row that are looked at."""

CHATTERING = 10
"""As many of them with a jump are chatter; steps that lead up to a single jump are more than those at it."""

HALVINGS = 20
"""How often the way along which a control changes is halved; what still changes then has jumped."""

FINITE = 0.1
"""A jump is at least this part of the change that has been halved."""

LEAST = 1e-6
"""Changes below this part of the forces are none."""


def check_chatter(control: Control, model: pin.Model, steps: Sequence[DenseStep]) -> None:
    """Raise an error if a control jumps in one of the last steps after the other.

    Each step is looked at from its start along its tangent, on which its first stages lie: whether its dense
    output crosses the jump depends on the stages.

    Args:
        control: Of (t, q, v).
        model: The robot.
        steps: Since the last look.

    Raises:
        IrregularMotionError: It chatters.
    """
    jumps = 0
    for step in steps[-LOOKED_AT:]:
        found = jump_within(control, model, step)
        if found is not None:
            jumps += 1
            before, after = found
    if jumps < CHATTERING:
        return
    i = int(np.abs(after - before).argmax())
    t, h = steps[-1].start, float(np.median([step.h for step in steps[-LOOKED_AT:]]))
    joint = joint_of_velocity(model, i)
    low, high = sorted((float(before[i]), float(after[i])))
    raise IrregularMotionError(
        f"control: it chatters at t = {t:.6g} s: at the joint {joint!r} it switches between "
        f"{low:.6g} and {high:.6g} repeatedly, in steps of {h:.2g} s; model dry friction by the "
        "model's friction, which also holds joints at rest, and sample a control that switches "
        "(period=)",
        field="control",
        value=(before, after),
    )


def jump_within(control: Control, model: pin.Model, step: DenseStep) -> tuple[Array, Array] | None:
    """Return the forces (nv,) on both sides of a jump of the control along a step's tangent, or None."""
    nv = len(step.v)
    slope = step.coefficients[0] + step.coefficients[1]  # h times the rates at the start

    def forces(part: float) -> Array:
        q = pin.integrate(model, step.q, part * slope[:nv])
        v = step.v + part * slope[nv : 2 * nv]
        return asked(control, step.start + part * step.h, q, v).copy()

    low, high = 0.0, 1.0
    before, after = forces(low), forces(high)
    whole = float(np.abs(after - before).max())
    if whole <= LEAST * float(np.abs(before).max()):
        return None
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        between = forces(middle)
        if np.abs(between - before).max() > np.abs(after - between).max():
            high, after = middle, between
        else:
            low, before = middle, between
    return (before, after) if np.abs(after - before).max() > FINITE * whole else None
