"""Derivatives of slip along a move: by panels, and in closed form where it stops. (derivatives.md, 2 and 3)

On a panel the nodes of (3.17) integrate everything that is needed. Sensitivities at its end follow from
those at its start and from what the data change on the way; nothing is divided by g, which vanishes on
invariant directions. Axes and units are those of the `View`, and impulses here are multiplied by ω.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import always_inlined, external, inlined
from .invariant_direction import LEFT_TO
from .moves import Units
from .slip_equations import in_frame, polynomials
from .slip_works import ABSCISSAE, AT0, AT4, AT8, INTEGRALS, NODES, WEIGHTS, product, raised

DATA = 8
"""Columns of sensitivities: v₁, v₂, b₁, b₂ and A = α + [[δ, χ], [χ, −δ]] by α, δ, χ; and of μ."""

VT1, VT2, PATH, STOP = 0, 1, 2, 3
"""Rows of sensitivities: v_t and κ·∫v_t dP₃, both at fixed P₃, and the P₃ at which v_t = 0."""

_ROWS = 17
AT, DS, BEND, COS, SIN, SPEED, DRIFT, LATER, GROWTH, PUSH, BENT, SLIDES, SWEEPS, IMPULSE, LAG, SLID, SWEPT = (
    np.int64(NODES * i) for i in range(_ROWS)
)
"""Where rows of scratch begin. At the nodes there are ξ, its weights, H, σ in the panel's frame, r, dP₃/r and
the same over E; with weights, what ln R, P₃, K, V and M grow by; and the last four up to each node."""

RADIAL, ANGLE, LATE, PATHS, IMPULSES = (np.int64(NODES * _ROWS + 20 * i) for i in range(5))
"""Where sums over every fourth node begin, five times four each. (D10)"""

NODE_ROOM = NODES * _ROWS + 100
"""Floats of scratch for what there is at the nodes."""

EFOLDS = 6.0
"""Change of ln r or ln g on a panel, at most."""

NEAREST = 1.6
"""Length of a panel, in L, over the distance of the next invariant direction."""

TAIL = 1e-13
"""Part of the path over which slip that settles turns by less than rounding until v_t = 0."""

UNSEEN = 1e-20
"""Tangent of an angle that changes no double: slip this close to an invariant direction is straight."""

MOST = 1e5
"""Panels that a move may take. Only slow slip that hardly gains speed needs more, at the stick threshold."""

HALF_ANGLE, INVARIANT, STRAIGHT = 0, 1, 2
"""What a panel's length is: x of (3.9), L of (4.2), s of (3.5)."""


class Slip(NamedTuple):
    """Where slip stands: direction, speed and p₀."""

    s1: float
    s2: float
    speed: float
    turn: float


@always_inlined
def _four(values, k):
    return values[k], values[k + 1], values[k + 2], values[k + 3]


@always_inlined
def _keep(values, k, x):
    values[k], values[k + 1], values[k + 2], values[k + 3] = x


@always_inlined
def _scaled(c, x):
    return c * x[0], c * x[1], c * x[2], c * x[3]


@always_inlined
def _minus(x, y):
    return x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3]


@always_inlined
def _plus(x, y):
    return x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3]


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
    """Return what integrals up to the nodes from i on are with the term of node j."""
    return (
        s[0] + INTEGRALS[j, i] * term,
        s[1] + INTEGRALS[j, i + 1] * term,
        s[2] + INTEGRALS[j, i + 2] * term,
        s[3] + INTEGRALS[j, i + 3] * term,
    )


@always_inlined
def _integrate(values, row, out):
    """Fill row `out` with the integrals of `row` up to the nodes, and return the whole. (3.17)"""
    a = b = c = 0.0, 0.0, 0.0, 0.0
    for j in range(NODES):
        term = values[row + j]
        a, b, c = _risen(a, j, AT0, term), _risen(b, j, AT4, term), _risen(c, j, AT8, term)
    _keep(values, out, a)
    _keep(values, out + AT4, b)
    _keep(values, out + AT8, c)
    a, b, c = _four(values, row), _four(values, row + AT4), _four(values, row + AT8)
    s = _plus(_plus(a, b), c)
    return (s[0] + s[1]) + (s[2] + s[3])


@inlined
def frame_polynomials(units, s1, s2, turn):
    """Return the polynomials of a direction and the coefficients of N. (D7)"""
    al, ax, ap, bl, bp = in_frame(units.a11, units.a12, units.a22, units.b1, units.b2, s1, s2)
    p = polynomials(al, ax, ap, bl, bp)
    return p, p.m1 + turn, p.m2 + p.p1 - p.m0, p.m1 + p.m3 + p.p2, -2.0 * bl


