"""Output of a time step: dense output, powers, modes and mean forces. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import largest
from ..._numeric.tolerances import ROUNDING
from .contact_forces import FREE, HELD, SLIP, STICK
from .force_evaluation import places_of_contacts
from .lie_charts import add_turning, turn_axes
from .step_rows import MeanForces, StepResult, StepRows, StepSystem
from .workspace import SceneWorkspace


@inlined
def free_modes(work, rests):
    """Set the modes of contacts, limits and velocities to `FREE`, except at joints at rest, rests (nj,)."""
    modes = work.modes
    for i in range(work.contacts):
        if not (rests[work.contact_joints[i, 0]] and rests[work.contact_joints[i, 1]]):
            modes[i] = FREE
    for k in range(work.limits):
        if not rests[work.velocity_joint[work.limit_v[k]]]:
            modes[work.contacts + k] = FREE
    for c in range(len(work.velocity_joint)):
        if not rests[work.velocity_joint[c]]:
            modes[work.contacts + work.limits + c] = FREE


@inlined
def scalar_modes(work, still, rows, found, dried):
    """Set the modes of limits and of joints with dry friction; fill the friction impulses, dried (nv,)."""
    modes, limits, dry, impulse = work.modes, rows.limits, rows.dry, found.impulse
    first = 3 * (len(rows.contacts) + len(rows.held))
    for k in range(len(dry)):
        row = first + len(limits) + k
        dried[dry[k]] = rows.values[row, 0] * impulse[row]
        modes[work.contacts + work.limits + dry[k]] = 1 if abs(found.u_end[row]) <= still else 0
    for k in range(len(limits)):
        modes[work.contacts + limits[k]] = 1 if impulse[first + k] > 0.0 else 0


@inlined
def dense_motion(work, h, start, v_end, coefficients):
    """Fill the dense output of q and v: velocities are linear in time, for free bodies in fixed axes.

    In body axes it is approximated by the cubic with the same values and rates at both ends. Arguments as in
    `report_step`.
    """
    charts, nv = work.joint_charts, len(start)
    turn, last, ended, first_rate, last_rate = np.empty((5, nv))
    for c in range(nv):
        turn[c] = -0.5 * h * start[c]
    turn_axes(charts, turn, v_end, last)
    for c in range(nv):
        coefficients[0, c] = turn[c] = 0.5 * h * (start[c] + last[c])
        first_rate[c] = last[c] - start[c]
        coefficients[1, c] = -0.5 * h * first_rate[c]
    turn_axes(charts, turn, last, ended)
    turn_axes(charts, turn, first_rate, last_rate)
    add_turning(charts, start, -h, first_rate)
    add_turning(charts, ended, -h, last_rate)
    for c in range(nv):
        change = ended[c] - start[c]
        coefficients[0, nv + c] = change
        coefficients[1, nv + c] = first_rate[c] - change
        coefficients[2, nv + c] = 2.0 * change - first_rate[c] - last_rate[c]


@inlined
def joint_powers(work, h, v, system, found, dried, powers):
    """Add the powers, times h, of control and drives, and of joints, to powers (2, 2): at start and end [J].

    `dried` (nv,) are the impulses of dry friction; other arguments as in `report_step`.
    """
    v_end, predicted = found.v_end, found.predicted
    for c in range(len(v)):
        change, damping = system.theta[c] * (v_end[c] - v[c]), h * work.damping[c]
        follows = (system.damping[c] - damping) * (change - 0.5 * (predicted[c] - v[c]))
        follows += system.softened[c] * (v_end[c] - v[c]) - system.damping[c] * change
        pushed, lost = h * work.control_force[c] - follows, dried[c] - damping * (v[c] + change)
        for e in range(2):
            speed = v[c] if e == 0 else v_end[c]
            powers[0, e] += pushed * speed
            powers[1, e] += lost * speed


@inlined
def contact_motion(work, h, still, rounding, rows, found, powers, forces):
    """Fill mean forces and modes of contacts; add the powers, times h, of sliding friction and of surfaces.

    Contacts whose impulse is not above `rounding` [N s] keep their mode. `powers` (2, 2) are those at start
    and end [J]; other arguments as in `report_step`.
    """
    contacts, held, surface = rows.contacts, rows.held, rows.surface
    impulse, u_start, u_end = found.impulse, found.u_start, found.u_end
    world, points, axes, _ = forces
    nc, every, modes = len(contacts), len(contacts) + len(held), work.modes
    index = np.empty(every, dtype=np.int64)
    for k in range(every):
        index[k] = contacts[k] if k < nc else held[k - nc]
    places_of_contacts(work, index, axes, points)
    for k in range(every):
        i, a = index[k], 3 * k
        for e in range(3):
            for o in range(3):
                world[k, e] += impulse[a + o] / h * axes[k, o, e]
            for o in range(2):
                powers[1, o] += impulse[a + e] * surface[k, e]
        if k >= nc:
            modes[i] = HELD
            continue
        for e in range(2):
            powers[0, 0] += impulse[a + e] * u_start[a + e]
            powers[0, 1] += impulse[a + e] * u_end[a + e]
        if impulse[a + 2] > rounding:
            slips = math.hypot(u_end[a], u_end[a + 1]) > still or work.friction[i] == 0.0
            modes[i] = SLIP if slips else STICK


@declared(
    *(SceneWorkspace, float, float, FLOATS, FLOATS),
    *(StepSystem, StepRows, StepResult, FLOAT_ROWS, MeanForces),
    result=bool,
)
@jit
def report_step(work, h, still, start, v, system, rows, found, coefficients, forces):
    """Fill dense output, modes and mean forces of a completed step; return whether any force acts.

    Velocities and powers are linear in time.

    Args:
        work: The workspace; its modes are set, except at joints at rest.
        h: Length of the step [s].
        still: Speed up to which a contact or joint is at rest [m/s].
        start, v: (nv,) velocity at the start, in the axes of the start and of the midpoint.
        system, rows, found: `StepSystem`, `StepRows` and `StepResult` of the step.
        coefficients: (terms, 2 nv + 4) is overwritten with the dense output; zero before.
        forces: Is overwritten with the `MeanForces`; zero before.
    """
    dried, impulse, joints, nv = np.zeros(len(v)), found.impulse, forces.joints, len(v)
    powers = np.zeros((4, 2))  # of control and drives, of joints, of sliding friction, of surfaces
    free_modes(work, system.rests)
    scalar_modes(work, still, rows, found, dried)
    dense_motion(work, h, start, found.v_end, coefficients)
    joint_powers(work, h, v, system, found, dried, powers[:2])
    rounding = ROUNDING * largest(impulse)
    contact_motion(work, h, still, rounding, rows, found, powers[2:], forces)
    for k in range(4):
        coefficients[0, 2 * nv + k] = 0.5 * (powers[k, 0] + powers[k, 1])
        coefficients[1, 2 * nv + k] = 0.5 * (powers[k, 0] - powers[k, 1])
    acts, scalars = False, 3 * (len(rows.contacts) + len(rows.held))
    for a in range(len(impulse)):
        acts = acts or impulse[a] != 0.0
        if a >= scalars and impulse[a] != 0.0:
            for k in range(rows.counts[a]):
                joints[rows.columns[a, k]] += impulse[a] / h * rows.values[a, k]
    return acts
