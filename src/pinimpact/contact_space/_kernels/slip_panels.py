"""Sensitivities across a panel of slip that turns. (derivatives.md, 2)

All integrals use the nodes of (3.17). No quantity is divided by g, which vanishes on invariant directions.
Axes and units are those of the `View`; impulses are multiplied by ω.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import always_inlined, external, inlined
from .moves import Units
from .sensitivities import ROW, ROWS, arrive, four, keep, minus, plus, scaled
from .slip_equations import in_frame, polynomials
from .slip_works import ABSCISSAE, AT0, AT4, AT8, INTEGRALS, NODES, WEIGHTS, product, raised

_FIRST, _NODE_ROWS = ROW * ROWS, 17
AT, DS, BEND, COS, SIN, SPEED, DRIFT, LATER, GROWTH, PUSH, BENT, SLIDES, SWEEPS, IMPULSE, LAG, SLID, SWEPT = (
    np.int64(_FIRST + NODES * i) for i in range(_NODE_ROWS)
)
"""Offsets of rows of values at the nodes: ξ, its weights, H, σ in the axes of the panel (2), r, dP₃/r, dP₃/(r
E); weighted integrands of ln R, P₃, K, V and M; the integrals of the last four up to each node."""

RADIAL, ANGLE, LATE, PATHS, IMPULSES = (np.int64(_FIRST + NODES * _NODE_ROWS + 20 * i) for i in range(5))
"""Offsets of sums over every fourth node, five times four each. (D10)"""

ROOM = _FIRST + NODES * _NODE_ROWS + 100
"""Length of the scratch array: rows of sensitivities, values at the nodes, and sums."""

HALF_ANGLE, INVARIANT, STRAIGHT = 0, 1, 2
"""Kind of a panel, by the variable of its length: x of (3.9), L of (4.2), s of (3.5)."""


class Slip(NamedTuple):
    """State of slip: direction, speed and p₀."""

    s1: float
    s2: float
    speed: float
    turn: float


@always_inlined
def _cubic(c0, c1, c2, c3, t):
    return raised(raised(raised((c3, c3, c3, c3), t, c2), t, c1), t, c0)


@always_inlined
def _inverse(x):
    return 1.0 / x[0], 1.0 / x[1], 1.0 / x[2], 1.0 / x[3]


@always_inlined
def _total(values, k):
    """Return the sum of four numbers of scratch."""
    return (values[k] + values[k + 1]) + (values[k + 2] + values[k + 3])


@always_inlined
def _risen(s, j, i, term):
    """Add the contribution of node j to the integrals up to four nodes, from i on."""
    return (
        s[0] + INTEGRALS[j, i] * term,
        s[1] + INTEGRALS[j, i + 1] * term,
        s[2] + INTEGRALS[j, i + 2] * term,
        s[3] + INTEGRALS[j, i + 3] * term,
    )


@always_inlined
def _integrate(values, row, out):
    """Fill row `out` with the integrals of `row` up to the nodes, and return the whole. (3.17)"""
    a = b = c = d = e = f = 0.0, 0.0, 0.0, 0.0
    for j in range(0, NODES, 2):  # two independent sums, to hide latency
        term, other = values[row + j], values[row + j + 1]
        a, b, c = _risen(a, j, AT0, term), _risen(b, j, AT4, term), _risen(c, j, AT8, term)
        d, e, f = _risen(d, j + 1, AT0, other), _risen(e, j + 1, AT4, other), _risen(f, j + 1, AT8, other)
    keep(values, out, plus(a, d))
    keep(values, out + AT4, plus(b, e))
    keep(values, out + AT8, plus(c, f))
    a, b, c = four(values, row), four(values, row + AT4), four(values, row + AT8)
    s = plus(plus(a, b), c)
    return (s[0] + s[1]) + (s[2] + s[3])


@inlined
def frame_polynomials(units, s1, s2, turn):
    """Return the `Polynomials` in axes along (s1, s2), and the coefficients of N. (D7)"""
    al, ax, ap, bl, bp = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    p = polynomials(al, ax, ap, bl, bp)
    return p, p.m1 + turn, p.m2 + p.p1 - p.m0, p.m1 + p.m3 + p.p2, -2.0 * bl


@inlined
def _place(kind, u, whole, rate):
    """Return ξ = 2t/p₀ and dξ/du at u; `whole` is 2t*/p₀, `rate` p₁/2. (D8)"""
    if kind == HALF_ANGLE or (kind == STRAIGHT and rate == 0.0):
        return u, 1.0
    x = -u if kind == INVARIANT else rate * u
    # both accurate to rounding by one function call
    grown = math.expm1(x) if abs(x) < 0.5 else math.exp(x)
    grown, power = (grown, 1.0 + grown) if abs(x) < 0.5 else (grown - 1.0, grown)
    return (-whole * grown, whole * power) if kind == INVARIANT else (grown / rate, power)


@always_inlined
def _fill_rates(p, n0, n1, n2, n3, h, values):
    """Fill the rows of scratch that do not depend on r, from ξ and its weights. (D7)"""
    for i in range(0, NODES, 4):
        xi = four(values, AT + i)
        t = scaled(h, xi)
        fall = _inverse(raised(scaled(0.5, xi), _cubic(p.p1, p.p2, p.p3, p.p4, t), 1.0))
        square = product(t, t)
        chord = raised(t, t, 1.0)
        inverse = _inverse(chord)
        ds = product(four(values, DS + i), fall)
        bent = product(scaled(0.5, xi), _cubic(n0, n1, n2, n3, t))
        drift = product(ds, chord)
        keep(values, BEND + i, product(bent, product(inverse, inverse)))
        keep(values, COS + i, product(minus((1.0, 1.0, 1.0, 1.0), square), inverse))
        keep(values, SIN + i, product(scaled(2.0, t), inverse))
        keep(values, SPEED + i, chord)
        keep(values, DRIFT + i, drift)
        keep(values, LATER + i, product(product(drift, fall), product(chord, chord)))
        keep(values, GROWTH + i, product(ds, _cubic(p.m0, p.m1, p.m2, p.m3, t)))


@always_inlined
def _fill_nodes(units, slip, kind, size, root, values):
    """Fill the rows of scratch from AT to GROWTH; return t, H, E and the speed at the end. (D6)–(D8)"""
    h = 0.5 * slip.turn
    p, n0, n1, n2, n3 = frame_polynomials(units, slip.s1, slip.s2, slip.turn)
    rate = 0.5 * p.p1
    whole = root / h if kind == INVARIANT else 0.0
    for i in range(NODES):
        xi, slope = _place(kind, size * ABSCISSAE[i], whole, rate)
        values[AT + i], values[DS + i] = xi, WEIGHTS[i] * size * slope
    _fill_rates(p, n0, n1, n2, n3, h, values)
    growth = _integrate(values, GROWTH, IMPULSE)
    for i in range(NODES):
        values[SPEED + i] *= slip.speed * math.exp(values[IMPULSE + i])
    xi, _ = _place(kind, size, whole, rate)
    t = h * xi
    chord = 1.0 + t * t
    per = 1.0 / (chord * chord)
    bend = 0.5 * xi * (n0 + t * (n1 + t * (n2 + t * n3))) * per
    turned = (1.0 + 0.5 * xi * (p.p1 + t * (p.p2 + t * (p.p3 + t * p.p4)))) * per
    return t, bend, turned, slip.speed * math.exp(growth) * chord


@always_inlined
def _fill_integrals(values, works, kl, kp):
    """Fill the rows of scratch of P₃, K and, with `works`, V and M; return these four at the end. (D6), (D10)

    (kl, kp) is k of (1.4) in the axes of the panel.
    """
    for i in range(0, NODES, 4):
        push = product(four(values, DRIFT + i), four(values, SPEED + i))
        keep(values, PUSH + i, push)
        keep(values, BENT + i, product(push, four(values, BEND + i)))
    span, lag = _integrate(values, PUSH, IMPULSE), _integrate(values, BENT, LAG)
    if not works:
        return span, lag, 0.0, 0.0
    for i in range(0, NODES, 4):
        c, s = four(values, COS + i), four(values, SIN + i)
        path = product(four(values, PUSH + i), four(values, SPEED + i))
        slides = product(path, plus(scaled(kl, c), scaled(kp, s)))
        turned = product(four(values, DRIFT + i), _inverse(four(values, LATER + i)))
        across = product(product(path, turned), minus(scaled(kp, c), scaled(kl, s)))
        keep(values, SLIDES + i, slides)
        keep(values, SWEEPS + i, plus(product(scaled(2.0, four(values, BEND + i)), slides), across))
    return span, lag, _integrate(values, SLIDES, SLID), _integrate(values, SWEEPS, SWEPT)


@always_inlined
def _add(values, row, k, x):
    keep(values, row + k, plus(four(values, row + k), x))


@always_inlined
def _add_sources(values, row, along, across, direction):
    """Add the contributions of ∂F/∂θ along and across slip at four nodes, θ = b∥, b⊥, −δ, −χ, −α. (D10)"""
    c, s, c2, s2 = direction
    _add(values, row, 0, minus(product(along, c), product(across, s)))
    _add(values, row, 4, plus(product(along, s), product(across, c)))
    _add(values, row, 8, minus(product(along, c2), product(across, s2)))
    _add(values, row, 12, plus(product(along, s2), product(across, c2)))
    _add(values, row, 16, along)


@always_inlined
def _left(values, row, k, whole):
    """Return the integrals from four nodes to the end, for the total `whole`."""
    return minus((whole, whole, whole, whole), four(values, row + k))


@always_inlined
def _sum_sources(values, works, bend, span, lag, slid, swept):
    """Fill the rows of sums. (D10)"""
    for i in range(RADIAL, ROOM if works else PATHS, 4):
        keep(values, i, (0.0, 0.0, 0.0, 0.0))
    for i in range(0, NODES, 4):
        c, s = four(values, COS + i), four(values, SIN + i)
        direction = c, s, minus(product(c, c), product(s, s)), scaled(2.0, product(c, s))
        w, q, here = four(values, DRIFT + i), four(values, LATER + i), four(values, BEND + i)
        rest = _left(values, IMPULSE, i, span)
        later = minus(_left(values, LAG, i, lag), product(here, rest))
        _add_sources(values, RADIAL, w, product(q, _left(values, BEND, i, bend)), direction)
        _add_sources(values, ANGLE, (0.0, 0.0, 0.0, 0.0), q, direction)
        _add_sources(values, LATE, product(w, rest), product(q, later), direction)
        if works:
            left = scaled(2.0, _left(values, SLID, i, slid))
            later = minus(_left(values, SWEPT, i, swept), product(here, left))
            _add_sources(values, PATHS, product(w, left), product(q, later), direction)
            push = four(values, PUSH + i)
            along, across = product(push, c), product(push, s)
            _add(values, IMPULSES, 0, along)
            _add(values, IMPULSES, 4, across)
            _add(values, IMPULSES, 8, product(rest, along))
            _add(values, IMPULSES, 12, product(rest, across))


@inlined
def _arrival(start, end):
    """Return δv_t (2) and δV at the end of a panel. (D10)"""
    (radial, angle, late, path), (fast, e1, e2, f1, f2, kv) = start, end
    out, across = fast * radial, fast * angle
    return out * e1 - across * e2 - f1 * late, out * e2 + across * e1 - f2 * late, path - kv * late


@declared(Units, Slip, int, float, float, float, float, float, bool, FLOATS)
@external
def cross_panel(units, slip, kind, size, root, mu, k1, k2, works, values):
    """Propagate the sensitivities through a panel. (D6)–(D10)

    Args:
        units, slip: The `Units`, and the `Slip` at the start.
        kind, size: Kind and length of the panel.
        root: Half-angle tangent to the invariant direction, for the kind INVARIANT.
        mu: μ.
        k1, k2: k of (1.4).
        works: Whether row PATH and the integrals are needed.
        values: (ROOM,) rows of sensitivities, which are overwritten, and scratch.

    Returns:
        the `Slip` at its end, the impulse of the panel, ∫σ dP₃ (2) and ∫∫σ dP₃ dP₃ (2).
    """
    s1, s2, speed, turn = slip
    t, bend, turned, fast = _fill_nodes(units, slip, kind, size, root, values)
    span, lag, slid, swept = _fill_integrals(values, works, k1 * s1 + k2 * s2, k2 * s1 - k1 * s2)
    _sum_sources(values, works, bend, span, lag, slid, swept)
    chord = 1.0 + t * t
    c, s = (1.0 - t * t) / chord, 2.0 * t / chord
    e1, e2 = s1 * c - s2 * s, s2 * c + s1 * s
    norm = 1.0 / math.sqrt(e1 * e1 + e2 * e2)
    e1, e2 = e1 * norm, e2 * norm
    al, _, _, bl, _ = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    f, g = (bl - al) + turn * bend, turn * turned
    end = fast, e1, e2, f * e1 - g * e2, f * e2 + g * e1, fast * (k1 * e1 + k2 * e2)
    per = 1.0 / speed
    arrive(
        *(values, s1, s2, units.per, mu),
        _arrival((per, 0.0, per * span, per * 2.0 * slid), end),
        _arrival((per * bend, per * turned, per * lag, per * swept), end),
        (
            _arrival(_sums(values, works, turned, 0), end),
            _arrival(_sums(values, works, turned, 4), end),
            _arrival(_sums(values, works, turned, 8), end),
            _arrival(_sums(values, works, turned, 12), end),
            _arrival(_sums(values, works, turned, 16), end),
        ),
    )
    i1 = i2 = m1 = m2 = 0.0
    if works:
        i1, i2 = _total(values, IMPULSES), _total(values, IMPULSES + 4)
        m1, m2 = _total(values, IMPULSES + 8), _total(values, IMPULSES + 12)
    turned_back = i1 * s1 - i2 * s2, i1 * s2 + i2 * s1, m1 * s1 - m2 * s2, m1 * s2 + m2 * s1
    return Slip(e1, e2, fast, g), span, *turned_back


@always_inlined
def _sums(values, works, turned, k):
    """Return the sums at offset k of each row of sums, as the argument `start` of `_arrival`."""
    path = _total(values, PATHS + k) if works else 0.0
    return _total(values, RADIAL + k), turned * _total(values, ANGLE + k), _total(values, LATE + k), path
