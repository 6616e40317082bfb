"""The force margin of the modes where forces are not unique, as a cone program. (theory.md, 11.6)

Among all x with (G M⁻¹H) x = −a° (9.3) that leave the motion unchanged,

    maximise m   with   x₃ ≥ m (slip),   μx₃ − |x_t| ≥ m (stick),   x − lower ≥ m,   upper − x ≥ m.   (11.6)

The maximum is continuous in the state, and the modes hold exactly as long as it is not negative. Forces are
taken as zero within `row_tolerance`, which is added to the margins.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import declared
from ..._compile.jit import external, inlined
from ..._numeric.cone_program import CONE, cone_program
from ..._numeric.least_norm import least_norm
from ..._numeric.loops import assign, repeated
from ..._numeric.tolerances import NOISE
from .contact_forces import SLIP, STICK, slips_with_friction
from .tolerances import NEGLIGIBLE
from .workspace import SceneWorkspace

LARGEST = 1e4
"""Bound on changes of forces in the null space, relative to `largest_force`: keeps the program bounded."""


@declared(SceneWorkspace, bool, result=float)
@external
def widest_margin(work, same_motion):
    """Return the largest margin, with `row_tolerance`, of all forces at the state last evaluated [N]. (11.6)

    If `same_motion`, that of all forces with the same motion.
    """
    size = len(work.target)
    x, null = np.empty(size), np.empty((size, size))
    free = size - least_norm(work.system, work.target, work.rank_tolerance, x, null)
    if same_motion and slips_with_friction(work):
        free = keep_motion(work, x, null, free)
    unit = largest_force(work, x)
    if unit == 0.0:
        return work.row_tolerance.min()
    n = free + 1
    lines, cones = count_bounds(work)
    lines += 1
    rows = lines + 3 * cones + n
    G, h = np.zeros((rows, n)), np.zeros(rows)
    G[0, free], h[0] = 1.0, 1.0  # m ≤ unit: where forces can grow without bound, so could the margin
    cone = fill_bounds(work, x, null, free, unit, 1.0, G, h, 1, lines)
    h[cone] = LARGEST
    for j in range(free):
        G[cone + 1 + j, j] = -1.0
    sizes = repeated(cones + 1, CONE)
    sizes[cones] = n
    P, c = np.zeros((n, n)), np.zeros(n)
    c[free] = -1.0
    y, s, z = np.empty(n), np.empty(rows), np.empty(rows)
    cone_program(P, c, G, h, lines, sizes, NOISE, y, s, z)
    return unit * y[free]


@inlined
def keep_motion(work, x, null, free):
    """Restrict the null space of (9.3) to changes of the forces that leave the motion unchanged.

    `x` (rows,) is overwritten with the forces last evaluated. The first `free` rows of `null` are a basis of
    the null space; they are overwritten with a basis of the subspace, whose dimension is returned.
    """
    response = work.force_response
    size, n = response.shape
    effects, no_change, none = np.zeros((n, free)), np.zeros(n), np.empty(free)
    largest = whole = 0.0
    for j in range(n):
        for c in range(free):
            parts = 0.0
            for m in range(size):
                effects[j, c] += response[m, j] * null[c, m]
                parts += abs(response[m, j] * null[c, m])
            largest, whole = max(largest, abs(effects[j, c])), max(whole, parts)
    assign(x, work.solution)
    if largest <= NEGLIGIBLE * whole:
        return free
    basis, kept = np.zeros((free, free)), np.zeros((free, size))
    left = free - least_norm(effects, no_change, NEGLIGIBLE * whole / largest, none, basis)
    for c in range(left):
        for d in range(free):
            for m in range(size):
                kept[c, m] += basis[c, d] * null[d, m]
    for c in range(left):
        assign(null[c], kept[c])
    return left


@inlined
def least_admissible(work, x):
    """Fill x (rows,) with the forces of least norm that satisfy their bounds, or nearly if there are none."""
    size = len(work.target)
    null = np.empty((size, size))
    free = size - least_norm(work.system, work.target, work.rank_tolerance, x, null)
    if slips_with_friction(work):
        free = keep_motion(work, x, null, free)
    unit = largest_force(work, x)
    if unit == 0.0 or free == 0:
        return
    lines, cones = count_bounds(work)
    rows = lines + 3 * cones
    G, h = np.zeros((rows, free)), np.zeros(rows)
    fill_bounds(work, x, null, free, unit, 0.0, G, h, 0, lines)
    P, c = np.eye(free), np.zeros(free)  # x is orthogonal to the null space
    y, s, z = np.zeros(free), np.empty(rows), np.empty(rows)
    cone_program(P, c, G, h, lines, repeated(cones, CONE), NOISE, y, s, z)
    for j in range(free):
        for a in range(size):
            x[a] += unit * y[j] * null[j, a]


@inlined
def largest_force(work, x):
    """Return the largest magnitude of forces x and finite bounds [N], the unit of the cone program."""
    lower, upper = work.scalar_lower, work.scalar_upper
    unit = 0.0
    for force in x:
        unit = max(unit, abs(force))
    for m in range(len(lower)):
        if lower[m] > -math.inf:
            unit = max(unit, abs(lower[m]))
        if upper[m] < math.inf:
            unit = max(unit, abs(upper[m]))
    return unit


@inlined
def count_bounds(work):
    """Return the numbers of half-lines and of second-order cones that bound the forces."""
    lower, upper = work.scalar_lower, work.scalar_upper
    lines = cones = 0
    for mode in work.active_mode:
        lines += mode == SLIP
        cones += mode == STICK
    for m in range(len(lower)):
        lines += int(lower[m] > -math.inf) + int(upper[m] < math.inf)
    return lines, cones


@inlined
def fill_bounds(work, x, null, free, unit, margin, G, h, line, cone):
    """Fill the rows of G and h, zero before, for the bounds of x + nullᵀy (h − G y in the cone).

    Args:
        work: The workspace.
        x: (rows,) forces for y = 0 [N].
        null: (free, rows) basis of the changes.
        free: Number of unknowns y.
        unit: Unit of forces [N].
        margin: 1 if a last unknown m is the margin from the bounds, with `row_tolerance`; 0 without it.
        G, h: Matrix and vector of the cone program.
        line, cone: Rows of the first half-line and of the first cone.

    Returns:
        The row after the last cone.
    """
    modes, mu = work.active_mode, work.active_friction
    lower, upper = work.scalar_lower, work.scalar_upper
    slack = margin * work.row_tolerance
    a = 0
    for k in range(len(modes)):
        if modes[k] == SLIP:
            bound_row(G, h, line, 1.0, (x[a] + slack[a]) / unit, null, free, a, margin)
            line += 1
            a += 1
            continue
        if modes[k] == STICK:
            bound_row(G, h, cone, mu[k], (x[a + 2] * mu[k] + slack[a + 2]) / unit, null, free, a + 2, margin)
            for d in range(2):
                bound_row(G, h, cone + 1 + d, 1.0, x[a + d] / unit, null, free, a + d, 0.0)
            cone += 3
        a += 3
    for m in range(len(lower)):
        if lower[m] > -math.inf:
            bound_row(G, h, line, 1.0, (x[a] - lower[m] + slack[a]) / unit, null, free, a, margin)
            line += 1
        if upper[m] < math.inf:
            bound_row(G, h, line, -1.0, (upper[m] - x[a] + slack[a]) / unit, null, free, a, margin)
            line += 1
        a += 1
    return cone


@inlined
def bound_row(G, h, row, factor, value, null, free, a, margin):
    """Fill a row of G and h for factor · x_a − margin · m, which is `value` at y = 0 and m = 0."""
    for j in range(free):
        G[row, j] = -factor * null[j, a]
    if margin > 0.0:
        G[row, free] = margin
    h[row] = value
