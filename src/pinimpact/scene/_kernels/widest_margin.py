"""By how much forces can keep to their laws where the motion does not determine them. (theory.md, 11)

Of all x with (G M⁻¹H) x = −a⁰ (9.3) those that keep farthest from their bounds:

    maximise m   with   x₃ ≥ m (slip),   μx₃ − |x_t| ≥ m (stick),   x − lower ≥ m,   upper − x ≥ m.

The maximum is continuous in the state, and the modes hold exactly as long as it is not negative.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.ahead import ahead
from ..._numeric.cone_program import cone_program
from ..._numeric.jit import inner, separate
from ..._numeric.least_norm import least_norm
from .contact_forces import SINGULAR_STILL, SLIP, STICK
from .workspace import SceneWorkspace

ACCURACY = 1e-13
LARGEST = 1e4
"""Forces beyond this times what the loads call for are not looked for."""


@ahead(SceneWorkspace)
@separate
def widest_margin(work):
    """Return the largest margin of all forces that the modes need at the state last evaluated [N]."""
    system, target, modes, mu = work.system, work.target, work.closed_mode, work.closed_friction
    lower, upper = work.scalar_lower, work.scalar_upper
    size, nc, ns = len(target), len(modes), len(lower)
    x, null = np.empty(size), np.empty((size, size))
    rank = least_norm(system, target, SINGULAR_STILL, x, null)
    free = size - rank
    unit = 0.0
    for a in range(size):
        unit = max(unit, abs(x[a]))
    for m in range(ns):
        if lower[m] > -math.inf:
            unit = max(unit, abs(lower[m]))
        if upper[m] < math.inf:
            unit = max(unit, abs(upper[m]))
    if unit == 0.0:
        return 0.0
    n = free + 1
    lines, cones = 1, 0
    for k in range(nc):
        lines += modes[k] == SLIP
        cones += modes[k] == STICK
    for m in range(ns):
        lines += (lower[m] > -math.inf) + (upper[m] < math.inf)
    rows = lines + 3 * cones + n
    G, h = np.zeros((rows, n)), np.zeros(rows)
    G[0, free], h[0] = 1.0, 1.0  # where forces can grow without end the margin is that of the loads
    line, cone, a = 1, lines, 0
    for k in range(nc):
        if modes[k] == SLIP:
            bound_row(G, h, line, 1.0, x[a] / unit, null, free, a)
            line += 1
            a += 1
            continue
        if modes[k] == STICK:
            bound_row(G, h, cone, mu[k], x[a + 2] * mu[k] / unit, null, free, a + 2)
            for d in range(2):
                bound_row(G, h, cone + 1 + d, 1.0, x[a + d] / unit, null, free, a + d)
                G[cone + 1 + d, free] = 0.0
            cone += 3
        a += 3
    for m in range(ns):
        if lower[m] > -math.inf:
            bound_row(G, h, line, 1.0, (x[a] - lower[m]) / unit, null, free, a)
            line += 1
        if upper[m] < math.inf:
            bound_row(G, h, line, -1.0, (upper[m] - x[a]) / unit, null, free, a)
            line += 1
        a += 1
    h[cone] = LARGEST
    for j in range(free):
        G[cone + 1 + j, j] = -1.0
    sizes = np.full(cones + 1, 3)
    sizes[cones] = n
    P, c = np.zeros((n, n)), np.zeros(n)
    c[free] = -1.0
    y, s, z = np.empty(n), np.empty(rows), np.empty(rows)
    cone_program(P, c, G, h, lines, sizes, ACCURACY, y, s, z)
    return unit * y[free]


@inner
def bound_row(G, h, row, factor, value, null, free, a):
    """Fill a row of G and h for factor · x_a − m, of which value is the part at the forces of least norm."""
    for j in range(free):
        G[row, j] = -factor * null[j, a]
    G[row, free] = 1.0
    h[row] = value