@inlined
def _place(kind, u, whole, rate):
    """Return ξ = 2t/p₀ and dξ/du. (D8)"""
    if kind == HALF_ANGLE or (kind == STRAIGHT and rate == 0.0):
        return u, 1.0
    x = -u if kind == INVARIANT else rate * u
    # both to rounding, by one function
    grown = math.expm1(x) if abs(x) < 0.5 else math.exp(x)
    grown, power = (grown, 1.0 + grown) if abs(x) < 0.5 else (grown - 1.0, grown)
    return (-whole * grown, whole * power) if kind == INVARIANT else (grown / rate, power)


@always_inlined
def _fill_rates(p, n0, n1, n2, n3, h, values):
    """Fill what does not depend on r, from ξ and its weights. (D7)"""
    for i in range(0, NODES, 4):
        xi = _four(values, AT + i)
        t = _scaled(h, xi)
        fall = _inverse(raised(_scaled(0.5, xi), _cubic(p.p1, p.p2, p.p3, p.p4, t), 1.0))
        square = product(t, t)
        chord = raised(t, t, 1.0)
        inverse = _inverse(chord)
        ds = product(_four(values, DS + i), fall)
        bent = product(_scaled(0.5, xi), _cubic(n0, n1, n2, n3, t))
        drift = product(ds, chord)
        _keep(values, BEND + i, product(bent, product(inverse, inverse)))
        _keep(values, COS + i, product(_minus((1.0, 1.0, 1.0, 1.0), square), inverse))
        _keep(values, SIN + i, product(_scaled(2.0, t), inverse))
        _keep(values, SPEED + i, chord)
        _keep(values, DRIFT + i, drift)
        _keep(values, LATER + i, product(product(drift, fall), product(chord, chord)))
        _keep(values, GROWTH + i, product(ds, _cubic(p.m0, p.m1, p.m2, p.m3, t)))


@always_inlined
def _fill_nodes(units, slip, kind, size, root, values):
    """Fill the rows of scratch that slip's own course gives. (D6)–(D8)

    Returns:
        at the end t, H, E and the speed.
    """
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
    """Fill the rows of scratch of P₃, K and, if wanted, V and M; return all four at the end. (D6), (D10)

    Args:
        kl, kp: κ in the panel's frame.
    """
    for i in range(0, NODES, 4):
        push = product(_four(values, DRIFT + i), _four(values, SPEED + i))
        _keep(values, PUSH + i, push)
        _keep(values, BENT + i, product(push, _four(values, BEND + i)))
    span, lag = _integrate(values, PUSH, IMPULSE), _integrate(values, BENT, LAG)
    if not works:
        return span, lag, 0.0, 0.0
    for i in range(0, NODES, 4):
        c, s = _four(values, COS + i), _four(values, SIN + i)
        path = product(_four(values, PUSH + i), _four(values, SPEED + i))
        slides = product(path, _plus(_scaled(kl, c), _scaled(kp, s)))
        turned = product(_four(values, DRIFT + i), _inverse(_four(values, LATER + i)))
        across = product(product(path, turned), _minus(_scaled(kp, c), _scaled(kl, s)))
        _keep(values, SLIDES + i, slides)
        _keep(values, SWEEPS + i, _plus(product(_scaled(2.0, _four(values, BEND + i)), slides), across))
    return span, lag, _integrate(values, SLIDES, SLID), _integrate(values, SWEEPS, SWEPT)


@always_inlined
def _add(values, row, k, x):
    _keep(values, row + k, _plus(_four(values, row + k), x))


@always_inlined
def _add_sources(values, row, along, across, direction):
    """Add what ∂F/∂θ counts along and across slip at four nodes, for θ = b∥, b⊥, −δ, −χ, −α. (D10)"""
    c, s, c2, s2 = direction
    _add(values, row, 0, _minus(product(along, c), product(across, s)))
    _add(values, row, 4, _plus(product(along, s), product(across, c)))
    _add(values, row, 8, _minus(product(along, c2), product(across, s2)))
    _add(values, row, 12, _plus(product(along, s2), product(across, c2)))
    _add(values, row, 16, along)


@always_inlined
def _left(values, row, k, whole):
    """Return what is left of an integral from four nodes on."""
    return (
        whole - values[row + k],
        whole - values[row + k + 1],
        whole - values[row + k + 2],
        whole - values[row + k + 3],
    )


@always_inlined
def _sum_sources(values, works, bend, span, lag, slid, swept):
    """Fill the rows of sums. (D10)"""
    for i in range(RADIAL, NODE_ROOM if works else PATHS, 4):
        _keep(values, i, (0.0, 0.0, 0.0, 0.0))
    for i in range(0, NODES, 4):
        c, s = _four(values, COS + i), _four(values, SIN + i)
        direction = c, s, _minus(product(c, c), product(s, s)), _scaled(2.0, product(c, s))
        w, q, here = _four(values, DRIFT + i), _four(values, LATER + i), _four(values, BEND + i)
        rest = _left(values, IMPULSE, i, span)
        later = _minus(_left(values, LAG, i, lag), product(here, rest))
        _add_sources(values, RADIAL, w, product(q, _left(values, BEND, i, bend)), direction)
        _add_sources(values, ANGLE, (0.0, 0.0, 0.0, 0.0), q, direction)
        _add_sources(values, LATE, product(w, rest), product(q, later), direction)
        if works:
            left = _scaled(2.0, _left(values, SLID, i, slid))
            later = _minus(_left(values, SWEPT, i, swept), product(here, left))
            _add_sources(values, PATHS, product(w, left), product(q, later), direction)
            push = _four(values, PUSH + i)
            along, across = product(push, c), product(push, s)
            _add(values, IMPULSES, 0, along)
            _add(values, IMPULSES, 4, across)
            _add(values, IMPULSES, 8, product(rest, along))
            _add(values, IMPULSES, 12, product(rest, across))


