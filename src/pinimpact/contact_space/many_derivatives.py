"""Derivatives of impacts at several contacts, by finite differences. (docs/derivatives.md, 11)"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDING, ROUNDOFF
from ..arrays import Bools, Integers
from ..errors import PinimpactError
from ._kernels.tolerances import MISSED
from .derivatives import Boundary, Derivatives
from .inputs import Array
from .many_inputs import ManyInputs, rows_of
from .many_solution import ManySolution, Run
from .problem import ZERO
from .simultaneous import find_policy

Impulses = Callable[[float], Array]

FIRST, FINER, LEVELS = 4e-3, 0.25, 9
"""The first step of differences relative to the size of the data, the ratio of successive steps, and their
largest number."""

AGREED = MISSED
"""Largest relative difference of derivatives by two steps, or to both sides, for which a derivative exists.
The truncation error of the second is 4⁻⁶ of the difference, or a third if the slope of P has a kink."""

STEEP = FINER**0.75
"""Least ratio of successive changes of P that shows a jump or an unbounded slope."""

CENTRAL = np.array([45.0, -9.0, 1.0]) / 60.0
ASIDE = np.array([18.0, -9.0, 2.0]) / 6.0
INTO = np.array([360.0, -450.0, 400.0, -225.0, 72.0, -10.0]) / 60.0
"""Weights of values at 1, 2, … steps: central differences; one side of them; one-sided differences."""


class Change(NamedTuple):
    """A direction in which the data of an impact change, in the shapes of `ManyInputs`."""

    velocity: Array
    delassus: Array
    friction: Array
    restitution: Array
    stiffness: Array

    def part(self, at: Integers) -> Change:
        """Return the change of the problem of some of the contacts, given by their indices."""
        rows = rows_of(at)
        coefficients = (self.friction[at], self.restitution[at], self.stiffness[at])
        return Change(self.velocity[at], self.delassus[np.ix_(rows, rows)], *coefficients)


def coefficient_change(n: int, **of: int) -> Change:
    """Return a unit `Change` of coefficients, given as name=index of the contact."""
    numbers = {name: np.zeros(n) for name in ("friction", "restitution", "stiffness")}
    for name, k in of.items():
        numbers[name][k] = 1.0
    return Change(np.zeros((n, 3)), np.zeros((3 * n, 3 * n)), **numbers)


def coefficient_changes(n: int) -> list[Change]:
    """Return the unit changes of μ of each of n contacts, then of e."""
    return [coefficient_change(n, **{name: k}) for name in ("friction", "restitution") for k in range(n)]


class Slopes(NamedTuple):
    """Derivatives of the impulses of an impact along m directions.

    Attributes:
        impulse: (3n, m) derivatives; NaN if they do not exist.
        shared: (m,) whether the distribution of impulses over redundant contacts is differentiable too. If
            not, W times the column is still the derivative of the velocities.
        boundary: Flags of `Boundary`.
    """

    impulse: Array
    shared: Bools
    boundary: Boundary


class _Slope(NamedTuple):
    """Derivative along one direction.

    Attributes:
        impulse: (3n,) derivative of P.
        error: Relative difference of derivatives by two steps, in velocities.
        unshared: The same in impulses.
        jumps: Whether the change of P does not vanish with the step.
    """

    impulse: Array
    error: float
    unshared: float
    jumps: bool


def derivatives_of_many(
    inputs: ManyInputs, policy: str, options: Mapping[str, Any], solution: ManySolution, side: int | None
) -> Derivatives:
    """Return the derivatives of an impact at n contacts by v°, the entries of W, μ and e."""
    n = len(inputs.velocity)
    m = 3 * n
    nothing, first, second = coefficient_change(n), *np.triu_indices(m)
    changes = [nothing._replace(velocity=row.reshape(n, 3)) for row in np.eye(m)]
    for i, j in zip(first, second, strict=True):
        entry = np.zeros((m, m))
        entry[i, j] = entry[j, i] = 1.0 if i == j else 0.5
        changes.append(nothing._replace(delassus=entry))
    changes += coefficient_changes(n)
    found = slopes_along(inputs, policy, solution, changes, side, options)
    impulse, end = solution.impulse.ravel(), m + len(first)
    moved = inputs.delassus @ found.impulse
    moved[:, :m] += np.eye(m)
    moved[:, m:end] += np.array([change.delassus @ impulse for change in changes[m:end]]).T
    impulses = np.where(found.shared, found.impulse, np.nan)
    return Derivatives(*_parts(moved, n), *_parts(impulses, n), found.boundary)


def _parts(columns: Array, n: int) -> tuple[Array, Array, Array, Array]:
    """Split derivatives (3n, …) of n contacts into those by v°, W (from its upper triangle), μ and e."""
    m = 3 * n
    first, second = np.triu_indices(m)
    by_velocity, by_entry, by_friction, by_restitution = np.split(
        columns.reshape(n, 3, -1), np.cumsum([m, len(first), n]), axis=2
    )
    by_delassus = np.empty((n, 3, m, m))
    by_delassus[..., first, second] = by_delassus[..., second, first] = by_entry
    return by_velocity.reshape(n, 3, n, 3), by_delassus, by_friction, by_restitution


def slopes_along(
    inputs: ManyInputs,
    policy: str,
    solution: ManySolution,
    changes: Sequence[Change],
    side: int | None = None,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> Slopes:
    """Differentiate the impulses of an impact along directions, by differences of sixth order.

    Changes of W keep its rank. A derivative does not exist if one-sided derivatives differ, if steps do not
    converge, if it is not linear in the direction, or if the impact is integrated by steps.

    Args:
        inputs: The problem.
        policy: Name of its policy.
        solution: Its solution.
        changes: The m directions.
        side: 1 or −1: derivatives that do not exist are replaced by those to this side, if these exist.
        options: Options of the policy.
    """
    if solution.story.parts:
        return _slopes_of_groups(inputs, policy, solution, changes, side, options)
    impulse = solution.impulse.ravel()
    if _by_steps(solution):
        nothing = np.full((len(impulse), len(changes)), np.nan)
        return Slopes(nothing, np.ones(len(changes), dtype=bool), Boundary.EVENTS_COINCIDE)
    along = _Differences(inputs, partial(find_policy(policy).run, **options), impulse)
    found = [along.slope(change) for change in changes]
    columns = np.array([one.impulse for one in found]).reshape(len(changes), impulse.size).T.copy()
    known = np.array([along.known(*one) for one in zip(changes, found, strict=True)], dtype=bool)
    boundary = Boundary.RANK if inputs.singular else Boundary.NONE
    if (inputs.friction == 0.0).any() or ((inputs.restitution == 0.0) | (inputs.restitution == 1.0)).any():
        boundary |= Boundary.BOUND
    for change, slope, is_known in zip(changes, found, known.tolist(), strict=True):
        if not is_known:
            boundary |= _reason(inputs, change, slope)
    moving = [k for k in np.flatnonzero(known).tolist() if along.size(changes[k]) > 0.0]
    both = [k for k in moving if not along.one_sided(changes[k])]
    if len(both) > 1 and not along.linear([changes[k] for k in both], columns[:, both]):
        known[both] = False
        boundary |= Boundary.EVENTS_COINCIDE
    for k in np.flatnonzero(~known).tolist():
        columns[:, k] = np.nan
        if side is not None:
            found[k] = along.slope(changes[k], float(side))
            columns[:, k] = found[k].impulse if along.known(changes[k], found[k]) else np.nan
    return Slopes(columns, np.array([one.unshared <= AGREED for one in found], dtype=bool), boundary)


def _slopes_of_groups(
    inputs: ManyInputs,
    policy: str,
    solution: ManySolution,
    changes: Sequence[Change],
    side: int | None,
    options: Mapping[str, Any],
) -> Slopes:
    """Differentiate each group of coupled contacts with its own scales; arguments as for `slopes_along`.

    Changes that couple groups are differences of the whole problem.
    """
    impulse = np.zeros((solution.impulse.size, len(changes)))
    shared, boundary = np.ones(len(changes), dtype=bool), Boundary.NONE
    for (at, one), (_, part) in zip(inputs.groups(), solution.story.parts, strict=True):
        own = [change.part(at) for change in changes]
        found = slopes_along(one, policy, part, own, side, options)
        impulse[rows_of(at)] = found.impulse
        shared &= found.shared
        boundary |= found.boundary
    inner = np.zeros(inputs.delassus.shape, dtype=bool)
    for at, _ in solution.story.parts:
        inner[np.ix_(rows_of(at), rows_of(at))] = True
    couples = [k for k, change in enumerate(changes) if change.delassus[~inner].any()]
    if couples:
        whole = solution.with_story(parts=())
        found = slopes_along(inputs, policy, whole, [changes[k] for k in couples], side, options)
        impulse[:, couples], shared[couples] = found.impulse, found.shared
        boundary |= found.boundary
    return Slopes(impulse, shared, boundary)


def _by_steps(solution: ManySolution) -> bool:
    """Return whether a solution was integrated by steps, or a bound on steps or events was reached."""
    return solution.story.bounded or (solution.events == 0 and bool(solution.impulse.any()))


def _reason(inputs: ManyInputs, change: Change, slope: _Slope) -> Boundary:
    """Return the probable reason why there is no derivative along a change."""
    rest = ROUNDING * float(np.abs(inputs.velocity).max(initial=0.0))
    normal = np.abs(inputs.velocity[:, 2]) <= rest
    if change.velocity[normal, 2].any():
        return Boundary.GRAZING
    still = np.abs(inputs.velocity[:, :2]).max(axis=1, initial=0.0) <= rest
    if change.velocity[still, :2].any():
        return Boundary.START_AT_REST
    return Boundary.JUMP if slope.jumps else Boundary.EVENTS_COINCIDE


class _Differences:
    """Differences of the impulses P of an impact along directions of its data."""

    def __init__(self, inputs: ManyInputs, run: Run, impulse: Array) -> None:
        self._inputs, self._run, self._impulse = inputs, run, impulse
        self._unknown = np.full_like(impulse, np.nan)
        self._moves = np.flatnonzero(inputs.delassus.any(axis=1))
        values, vectors = np.linalg.eigh(inputs.delassus[np.ix_(self._moves, self._moves)])
        kept = values > ZERO * len(values) * values.max(initial=0.0)
        roots = np.sqrt(values[kept])
        self._factor, self._inverse = vectors[:, kept] * roots, (vectors[:, kept] / roots).T
        self._speed = float(np.abs(inputs.velocity).max(initial=0.0)) or 1.0

    def _of_factor(self, change: Change) -> Array:
        """Return the change of L, W = L Lᵀ, for a change of W that keeps its rank."""
        moved = change.delassus[np.ix_(self._moves, self._moves)] @ self._inverse.T
        return np.asarray(moved - 0.5 * self._factor @ (self._inverse @ moved))

    def size(self, change: Change) -> float:
        """Return the size of a change relative to the data."""
        inputs, of_factor = self._inputs, self._of_factor(change)
        within = self._inverse @ of_factor
        beyond = of_factor - self._factor @ within
        return max(
            float(np.abs(change.velocity).max(initial=0.0)) / self._speed,
            2.0 * float(np.linalg.norm(within)),
            float(np.linalg.norm(beyond)) / (float(np.linalg.norm(self._factor)) or 1.0),
            float((np.abs(change.friction) / np.maximum(inputs.friction, 1.0)).max(initial=0.0)),
            float(np.abs(change.restitution).max(initial=0.0)),
            float((np.abs(change.stiffness) / inputs.stiffness).max(initial=0.0)),
        )

    def known(self, change: Change, slope: _Slope) -> bool:
        """Return whether the velocities have the derivative `slope` along a change.

        Impulses that move nothing, but jump, do move something where W changes.
        """
        jumps = slope.jumps and slope.unshared > AGREED and bool(change.delassus.any())
        return slope.error <= AGREED and not jumps

    def _room(self, change: Change, sign: float) -> float:
        """Return the largest multiple of a change with which coefficients stay in their ranges."""
        inputs = self._inputs
        values = np.concatenate([inputs.friction, inputs.restitution, 1.0 - inputs.restitution])
        rates = -sign * np.concatenate([change.friction, change.restitution, -change.restitution])
        falling = rates > 0.0
        return float((values[falling] / rates[falling]).min(initial=np.inf))

    def one_sided(self, change: Change) -> bool:
        """Return whether a coefficient that changes is at a bound of its range."""
        return min(self._room(change, 1.0), self._room(change, -1.0)) * self.size(change) < FIRST * FINER**3

    def _impulses(self, change: Change, size: float) -> Impulses:
        """Return P (3n,) as a function of the multiple of a change; NaN if it is integrated by steps."""
        inputs, run, moves = self._inputs, self._run, np.ix_(self._moves, self._moves)
        of_factor = self._of_factor(change) / size
        turned = self._factor @ of_factor.T
        turned, bent = turned + turned.T, of_factor @ of_factor.T
        v, mu, e, stiffness = (
            one / size for one in (change.velocity, change.friction, change.restitution, change.stiffness)
        )

        def at(s: float) -> Array:
            delassus = inputs.delassus.copy()
            delassus[moves] += s * turned + s * s * bent
            problem = inputs._replace(
                delassus=delassus,
                velocity=inputs.velocity + s * v,
                friction=inputs.friction + s * mu,
                restitution=inputs.restitution + s * e,
                stiffness=inputs.stiffness + s * stiffness,
            )
            try:
                found = run(problem, False)
            except PinimpactError:  # no solution for this change
                return self._unknown
            return self._unknown if _by_steps(found) else found.impulse.ravel()

        return at

    def slope(self, along: Change, side: float = 0.0) -> _Slope:
        """Return the derivative along a change; with `side`, 1 or −1, the one-sided one."""
        size = self.size(along)
        if size == 0.0:
            return _Slope(np.zeros_like(self._impulse), 0.0, 0.0, False)
        at, ahead, behind = self._impulses(along, size), self._room(along, 1.0), self._room(along, -1.0)
        one_sided = side != 0.0 or self.one_sided(along)
        sign = side or (1.0 if ahead >= behind else -1.0)
        room = (ahead if sign > 0.0 else behind) if one_sided else min(ahead, behind)
        h = min(FIRST, room * size / len(INTO if one_sided else CENTRAL))
        best, change = _Slope(self._unknown, np.inf, np.inf, False), np.inf
        last: Array | None = None
        for _ in range(LEVELS if h > 0.0 else 0):
            now, bend = self._into(at, sign * h) if one_sided else self._both(at, h)
            before, change = change, self._apart(h * now, np.zeros_like(now))[1]
            best = best._replace(jumps=change > STEEP * before)
            if last is not None:
                error, unshared = self._apart(now, last)
                error = max(error, self._apart(bend + now, now)[0])
                if error <= best.error:
                    best = _Slope(now * size, error, unshared, best.jumps)
            if best.error <= min(AGREED, ROUNDOFF / (h * FINER**6)):  # a shorter step gains nothing
                break
            last, h = now, FINER * h
        return best

    def _apart(self, one: Array, other: Array) -> tuple[float, float]:
        """Return the relative differences of two derivatives, in velocities and in impulses."""

        def part(weigh: Callable[[Array], Array]) -> float:
            scale = max(float(np.linalg.norm(weigh(x))) for x in (self._impulse, one, other))
            return float(np.linalg.norm(weigh(one - other))) / (scale or 1.0)

        return part(lambda x: self._factor.T @ x[self._moves]), part(lambda x: x)

    def _both(self, at: Impulses, h: float) -> tuple[Array, Array]:
        """Return the central derivative by steps h, and the difference of the one-sided ones."""
        right, left = ([at(side * k * h) for k in (1, 2, 3)] for side in (1.0, -1.0))
        differences = np.array(right) - np.array(left)
        sums = np.array(right) + np.array(left) - 2.0 * self._impulse
        return CENTRAL @ differences / h, ASIDE @ sums / h

    def _into(self, at: Impulses, h: float) -> tuple[Array, Array]:
        """Return the one-sided derivative by steps h, and zeros."""
        values = np.array([at(k * h) - self._impulse for k in range(1, 7)])
        return INTO @ values / h, np.zeros_like(self._impulse)

    def linear(self, changes: Sequence[Change], slopes: Array) -> bool:
        """Return whether the derivative along a weighted sum of changes is the sum of their derivatives."""
        weights = np.random.default_rng(0).choice([-1.0, 1.0], len(changes)) * np.linspace(
            0.5, 1.0, len(changes)
        )
        weights /= [self.size(change) for change in changes]
        total = Change(*(np.tensordot(weights, np.array(parts), 1) for parts in zip(*changes, strict=True)))
        if self.size(total) == 0.0:
            return True
        found = self.slope(total)
        return found.error <= AGREED and self._apart(found.impulse, slopes @ weights)[0] <= AGREED
