"""v̇ of a robot with the contacts that are closed, evaluated from compiled code.

Everything stands in arrays that Python made once; `memory` tells which.
"""

from __future__ import annotations

import math

from ..._numeric.elimination import RANK, solve
from ..._numeric.jit import inner
from ...robot._kernels import contact_kinematics, contact_motion
from ...robot._kernels.python_calls import call
from . import contact_forces
from . import workspace as at
from .workspace import d1, d2, d3, f2, i1, i2, put

ABA, INVERT, KINEMATICS, LEAST_NORM, CONTROL = 0, 2, 4, 6, 8
"""Where `CALLS` has the function; its arguments follow."""

STILL, ALLOWANCE, MARGIN, LEAST_MARGIN, UNIQUE, FAILED, EVALUATIONS, STIFFNESS, LENGTH, ERROR, SLOWEST = (
    range(11)
)
"""In `STATE`: the speed [m/s] below which a contact may stick; the force [N] by which
Coulomb's law may seem violated through rounding; by how much the forces keep to it, negative where the modes
do not hold, and the least of it since it was last set to infinity; whether the motion determines the forces,
else they are those of least norm; whether a call raised; how often v̇ was evaluated; the stiffness of
slip at the start of the step, see `collocation`; length and error of the step before, zero at a start; the
speed [m/s] below which slip has no direction but the one remembered."""

LEAST_EFFECTIVE = 1e-9
"""Effective inverse inertia of a slipping contact, over that without friction, that counts as none."""


@inner
def take(q, v, mem):
    """Take a state into the buffers that Pinocchio reads."""
    put(d1(mem, at.Q), q)
    put(d1(mem, at.V), v)


@inner
def look(mem, i):
    """Return gap and gap rate of a contact at the kinematics last computed."""
    placement, local = d2(mem, at.PLACEMENT), d2(mem, at.LOCAL)
    constants, ends = d2(mem, at.CONSTANTS), i2(mem, at.ENDS)
    tip, base = ends[i, 0], ends[i, 1]
    return contact_motion.gap_and_rate(placement[tip], local[tip], placement[base], local[base], constants[i])


@inner
def kinematics(mem):
    """Compute placements and velocities at the state in the buffers."""
    state = d1(mem, at.STATE)
    calls = i1(mem, at.CALLS)
    if not call(calls[KINEMATICS], calls[KINEMATICS + 1]):
        state[FAILED] = 1.0


@inner
def gaps(mem, found):
    """Fill gap and gap rate (n, 2) of all contacts at the state in the buffers."""
    kinematics(mem)
    for i in range(len(found)):
        found[i, 0], found[i, 1] = look(mem, i)


@inner
def limit_gap(mem, k, q, v):
    """Return gap and gap rate of a joint limit at a state."""
    sign, j = d1(mem, at.SIGN)[k], i1(mem, at.INDEX_V)[k]
    return sign * (q[i1(mem, at.INDEX_Q)[k]] - d1(mem, at.BOUND)[k]), sign * v[j]


@inner
def all_gaps(q, v, found, mem):
    """Fill (n + nl, 2) gaps and rates of all contacts, then of the joint limits, at a state."""
    take(q, v, mem)
    limits = len(d1(mem, at.SIGN))
    count = len(found) - limits
    if count > 0:
        gaps(mem, found[:count])
    for k in range(limits):
        found[count + k, 0], found[count + k, 1] = limit_gap(mem, k, q, v)


@inner
def look_closely(mem, i, rows, velocity, acceleration, surface):
    """Fill what a closed contact needs, see `contact_motion.contact_motion`; return the gap [m]."""
    placement, spatial, gained, columns = (
        d2(mem, at.PLACEMENT),
        d2(mem, at.SPATIAL),
        d2(mem, at.GAINED),
        f2(mem, at.COLUMNS),
    )
    constants, ends, weights = d2(mem, at.CONSTANTS), i2(mem, at.ENDS), d2(mem, at.WEIGHTS)
    tip, base = ends[i, 0], ends[i, 1]
    return contact_motion.contact_motion(
        placement[tip],
        spatial[tip],
        gained[tip],
        placement[base],
        spatial[base],
        gained[base],
        constants[i],
        columns,
        weights[i],
        rows,
        velocity,
        acceleration,
        surface,
    )


@inner
def follow_surface(mem, i):
    """Let the axes of a contact follow its surface, see `contact_kinematics.follow`."""
    placement, constants, ends = d2(mem, at.PLACEMENT), d2(mem, at.CONSTANTS), i2(mem, at.ENDS)
    contact_kinematics.follow(placement[ends[i, 0]], placement[ends[i, 1]], constants[i])