@inlined
def _arrival(radial, angle, late, path, fast, turned, e1, e2, f1, f2, kv):
    """Return δv_t (2) and δV at the end of a panel. (D10)"""
    out, across = fast * radial, fast * turned * angle
    return out * e1 - across * e2 - f1 * late, out * e2 + across * e1 - f2 * late, path - kv * late


@declared(Units, Slip, int, float, float, float, float, float, bool, FLOATS, FLOAT_ROWS)
@external
def cross_panel(units, slip, kind, size, root, mu, k1, k2, works, values, found):
    """Take the sensitivities across a panel. (D6)–(D10)

    Args:
        units, slip: The slip equations, and where slip stands.
        kind, size: What the panel's length is, and how much.
        root: Half-angle tangent from here to the invariant direction that L goes to.
        mu: Friction.
        k1, k2: κ.
        works: Whether row PATH and the integrals are wanted.
        values: (NODE_ROOM,) scratch.
        found: (4, DATA) sensitivities, which are brought to its end.

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
    end = fast, turned, e1, e2, f * e1 - g * e2, f * e2 + g * e1, fast * (k1 * e1 + k2 * e2)
    per = 1.0 / speed
    x1, x2, x3 = _arrival(per, 0.0, per * span, per * 2.0 * slid, *end)
    y1, y2, y3 = _arrival(per * bend, per, per * lag, per * swept, *end)
    m11, m12, m21, m22 = x1 * s1 - y1 * s2, x1 * s2 + y1 * s1, x2 * s1 - y2 * s2, x2 * s2 + y2 * s1
    m31, m32 = units.per * (x3 * s1 - y3 * s2), units.per * (x3 * s2 + y3 * s1)
    for j in range(DATA - 1):
        x, y = found[VT1, j], found[VT2, j]
        found[VT1, j], found[VT2, j] = m11 * x + m12 * y, m21 * x + m22 * y
        found[PATH, j] += m31 * x + m32 * y
    cos2, sin2 = s1 * s1 - s2 * s2, 2.0 * s1 * s2
    by_b, by_a = units.per, mu * units.per
    turns = (s1, s2), (-s2, s1), (-cos2, -sin2), (sin2, -cos2), (-1.0, 0.0)
    for k in range(5):
        at, by = RADIAL + 4 * k, by_b if k < 2 else by_a
        sums = _total(values, at), _total(values, at + 20), _total(values, at + 40)
        path = _total(values, at + 60) if works else 0.0
        x1, x2, x3 = _arrival(*sums, path, *end)
        j = 2 if k < 2 else 5 if k < 4 else 4
        u, w = by * turns[k][0], by * turns[k][1]
        found[VT1, j], found[VT2, j] = found[VT1, j] + u * x1, found[VT2, j] + u * x2
        found[PATH, j] += units.per * u * x3
        found[VT1, j + 1], found[VT2, j + 1] = found[VT1, j + 1] + w * x1, found[VT2, j + 1] + w * x2
        found[PATH, j + 1] += units.per * w * x3
    i1 = i2 = m1 = m2 = 0.0
    if works:
        i1, i2 = _total(values, IMPULSES), _total(values, IMPULSES + 4)
        m1, m2 = _total(values, IMPULSES + 8), _total(values, IMPULSES + 12)
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
    stop2 = bend / (f * (f + rate)) if bend != 0.0 else 0.0
    stop1 = -(1.0 + stop2 * turn) / f  # a shift along F is one of P*, however little slip still turns (D5)
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


@always_inlined
def cross_move(units, slip, length, root, span, fast, mu, k1, k2, works, values, found):
    """Take the sensitivities across a move of slip.

    Args:
        units, slip, mu, k1, k2, works, values, found: As in `cross_panel`.
        length, root: Of the `Move`.
        span: Its normal impulse times ω.
        fast: The speed at its end.

    Returns:
        ∫∫σ dP₃ dP₃ (2) over the move. Sensitivities are NaN where it would need too many panels.
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
    if math.inf > abs(left) > MOST * (EFOLDS if kind == INVARIANT else abs(size)):
        for j in range(DATA - 1):
            found[VT1, j] = found[VT2, j] = found[PATH, j] = math.nan
        return 0.5 * span * span * slip.s1, 0.5 * span * span * slip.s2
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
