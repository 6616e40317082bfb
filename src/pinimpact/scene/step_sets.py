"""Active sets of a time step, and derivatives of the iterations that solve its contact problem.

The method is in derivatives.md, section 12.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import LITTLE, RANK, ROUNDING, SETTLED, SOFTEST, TINY
from ..arrays import Array, Bools, Integers
from ._kernels.step_rows import StepRows
from .step_taken import StepTaken

TIED = 1e3 * SETTLED
"""Tolerance of ties, relative to a bound of friction, to the largest velocity or to a change: a thousand
times the residual of the contact problem."""

SETTLING = 3
"""Number of iterations, with a thousandth of r, that represent impulses found by another method. The relative
error of changes is 3·10⁻⁶ W/w after the first one, with w the part of W that they move, and its third power
after three."""


class Iteration(NamedTuple):
    """Derivatives of an iteration of (16.3): δf⁺ = `kept` δf − `stiff` δu + `bent` δr/r + …. (D40)

    Attributes:
        impulse: (rows,) f⁺ [N s].
        shift: (nv,) difference of the velocities from those at the end of the step.
        kept: (rows, rows) ∂P; the identity for islands whose iterations have ended.
        stiff: (rows, rows) ∂P/r.
        bent: (rows,) ∂P u/r.
        by_friction: (rows,) ∂P/∂μ, by the coefficient of the row's own contact.
        by_length: (rows,) derivatives by h of impulses at the bound of dry friction [N or N m].
        tied: Whether P has a kink in any row.
    """

    impulse: Array
    shift: Array
    kept: Array
    stiff: Array
    bent: Array
    by_friction: Array
    by_length: Array
    tied: bool


class StepLaw:
    """The law of the contacts, limits and dry joints of a step, as its iterations solve it.

    Args:
        taken: Data of the step.
        friction: (n,) coefficients of friction of all contacts.
        dry_friction: (nv,) dry friction of all joints.
        compliances: (n,) compliances of all contacts.

    Attributes:
        jacobian: (rows, nv) Jacobian of the rows.
        closes: (rows,) whether a normal row closes the gap at the midpoint.
        targets: (rows,) speed at which it does [m/s].
        pinned: (m,) normal rows with an impulse whose contacts touch at the midpoint.
        sticks, slips: (nc,) whether each contact has an impulse and sticks, or slips.
        limits: (nl,) whether each limit has an impulse.
    """

    def __init__(self, taken: StepTaken, friction: Array, dry_friction: Array, compliances: Array) -> None:
        found, rows = taken.found, taken.rows
        nc, every, n = len(rows.contacts), len(rows.surface), len(rows.counts)
        self._taken, self.jacobian = taken, dense(rows, len(found.v_end))
        self._friction, self._compliances = friction[rows.contacts], compliances[rows.contacts]
        self._first = 3 * every + len(rows.limits)
        self._bounds = taken.h * dry_friction[rows.dry] / rows.values[self._first :, 0]
        gaps, normals = np.zeros(n), np.concatenate([3 * np.arange(every) + 2, rows.normals[nc:]])
        gaps[normals] = rows.gap
        self.closes, held = np.zeros(n, dtype=bool), np.arange(nc, every)
        self.closes[normals] = rows.gap > -taken.overlap
        self.closes[3 * held + 2] = True
        self.targets = np.where(self.closes, gaps / taken.h, 0.0)
        impulse = found.impulse
        self._rounding = rounding = ROUNDING * np.abs(impulse).max(initial=0.0)
        without = self.jacobian @ (found.foreseen - taken.h * taken.pushed)  # impulses: a scale if all rests
        self._speed = max(np.abs(one).max(initial=0.0) for one in (found.u_start, found.u_end, without))
        presses = impulse > rounding
        touches = presses & self.closes & (gaps <= taken.touching)
        self.pinned = rows.normals[touches[rows.normals]]
        pushed, speed = (np.hypot(*one[: 3 * nc].reshape(-1, 3).T[:2]) for one in (impulse, found.u_end))
        closed, radius = presses[2 : 3 * nc : 3], self._friction * impulse[2 : 3 * nc : 3]
        bound = closed & (pushed >= (1.0 - TIED) * radius)
        self.slips = bound & ((radius == 0.0) | (speed > TIED * self._speed))
        self.sticks = closed & ~self.slips
        self.limits = presses[3 * every : self._first]

    def pushes(self) -> Array:
        """Return the generalized forces (m, nv) per unit of impulses along the pinned rows, with friction."""
        out, impulse = self.jacobian[self.pinned].copy(), self._taken.found.impulse
        for one, row in zip(out, self.pinned.tolist(), strict=True):
            if row < 3 * len(self.slips) and self.slips[row // 3]:
                one += impulse[row - 2 : row] / impulse[row] @ self.jacobian[row - 2 : row]
        return out

    def softness(self) -> Array:
        """Return the compliances (m,) of the pinned rows."""
        every = np.append(self._compliances, 1.0)
        return np.asarray(every[np.minimum(self.pinned // 3, len(every) - 1)])

    def largest(self, response: Array) -> Integers:
        """Return for each row (rows,) the contact row of its island with the largest diagonal entry of W.

        The response (nv, rows) is M⁻¹Jᵀ.
        """
        found, contacts = self._taken.found, 3 * len(self._friction)
        delassus, acts = self.jacobian @ response, np.ones(len(self.jacobian), dtype=bool)
        acts[self._taken.rows.normals] = ~found.arrives
        acts[:contacts] = np.repeat(acts[2:contacts:3], 3)
        linked = (delassus != 0.0) & np.outer(acts, acts)
        island, lower = np.full(len(acts), -1), np.arange(len(acts))
        while (lower != island).any():
            island = lower
            lower = np.minimum(island, np.where(linked, island, len(acts)).min(axis=1, initial=len(acts)))
        largest = np.arange(len(island))
        for number in np.unique(island[:contacts]):
            of = np.flatnonzero(island[:contacts] == number)
            largest[island == number] = of[delassus.diagonal()[of].argmax()]
        return largest

    def _course(self, response: Array, largest: Integers) -> tuple[Array, Array, Array]:
        """Return r and the impulses before and after each iteration, (…, rows).

        Impulses found by another method are represented by `SETTLING` iterations that do not change them.
        """
        found, contacts = self._taken.found, 3 * len(self._friction)
        (given, after), none = found.course, ~found.course[0].any(axis=0)
        before = np.vstack([np.zeros((1, len(none))), after])
        if none.any():
            soft = LITTLE * SOFTEST * np.einsum("an,na->a", self.jacobian, response)[largest]
            soft[:contacts] *= np.repeat(self._compliances, 3)
            soft /= self._compliances.max(initial=0.0) or 1.0
            impulse = np.where(none & (np.abs(found.impulse) > self._rounding), found.impulse, 0.0)
            given = np.vstack([given, *[np.where(none, soft, 0.0)] * SETTLING])
            after = np.vstack([after, *[impulse] * SETTLING])
            before = np.vstack([before[:-1], *[impulse] * SETTLING])
        return given, before[: len(given)], after

    def iterations(self, response: Array, largest: Integers, otherwise: bool) -> Iterator[Iteration]:
        """Yield the iterations; `otherwise` decides ties the opposite way. For `response` see `largest`."""
        found, now = self._taken.found, np.zeros(len(self.jacobian))
        dry = np.arange(len(now)) >= self._first
        for r, before, after in zip(*self._course(response, largest), strict=True):
            runs = r > 0.0
            now = np.where(runs, after, now)
            shift = response @ (now - found.impulse)
            u = found.u_end + self.targets + self.jacobian @ shift
            rate = np.divide(1.0, r, out=np.zeros_like(r), where=runs)
            near = SETTLED * self._speed * rate
            slopes, by_friction, tied = self._slopes(before - u * rate, now, near, otherwise)
            kept, stiff = np.where(runs[:, None], slopes, np.eye(len(now))), slopes * rate
            bound = dry & runs & (slopes.diagonal() == 0.0)
            by_length = np.where(bound, now / self._taken.h, 0.0)
            changes = kept, stiff, stiff @ u, np.where(runs, by_friction, 0.0), by_length
            yield Iteration(now, shift, *changes, bool(tied[runs].any()))

    def _slopes(self, z: Array, impulse: Array, near: Array, otherwise: bool) -> tuple[Array, Array, Bools]:
        """Return the derivatives of P of (16.4).

        Args:
            z: (rows,) argument of P.
            impulse: (rows,) P(z).
            near: (rows,) distance from a kink up to which there is a tie.
            otherwise: Whether to decide ties the opposite way.

        Returns:
            (rows, rows) ∂P; (rows,) its derivative by friction; (rows,) ties.
        """
        nc, every = len(self._friction), len(self._taken.rows.surface)
        out, by_friction, tied = np.zeros((len(z), len(z))), np.zeros(len(z)), np.abs(z) <= near
        tied[: 3 * every] &= np.arange(3 * every) % 3 == 2
        tied[3 * nc : 3 * every] = False
        bounds = np.abs(z[self._first :]) - self._bounds
        tied[self._first :] = np.abs(bounds) <= near[self._first :]
        for k, mu in enumerate(self._friction.tolist()):
            t, n = slice(3 * k, 3 * k + 2), 3 * k + 2
            if not (impulse[n] > 0.0) ^ (tied[n] & otherwise):
                continue
            out[n, n] = 1.0
            size, pushed, radius = np.hypot(*z[t]), np.hypot(*impulse[t]), mu * impulse[n]
            tied[3 * k] = radius > 0.0 and abs(size - radius) <= near[n]
            if (pushed < (1.0 - ROUNDING) * radius) ^ (tied[3 * k] & otherwise):
                out[t, t] = np.eye(2)
                continue
            along = z[t] / max(size, TINY)
            out[t, t] = pushed / max(size, pushed, TINY) * (np.eye(2) - np.outer(along, along))
            out[t, n], by_friction[t] = mu * along, impulse[n] * along
        scalar, acts = np.arange(3 * nc, len(z)), np.ones(len(z), dtype=bool)  # held contacts
        acts[3 * every :] = (impulse > 0.0)[3 * every :]
        acts[self._first :] = np.abs(impulse[self._first :]) < (1.0 - ROUNDING) * self._bounds
        out[scalar, scalar] = (acts ^ (tied & otherwise))[scalar]
        return out, by_friction, tied


def dense(rows: StepRows, nv: int) -> Array:
    """Return the Jacobian (rows, nv) of the rows of a step."""
    out = np.zeros((len(rows.counts), nv))
    for row, (values, columns, count) in enumerate(
        zip(rows.values, rows.columns, rows.counts.tolist(), strict=True)
    ):
        out[row, columns[:count]] = values[:count]
    return out


def limit_of_compliances(matrix: Array, velocities: Array, compliances: Array) -> Array:
    """Return impulses λ (m, n) that cause velocities (m, n), in the limit of small compliances C.

    In the null space of the matrix, ℓᵀ C λ = 0. Columns with NaN stay NaN.

    Args:
        matrix: (m, m) velocities per impulse, of any rank.
        velocities: (m, n) velocities.
        compliances: (m,) C.
    """
    m = len(matrix)
    found = np.full_like(velocities, np.nan)
    known = np.isfinite(velocities).all(axis=0)
    if m == 0:
        return found
    left, sizes, right = np.linalg.svd(matrix)
    small = sizes <= RANK * sizes[0]
    null = left[:, small]
    if null.shape[1] == 0:
        found[:, known] = np.linalg.solve(matrix, velocities[:, known])
        return found
    # (matrix + r C) λ = velocities for r → 0; velocities that no λ causes are removed along C ρ, matrix ρ = 0
    given, unit = velocities[:, known], sizes[0] / compliances.max()
    along = compliances[:, None] * right[small].T
    caused = given - along @ np.linalg.lstsq(null.T @ along, null.T @ given, rcond=RANK)[0]
    wanted = np.concatenate([caused, np.zeros((null.shape[1], given.shape[1]))])
    rows = np.concatenate([matrix, unit * null.T * compliances])
    found[:, known] = np.linalg.lstsq(rows, wanted, rcond=RANK)[0]
    return found
