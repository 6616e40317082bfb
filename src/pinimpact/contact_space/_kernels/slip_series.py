"""Evaluation of a series of turning slip, on which v₃ is monotone.

The variable is x = 2t/p(0) (`slip_equations`), or x = |L| for a series around an invariant direction
(`invariant_direction`). (theory.md, 3.3 and 4)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._compile.jit import always_inlined, inlined
from ..._numeric.loops import power
from .delassus import EPS
from .slip_equations import Shape, moments
from .tolerances import HALLEY, ROOT

SETTLED = 38.0
"""e^{−SETTLED} is below rounding."""


class SlipSeries(NamedTuple):
    """Series of turning slip from x = 0 on.

    Attributes:
        around_invariant: Whether it is a series around an invariant direction.
        coefficients: (m,) coefficients of S or G.
        reciprocals: (m + 4,) 1/(a + k), for a series around an invariant direction.
        shape: Its `Shape`.
        scale: The speed at x = 0 over ω.
        mu: μ.
        j0, j1, j2: Coefficients of dv₃/dP₃ (1 + t²) in powers of t. (3.16)
        v3, speed: v₃ and |v_t| at x = 0.
    """

    around_invariant: bool
    coefficients: NDArray[np.float64]
    reciprocals: NDArray[np.float64]
    shape: Shape
    scale: float
    mu: float
    j0: float
    j1: float
    j2: float
    v3: float
    speed: float


@inlined
def _roots(k0, k1, k2):
    """Return the real roots of k₀ + k₁t + k₂t²; inf for each that does not exist."""
    square = k1 * k1 - 4.0 * k0 * k2
    if square < 0.0:
        return math.inf, math.inf
    q = -0.5 * (k1 + math.copysign(math.sqrt(square), k1))
    return k0 / q if q != 0.0 else math.inf, q / k2 if k2 != 0.0 else math.inf


@inlined
def first_root(k0, k1, k2, end, size):
    """Return the first root of k₀ + k₁t + k₂t², an extremum of v₃, between 0 and `end`, or else `end`.

    Roots within `ROOT` |size| of 0 are ignored: v₃ changes by less than rounding up to there.
    """
    found, least = end, ROOT * abs(size)
    for t in _roots(k0, k1, k2):
        if t * end > 0.0 and least < abs(t) < abs(found):
            found = t
    return found


@inlined
def last_root(k0, k1, k2, start):
    """Return the first root of k₀ + k₁t + k₂t² on the way from `start` to 0, or 0 for none.

    Roots close to 0 are accurate relative to their size.
    """
    found, most = 0.0, (1.0 - ROOT) * abs(start)
    for t in _roots(k0, k1, k2):
        if t * start > 0.0 and abs(found) < abs(t) < most:
            found = t
    return found


@inlined
def halley(f, slope, bend):
    """Return the step of Halley's method, or of Newton's if the curvature is too large.

    `bend` is the ratio of the second to the first derivative.
    """
    step = -f / slope
    damp = 1.0 + 0.5 * bend * step
    return step / damp if damp > 0.5 else step


@inlined
def leap(f, slope, bend):
    """Return the step to a root of f if its slope is exponential, as around an invariant direction."""
    bent = -bend * f / slope
    # a denormal `bend` has few digits, so a slope that is nearly constant is taken as such
    if abs(bent) <= EPS or not -0.99 < bent < math.inf:
        return halley(f, slope, bend)
    return math.log1p(bent) / bend


@inlined
def settled(step, x, f, slope):
    """Return whether a step of Halley's method has converged; next to an extremum f has to be small too."""
    return abs(step) <= HALLEY * x and abs(f) <= 2.0 * HALLEY * x * abs(slope)


@inlined
def passed(exponent, start, span):
    """Return y, start − y, e^{−aL} and 1 − e^{−aL}, with L = `span` and y = start e^{−L}."""
    if span == math.inf:
        return 0.0, start, 0.0, 1.0
    drop = -start * math.expm1(-span)
    part = -math.expm1(-exponent * span)
    # each form is accurate relative to y
    y = start - drop if drop < 0.5 * start else start * math.exp(-span)
    return y, drop, 1.0 - part if part < 0.5 else math.exp(-exponent * span), part


@inlined
def fill(z, k, start, span):
    """Return startᵏ(1 − e^{−zL})/z with L = `span`, accurate for z close to zero too."""
    whole = power(start, k)
    if z == 0.0:
        return whole * span
    return whole / z if span == math.inf else whole * (-math.expm1(-z * span) / z)


