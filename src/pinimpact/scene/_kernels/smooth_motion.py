"""The smooth motion between events: its start, and the completion of each step. (theory.md, 9, 11.6)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, TWO_FLOATS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign, filled
from ..._numeric.products import apply_symmetric, dot
from ..._numeric.tolerances import EPS, TINY
from . import dynamics, slip, step_dop853, stiff_drives
from .approach import touches
from .constraint_drift import constraint_drift
from .contact_forces import FREE, SLIP, joint_forces
from .events.force_bound import doubtful_margin
from .events.registry import find_first_event
from .samples import record_sample, speed_along
from .step_radau import STIFF as STIFF_SLIP
from .tolerances import ITERATED, STILL
from .workspace import SceneWorkspace

BEYOND = 1.3
"""Longest step, relative to the predicted duration of a bounce that has begun, or of a slip that ends."""


@declared(SceneWorkspace, float, FLOATS, FLOATS)
@jit
def begin(work, t, q, v):
    """Begin a smooth motion at a state: evaluate accelerations, forces, gaps and rates of stiff terms.

    Returns an estimate of the duration of a bounce that has just begun [s]; infinite if there is none.
    """
    rates, gaps, modes = work.stage_rates, work.start_gaps, work.modes
    n = len(v)
    assign(work.q0, q)
    assign(work.v0, v)
    _set_speeds(work)
    dynamics.set_state(work, q, v)
    for i in range(len(rates)):
        filled(rates[i, 2 * n :], 0.0)
    assign(rates[0, :n], v)
    dynamics.evaluate_anew(work, t, rates[0, n:])
    slip.turn_references(work, work.contact_velocity)
    work.drive_rate = stiff_drives.rate_of_drives(work)
    _set_start(work)
    guess = math.inf
    if len(gaps) == 0:
        return guess
    dynamics.contact_gaps(work, gaps, work.start_spheres)
    jacobian, three = np.empty((3, n)), np.empty((3, 3))
    for i in range(len(gaps)):
        if modes[i] == FREE and abs(gaps[i, 0]) <= work.touching_gap and gaps[i, 1] > work.stick_speed:
            dynamics.motion_of_contact(work, i, jacobian, three[0], three[1], three[2])
            fall = -three[1, 2]
            for j in range(n):  # effect of the active rows
                fall -= jacobian[2, j] * (rates[0, n + j] - work.acceleration[j])
            if fall > 0.0:
                guess = min(guess, 2.0 * gaps[i, 1] / fall)
    return guess


@inlined
def _set_speeds(work):
    """Set the speeds below which slip is uncertain, or keeps its direction, at the start of a motion."""
    slip.set_certain_speed(work)
    work.direction_speed = min(slip.certain(work), STILL * work.stick_speed)


@inlined
def _set_start(work):
    """Set the data of the first sample and of step size control from the rates at the start of a motion."""
    rates, n = work.stage_rates, work.nv
    for m in range(n):
        work.stage_reactions[0, m] = rates[0, n + m] - work.acceleration[m]
    record_sample(work, 0, 0.0)
    _set_stiffness(work, slip.stiffness_of_slip(work))
    work.slip_ends = _slip_ends(work, rates[0])
    work.previous_length = 0.0
    work.evaluated = work.active_contacts + work.active_scalars > 0


@inlined
def _set_stiffness(work, of_slip):
    """Set the rate at which the direction of slip settles [1/s], and the largest explicit step."""
    work.slip_stiffness = of_slip
    work.stiff_length = 1.0 / max(of_slip / STIFF_SLIP, work.drive_rate / stiff_drives.STIFF, TINY)


@inlined
def _slip_ends(work, rates):
    """Return an estimate of the time until the first slip ends [s], from the rates (2 nv, …) at the start.

    Slip slower than `certain_speed` is not considered.
    """
    ends, n = math.inf, work.nv
    jacobian, reference = work.contact_jacobian, work.slip_reference
    for k in range(len(work.active_mode)):
        if work.active_mode[k] == SLIP and work.active_friction[k] > 0.0:
            rate = speed_along(work, k, work.contact_acceleration)
            for j in range(n):
                turned = reference[k, 0] * jacobian[k, 0, j] + reference[k, 1] * jacobian[k, 1, j]
                rate += turned * (rates[n + j] - work.acceleration[j])
            speed = speed_along(work, k, work.contact_velocity)
            if rate < 0.0 and speed > work.certain_speed:
                ends = min(ends, -speed / rate)
    return ends


@declared(SceneWorkspace, FLOATS)
@jit
def replace_force(work, tau):
    """Replace the constant generalized force (nv,) where the next step starts; return whether it can start.

    Accelerations are linear in it, and M⁻¹ and Jacobians of the last evaluation are used again. If that was
    at another state, or the modes may not hold with the new force, the motion has to be restarted.
    """
    control, jacobian, free = work.control_force, work.contact_jacobian, work.contact_acceleration
    n, modes, gaps, rates = work.nv, work.modes, work.start_gaps, work.stage_rates
    change, response, largest = np.empty(n), np.empty(n), 0.0
    for j in range(n):
        change[j] = tau[j] - control[j]
        control[j] = tau[j]
        largest = max(largest, abs(change[j]))
    if largest == 0.0:
        return True
    if not (work.evaluated and work.forces_unique) or work.least_margin < 0.0 or work.driven > 0:
        return False
    for i in range(len(gaps)):
        if modes[i] == FREE and abs(gaps[i, 0]) <= work.touching_gap:
            return False
    apply_symmetric(work.minverse, change, response)
    acceleration, out = work.acceleration, rates[0, n:]
    dynamics.set_state(work, work.q0, work.v0)
    joint_forces(work, out[n:])
    for j in range(n):
        acceleration[j] += response[j]
        out[j] = acceleration[j]
    for k in range(len(free)):
        for d in range(3):
            free[k, d] += dot(jacobian[k, d], response)
    dynamics.add_forces(work, out)
    _set_speeds(work)
    _set_start(work)
    return work.forces_unique and work.force_margin > doubtful_margin(work) and modes_continue(work)


@declared(SceneWorkspace)
@jit
def modes_continue(work):
    """Return whether the modes hold for certain after a jump of a force, at the start of a smooth motion.

    They may not if contact forces violate their bounds, an open contact or limit touches, or a sliding
    contact or joint is slower than the sticking speed.
    """
    if work.active_contacts + work.active_scalars > 0 and not work.force_margin >= 0.0:
        return False
    gaps, modes, v0, contacts = work.start_gaps, work.modes, work.v0, work.contacts
    slowest = work.stick_speed
    for i in range(contacts):
        if modes[i] == FREE and touches(work, gaps[i, 0], gaps[i, 1]):
            return False
    for k in range(work.limits):
        gap, rate = dynamics.limit_gap(work, k, work.q0, v0)
        if modes[contacts + k] == 0 and touches(work, gap, rate):
            return False
    mode, mu, velocity = work.active_mode, work.active_friction, work.contact_velocity
    for k in range(len(mode)):
        if mode[k] == SLIP and mu[k] > 0.0 and math.hypot(velocity[k, 0], velocity[k, 1]) <= slowest:
            return False
    for j in range(len(v0)):
        speed = work.joint_metres[j] * abs(v0[j])
        if work.dry_friction[j] > 0.0 and modes[contacts + work.limits + j] == 0 and speed <= slowest:
            return False
    return True


@declared(SceneWorkspace, float, float, float)
@jit
def finish(work, t, h, error):
    """Complete an accepted step: dense output, first event, step size control.

    Results are stored in the workspace. If no event cuts the step its end becomes the start of the next one.

    Args:
        work: The workspace.
        t: Time at the start [s].
        h: Length of the step [s].
        error: Error of the step relative to the tolerance.

    Returns:
        The time of the first event [s]: infinite if there is none, −∞ if the step has to be repeated.
    """
    work.step_start, work.step_length = t, h
    assign(work.start_gain, work.end_gain)
    work.end_margin = work.force_margin
    work.drift_at_end = constraint_drift(work, work.v1)
    velocity = work.end_velocity
    for k in range(len(velocity)):
        assign(velocity[k], work.contact_velocity[k])
    stiffness = slip.stiffness_of_slip(work)
    for i in work.active_index:
        dynamics.follow_surface(work, i)
    if len(work.end_gaps):
        dynamics.contact_gaps(work, work.end_gaps, work.end_spheres)
    if work.method != step_dop853.IMPLICIT:
        step_dop853.complete(work, t, h)
    find_first_event(work)
    slip.set_directions_within(work, min(max(work.event_time - t, 0.0) / h, 1.0))
    work.growth, work.regular = 1.0, False
    if work.event_time > t + h:
        step_dop853.begin_next(work)
        slip.set_certain_speed(work)
        for i in range(len(work.end_gaps)):
            assign(work.start_gaps[i], work.end_gaps[i])
        for k in range(work.spheres):
            assign(work.start_spheres[k], work.end_spheres[k])
        _set_stiffness(work, stiffness)
        slip.turn_references(work, velocity)
        work.sample_margins[0] = work.end_margin
        work.slip_ends = math.inf
        for k in range(len(velocity)):
            before, now = work.sample_slip[0, k], speed_along(work, k, velocity)
            work.sample_slip[0, k] = now
            rubs = work.active_mode[k] == SLIP and work.active_friction[k] > 0.0
            if rubs and work.certain_speed < now < before:
                work.slip_ends = min(work.slip_ends, now * h / (before - now))
        set_growth(work, h, error)
        work_done, gain, gained = work.dense_coefficients[0, 2 * work.nv :], work.end_gain, False
        for k in range(2):
            gain[k] = max(work.start_gain[k] + work_done[1 + k], 0.0)
            gained |= not gain[k] <= work.gain_tolerance
        passes = not (gained or work.callback_failed) and work.least_margin >= 0.0
        work.regular = passes and work.drift_at_end <= work.drift_tolerance
    elif work.event_time == -math.inf:  # the step will be repeated with a smaller size
        slip.restore_directions(work)
    return work.event_time


@declared(SceneWorkspace, float, float, float, result=TWO_FLOATS)
@jit
def explicit_step(work, t, h, largest):
    """Attempt an explicit step, and `finish` it if its error is at most `largest`.

    Returns the error relative to the tolerance, and the result of `finish`, −∞ if the error is larger.
    """
    error = step_dop853.attempt(work, t, h, work.rtol, work.atol)
    if error > largest:  # or infinite, if a call into Python has failed
        return error, -math.inf
    return error, finish(work, t, h, error)


@declared(SceneWorkspace, FLOATS, float, float, float, result=TWO_FLOATS)
@jit
def step_under(work, tau, t, h, largest):
    """Replace the constant generalized force (nv,), and take the `explicit_step` from there.

    Returns the results of the step; NaN and −∞ if the motion has to be restarted, see `replace_force`;
    infinity and −∞ if this step has to be shorter or implicit.
    """
    if not replace_force(work, tau):
        return math.nan, -math.inf
    if h > min(work.stiff_length, BEYOND * work.slip_ends):
        return math.inf, -math.inf
    return explicit_step(work, t, h, largest)


@inlined
def set_growth(work, h, error):
    """Set `growth`, the factor to the next step size, from the errors of this step and the previous one.

    The trend of the two is used if it gives a smaller factor, since steps towards the end of a slip become
    shorter and shorter. (K. Gustafsson, ACM Transactions on Mathematical Software 20, 1994)
    """
    error, power = max(error, EPS), step_dop853.POWERS[work.method]
    factor = min(5.0, 0.9 * error**-power)
    if work.previous_length > 0.0:
        trend = 0.9 * h / work.previous_length
        factor = min(factor, trend * (max(work.previous_error, ITERATED) / error**2) ** power)
    work.previous_length, work.previous_error = h, error
    work.growth = max(factor, 0.2)


@declared(SceneWorkspace, FLOATS, FLOATS, FLOAT_ROWS)
@jit
def gaps_at(work, q, v, found):
    """Fill found (n + nl, 2) with gap and gap rate of contacts, then of joint limits, at a state."""
    dynamics.all_gaps(work, q, v, found)


@declared(
    *(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS),
    *(FLOATS, FLOAT_STACK, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOATS),
)
@jit
def free_motion_at(work, t, q, v, index, joints, jacobian, velocity, acceleration, surface, gap):
    """Fill v̇ and the motion of contacts `index` (k,) without contact forces at a state.

    Arrays other than joints (nv,), v̇, are those of `dynamics.motion_of_contacts`.
    """
    dynamics.set_state(work, q, v)
    dynamics.evaluate_without_contacts(work, t, np.empty(2))
    assign(joints, work.acceleration)
    for i in index:
        dynamics.follow_surface(work, i)
    dynamics.motion_of_contacts(work, index, jacobian, velocity, acceleration, surface, gap)
