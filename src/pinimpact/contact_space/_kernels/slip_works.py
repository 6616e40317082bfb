"""The works of turning slip: by collocation; around an invariant direction as series. (theory.md, 3.5, 4)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._compile.jit import always_inlined, inlined
from .delassus import EPS
from .slip_equations import RECIPROCAL, TERMS, VANISHING
from .slip_series import SETTLED, fill, passed, point

ORDER = 40
"""Of the series of works at most: they converge a little later than those of slip."""

WORK_TERMS = ORDER + 7
"""Coefficients of the series of works around a direction: six more, for (1 + t²)³."""

SHORT = 0.4
"""Part of an e-fold on which the terms of (4.8) cancel, and twelve nodes do better."""

LATE = 6
"""A logarithm later than this in the series, of slip that explodes, would take more terms."""

CONVERGED = 16.0 * EPS
"""Size up to which the last terms of U leave the works whole, for integrals divide them by their numbers."""

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


_ABSCISSAE, _WEIGHTS, _INTEGRALS = _collocation()


MARGIN = 8
"""Zeros in front of a row of coefficients, for those before the first."""

COLUMNS, SLIP_COLUMNS = WORK_TERMS + 1, TERMS + 8
"""Places for coefficients of works, and of what slip itself is made of, with zeros up to a multiple of four.
All are gone through, four at a time: loops of fixed length become vector instructions."""

ROW = MARGIN + COLUMNS


class WorkSeries(NamedTuple):
    """The works on a `SlipSeries` around an invariant direction, and scratch on any.

    Attributes:
        nodes: Scratch for rows of what there is at the NODES: dP₃/dx and dv₃/dx over the series' unit, times
            the weights; S (1 + t²); and the terms of the sum that was made last.
        rows: Scratch for coefficients, of G, U, E G, Q, for 1/(a + k), and for the coefficients of the works.
        normal, friction: Coefficients of the two works, integrated, and zeros up to a multiple of four,
        normal_pole, friction_pole: and of the terms that are logarithms, or nearly.
        quotients: Those of Q, where v₃ has such a term. (4.7)
        rest: The part of v₃ that stays.
        push, share: Coefficients of that term in v₃ and in P₃.
        pole, work_pole: Which power it is in these, and in the works; −1: none.
        last: The last coefficients of U, over the sum of all where the series goes around a direction.
    """

    nodes: NDArray[np.float64]
    rows: NDArray[np.float64]
    normal: NDArray[np.float64]
    friction: NDArray[np.float64]
    normal_pole: float
    friction_pole: float
    quotients: NDArray[np.float64]
    rest: float
    push: float
    share: float
    pole: np.int64
    work_pole: np.int64
    last: float


WORK_SCRATCH = 4 * NODES + 5 * ROW + 2 * COLUMNS
"""Floats of scratch space that works need."""


@always_inlined
def no_works(scratch):
    """Return a `WorkSeries` that is yet to be made, in WORK_SCRATCH floats of scratch space."""
    none = np.int64(-1)
    nodes, rows = scratch[: 4 * NODES], scratch[4 * NODES :]
    return WorkSeries(nodes, rows, rows, rows, 0.0, 0.0, rows, 0.0, 0.0, 0.0, none, none, 0.0)


@always_inlined
def _summed(values, row):
    """Return the sum of a row of `WorkSeries.nodes`."""
    s0 = s1 = s2 = s3 = 0.0
    for i in range(row * NODES, (row + 1) * NODES, 4):
        s0, s1, s2, s3 = s0 + values[i], s1 + values[i + 1], s2 + values[i + 2], s3 + values[i + 3]
    return (s0 + s1) + (s2 + s3)


@always_inlined
def _collocated(values, v3, size):
    """Return the normal work and what v₃ grows by. (3.17)

    Four nodes at a time: their sums hide each other's latency, and share instructions.

    Args:
        values: See `WorkSeries.nodes`.
        v3, size: v₃ at the start; the length over the series' unit.
    """
    for i in range(0, NODES, 4):
        s0 = s1 = s2 = s3 = 0.0
        for j in range(NODES):
            term = values[NODES + j]
            s0, s1 = s0 + _INTEGRALS[j, i] * term, s1 + _INTEGRALS[j, i + 1] * term
            s2, s3 = s2 + _INTEGRALS[j, i + 2] * term, s3 + _INTEGRALS[j, i + 3] * term
        k = 3 * NODES + i
        values[k], values[k + 1] = values[i] * (v3 + size * s0), values[i + 1] * (v3 + size * s1)
        values[k + 2], values[k + 3] = values[i + 2] * (v3 + size * s2), values[i + 3] * (v3 + size * s3)
    return size * _summed(values, 3), size * _summed(values, 1)


@always_inlined
def _places(i, x):
    """Return four nodes of (0, x), from the i-th on."""
    return x * _ABSCISSAE[i], x * _ABSCISSAE[i + 1], x * _ABSCISSAE[i + 2], x * _ABSCISSAE[i + 3]


@always_inlined
def _product(x, y):
    """Return x y for four numbers x and y."""
    return x[0] * y[0], x[1] * y[1], x[2] * y[2], x[3] * y[3]


@always_inlined
def _raised(s, y, c):
    """Return s y + c for four numbers s and y."""
    return s[0] * y[0] + c, s[1] * y[1] + c, s[2] * y[2] + c, s[3] * y[3] + c


@always_inlined
def _kept(values, i, x, s, u, h, j0, j1, j2):
    """Keep what `WorkSeries.nodes` holds, for four nodes."""
    t = h * x[0], h * x[1], h * x[2], h * x[3]
    chord = _raised(t, t, 1.0)
    even = _product(x, u)
    slope = _product(chord, (s[0] + even[0], s[1] + even[1], s[2] + even[2], s[3] + even[3]))
    rate = _raised(_raised((j2, j2, j2, j2), t, j1), t, j0)
    whole, part = _product(slope, chord), _product(slope, rate)
    w0, w1, w2, w3 = _WEIGHTS[i], _WEIGHTS[i + 1], _WEIGHTS[i + 2], _WEIGHTS[i + 3]
    values[i], values[i + 1], values[i + 2], values[i + 3] = _product(whole, (w0, w1, w2, w3))
    k = NODES + i
    values[k], values[k + 1], values[k + 2], values[k + 3] = _product(part, (w0, w1, w2, w3))
    k += NODES
    values[k], values[k + 1], values[k + 2], values[k + 3] = slope


@inlined
def _along_half_angle(coefficients, h, j0, j1, j2, v3, unit, values, x):
    """Do what `works_so_far` does.

    Args:
        coefficients, h: Of the series and its `Shape`.
        j0, j1, j2: Of dv₃/dP₃ (1 + t²) in powers of t.
        v3: At the start.
        unit: Of P₃.
        values: Scratch, see `WorkSeries.nodes`.
    """
    k = len(coefficients) - 1  # even
    z, first = x * x, coefficients[k]
    at0, at4, at8 = _places(0, x), _places(4, x), _places(8, x)
    y0, y4, y8 = _product(at0, at0), _product(at4, at4), _product(at8, at8)
    s0 = s4 = s8 = (first, first, first, first)
    u0 = u4 = u8 = (0.0, 0.0, 0.0, 0.0)
    here, odd_here = first, 0.0
    while k > 1:
        k -= 2
        even, odd = coefficients[k], coefficients[k + 1]
        s0, s4, s8 = _raised(s0, y0, even), _raised(s4, y4, even), _raised(s8, y8, even)
        u0, u4, u8 = _raised(u0, y0, odd), _raised(u4, y4, odd), _raised(u8, y8, odd)
        here, odd_here = here * z + even, odd_here * z + odd
    _kept(values, 0, at0, s0, u0, h, j0, j1, j2)
    _kept(values, 4, at4, s4, u4, h, j0, j1, j2)
    _kept(values, 8, at8, s8, u8, h, j0, j1, j2)
    work, change = _collocated(values, v3, unit * x)
    return work, change, here + x * odd_here


@inlined
def _rubbed(q1, q2, q3, q4, values, x):
    """Return ∫ R dP₃ over the unit of P₃ and the speed at the start, from what `_along_half_angle` left."""
    for i in range(0, NODES, 4):
        at = _places(i, x)
        fall = _raised(_raised(_raised(_raised((q4, q4, q4, q4), at, q3), at, q2), at, q1), at, 1.0)
        k, m = 2 * NODES + i, 3 * NODES + i
        values[m], values[m + 1] = values[i] * values[k] * fall[0], values[i + 1] * values[k + 1] * fall[1]
        values[m + 2] = values[i + 2] * values[k + 2] * fall[2]
        values[m + 3] = values[i + 3] * values[k + 3] * fall[3]
    return x * _summed(values, 3)


@always_inlined
def works_so_far(series, work_series, x):
    """Return the normal work over (0, x) of a series in the half-angle, what v₃ grows by, and S. (3.17)"""
    shape = series.shape
    return _along_half_angle(
        *(series.coefficients, shape.h),
        *(series.j0, series.j1, series.j2, series.v3, shape.unit * series.scale),
        *(work_series.nodes, x),
    )


@always_inlined
def _term(row, k, f0, f1, f2, f3, f4):
    """Return the coefficient k of a row times f₀ + f₁y + f₂y² + f₃y³ + f₄y⁴."""
    k += MARGIN
    return f0 * row[k] + (f1 * row[k - 1] + f2 * row[k - 2]) + (f3 * row[k - 3] + f4 * row[k - 4])


@always_inlined
def _terms(row, k, f0, f1, f2, f3, f4):
    """Return four of them, from k on."""
    return (
        _term(row, k, f0, f1, f2, f3, f4),
        _term(row, k + 1, f0, f1, f2, f3, f4),
        _term(row, k + 2, f0, f1, f2, f3, f4),
        _term(row, k + 3, f0, f1, f2, f3, f4),
    )


@always_inlined
def _even_term(row, k, f2, f4, f6):
    """Return the coefficient k of a row times 1 + f₂y² + f₄y⁴ + f₆y⁶."""
    k += MARGIN
    return row[k] + f2 * row[k - 2] + (f4 * row[k - 4] + f6 * row[k - 6])


@always_inlined
def _even_terms(row, k, f2, f4, f6):
    """Return four of them, from k on."""
    return (
        _even_term(row, k, f2, f4, f6),
        _even_term(row, k + 1, f2, f4, f6),
        _even_term(row, k + 2, f2, f4, f6),
        _even_term(row, k + 3, f2, f4, f6),
    )


@always_inlined
def _apart(z):
    """Return z, or infinity where it is close to zero: a quotient by it is then left out."""
    return z if abs(z) >= 0.5 else math.inf


@always_inlined
def _over(x, z):
    """Return four numbers over z, z + 1, z + 2 and z + 3, and zero where that is close to zero."""
    return x[0] / _apart(z), x[1] / _apart(z + 1.0), x[2] / _apart(z + 2.0), x[3] / _apart(z + 3.0)


@inlined
def _pole(exponent, terms):
    """Return the k below `terms` for which exponent + k is within ½ of zero, or −1."""
    if exponent < 0.5:
        k = np.int64(0.5 - exponent)
        if abs(exponent + k) >= 0.5:  # the sum was rounded up
            k -= 1
        if k < terms and abs(exponent + k) < 0.5:
            return k
    return np.int64(-1)


@inlined
def _expand_around(series, rows, normal, friction, rubbing, f0, f1, f2, f3, f4):
    """Make the coefficients of the works around an invariant direction. (4.7)–(4.10)

    Args:
        rows, normal, friction: See `WorkSeries`.
        rubbing: Whether the work of friction is wanted.

    Returns:
        the two coefficients at the pole of the works, the rest, the push, the share, both poles; how many
        coefficients of U there are after the first, and the size of the last over the sum of all.
    """
    g, shape = series.coefficients, series.shape
    q1, q2, q3, start = shape.q1, shape.q2, shape.q3, shape.start
    w0, w1, w2, exponent = shape.w0, shape.w1, shape.w2, shape.exponent
    terms = len(g) + 4
    direction, square = rows[:ROW], rows[ROW : 2 * ROW]
    product, quotients, inverses = rows[2 * ROW : 3 * ROW], rows[3 * ROW : 4 * ROW], rows[4 * ROW : 5 * ROW]
    # v₃ = rest + push·fill + e^{−aL}E
    r0 = r1 = r2 = r3 = 0.0
    fourth = start * start * (start * start)
    for k in range(SLIP_COLUMNS - 4, -1, -4):
        rate = _terms(direction, k, f0, f1, f2, f3, f4)
        i = MARGIN + k
        r0, r1 = r0 * fourth + rate[0] * inverses[i], r1 * fourth + rate[1] * inverses[i + 1]
        r2, r3 = r2 * fourth + rate[2] * inverses[i + 2], r3 * fourth + rate[3] * inverses[i + 3]
    rest = series.v3 + ((r0 + start * r1) + start * start * (r2 + start * r3))
    pole, push, share = _pole(exponent, terms), 0.0, 0.0
    hh = shape.h * shape.h
    h2, h4 = 2.0 * hh, hh * hh
    shifted = MARGIN + max(pole, np.int64(0))
    if pole >= 0:
        push = _term(direction, pole, f0, f1, f2, f3, f4)
        share = _even_term(direction, pole, h2, h4, 0.0)
        for k in range(0, SLIP_COLUMNS, 4):  # H = Gπ
            i = shifted + k
            quotients[i], quotients[i + 1], quotients[i + 2], quotients[i + 3] = _terms(
                direction, k, 1.0, q1, q2, q3, 0.0
            )
    # U
    c0, c1, c2 = 2.0 * w0 + q1, 2.0 * w1 + 3.0 * q2, 2.0 * w2 + 5.0 * q3
    total, u0, u1, u2 = 1.0, 1.0, 0.0, 0.0
    square[MARGIN] = 1.0
    for k in range(1, ORDER + 1):
        part = RECIPROCAL[k]
        new = (c0 * part) * u0 + ((c1 * part) * u1 + (c2 * part) * u2)
        c0 -= q1
        c1 -= q2
        c2 -= q3
        u2, u1, u0 = u1, u0, new
        square[MARGIN + k] = new
        total += new
        if max(abs(u0), max(abs(u1), abs(u2))) <= VANISHING * total:
            break
    order = max(k, terms)
    last = max(abs(u0), max(abs(u1), abs(u2)))
    # what drives E G, and E G
    for k in range(0, COLUMNS, 4):
        lost = _terms(square, k, f0, f1, f2, f3, f4)
        i = MARGIN + k
        product[i], product[i + 1], product[i + 2], product[i + 3] = (
            push * quotients[i] - lost[0],
            push * quotients[i + 1] - lost[1],
            push * quotients[i + 2] - lost[2],
            push * quotients[i + 3] - lost[3],
        )
    size, x1, x2, x3 = 0.0, 0.0, 0.0, 0.0
    for k in range(ORDER + 1):
        z = exponent + k
        inverse = inverses[MARGIN + k] if k < terms else 1.0 / z
        near, far = (w1 - q2 * (z - 2.0)) * inverse, (w2 - q3 * (z - 3.0)) * inverse
        others = near * x2 + (far * x3 + product[MARGIN + k] * inverse)
        new = ((w0 - q1 * (z - 1.0)) * inverse) * x1 + others
        if k == pole:
            new = _before(series, pole, f0, f1, f2, f3, f4)
        x3, x2, x1 = x2, x1, new
        product[MARGIN + k] = new
        size += abs(new)
        if k >= order and abs(x1) + abs(x2) + abs(x3) <= VANISHING * size:
            break
    order = k
    for k in range(order + 1, ORDER + 1):
        product[MARGIN + k] = 0.0
    if pole >= 0:
        for k in range(0, SLIP_COLUMNS, 4):  # Q
            weight = _even_terms(direction, k, h2, h4, 0.0)
            i = shifted + k
            quotients[i], quotients[i + 1], quotients[i + 2], quotients[i + 3] = (
                weight[0] * inverses[MARGIN + k],
                weight[1] * inverses[MARGIN + k + 1],
                weight[2] * inverses[MARGIN + k + 2],
                weight[3] * inverses[MARGIN + k + 3],
            )
    # and all of it, integrated
    work_terms, twice = order + 7, 2.0 * exponent
    for k in range(0, COLUMNS, 4):
        x = _even_terms(product, k, h2, h4, 0.0)
        i = MARGIN + k
        x = (
            x[0] + push * quotients[i],
            x[1] + push * quotients[i + 1],
            x[2] + push * quotients[i + 2],
            x[3] + push * quotients[i + 3],
        )
        normal[k], normal[k + 1], normal[k + 2], normal[k + 3] = _over(x, twice + k)
    e2, e4, e6 = 3.0 * hh, 3.0 * h4, h4 * hh
    if rubbing:
        for k in range(0, COLUMNS, 4):
            friction[k], friction[k + 1], friction[k + 2], friction[k + 3] = _over(
                _even_terms(square, k, e2, e4, e6), twice + k
            )
    work_pole = _pole(twice, work_terms)
    normal_pole = friction_pole = 0.0
    if work_pole >= 0:
        normal_pole = _even_term(product, work_pole, h2, h4, 0.0) + push * quotients[MARGIN + work_pole]
        friction_pole = _even_term(square, work_pole, e2, e4, e6)
    return normal_pole, friction_pole, rest, push, share, pole, work_pole, order, last / total


@inlined
def _before(series, pole, f0, f1, f2, f3, f4):
    """Return the coefficient of E G at the pole, from E's before it."""
    g, reciprocals = series.coefficients, series.reciprocals
    total = 0.0
    g0 = g1 = g2 = g3 = g4 = 0.0
    for k in range(pole):
        g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k] if k < len(g) else 0.0
        if pole - k < len(g):
            total -= (f0 * g0 + f1 * g1 + f2 * g2 + f3 * g3 + f4 * g4) * reciprocals[k] * g[pole - k]
    return total


