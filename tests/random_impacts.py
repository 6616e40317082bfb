"""Random contact-space problems near boundaries of the solver's regimes, and checks of their solutions.

The checks of each solution are:

- it is finite; v₃⁺ ≥ 0; P is in the friction cone; v⁺ = v⁻ + W P;
- friction dissipates energy; the sum of all work is the change of kinetic energy, which is not positive for
  the energetic law and for e = 0; the restitution law is satisfied;
- it is identical in all bits after mirroring, swapping the tangent axes, and scaling by powers of two;
- it is equal after rotating the axes and scaling by other numbers, within the effect of rounding errors of
  the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinimpact import LAWS, Flag, Status, solve_impacts

Array = NDArray[np.float64]
EPS = 2.0**-52
ROUNDINGS = 8.0
"""Size of the perturbations that measure the sensitivity, in units of EPS."""
TRIALS = (3, 300)
"""Number of perturbations of each problem, and of one that would be a violation otherwise."""
ALLOWED = 8.0
"""Ratio of disagreement to sensitivity above which there is a violation."""


class Problems(NamedTuple):
    """N problems: W (N, 3, 3), v (N, 3), μ (N,), e (N,), and the scale of v (N,), 0 where it is not given."""

    delassus: Array
    velocity: Array
    friction: Array
    restitution: Array
    scale: Array

    def __getitem__(self, rows):
        return Problems(*(tuple.__getitem__(self, k)[rows] for k in range(5)))


# ---- drawing ----


def power(rng, n, low, high) -> Array:
    """Draw powers of ten with uniform exponents."""
    return 10.0 ** rng.uniform(low, high, n)


def sign(rng, n) -> Array:
    return rng.choice([-1.0, 1.0], n)


def gram(rng, n, columns=7) -> Array:
    X = rng.standard_normal((n, 3, columns))
    return symmetric(X @ X.transpose(0, 2, 1) / columns)


def symmetric(W: Array) -> Array:
    return (W + W.transpose(0, 2, 1)) / 2


def approach(rng, n, slip=1.0, normal=1.0) -> Array:
    v = rng.standard_normal((n, 3))
    v[:, :2] *= np.reshape(slip, (-1, 1))
    v[:, 2] = -(np.abs(v[:, 2]) + 0.01) * normal
    return v


def critical(W: Array) -> Array:
    """Return the friction ‖A⁻¹b‖ above which contacts stick."""
    return np.linalg.norm(np.linalg.solve(W[:, :2, :2], W[:, :2, 2:]), axis=(1, 2))


def turned(angle: Array) -> Array:
    """Return rotations (N, 3, 3) of the tangent axes."""
    R = np.zeros((len(angle), 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angle)
    R[:, 1, 0] = np.sin(angle)
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return R


def mapped(T: Array, W: Array, v: Array) -> tuple[Array, Array]:
    return symmetric(T @ W @ T.transpose(0, 2, 1)), np.einsum("nij,nj->ni", T, v)


def outer(x: Array) -> Array:
    return x[:, :, None] * x[:, None, :]


def general(rng, n):
    W = gram(rng, n, int(rng.choice([3, 4, 7])))
    D = power(rng, (n, 3), -2, 0)
    return W * outer(D), approach(rng, n, power(rng, n, -3, 1), power(rng, n, -3, 1)), power(rng, n, -2, 1)


def near_critical(rng, n):
    W = gram(rng, n, 4)
    mu = critical(W) * (1 + sign(rng, n) * power(rng, n, -16, -2))
    slip = np.where(rng.random(n) < 0.3, 0.0, power(rng, n, -12, 0))
    return W, approach(rng, n, slip), mu


def exactly_critical(rng, n):
    a, d, ratio = 2.0 ** rng.integers(-2, 3, (3, n))
    ratio /= 32
    p, q, h = np.array([(3, 4, 5), (5, 12, 13), (8, 15, 17), (1, 0, 1)])[rng.integers(4, size=n)].T
    W = np.zeros((n, 3, 3))
    W[:, 0, 0], W[:, 1, 1] = a, d
    W[:, 0, 2], W[:, 1, 2] = a * p * ratio, d * q * ratio * sign(rng, n)
    W[:, 2, 2] = W[:, 0, 2] ** 2 / a + W[:, 1, 2] ** 2 / d + 2.0 ** -rng.integers(0, 6, n)
    W = np.maximum(W, W.transpose(0, 2, 1)) + np.minimum(W, W.transpose(0, 2, 1))
    W[:, [0, 1, 2], [0, 1, 2]] /= 2
    slip = np.where(rng.random(n) < 0.3, 0.0, power(rng, n, -300, 0))
    return W, approach(rng, n, slip), h * ratio


def invariant(rng, n):
    """Draw slip on or near stable and unstable invariant directions; in half of them they are exact axes."""
    W, mu = gram(rng, n, 4), power(rng, n, -2, 0.5)
    plane = rng.random(n) < 0.5
    W[plane, 0, 1] = W[plane, 1, 0] = W[plane, 1, 2] = W[plane, 2, 1] = 0.0
    angle = np.where(plane, np.pi * rng.integers(0, 2, n), rng.uniform(0, 2 * np.pi, n))
    for _ in range(50):  # g(φ) = σ⊥ᵀ(b − μAσ) by Newton's method
        co, si = np.cos(angle), np.sin(angle)
        lean = (W[:, 1, 1] - W[:, 0, 0]) * co * si + W[:, 0, 1] * (co * co - si * si)
        slope = (W[:, 1, 1] - W[:, 0, 0]) * (co * co - si * si) - 4 * W[:, 0, 1] * co * si
        g = W[:, 1, 2] * co - W[:, 0, 2] * si - mu * lean
        dg = -W[:, 1, 2] * si - W[:, 0, 2] * co - mu * slope
        angle = np.where(plane, angle, angle - np.clip(g / dg, -0.5, 0.5))
    deviation = sign(rng, n) * power(rng, n, -30, -1) * (rng.random(n) < 0.7)
    co, si = np.cos(angle), np.where(plane, 0.0, np.sin(angle))
    direction = np.stack([co - deviation * si, si + deviation * co], axis=1)
    v = approach(rng, n, 0.0)
    v[:, :2] = direction * power(rng, n, -2, 1)[:, None]
    return W, v, mu


def tiny_slip(rng, n):
    slip = np.where(rng.random(n) < 0.1, 0.0, power(rng, n, rng.choice([-16, -300], n), -2))
    return gram(rng, n, 4), approach(rng, n, slip), power(rng, n, -2, 1)


def jam(rng, n):
    """Draw slip nearly along b with so much friction that the normal acceleration is negative.

    Some of them have v₃ = 0.
    """
    W = gram(rng, n, int(rng.choice([3, 4])))
    b = W[:, :2, 2]
    angle = np.arctan2(b[:, 1], b[:, 0]) + rng.uniform(-1, 1, n)
    v = np.stack([np.cos(angle), np.sin(angle), -power(rng, n, -3, 1)], axis=1)
    v[:, 2] *= rng.random(n) < 0.8
    mu = power(rng, n, -2, 0.5) + W[:, 2, 2] / np.abs(np.sum(b * v[:, :2], axis=1))
    v[:, :2] *= power(rng, n, -3, 1)[:, None]
    return W, v, mu


def slow_approach(rng, n):
    W, v, mu = jam(rng, n)
    v[:, 2] = -power(rng, n, rng.choice([-16, -300], n), -2)
    return W, v, np.where(rng.random(n) < 0.5, mu, power(rng, n, -2, 0))


def second_compression(rng, n):
    """Draw impacts with or nearly with a second compression, as the normal acceleration becomes negative."""
    W = np.tile([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]], (n, 1, 1))
    v = np.tile([0.5, 12, 0], (n, 1))
    spread = np.where(rng.random(n) < 0.3, 0.0, 0.1)
    W[:, 0, 0] *= 1 + 0.2 * spread * rng.random(n)
    W[:, 1, 1] *= 1 + spread * rng.uniform(-1, 1, n)
    v[:, 1] *= 1 + spread * rng.uniform(-1, 1, n)
    v[:, 2] = -rng.uniform(0.3, 0.6, n)
    edge = spread == 0
    v[edge, 2] = -0.529177 + (sign(rng, n) * power(rng, n, -9, -3))[edge]
    some = rng.random(n) < 0.7
    T = turned(np.where(some, rng.uniform(0, 7, n), 0.0))
    W, v = mapped(T, W, v)
    return W, v, np.where(edge, 1.5, rng.uniform(1.3, 1.7, n))


def rank_exact(rng, n, rank, inside=0.9):
    """Draw W = XXᵀ of integers, singular in exact arithmetic; some v are not in the range of W."""
    X = rng.integers(-5, 6, (n, 3, rank)).astype(float)
    v = np.einsum("nij,nj->ni", X, rng.integers(-64, 65, (n, rank)) / 32)
    v[v[:, 2] > 0] *= -1
    v = np.where((rng.random(n) < inside)[:, None], v, rng.integers(-64, 1, (n, 3)) / 32)
    return (
        X @ X.transpose(0, 2, 1) * (2.0 ** rng.integers(-6, 3, n))[:, None, None],
        v,
        power(rng, n, -1.5, 1.5),
    )


def rank_rounded(rng, n, rank):
    """Draw W = XXᵀ and v = Xw, with their rounding errors."""
    X = rng.standard_normal((n, 3, rank))
    X *= power(rng, (n, 3), -1, 0)[:, :, None]
    v = np.einsum("nij,nj->ni", X, rng.standard_normal((n, rank)))
    v[v[:, 2] > 0] *= -1
    return symmetric(X @ X.transpose(0, 2, 1)), v, power(rng, n, -1.5, 1.5)


def made_by_w(rng, n, rank):
    """Draw W = XXᵀ and v = W r with their rounding errors; v is smaller than its terms by cancellation."""
    X = rng.standard_normal((n, 3, rank))
    W = symmetric(X @ X.transpose(0, 2, 1))
    r = rng.standard_normal((n, 3, 1))
    null = np.linalg.svd(X)[0][:, :, rank:]
    r += power(rng, (n, 1, 1), 0, 4) * null[:, :, :1]
    v = (W @ r)[:, :, 0]
    v[v[:, 2] > 0] *= -1
    return W, v, power(rng, n, -1.5, 1.5), (np.abs(W) @ np.abs(r)).sum(axis=(1, 2))


def leaning(rng, n):
    """Draw planar arms within angles of 1e-15 … 1e-3 of the normal or of the floor; some in rotated axes."""
    tilt = sign(rng, n) * power(rng, n, -15, -3) * (rng.random(n) < 0.9)
    T = turned(np.where(rng.random(n) < 0.5, rng.uniform(0, 7, n), 0.0))
    plane = np.zeros((n, 3, 2))
    plane[:, 0, 0] = 1.0
    floor = rng.random(n) < 0.3
    plane[:, 1, 1] = np.where(floor, np.cos(tilt), np.sin(tilt))
    plane[:, 2, 1] = np.where(floor, np.sin(tilt), np.cos(tilt))
    X = T @ plane @ rng.standard_normal((n, 2, 2))
    v = (X @ rng.standard_normal((n, 2, 1)))[:, :, 0]
    v[v[:, 2] > 0] *= -1
    return symmetric(X @ X.transpose(0, 2, 1)), v, power(rng, n, -1.5, 1)


def turned_in_space(rng, n):
    """Draw mechanisms of one to three degrees of freedom in randomly rotated axes."""
    Q = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    X = rng.standard_normal((n, 3, 3)) * (np.arange(3) < rng.integers(1, 4, (n, 1)))[:, None, :]
    X[rng.random(n) < 0.5, 1] = 0.0
    W = symmetric(Q @ (X @ X.transpose(0, 2, 1)) @ Q.transpose(0, 2, 1))
    v = (Q @ X @ rng.standard_normal((n, 3, 1)))[:, :, 0]
    v[v[:, 2] > 0] *= -1
    return W, v, power(rng, n, -1.5, 1)


def nearly_singular(rng, n):
    """Draw W with one or two eigenvalues near the tolerance of its rank."""
    Q = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    small = power(rng, n, -18, -12)
    values = np.stack([np.ones(n), np.where(rng.random(n) < 0.7, power(rng, n, -2, 0), small), small], axis=1)
    return symmetric(Q * values[:, None, :] @ Q.transpose(0, 2, 1)), approach(rng, n), power(rng, n, -1.5, 1)


def ill_conditioned(rng, n):
    Q = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    last = power(rng, n, -13.5, -3)
    values = np.stack([np.ones(n), last ** rng.random(n), last], axis=1)
    return symmetric(Q * values[:, None, :] @ Q.transpose(0, 2, 1)), approach(rng, n), power(rng, n, -1.5, 1)


def planar(rng, n):
    """Draw planar mechanisms, some with a surface that moves across their plane, some in rotated axes."""
    W, v = gram(rng, n, 3), approach(rng, n, power(rng, n, -3, 1))
    W[:, 1, :] = W[:, :, 1] = 0.0
    v[rng.random(n) < 0.7, 1] = 0.0
    W, v = mapped(turned(np.where(rng.random(n) < 0.5, rng.uniform(0, 7, n), 0.0)), W, v)
    return W, v, power(rng, n, -1.5, 1)


def high_friction(rng, n):
    return gram(rng, n), approach(rng, n, power(rng, n, -3, 3)), power(rng, n, 1, 6)


def frictionless(rng, n):
    return gram(rng, n, int(rng.integers(3, 8))), approach(rng, n, power(rng, n, -9, 9)), np.zeros(n)


def coincident(rng, n):
    """Draw small integers, for which events coincide, such as the end of slip with that of compression."""
    X = rng.integers(-2, 3, (n, 3, 3)).astype(float)
    W = X @ X.transpose(0, 2, 1)
    v = rng.integers(-4, 5, (n, 3)) / 2.0
    v[:, 2] = -np.abs(v[:, 2])
    mu = rng.integers(0, 9, n) / 4.0
    stop = rng.random(n) < 0.5
    a, d, c = 2.0 ** rng.integers(-2, 4, (3, n))
    m, v3 = rng.integers(1, 64, (2, n)) / 32
    W[stop] = (np.eye(3) * np.stack([a, d, c], axis=1)[:, None, :])[stop]
    mu[stop] = m[stop]
    v[stop] = np.stack([m * a * v3 / c * rng.choice([1, 1.5], n), np.zeros(n), -v3], axis=1)[stop]
    return W, v, mu


def scaled(rng, n):
    """Draw masses from 1e-9 to 1e9 kg and speeds from 1e-12 to 1e6 m/s."""
    W, v, mu = general(rng, n)
    return W * power(rng, n, -9, 9)[:, None, None], v * power(rng, n, -12, 6)[:, None], mu


def isotropic(rng, n):
    """Draw W with A a multiple of the identity; in some of them b = 0, so slip is straight."""
    W, v = gram(rng, n), approach(rng, n, power(rng, n, -3, 1))
    W[:, 0, 1] = W[:, 1, 0] = 0.0
    W[:, 1, 1] = W[:, 0, 0] = W[:, 0, 0] + W[:, 1, 1]
    W[rng.random(n) < 0.3, 2, :2] = 0.0
    W[:, :2, 2] = W[:, 2, :2]
    return W, v, power(rng, n, -1.5, 0.5)


CATEGORIES: dict[str, Callable] = {
    "general": general,
    "near-critical friction": near_critical,
    "exactly critical friction": exactly_critical,
    "invariant direction": invariant,
    "tiny slip": tiny_slip,
    "jam": jam,
    "slow approach": slow_approach,
    "second compression": second_compression,
    "rank two, exactly": lambda rng, n: rank_exact(rng, n, 2),
    "rank two, rounded": lambda rng, n: rank_rounded(rng, n, 2),
    "rank one, exactly": lambda rng, n: rank_exact(rng, n, 1),
    "rank one, rounded": lambda rng, n: rank_rounded(rng, n, 1),
    "rank two, v = W r": lambda rng, n: made_by_w(rng, n, 2),
    "rank one, v = W r": lambda rng, n: made_by_w(rng, n, 1),
    "leaning": leaning,
    "turned in space": turned_in_space,
    "nearly singular": nearly_singular,
    "ill-conditioned": ill_conditioned,
    "planar": planar,
    "high friction": high_friction,
    "frictionless": frictionless,
    "coincident events": coincident,
    "scaled": scaled,
    "isotropic": isotropic,
}


def draw(rng: np.random.Generator, category: str, count: int) -> Problems:
    """Draw problems of a category; a third of them with e = 0 or e = 1."""
    W, v, mu, *scale = CATEGORIES[category](rng, count)
    e = np.where(rng.random(count) < 0.35, rng.integers(0, 2, count), rng.random(count))
    if category == "second compression":
        e = 1 - (rng.random(count) < 0.5) * rng.uniform(0, 0.1, count)
    if category == "coincident events":
        e = rng.integers(0, 5, count) / 4
    return Problems(
        np.ascontiguousarray(W),
        v,
        np.asarray(mu, dtype=float),
        e.astype(float),
        *(scale or [np.zeros(count)]),
    )


# ---- solving, changing, comparing ----


class Answers(NamedTuple):
    """Results of `solve_impacts` for N problems."""

    velocity: Array
    impulse: Array
    compression: Array
    status: NDArray[np.int64]
    flags: NDArray[np.int64]
    iterations: NDArray[np.int64]


def solve(p: Problems, law: str) -> Answers:
    s = solve_impacts(p.delassus, p.velocity, p.friction, p.restitution, law, p.scale)
    return Answers(s.velocity, s.impulse, s.compression_impulse, s.status, s.flags, s.iterations)


def sizes(p: Problems, s: Answers) -> tuple[Array, Array]:
    """Return the scales of velocities and impulses (N,) of each problem."""
    P = np.abs(s.impulse).max(axis=1)
    return np.abs(p.velocity).max(axis=1) + np.abs(p.delassus).max(axis=(1, 2)) * P, P


def difference(p: Problems, a: Answers, velocity: Array, impulse: Array, status) -> Array:
    """Return the largest change (N,) of v⁺ and P over their scales; infinite if only one has a solution."""
    speed, size = sizes(p, a)
    tiny = np.finfo(float).tiny
    with np.errstate(over="ignore"):
        gap = np.abs(velocity - a.velocity).max(axis=1) / np.maximum(speed, tiny)
        gap = np.maximum(gap, np.abs(impulse - a.impulse).max(axis=1) / np.maximum(size, tiny))
    one, other = a.status <= Status.LOCKED, status <= Status.LOCKED
    return np.where(one & other, gap, np.where(one == other, 0.0, np.inf))


def perturbed(rng: np.random.Generator, p: Problems) -> Problems:
    """Return the problems with perturbations of a few rounding errors.

    W → TWTᵀ and v → Tv with T near the identity, then W is perturbed relative to ‖W‖.
    """
    n = len(p.friction)

    def noise(*shape: int) -> Array:
        return ROUNDINGS * EPS * rng.uniform(-1, 1, (n, *shape))

    T = np.eye(3) + noise(3, 3) * [[1, 1, 0], [1, 1, 0], [0, 0, 1]]
    W, v = mapped(T, p.delassus, p.velocity)
    # as a rotation of the axes perturbs it, so that the rank of W does not change
    W = W + symmetric(noise(3, 3)) / 4 * np.abs(W).max(axis=(1, 2), keepdims=True)
    return Problems(W, v, p.friction * (1 + noise()), np.minimum(p.restitution * (1 + noise()), 1.0), p.scale)


def sensitivity(rng: np.random.Generator, p: Problems, law: str, answers: Answers, trials: int) -> Array:
    """Return the largest change (N,) due to perturbations of the input, at least a rounding error."""
    largest = np.full(len(p.friction), ROUNDINGS * EPS)
    for _ in range(trials):
        s = solve(perturbed(rng, p), law)
        largest = np.maximum(largest, difference(p, answers, s.velocity, s.impulse, s.status))
    return largest


EXACT_MAPS = {
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
    "axes swapped": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "half turn": np.diag([-1.0, -1.0, 1.0]),
}


def bits(a: Answers) -> Array:
    return np.column_stack([a.velocity, a.impulse, a.compression, a.status, a.flags])


def same_bits(rng: np.random.Generator, p: Problems, law: str, a: Answers) -> dict[str, NDArray[np.bool_]]:
    """Return which results change in any bit under maps without rounding errors, by map."""
    wrong = {}
    for name, T in EXACT_MAPS.items():
        s = solve(p._replace(delassus=T @ p.delassus @ T.T, velocity=p.velocity @ T.T), law)
        s = s._replace(velocity=s.velocity @ T, impulse=s.impulse @ T)
        wrong[name] = ~np.equal(bits(s), bits(a)).all(axis=1) & (a.status <= Status.LOCKED)
        wrong[name] |= s.status != a.status
    # only to larger numbers, since those that underflow are rounded
    m, u = 2.0 ** rng.integers(0, 60, (2, len(p.friction)))
    scaled = p._replace(
        delassus=p.delassus / m[:, None, None], velocity=p.velocity * u[:, None], scale=p.scale * u
    )
    s = solve(scaled, law)
    s = s._replace(
        velocity=s.velocity / u[:, None],
        impulse=s.impulse / (m * u)[:, None],
        compression=s.compression / (m * u),
    )
    wrong["powers of two"] = ~np.equal(bits(s), bits(a)).all(axis=1) & (a.status <= Status.LOCKED)
    return wrong


def decided_by_rounding(*answers: Answers) -> NDArray[np.bool_]:
    """Return which solutions of singular W are flagged as depending on rounding errors."""
    flagged = np.zeros(len(answers[0].flags), dtype=bool)
    for a in answers:
        singular = (a.flags & Flag.SINGULAR_DELASSUS != 0) | (a.status == Status.NO_IMPACT)
        flagged |= singular & (a.flags & Flag.NEAR_JUMP != 0)
    return flagged


def changes_by_axes_and_units(rng: np.random.Generator, p: Problems, law: str, a: Answers) -> Array:
    """Return the changes (N,) after a rotation of the axes and a change of units, both with rounding errors.

    They are zero for solutions that are flagged as depending on rounding errors.
    """
    n = len(p.friction)
    T = turned(rng.uniform(0, 2 * np.pi, n))
    back = T.transpose(0, 2, 1)
    W, v = mapped(T, p.delassus, p.velocity)
    s = solve(p._replace(delassus=W, velocity=v), law)
    turn = difference(
        p, a, np.einsum("nij,nj->ni", back, s.velocity), np.einsum("nij,nj->ni", back, s.impulse), s.status
    )
    turn = np.where(decided_by_rounding(a, s), 0.0, turn)
    m, u = power(rng, (n, 1), -3, 3), power(rng, (n, 1), -3, 3)
    rescaled = p._replace(
        delassus=p.delassus / m[:, :, None], velocity=p.velocity * u, scale=p.scale * u[:, 0]
    )
    s = solve(rescaled, law)
    unit = difference(p, a, s.velocity / u, s.impulse / (m * u), s.status)
    return np.maximum(turn, np.where(decided_by_rounding(a, s), 0.0, unit))


# ---- what must hold ----


def made_zero(p: Problems, flags) -> Array:
    """Return the size (N,) of parts of v, relative to v, that are taken as zero if outside the range of W."""
    values = np.sort(np.abs(np.linalg.eigvalsh(p.delassus)), axis=1)
    least = np.where(values[:, 0] > 32 * EPS * values[:, 2], values[:, 0], values[:, 1])
    amplified = 64 * EPS * values[:, 2] / np.maximum(least, EPS * np.maximum(values[:, 2], 1e-300))
    singular = (flags & Flag.SINGULAR_DELASSUS != 0) | (values[:, 0] < 64 * EPS * values[:, 2])
    size = np.maximum(1.0, p.scale / np.maximum(np.abs(p.velocity).max(axis=1), np.finfo(float).tiny))
    return np.where(singular, np.minimum(amplified, 4e-6) * size, 0.0)


def mechanics(p: Problems, law: str) -> dict[str, NDArray[np.bool_]]:
    """Return which solutions violate which law of mechanics."""
    s = solve_impacts(p.delassus, p.velocity, p.friction, p.restitution, law, p.scale)
    W, v0, mu, e, _ = p
    v, P, pc, status = s.velocity, s.impulse, s.compression_impulse, s.status
    ok = status <= Status.LOCKED
    wrong = {"not converged": status == Status.NOT_CONVERGED}
    wrong["refused"] = ~ok & (np.linalg.eigvalsh(W)[:, 0] > 1e-13 * np.abs(W).max(axis=(1, 2)))
    wrong["refused"] |= ~ok & (status != Status.UNSTOPPABLE) & (status != Status.LAW_UNREACHABLE)
    wrong["not finite"] = ok != np.isfinite(np.column_stack([v, P, pc])).all(axis=1)
    # in units of each problem, so that nothing underflows or overflows
    w, u = np.abs(W).max(axis=(1, 2)), np.abs(v0).max(axis=1)
    w, u = np.where(w > 0, w, 1.0), np.where(u > 0, u, 1.0)
    W, v0, v = W / w[:, None, None], v0 / u[:, None], v / u[:, None]
    P, pc = P / u[:, None] * w[:, None], pc / u * w
    work = [x / u / u * w for x in (s.work.compression, s.work.restitution, s.work.friction)]
    wc, wr, wf = work
    size = np.abs(P).max(axis=1)
    speed = 1.0 + size
    magnitude = np.abs(wc) + np.abs(wr) + np.abs(wf)
    gained = np.sum(P * (v0 + v), axis=1) / 2
    projected = made_zero(p, s.flags)
    # if no motion along the normal is possible, a negative v₃ is a rounding error
    wrong["v3 < 0"] = v[:, 2] < np.where(status == Status.NO_IMPACT, -projected, 0.0)
    wrong["outside the cone"] = np.hypot(P[:, 0], P[:, 1]) > mu * P[:, 2] * (1 + 1e-13)
    imbalance = np.abs(v - v0 - np.einsum("nij,nj->ni", W, P)).max(axis=1)
    wrong["momentum"] = imbalance > (1e-11 + projected) * speed
    wrong["friction gives work"] = wf > 0
    wrong["signs of normal work"] = (wc > 1e-12 * magnitude) | (wr < -1e-12 * magnitude)
    wrong["ledger"] = np.abs(wc + wr + wf - gained) > (1e-11 + projected) * (magnitude + speed * size)
    passive = (law == "energetic") | (e == 0)
    wrong["energy grows"] = passive & (wc + wr + wf > 1e-12 * magnitude)
    wrong["energy created, not said"] = (s.flags & Flag.ENERGY_CREATED == 0) & (gained > 1e-12 * speed * size)
    if law == "poisson":
        lack = np.abs(P[:, 2] - (1 + e) * pc) > 1e-13 * P[:, 2]
    elif law == "energetic":
        lack = np.abs(wr + e * e * wc) > 1e-12 * magnitude
    else:
        lack = v[:, 2] != -e * v0[:, 2]
        lack &= np.abs(v[:, 2] + e * v0[:, 2]) > 4 * EPS * np.abs(v0[:, 2])
    held = (status == Status.SEPARATED) | (status == Status.ENDED_AT_REST) | (law == "poisson")
    wrong["law"] = lack & held & (status != Status.NO_IMPACT)
    return {
        name: rows & (ok | (name in ("not converged", "refused", "not finite")))
        for name, rows in wrong.items()
    }


@dataclass
class Tally:
    """Counts and largest disagreement of one category."""

    problems: int = 0
    refused: int = 0
    iterations: int = 0
    disagreement: float = 0.0
    flags: dict[str, int] = field(default_factory=dict)


@dataclass
class Report:
    """Tallies by category, violations (what, category, law, problem), and the problem of most iterations."""

    tallies: dict[str, Tally] = field(default_factory=dict)
    violations: list[tuple[str, str, str, Problems]] = field(default_factory=list)
    longest: tuple[int, str, Problems] | None = None

    def table(self) -> str:
        """Return the tallies as a table."""
        tallies = self.tallies.values()
        everything = Tally(
            sum(t.problems for t in tallies),
            sum(t.refused for t in tallies),
            max(t.iterations for t in tallies),
            max(t.disagreement for t in tallies),
        )
        lines = [f"{'category':26}{'problems':>9}{'refused':>9}{'iterations':>12}{'disagreement':>14}"]
        for name, t in [*self.tallies.items(), ("all", everything)]:
            lines.append(f"{name:26}{t.problems:9}{t.refused:9}{t.iterations:12}{t.disagreement:14.2g}")
        lines += ["", f"{'flag':26}{'problems':>9}"]
        lines += [f"{flag.name:26}{sum(t.flags[flag.name] for t in tallies):9}" for flag in Flag]
        return "\n".join([*lines, "", f"{len(self.violations)} violations", ""])


def check(rng: np.random.Generator, category: str, law: str, count: int, report: Report) -> None:
    """Draw problems of a category, solve and check them, and add the results to the report."""
    p = draw(rng, category, count)
    a = solve(p, law)
    wrong = mechanics(p, law) | same_bits(rng, p, law, a)

    gap = np.maximum(changes_by_axes_and_units(rng, p, law, a) - made_zero(p, a.flags), 0.0)
    sensitive = sensitivity(rng, p, law, a, TRIALS[0])
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isinf(sensitive), 0.0, gap / sensitive)
    for k in np.flatnonzero(ratio > 2.0):  # a violation, unless more perturbations show a larger sensitivity
        one = p[np.full(TRIALS[1], k)]
        same = Answers(*(x[np.full(TRIALS[1], k)] for x in a))
        most = sensitivity(rng, one, law, same, 1).max()
        ratio[k] = 0.0 if np.isinf(most) else gap[k] / max(most, sensitive[k])
    wrong["other axes or units"] = ratio > ALLOWED

    tally = report.tallies.setdefault(category, Tally())
    tally.problems += count
    tally.refused += int(np.sum(a.status > Status.LOCKED))
    tally.disagreement = max(tally.disagreement, float(ratio.max()))
    longest = int(a.iterations.argmax())
    tally.iterations = max(tally.iterations, int(a.iterations[longest]))
    if report.longest is None or a.iterations[longest] > report.longest[0]:
        report.longest = int(a.iterations[longest]), law, p[longest]
    for flag in Flag:
        tally.flags[flag.name] = tally.flags.get(flag.name, 0) + int(np.sum(a.flags & flag != 0))
    for name, rows in wrong.items():
        report.violations += [(name, category, law, p[k]) for k in np.flatnonzero(rows)]


def run(seed: int, count: int, chunk: int = 5000) -> Report:
    """Check `count` problems of all categories and laws; the problems depend on `seed` and `chunk` only."""
    report = Report()
    kinds = [(category, law) for category in CATEGORIES for law in LAWS]
    shares = [count // len(kinds) + (k < count % len(kinds)) for k in range(len(kinds))]
    for k, (category, law) in enumerate(kinds):
        for j, start in enumerate(range(0, shares[k], chunk)):
            rng = np.random.default_rng((seed, k, j))
            check(rng, category, law, min(chunk, shares[k] - start), report)
    return report
