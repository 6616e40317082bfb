"""Active sets of a time step, and derivatives of the iterations that solve its contact problem.

The method is in derivatives.md, section 12.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._numeric.tolerances import LITTLE, RANK, ROUNDING, SETTLED, SOFTEST
from ..arrays import Array, Integers
from ._kernels.step_iterations import Course, Law, largest_rows
from ._kernels.step_rows import StepRows
from .step_taken import StepTaken

TIED = 1e3 * SETTLED
"""Tolerance of ties, relative to a bound of friction, to the largest velocity or to a change: a thousand
times the residual of the contact problem."""

SETTLING = 3
"""Number of iterations, with a thousandth of r, that represent impulses found by another method. The relative
error of changes is 3·10⁻⁶ W/w after the first one, with w the part of W that they move, and its third power
after three."""


UNRESOLVED = LITTLE * LITTLE
"""Singular value of W, relative to its diagonal, of displacements that the iterations which remove overlap
leave as they are: with r of `LITTLE` of the diagonal, each iteration removes a thousandth of them."""


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
        found, rows, near = taken.found, taken.rows, taken.rows.normals
        nc, every, n = len(rows.contacts), len(rows.surface), len(rows.counts)
        self._taken, self.jacobian = taken, dense(rows, len(found.v_end))
        self._friction, self._compliances = friction[rows.contacts], compliances[rows.contacts]
        first = 3 * every + len(rows.limits)
        bounds = taken.h * dry_friction[rows.dry] / rows.values[first:, 0]
        gaps, normals = np.zeros(n), np.concatenate([3 * np.arange(every) + 2, near[nc:]])
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
        self.pinned = near[touches[near]]
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
        acts = np.ones(len(self.jacobian), dtype=bool)
        acts[self._taken.rows.normals] = ~self._taken.found.arrives
        largest = np.empty(len(acts), dtype=np.int64)
        largest_rows(self.jacobian, response, acts, len(self._friction), largest)
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

    def iterations(self, response: Array, largest: Integers, of_mass: Callable[[Array], Array]) -> Course:
        """Return the iterations; `of_mass` returns ∂(M x)/∂q, for other arguments see `largest`."""
        given, before, after = self._course(response, largest)
        now, shown = np.zeros(len(self.jacobian)), np.empty_like(after)
        for k, runs in enumerate(given > 0.0):
            now = shown[k] = np.where(runs, after[k], now)
        shifts = (shown - self._taken.found.impulse) @ response.T
        u = self._taken.found.u_end + self.targets + shifts @ self.jacobian.T
        turned = np.zeros((*shifts.shape, len(response)))
        for k in np.flatnonzero(shifts.any(axis=1)).tolist():
            turned[k] = of_mass(shifts[k])
        return Course(np.ascontiguousarray(given), np.ascontiguousarray(before), shown, u, shifts, turned)


def dense(rows: StepRows, nv: int) -> Array:
    """Return the Jacobian (rows, nv) of the rows of a step."""
    out = np.zeros((len(rows.counts), nv))
    used = np.arange(rows.columns.shape[1]) < rows.counts[:, None]
    out[np.repeat(np.arange(len(out)), rows.counts), rows.columns[used]] = rows.values[used]
    return out


def limit_of_removal(matrix: Array, gaps: Array) -> Array:
    """Return multipliers (m, n) that cause displacements `gaps` (m, n), as the removal of overlap does.

    The matrix (m, m) are displacements per multiplier. Compliances are in proportion to its diagonal.
    """
    diagonal = matrix.diagonal()
    largest = float(diagonal.max(initial=0.0)) or 1.0
    root = np.sqrt(np.where(diagonal > RANK * largest, diagonal, largest))
    scaled, ones = matrix / np.outer(root, root), np.ones(len(matrix))
    return limit_of_compliances(scaled, gaps / root[:, None], ones, UNRESOLVED) / root[:, None]


def limit_of_compliances(
    matrix: Array, velocities: Array, compliances: Array, resolved: float = RANK
) -> Array:
    """Return impulses λ (m, n) that cause velocities (m, n), in the limit of small compliances C.

    In the null space of the matrix, ℓᵀ C λ = 0. Columns with NaN stay NaN.

    Args:
        matrix: (m, m) velocities per impulse, of any rank.
        velocities: (m, n) velocities.
        compliances: (m,) C.
        resolved: Singular value, relative to the largest, up to which it is taken as zero.
    """
    m = len(matrix)
    if m == 0:
        return np.full_like(velocities, np.nan)
    sizes = np.linalg.svd(matrix, compute_uv=False)
    small = sizes <= resolved * sizes[0]
    if not small.any():
        return np.asarray(np.linalg.solve(matrix, velocities), dtype=float)
    found, known = np.full_like(velocities, np.nan), np.isfinite(velocities).all(axis=0)
    left, _, right = np.linalg.svd(matrix)
    null = left[:, small]
    # (matrix + r C) λ = velocities for r → 0; velocities that no λ causes are removed along C ρ, matrix ρ = 0
    given, unit = velocities[:, known], sizes[0] / compliances.max()
    along = compliances[:, None] * right[small].T
    caused = given - along @ np.linalg.lstsq(null.T @ along, null.T @ given, rcond=RANK)[0]
    wanted = np.concatenate([caused, np.zeros((null.shape[1], given.shape[1]))])
    rows = np.concatenate([matrix, unit * null.T * compliances])
    found[:, known] = np.linalg.lstsq(rows, wanted, rcond=RANK)[0]
    return found