@inlined
def expand_works(series, work_series, rubbing):
    """Make the `WorkSeries` of a `SlipSeries` around an invariant direction.

    Args:
        rubbing: Whether the work of friction is wanted too.
    """
    nodes, rows = work_series.nodes, work_series.rows
    normal, friction = rows[5 * ROW : 5 * ROW + COLUMNS], rows[5 * ROW + COLUMNS :]
    shape = series.shape
    size = shape.unit * series.scale
    h = shape.h
    hh = h * h
    j0, j1, j2 = size * series.j0, size * series.j1, size * series.j2
    f0, f1, f2, f3, f4 = j0, j1 * h, (j0 + j2) * hh, j1 * hh * h, j2 * hh * hh
    for k in range(0, 5 * ROW, 4):
        rows[k], rows[k + 1], rows[k + 2], rows[k + 3] = 0.0, 0.0, 0.0, 0.0
    for k in range(len(series.coefficients)):
        rows[MARGIN + k] = series.coefficients[k]
    for k in range(len(series.coefficients) + 4):
        rows[4 * ROW + MARGIN + k] = series.reciprocals[k]
    if shape.exponent < -LATE - 0.5:
        none, late = np.int64(-1), np.int64(LATE + 1)
        return WorkSeries(nodes, rows, rows, rows, 0.0, 0.0, rows, 0.0, 0.0, 0.0, late, none, math.inf)
    normal_pole, friction_pole, rest, push, share, pole, work_pole, order, last = _expand_around(
        series, rows, normal, friction, rubbing, f0, f1, f2, f3, f4
    )
    size, terms = (order + 10) // 4 * 4, (len(series.coefficients) + 7) // 4 * 4
    quotients = rows[3 * ROW + MARGIN + max(pole, np.int64(0)) : 4 * ROW]
    return WorkSeries(
        *(nodes, rows, normal[:size], friction[:size], normal_pole, friction_pole, quotients[:terms]),
        *(rest, push, share, pole, work_pole, last),
    )


