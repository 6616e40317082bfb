"""Preparation of an impact at one contact: checks, exact scaling and mirroring, the null space of W.

(theory.md, sections 6 and 7)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLOATS, declared
from ..._compile.jit import always_inlined_bitcode, inlined
from ..._numeric.tolerances import ROUNDING, TINY
from . import codes
from .delassus import LEANING, ZERO, Delassus, clear, nearly_singular, of_factor
from .laws import counted, law_of_slow_approach
from .tolerances import WELL_CONDITIONED

PROCEEDS = np.int64(-1)
"""Returned instead of a status: there is an impact to integrate."""

TOO_SHORT = 2.0**-300
"""|v₃|/|v_t| below which slip does not turn during an impact with dv₃/dP₃ > 0. The energetic law then agrees
with Poisson's, which is used because the work underflows."""

DOUBTFUL = 2.0**20
"""Factor of the tolerance for parts of v in the null space of W, if stick locks and the scale of v is
unknown. A result that is divided by such a part, or refused because of it, would be decided by rounding."""


class View(NamedTuple):
    """Transformation of a problem to canonical axes and numbers of order one; exact, unless `leaning`.

    Attributes:
        sign1, sign2: Signs of the tangent axes.
        swapped: Whether the axes are then swapped.
        diagonal: Whether the problem is symmetric under the swap.
        scale_w, scale_v: W and v are divided by 2 to these powers.
        leaning: Whether the tangent axes are then rotated, with rounding, so that the second is (lean1,
            lean2).
        lean1, lean2: The direction in which a nearly planar mechanism is weak.
    """

    sign1: float
    sign2: float
    swapped: bool
    diagonal: bool
    scale_w: int
    scale_v: int
    leaning: bool
    lean1: float
    lean2: float


class Problem(NamedTuple):
    """An impact to integrate, in the axes and units of its `View`.

    Attributes:
        a11, a12, a22, b1, b2, c: W, with eigenvalues that are taken as zero removed.
        k1, k2: Stick ratio k = A⁺b.
        s: c − bᵀA⁺b; exactly 0 if stick locks the normal direction.
        mu, e: μ and e.
        law, counts: Code of the law, and its quantity.
        v1, v2, v3: Velocity at the start.
        s1, s2, speed: Direction and speed of slip at the start.
        offset: η, v₃ at v_t = 0, for s = 0.
        flat: Whether A is singular.
        planar: Whether A is singular and slip is in its range, so that it never turns.
        endless_slip: Whether slip may turn into a direction in which no force acts.
    """

    a11: float
    a12: float
    a22: float
    b1: float
    b2: float
    c: float
    k1: float
    k2: float
    s: float
    mu: float
    e: float
    law: np.int64
    counts: np.int64
    v1: float
    v2: float
    v3: float
    s1: float
    s2: float
    speed: float
    offset: float
    flat: bool
    planar: bool
    endless_slip: bool


@inlined
def usable(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, velocity_scale):
    """Return whether all numbers are finite, μ ≥ 0 and 0 ≤ e ≤ 1."""
    zero = 0.0 * w11 + 0.0 * w12 + 0.0 * w13 + 0.0 * w22 + 0.0 * w23 + 0.0 * w33
    zero += 0.0 * v1 + 0.0 * v2 + 0.0 * v3  # 0 times infinity is NaN, and so is every sum with one
    return zero == 0.0 and 0.0 <= mu < math.inf and 0.0 <= e <= 1.0 and 0.0 <= velocity_scale < math.inf


@inlined
def canonical(w12, w13, w23, w11, w22, v1, v2):
    """Return signs, order and symmetry of the tangent axes, as in `View`, for which mirror images agree."""
    sign1 = -1.0 if v1 < 0.0 or (v1 == 0.0 and w13 < 0.0) else 1.0
    sign2 = -1.0 if v2 < 0.0 or (v2 == 0.0 and w23 < 0.0) else 1.0
    if sign1 * sign2 * w12 < 0.0:
        if v1 == 0.0 and w13 == 0.0:
            sign1 = -1.0
        elif v2 == 0.0 and w23 == 0.0:
            sign2 = -1.0
    x1, x2, y1, y2 = abs(v1), abs(v2), sign1 * w13, sign2 * w23
    swapped = x2 > x1 or (x2 == x1 and (y2 > y1 or (y2 == y1 and w22 > w11)))
    return sign1, sign2, swapped, x2 == x1 and y2 == y1 and w22 == w11


