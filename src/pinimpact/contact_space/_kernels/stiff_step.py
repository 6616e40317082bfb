"""Implicit steps of slip whose direction settles fast: the Rosenbrock method RODAS.

The slip direction settles within an impulse of |v_t|/μA⊥, and explicit steps cannot be much longer. Each
stage solves a linear system with the Jacobian of dP_t/dP₃,

    −κ σ⊥ (Aσ⊥)ᵀ,   κ = μ/|v_t|,

in closed form, since it has rank one. Coefficients: Hairer and Wanner, Solving Ordinary Differential
Equations II (1996), section IV.7: order 4 with an error estimate of order 3, L-stable.
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.jit import inlined

STAGES = 6
GAMMA = 0.25

_A = np.zeros((STAGES + 1, STAGES))
_A[1, :1] = 1.544
_A[2, :2] = 0.9466785280815826, 0.2557011698983284
_A[3, :3] = 3.314825187068521, 2.896124015972201, 0.9986419139977817
_A[4, :4] = 1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950
_A[5] = _A[4] + [0, 0, 0, 0, 1, 0]
_A[6] = _A[5] + [0, 0, 0, 0, 0, 1]  # the end of the step; its last term is the error estimate
_C = np.zeros((STAGES, STAGES))
_C[1, :1] = -5.6688
_C[2, :2] = -2.430093356833875, -0.2063599157091915
_C[3, :3] = -0.1073529058151375, -9.594562251023355, -20.47028614809616
_C[4, :4] = 7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160
_C[5, :5] = 8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054
_AT = np.array([0.0, 0.386, 0.21, 0.63, 1.0, 1.0])
_DRIFT = np.array([0.25, -0.1043, 0.1035, -0.03620000000000023, 0.0, 0.0])


@inlined
def settling(tangent, mu, v1, v2):
    """Return κ A⊥, the rate per P₃ at which the slip direction settles."""
    a11, a12, a22, _, _ = tangent
    square = v1 * v1 + v2 * v2
    return mu * (a11 * v2 * v2 - 2.0 * a12 * v1 * v2 + a22 * v1 * v1) / (square * math.sqrt(square))


@inlined
def stiff_step(tangent, mu, v1, v2, h, k):
    """Take one step of slip; arguments and result as for `slip_steps.slip_step`, with k (STAGES, 4)."""
    a11, a12, a22, b1, b2 = tangent
    speed = math.hypot(v1, v2)
    n1, n2 = -v2 / speed, v1 / speed
    kappa = mu / speed
    x1, x2 = a11 * n1 + a12 * n2, a12 * n1 + a22 * n2
    gh = GAMMA * h
    damp = gh * kappa / (1.0 + gh * kappa * (x1 * n1 + x2 * n2))
    drift = -kappa * (n1 * b1 + n2 * b2) * h
    for i in range(STAGES):
        d1 = d2 = q1 = q2 = y1 = y2 = z1 = z2 = 0.0
        for j in range(i):
            d1 += _A[i, j] * k[j, 0]
            d2 += _A[i, j] * k[j, 1]
            q1 += _A[i, j] * k[j, 2]
            q2 += _A[i, j] * k[j, 3]
            y1 += _C[i, j] * k[j, 0]
            y2 += _C[i, j] * k[j, 1]
            z1 += _C[i, j] * k[j, 2]
            z2 += _C[i, j] * k[j, 3]
        u1 = v1 + a11 * d1 + a12 * d2 + _AT[i] * h * b1
        u2 = v2 + a12 * d1 + a22 * d2 + _AT[i] * h * b2
        size = math.hypot(u1, u2)
        pull = -mu / size if size > 0.0 else 0.0
        y1 = gh * (pull * u1 + _DRIFT[i] * drift * n1) + GAMMA * y1
        y2 = gh * (pull * u2 + _DRIFT[i] * drift * n2) + GAMMA * y2
        back = damp * (x1 * y1 + x2 * y2)
        k[i, 0], k[i, 1] = y1 - back * n1, y2 - back * n2
        k[i, 2], k[i, 3] = gh * (k[i, 0] + d1) + GAMMA * z1, gh * (k[i, 1] + d2) + GAMMA * z2
    d1 = d2 = q1 = q2 = 0.0
    for j in range(STAGES):
        d1 += _A[STAGES, j] * k[j, 0]
        d2 += _A[STAGES, j] * k[j, 1]
        q1 += _A[STAGES, j] * k[j, 2]
        q2 += _A[STAGES, j] * k[j, 3]
    u1 = v1 + a11 * d1 + a12 * d2 + h * b1
    u2 = v2 + a12 * d1 + a22 * d2 + h * b2
    error = math.hypot(k[STAGES - 1, 0], k[STAGES - 1, 1])
    return d1, d2, q1, q2, u1, u2, error, (u1 * v1 + u2 * v2) / (speed * speed)