@always_inlined
def works(series, work_series, x, span, rubbing):
    """Return the normal work over (0, x), where P₃ grows by `span`, and that of friction if it is wanted."""
    if series.around_invariant:
        return works_around(series, work_series, x, span, rubbing)
    work, _, _ = works_so_far(series, work_series, x)
    rubbed, shape = 0.0, series.shape
    if rubbing:
        rubbed = _rubbed(shape.q1, shape.q2, shape.q3, shape.q4, work_series.nodes, x)
        rubbed *= -series.mu * series.speed * shape.factor * shape.unit * series.scale
    return work, rubbed


@inlined
def works_around(series, work_series, x, span, rubbing):
    """Do what `works` does, for a series around an invariant direction."""
    shape, pole = series.shape, work_series.work_pole
    size = shape.unit * series.scale
    exponent, start = shape.exponent, shape.start
    length = shape.sign * x
    y, drop, power, part = passed(exponent, start, length)
    converges = _converges(work_series, max(start, y))
    short = x * max(1.0, abs(exponent)) < SHORT
    log = 0.0
    if pole >= 0 and converges:
        log = fill(2.0 * exponent + pole, pole, start, length)
    if short or work_series.pole > LATE or not converges:
        work, rubbed = quadrature(series, work_series, x)
    else:
        work = _filled(work_series.normal, start, y, drop, power, part) + work_series.normal_pole * log
        work *= size
        if work_series.pole >= 0:
            k = work_series.pole
            whole = fill(exponent + k, k, start, length)
            quotient = _sum(work_series.quotients, y)
            work += size * (work_series.push * whole * (0.5 * work_series.share * whole - power * quotient))
        work += work_series.rest * span
        rubbed = 0.0
    if rubbing and converges:
        rubbed = _filled(work_series.friction, start, y, drop, power, part) + work_series.friction_pole * log
        rubbed *= -series.mu * series.speed * shape.factor * size
    return work, rubbed