@inlined
def halves(exponent):
    """Return two powers of two whose product is 2^exponent, even if that overflows."""
    half = exponent // 2
    return math.ldexp(1.0, half), math.ldexp(1.0, exponent - half)


@inlined
def _nothing_to_follow(status, figure, flags):
    """Return the result of `prepare` for a status."""
    nan, no = math.nan, np.int64(0)
    view = View(1.0, 1.0, False, False, 0, 0, False, 0.0, 1.0)
    nans = (nan, nan, nan, nan, nan, nan, nan)
    problem = Problem(*nans, nan, nan, nan, nan, no, no, *nans, False, False, False)
    return status, figure, flags, view, problem


@inlined
def _lean(a11, a12, a22, b1, b2, c, e1, e2, norm, n3):
    """Return W of rank two, with null vector norm e + n₃ e₃, in tangent axes of which the second is e. (6.3)

    Small entries are computed as products with n₃ and have its relative accuracy.
    """
    along = e2 * (e2 * a11 - e1 * a12) - e1 * (e2 * a12 - e1 * a22)
    skew = e2 * (e1 * a11 + e2 * a12) - e1 * (e1 * a12 + e2 * a22)
    across = e1 * (e1 * a11 + e2 * a12) + e2 * (e1 * a12 + e2 * a22)
    beta = norm * (e2 * b1 - e1 * b2) - n3 * skew
    gamma = norm * norm * c - 2.0 * n3 * norm * (e1 * b1 + e2 * b2) + n3 * n3 * across
    return along, -beta * n3, gamma * n3 * n3, beta * norm, -gamma * n3 * norm, gamma * norm * norm


@inlined
def _of_factor(factor, scale_w, sign1, sign2, swapped):
    """Return the result of `of_factor` for a factor (FACTOR,) in the caller's axes and units."""
    half = scale_w // 2
    f = math.ldexp(1.0, -half)
    c11, c21, c22, c31, c32, c33, formed = factor
    x, y = (sign1 * f * c11, 0.0, 0.0), (sign2 * f * c21, sign2 * f * c22, 0.0)
    if swapped:
        x, y = y, x
    found, e1, e2, rest = of_factor(x, y, (f * c31, f * c32, f * c33), f * formed)
    rank, a11, a12, b1, a22, b2, c, k1, k2, s, least, spread, n1, n2, n3, doubt = found
    g = 1.0 if scale_w == 2 * half else 0.5
    turned = Delassus(
        *(rank, g * a11, g * a12, g * b1, g * a22, g * b2, g * c, k1, k2, g * s, least, spread),
        *(n1, n2, n3, doubt),
    )
    return turned, e1, e2, rest


@inlined
def _normalized(w11, w12, w13, w22, w23, w33, v1, v2, v3):
    """Scale a problem by powers of two and mirror it. (theory.md, section 7)

    Returns:
        W (6), v (3), the exponents of their scales, and signs, order and symmetry of the axes, as in `View`.
    """
    largest_w = max(max(abs(w11), abs(w22), abs(w33)), max(abs(w12), abs(w13), abs(w23)))
    largest_v = max(abs(v1), abs(v2), abs(v3))
    # adding 0 makes numba's 32-bit exponents 64-bit
    scale_w, scale_v = 0 + math.frexp(largest_w)[1], 0 + math.frexp(largest_v)[1]
    sign1, sign2, swapped, diagonal = canonical(w12, w13, w23, w11, w22, v1, v2)
    fw1, fw2 = halves(-scale_w)
    fv1, fv2 = halves(-scale_v)
    w11, w22, w33 = w11 * fw1 * fw2, w22 * fw1 * fw2, w33 * fw1 * fw2
    w12, w13, w23 = sign1 * sign2 * w12 * fw1 * fw2, sign1 * w13 * fw1 * fw2, sign2 * w23 * fw1 * fw2
    v1, v2, v3 = sign1 * v1 * fv1 * fv2, sign2 * v2 * fv1 * fv2, v3 * fv1 * fv2
    if swapped:
        v1, v2, w11, w22, w13, w23 = v2, v1, w22, w11, w23, w13
    return w11, w12, w13, w22, w23, w33, v1, v2, v3, scale_w, scale_v, sign1, sign2, swapped, diagonal


