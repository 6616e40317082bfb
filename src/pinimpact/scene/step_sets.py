"""Active sets of a time step, and derivatives of the iterations that solve its contact problem.

The method is in derivatives.md, section 12.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import LITTLE, RANK, ROUNDING, SETTLED, SOFTEST
from ..arrays import Array, Integers
from ._kernels.step_iterations import Law
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
    """An iteration of (16.3).

    Attributes:
        r: (rows,) r; zero for rows whose iterations have ended.
        before, after: (rows,) impulses before it and after it [N s].
        u: (rows,) velocities of the rows that it makes vanish [m/s].
        shift: (nv,) difference of the velocities from those at the end of the step.
    """

    r: Array
    before: Array
    after: Array
    u: Array
    shift: Array


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
        numbers: What kernels need of the law.
    """

    def __init__(self, taken: StepTaken, friction: Array, dry_friction: Array, compliances: Array) -> None:
        found, rows = taken.found, taken.rows
        nc, every, n = len(rows.contacts), len(rows.surface), len(rows.counts)
        self._taken, self.jacobian = taken, dense(rows, len(found.v_end))
        self._friction, self._compliances = friction[rows.contacts], compliances[rows.contacts]
        first = 3 * every + len(rows.limits)
        bounds = taken.h * dry_friction[rows.dry] / rows.values[first:, 0]
        gaps, normals = np.zeros(n), np.concatenate([3 * np.arange(every) + 2, rows.normals[nc:]])
        gaps[normals] = rows.gap
        self.closes, held = np.zeros(n, dtype=bool), np.arange(nc, every)
        self.closes[normals] = rows.gap > -taken.overlap
        self.closes[3 * held + 2] = True
        self.targets = np.where(self.closes, gaps / taken.h, 0.0)
        impulse = found.impulse
        self._rounding = rounding = ROUNDING * np.abs(impulse).max(initial=0.0)
        without = self.jacobian @ (found.foreseen - taken.h * taken.pushed)  # impulses: a scale if all rests
        fastest = max(float(np.abs(one).max(initial=0.0)) for one in (found.u_start, found.u_end, without))
        self.numbers = Law(nc, 3 * every, first, self._friction, bounds, fastest, taken.h)
        presses = impulse > rounding
        touches = presses & self.closes & (gaps <= taken.touching)
        self.pinned = rows.normals[touches[rows.normals]]
        pushed, speed = (np.hypot(*one[: 3 * nc].reshape(-1, 3).T[:2]) for one in (impulse, found.u_end))
        closed, radius = presses[2 : 3 * nc : 3], self._friction * impulse[2 : 3 * nc : 3]
        bound = closed & (pushed >= (1.0 - TIED) * radius)
        self.slips = bound & ((radius == 0.0) | (speed > TIED * fastest))
        self.sticks = closed & ~self.slips
        self.limits = presses[3 * every : first]

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

    def iterations(self, response: Array, largest: Integers) -> list[Iteration]:
        """Return the iterations; for `response` and `largest` see `largest`."""
        given, before, after = self._course(response, largest)
        now, shown = np.zeros(len(self.jacobian)), np.empty_like(after)
        for k, runs in enumerate(given > 0.0):
            now = shown[k] = np.where(runs, after[k], now)
        shifts = (shown - self._taken.found.impulse) @ response.T
        velocities = self._taken.found.u_end + self.targets + shifts @ self.jacobian.T
        return list(map(Iteration, given, before, shown, velocities, shifts))


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
