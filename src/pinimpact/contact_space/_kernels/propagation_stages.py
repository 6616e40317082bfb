"""Stages of the implicit steps of an impact at several contacts. (theory.md, section 14.9)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, Floats, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import largest
from ..._numeric.products import add, apply
from ..._numeric.semidefinite import cholesky, substitute
from ..._numeric.tolerances import EPS, LITTLE, ROUNDOFF
from .tolerances import NEGLIGIBLE

TURNS, SEARCHES, SLOPE = 60, 60, 0.1
"""Largest numbers of iterations of Newton's method and of its line search, and the ratio to which the search
reduces the slope."""

ROUNDS = 20
"""Largest number of alternations between stiff normal forces and friction bounds before a shorter step."""


class Springs(NamedTuple):
    """Parameters of the normal forces of n contacts. (14.9)

    Attributes:
        largest: (n,) x*, the largest penetration so far.
        peak: (n,) δ*, the indentation there.
        restitution: (n,) e.
        stiffness: (n,) κ.
        exponent: η.
    """

    largest: Floats
    peak: Floats
    restitution: Floats
    stiffness: Floats
    exponent: float


@inlined
def force_at(springs, j, x):
    """Return F of contact j at the penetration x."""
    depth = _depth(springs, j, x)
    return springs.stiffness[j] * (depth if springs.exponent == 1.0 else depth**springs.exponent)


@inlined
def _depth(springs, j, x):
    """Return max(δ, 0) of contact j at the penetration x. (14.9)"""
    deeper, e = x - springs.largest[j], springs.restitution[j]
    return max(springs.peak[j] + (deeper if deeper >= 0.0 else deeper / (e * e)), 0.0)


@inlined
def _hardness(springs, j, x):
    """Return dF/dx of contact j at the penetration x."""
    depth, e = _depth(springs, j, x), springs.restitution[j]
    if depth == 0.0:
        return 0.0
    rate = 1.0 if x >= springs.largest[j] else 1.0 / (e * e)
    return rate * springs.stiffness[j] * springs.exponent * depth ** (springs.exponent - 1.0)


@inlined
def find_stage(rows, friction, creep, springs, stiff, x, part, target, y, v, force, bound):
    """Solve a stage; return whether friction bounds and normal forces of stiff contacts have converged.

    Args:
        friction: (n,) μ.
        force: (3n,) forces; the normal ones of stiff contacts are updated.
        bound: (n,) scratch.
        rows, creep, springs, stiff, x, part, target, y, v: As for `minimize`.
    """
    for _ in range(ROUNDS):
        for j in range(len(x)):
            bound[j] = part * friction[j] * force[3 * j + 2]
        minimize(rows, bound, creep, springs, stiff, x, part, target, y, v)
        change = 0.0
        for j in range(len(x)):
            if stiff[j]:
                z = 3 * j + 2
                normal = force_at(springs, j, x[j] - part * v[z])
                change = max(change, part * friction[j] * abs(normal - force[z]))
                force[z] = normal
        if change <= LITTLE * creep:
            return True
    return False


@declared(
    *(FLOAT_ROWS, FLOATS, float, Springs, FLAGS, FLOATS, float, FLOATS, FLOATS, FLOATS),
    result=bool,
)
@external
def minimize(rows, bound, creep, springs, stiff, x, part, target, y, v):
    """Minimize (14.10) by Newton's method with a line search; return whether it has converged.

    Args:
        rows: (3n, r) J.
        bound: (n,) factors h a μ F of H.
        creep: ε.
        springs: The `Springs`.
        stiff: (n,) whether the spring of a contact is implicit.
        x: (n,) penetrations; those of stiff contacts without the implicit term −`part` v₃.
        part: h a.
        target: (r,) c.
        y: (r,) initial guess; is overwritten with the minimum.
        v: (3n,) velocities at y; is updated with it.
    """
    rows, bound, springs, stiff = borrowed(rows), borrowed(bound), borrowed(springs), borrowed(stiff)
    x, target, y, v = borrowed(x), borrowed(target), borrowed(y), borrowed(v)
    n, r = len(bound), len(y)
    gradient, matrix, step, change = np.empty(r), np.empty((r, r)), np.empty(r), np.empty(3 * n)
    strongest, last = largest(bound), math.inf
    for _ in range(TURNS):
        for k in range(r):
            gradient[k] = y[k] - target[k]
        noise = LITTLE * creep
        for j in range(n):
            if stiff[j]:
                deep = x[j] - part * v[3 * j + 2]
                push = part * force_at(springs, j, deep)
                strongest = max(strongest, push)
                noise = max(noise, EPS * part * _hardness(springs, j, deep) * (abs(x[j]) + springs.peak[j]))
                add(gradient, -push, rows[3 * j + 2])
            if bound[j] > 0.0:
                ax, ay = v[3 * j], v[3 * j + 1]
                rub = bound[j] / max(math.sqrt(ax * ax + ay * ay), creep)
                add(gradient, rub * ax, rows[3 * j])
                add(gradient, rub * ay, rows[3 * j + 1])
        residual = largest(gradient)
        if residual <= noise or (residual <= ROUNDOFF + NEGLIGIBLE * strongest and residual > 0.5 * last):
            return True
        last = residual
        _curvature(rows, bound, creep, springs, stiff, x, part, v, matrix)
        cholesky(matrix)
        for k in range(r):
            step[k] = -gradient[k]
        substitute(matrix, step)
        apply(rows, step, change)
        length = _search(bound, creep, springs, stiff, x, part, target, y, step, v, change)
        add(y, length, step)
        add(v, length, change)
    return False


@inlined
def _curvature(rows, bound, creep, springs, stiff, penetration, part, v, matrix):
    """Compute the lower triangle of the Hessian (r, r) of (14.10)."""
    r = len(matrix)
    for k in range(r):
        for m in range(k + 1):
            matrix[k, m] = 1.0 if k == m else 0.0
    for j in range(len(bound)):
        x, y, z = 3 * j, 3 * j + 1, 3 * j + 2
        if stiff[j]:
            hard = part * part * _hardness(springs, j, penetration[j] - part * v[z])
            if hard > 0.0:
                for k in range(r):
                    for m in range(k + 1):
                        matrix[k, m] += hard * rows[z, k] * rows[z, m]
        if bound[j] > 0.0:
            speed = math.sqrt(v[x] * v[x] + v[y] * v[y])
            xx = yy = bound[j] / max(speed, creep)
            xy = 0.0
            if speed > creep:
                ux, uy = v[x] / speed, v[y] / speed
                xx, yy, xy = xx * uy * uy, yy * ux * ux, -xx * ux * uy
            for k in range(r):
                px, py = xx * rows[x, k] + xy * rows[y, k], xy * rows[x, k] + yy * rows[y, k]
                for m in range(k + 1):
                    matrix[k, m] += px * rows[x, m] + py * rows[y, m]


@inlined
def _search(bound, creep, springs, stiff, x, part, target, y, step, v, change):
    """Return the length of a Newton step: 1, or where the slope of (14.10) along it is nearly zero.

    `step` (r,) is the change of y and `change` (3n,) that of v; other arguments as in `minimize`.
    """
    begin = square = 0.0
    for k in range(len(y)):
        begin += (y[k] - target[k]) * step[k]
        square += step[k] * step[k]
    least, most, far, first = 0.0, 0.0, 0.0, 0.0
    for search in range(SEARCHES):
        slope = begin + far * square
        for j in range(len(bound)):
            if stiff[j]:
                dz = change[3 * j + 2]
                slope -= part * dz * force_at(springs, j, x[j] - part * (v[3 * j + 2] + far * dz))
            if bound[j] > 0.0:
                dx, dy = change[3 * j], change[3 * j + 1]
                ax, ay = v[3 * j] + far * dx, v[3 * j + 1] + far * dy
                slope += bound[j] * (ax * dx + ay * dy) / max(math.sqrt(ax * ax + ay * ay), creep)
        if search == 0:
            first, far = abs(slope), 1.0
            continue
        if abs(slope) <= SLOPE * first or (far == 1.0 and slope < 0.0):
            break
        if slope > 0.0:
            most = far
        else:
            least = far
        far = 0.5 * (least + most)
    return far
