"""The works of turning slip as series: once made, each value is one sum. (theory.md, 3.5 and 4)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._numeric.jit import inlined, inner
from .delassus import EPS
from .invariant_direction import VANISHES
from .slip_equations import RECIPROCAL, TERMS
from .slip_series import SETTLED, fill, passed, point

ORDER = 40
"""Of the series of works: they converge a little later than those of slip."""

WORK_TERMS = ORDER + 7
"""Coefficients of the series of works around a direction: six more, for (1 + t²)³."""

SHORT = 0.4
"""Part of an e-fold on which the terms of (4.8) cancel, and twelve nodes do better."""

LATE = 6
"""A logarithm later than this in the series, of slip that explodes, would take more terms."""

CONVERGED = 16.0 * EPS
"""Size up to which the last terms of U leave the works whole, for integrals divide them by their numbers."""

_GAUSS = np.polynomial.legendre.leggauss(12)
_ABSCISSAE = 0.5 * (_GAUSS[0] + 1.0)
_WEIGHTS = 0.5 * _GAUSS[1]


class WorkSeries(NamedTuple):
    """The works on a `SlipSeries`.

    Attributes:
        normal, friction: Coefficients of the two works, integrated; those of the terms that are logarithms,
            or nearly, come last.
        quotients: Those of Q, where v₃ has such a term. (4.7)
        rest: The part of v₃ that stays.
        push, share: Coefficients of that term in v₃ and in P₃.
        pole, work_pole: Which power it is in these, and in the works; −1: none.
        last: The last coefficients of U, over the sum of all where the series goes around a direction.
    """

    normal: NDArray[np.float64]
    friction: NDArray[np.float64]
    quotients: NDArray[np.float64]
    rest: float
    push: float
    share: float
    pole: np.int64
    work_pole: np.int64
    last: float


@inner
def no_works(scratch):
    """Return a `WorkSeries` that is yet to be made, in 3 (WORK_TERMS + 1) floats of scratch space."""
    size = WORK_TERMS + 1
    none = np.int64(-1)
    return WorkSeries(
        scratch[:size], scratch[size : 2 * size], scratch[2 * size : 3 * size], 0.0, 0.0, 0.0, none, none, 0.0
    )


@inner
def _expand(normal, friction, rubbing, shape, v3, f0, f1, f2, f3, f4):
    """Fill `normal` with the coefficients of Z (1 + t²)², and `friction` with U (1 + t²)³, both integrated.

    (3.16) to (3.18); `rubbing` says whether the second is wanted.

    Returns:
        the size of the last coefficients of U.
    """
    w0, w1, w2, w3 = shape.w0, shape.w1, shape.w2, shape.w3
    q1, q2, q3, q4 = shape.q1, shape.q2, shape.q3, shape.q4
    c0, c1, c2, c3 = w0, w1 + q2, w2 + 2.0 * q3, w3 + 3.0 * q4
    d0, d1, d2, d3 = w0 + q1, w1 + 2.0 * q2, w2 + 3.0 * q3, w3 + 4.0 * q4
    hh = shape.h * shape.h
    h2, h4 = 2.0 * hh, hh * hh
    z0, z1, z2, z3, z4 = v3, 0.0, 0.0, 0.0, 0.0
    u0, u1, u2, u3, u4 = 1.0, 0.0, 0.0, 0.0, 0.0
    friction[0] = 1.0
    for k in range(ORDER):
        share = RECIPROCAL[k + 1]
        normal[k] = (z0 + (h2 * z2 + h4 * z4)) * share
        force = (f1 * u1 + f2 * u2) + (f3 * u3 + f4 * u4)
        ahead = ((c1 * z1 + (c2 * z2 + c3 * z3)) + (f0 * u0 + force)) * share + (c0 * share) * z0
        new = (((c1 + d1) * u1 + ((c2 + d2) * u2 + (c3 + d3) * u3)) * share) + ((c0 + d0) * share) * u0
        c0 -= q1
        c1 -= q2
        c2 -= q3
        c3 -= q4
        z4, z3, z2, z1, z0 = z3, z2, z1, z0, ahead
        u4, u3, u2, u1, u0 = u3, u2, u1, u0, new
        friction[k + 1] = new
    normal[ORDER] = (z0 + (h2 * z2 + h4 * z4)) * RECIPROCAL[ORDER + 1]
    if rubbing:
        e2, e4, e6 = 3.0 * hh, 3.0 * h4, h4 * hh
        for k in range(ORDER, 5, -1):
            rubbed = (friction[k] + e2 * friction[k - 2]) + (e4 * friction[k - 4] + e6 * friction[k - 6])
            friction[k] = rubbed * RECIPROCAL[k + 1]
        friction[5] = (friction[5] + (e2 * friction[3] + e4 * friction[1])) * RECIPROCAL[6]
        friction[4] = (friction[4] + (e2 * friction[2] + e4 * friction[0])) * RECIPROCAL[5]
        friction[3] = (friction[3] + e2 * friction[1]) * RECIPROCAL[4]
        friction[2] = (friction[2] + e2 * friction[0]) * RECIPROCAL[3]
        friction[1] *= RECIPROCAL[2]
    return max(max(abs(u0), abs(u1)), max(abs(u2), abs(u3)))


@inner
def _expand_square(friction, shape):
    """Fill `friction` with the coefficients of U for a series around an invariant direction. (3.16)

    Returns:
        the size of the last of them, over the sum of all.
    """
    q1, q2, q3 = shape.q1, shape.q2, shape.q3
    c0, c1, c2 = 2.0 * shape.w0 + q1, 2.0 * shape.w1 + 3.0 * q2, 2.0 * shape.w2 + 5.0 * q3
    u0, u1, u2 = 1.0, 0.0, 0.0
    total = friction[0] = 1.0
    for k in range(ORDER):
        share = RECIPROCAL[k + 1]
        new = (c1 * u1 + c2 * u2) * share + (c0 * share) * u0
        if abs(new) < VANISHES:
            new = 0.0
        c0 -= q1
        c1 -= q2
        c2 -= q3
        u2, u1, u0 = u1, u0, new
        friction[k + 1] = new
        total += new
    return max(abs(u0), max(abs(u1), abs(u2))) / total


@inner
def _expand_around(series, normal, friction, quotients, rubbing, f0, f1, f2, f3, f4):
    """Make the coefficients of the works around an invariant direction from those of U. (4.7)

    Args:
        rubbing: Whether the work of friction is wanted.

    Returns:
        the rest, the push, the share, and at which powers v₃ and the works have a logarithm, or nearly.
    """
    g, reciprocals, shape = series.coefficients, series.reciprocals, series.shape
    q1, q2, q3 = shape.q1, shape.q2, shape.q3
    w0, w1, w2, exponent = shape.w0, shape.w1, shape.w2, shape.exponent
    rest, push, power = series.v3, 0.0, 1.0
    pole, work_pole = np.int64(-1), np.int64(-1)
    # v₃ = rest + push·fill + e^{−aL}E; quotients: H = Gπ
    g0 = g1 = g2 = g3 = g4 = 0.0
    for k in range(TERMS + 5):
        g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k] if k <= TERMS else 0.0
        rate = f0 * g0 + (f1 * g1 + f2 * g2) + (f3 * g3 + f4 * g4)
        rest += rate * reciprocals[k] * power
        power *= shape.start
        if reciprocals[k] == 0.0 and abs(exponent + k) < 0.5:
            push, pole = rate, np.int64(k)
        quotients[k] = g0 + (q1 * g1 + (q2 * g2 + q3 * g3))
    for k in range(TERMS + 5, WORK_TERMS):
        quotients[k] = 0.0
    # normal: E G
    x1 = x2 = x3 = x4 = 0.0
    u0 = u1 = u2 = u3 = u4 = 0.0
    for k in range(ORDER + 1):
        u4, u3, u2, u1, u0 = u3, u2, u1, u0, friction[k]
        z = exponent + k
        new = (w1 - q2 * (z - 2.0)) * x2 + (w2 - q3 * (z - 3.0)) * x3
        new -= f0 * u0 + (f1 * u1 + f2 * u2) + (f3 * u3 + f4 * u4)
        if 0 <= pole <= k:
            new += push * quotients[k - pole]
        inverse = reciprocals[k] if k < TERMS + 5 else 1.0 / z
        new = new * inverse + ((w0 - q1 * (z - 1.0)) * inverse) * x1
        if k == pole:
            new = _before(series, pole, f0, f1, f2, f3, f4)
        x3, x2, x1 = x2, x1, new
        normal[k] = new
    # quotients: Q; normal: all of it, integrated
    hh = shape.h * shape.h
    h2, h4 = 2.0 * hh, hh * hh
    share = 0.0
    if pole >= 0:
        g0 = g1 = g2 = g3 = g4 = 0.0
        for k in range(TERMS + 5):
            g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k] if k <= TERMS else 0.0
            weight = g0 + (h2 * g2 + h4 * g4)
            quotients[k] = weight * reciprocals[k]
            if k == pole:
                share = weight
    normal[WORK_TERMS] = friction[WORK_TERMS] = 0.0
    x0 = x1 = x2 = x3 = 0.0
    for k in range(WORK_TERMS):
        x4, x3, x2, x1, x0 = x3, x2, x1, x0, normal[k] if k <= ORDER else 0.0
        work = x0 + (h2 * x2 + h4 * x4)
        if 0 <= pole <= k:
            work += push * quotients[k - pole]
        z = 2.0 * exponent + k
        if abs(z) < 0.5:
            work_pole = np.int64(k)
            normal[WORK_TERMS], normal[k] = work, 0.0
        else:
            normal[k] = work / z
    if rubbing:
        e2, e4, e6 = 3.0 * hh, 3.0 * h4, h4 * hh
        u0 = u1 = u2 = u3 = u4 = u5 = 0.0
        for k in range(WORK_TERMS):
            u6, u5, u4, u3, u2, u1, u0 = u5, u4, u3, u2, u1, u0, friction[k] if k <= ORDER else 0.0
            work = u0 + e2 * u2 + (e4 * u4 + e6 * u6)
            if k == work_pole:
                friction[WORK_TERMS], friction[k] = work, 0.0
            else:
                friction[k] = work / (2.0 * exponent + k)
    return rest, push, share, pole, work_pole


@inner
def _before(series, pole, f0, f1, f2, f3, f4):
    """Return the coefficient of E G at the pole, from E's before it."""
    g, reciprocals = series.coefficients, series.reciprocals
    total = 0.0
    g0 = g1 = g2 = g3 = g4 = 0.0
    for k in range(pole):
        g4, g3, g2, g1, g0 = g3, g2, g1, g0, g[k]
        total -= (f0 * g0 + f1 * g1 + f2 * g2 + f3 * g3 + f4 * g4) * reciprocals[k] * g[pole - k]
    return total


