"""Response of a robot to impulses: W and M⁻¹Jᵀ from M and the rows of J."""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign
from ..._numeric.products import products
from ..._numeric.tolerances import ROUNDING
from .tree import factor, solve, solve_transposed


@declared(FLOAT_ROWS, INTEGERS, FLOATS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def half_solve(mass, parents, mobility, lower, rows):
    """Compute L, N = LᵀL, and L⁻ᵀ D x for each row x. (1.7)

    Args:
        mass: (nv, nv) M.
        parents: (nv,) next velocity towards the root, or −1.
        mobility: (nv,) diagonal of D, 1 for free velocities and 0 for locked ones.
        lower: (nv, nv) is overwritten with L.
        rows: (m, nv) rows x; are overwritten with L⁻ᵀ D x.

    Returns:
        −1, or the index of the first velocity whose inertia is not positive.
    """
    n = len(mobility)
    scaled = np.empty((n, n))  # of ancestors only, as L
    for i in range(n):
        j = i
        while j >= 0:
            scaled[i, j] = mass[i, j] * (mobility[i] * mobility[j])
            j = parents[j]
        scaled[i, i] = mass[i, i] if mobility[i] > 0.0 else 1.0  # a locked joint may be without inertia
        for row in rows:
            row[i] *= mobility[i]
    stopped = factor(scaled, parents, lower)
    if stopped < 0:
        solve_transposed(lower, parents, rows)
    return stopped


@declared(FLOAT_ROWS, INTEGERS, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def respond(lower, parents, mobility, y, delassus, response):
    """Fill `delassus` (m, m) with y yᵀ and `response` (m, nv) with D L⁻¹ y for rows y of `half_solve`."""
    products(y, y, delassus)
    for a in range(len(y)):
        assign(response[a], y[a])
    solve(lower, parents, response)
    for row in response:
        for i in range(len(row)):
            row[i] *= mobility[i]


@declared(FLOAT_ROWS, FLOATS, FLOATS, float, int, INTEGERS)
@jit
def taking_part(delassus, friction, rates, least, first, found):
    """Mark which of n contacts take part in an impact at contact `first`.

    These are contacts that approach and are coupled to another of them, and those that an impulse of another
    can press. Any impulse within the friction cones lifts all other contacts, so they have no impulse.

    Args:
        delassus: (3n, 3n) W.
        friction: (n,) μ.
        rates: (n,) normal velocities.
        least: Speed of approach that is taken as zero.
        first: Index of a contact that takes part.
        found: (n,) is overwritten with 1 for contacts that take part, else 0.

    Returns:
        Whether any of them is coupled to another contact.
    """
    n = len(found)
    own = np.empty(n)
    coupled = False
    for i in range(n):
        own[i] = _largest(delassus, i, i)
        found[i] = 1 if i == first else 0
    waiting = np.empty(n, dtype=np.int64)
    waiting[0], count = first, 1
    while count > 0:
        count -= 1
        i = waiting[count]
        x, y, z = 3 * i, 3 * i + 1, 3 * i + 2
        for j in range(n):
            size = _largest(delassus, i, j)
            if found[j] != 0 or not size * size > ROUNDING * ROUNDING * own[i] * own[j]:
                continue
            coupled = True
            of_normal = delassus[3 * j + 2]
            lift = of_normal[z] - friction[i] * math.hypot(of_normal[x], of_normal[y])
            if rates[j] < -least or lift < 0.0:
                found[j] = 1
                waiting[count] = j
                count += 1
    return coupled


@inlined
def _largest(delassus, i, j):
    """Return the largest magnitude in the block (3, 3) of W for contacts i and j."""
    largest = 0.0
    for a in range(3 * i, 3 * i + 3):
        for b in range(3 * j, 3 * j + 3):
            largest = max(largest, abs(delassus[a, b]))
    return largest