@inlined
def _sum(coefficients, x):
    """Return the value of a polynomial with a multiple of four coefficients, as four in x⁴."""
    square = x * x
    fourth = square * square
    s0 = s1 = s2 = s3 = 0.0
    k = len(coefficients)
    while k > 3:
        k -= 4
        s0, s1 = s0 * fourth + coefficients[k], s1 * fourth + coefficients[k + 1]
        s2, s3 = s2 * fourth + coefficients[k + 2], s3 * fourth + coefficients[k + 3]
    return (s0 + x * s1) + square * (s2 + x * s3)


@inlined
def _filled(coefficients, start, y, drop, power, part):
    """Sum the integrals of e^{−2aL}yᵏ over (0, L), with 1/(2a + k) in the coefficients already. (4.4)

    Args:
        coefficients: A multiple of four.
        start, y, drop, power, part: Where y starts, and what `passed` says.
    """
    # startᵏ − e^{−2aL}yᵏ, without cancellation; each four powers further on
    rise0 = power * power
    rise1 = rise0 * y
    rise2 = rise1 * y
    rise3 = rise2 * y
    part0 = part * (1.0 + power)
    part1 = start * part0 + rise0 * drop
    part2 = start * part1 + rise1 * drop
    part3 = start * part2 + rise2 * drop
    below, above = y * y, start * start
    drop *= (start + y) * (above + below)
    below *= below
    above *= above
    s0 = s1 = s2 = s3 = 0.0
    for k in range(0, len(coefficients), 4):
        s0, s1 = s0 + coefficients[k] * part0, s1 + coefficients[k + 1] * part1
        s2, s3 = s2 + coefficients[k + 2] * part2, s3 + coefficients[k + 3] * part3
        part0, part1 = above * part0 + rise0 * drop, above * part1 + rise1 * drop
        part2, part3 = above * part2 + rise2 * drop, above * part3 + rise3 * drop
        rise0, rise1, rise2, rise3 = rise0 * below, rise1 * below, rise2 * below, rise3 * below
    return (s0 + s1) + (s2 + s3)