@inner
def expand_works(series, work_series, rubbing):
    """Make the `WorkSeries` of a `SlipSeries`; `rubbing` says that the work of friction is wanted too."""
    normal, friction, quotients = work_series.normal, work_series.friction, work_series.quotients
    shape, mu, c, bl, bp = series.shape, series.mu, series.c, series.bl, series.bp
    size = shape.unit * series.scale
    h = shape.h
    hh = h * h
    j0, j1, j2 = size * (c - mu * bl), size * (-2.0 * mu * bp), size * (c + mu * bl)
    f0, f1, f2, f3, f4 = j0, j1 * h, (j0 + j2) * hh, j1 * hh * h, j2 * hh * hh
    rest = push = share = 0.0
    pole = work_pole = np.int64(-1)
    if series.around_invariant:
        last = _expand_square(friction, shape)
        rest, push, share, pole, work_pole = _expand_around(
            series, normal, friction, quotients, rubbing, f0, f1, f2, f3, f4
        )
    else:
        last = _expand(normal, friction, rubbing, shape, series.v3, f0, f1, f2, f3, f4)
    return WorkSeries(normal, friction, quotients, rest, push, share, pole, work_pole, last)


@inlined
def normal_work(series, work_series, x, span):
    """Return the normal work over (0, x), where P₃ grows by `span`. (3.18), (4.8)"""
    normal, shape = work_series.normal, series.shape
    size = shape.unit * series.scale
    if not series.around_invariant:
        if not _converges(work_series, x):
            return quadrature(series, x)[0]
        return size * x * _sum(normal, ORDER, x)
    exponent, start = shape.exponent, shape.start
    length = shape.sign * x
    y, drop, power, part = passed(exponent, start, length)
    short = x * max(1.0, abs(exponent)) < SHORT
    if short or work_series.pole > LATE or not _converges(work_series, max(start, y)):
        return quadrature(series, x)[0]
    work = _filled(normal, work_series.work_pole, exponent, start, length, y, drop, power, part)
    if work_series.pole >= 0:
        k = work_series.pole
        whole = fill(exponent + k, k, start, length)
        quotient = _sum(work_series.quotients, TERMS + 4, y)
        work += work_series.push * whole * (0.5 * work_series.share * whole - power * quotient)
    return work_series.rest * span + size * work


