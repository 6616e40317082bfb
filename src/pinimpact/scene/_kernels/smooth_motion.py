"""The smooth motion between events: how it begins, and how a step of it is finished."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign, filled
from ..._numeric.tolerances import EPS
from . import dynamics, slip, step_dop853
from .constraint_drift import constraint_drift
from .contact_forces import FREE, SLIP
from .events.registry import find_first_event
from .force_choice import choose_forces
from .samples import along, record_sample
from .stiff_drives import rate_of_drives
from .tolerances import ITERATED, STILL
from .workspace import SceneWorkspace


@declared(SceneWorkspace, float, FLOATS, FLOATS)
@jit
def begin(work, t, q, v):
    """Begin a smooth motion: evaluate at its start, take the gaps and the stiffness of slip.

    Return a guess how long a bounce just begun lasts [s]; infinite where there is none.
    """
    rates, gaps, modes = work.stage_rates, work.start_gaps, work.modes
    n = len(v)
    assign(work.q0, q)
    assign(work.v0, v)
    slip.set_certain_speed(work)
    # below it slip has no direction but the one last known
    work.direction_speed = min(slip.certain(work), STILL * work.stick_speed)
    dynamics.set_state(work, q, v)
    for i in range(len(rates)):
        filled(rates[i, 2 * n :], 0.0)
    assign(rates[0, :n], v)
    dynamics.evaluate(work, t, rates[0, n:])
    choose_forces(work, t, rates[0, n:])
    for m in range(n):
        work.stage_reactions[0, m] = rates[0, n + m] - work.acceleration[m]
    slip.turn_references(work, work.contact_velocity)
    record_sample(work, 0, 0.0)
    work.slip_stiffness = slip.stiffness_of_slip(work)
    work.slip_ends = _slip_ends(work, rates[0])
    work.drive_rate = rate_of_drives(work)
    work.previous_length = 0.0
    guess = math.inf
    if len(gaps) == 0:
        return guess
    dynamics.contact_gaps(work, gaps, work.start_spheres)
    jacobian, three = np.empty((3, n)), np.empty((3, 3))
    for i in range(len(gaps)):
        if modes[i] == FREE and abs(gaps[i, 0]) <= work.touching_gap and gaps[i, 1] > work.stick_speed:
            dynamics.motion_of_contact(work, i, jacobian, three[0], three[1], three[2])
            fall = -three[1, 2]
            for j in range(n):  # what is closed pushes
                fall -= jacobian[2, j] * (rates[0, n + j] - work.acceleration[j])
            if fall > 0.0:
                guess = min(guess, 2.0 * gaps[i, 1] / fall)
    return guess


@inlined
def _slip_ends(work, rates):
    """Return a guess of the time until the first certain slip ends, at the rates (2 nv, …) of the start."""
    ends, n = math.inf, work.nv
    jacobian, reference = work.contact_jacobian, work.slip_reference
    for k in range(len(work.active_mode)):
        if work.active_mode[k] == SLIP and work.active_friction[k] > 0.0:
            rate = along(work, k, work.contact_acceleration)
            for j in range(n):
                turned = reference[k, 0] * jacobian[k, 0, j] + reference[k, 1] * jacobian[k, 1, j]
                rate += turned * (rates[n + j] - work.acceleration[j])
            speed = along(work, k, work.contact_velocity)
            if rate < 0.0 and speed > work.certain_speed:
                ends = min(ends, -speed / rate)
    return ends


@declared(SceneWorkspace)
@jit
def modes_continue(work):
    """Whether the modes that hold do so under a force that has jumped, at the start of a smooth motion.

    Not where the forces of what is closed leave their bounds, and not for certain where something is about to
    change its mode: what touches is open, or what slips has no speed.
    """
    if work.active_contacts + work.active_scalars > 0 and not work.force_margin >= 0.0:
        return False
    gaps, modes, v0, contacts = work.start_gaps, work.modes, work.v0, work.contacts
    near, resting, slowest = work.touching_gap, work.resting_speed, work.stick_speed
    for i in range(contacts):
        if modes[i] == FREE and gaps[i, 0] <= near and abs(gaps[i, 1]) <= resting:
            return False
    for k in range(work.limits):
        gap, rate = dynamics.limit_gap(work, k, work.q0, v0)
        if modes[contacts + k] == 0 and gap <= near and abs(rate) <= resting:
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


@declared(SceneWorkspace, float, float, float, bool)
@jit
def finish(work, t, h, error, explicit):
    """Finish a step whose error is small enough: look for the first event in it.

    What comes of it is in the workspace: the event, the margin and the drift at the end of the step, how much
    longer the next one may be, and the dense output; also the end as the next one's start, if no event cuts
    it. The step of length h [s] starts at t [s]; the error is over the tolerance.
    """
    work.step_start, work.step_length = t, h
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
    if explicit:
        step_dop853.complete(work, t, h)
    find_first_event(work)
    slip.set_directions_within(work, min(max(work.event_time - t, 0.0) / h, 1.0))
    work.growth = 1.0
    if work.event_time > t + h:
        step_dop853.begin_next(work)
        slip.set_certain_speed(work)
        for i in range(len(work.end_gaps)):
            assign(work.start_gaps[i], work.end_gaps[i])
        for k in range(work.spheres):
            assign(work.start_spheres[k], work.end_spheres[k])
        work.slip_stiffness = stiffness
        slip.turn_references(work, velocity)
        work.sample_margins[0] = work.end_margin
        work.slip_ends = math.inf
        for k in range(len(velocity)):
            before, now = work.sample_slip[0, k], along(work, k, velocity)
            work.sample_slip[0, k] = now
            rubs = work.active_mode[k] == SLIP and work.active_friction[k] > 0.0
            if rubs and work.certain_speed < now < before:
                work.slip_ends = min(work.slip_ends, now * h / (before - now))
        set_growth(work, h, error)
    elif work.event_time == -math.inf:  # the step will be tried again, shorter
        slip.restore_directions(work)


@inlined
def set_growth(work, h, error):
    """Tell how much longer the next step may be, and keep this one in mind for the step after it.

    The trend of the last two steps counts where it asks for less: steps towards the end of a slip shrink one
    after the other. (K. Gustafsson, ACM Transactions on Mathematical Software 20, 1994)
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
    """Fill (n + nl, 2) gaps and rates of all contacts, then of the joint limits, at a state."""
    dynamics.all_gaps(work, q, v, found)


@declared(
    *(SceneWorkspace, float, FLOATS, FLOATS, INTEGERS),
    *(FLOATS, FLOAT_STACK, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, FLOATS),
)
@jit
def free_motion_at(work, t, q, v, index, joints, jacobian, velocity, acceleration, surface, gap):
    """Fill v̇ and the motion of some contacts without contact forces, see `dynamics.motion_of_contact`."""
    dynamics.set_state(work, q, v)
    dynamics.evaluate_without_contacts(work, t, np.empty(2))
    assign(joints, work.acceleration)
    for i in index:
        dynamics.follow_surface(work, i)
    dynamics.motion_of_contacts(work, index, jacobian, velocity, acceleration, surface, gap)
