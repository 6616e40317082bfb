"""Derivatives of slip along a move: by panels, and in closed form where it stops. (derivatives.md, 2 and 3)

On a panel the nodes of (3.17) integrate everything that is needed. Sensitivities at its end follow from
those at its start and from what the data change on the way; nothing is divided by g, which vanishes on
invariant directions. Axes and units are those of the `View`, and impulses here are multiplied by ω.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..._compile.declared import FLOAT_ROWS, declared
from ..._compile.jit import external, inlined
from .invariant_direction import LEFT_TO
from .moves import Units
from .slip_equations import in_frame, polynomials
from .slip_works import ABSCISSAE, INTEGRALS, NODES, WEIGHTS

DATA = 8
"""Columns of sensitivities: v₁, v₂, b₁, b₂ and A = α + [[δ, χ], [χ, −δ]] by α, δ, χ; and of μ."""

VT1, VT2, PATH, STOP = 0, 1, 2, 3
"""Rows of sensitivities: v_t and κ·∫v_t dP₃, both at fixed P₃, and the P₃ at which v_t = 0."""

_GROWTH, _BEND, _TURNED, _COS, _SIN, _SPEED, _PUSH, _IMPULSE, _BENT, _LAG, _SLID, _SLIDES, _SWEPT, _SWEEPS = (
    range(14)
)
_ALONG, _ACROSS, _BY = 14, 19, 24
NODE_ROWS = 31
"""Rows of scratch for what there is at the nodes; those of integrands have the weights in them."""

EFOLDS = 6.0
"""Change of ln r or ln g on a panel, at most."""

NEAREST = 1.6
"""Length of a panel, in L, over the distance of the next invariant direction."""

TAIL = 1e-13
"""Part of the path over which slip that settles turns by less than rounding until v_t = 0."""

UNSEEN = 1e-20
"""Tangent of an angle that changes no double: slip this close to an invariant direction is straight."""

HALF_ANGLE, INVARIANT, STRAIGHT = 0, 1, 2
"""What a panel's length is: x of (3.9), L of (4.2), s of (3.5)."""


class Slip(NamedTuple):
    """Where slip stands: direction, speed and p₀."""

    s1: float
    s2: float
    speed: float
    turn: float


@inlined
def _integrate(values, row, out):
    """Fill row `out` with the integrals of `row` up to the nodes, and return the whole. (3.17)"""
    total = 0.0
    for i in range(NODES):
        values[out, i] = 0.0
    for j in range(NODES):
        term = values[row, j]
        total += term
        for i in range(NODES):
            values[out, i] += INTEGRALS[j, i] * term
    return total


@inlined
def frame_polynomials(units, s1, s2, turn):
    """Return the polynomials of a direction and the coefficients of N. (D7)"""
    al, ax, ap, bl, bp = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    p = polynomials(al, ax, ap, bl, bp)
    return p, p.m1 + turn, p.m2 + p.p1 - p.m0, p.m1 + p.m3 + p.p2, -2.0 * bl


@inlined
def _place(kind, u, whole, rate):
    """Return ξ = 2t/p₀ and dξ/du. (D8)"""
    if kind == INVARIANT:
        return -whole * math.expm1(-u), whole * math.exp(-u)
    if kind == STRAIGHT:
        return (math.expm1(rate * u) / rate if rate != 0.0 else u), math.exp(rate * u)
    return u, 1.0


@inlined
def _fill_nodes(units, slip, kind, size, root, values):
    """Fill the rows of scratch that slip's own course gives. (D6)–(D8)

    Returns:
        at the end t, H, E, the speed and P₃.
    """
    turn = slip.turn
    p, n0, n1, n2, n3 = frame_polynomials(units, slip.s1, slip.s2, turn)
    h, rate = 0.5 * turn, 0.5 * p.p1
    whole = root / h if kind == INVARIANT else 0.0
    t = bend = turned = 0.0
    for i in range(NODES + 1):
        xi, slope = _place(kind, size * (ABSCISSAE[i] if i < NODES else 1.0), whole, rate)
        t = h * xi
        fall = 1.0 + 0.5 * xi * (p.p1 + t * (p.p2 + t * (p.p3 + t * p.p4)))
        chord = 1.0 + t * t
        square = chord * chord
        bend = 0.5 * xi * (n0 + t * (n1 + t * (n2 + t * n3))) / square
        turned = fall / square
        if i < NODES:
            ds = WEIGHTS[i] * size * slope / fall
            values[_GROWTH, i] = ds * (p.m0 + t * (p.m1 + t * (p.m2 + t * p.m3)))
            values[_PUSH, i] = ds * square
            values[_BEND, i], values[_TURNED, i] = bend, turned
            values[_COS, i], values[_SIN, i] = (1.0 - t * t) / chord, 2.0 * t / chord
            values[_SPEED, i] = chord
    growth = _integrate(values, _GROWTH, _IMPULSE)
    for i in range(NODES):
        radius = slip.speed * math.exp(values[_IMPULSE, i])
        values[_PUSH, i] *= radius
        values[_SPEED, i] *= radius
    span = _integrate(values, _PUSH, _IMPULSE)
    return t, bend, turned, slip.speed * math.exp(growth) * (1.0 + t * t), span


