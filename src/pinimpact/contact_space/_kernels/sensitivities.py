"""Layout of the sensitivities of an impact, and operations on their rows. (derivatives.md)

Rows are processed four numbers at a time, for vector instructions.
"""

from __future__ import annotations

import numpy as np

from ..._compile.jit import always_inlined

V1, V2, V3, B1, B2, C, MEAN, SKEW, CHI, MU, E = (np.int64(i) for i in range(11))
"""Columns of sensitivities, with W = [[A, b], [bᵀ, c]] and A = MEAN + [[SKEW, CHI], [CHI, −SKEW]]."""

ROW = 12
"""Length of a row of sensitivities, a multiple of four; the last number is unused."""

ROWS = 14
VT1, VT2, PATH, STOP, NORMAL, WORK_DONE, COMPRESSED, END, *_ENDS = (np.int64(ROW * i) for i in range(ROWS))
"""Offsets of rows of sensitivities in scratch: v_t and k·∫v_t dP₃ at fixed P₃, and the P₃ at which v_t = 0;
v₃ and its work at fixed P₃, the impulse or work of compression, and the P₃ at the end."""

OUT1, OUT2, OUT3, P1, P2, P3 = _ENDS
"""Offsets of the rows of v⁺ and P."""


@always_inlined
def four(values, k):
    """Return four numbers from the k-th on."""
    return values[k], values[k + 1], values[k + 2], values[k + 3]


@always_inlined
def keep(values, k, x):
    """Set four numbers from the k-th on."""
    values[k], values[k + 1], values[k + 2], values[k + 3] = x


@always_inlined
def scaled(c, x):
    """Return c x for four numbers x."""
    return c * x[0], c * x[1], c * x[2], c * x[3]


@always_inlined
def minus(x, y):
    """Return x − y for four numbers x and y."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3]


@always_inlined
def plus(x, y):
    """Return x + y for four numbers x and y."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3]


@always_inlined
def combine(values, out, a, i, b, j):
    """Fill a row of sensitivities with a times the row at i and b times that at j."""
    for k in range(0, ROW, 4):
        keep(values, out + k, plus(scaled(a, four(values, i + k)), scaled(b, four(values, j + k))))


@always_inlined
def clear_rows(values, last):
    """Fill rows of sensitivities with zeros, up to, but not including, offset `last`."""
    for k in range(VT1, last, 4):
        keep(values, k, (0.0, 0.0, 0.0, 0.0))


@always_inlined
def add_response(values, k, s1, s2, by_b, by_a, x):
    """Add the response to the k-th θ of `slip_panels._add_sources`, along σ, to rows VT1, VT2 and PATH.

    `by_b` and `by_a` are factors for b and A, x (3) the response of each row to ∂F/∂θ.
    """
    cos2, sin2 = s1 * s1 - s2 * s2, 2.0 * s1 * s2
    turns = (s1, s2), (-s2, s1), (-cos2, -sin2), (sin2, -cos2), (-1.0, 0.0)
    by = by_b if k < 2 else by_a
    j = B1 if k < 2 else SKEW if k < 4 else MEAN
    u, w = by * turns[k][0], by * turns[k][1]
    values[VT1 + j], values[VT1 + j + 1] = values[VT1 + j] + u * x[0], values[VT1 + j + 1] + w * x[0]
    values[VT2 + j], values[VT2 + j + 1] = values[VT2 + j] + u * x[1], values[VT2 + j + 1] + w * x[1]
    values[PATH + j], values[PATH + j + 1] = values[PATH + j] + u * x[2], values[PATH + j + 1] + w * x[2]


@always_inlined
def arrive(values, s1, s2, per, mu, x, y, sources):
    """Propagate the sensitivities to the end of a part of slip, by their linear map (D3).

    Args:
        values: Rows of sensitivities; VT1, VT2 and PATH are overwritten.
        s1, s2: σ at the start.
        per: 1/ω.
        mu: μ.
        x, y: (3) response of these rows to changes of v_t along σ and across.
        sources: (5, 3) their response to each θ of `slip_panels._add_sources`.
    """
    m11, m12 = x[0] * s1 - y[0] * s2, x[0] * s2 + y[0] * s1
    m21, m22 = x[1] * s1 - y[1] * s2, x[1] * s2 + y[1] * s1
    m31, m32 = per * (x[2] * s1 - y[2] * s2), per * (x[2] * s2 + y[2] * s1)
    for k in range(0, ROW, 4):
        a, b, path = four(values, VT1 + k), four(values, VT2 + k), four(values, PATH + k)
        keep(values, VT1 + k, plus(scaled(m11, a), scaled(m12, b)))
        keep(values, VT2 + k, plus(scaled(m21, a), scaled(m22, b)))
        keep(values, PATH + k, plus(path, plus(scaled(m31, a), scaled(m32, b))))
    for k in range(5):
        x1, x2, x3 = sources[k]
        add_response(values, k, s1, s2, per, mu * per, (x1, x2, per * x3))
