"""Dense output of a step, and bounds of its rates.

The unknowns are (ξ, v, w): chart coordinates, velocities, and the four kinds of work w of (9.4). `rates`
(16, 2 nv + 4) has their derivatives at the stages.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from ..._compile.declared import FLOAT_ROWS, FLOAT_VIEW, FLOATS, INTEGER_ROWS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.products import add
from .lie_charts import advance
from .workspace import DENSE_TERMS, SceneWorkspace


def _basis():
    """Return the polynomials θ, θ(1 − θ), θ²(1 − θ), … of `interpolate` as rows (7, 7) in θ, θ², …."""
    basis, factor = np.zeros((DENSE_TERMS, DENSE_TERMS)), Polynomial([0.0, 1.0])
    for k in range(DENSE_TERMS):
        basis[k, : k + 1] = factor.coef[1:]
        factor = factor * (Polynomial([1.0, -1.0]) if k % 2 == 0 else Polynomial([0.0, 1.0]))
    return basis


BASIS = _basis()


@declared(FLOAT_VIEW, float, FLOATS)
@jit
def interpolate(coefficients, theta, out):
    """Fill the increments (n,) at a fraction θ of the step: θ(F₀ + (1 − θ)(F₁ + θ(F₂ + (1 − θ)(F₃ + …)))).

    The coefficients F₀, F₁, … are the rows of `coefficients` (k, n).
    """
    for m in range(coefficients.shape[1]):
        value = 0.0
        for k in range(len(coefficients) - 1, -1, -1):
            value = (value + coefficients[k, m]) * (theta if k % 2 == 0 else 1.0 - theta)
        out[m] = value


@declared(FLOAT_ROWS, float, INTEGER_ROWS, FLOATS, FLOATS, FLOATS, FLOATS)
@jit
def state(coefficients, theta, joints, q0, v0, q, v):
    """Fill q (nq,) and v (nv,) at a fraction θ of the step that starts from q0 and v0."""
    n = len(v0)
    xi = np.empty(n)
    interpolate(coefficients[:, :n], theta, xi)
    interpolate(coefficients[:, n : 2 * n], theta, v)
    add(v, 1.0, v0)
    advance(joints, q0, xi, q)


@declared(SceneWorkspace, float)
@external
def set_state_within(work, fraction):
    """Set the state at a fraction of the last completed step in the workspace."""
    state(work.dense_coefficients, fraction, work.joint_charts, work.q0, work.v0, work.q, work.v)


@inlined
def rate_bounds(rates, stages, n, out):
    """Fill out (4, n): largest |ξ̇|, |v̇| of the first `stages`, then their largest changes from the first."""
    for m in range(n):
        for part in range(2):
            first = rates[0, part * n + m]
            value = change = 0.0
            for j in range(stages):
                value = max(value, abs(rates[j, part * n + m]))
                change = max(change, abs(rates[j, part * n + m] - first))
            out[part, m] = value
            out[part + 2, m] = change