@inlined
def _in_range(rank, s, a11, a12, a22, v1, v2, tiny, doubtful):
    """Remove rounding from v_t for singular A. (theory.md, section 6)

    No force acts across the range of A, so a part of v_t there is constant, or zero within `doubtful`.

    Returns:
        v_t (2); whether A is singular; `Problem.planar`; whether v_t has a part across the range of A.
    """
    flat = planar = crosses = rank < 3 and (s > 0.0 or rank == 1) and a11 + a22 > 0.0
    if planar:
        norm = math.hypot(a12, a22) if a22 > a11 else math.hypot(a11, a12)
        d1, d2 = (a12 / norm, a22 / norm) if a22 > a11 else (a11 / norm, a12 / norm)
        along = d1 * v1 + d2 * v2
        planar = abs(d1 * v2 - d2 * v1) <= doubtful
        crosses = not planar
        if planar:
            v1, v2 = d1 * along, d2 * along
    if rank < 3 and a11 + a22 == 0.0 and abs(v1) + abs(v2) <= tiny:
        v1 = v2 = 0.0
    return v1, v2, flat, planar, crosses


@inlined
def norm(x, y):
    """Return √(x² + y²), by the slower library function only if squares underflow."""
    square = x * x + y * y
    return math.sqrt(square) if square > TINY else math.hypot(x, y)


@inlined
def _slip(v1, v2):
    """Return the speed and the direction of slip; (1, 0) without slip."""
    speed, s1, s2 = norm(v1, v2), 1.0, 0.0
    if speed > 0.0:
        s1, s2 = v1 / speed, v2 / speed
    return speed, s1, s2


@inlined
def _tie(v1, v2, v3, k1, k2, normal_part, law, factored, tiny, doubtful):
    """Return η = v₃ − k·v_t, which is constant for s = 0 and zero within rounding, and v₃. (theory.md, 6)"""
    offset = v3 - k1 * v1 - k2 * v2
    known = offset > 0.0 and counted(law) == codes.IMPULSE  # then no result is divided by η
    if normal_part * abs(offset) <= (tiny if known else doubtful):
        tied = v3 - offset
        offset = 0.0
        if factored and abs(k2) <= 1.0 and tied < 0.0:
            v3 = tied  # the null vector is mainly normal, and so is the rounding of v
    return offset, v3


