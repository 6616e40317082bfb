"""First zero crossing of a polynomial to negative values, bracketed by Bernstein coefficients."""

from __future__ import annotations

import math

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import external, inlined
from ..._numeric.loops import assign
from ..._numeric.tolerances import EXACT
from .tolerances import NOISE

NEVER = math.inf


@inlined
def value(c, degree, s):
    """Return Σ c_k sᵏ."""
    total = c[degree]
    for k in range(degree - 1, -1, -1):
        total = total * s + c[k]
    return total


@inlined
def value_at(rows, i, degree, s):
    """Return Σ rows[k, i] sᵏ."""
    total = rows[degree, i]
    for k in range(degree - 1, -1, -1):
        total = total * s + rows[k, i]
    return total


@declared(FLOATS, int, float, float, FLOAT_ROWS)
@external
def first_fall(c, degree, h, zero, rows):
    """Return the first s in [0, h] at which Σ c_k sᵏ becomes negative, or `NEVER`.

    No crossing is missed: non-negative Bernstein coefficients exclude one.

    Args:
        c: (degree + 1,) coefficients.
        degree: Degree of the polynomial.
        h: End of the interval.
        zero: Values up to this size at s = 0 are taken as zero; the sign of the next coefficient then
            decides.
        rows: (4, degree + 1) scratch.
    """
    power, rest, left, right = rows[0], rows[1], rows[2], rows[3]
    largest, scale = 0.0, 1.0
    for k in range(degree + 1):
        power[k] = c[k] * scale
        largest = max(largest, abs(power[k]))
        scale *= h
    if not largest > zero:
        return NEVER
    if power[0] < -zero:
        return 0.0
    first = 0
    if power[0] <= zero:
        first = 1
        while first <= degree and abs(power[first]) <= NOISE * largest:
            first += 1
        if first > degree:
            return NEVER
        if power[first] < 0.0:
            return 0.0
    # divide by a root at zero; the quotient is positive there
    n = degree - first
    lowest = power[first]
    for k in range(n + 1):
        power[k] = power[k + first]
        rest[k] = power[k]
        if k > 0:
            lowest -= abs(power[k])
    if lowest >= 0.0:  # the first coefficient outweighs all others
        return NEVER
    # Bernstein coefficients b_j = Σ_k C(j, k)/C(n, k) a_k
    binomial = 1.0
    for k in range(1, n + 1):
        binomial *= (n - k + 1.0) / k
        rest[k] /= binomial
    for k in range(1, n + 1):
        for j in range(n, k - 1, -1):
            rest[j] += rest[j - 1]
    noise = NOISE * largest
    start, part = 0.0, 1.0
    while True:  # rest: coefficients on [start, 1]; left, right: on its first part and on the remainder
        assign(right[: n + 1], rest)
        lowest, changes = rest[0], 0
        for r in range(n + 1):  # subdivision by de Casteljau's algorithm, unless the part is the whole
            left[r] = right[0] if part < 1.0 else rest[r]
            lowest = min(lowest, left[r])
            if r > 0 and (left[r] < 0.0) != (left[r - 1] < 0.0):
                changes += 1
            for i in range(n - r if part < 1.0 else 0):
                right[i] += part * (right[i + 1] - right[i])
        width = part * (1.0 - start)
        if lowest >= -noise:
            if part >= 1.0:
                return NEVER
            start += width
            part = min(1.0, 2.0 * part / (1.0 - part))
            assign(rest[: n + 1], right)
        elif changes == 1 and left[n] < 0.0:
            return h * _bisect(power, n, start, start + width)
        elif width < EXACT:
            return h * start
        else:
            part *= 0.5


@inlined
def _bisect(c, n, low, high):
    """Return the crossing of a polynomial of degree n in [low, high], where it is not yet negative."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if value(c, n, middle) < 0.0:
            high = middle
        else:
            low = middle
    return low
