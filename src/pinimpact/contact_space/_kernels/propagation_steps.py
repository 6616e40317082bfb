"""An impact at many contacts by short steps of equal length, where events cannot be followed one by one.

(theory.md, section 14)
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import inlined, jit
from .first_fall import NEVER

SWEEPS, FORCES = 200, 1e-10
"""Of Gauss and Seidel at most in a step, and the change of accelerations in one that ends them."""

STILL = 1e-13
"""A change of velocities in unit time, with velocities, that is none: friction has locked what is left."""

SLOW = 1e-10
"""Part of the largest velocity below which what approaches, or can come to, is at rest."""


@declared(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, float, float, int, FLOATS, FLOATS, FLOAT_ROWS)
@jit
def step_through(w, start, friction, restitution, stiffness, exponent, h, most, v, impulse, works):
    """Resolve an impact at n contacts by semi-implicit steps: first-order in h. (14.1), (14.2)

    Indentations go half a step, forces follow from them, friction opposes the velocities at the end of the
    step, and indentations go the other half.

    Args:
        w: (3n, 3n) W.
        start: (3n,) velocities before it, the largest of size one.
        friction: (n,) μ.
        restitution: (n,) e, of the energetic law, > 0.
        stiffness: (n,) κ, with κ W₃₃ ≤ 1.
        exponent: η, 1 or 3/2.
        h: The length of a step.
        most: A bound on their number.
        v: (3n,) takes the velocities after it.
        impulse: (3n,) takes P.
        works: (n, 3) takes the works of compression, restitution and friction.

    Returns:
        The number of steps; 0: the bound has been reached.
    """
    n = len(friction)
    depth, deepest, force = np.zeros(n), np.zeros(n), np.zeros(3 * n)
    softest, before = np.empty(n), np.empty(3 * n)
    for j in range(n):
        x, y = 3 * j, 3 * j + 1
        middle, half = 0.5 * (w[x, x] + w[y, y]), 0.5 * (w[x, x] - w[y, y])
        softest[j] = middle + math.hypot(half, w[x, y])
        works[j] = 0.0
    for i in range(3 * n):
        v[i], impulse[i] = start[i], 0.0
    for step in range(1, most + 1):
        speed, time, pressed = _outlook(w, stiffness, exponent, v, depth)
        if not pressed:
            if time == NEVER:
                return step
            for j in range(n):
                depth[j] -= time * v[3 * j + 2]
        if speed <= SLOW:
            return step
        for j in range(n):
            _indent(depth, deepest, j, v[3 * j + 2], 0.5 * h, restitution[j])
            force[3 * j + 2] = h * stiffness[j] * max(depth[j], 0.0) ** exponent
        for i in range(3 * n):
            before[i] = v[i]
            for k in range(3 * n):
                v[i] += w[i, k] * force[k]
        _rub(w, friction, softest, force, FORCES * h, v)
        changed = 0.0
        for j in range(n):
            x, z = 3 * j, 3 * j + 2
            work = 0.5 * (before[z] + v[z]) * force[z]
            works[j, 0 if work < 0.0 else 1] += work
            for i in range(x, z):
                works[j, 2] += 0.5 * (before[i] + v[i]) * force[i]
            for i in range(x, z + 1):
                impulse[i] += force[i]
                changed = max(changed, abs(v[i] - before[i]) + (abs(v[i]) if depth[j] > 0.0 else 0.0))
            _indent(depth, deepest, j, v[z], 0.5 * h, restitution[j])
        if pressed and changed <= STILL * h:  # locked by friction
            return step
    return 0


@inlined
def _outlook(w, stiffness, exponent, v, depth):
    """Return the speed of approach, now or to come, the time to the next closing, and if any is pressed."""
    speed, time, pressed = 0.0, NEVER, False
    for j in range(len(depth)):
        z = 3 * j + 2
        approach = -v[z]
        if depth[j] > 0.0:
            pressed = True
            stored = stiffness[j] * depth[j] ** (exponent + 1.0)
            approach = max(approach, math.sqrt(2.0 * stored / (exponent + 1.0) * w[z, z]))
        elif approach > 0.0:
            if depth[j] == 0.0:
                pressed = True
            time = min(time, -depth[j] / approach)
        speed = max(speed, approach)
    return speed, time, pressed


@inlined
def _indent(depth, deepest, j, velocity, h, e):
    """Let the indentation of a contact follow its velocity for a time h."""
    way = -velocity * h
    if way > 0.0:
        if depth[j] < 0.0:  # through its gap
            part = min(way, -depth[j])
            depth[j] += part
            way -= part
        if way > 0.0 and depth[j] < deepest[j]:  # elastic reloading
            part = min(way, (deepest[j] - depth[j]) * e * e)
            depth[j] += part / (e * e)
            way -= part
            if way > 0.0:
                depth[j] = deepest[j]
        if way > 0.0:
            depth[j] += way
            deepest[j] = depth[j]
    else:
        way = -way
        if depth[j] > 0.0:
            part = min(way, depth[j] * e * e)
            depth[j] -= part / (e * e)
            way -= part
            if way > 0.0:
                depth[j] = 0.0
        if way > 0.0:
            depth[j] -= way
            deepest[j] = 0.0


@inlined
def _rub(w, friction, softest, force, enough, v):
    """Let friction at known normal forces oppose the velocities at the end of a step. (14.3)

    Begins with the forces of the step before; v comes with these, and takes what new ones change.
    """
    n = len(friction)
    for _ in range(SWEEPS):
        change = 0.0
        for j in range(n):
            x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
            bound = friction[j] * force[z]
            if not softest[j] > 0.0 or (bound == 0.0 and force[x] == 0.0 and force[y] == 0.0):
                continue
            fx, fy = force[x] - v[x] / softest[j], force[y] - v[y] / softest[j]
            length = math.hypot(fx, fy)
            if length > bound:
                fx, fy = fx * bound / length, fy * bound / length
            dx, dy = fx - force[x], fy - force[y]
            change = max(change, (abs(dx) + abs(dy)) * softest[j])
            force[x], force[y] = fx, fy
            for i in range(3 * n):
                v[i] += w[i, x] * dx + w[i, y] * dy
        if change <= enough:
            break
