"""Models of an impact in one step, for comparison with its path. (docs/identification.md, I13)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import HALF_DIGITS, TINY
from ..arrays import Array, Integers
from ..status import Flag, Status

ONE_STEP = ("moreau", "convex")
"""Coulomb's law and Newton's restitution on the velocities after the impact; the same with the convex
relaxation of friction, in which slip has a normal velocity μ|v_t|."""

DEGREE = 3
"""Degree of the trigonometric polynomial of the direction of slip whose roots are found."""

HALVINGS = 50
"""Number of bisections of such an interval, down to rounding."""

ROUNDING = 32.0 * np.finfo(float).eps
"""Ratio to the largest eigenvalue of W below which an eigenvalue is taken as zero."""


class OneStepSlopes(NamedTuple):
    """Derivatives of the impulses, as in `Derivatives`."""

    dP_ddelassus: Array
    dP_dfriction: Array
    dP_drestitution: Array


class OneStepSolution(NamedTuple):
    """Solution of N impacts, with fields as in `BatchSolution`; impulses that do not exist are NaN."""

    velocity: Array
    impulse: Array
    status: Integers
    flags: Integers
    derivatives: OneStepSlopes


class _Slip(NamedTuple):
    """Impulses p d(θ) on the friction cone, d = (−μσ, 1), with a·û = 0 for slip û; a is d (convex) or n."""

    W: Array
    c: Array
    mu: Array
    convex: bool

    def directions(self, angle: Array) -> tuple[Array, Array, Array, Array]:
        """Return σ, σ⊥, d and a (n, k, 3) at angles (n, k)."""
        zero, n = np.zeros_like(angle), np.array([0.0, 0.0, 1.0])
        sigma = np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
        across = np.stack([-np.sin(angle), np.cos(angle), zero], axis=-1)
        d = n - self.mu[:, None, None] * sigma
        return sigma, across, d, d if self.convex else np.broadcast_to(n, d.shape)

    def at(self, angle: Array) -> tuple[Array, Array, Array]:
        """Return p and û at angles (n, k), from a·û = 0, and the residual a·Wd (σ⊥·û), which has no poles."""
        _, across, d, a = self.directions(angle)
        moved = np.einsum("nij,nkj->nki", self.W, d)
        gain, pull = np.einsum("nki,nki->nk", a, moved), -np.einsum("nki,ni->nk", a, self.c)
        across_c, across_moved = np.einsum("nki,ni->nk", across, self.c), (across * moved).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = pull / gain
            return p, self.c[:, None] + p[..., None] * moved, gain * across_c + pull * across_moved

    def _extrema(self) -> Array:
        """Return rising angles (n, k) from 0 to 2π, between which the residual has at most one root.

        They include the angles of its extrema, which are eigenvalues of the companion matrix of its slope.
        """
        count, size = len(self.c), 2 * DEGREE
        even = np.arange(size + 2) * 2.0 * np.pi / (size + 2)
        of_angle = np.fft.fft(self.at(np.broadcast_to(even, (count, len(even))))[2]) / len(even)
        orders = np.arange(-DEGREE, DEGREE + 1)
        slope = 1j * orders * of_angle[:, orders]
        least = np.maximum(np.finfo(float).eps * np.abs(slope).max(axis=1), TINY)
        lead = np.where(np.abs(slope[:, -1]) < least, least, slope[:, -1])  # a lower degree: roots far away
        companion = np.zeros((count, size, size), dtype=complex)
        companion[:, 1:, :-1] = np.eye(size - 1)
        companion[:, :, -1] = -slope[:, :-1] / lead[:, None]
        turning = np.angle(np.linalg.eigvals(companion)) % (2.0 * np.pi)
        full = np.full((count, 1), 2.0 * np.pi)
        return np.sort(np.hstack([np.broadcast_to(even, (count, len(even))), turning, full]), axis=1)

    def solve(self) -> tuple[Array, Array]:
        """Return the angle and p (n,) of the root with slip along σ and the least p ≥ 0; NaN: no root."""
        edges = self._extrema()
        _, _, turns = self.at(edges)
        rows, columns = np.nonzero(turns[:, :-1] * turns[:, 1:] <= 0.0)
        each = _Slip(self.W[rows], self.c[rows], self.mu[rows], self.convex)
        low, high = edges[rows, columns][:, None], edges[rows, columns + 1][:, None]
        first = turns[rows, columns][:, None]
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = each.at(middle)[2] * first > 0.0
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        p, slip, _ = each.at(low)
        sigma, _, _, _ = each.directions(low)
        with np.errstate(invalid="ignore"):
            valid = ((p >= 0.0) & (np.einsum("nki,nki->nk", sigma, slip) >= 0.0))[:, 0]
        angle, push = np.full(len(self.c), np.nan), np.full(len(self.c), np.nan)
        for k in np.flatnonzero(valid)[np.argsort(-p[valid, 0], kind="stable")]:  # the least p last
            angle[rows[k]], push[rows[k]] = low[k, 0], p[k, 0]
        return angle, push


def solve_one_step(W: Array, velocity: Array, mu: Array, e: Array, model: str) -> OneStepSolution:
    """Solve N impacts in one step by a model of `ONE_STEP`: W (N, 3, 3), velocity (N, 3), μ and e (N,)."""
    count = len(velocity)
    hits = velocity[:, 2] < 0.0
    impulse = np.zeros((count, 3))
    slopes = OneStepSlopes(np.zeros((count, 3, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3)))
    c = velocity.copy()
    c[:, 2] *= 1.0 + e
    values, vectors = np.linalg.eigh(W)
    regular = values > ROUNDING * values[:, 2:]
    parts = np.einsum("nij,ni->nj", vectors, c)
    missing = np.abs(np.where(regular, 0.0, parts)).max(axis=1)  # velocity that no impulse changes
    reciprocals = np.divide(1.0, values, out=np.zeros_like(values), where=regular)
    inverse = np.einsum("nij,nj,nkj->nik", vectors, reciprocals, vectors)
    impulse[hits] = -np.einsum("nij,nj->ni", inverse, c)[hits]
    slides = hits & (
        (np.hypot(impulse[:, 0], impulse[:, 1]) > mu * impulse[:, 2])
        | (missing > HALF_DIGITS * np.abs(parts).max(axis=1))
    )
    sticks = hits & ~slides
    slopes.dP_drestitution[sticks] = -(inverse[:, :, 2] * velocity[:, 2:])[sticks]
    slopes.dP_ddelassus[sticks] = -np.einsum("nki,nj->nkij", inverse, impulse)[sticks]
    if slides.any():
        slip = _Slip(W[slides], c[slides], mu[slides], model == "convex")
        angle, p = slip.solve()
        solved = np.isfinite(p)
        impulse[slides] = np.nan
        slides[slides] = solved
        slip = _Slip(W[slides], c[slides], mu[slides], slip.convex)
        impulse[slides], *by = _slipping(slip, angle[solved], p[solved], velocity[slides, 2])
        for slope, part in zip(slopes, by, strict=True):
            slope[slides] = part
    after = velocity + np.einsum("nij,nj->ni", W, impulse)
    status = np.where(hits, int(Status.SEPARATED), int(Status.NO_IMPACT))
    status[np.isnan(impulse).any(axis=1)] = int(Status.UNSTOPPABLE)
    return OneStepSolution(after, impulse, status, np.where(sticks, int(Flag.STICK), 0), slopes)


def _slipping(slip: _Slip, angle: Array, p: Array, speed: Array) -> tuple[Array, Array, Array, Array]:
    """Return the impulses (n, 3) of slip, and their derivatives by W, μ and e.

    From F(z) = (a·û, σ⊥·û) = 0 with z = (p, θ) follows δz = −(∂F/∂z)⁻¹ δF.
    """
    W, mu = slip.W, slip.mu
    sigma, across, d, a = (one[:, 0] for one in slip.directions(angle[:, None]))
    u = slip.at(angle[:, None])[1][:, 0]
    tests = np.stack([a, across], axis=1)
    by_angle, by_mu = -mu[:, None] * across, -sigma  # of d

    def change(of_d: Array, of_across: Array | None = None) -> Array:
        """Return δF for a change of d, and with it of a and σ⊥."""
        out = p[:, None] * np.einsum("nri,nij,nj->nr", tests, W, of_d)
        if slip.convex:
            out[:, 0] += np.einsum("ni,ni->n", of_d, u)
        if of_across is not None:
            out[:, 1] += np.einsum("ni,ni->n", of_across, u)
        return out

    of_z = np.stack([np.einsum("nri,nij,nj->nr", tests, W, d), change(by_angle, -sigma)], axis=2)
    of_e = tests[:, :, 2] * speed[:, None]
    of_W = p[:, None, None, None] * np.einsum("nri,nj->nrij", tests, d)
    to_z = -np.linalg.pinv(of_z)
    to_P = np.stack([d, p[:, None] * by_angle], axis=2) @ to_z
    by_W = np.einsum("nkr,nrij->nkij", to_P, of_W)
    by_friction = np.einsum("nkr,nr->nk", to_P, change(by_mu)) + p[:, None] * by_mu
    return p[:, None] * d, by_W, by_friction, np.einsum("nkr,nr->nk", to_P, of_e)