@inlined
def _fill_sources(values):
    """Fill the rows of ∂F/∂θ along and across slip, for θ = b∥, b⊥, α, δ, χ in the panel's frame. (D10)"""
    for i in range(NODES):
        c, s = values[_COS, i], values[_SIN, i]
        c2, s2 = c * c - s * s, 2.0 * c * s
        values[_ALONG, i], values[_ACROSS, i] = c, -s
        values[_ALONG + 1, i], values[_ACROSS + 1, i] = s, c
        values[_ALONG + 2, i], values[_ACROSS + 2, i] = -1.0, 0.0
        values[_ALONG + 3, i], values[_ACROSS + 3, i] = -c2, s2
        values[_ALONG + 4, i], values[_ACROSS + 4, i] = -s2, -c2


@inlined
def _fill_weights(values, span, lag, bend, slid, swept):
    """Fill the rows by which sources count: in ln r, φ, P₃ and κ·∫v_t dP₃. (D10)"""
    for i in range(NODES):
        w = values[_PUSH, i] / values[_SPEED, i]
        q = w / values[_TURNED, i]
        here, rest, left = values[_BEND, i], span - values[_IMPULSE, i], slid - values[_SLID, i]
        values[_BY, i], values[_BY + 1, i], values[_BY + 2, i] = w, q * (bend - here), q
        values[_BY + 3, i], values[_BY + 4, i] = w * rest, q * (lag - values[_LAG, i] - here * rest)
        values[_BY + 5, i] = 2.0 * w * left
        values[_BY + 6, i] = q * (swept - values[_SWEPT, i] - 2.0 * here * left)


@inlined
def _source(values, k, works):
    """Return what a datum changes on a panel: of ln r, φ, P₃ and κ·∫v_t dP₃, in the sense of (D9)."""
    radial = angle = late = path = 0.0
    for i in range(NODES):
        along, across = values[_ALONG + k, i], values[_ACROSS + k, i]
        radial += values[_BY, i] * along + values[_BY + 1, i] * across
        angle += values[_BY + 2, i] * across
        late += values[_BY + 3, i] * along + values[_BY + 4, i] * across
    if works:
        for i in range(NODES):
            path += values[_BY + 5, i] * values[_ALONG + k, i] + values[_BY + 6, i] * values[_ACROSS + k, i]
    return radial, angle, late, path


