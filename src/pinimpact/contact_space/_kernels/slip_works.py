"""Normal and frictional work of turning slip, by Gauss collocation. (theory.md, 3.5 and 4)"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..._compile.jit import always_inlined, inlined
from .sensitivities import four, keep, scaled
from .slip_series import SETTLED, point

NODES = 12
"""Number of nodes of the Gauss rule; its error is below rounding for any series in the half-angle."""


def _collocation() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes θ and weights g of the Gauss rule on (0, 1), and a_ij/g_j, transposed. (3.17)"""
    x, w = np.polynomial.legendre.leggauss(NODES)
    values = np.polynomial.legendre.legvander(x, NODES)
    rising = np.empty((NODES, NODES))  # ∫ of each Legendre polynomial up to each node
    rising[:, 0] = x + 1.0
    for k in range(1, NODES):
        rising[:, k] = (values[:, k + 1] - values[:, k - 1]) / (2 * k + 1)
    return 0.5 * (x + 1.0), 0.5 * w, values[:, :NODES] * (np.arange(NODES) + 0.5) @ rising.T


ABSCISSAE, WEIGHTS, INTEGRALS = _collocation()


AT0, AT4, AT8 = np.int64(0), np.int64(4), np.int64(8)
"""Indices of the groups of four nodes that are evaluated together; not literals, see `codes`."""

WORK_SCRATCH = 5 * NODES
"""Length of the scratch array `nodes`. Its five rows hold, at the nodes, dP₃/dx and dv₃/dx over the unit of
the series, times the weights; S (1 + t²); the terms of the last sum; x or y."""


@always_inlined
def _summed(values, row):
    """Return the sum of a row of WORK_SCRATCH."""
    s0 = s1 = s2 = s3 = 0.0
    for i in range(row * NODES, (row + 1) * NODES, 4):
        s0, s1, s2, s3 = s0 + values[i], s1 + values[i + 1], s2 + values[i + 2], s3 + values[i + 3]
    return (s0 + s1) + (s2 + s3)


@always_inlined
def _collocated(values, v3, size):
    """Return the normal work and Δv₃. (3.17)

    Four nodes at a time, for vector instructions and to hide their latency.

    Args:
        values: Scratch of WORK_SCRATCH.
        v3: v₃ at the start.
        size: Length of the interval times the unit of the series.
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
def _fill_nodes(values, i, x, s, u, h, j0, j1, j2):
    """Fill WORK_SCRATCH at four nodes from i on, with S = s + x u; h, j as for `_along_half_angle`."""
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
    """Return the result of `works_so_far`.

    Args:
        coefficients, h: Of the series, and of its `Shape`.
        j0, j1, j2: Coefficients of (3.16).
        v3: v₃ at the start.
        unit: Unit of P₃.
        values: Scratch of WORK_SCRATCH.
        x: End of the interval.
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
    _fill_nodes(values, AT0, at0, s0, u0, h, j0, j1, j2)
    _fill_nodes(values, AT4, at4, s4, u4, h, j0, j1, j2)
    _fill_nodes(values, AT8, at8, s8, u8, h, j0, j1, j2)
    work, change = _collocated(values, v3, unit * x)
    return work, change, here + x * odd_here


@always_inlined
def _slip_path(shape, values):
    """Return ∫ |v_t| dP₃ over the units of both and x, from the rows that `_fill_nodes` has filled."""
    q1, q2, q3, q4 = shape.q1, shape.q2, shape.q3, shape.q4
    for i in range(0, NODES, 4):
        at = four(values, 4 * NODES + i)
        fall = raised(raised(raised(raised((q4, q4, q4, q4), at, q3), at, q2), at, q1), at, 1.0)
        integrand = product(four(values, i), four(values, 2 * NODES + i))
        keep(values, 3 * NODES + i, product(integrand, fall))
    return _summed(values, 3)


@always_inlined
def works_so_far(series, nodes, x):
    """Return the normal work over (0, x) of a series in the half-angle, Δv₃, and S(x). (3.17)"""
    shape = series.shape
    return _along_half_angle(
        *(series.coefficients, shape.h),
        *(series.j0, series.j1, series.j2, series.v3, shape.unit * series.scale),
        *(nodes, x),
    )


@always_inlined
def works(series, nodes, x):
    """Return the work of the normal impulse and of friction over (0, x)."""
    if series.around_invariant:
        return works_around(series, nodes, x)
    shape = series.shape
    work, _, _ = works_so_far(series, nodes, x)
    slip_path = x * _slip_path(shape, nodes)
    return work, -series.mu * series.speed * shape.factor * shape.unit * series.scale * slip_path


@always_inlined
def _decayed(length, rate, first):
    """Return first · e^{−rate·length} for four lengths."""
    return (
        first * math.exp(-rate * length[0]),
        first * math.exp(-rate * length[1]),
        first * math.exp(-rate * length[2]),
        first * math.exp(-rate * length[3]),
    )


@inlined
def works_around(series, nodes, x):
    """Return the result of `works` for a series around an invariant direction, by intervals of L. (4.7)"""
    shape, coefficients, mu = series.shape, series.coefficients, series.mu
    h, exponent, start, sign = shape.h, shape.exponent, shape.start, shape.sign
    v3, last = series.v3, coefficients[len(coefficients) - 1]
    normal = friction = low = 0.0
    # beyond this L slip is straight, or its speed negligible
    end = min(x, SETTLED / max(1.0, exponent))
    while low < end:
        # the integrand is analytic down to L ≈ −1 and proportional to e^{−2aL}
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
            _fill_nodes(nodes, i, y, value, (0.0, 0.0, 0.0, 0.0), h, series.j0, series.j1, series.j2)
        size = sign * shape.unit * series.scale * width
        work, change = _collocated(nodes, v3, size)
        normal += work
        v3 += change
        friction -= mu * series.speed * shape.factor * size * _slip_path(shape, nodes)
        low = low + width if low + width > low else end
    if end < x:
        here, there = point(series, end), point(series, x)
        span = there[0] - here[0]
        normal += span * (series.v3 + 0.5 * (here[3] + there[3]))
        friction -= 0.5 * mu * series.speed * span * (here[4] + there[4])
    return normal, friction
