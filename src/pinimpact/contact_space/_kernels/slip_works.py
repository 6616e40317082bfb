"""The works of turning slip: by collocation; around an invariant direction as series. (theory.md, 3.5, 4)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._numeric.jit import inlined, inner
from .delassus import EPS
from .invariant_direction import VANISHES
from .slip_equations import RECIPROCAL, VANISHING
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

FEW, MANY = 8, 12
"""Nodes of Gauss' rules: the first is right to rounding for a series in the half-angle of up to FEW_TERMS
terms, the second as far as any goes."""

FEW_TERMS = 20


def _collocation(nodes: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes θ of Gauss' rule on (0, 1), its weights, and what integrates from 0 to each node."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    values = np.polynomial.legendre.legvander(x, nodes)
    rising = np.empty((nodes, nodes))  # ∫ of each Legendre polynomial up to each node
    rising[:, 0] = x + 1.0
    for k in range(1, nodes):
        rising[:, k] = (values[:, k + 1] - values[:, k - 1]) / (2 * k + 1)
    shares = values[:, :nodes] * (np.arange(nodes) + 0.5) * w[:, None]
    return 0.5 * (x + 1.0), 0.5 * w, 0.5 * rising @ shares.T


# the two rules, one after the other
_RULES = _collocation(FEW), _collocation(MANY)
_ABSCISSAE, _WEIGHTS = (np.concatenate([rule[part] for rule in _RULES]) for part in (0, 1))
_INTEGRALS = np.concatenate([np.pad(rule[2], ((0, 0), (0, MANY - len(rule[0])))) for rule in _RULES])


class WorkSeries(NamedTuple):
    """The works on a `SlipSeries` around an invariant direction, and scratch on any.

    Attributes:
        nodes: Scratch for dP₃/dx and dv₃/dx at the nodes, over the series' unit.
        normal, friction: Coefficients of the two works, integrated; those of the terms that are logarithms,
            or nearly, come last.
        quotients: Those of Q, where v₃ has such a term. (4.7)
        rest: The part of v₃ that stays.
        push, share: Coefficients of that term in v₃ and in P₃.
        pole, work_pole: Which power it is in these, and in the works; −1: none.
        last: The last coefficients of U, over the sum of all where the series goes around a direction.
    """

    nodes: NDArray[np.float64]
    normal: NDArray[np.float64]
    friction: NDArray[np.float64]
    quotients: NDArray[np.float64]
    rest: float
    push: float
    share: float
    pole: np.int64
    work_pole: np.int64
    last: float


WORK_SCRATCH = 2 * MANY + 3 * (WORK_TERMS + 1)
"""Floats of scratch space that works need."""


@inlined
def no_works(scratch):
    """Return a `WorkSeries` that is yet to be made, in WORK_SCRATCH floats of scratch space."""
    size = WORK_TERMS + 1
    none = np.int64(-1)
    series = scratch[2 * MANY :]
    return WorkSeries(
        scratch[: 2 * MANY], series[:size], series[size : 2 * size], series[2 * size : 3 * size],
        0.0, 0.0, 0.0, none, none, 0.0,
    )  # fmt: skip


@inner
def _collocated(weights, integrals, values, v3, size):
    """Return the normal work and what v₃ grows by. (3.17)

    Args:
        weights, integrals: Of the rule.
        values: (2 MANY,) dP₃/dx at the nodes, times the weights, and dv₃/dx.
        v3, size: v₃ at the start; the length over the series' unit.
    """
    nodes = len(weights)
    normal = change = 0.0
    for i in range(0, nodes, 4):
        s0 = s1 = s2 = s3 = 0.0
        for j in range(nodes):
            term = values[MANY + j]
            s0, s1 = s0 + integrals[i, j] * term, s1 + integrals[i + 1, j] * term
            s2, s3 = s2 + integrals[i + 2, j] * term, s3 + integrals[i + 3, j] * term
        normal += values[i] * (v3 + size * s0) + values[i + 1] * (v3 + size * s1)
        normal += values[i + 2] * (v3 + size * s2) + values[i + 3] * (v3 + size * s3)
    for j in range(nodes):
        change += weights[j] * values[MANY + j]
    return size * normal, size * change


@inner
def _along_half_angle(coefficients, h, q1, q2, q3, q4, j0, j1, j2, v3, unit, values, x, rubbing):
    """Do what `works_so_far` does.

    Args:
        coefficients, h, q1, q2, q3, q4: Of the series and its `Shape`.
        j0, j1, j2: Of dv₃/dP₃ (1 + t²) in powers of t.
        v3: At the start.
        unit: Of P₃.
        values: Scratch, see `WorkSeries.nodes`.
        rubbing: Whether the work of friction is wanted, here as ∫ R dP₃ over the speed at the start.
    """
    terms = len(coefficients) - 1
    first, nodes = (0, FEW) if terms <= FEW_TERMS else (FEW, MANY)
    abscissae, weights = _ABSCISSAE[first : first + nodes], _WEIGHTS[first : first + nodes]
    rubbed = 0.0
    # the sums of even and odd powers at four nodes hide each other's latency; `terms` is even
    for i in range(0, nodes, 4):
        x0, x1, x2, x3 = x * abscissae[i], x * abscissae[i + 1], x * abscissae[i + 2], x * abscissae[i + 3]
        y0, y1, y2, y3 = x0 * x0, x1 * x1, x2 * x2, x3 * x3
        s0 = s1 = s2 = s3 = coefficients[terms]
        u0 = u1 = u2 = u3 = 0.0
        for k in range(2, terms + 1, 2):
            even, odd = coefficients[terms - k], coefficients[terms - k + 1]
            s0, s1, s2, s3 = s0 * y0 + even, s1 * y1 + even, s2 * y2 + even, s3 * y3 + even
            u0, u1, u2, u3 = u0 * y0 + odd, u1 * y1 + odd, u2 * y2 + odd, u3 * y3 + odd
        values[i], values[i + 1] = s0 + x0 * u0, s1 + x1 * u1
        values[i + 2], values[i + 3] = s2 + x2 * u2, s3 + x3 * u3
    for i in range(nodes):
        at = x * abscissae[i]
        t = h * at
        chord = 1.0 + t * t
        slope = values[i] * chord
        if rubbing:
            fall = 1.0 + at * (q1 + at * (q2 + at * (q3 + at * q4)))
            rubbed += weights[i] * (slope * slope * chord * fall)
        values[i] = weights[i] * slope * chord
        values[MANY + i] = slope * (j0 + t * (j1 + t * j2))
    size = unit * x
    normal, change = _collocated(weights, _INTEGRALS[first : first + nodes], values, v3, size)
    return normal, size * rubbed, change


@inlined
def works_so_far(series, work_series, x, rubbing):
    """Return the works over (0, x) of a series in the half-angle, and what v₃ grows by. (3.17)

    Args:
        rubbing: Whether the work of friction is wanted.
    """
    shape = series.shape
    work, rubbed, change = _along_half_angle(
        *(series.coefficients, shape.h, shape.q1, shape.q2, shape.q3, shape.q4),
        *(series.j0, series.j1, series.j2, series.v3, shape.unit * series.scale),
        *(work_series.nodes, x, rubbing),
    )
    return work, -series.mu * series.speed * shape.factor * rubbed, change


@inner
def _expand_around(series, normal, friction, quotients, rubbing, f0, f1, f2, f3, f4):
    """Make the coefficients of the works around an invariant direction. (4.7)–(4.10)

    Args:
        rubbing: Whether the work of friction is wanted.

    Returns:
        the rest, the push, the share, at which powers v₃ and the works have a logarithm, or nearly; how many
        coefficients of U there are after the first, and the size of the last over the sum of all.
    """
    g, reciprocals, shape = series.coefficients, series.reciprocals, series.shape
    q1, q2, q3 = shape.q1, shape.q2, shape.q3
    w0, w1, w2, exponent = shape.w0, shape.w1, shape.w2, shape.exponent
    rest, push, power = series.v3, 0.0, 1.0
    terms = len(g) + 4
    pole, work_pole = np.int64(-1), np.int64(-1)
    # v₃ = rest + push·fill + e^{−aL}E; quotients: H = Gπ
    g0 = g1 = g2 = g3 = g4 = 0.0
    for k in range(terms):
        g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k] if k < len(g) else 0.0
        rate = f0 * g0 + (f1 * g1 + f2 * g2) + (f3 * g3 + f4 * g4)
        rest += rate * reciprocals[k] * power
        power *= shape.start
        if reciprocals[k] == 0.0 and abs(exponent + k) < 0.5:
            push, pole = rate, np.int64(k)
        quotients[k] = g0 + (q1 * g1 + (q2 * g2 + q3 * g3))
    for k in range(terms, WORK_TERMS):
        quotients[k] = 0.0
    # friction: U; normal: E G
    c0, c1, c2 = 2.0 * w0 + q1, 2.0 * w1 + 3.0 * q2, 2.0 * w2 + 5.0 * q3
    order, last, total, size = ORDER, 0.0, 0.0, 0.0
    x1 = x2 = x3 = x4 = 0.0
    u0 = u1 = u2 = u3 = u4 = 0.0
    for k in range(ORDER + 1):
        part = RECIPROCAL[k]
        ahead = (c1 * u1 + c2 * u2) * part + (c0 * part) * u0
        if k == 0:
            ahead = 1.0
        else:
            c0 -= q1
            c1 -= q2
            c2 -= q3
        if abs(ahead) < VANISHES:
            ahead = 0.0
        u4, u3, u2, u1, u0 = u3, u2, u1, u0, ahead
        friction[k] = ahead
        total += ahead
        z = exponent + k
        new = (w1 - q2 * (z - 2.0)) * x2 + (w2 - q3 * (z - 3.0)) * x3
        new -= f0 * u0 + (f1 * u1 + f2 * u2) + (f3 * u3 + f4 * u4)
        if 0 <= pole <= k:
            new += push * quotients[k - pole]
        inverse = reciprocals[k] if k < terms else 1.0 / z
        new = new * inverse + ((w0 - q1 * (z - 1.0)) * inverse) * x1
        if k == pole:
            new = _before(series, pole, f0, f1, f2, f3, f4)
        x3, x2, x1 = x2, x1, new
        normal[k] = new
        size += abs(new)
        last = max(abs(u0), max(abs(u1), abs(u2)))
        if k >= terms and last <= VANISHING * total and abs(x1) + abs(x2) + abs(x3) <= VANISHING * size:
            order = k
            break
    work_terms = order + 7
    # quotients: Q; normal: all of it, integrated
    hh = shape.h * shape.h
    h2, h4 = 2.0 * hh, hh * hh
    share = 0.0
    if pole >= 0:
        g0 = g1 = g2 = g3 = g4 = 0.0
        for k in range(terms):
            g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k] if k < len(g) else 0.0
            weight = g0 + (h2 * g2 + h4 * g4)
            quotients[k] = weight * reciprocals[k]
            if k == pole:
                share = weight
    normal[work_terms] = friction[work_terms] = 0.0
    x0 = x1 = x2 = x3 = 0.0
    for k in range(work_terms):
        x4, x3, x2, x1, x0 = x3, x2, x1, x0, normal[k] if k <= order else 0.0
        work = x0 + (h2 * x2 + h4 * x4)
        if 0 <= pole <= k:
            work += push * quotients[k - pole]
        z = 2.0 * exponent + k
        if abs(z) < 0.5:
            work_pole = np.int64(k)
            normal[work_terms], normal[k] = work, 0.0
        else:
            normal[k] = work / z
    if rubbing:
        e2, e4, e6 = 3.0 * hh, 3.0 * h4, h4 * hh
        u0 = u1 = u2 = u3 = u4 = u5 = 0.0
        for k in range(work_terms):
            u6, u5, u4, u3, u2, u1, u0 = u5, u4, u3, u2, u1, u0, friction[k] if k <= order else 0.0
            work = u0 + e2 * u2 + (e4 * u4 + e6 * u6)
            if k == work_pole:
                friction[work_terms], friction[k] = work, 0.0
            else:
                friction[k] = work / (2.0 * exponent + k)
    return rest, push, share, pole, work_pole, order, last / total


@inner
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


@inner
def expand_works(series, work_series, rubbing):
    """Make the `WorkSeries` of a `SlipSeries` around an invariant direction.

    Args:
        rubbing: Whether the work of friction is wanted too.
    """
    nodes, normal = work_series.nodes, work_series.normal
    friction, quotients = work_series.friction, work_series.quotients
    shape = series.shape
    size = shape.unit * series.scale
    h = shape.h
    hh = h * h
    j0, j1, j2 = size * series.j0, size * series.j1, size * series.j2
    f0, f1, f2, f3, f4 = j0, j1 * h, (j0 + j2) * hh, j1 * hh * h, j2 * hh * hh
    if shape.exponent < -LATE - 0.5:
        none, late = np.int64(-1), np.int64(LATE + 1)
        return WorkSeries(nodes, normal, friction, quotients, 0.0, 0.0, 0.0, late, none, math.inf)
    rest, push, share, pole, work_pole, order, last = _expand_around(
        series, normal, friction, quotients, rubbing, f0, f1, f2, f3, f4
    )
    size, terms = order + 8, len(series.coefficients) + 4
    return WorkSeries(
        *(nodes, normal[:size], friction[:size], quotients[:terms]),
        *(rest, push, share, pole, work_pole, last),
    )


@inlined
def works(series, work_series, x, span, rubbing):
    """Return the normal work over (0, x), where P₃ grows by `span`, and that of friction if it is wanted."""
    if series.around_invariant:
        return works_around(series, work_series, x, span, rubbing)
    work, rubbed, _ = works_so_far(series, work_series, x, rubbing)
    return work, rubbed


@inner
def works_around(series, work_series, x, span, rubbing):
    """Do what `works` does, for a series around an invariant direction."""
    normal, shape = work_series.normal, series.shape
    size = shape.unit * series.scale
    exponent, start = shape.exponent, shape.start
    length = shape.sign * x
    y, drop, power, part = passed(exponent, start, length)
    converges = _converges(work_series, max(start, y))
    short = x * max(1.0, abs(exponent)) < SHORT
    if short or work_series.pole > LATE or not converges:
        work, rubbed = quadrature(series, work_series.nodes, x)
    else:
        work = size * _filled(normal, work_series.work_pole, exponent, start, length, y, drop, power, part)
        if work_series.pole >= 0:
            k = work_series.pole
            whole = fill(exponent + k, k, start, length)
            quotient = _sum(work_series.quotients, y)
            work += size * (work_series.push * whole * (0.5 * work_series.share * whole - power * quotient))
        work += work_series.rest * span
        rubbed = 0.0
    if rubbing and converges:
        rubbed = _filled(
            work_series.friction, work_series.work_pole, exponent, start, length, y, drop, power, part
        )
        rubbed *= -series.mu * series.speed * shape.factor * size
    return work, rubbed


@inner
def _sum(coefficients, x):
    """Return the value of a polynomial."""
    total, degree = 0.0, len(coefficients) - 1
    for k in range(degree + 1):
        total = total * x + coefficients[degree - k]
    return total


@inner
def _filled(coefficients, pole, exponent, start, length, y, drop, power, part):
    """Sum the integrals of e^{−2aL}yᵏ over (0, L), with 1/(2a + k) in the coefficients already. (4.4)

    The last four arguments are what `passed` says.
    """
    part *= 1.0 + power
    rising = power * power
    total = 0.0
    terms = len(coefficients) - 1
    for k in range(terms):
        total += coefficients[k] * part
        part = start * part + rising * drop
        rising *= y
    if pole >= 0:
        total += coefficients[terms] * fill(2.0 * exponent + pole, pole, start, length)
    return total


@inner
def _converges(work_series, x):
    """Whether the series of the works converges at x, or y."""
    power = x * x
    power *= power
    power *= power
    eighth = power
    power *= power
    power *= power
    return work_series.last * (power * eighth) <= CONVERGED


@inner
def quadrature(series, values, x):
    """Integrate the works over (0, x) around an invariant direction by Gauss' collocation. (3.17)

    Args:
        values: Scratch, see `WorkSeries.nodes`.
    """
    coefficients, shape, mu = series.coefficients, series.shape, series.mu
    h, exponent, start, sign, q1, q2, q3 = (
        shape.h, shape.exponent, shape.start, shape.sign, shape.q1, shape.q2, shape.q3,
    )  # fmt: skip
    j0, j1, j2 = series.j0, series.j1, series.j2
    speed, v3 = series.speed, series.v3
    abscissae, weights = _ABSCISSAE[FEW:], _WEIGHTS[FEW:]
    normal = friction = low = 0.0
    # from here on the direction is settled or nothing is left: the rest is straight
    end = min(x, SETTLED / max(1.0, exponent))
    while low < end:
        # the integrand is analytic down to L ≈ −1, and falls or grows like e^{−2aL}
        width = min(end - low, 1.25 * (low + 1.0), 5.0 / max(1e-3, abs(exponent)))
        rubbed = 0.0
        for i in range(MANY):
            length = sign * (low + width * abscissae[i])
            y = start * math.exp(-length)
            t = h * y
            chord = 1.0 + t * t
            slope = math.exp(-exponent * length) * _sum(coefficients, y) * chord
            rubbed += weights[i] * (slope * slope * chord * (1.0 + y * (q1 + y * (q2 + y * q3))))
            values[i] = weights[i] * slope * chord
            values[MANY + i] = slope * (j0 + t * (j1 + t * j2))
        size = sign * shape.unit * series.scale * width
        work, change = _collocated(weights, _INTEGRALS[FEW:], values, v3, size)
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