@declared(*11 * [float], int, float, FLOATS)
@always_inlined_bitcode
def prepare(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, law, velocity_scale, factor):
    """Check, scale, mirror and classify a problem, and decide whether there is an impact.

    Args: As for `path.solve_into`.

    Returns:
        PROCEEDS, or the status without integration; the number for its message; flags; the `View`; the
        `Problem`.
    """
    if not usable(w11, w12, w13, w22, w23, w33, v1, v2, v3, mu, e, velocity_scale):
        return _nothing_to_follow(codes.INVALID_NUMBERS, 0.0, codes.NO_FLAG)

    w11, w12, w13, w22, w23, w33, v1, v2, v3, scale_w, scale_v, sign1, sign2, swapped, diagonal = _normalized(
        w11, w12, w13, w22, w23, w33, v1, v2, v3
    )
    fv1, fv2 = halves(-scale_v)
    regular, found = clear(w11, w12, w13, w22, w23, w33, WELL_CONDITIONED if len(factor) > 0 else ROUNDING)
    factored = leaning = not regular and len(factor) > 0
    lean1, lean2, rest = 0.0, 1.0, 0.0
    if leaning:
        found, lean1, lean2, rest = _of_factor(factor, scale_w, sign1, sign2, swapped)
    elif not regular:
        found = nearly_singular(w11, w12, w13, w22, w23, w33)
    rank, a11, a12, b1, a22, b2, c, k1, k2, s, least, spread, n1, n2, n3, doubt = found
    if rank < 0:
        return _nothing_to_follow(codes.INDEFINITE_DELASSUS, math.ldexp(least, scale_w), codes.NO_FLAG)
    flags = codes.SINGULAR_DELASSUS if rank < 3 else codes.NO_FLAG
    jump = codes.NEAR_JUMP if doubt else codes.NO_FLAG
    flags |= jump

    # parts of v in the null space of W are rounding up to `tiny`, a moving surface above it (theory.md, 6)
    size = max(abs(v1) + abs(v2) + abs(v3), velocity_scale * fv1 * fv2)
    tiny = ZERO * spread * size
    doubtful = DOUBTFUL * tiny if velocity_scale == 0.0 and s == 0.0 else tiny
    normal_part = abs(n3)
    if leaning:
        v1, v2 = lean2 * v1 - lean1 * v2, lean1 * v1 + lean2 * v2
        v1, v2 = v1 + rest * v2, v2 - rest * v1
        if s == 0.0 and abs(k2) > 1.0 and normal_part * abs(v3 - k1 * v1 - k2 * v2) <= tiny:
            v2 = (v3 - k1 * v1) / k2
    elif rank == 2 and 0.0 < normal_part < LEANING:
        leaning = True
        norm = math.hypot(n1, n2)
        lean1, lean2 = n1 / norm, n2 / norm
        a11, a12, a22, b1, b2, c = _lean(a11, a12, a22, b1, b2, c, lean1, lean2, norm, n3)
        k1, k2 = 0.0, -norm / n3
        v1, v2 = lean2 * v1 - lean1 * v2, lean1 * v1 + lean2 * v2
        if abs(norm * v2 + n3 * v3) <= tiny:
            v2 = -n3 * v3 / norm
    view = View(sign1, sign2, swapped, diagonal, scale_w, scale_v, leaning, lean1, lean2)

    v1, v2, flat, planar, crosses = _in_range(rank, s, a11, a12, a22, v1, v2, tiny, doubtful)
    if c == 0.0 and abs(v3) <= tiny:
        v3 = 0.0
    speed, s1, s2 = _slip(v1, v2)
    if abs(v3) <= tiny and c < mu * (b1 * s1 + b2 * s2):
        # friction starts an impact for v₃ = 0, but not for the smallest v₃ > 0
        jump = codes.NEAR_JUMP
        flags |= jump
    if v3 > 0.0 or (v3 == 0.0 and not (speed > 0.0 and c < mu * (b1 * s1 + b2 * s2))):
        return _nothing_to_follow(codes.NO_IMPACT, 0.0, jump)
    if c <= 0.0:
        return _nothing_to_follow(codes.UNSTOPPABLE, math.ldexp(v3, scale_v), codes.NO_FLAG)
    if v3 == 0.0:
        flags |= codes.IMPACT_WITHOUT_COLLISION
    elif v3 > -TOO_SHORT * speed and c > mu * (b1 * s1 + b2 * s2):
        law = law_of_slow_approach(law)

    offset = 0.0
    if s == 0.0:
        offset, v3 = _tie(v1, v2, v3, k1, k2, normal_part, law, factored, tiny, doubtful)
    endless_slip = crosses or s == 0.0
    problem = Problem(
        *(a11, a12, a22, b1, b2, c, k1, k2, s, mu, e, law, counted(law)),
        *(v1, v2, v3, s1, s2, speed, offset, flat, planar, endless_slip),
    )
    return PROCEEDS, 0.0, flags, view, problem