@declared(Units, Slip, int, float, float, float, float, float, bool, FLOAT_ROWS, FLOAT_ROWS)
@external
def cross_panel(units, slip, kind, size, root, mu, k1, k2, works, values, found):
    """Take the sensitivities across a panel. (D6)–(D10)

    Args:
        units, slip: The slip equations, and where slip stands.
        kind, size: What the panel's length is, and how much.
        root: Half-angle tangent from here to the invariant direction that L goes to.
        mu: Friction.
        k1, k2: κ.
        works: Whether row PATH is wanted.
        values: (NODE_ROWS, NODES) scratch.
        found: (4, DATA) sensitivities, which are brought to its end.

    Returns:
        the `Slip` at its end, the impulse of the panel, ∫σ dP₃ (2) and ∫∫σ dP₃ dP₃ (2).
    """
    s1, s2, speed, turn = slip
    t, bend, turned, fast, span = _fill_nodes(units, slip, kind, size, root, values)
    kl, kp = k1 * s1 + k2 * s2, k2 * s1 - k1 * s2
    for i in range(NODES):
        push, r = values[_PUSH, i], values[_SPEED, i]
        c, s = values[_COS, i], values[_SIN, i]
        values[_BENT, i] = push * values[_BEND, i]
        values[_SLIDES, i] = push * r * (kl * c + kp * s)
        values[_SWEEPS, i] = 2.0 * values[_BEND, i] * values[_SLIDES, i] + push * r * values[_TURNED, i] * (
            kp * c - kl * s
        )
    lag = _integrate(values, _BENT, _LAG)
    slid = swept = 0.0
    if works:
        slid, swept = _integrate(values, _SLIDES, _SLID), _integrate(values, _SWEEPS, _SWEPT)
    _fill_sources(values)

    chord = 1.0 + t * t
    c, s = (1.0 - t * t) / chord, 2.0 * t / chord
    e1, e2 = s1 * c - s2 * s, s2 * c + s1 * s
    norm = 1.0 / math.sqrt(e1 * e1 + e2 * e2)
    e1, e2 = e1 * norm, e2 * norm
    al, _, _, bl, _ = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    f, g = (bl - al) + turn * bend, turn * turned
    f1, f2 = f * e1 - g * e2, f * e2 + g * e1
    kv = fast * (k1 * e1 + k2 * e2)
    cos2, sin2 = s1 * s1 - s2 * s2, 2.0 * s1 * s2
    _fill_weights(values, span, lag, bend, slid, swept)
    b0, b1, a0 = _source(values, 0, works), _source(values, 1, works), _source(values, 2, works)
    a1, a2 = _source(values, 3, works), _source(values, 4, works)
    for j in range(DATA - 1):
        along = (found[VT1, j] * s1 + found[VT2, j] * s2) / speed
        angle = (found[VT2, j] * s1 - found[VT1, j] * s2) / speed
        radial, late = along + bend * angle, span * along + lag * angle
        path = 2.0 * slid * along + swept * angle
        if j >= 2:
            x, y, u, w, size = a0, a0, 1.0, 0.0, mu * units.per
            if j < 4:
                x, y, size = b0, b1, units.per
                u, w = (s1, -s2) if j == 2 else (s2, s1)
            elif j > 4:
                x, y = a1, a2
                u, w = (cos2, -sin2) if j == 5 else (sin2, cos2)
            radial += size * (u * x[0] + w * y[0])
            angle += size * (u * x[1] + w * y[1])
            late += size * (u * x[2] + w * y[2])
            path += size * (u * x[3] + w * y[3])
        out, across = fast * radial, fast * turned * angle
        found[VT1, j] = out * e1 - across * e2 - f1 * late
        found[VT2, j] = out * e2 + across * e1 - f2 * late
        found[PATH, j] += units.per * (path - kv * late)
    i1 = i2 = m1 = m2 = 0.0
    for i in range(NODES):
        w, rest = values[_PUSH, i], span - values[_IMPULSE, i]
        along, across = w * values[_COS, i], w * values[_SIN, i]
        i1, i2, m1, m2 = i1 + along, i2 + across, m1 + rest * along, m2 + rest * across
    turned_back = i1 * s1 - i2 * s2, i1 * s2 + i2 * s1, m1 * s1 - m2 * s2, m1 * s2 + m2 * s1
    return Slip(e1, e2, fast, g), span, *turned_back


@inlined
def come_to_rest(units, slip, mu, k1, k2, found):
    """Take the sensitivities along straight slip to v_t = 0. (D11)

    Returns:
        the impulse until then.
    """
    s1, s2, speed, turn = slip
    p, n0, _, _, _ = frame_polynomials(units, s1, s2, turn)
    f, rate, bend = p.m0, 0.5 * p.p1, 0.5 * n0
    kl, kp = k1 * s1 + k2 * s2, k2 * s1 - k1 * s2
    # f + g′ = −μA⊥ and f′ = −μA× vanish together where A is singular
    stop1, stop2 = -1.0 / f, bend / (f * (f + rate)) if bend != 0.0 else 0.0
    path1, path2 = -kl / f, (kl * bend / f - kp) / (2.0 * f + rate)
    span = -speed / f
    cos2, sin2 = s1 * s1 - s2 * s2, 2.0 * s1 * s2
    for j in range(DATA - 1):
        along, across = found[VT1, j] * s1 + found[VT2, j] * s2, found[VT2, j] * s1 - found[VT1, j] * s2
        stop, path = stop1 * along + stop2 * across, speed * (path1 * along + path2 * across)
        if j >= 2:
            along, across, size = -1.0, 0.0, mu * units.per
            if j < 4:
                along, across = (s1, -s2) if j == 2 else (s2, s1)
                size = units.per
            elif j > 4:
                along, across = (-cos2, sin2) if j == 5 else (-sin2, -cos2)
            stop += size * span * (stop1 * along + stop2 * across)
            path += size * 0.5 * span * speed * (path1 * along + path2 * across)
        found[STOP, j] = units.per * stop
        found[PATH, j] += units.per * path
        found[VT1, j] = found[VT2, j] = 0.0
    return span


