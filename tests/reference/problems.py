"""Random contact-space problems, with one recipe for each regime; all numbers are doubles taken as exact."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .reference import LAWS

Draw = tuple[np.ndarray, np.ndarray, float]  # W, v, μ


@dataclass(frozen=True)
class Problem:
    """Arguments of `solve_reference`, and the regime of the problem."""

    delassus: np.ndarray
    velocity: np.ndarray
    friction: float
    restitution: float
    law: str
    category: str


def _gram(rng: np.random.Generator, columns: int = 7) -> np.ndarray:
    X = rng.standard_normal((3, columns))
    W = X @ X.T / columns
    return (W + W.T) / 2


def _approach(rng: np.random.Generator, slip: float = 1.0) -> np.ndarray:
    v = rng.standard_normal(3) * (slip, slip, 1)
    v[2] = -abs(v[2]) - 0.01
    return v


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a power of ten with a uniform exponent between `low` and `high`."""
    return 10 ** float(rng.uniform(low, high))


def _critical(W: np.ndarray) -> float:
    return float(np.linalg.norm(np.linalg.solve(W[:2, :2], W[:2, 2])))


def _turned(rng: np.random.Generator, W: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the problem in tangent axes rotated by a random angle."""
    angle = rng.uniform(0, 2 * math.pi)
    R = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    W = R @ W @ R.T
    return (W + W.T) / 2, R @ v


def _smooth(rng: np.random.Generator) -> Draw:
    return _gram(rng), _approach(rng, 2.0), _log_uniform(rng, -1.5, 0)


def _stick(rng: np.random.Generator) -> Draw:
    W = _gram(rng)
    return W, _approach(rng, _log_uniform(rng, -2, -0.2)), _critical(W) * rng.uniform(1.05, 5)


def _resumed(rng: np.random.Generator) -> Draw:
    W = _gram(rng, 4)
    return W, _approach(rng, _log_uniform(rng, -2, -0.5)), _critical(W) * rng.uniform(0.3, 0.95)


def _locked(rng: np.random.Generator) -> Draw:
    """Draw W of rank two with a regular A, and v in its range: sticking locks the normal direction."""
    while True:
        X = rng.integers(-4, 5, (3, 2)).astype(float)
        W = X @ X.T
        v = X @ (rng.integers(-64, 65, 2) / 32)
        if W[0, 0] * W[1, 1] != W[0, 1] ** 2 and v[2] < 0 and (v[0] or v[1]):
            scale = 2.0 ** rng.integers(-6, 3)
            return W * scale, v, rng.uniform(0.3, 4) * max(_critical(W), 0.3)


def _rank_one(rng: np.random.Generator) -> Draw:
    x = rng.integers(-5, 6, 3).astype(float)
    x[2] = rng.integers(1, 6)
    x[0] += not x[:2].any()
    v = -x * rng.integers(1, 40) / 32
    return np.outer(x, x) / 8, v, rng.uniform(0.1, 2) * x[2] / float(np.hypot(x[0], x[1]))


def _planar(rng: np.random.Generator) -> Draw:
    """Draw a planar mechanism; some surfaces move across its plane."""
    W, v = _gram(rng, 3), _approach(rng, _log_uniform(rng, -2, 0.5))
    W[1, :] = W[:, 1] = 0
    if rng.random() < 0.7:
        v[1] = 0
    return W, v, _log_uniform(rng, -1.5, 0.5)


def _straight(rng: np.random.Generator) -> Draw:
    """Draw a spatial mechanism with an impact in a plane of symmetry."""
    W, v = _gram(rng, 3), _approach(rng, _log_uniform(rng, -2, 0.5))
    W[0, 1] = W[1, 0] = W[1, 2] = W[2, 1] = 0
    v[1] = 0
    return W, v, _log_uniform(rng, -1.5, 0.5)


def _frictionless(rng: np.random.Generator) -> Draw:
    return _gram(rng, int(rng.integers(3, 8))), _approach(rng), 0.0


def _jamming(rng: np.random.Generator) -> Draw:
    """Draw slip nearly along b with so much friction that the normal acceleration is negative."""
    while True:
        W = _gram(rng, 3)
        b = W[:2, 2]
        if np.hypot(*b) > 0.2 * W[2, 2]:
            break
    angle = math.atan2(b[1], b[0]) + rng.uniform(-0.8, 0.8)
    v = np.array([math.cos(angle), math.sin(angle), 0.0]) * _log_uniform(rng, -1, 1)
    v[2] = -_log_uniform(rng, -2, 0.5)
    return W, v, rng.uniform(1.05, 3) * W[2, 2] / (b @ v[:2] / np.hypot(*v[:2]))


def _no_collision(rng: np.random.Generator) -> Draw:
    W, v, mu = _jamming(rng)
    v[2] = 0.0
    return W, v, mu


def _second_compression(rng: np.random.Generator) -> Draw:
    """Draw slip whose normal acceleration becomes negative after the first compression, or almost."""
    W = np.array([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]])
    v = np.array([0.5, 12, -rng.uniform(0.4, 0.5292)])
    if rng.random() < 0.3:
        v[2] = -0.529177 - rng.choice([-1, 1]) * _log_uniform(rng, -6, -3)
    else:
        W[0, 0] *= 1 + 0.02 * rng.random()
        W[1, 1] *= rng.uniform(0.9, 1.1)
        v[:2] *= rng.uniform(0.9, 1.1, 2)
    W, v = _turned(rng, W, v)
    return W, v, 1.5


def _small_slip(rng: np.random.Generator) -> float:
    return 0.0 if rng.random() < 0.3 else _log_uniform(rng, -8, -0.5)


def _near_critical(rng: np.random.Generator) -> Draw:
    W = _gram(rng, 4)
    offset = rng.choice([-1, 1]) * _log_uniform(rng, -14, -2)
    return W, _approach(rng, _small_slip(rng)), _critical(W) * (1 + offset)


def _exactly_critical(rng: np.random.Generator) -> Draw:
    """Draw ‖A⁻¹b‖ = μ in exact arithmetic, by a Pythagorean triple."""
    i, j = rng.integers(-2, 3, 2)
    p, q, h = [(3, 4, 5), (5, 12, 13), (8, 15, 17)][rng.integers(3)]
    a, d = 2.0**i, 2.0**j
    ratio = 2.0 ** -rng.integers(3, 6)
    b1, b2 = a * p * ratio, d * q * ratio * rng.choice([-1, 1])
    c = b1 * b1 / a + b2 * b2 / d + 2.0 ** -rng.integers(0, 6)
    W = np.array([[a, 0, b1], [0, d, b2], [b1, b2, c]])
    return W, _approach(rng, _small_slip(rng)), h * ratio


def _near_invariant(rng: np.random.Generator) -> Draw:
    """Draw slip that starts near an invariant direction, stable or not."""
    W, v = _gram(rng), _approach(rng)
    mu = _log_uniform(rng, -1.5, 0.3)
    alpha, beta = complex(W[0, 1], (W[0, 0] - W[1, 1]) / 2), complex(W[1, 2], W[0, 2])
    roots = np.roots([-mu * alpha, beta, 0, beta.conjugate(), -mu * alpha.conjugate()])
    roots = roots[np.abs(np.abs(roots) - 1) < 1e-9]
    angle = float(np.angle(rng.choice(roots))) + rng.choice([-1, 1]) * _log_uniform(rng, -12, -1)
    speed = _log_uniform(rng, -1.5, 0.7)
    return W, np.array([speed * math.cos(angle), speed * math.sin(angle), v[2]]), mu


def _tiny_slip(rng: np.random.Generator) -> Draw:
    exponent = -rng.uniform(2, 16) if rng.random() < 0.7 else -rng.uniform(16, 290)
    return _gram(rng, 4), _approach(rng, 10**exponent), _log_uniform(rng, -1.5, 0.5)


def _no_slip(rng: np.random.Generator) -> Draw:
    return _gram(rng, 4), _approach(rng, 0.0), _log_uniform(rng, -1.5, 0.5)


def _slow_approach(rng: np.random.Generator) -> Draw:
    W, v, mu = _jamming(rng) if rng.random() < 0.5 else _smooth(rng)
    exponent = rng.uniform(2, 12) if rng.random() < 0.9 else rng.uniform(12, 290)
    v[2] = -(10**-exponent)
    return W, v, mu


def _ill_conditioned(rng: np.random.Generator) -> Draw:
    while True:
        Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        W = (Q * [1, _log_uniform(rng, -12, 0), _log_uniform(rng, -12, 0)]) @ Q.T
        W = (W + W.T) / 2
        if np.linalg.eigvalsh(W)[0] > 2e-13:
            return W, _approach(rng), _log_uniform(rng, -1.5, 0.5)


def _high_friction(rng: np.random.Generator) -> Draw:
    return _gram(rng), _approach(rng), _log_uniform(rng, 1, 6)


def _scaled(rng: np.random.Generator) -> Draw:
    W, v, mu = rng.choice([_smooth, _stick, _resumed])(rng)
    return W * _log_uniform(rng, -9, 9), v * _log_uniform(rng, -12, 6), mu


def _isotropic(rng: np.random.Generator) -> Draw:
    """Draw W with A a multiple of the identity; some have b = 0."""
    W, v = _gram(rng), _approach(rng)
    W[0, 1] = W[1, 0] = 0
    W[0, 0] = W[1, 1] = W[0, 0] + W[1, 1]
    if rng.random() < 0.2:
        W[2, :2] = W[:2, 2] = 0
    return W, v, _log_uniform(rng, -1.5, 0.5)


def _balanced(rng: np.random.Generator) -> Draw:
    W = _gram(rng)
    W[2, :2] = W[:2, 2] = 0
    return W, _approach(rng, _log_uniform(rng, -2, 0)), _log_uniform(rng, -1.5, 0.5)


def _coincident(rng: np.random.Generator) -> Draw:
    """Draw slip that stops exactly at the end of compression, or of the impact (Poisson's law, e = 1/2)."""
    a, d, c = 2.0 ** rng.integers(-2, 4, 3)
    mu, v3 = rng.integers(1, 64) / 32, rng.integers(1, 64) / 32
    P3 = v3 / c * rng.choice([1, 1.5])
    v = np.array([mu * a * P3, 0, -v3])
    return np.diag([a, d, c]), v, float(mu)


RECIPES: dict[str, Callable[[np.random.Generator], Draw]] = {
    "smooth slip": _smooth,
    "slip to stick": _stick,
    "resumed slip": _resumed,
    "rank two": _locked,
    "rank one": _rank_one,
    "planar": _planar,
    "straight": _straight,
    "frictionless": _frictionless,
    "jam": _jamming,
    "no collision": _no_collision,
    "second compression": _second_compression,
    "near-critical friction": _near_critical,
    "exactly critical friction": _exactly_critical,
    "near-invariant start": _near_invariant,
    "tiny slip": _tiny_slip,
    "no slip": _no_slip,
    "slow approach": _slow_approach,
    "ill-conditioned": _ill_conditioned,
    "high friction": _high_friction,
    "scaled": _scaled,
    "isotropic": _isotropic,
    "balanced": _balanced,
    "coincident": _coincident,
}
CATEGORIES = tuple(RECIPES)


def draw(seed: int, index: int) -> Problem:
    """Return the problem of a row; regimes and laws alternate, and some rows have e = 0, 1/2 or 1."""
    rng = np.random.default_rng((seed, index))
    turn, position = divmod(index, len(CATEGORIES))
    category = CATEGORIES[position]
    W, v, mu = RECIPES[category](rng)
    e = float(rng.choice([0.0, 0.5, 1.0], p=[1 / 3, 1 / 6, 1 / 2]) if rng.random() < 0.4 else rng.random())
    if category == "second compression":
        e = float(rng.uniform(0.9, 1)) if rng.random() < 0.5 else 1.0
    if category == "coincident":
        e = 0.5
    return Problem(W, v, float(mu), e, LAWS[turn % 3], category)
