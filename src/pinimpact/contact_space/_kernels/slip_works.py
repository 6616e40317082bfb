"""The works of turning slip, by Gauss' collocation. (theory.md, 3.5 and 4)"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..._compile.jit import always_inlined, inlined
from .sensitivities import four, keep, scaled
from .slip_series import SETTLED, point

NODES = 12
"""Of Gauss' rule, which is right to rounding as far as any series in the half-angle goes."""


def _collocation() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes θ of Gauss' rule on (0, 1), its weights g, and a_ij/g_j, transposed. (3.17)"""
    x, w = np.polynomial.legendre.leggauss(NODES)
    values = np.polynomial.legendre.legvander(x, NODES)
    rising = np.empty((NODES, NODES))  # ∫ of each Legendre polynomial up to each node
    rising[:, 0] = x + 1.0
    for k in range(1, NODES):
        rising[:, k] = (values[:, k + 1] - values[:, k - 1]) / (2 * k + 1)
    return 0.5 * (x + 1.0), 0.5 * w, values[:, :NODES] * (np.arange(NODES) + 0.5) @ rising.T


ABSCISSAE, WEIGHTS, INTEGRALS = _collocation()


AT0, AT4, AT8 = np.int64(0), np.int64(4), np.int64(8)
"""Where the nodes stand, four at a time; no literals: see `codes`."""

WORK_SCRATCH = 5 * NODES
"""Floats of scratch space that works need, `nodes`: rows of what there is at the NODES. They are dP₃/dx and
dv₃/dx over the series' unit, times the weights; S (1 + t²); the terms of the last sum; x or y."""


@always_inlined
def _summed(values, row):
    """Return the sum of a row of `nodes`."""
    s0 = s1 = s2 = s3 = 0.0
    for i in range(row * NODES, (row + 1) * NODES, 4):
        s0, s1, s2, s3 = s0 + values[i], s1 + values[i + 1], s2 + values[i + 2], s3 + values[i + 3]
    return (s0 + s1) + (s2 + s3)


@always_inlined
def _collocated(values, v3, size):
    """Return the normal work and what v₃ grows by. (3.17)

    Four nodes at a time: their sums hide each other's latency, and share instructions. v₃ is that at the
    start, the size the length over the series' unit; for values see WORK_SCRATCH.
    """
    for i in range(0, NODES, 4):
        s0 = s1 = s2 = s3 = 0.0
        for j in range(NODES):
            term = values[NODES + j]
            s0, s1 = s0 + INTEGRALS[j, i] * term, s1 + INTEGRALS[j, i + 1] * term
            s2, s3 = s2 + INTEGRALS[j, i + 2] * term, s3 + INTEGRALS[j, i + 3] * term
        speed = raised((size, size, size, size), (s0, s1, s2, s3), v3)
        keep(values, 3 * NODES + i, product(four(values, i), speed))
    return size * _summed(values, 3), size * _summed(values, 1)


@always_inlined
def _places(i, x):
    """Return four nodes of (0, x), from the i-th on."""
    return scaled(x, four(ABSCISSAE, i))


@always_inlined
def product(x, y):
    """Return x y for four numbers x and y."""
    return x[0] * y[0], x[1] * y[1], x[2] * y[2], x[3] * y[3]


@always_inlined
def raised(s, y, c):
    """Return s y + c for four numbers s and y."""
    return s[0] * y[0] + c, s[1] * y[1] + c, s[2] * y[2] + c, s[3] * y[3] + c


@always_inlined
def _kept(values, i, x, s, u, h, j0, j1, j2):
    """Keep what WORK_SCRATCH tells of four nodes, with S = s + x u there."""
    t = h * x[0], h * x[1], h * x[2], h * x[3]
    chord = raised(t, t, 1.0)
    even = product(x, u)
    slope = product(chord, (s[0] + even[0], s[1] + even[1], s[2] + even[2], s[3] + even[3]))
    rate = raised(raised((j2, j2, j2, j2), t, j1), t, j0)
    weights = four(WEIGHTS, i)
    keep(values, i, product(product(slope, chord), weights))
    keep(values, NODES + i, product(product(slope, rate), weights))
    keep(values, 2 * NODES + i, slope)
    keep(values, 4 * NODES + i, x)


