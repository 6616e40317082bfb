"""Propagation of the sensitivities of v_t and ∫v_t dP₃ through a move. (derivatives.md, (D12) and (D13))"""

from __future__ import annotations

import math

from ..._compile.jit import always_inlined, inlined
from .codes import IN_RESUMED_SLIP, IN_SLIP, WORK
from .sensitivities import B1, B2, MU, PATH, STOP, V1, V2, VT1, VT2, add_response, clear_rows, combine
from .slip_derivatives import cross_move
from .slip_equations import in_frame
from .slip_panels import Slip
from .slip_works import ABSCISSAE, NODES, WEIGHTS


@inlined
def _integral_of_direction(x, y, rho, x0, rho0):
    """Return the components of ∫σ along and across a straight line of v_t.

    The line leads from x₀ to x at the distance y from the origin; |v_t| is ρ₀ and ρ at its ends.
    """
    along = (x - x0) * (x + x0) / (rho + rho0)
    if y == 0.0:
        return along, 0.0
    same_side = x * x0 > 0.0
    part = along * (rho + rho0) / (x * rho0 + x0 * rho) if same_side else (x * rho0 - x0 * rho) / (y * y)
    return along, y * math.asinh(part)


@inlined
def _without_friction(problem, p3, values):
    """Fill the sensitivities at P₃ for μ = 0, to the side μ > 0. (D12)"""
    b1, b2, v1, v2 = problem.b1, problem.b2, problem.v1, problem.v2
    k1, k2 = problem.k1, problem.k2
    clear_rows(values, STOP)
    values[VT1 + V1] = values[VT2 + V2] = 1.0
    values[VT1 + B1] = values[VT2 + B2] = p3
    values[PATH + V1], values[PATH + V2] = k1 * p3, k2 * p3
    values[PATH + B1], values[PATH + B2] = 0.5 * k1 * p3 * p3, 0.5 * k2 * p3 * p3
    size = math.sqrt(b1 * b1 + b2 * b2)
    i1 = i2 = m1 = m2 = 0.0
    if size * p3 <= 0.25 * problem.speed:
        # on a short part of the line the Gauss rule is exact to rounding
        for i in range(NODES):
            q = p3 * ABSCISSAE[i]
            u1, u2 = v1 + b1 * q, v2 + b2 * q
            r = math.sqrt(u1 * u1 + u2 * u2)
            w = p3 * WEIGHTS[i] / r if r > 0.0 else 0.0
            i1, i2 = i1 + w * u1, i2 + w * u2
            m1, m2 = m1 + w * u1 * (p3 - q), m2 + w * u2 * (p3 - q)
    else:
        e1, e2 = b1 / size, b2 / size
        x0, y = e1 * v1 + e2 * v2, e1 * v2 - e2 * v1
        x = x0 + size * p3
        rho0, rho = math.hypot(x0, y), math.hypot(x, y)
        along, across = _integral_of_direction(x, y, rho, x0, rho0)
        swept = 0.5 * (x * rho - x0 * rho0 - y * across) - x0 * along  # ∫(x − x₀) σ dx along
        swept_across = y * along - x0 * across
        a, c = along / size, across / size
        s, d = p3 * a - swept / (size * size), p3 * c - swept_across / (size * size)
        i1, i2 = a * e1 - c * e2, a * e2 + c * e1
        m1, m2 = s * e1 - d * e2, s * e2 + d * e1
    x1, x2 = problem.a11 * i1 + problem.a12 * i2, problem.a12 * i1 + problem.a22 * i2
    y1, y2 = problem.a11 * m1 + problem.a12 * m2, problem.a12 * m1 + problem.a22 * m2
    values[VT1 + MU], values[VT2 + MU], values[PATH + MU] = -x1, -x2, -(k1 * y1 + k2 * y2)


@inlined
def _resume(problem, s1, s2, gain, start, end, values):
    """Propagate the sensitivities through resumed slip along σ with λ = `gain`. (D13)

    `start` and `end` are P₃ at its ends minus that at v_t = 0.
    """
    mu, kl, middle = problem.mu, problem.k1 * s1 + problem.k2 * s2, 0.5 * (start + end)
    _, skew, across, _, _ = in_frame(problem.a11, problem.a12, problem.a22, 0.0, 0.0, s1, s2)
    combine(values, VT1, -gain * s1, STOP, 0.0, STOP)
    combine(values, VT2, -gain * s2, STOP, 0.0, STOP)
    combine(values, PATH, 1.0, PATH, -(end - start) * gain * kl, STOP)
    # δ(λσ) for δb along and across σ
    angle = 1.0 / (gain + mu * across)
    skewed = mu * skew * angle
    along, aside = (s1, s2), (-skewed * s1 - gain * angle * s2, -skewed * s2 + gain * angle * s1)
    for k in range(5):
        d1, d2 = along if k % 2 == 0 else aside
        path = (end - start) * middle * (problem.k1 * d1 + problem.k2 * d2)
        add_response(values, k, s1, s2, 1.0, mu, (d1 * end, d2 * end, path))


@always_inlined
def cross(problem, units, move, after, start, end, rest_at, values):
    """Propagate the sensitivities to the end of a move.

    Args:
        problem, units: The `Problem` and its `Units`.
        move, after: (MOVE,) the row of the move in the trace, and the next one.
        start, end: P₃ at its ends.
        rest_at: P₃ at v_t = 0, for resumed slip.
        values: Rows of sensitivities; are overwritten.

    Returns:
        −∫∫dP_t dP₃ (2) over the move, and λ of resumed slip.
    """
    s1, s2, span = move[7], move[8], end - start
    half, mu, k1, k2 = 0.5 * span * span, problem.mu, problem.k1, problem.k2
    if mu == 0.0:
        _without_friction(problem, end, values)
        return 0.0, 0.0, 0.0
    if move[0] == IN_SLIP:
        n1, n2 = cross_move(
            *(units, Slip(s1, s2, move[9], move[10]), move[11], move[12], units.omega * span, after[9]),
            *(mu, k1, k2, problem.counts == WORK, values),
        )
        square = mu * units.per * units.per
        return square * n1, square * n2, 0.0
    if move[0] == IN_RESUMED_SLIP and end > rest_at:
        gain = after[9] / (end - rest_at)
        _resume(problem, s1, s2, gain, start - rest_at, end - rest_at, values)
        return mu * s1 * half, mu * s2 * half, gain
    return k1 * half, k2 * half, 0.0
