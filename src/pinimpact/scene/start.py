"""Checks of the initial state of a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array, Integers
from ..checks import finite_array
from ..errors import InputError
from ..robot.data_cache import checked_configuration, data_cache
from ..robot.inverse_kinematics import closed_by_rounding
from ..robot.joint_limits import degrees_hint
from ..robot.tolerances import HELD_TOLERANCE
from ._kernels.tolerances import HELD_GAP, START_ROUNDING, STEPS_SLACK, STEPS_TOUCH
from .dynamics import SceneDynamics
from .hybrid_state import HybridState


def check_start(
    model: pin.Model,
    data: Any,
    dynamics: SceneDynamics,
    state: HybridState,
    names: Sequence[str],
    extent: float,
    left: Callable[[Array], Array],
) -> None:
    """Check the initial state of a motion, and remove overlap by rounding.

    Larger overlap that time steps may have left is described in `state.overlap`. Held contacts keep gaps.

    Args:
        model: The model.
        data: Its data.
        dynamics: The contacts and limits.
        state: The state; `q` and `overlap` may be replaced.
        names: Names of the contacts and limits.
        extent: The robot's size [m].
        left: Returns the largest overlap that time steps may leave [m] for a gap rate, see `left_by_steps`.

    Raises:
        InputError: A contact below its surface, a joint beyond its limit, a held contact that moves or is
            too far from its surface.
    """
    count = len(dynamics.contacts)
    free = count - int(dynamics.work.bilateral.sum())
    gaps, rates = dynamics.gaps_at(state.q, state.v).T
    acting = np.append(np.arange(count, len(gaps)), np.arange(free))  # limits first: hint at degrees
    below = -dynamics.work.touching_gap
    if ((gaps[acting] < below) & (gaps[acting] >= -START_ROUNDING)).any():
        _remove_rounding(model, data, dynamics, state, acting[np.abs(gaps[acting]) <= START_ROUNDING])
        gaps, rates = dynamics.gaps_at(state.q, state.v).T
    for i in acting[~(gaps[acting] >= -START_ROUNDING)].tolist():
        gap = float(gaps[i])
        if i < count:
            contact = dynamics.contacts[i]
            where = f"frame {contact.frame!r}" if contact.shape is None else f"shape {contact.shape!r}"
            overlap = f"q0: the contact {contact.label!r} at {where} starts {-gap:.6g} m below its surface"
            advice = (
                "start with every contact on or above its surface; pinimpact.place_in_contact finds such "
                "configurations"
            )
        else:
            limit = dynamics.limits[i - count]
            beyond = limit.sign * (limit.bound - state.q[limit.index_q])
            overlap = f"q0: the joint starts {beyond:.6g} beyond its limit {names[i]!r} ({limit.bound:.6g})"
            overlap += degrees_hint(state.q[limit.index_q])
            advice = 'start within the limits, or leave them out with without=("joint limits",)'
        if not -gap <= left(rates[i]):
            raise InputError(f"{overlap}; {advice}", field="q0", value=gap)
        state.overlap = overlap
    if free < count:
        _check_held(dynamics, state, gaps[:count], range(free, count), extent)


def left_by_steps(dt: float, extent: float, gravity: float, rates: Any) -> Any:
    """Return the largest overlap within a time step [m]. (theory.md, 16)

    Gaps are nonnegative only at the ends of steps; from any time within a step, they change up to its end by
    their rates times dt and by the slack `STEPS_SLACK`.

    Args:
        dt: Step size [s].
        extent: The robot's size [m].
        gravity: Acceleration of gravity [m/s²].
        rates: Gap rates [m/s], a number or an array.
    """
    return STEPS_TOUCH * extent + dt * (np.maximum(-rates, 0.0) + STEPS_SLACK * dt * gravity)


def _remove_rounding(
    model: pin.Model, data: Any, dynamics: SceneDynamics, state: HybridState, numbers: Integers
) -> None:
    """Move the configuration onto the surfaces and limits from which it differs by rounding."""
    count = len(dynamics.contacts)
    state.q = state.q.copy()
    for limit in (dynamics.limits[i - count] for i in numbers if i >= count):
        state.q[limit.index_q] = limit.bound
    contacts = [dynamics.contacts[i] for i in numbers if i < count]
    if contacts:
        state.q = closed_by_rounding(model, data, state.q, contacts)


def _check_held(dynamics: SceneDynamics, state: HybridState, gaps: Array, held: range, extent: float) -> None:
    """Check that held contacts are near their surfaces and do not move; they keep their gaps (n,) [m]."""
    for i in held:
        if abs(gaps[i]) > HELD_GAP * extent:
            raise InputError(
                f"q0: the held contact {dynamics.contacts[i].label!r} starts {gaps[i]:.6g} m from its "
                "surface; start with it there, or put the surface where it is held",
                value=float(gaps[i]),
            )
    dynamics.hold_at(np.where(np.arange(len(gaps)) < held.start, 0.0, gaps))
    motion = dynamics.free_motion_at(state.t, state.q, state.v, held)
    speeds = np.linalg.norm(motion.velocity, axis=1).tolist()
    parts = (np.abs(motion.jacobian) @ np.abs(state.v)).max(axis=1, initial=0.0).tolist()
    for i, speed, largest in zip(held, speeds, parts, strict=True):
        if speed > HELD_TOLERANCE * (1.0 + largest):
            raise InputError(
                f"v0: the held contact {dynamics.contacts[i].label!r} moves at {speed:.6g} "
                "m/s relative to its surface; start with it at rest there, or remove it from "
                "held",
                value=speed,
            )


def state_at(model: pin.Model, data: Any, q0: ArrayLike, v0: ArrayLike) -> HybridState:
    """Return the initial state at t = 0.

    Raises:
        InputError: Arrays of the wrong shape or not finite; q0 that is not a configuration.
    """
    try:
        q = checked_configuration(data_cache(model, data), model, q0).copy()
    except InputError as error:
        raise InputError(f"q0: {str(error).removeprefix('q: ')}", value=q0) from None
    return HybridState(0.0, q, finite_array("v0", v0, (model.nv,)).copy())
