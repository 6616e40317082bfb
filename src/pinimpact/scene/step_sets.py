"""What holds in a time step, and the impulses that keep its changes to that. (derivatives.md, 12)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from .._numeric.tolerances import RANK, ROUNDING, SETTLED, SOFTEST, TINY
from ..arrays import Array, Integers
from .step_taken import StepTaken

TIED = 1e3 * SETTLED
"""Part of a bound of friction, of the largest velocity or of a change below which a step is at a tie: a
thousand times what the contact problem leaves."""


OPEN, CLOSES, PINNED = range(3)
"""Whether the gap at the midpoint matters to a row: not; it is closed; it is, and already touches."""


class Slide(NamedTuple):
    """A contact that slips at the end of a step.

    Attributes:
        contact: Its place among the near contacts.
        friction: μ.
        direction: (2,) σ.
        turns: (2, 2) how the tangential impulse follows the velocity: μ λ₃ (1 − σσᵀ)/|v_t|.
    """

    contact: int
    friction: float
    direction: Array
    turns: Array


class ActiveSets(NamedTuple):
    """What holds in a step.

    Attributes:
        rows: (m,) rows whose velocities vanish, but for what gaps leave.
        gaps: (m,) gaps at the midpoint that a row closes [m], zero where it closes none.
        closing: (m,) of these gaps, see `PINNED`.
        compliances: (m,).
        slides: The contacts that slip.
        bounds: (rows,) rates of impulses that are at bounds by the length of the step, of dry friction.
        tied: Whether something is at a tie, and has been decided one way.
    """

    rows: Integers
    gaps: Array
    closing: Integers
    compliances: Array
    slides: tuple[Slide, ...]
    bounds: Array
    tied: bool

    def directions(self, jacobian: Array) -> Array:
        """Return the generalized forces (nv, m) by which impulses act on the rows."""
        out, slides = jacobian[self.rows].T.copy(), {3 * one.contact + 2: one for one in self.slides}
        for column, row in enumerate(self.rows.tolist()):
            if row in slides:
                one = slides[row]
                out[:, column] -= one.friction * one.direction @ jacobian[row - 2 : row]
        return out


class _Sets:
    """Collects what holds in a step; a tie is decided one way or the other."""

    def __init__(self, taken: StepTaken, otherwise: bool) -> None:
        self.taken, self.otherwise, self.tied = taken, otherwise, False
        self.kept: list[tuple[int, float, int, float]] = []
        self.slides: list[Slide] = []
        self.bounds = np.zeros(len(taken.found.impulse))
        found = taken.found
        self.rounding = ROUNDING * np.abs(found.impulse).max(initial=0.0)
        self.still = TIED * max(np.abs(one).max(initial=0.0) for one in (found.u_start, found.u_end))
        self.still = max(self.still, self._missed())

    def _missed(self) -> float:
        """Return the sum of what velocities of contacts and limits with impulses are off [m/s].

        Velocities of others follow from these, and are known no better.
        """
        taken, rows = self.taken, self.taken.rows.normals
        every = len(taken.rows.surface)
        gap = np.concatenate([taken.rows.gap[: len(taken.rows.contacts)], taken.rows.gap[every:]])
        off = taken.found.u_end[rows] + np.where(gap > -taken.overlap, gap / taken.h, 0.0)
        return float(np.abs(off[taken.found.impulse[rows] > self.rounding]).sum())

    def tie(self) -> bool:
        """Decide a tie."""
        self.tied = True
        return self.otherwise

    def closed(self, row: int, gap: float) -> tuple[float, int] | None:
        """Return the gap that a row along a normal closes, and how it matters; None if it is open."""
        found, h = self.taken.found, self.taken.h
        if found.impulse[row] <= self.rounding:
            apart = found.u_end[row] + (gap / h if gap > -self.taken.overlap else 0.0) > self.still
            return None if apart or not self.tie() else (0.0, OPEN)
        if gap <= -self.taken.overlap:
            return 0.0, OPEN
        return gap, PINNED if gap <= self.taken.touching else CLOSES

    def add_contact(self, k: int, gap: float, friction: float, compliance: float) -> None:
        """Add a contact by its place among the near ones."""
        impulse, u, row = self.taken.found.impulse, self.taken.found.u_end, 3 * k + 2
        closes = self.closed(row, gap)
        if closes is None:
            return
        speed, pushed = float(np.hypot(*u[row - 2 : row])), float(np.hypot(*impulse[row - 2 : row]))
        slips = friction == 0.0 or pushed >= (1.0 - TIED) * friction * impulse[row]
        if slips and friction > 0.0 and speed <= self.still:
            slips = self.tie()
            speed, direction = 0.0, -impulse[row - 2 : row] / (pushed or 1.0)
        elif slips and friction > 0.0:
            direction = u[row - 2 : row] / speed
        if slips:
            turns = np.zeros((2, 2))
            if friction == 0.0:
                direction = np.zeros(2)
            elif speed > 0.0:
                turns = friction * impulse[row] / speed * (np.eye(2) - np.outer(direction, direction))
            self.slides.append(Slide(k, friction, direction, turns))
        else:
            self.kept += [(row - 2, 0.0, OPEN, compliance), (row - 1, 0.0, OPEN, compliance)]
        self.kept.append((row, *closes, compliance))

    def add_dry(self, row: int, bound: float) -> None:
        """Add a joint with dry friction, whose impulse has a bound."""
        impulse, speed = self.taken.found.impulse[row], abs(self.taken.found.u_end[row])
        sticks = abs(impulse) < (1.0 - TIED) * bound
        if not sticks and speed <= self.still:
            sticks = self.tie()
        if sticks:
            self.kept.append((row, 0.0, OPEN, 1.0))
        else:
            self.bounds[row] = impulse / self.taken.h


def active_sets(
    taken: StepTaken, friction: Array, dry_friction: Array, compliances: Array, otherwise: bool
) -> ActiveSets:
    """Return what holds in a step, with ties decided one way, or otherwise.

    Friction and compliances (n,) are those of all contacts, dry friction (nv,) that of all joints.
    """
    rows, sets = taken.rows, _Sets(taken, otherwise)
    nc, nh, nl = len(rows.contacts), len(rows.held), len(rows.limits)
    for k, i in enumerate(rows.contacts.tolist()):
        if not taken.found.arrives[k]:
            sets.add_contact(k, float(rows.gap[k]), float(friction[i]), float(compliances[i]))
    for k in range(nc, nc + nh):
        sets.kept += [(3 * k, 0.0, OPEN, 1.0), (3 * k + 1, 0.0, OPEN, 1.0)]
        sets.kept.append((3 * k + 2, float(rows.gap[k]), CLOSES, 1.0))
    first = 3 * (nc + nh)
    for k in range(nl):
        closes = None if taken.found.arrives[nc + k] else sets.closed(first + k, float(rows.gap[nc + nh + k]))
        if closes is not None:
            sets.kept.append((first + k, *closes, 1.0))
    for row, joint in enumerate(rows.dry.tolist(), first + nl):
        sets.add_dry(row, taken.h * float(dry_friction[joint]) / float(rows.values[row, 0]))
    numbers, gaps, closing, soft = zip(*sets.kept, strict=True) if sets.kept else ((), (), (), ())
    places, kinds = np.array(numbers, dtype=np.int64), np.array(closing, dtype=np.int64)
    ends, softness = np.array(gaps, dtype=float), np.array(soft, dtype=float)
    return ActiveSets(places, ends, kinds, softness, tuple(sets.slides), sets.bounds, sets.tied)


class Shares(NamedTuple):
    """How redundant rows share their impulses: ℓᵀ (C λ + κ w) = 0, of velocities w that they miss. (D40)

    Attributes:
        rates: (m,) κ of the island of each row; zero where it is not known.
        least: (m,) where it is not known, that of one iteration.
        missed: (m,) κ w.
        largest: (m,) the row of the step with the largest entry on the diagonal of W in that island.
    """

    rates: Array
    least: Array
    missed: Array
    largest: Integers


def shares_of(taken: StepTaken, sets: ActiveSets, compliances: Array, delassus: Array, null: Array) -> Shares:
    """Return how the active rows share their impulses in a step.

    Compliances (nc,) are those of the near contacts, W (rows, rows) is that of all rows of the step, and null
    (m, …) has the ℓ of the active ones.
    """
    found, contacts = taken.found, 3 * len(compliances)
    acts = np.ones(len(delassus), dtype=bool)
    acts[taken.rows.normals] = ~found.arrives
    acts[:contacts] = np.repeat(acts[2:contacts:3], 3)
    island = connected_components((delassus != 0.0) & np.outer(acts, acts))[1]
    missed = found.u_end[sets.rows] + np.where(sets.closing != OPEN, sets.gaps / taken.h, 0.0)
    w, p = (null @ (null.T @ np.column_stack([missed, sets.compliances * found.impulse[sets.rows]]))).T
    (rates, least), largest = np.zeros((2, len(w))), np.zeros(len(w), dtype=np.int64)
    for number in np.unique(island[sets.rows]):
        own, of = island[sets.rows] == number, np.flatnonzero(island[:contacts] == number)
        if len(of) == 0:
            continue
        largest[own] = top = of[delassus[of, of].argmax()]
        once = compliances[of // 3].max() / (SOFTEST * delassus[top, top])
        count = -(w[own] @ p[own]) / max(w[own] @ w[own], TINY) / once
        if 0.5 < count < 1.0 / TIED and abs(count - round(count)) <= TIED:
            rates[own] = round(count) * once
        else:
            least[own] = once
    return Shares(rates, least, rates * missed, largest)


def limit_of_compliances(
    matrix: Array, velocities: Array, compliances: Array, shared: Array | None = None
) -> Array:
    """Return impulses (m, n) that cause velocities (m, n), in the limit of small compliances (m,). (D37)

    The matrix (m, m) of velocities by impulses is of any rank; columns with NaN stay so. What no velocity
    shows of the impulses λ is ℓᵀ C λ = ℓᵀ `shared` (m, n), or zero.
    """
    m = len(matrix)
    found = np.full_like(velocities, np.nan)
    shared = np.zeros_like(velocities) if shared is None else shared
    known = np.isfinite(velocities + shared).all(axis=0)
    if m == 0:
        return found
    left, sizes, right = np.linalg.svd(matrix)
    small = sizes <= RANK * sizes[0]
    null = left[:, small]
    if null.shape[1] == 0:
        found[:, known] = np.linalg.solve(matrix, velocities[:, known])
        return found
    # (matrix + r C) λ = velocities for r → 0: what cannot be caused grows along C ρ, matrix ρ = 0
    given, unit = velocities[:, known], sizes[0] / compliances.max()
    along = compliances[:, None] * right[small].T
    caused = given - along @ np.linalg.lstsq(null.T @ along, null.T @ given, rcond=RANK)[0]
    wanted = np.concatenate([caused, unit * null.T @ shared[:, known]])
    rows = np.concatenate([matrix, unit * null.T * compliances])
    found[:, known] = np.linalg.lstsq(rows, wanted, rcond=RANK)[0]
    return found