@inner
def friction_work(series, work_series, x):
    """Return the friction work over (0, x). (3.18), (4.8)"""
    friction, shape = work_series.friction, series.shape
    size = -series.mu * series.speed * shape.factor * shape.unit * series.scale
    if not series.around_invariant:
        if not _converges(work_series, x):
            return quadrature(series, x)[1]
        return size * x * _sum(friction, ORDER, x)
    length = shape.sign * x
    y, drop, power, part = passed(shape.exponent, shape.start, length)
    if not _converges(work_series, max(shape.start, y)):
        return quadrature(series, x)[1]
    pole, exponent, start = work_series.work_pole, shape.exponent, shape.start
    return size * _filled(friction, pole, exponent, start, length, y, drop, power, part)


@inner
def _sum(coefficients, degree, x):
    """Return the value of a polynomial of an even degree."""
    xx = x * x
    even, odd = coefficients[degree], 0.0
    for k in range(degree - 2, -1, -2):
        even = even * xx + coefficients[k]
        odd = odd * xx + coefficients[k + 1]
    return even + x * odd


@inner
def _filled(coefficients, pole, exponent, start, length, y, drop, power, part):
    """Sum the integrals of e^{−2aL}yᵏ over (0, L), with 1/(2a + k) in the coefficients already. (4.4)

    The last four arguments are what `passed` says.
    """
    part *= 1.0 + power
    rising = power * power
    total = 0.0
    for k in range(WORK_TERMS):
        total += coefficients[k] * part
        part = start * part + rising * drop
        rising *= y
    if pole >= 0:
        total += coefficients[WORK_TERMS] * fill(2.0 * exponent + pole, pole, start, length)
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
def quadrature(series, x):
    """Integrate the works over (0, x) by Gauss' nodes."""
    mu, v3, speed, exponent = series.mu, series.v3, series.speed, series.shape.exponent
    normal = friction = low = 0.0
    # from here on the direction is settled or nothing is left: the rest is straight
    end = min(x, SETTLED / max(1.0, exponent)) if series.around_invariant else x
    while low < end:
        width = end - low
        if series.around_invariant:
            # the integrand is analytic down to L ≈ −1, and falls or grows like e^{−2aL}
            width = min(width, 1.25 * (low + 1.0), 5.0 / max(1e-3, abs(exponent)))
        for i in range(_ABSCISSAE.size):
            _, _, _, dv3, ratio, _, slope, _ = point(series, low + width * _ABSCISSAE[i])
            share = _WEIGHTS[i] * width * slope
            normal += share * (v3 + dv3)
            friction -= share * mu * speed * ratio
        low = low + width if low + width > low else end
    if end < x:
        here, there = point(series, end), point(series, x)
        span = there[0] - here[0]
        normal += span * (v3 + 0.5 * (here[3] + there[3]))
        friction -= 0.5 * mu * speed * span * (here[4] + there[4])
    return normal, friction
