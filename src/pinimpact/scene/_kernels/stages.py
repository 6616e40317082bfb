"""The arithmetic of one Runge-Kutta step on a configuration manifold; the flow is evaluated between.

The unknowns are (ξ, v, w): chart coordinates, velocities, and quadratures w that nothing depends on. `rates`
(16, 2 nv + nw) holds their derivatives at the stages.
"""

from __future__ import annotations

import math

import numpy as np

from ..._numeric.jit import inner, jit
from .lie_charts import advance, chart_rate


@inner
def stage(i, h, step, rates, v0, joints, q0, xi, q, v):
    """Fill q and v at stage i, and the stage's ξ̇."""
    n = len(v0)
    for m in range(n):
        a = b = 0.0
        for j in range(i):
            c = step[i, j]
            a += c * rates[j, m]
            b += c * rates[j, n + m]
        xi[m] = h * a
        v[m] = v0[m] + h * b
    advance(joints, q0, xi, q)
    chart_rate(joints, xi, v, rates[i, :n])


@inner
def error_norm(h, error, rates, v0, v1, sizes, rtol, atol):
    """Return the error of the step over the tolerance, root mean square over ξ and v."""
    n = len(v0)
    e3 = e5 = 0.0
    for m in range(2 * n):
        a = b = 0.0
        for j in range(rates.shape[0]):
            if j < error.shape[1]:
                a += error[0, j] * rates[j, m]
                b += error[1, j] * rates[j, m]
        size = sizes[m] if m < n else max(abs(v0[m - n]), abs(v1[m - n]))
        scale = 1.0 / (atol + rtol * size)
        e3 += (a * scale) ** 2
        e5 += (b * scale) ** 2
    if e3 == 0.0 and e5 == 0.0:
        return 0.0
    return abs(h) * e5 / math.sqrt((e5 + 0.01 * e3) * 2 * n)


@inner
def dense(h, step, weights, rates, out):
    """Fill the (7, n) coefficients of the dense output; see `interpolate`."""
    for m in range(rates.shape[1]):
        total = 0.0
        for j in range(12):
            total += step[12, j] * rates[j, m]
        out[0, m] = h * total
        out[1, m] = h * (rates[0, m] - total)
        out[2, m] = h * (2.0 * total - rates[0, m] - rates[12, m])
        for k in range(4):
            value = 0.0
            for j in range(16):
                value += weights[k, j] * rates[j, m]
            out[3 + k, m] = h * value


@jit
def interpolate(coefficients, theta, out):
    """Fill the increments at a fraction θ of the step: θ(F₀ + (1 − θ)(F₁ + θ(F₂ + (1 − θ)(F₃ + …))))."""
    for m in range(coefficients.shape[1]):
        value = 0.0
        for k in range(6, -1, -1):
            value = (value + coefficients[k, m]) * (theta if k % 2 == 0 else 1.0 - theta)
        out[m] = value


@jit
def state(coefficients, theta, joints, q0, v0, q, v):
    """Fill q and v at a fraction θ of the step."""
    n = len(v0)
    xi = np.empty(n)
    interpolate(coefficients[:, :n], theta, xi)
    interpolate(coefficients[:, n : 2 * n], theta, v)
    for m in range(n):
        v[m] += v0[m]
    advance(joints, q0, xi, q)


@inner
def largest(rates, count, n, out):
    """Fill the largest |ξ̇| and |v̇| of the first `count` stages, and their largest change from the first."""
    for m in range(n):
        for part in range(2):
            first = rates[0, part * n + m]
            value = change = 0.0
            for j in range(count):
                value = max(value, abs(rates[j, part * n + m]))
                change = max(change, abs(rates[j, part * n + m] - first))
            out[part, m] = value
            out[part + 2, m] = change