@inlined
def invariant_moments(coefficients, reciprocals, exponent, start, span):
    """Return y, e^{−aL}G(y) and the integrals of e^{−aL}yʲG over (0, L) for j = 0 … 4. (4.4)"""
    y, drop, power, part = passed(exponent, start, span)
    rising = power
    # fill_k = (start^k − e^{−aL} y^k)/(a+k); its numerator is summed without cancellation
    fill0 = part * reciprocals[0]
    part = start * part + rising * drop
    fill1 = part * reciprocals[1]
    rising *= y
    part = start * part + rising * drop
    fill2 = part * reciprocals[2]
    rising *= y
    part = start * part + rising * drop
    fill3 = part * reciprocals[3]
    value = n0 = n1 = n2 = n3 = n4 = 0.0
    terms = len(coefficients) - 1
    for k in range(terms + 1):
        rising *= y
        part = start * part + rising * drop
        fill4 = part * reciprocals[k + 4]
        term = coefficients[k]
        value += term * power
        power *= y
        n0 += term * fill0
        n1 += term * fill1
        n2 += term * fill2
        n3 += term * fill3
        n4 += term * fill4
        fill0, fill1, fill2, fill3 = fill1, fill2, fill3, fill4
    if exponent < 0.5:
        # the one k with a + k close to zero has reciprocal 0 and was left out
        k = min(int(0.5 - exponent), terms + 4)
        if k > 0 and reciprocals[k] != 0.0:
            k -= 1
        z = exponent + k
        if reciprocals[k] == 0.0:
            fill0 = fill(z, k, start, span)
            n0 += coefficients[k] * fill0 if k <= terms else 0.0
            n1 += coefficients[k - 1] * fill0 if 1 <= k <= terms + 1 else 0.0
            n2 += coefficients[k - 2] * fill0 if 2 <= k <= terms + 2 else 0.0
            n3 += coefficients[k - 3] * fill0 if 3 <= k <= terms + 3 else 0.0
            n4 += coefficients[k - 4] * fill0 if 4 <= k <= terms + 4 else 0.0
    return y, value, n0, n1, n2, n3, n4


@always_inlined
def _bend(shape, x, t):
    """Return (ln dP₃/dx)′ of a series in the half-angle, and p̂. (3.13)"""
    fall = 1.0 + x * (shape.q1 + x * (shape.q2 + x * (shape.q3 + x * shape.q4)))
    growth = shape.w0 + x * (shape.w1 + x * (shape.w2 + x * shape.w3))
    return growth / fall + 4.0 * shape.h * t / (1.0 + t * t), fall


@always_inlined
def flow(series, x, value):
    """Return dP₃/dx at x, where S is `value`, (ln dP₃/dx)′ and t, for a series in the half-angle."""
    shape = series.shape
    t = shape.h * x
    chord = 1.0 + t * t
    return shape.unit * series.scale * value * chord * chord, _bend(shape, x, t)[0], t


@always_inlined
def point(series, x):
    """Return ΔP₃, ΔP∥, ΔP⊥, Δv₃, the speed over that at 0, t, dP₃/dx and (ln dP₃/dx)′ at x. (3.12), (4.5)"""
    around_invariant, coefficients, reciprocals, shape, scale, mu, j0, j1, j2, _, _ = series
    h, factor, unit, exponent, start, sign, q1, q2, q3, w0, w1, w2, _, _ = shape
    if around_invariant:
        y, value, n0, n1, n2, n3, n4 = invariant_moments(coefficients, reciprocals, exponent, start, sign * x)
        t = h * y
        fall = 1.0 + y * (q1 + y * (q2 + y * q3))
        tt = t * t
        bend = -sign * (exponent + y * (w0 + y * (w1 + y * w2)) / fall + 4.0 * tt / (1.0 + tt))
    else:
        value, n0, n1, n2, n3, n4 = moments(coefficients, x)
        t = h * x
        tt = t * t
        bend, fall = _bend(shape, x, t)
    hh = h * h
    h4 = hh * hh
    unit *= scale
    chord = 1.0 + tt
    normal = unit * (n0 + 2.0 * hh * n2 + h4 * n4)
    along = -mu * unit * (n0 - h4 * n4)
    across = -2.0 * mu * unit * h * (n1 + hh * n3)
    dv3 = unit * (j0 * n0 + h * (j1 * (n1 + hh * n3) + h * ((j0 + j2) * n2 + hh * j2 * n4)))
    slope = sign * unit * value * chord * chord
    return normal, along, across, dv3, factor * value * fall * chord, t, slope, bend


@inlined
def beginning(series):
    """Return dP₃/dx and (ln dP₃/dx)′ at x = 0."""
    h, factor, unit, exponent, start, sign, q1, q2, q3, w0, w1, w2, _, _ = series.shape
    slope = unit * series.scale
    if not series.around_invariant:
        return slope, w0
    fall = 1.0 + start * (q1 + start * (q2 + start * q3))
    t = h * start
    tt = t * t
    rest = exponent + start * (w0 + start * (w1 + start * w2)) / fall + 4.0 * tt / (1.0 + tt)
    return sign * slope * (1.0 + tt) / (factor * fall), -sign * rest