@inlined
def _converges(work_series, x):
    """Whether the series of the works converges at x, or y."""
    power = x * x
    power *= power
    power *= power
    eighth = power
    power *= power
    power *= power
    return work_series.last * (power * eighth) <= CONVERGED


@inlined
def quadrature(series, work_series, x):
    """Integrate the works over (0, x) around an invariant direction by Gauss' collocation. (3.17)"""
    values, shape, mu = work_series.nodes, series.shape, series.mu
    coefficients = work_series.rows[MARGIN : MARGIN + (len(series.coefficients) + 3) // 4 * 4]
    h, exponent, start, sign, q1, q2, q3 = (
        shape.h, shape.exponent, shape.start, shape.sign, shape.q1, shape.q2, shape.q3,
    )  # fmt: skip
    j0, j1, j2 = series.j0, series.j1, series.j2
    speed, v3 = series.speed, series.v3
    normal = friction = low = 0.0
    # from here on the direction is settled or nothing is left: the rest is straight
    end = min(x, SETTLED / max(1.0, exponent))
    while low < end:
        # the integrand is analytic down to L ≈ −1, and falls or grows like e^{−2aL}
        width = min(end - low, 1.25 * (low + 1.0), 5.0 / max(1e-3, abs(exponent)))
        rubbed = 0.0
        for i in range(NODES):
            length = sign * (low + width * _ABSCISSAE[i])
            y = start * math.exp(-length)
            t = h * y
            chord = 1.0 + t * t
            slope = math.exp(-exponent * length) * _sum(coefficients, y) * chord
            rubbed += _WEIGHTS[i] * (slope * slope * chord * (1.0 + y * (q1 + y * (q2 + y * q3))))
            values[i] = _WEIGHTS[i] * slope * chord
            values[NODES + i] = _WEIGHTS[i] * slope * (j0 + t * (j1 + t * j2))
        size = sign * shape.unit * series.scale * width
        work, change = _collocated(values, v3, size)
        normal += work
        v3 += change
        friction -= mu * speed * shape.factor * size * rubbed
        low = low + width if low + width > low else end
    if end < x:
        here, there = point(series, end), point(series, x)
        span = there[0] - here[0]
        normal += span * (series.v3 + 0.5 * (here[3] + there[3]))
        friction -= 0.5 * mu * speed * span * (here[4] + there[4])
    return normal, friction