@inlined
def _along_half_angle(coefficients, h, j0, j1, j2, v3, unit, values, x):
    """Do what `works_so_far` does, with h of the series' `Shape`, j of dv₃/dP₃ (1 + t²) in powers of t.

    v₃ is that at the start, the unit that of P₃; for values see WORK_SCRATCH.
    """
    k = len(coefficients) - 1  # even
    z, first = x * x, coefficients[k]
    at0, at4, at8 = _places(AT0, x), _places(AT4, x), _places(AT8, x)
    y0, y4, y8 = product(at0, at0), product(at4, at4), product(at8, at8)
    s0 = s4 = s8 = (first, first, first, first)
    u0 = u4 = u8 = (0.0, 0.0, 0.0, 0.0)
    here, odd_here = first, 0.0
    while k > 1:
        k -= 2
        even, odd = coefficients[k], coefficients[k + 1]
        s0, s4, s8 = raised(s0, y0, even), raised(s4, y4, even), raised(s8, y8, even)
        u0, u4, u8 = raised(u0, y0, odd), raised(u4, y4, odd), raised(u8, y8, odd)
        here, odd_here = here * z + even, odd_here * z + odd
    _kept(values, AT0, at0, s0, u0, h, j0, j1, j2)
    _kept(values, AT4, at4, s4, u4, h, j0, j1, j2)
    _kept(values, AT8, at8, s8, u8, h, j0, j1, j2)
    work, change = _collocated(values, v3, unit * x)
    return work, change, here + x * odd_here


@always_inlined
def _rubbed(shape, values):
    """Return ∫ R dP₃ over the units of both, R at the start, and x, from what `_kept` has left."""
    q1, q2, q3, q4 = shape.q1, shape.q2, shape.q3, shape.q4
    for i in range(0, NODES, 4):
        at = four(values, 4 * NODES + i)
        fall = raised(raised(raised(raised((q4, q4, q4, q4), at, q3), at, q2), at, q1), at, 1.0)
        rubs = product(four(values, i), four(values, 2 * NODES + i))
        keep(values, 3 * NODES + i, product(rubs, fall))
    return _summed(values, 3)


@always_inlined
def works_so_far(series, nodes, x):
    """Return the normal work over (0, x) of a series in the half-angle, what v₃ grows by, and S. (3.17)"""
    shape = series.shape
    return _along_half_angle(
        *(series.coefficients, shape.h),
        *(series.j0, series.j1, series.j2, series.v3, shape.unit * series.scale),
        *(nodes, x),
    )


@always_inlined
def works(series, nodes, x):
    """Return the works of the normal impulse and of friction over (0, x)."""
    if series.around_invariant:
        return works_around(series, nodes, x)
    shape = series.shape
    work, _, _ = works_so_far(series, nodes, x)
    rubbed = x * _rubbed(shape, nodes)
    return work, -series.mu * series.speed * shape.factor * shape.unit * series.scale * rubbed


@always_inlined
def _decayed(length, rate, first):
    """Return e^{−rate·length} for four lengths, times a first value."""
    return (
        first * math.exp(-rate * length[0]),
        first * math.exp(-rate * length[1]),
        first * math.exp(-rate * length[2]),
        first * math.exp(-rate * length[3]),
    )


@inlined
def works_around(series, nodes, x):
    """Do what `works` does, for a series around an invariant direction, in parts of L. (4.7)"""
    shape, coefficients, mu = series.shape, series.coefficients, series.mu
    h, exponent, start, sign = shape.h, shape.exponent, shape.start, shape.sign
    v3, last = series.v3, coefficients[len(coefficients) - 1]
    normal = friction = low = 0.0
    # from here on the direction is settled or nothing is left: the rest is straight
    end = min(x, SETTLED / max(1.0, exponent))
    while low < end:
        # the integrand is analytic down to L ≈ −1, and falls or grows like e^{−2aL}
        width = min(end - low, 1.25 * (low + 1.0))
        if width * abs(exponent) > 3.5:
            width = 3.5 / abs(exponent)
        for i in range(0, NODES, 4):
            at = _places(i, width)
            length = sign * (low + at[0]), sign * (low + at[1]), sign * (low + at[2]), sign * (low + at[3])
            y = _decayed(length, 1.0, start)
            value = last, last, last, last
            for k in range(len(coefficients) - 2, -1, -1):
                value = raised(value, y, coefficients[k])
            value = product(value, _decayed(length, exponent, 1.0))
            _kept(nodes, i, y, value, (0.0, 0.0, 0.0, 0.0), h, series.j0, series.j1, series.j2)
        size = sign * shape.unit * series.scale * width
        work, change = _collocated(nodes, v3, size)
        normal += work
        v3 += change
        friction -= mu * series.speed * shape.factor * size * _rubbed(shape, nodes)
        low = low + width if low + width > low else end
    if end < x:
        here, there = point(series, end), point(series, x)
        span = there[0] - here[0]
        normal += span * (series.v3 + 0.5 * (here[3] + there[3]))
        friction -= 0.5 * mu * series.speed * span * (here[4] + there[4])
    return normal, friction
