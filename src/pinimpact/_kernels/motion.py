"""v̇ of a robot with the contacts that are closed, evaluated from compiled code.

Everything stands in arrays that Python made once, handed over in tuples:

`tree` — calls (10,) the addresses of functions and their arguments (`ABA` and its neighbours; 0 where there
is no control); q, v, tau the buffers that these read;
given (nv,) and clock (1,) what the control returns and at what time it is asked; acceleration, minverse,
placement (nj, 12), local (nj, 6), spatial (nj, 6), gained (nj, 6), columns (6, nv) where Pinocchio leaves v̇,
M⁻¹, oMi, v, ov, oa_gf and J; damping and sliding (nv,) of the joints.

`points` — constants (n, 22) of all contacts, see `touch`; ends (n, 2) the joints of tip and plane; weights
(n, nv), see `touch.contact_motion`; group (nv,) the joint that each velocity belongs to.

`closed` — of what is closed: which (nc,) contact, modes (nc,), mu (nc,), reference (nc, 2), scalars (ns,)
velocity indices, lower and upper (ns,), rest (nc,) the gap that the contact keeps; and what an evaluation
leaves: rows (nc, 3, nv), velocity, acceleration, surface (nc, 3), gap (nc,), directions (nc, 2), equations
and response (m, nv), system (m, m), target and solution (m,), force (nc, 3), scalar_force (ns,).

`state` (10,) — see `STILL` and its neighbours.
"""

from __future__ import annotations

import math

from . import sustained, touch
from .foreign import call
from .jit import inner, jit

ABA, MINVERSE, KINEMATICS, LEAST_NORM, CONTROL = 0, 2, 4, 6, 8
"""Where `calls` has the function; its arguments follow."""

STILL, ALLOWANCE, MARGIN, LEAST_MARGIN, UNIQUE, FAILED, EVALUATIONS, STIFFNESS, LENGTH, ERROR = range(10)
"""In `state`: the speed [m/s] below which the direction of slip is the one remembered; the force [N] by which
Coulomb's law may seem violated through rounding; by how much the forces keep to it, negative where the modes
do not hold, and the least of it since it was last set to infinity; whether the motion determines the forces,
else they are those of least norm; whether a call raised; how often v̇ was evaluated; the stiffness of
slip at the start of the step, see `collocation`; length and error of the step before, zero at a start."""

LEAST_EFFECTIVE = 1e-9
"""Effective inverse inertia of a slipping contact, over that without friction, that counts as none."""


@inner
def look(tree, points, i):
    """Return gap and gap rate of a contact at the kinematics last computed."""
    placement, local = tree[8], tree[9]
    constants, ends = points[0], points[1]
    tip, base = ends[i, 0], ends[i, 1]
    return touch.gap_and_rate(placement[tip], local[tip], placement[base], local[base], constants[i])


@jit
def kinematics(tree, state):
    """Compute placements and velocities at the state in the buffers."""
    calls = tree[0]
    if not call(calls[KINEMATICS], calls[KINEMATICS + 1]):
        state[FAILED] = 1.0


@jit
def gaps(tree, points, state, found):
    """Fill gap and gap rate (n, 2) of all contacts at the state in the buffers."""
    kinematics(tree, state)
    for i in range(len(found)):
        found[i, 0], found[i, 1] = look(tree, points, i)


@inner
def look_closely(tree, points, i, rows, velocity, acceleration, surface):
    """Fill what a closed contact needs, see `touch.contact_motion`; return the gap [m]."""
    placement, spatial, gained, columns = tree[8], tree[10], tree[11], tree[12]
    constants, ends, weights = points[0], points[1], points[2]
    tip, base = ends[i, 0], ends[i, 1]
    return touch.contact_motion(
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


@jit
def release(t, tree, state, powers):
    """Evaluate without contact forces: leave v̇ and the kinematics; fill the powers of control and joints."""
    calls, _, v, tau, given, clock = tree[:6]
    damping, sliding = tree[13], tree[14]
    if calls[CONTROL] != 0:
        clock[0] = t
        if not call(calls[CONTROL], calls[CONTROL + 1]) or state[FAILED] != 0.0:
            state[FAILED] = 1.0
            return
    state[EVALUATIONS] += 1.0
    sustained.joint_forces(v, given, damping, sliding, tau, powers)
    if not call(calls[ABA], calls[ABA + 1]):
        state[FAILED] = 1.0


@jit
def measure(tree, points, closed):
    """Take the numbers of what is closed, at the state last evaluated without contact forces."""
    which = closed[0]
    rows, velocity, acceleration, surface, gap = closed[8:13]
    for k in range(len(which)):
        gap[k] = look_closely(tree, points, which[k], rows[k], velocity[k], acceleration[k], surface[k])


@jit
def evaluate(t, tree, points, closed, state, out):
    """Fill `out` (nv + 4) with v̇ and the powers of control, joints, sliding friction and surfaces."""
    calls, acceleration, minverse = tree[0], tree[6], tree[7]
    n = len(acceleration)
    release(t, tree, state, out[n:])
    for j in range(n):
        out[j] = acceleration[j]
    which, modes, mu, reference, scalars, lower, upper = closed[:7]
    if len(which) + len(scalars) == 0 or state[FAILED] != 0.0:
        return
    if not call(calls[MINVERSE], calls[MINVERSE + 1]):
        state[FAILED] = 1.0
        return
    measure(tree, points, closed)
    rows, velocity, free, surface = closed[8:12]
    directions, equations, response, system, target, solution, force, scalar_force = closed[13:]
    effective = sustained.assemble(
        minverse,
        out[:n],
        rows,
        free,
        velocity,
        modes,
        mu,
        reference,
        state[STILL],
        scalars,
        directions,
        equations,
        response,
        system,
        target,
    )
    if sustained.solve(system, target, solution):
        state[UNIQUE] = 1.0
    else:
        state[UNIQUE] = 0.0
        if not call(calls[LEAST_NORM], calls[LEAST_NORM + 1]):
            state[FAILED] = 1.0
            return
    margin = sustained.finish(
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
    state[MARGIN] = -math.inf if effective <= LEAST_EFFECTIVE else state[ALLOWANCE] + margin
    state[LEAST_MARGIN] = min(state[LEAST_MARGIN], state[MARGIN])