@inner
def release(t, mem, powers):
    """Evaluate without contact forces: leave v̇ and the kinematics; fill the powers of control and joints."""
    state = d1(mem, at.STATE)
    calls, v, tau, given, clock = (
        i1(mem, at.CALLS),
        d1(mem, at.V),
        d1(mem, at.TAU),
        d1(mem, at.GIVEN),
        d1(mem, at.CLOCK),
    )
    damping, sliding = d1(mem, at.DAMPING), d1(mem, at.SLIDING)
    if calls[CONTROL] != 0:
        clock[0] = t
        if not call(calls[CONTROL], calls[CONTROL + 1]) or state[FAILED] != 0.0:
            state[FAILED] = 1.0
            return
    state[EVALUATIONS] += 1.0
    contact_forces.joint_forces(v, given, damping, sliding, tau, powers)
    if not call(calls[ABA], calls[ABA + 1]):
        state[FAILED] = 1.0


@inner
def measure(mem, which, rows, velocity, acceleration, surface, gap):
    """Take the numbers of some contacts, at the state last evaluated without contact forces."""
    for k in range(len(which)):
        gap[k] = look_closely(mem, which[k], rows[k], velocity[k], acceleration[k], surface[k])


@inner
def evaluate(t, mem, out):
    """Fill `out` (nv + 4) with v̇ and the powers of control, joints, sliding friction and surfaces."""
    state = d1(mem, at.STATE)
    calls, acceleration, minverse = i1(mem, at.CALLS), d1(mem, at.ACCELERATION), d2(mem, at.MINVERSE)
    n = len(acceleration)
    release(t, mem, out[n:])
    for j in range(n):
        out[j] = acceleration[j]
    which, modes, mu, reference, scalars, lower, upper = (
        i1(mem, at.WHICH),
        i1(mem, at.MODES),
        d1(mem, at.MU),
        d2(mem, at.REFERENCE),
        i1(mem, at.SCALARS),
        d1(mem, at.LOWER),
        d1(mem, at.UPPER),
    )
    if len(which) + len(scalars) == 0 or state[FAILED] != 0.0:
        return
    if not call(calls[INVERT], calls[INVERT + 1]):
        state[FAILED] = 1.0
        return
    rows, velocity, free, surface = (
        d3(mem, at.ROWS),
        d2(mem, at.VELOCITY),
        d2(mem, at.FREE_ACCELERATION),
        d2(mem, at.SURFACE),
    )
    measure(mem, which, rows, velocity, free, surface, d1(mem, at.GAP))
    directions, equations, response, system, target, solution, force, scalar_force = (
        d2(mem, at.DIRECTIONS),
        d2(mem, at.EQUATIONS),
        d2(mem, at.RESPONSE),
        d2(mem, at.SYSTEM),
        d1(mem, at.TARGET),
        d1(mem, at.SOLUTION),
        d2(mem, at.FORCE),
        d1(mem, at.SCALAR_FORCE),
    )
    effective = contact_forces.assemble(
        minverse,
        out[:n],
        rows,
        free,
        velocity,
        modes,
        mu,
        reference,
        state[SLOWEST],
        scalars,
        directions,
        equations,
        response,
        system,
        target,
    )
    rank = RANK if state[UNIQUE] != 0.0 else contact_forces.SINGULAR_STILL
    orientation = solve(system, target, solution, rank)
    total = 0.0
    for a in range(len(target)):
        total += target[a]
        for b in range(len(target)):
            total += system[a, b]
    if not math.isfinite(total):  # a stage far off; the step will be refused
        for j in range(len(out)):
            out[j] = math.nan
        return
    state[UNIQUE] = abs(orientation)
    if orientation == 0 and not call(calls[LEAST_NORM], calls[LEAST_NORM + 1]):
        state[FAILED] = 1.0
        return
    margin = contact_forces.finish(
        solution,
        response,
        directions,
        velocity,
        surface,
        modes,
        mu,
        lower,
        upper,
        out[:n],
        force,
        scalar_force,
        out[n + 2 :],
    )
    # without friction the determinant is positive, so where it is not, slip has passed a singularity
    lost = effective <= LEAST_EFFECTIVE or orientation < 0
    state[MARGIN] = -math.inf if lost else state[ALLOWANCE] + margin
    state[LEAST_MARGIN] = min(state[LEAST_MARGIN], state[MARGIN])