@inlined
def _next_panel(around, root, left):
    """Return the length of the next panel around an invariant direction, and how much slip still turns.

    Args:
        around: The polynomials of that direction.
        root: Its half-angle tangent from here.
        left: L that is left.
    """
    at = abs(root)
    others = at * (abs(around.p2) + at * (abs(around.p3) + at * abs(around.p4))) / abs(around.p1)
    size = EFOLDS / max(1.0, abs(2.0 * around.m0 / around.p1))
    far = -math.log(min(others, LEFT_TO)) if others > 0.0 else math.inf
    size = min(size, NEAREST * far if left > 0.0 else far / NEAREST)
    return math.copysign(min(size, abs(left)), left), at + others


@inlined
def _turn_to(units, slip, root):
    """Return p₀ by the root: as p falls towards it, an error of their ratio would grow like 1/p."""
    p, _, _, _, _ = frame_polynomials(units, slip.s1, slip.s2, slip.turn)
    return -root * (p.p1 + root * (p.p2 + root * (p.p3 + root * p.p4)))


@inlined
def cross_move(units, slip, length, root, span, fast, mu, k1, k2, works, values, found):
    """Take the sensitivities across a move of slip.

    Args:
        units, slip, mu, k1, k2, works, values, found: As in `cross_panel`.
        length, root: Of the `Move`.
        span: Its normal impulse times ω.
        fast: The speed at its end.

    Returns:
        ∫∫σ dP₃ dP₃ (2) over the move.
    """
    i1 = i2 = m1 = m2 = left = size = 0.0
    kind, first = int(STRAIGHT), slip.speed  # int(): numba 0.61 cannot unify its literals
    p, _, _, _, _ = frame_polynomials(units, slip.s1, slip.s2, slip.turn)
    if root != 0.0:
        kind, left = int(INVARIANT), length
        scale = 1.0 / (1.0 + root * root)
        c, s = (1.0 - root * root) * scale, 2.0 * root * scale
        p, _, _, _, _ = frame_polynomials(
            units, slip.s1 * c - slip.s2 * s, slip.s2 * c + slip.s1 * s, slip.turn
        )
    elif length != 0.0:
        kind, left, size = int(HALF_ANGLE), length, length
    elif fast > 0.0:
        gained = p.m0 * span / slip.speed
        left = math.log1p(gained) if gained > -0.5 else math.log(fast / slip.speed)
        left = left / p.m0 if p.m0 != 0.0 else span / slip.speed
        steepest = max(abs(p.m0), 0.5 * abs(p.p1))
        size = EFOLDS / steepest if steepest > 0.0 else left
    while abs(left) > 0.0:
        step, part, whole, form = min(size, left), min(size, left), 0.0, kind
        if kind == INVARIANT:
            step, turning = _next_panel(p, root, left)
            slip = Slip(slip.s1, slip.s2, slip.speed, _turn_to(units, slip, root))
            if left == math.inf and turning * slip.speed <= TAIL * first:
                break
            z = math.exp(-step)
            if abs(root) > UNSEEN:
                whole = root
                # L in the panel's own axes
                part = step + math.log1p(root * root * z) - math.log1p(root * root)
            else:
                form, part = int(STRAIGHT), -2.0 * step / p.p1
            root *= z
        left -= step
        slip, gained, j1, j2, n1, n2 = cross_panel(
            units, slip, form, part, whole, mu, k1, k2, works, values, found
        )
        m1, m2 = m1 + gained * i1 + n1, m2 + gained * i2 + n2
        i1, i2 = i1 + j1, i2 + j2
    if fast == 0.0:
        gained = come_to_rest(units, slip, mu, k1, k2, found)
        m1 += gained * (i1 + 0.5 * gained * slip.s1)
        m2 += gained * (i2 + 0.5 * gained * slip.s2)
    return m1, m2
