"""Impacts at several contacts: checks of a problem, and construction of its solution."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .._numeric.tolerances import ROUNDOFF
from ..arrays import Integers
from ..checks import counted, finite_array, real_numbers
from ..errors import InputError, UnstoppableApproachError
from .inputs import Array
from .laws import law_code
from .many_solution import ManyPath, ManySolution, ManyStory, Segments
from .problem import ZERO, ImpactProblem


class ManyInputs(NamedTuple):
    """A checked problem of n contacts.

    Attributes:
        delassus: (3n, 3n) W [1/kg].
        velocity: (n, 3) pre-impact velocities [m/s].
        friction, restitution, stiffness: (n,) μ, e and κ.
        law: Name of the restitution law.
        surface_velocity: (n, 3) velocities of the surfaces [m/s].
        singular: Whether W is singular.
        places: Numbers of the contacts in the problem, if these are some of its contacts.
    """

    delassus: Array
    velocity: Array
    friction: Array
    restitution: Array
    stiffness: Array
    law: str
    surface_velocity: Array
    singular: bool
    places: tuple[int, ...] = ()

    def part(self, at: Integers) -> ManyInputs:
        """Return the problem of some of the contacts, given by their indices."""
        rows = rows_of(at)
        return ManyInputs(
            self.delassus[np.ix_(rows, rows)],
            *(self.velocity[at], self.friction[at], self.restitution[at], self.stiffness[at]),
            *(self.law, self.surface_velocity[at], self.singular, tuple(self.place(j) for j in at.tolist())),
        )

    def groups(self) -> list[tuple[Integers, ManyInputs]]:
        """Return the indices and the problem of each group of contacts that W couples.

        Velocities of a group that are all up to `ROUNDOFF` of the largest are set to zero: those of a robot,
        sums of larger terms, have such rounding errors.
        """
        least = ROUNDOFF * float(np.abs(self.velocity).max(initial=0.0))
        found = [(at, self.part(at)) for at in coupled_groups(self.delassus)]
        still = [float(np.abs(one.velocity).max(initial=0.0)) <= least for _, one in found]
        return [
            (at, one._replace(velocity=np.zeros_like(one.velocity)) if rests else one)
            for (at, one), rests in zip(found, still, strict=True)
        ]

    def place(self, j: int) -> int:
        """Return the number of contact j in the problem."""
        return self.places[j] if self.places else j


def rows_of(at: Integers) -> Integers:
    """Return the rows (3m,) of contacts (m,)."""
    return (3 * at[:, None] + np.arange(3)).ravel()


def coupled_groups(delassus: Array) -> list[Integers]:
    """Return the indices of the contacts of each group that W (3n, 3n) couples, in ascending order."""
    n = len(delassus) // 3
    coupled = (delassus != 0.0).reshape(n, 3, n, 3).any(axis=(1, 3))
    coupled |= coupled.T
    if coupled[0].all():
        return [np.arange(n)]
    left, groups = np.ones(n, dtype=bool), []
    while left.any():
        group = np.zeros(n, dtype=bool)
        group[np.argmax(left)] = True
        grown = group
        while grown.any():
            grown = coupled[grown].any(axis=0) & ~group
            group |= grown
        left &= ~group
        groups.append(np.flatnonzero(group))
    return groups


def many_inputs(problem: ImpactProblem) -> ManyInputs:
    """Return the checked arrays of a problem of n contacts.

    Raises:
        InputError: Shapes that do not fit, numbers that are not finite or out of range, an indefinite W.
        UnknownNameError: An unknown law.
    """
    n = np.shape(problem.velocity)[0]
    velocity = np.array(finite_array("velocity", problem.velocity, (n, 3)))
    delassus = finite_array("delassus", problem.delassus, (3 * n, 3 * n))
    singular = False
    for at in coupled_groups(delassus):
        rows = rows_of(at)
        singular |= _check_semidefinite(problem, delassus[np.ix_(rows, rows)])
    delassus = 0.5 * (delassus + delassus.T)
    law_code(problem.law)
    stiffness = 1.0 if problem.stiffness is None else problem.stiffness
    return ManyInputs(
        delassus,
        velocity,
        _per_contact("friction", problem.friction, n, 0.0, np.inf, "a finite number ≥ 0"),
        _per_contact("restitution", problem.restitution, n, 0.0, 1.0, "a number from 0 to 1"),
        _per_contact("stiffness", stiffness, n, np.nextafter(0.0, 1.0), np.inf, "a finite number > 0"),
        problem.law,
        np.broadcast_to(np.asarray(problem.surface_velocity, dtype=float), (n, 3)),
        singular,
    )


def _check_semidefinite(problem: ImpactProblem, delassus: Array) -> bool:
    """Raise `InputError` if W of a group of coupled contacts is invalid; return whether it is singular."""
    largest = float(np.abs(delassus).max(initial=0.0))
    asymmetry = float(np.abs(delassus - delassus.T).max(initial=0.0))
    if asymmetry > ZERO * largest:
        raise InputError(
            f"delassus: W must be symmetric to {ZERO:.1e} of its largest entry {largest:.6g}, but W and its "
            f"transpose differ by {asymmetry:.6g}",
            value=problem.delassus,
        )
    delassus = 0.5 * (delassus + delassus.T)
    moves = delassus.any(axis=1)  # rows of zeros have eigenvalues that are exactly zero
    eigenvalues = np.linalg.eigvalsh(delassus[np.ix_(moves, moves)]) if moves.any() else np.zeros(1)
    least = ZERO * (len(delassus) // 3) * float(np.abs(eigenvalues).max())
    if eigenvalues[0] < -least:
        raise InputError(
            f"delassus: W must be positive semidefinite, but its smallest eigenvalue is {eigenvalues[0]:.6g}",
            value=problem.delassus,
        )
    return bool(not moves.all() or eigenvalues[0] <= least)


def _per_contact(name: str, value: Any, n: int, low: float, high: float, right: str) -> Array:
    array = real_numbers(name, value, "a number, or one for each contact,")
    if array.shape not in ((), (n,)):
        raise InputError(
            f"{name}: shape {array.shape} given, a number or ({n},), one for each contact, expected",
            value=value,
        )
    for number in np.atleast_1d(array).tolist():
        if not (low <= number <= high and np.isfinite(number)):
            raise InputError(f"{name}: {number!r} given, {right} expected", value=value)
    return np.array(np.broadcast_to(array, (n,)))


def solution_of(
    inputs: ManyInputs,
    names: tuple[str, str],
    velocity: Array,
    impulse: Array,
    works: Array,
    counts: tuple[int, int],
    segments: Callable[[], Segments] | None = None,
    notes: tuple[str, ...] = (),
    path: ManyPath | None = None,
    bounded: bool = False,
) -> ManySolution:
    """Return a `ManySolution`.

    Args:
        inputs: The problem.
        names: Names of the policy and of the law that it has used.
        velocity: (3n,) v⁺ [m/s].
        impulse: (3n,) P [N s].
        works: (n, 3) work of compression, restitution and friction [J].
        counts: Numbers of iterations and events.
        segments: As in `ManyStory`; None for no segments.
        notes: As in `ManySolution`.
        path: As in `ManySolution`.
        bounded: As in `ManyStory`.
    """
    n = len(inputs.velocity)
    if segments is None:
        segments = partial(tuple, ((),) * n)
    story = ManyStory(segments, works, inputs.surface_velocity, inputs.singular, bounded)
    return ManySolution(velocity.reshape(n, 3), impulse.reshape(n, 3), *counts, *names, story, notes, path)


def notes_on_law(inputs: ManyInputs) -> tuple[str, ...]:
    """Return a note if the chosen law is not the one that is used; the default "poisson" is not a choice."""
    if inputs.law in ("energetic", "poisson") or not inputs.restitution.any():
        return ()
    return (f"The law {inputs.law!r} is for one contact; several at once follow the energetic law.",)


def refuse(inputs: ManyInputs) -> None:
    """Raise `UnstoppableApproachError`: no impulses can stop all approaches."""
    j = int(np.argmin(inputs.velocity[:, 2]))
    raise UnstoppableApproachError(
        f"velocity: contact {inputs.place(j)} approaches at {-inputs.velocity[j, 2]:.6g} m/s and no impulses "
        f"at {counted(len(inputs.velocity), 'contact')} can stop all of them; the mechanism cannot move "
        "along the normals",
        value=inputs.velocity,
    )
