"""Impacts at many contacts at one instant: the policies of `solve_impact`, ``simultaneous=``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..checks import choice, finite_array, in_short, real_number, real_numbers
from ..errors import (
    BoundReachedWarning,
    InputError,
    LawError,
    PinimpactError,
    UnknownNameError,
    UnstoppableApproachError,
)
from .inputs import NO_FACTOR, Array, Inputs
from .laws import find_law
from .many_solution import ManyPath, ManySolution, ManyStory, Segments, segments_of
from .one_contact import solve_inputs
from .problem import ZERO, ImpactProblem
from .solution import Segment


class ManyInputs(NamedTuple):
    """A problem of n contacts, checked.

    Attributes:
        delassus: (3n, 3n) W.
        velocity: (n, 3).
        friction, restitution, stiffness: (n,).
        law: Name of the law.
        surface_velocity: (n, 3).
        singular: Whether W is.
    """

    delassus: Array
    velocity: Array
    friction: Array
    restitution: Array
    stiffness: Array
    law: str
    surface_velocity: Array
    singular: bool


Run = Callable[..., ManySolution]


@dataclass(frozen=True, slots=True)
class Policy:
    """A way to resolve an impact at many contacts.

    Attributes:
        run: run(inputs, record, **options) -> `ManySolution`.
        kernels: Returns the kernels that it calls beyond those of single impacts.
        summary: One line on what it is.
        options: Names of its keyword options and their defaults.
    """

    run: Run
    kernels: Callable[[], tuple[Any, ...]]
    summary: str
    options: Mapping[str, Any] = field(default_factory=dict)


def many_inputs(problem: ImpactProblem) -> ManyInputs:
    """Return the numbers of a problem of n contacts, or raise what is wrong with them.

    Raises:
        InputError: Shapes that do not fit, numbers that are not finite or out of range, an indefinite W.
        UnknownNameError: No such law.
    """
    n = np.shape(problem.velocity)[0]
    velocity = np.array(finite_array("velocity", problem.velocity, (n, 3)))
    delassus = finite_array("delassus", problem.delassus, (3 * n, 3 * n))
    largest = float(np.abs(delassus).max(initial=0.0))
    asymmetry = float(np.abs(delassus - delassus.T).max(initial=0.0))
    if asymmetry > ZERO * largest:
        raise InputError(
            f"delassus: W must be symmetric to {ZERO:.1e} of its largest entry {largest:.6g}, but W and its "
            f"transpose differ by {asymmetry:.6g}",
            field="delassus",
            value=problem.delassus,
        )
    delassus = 0.5 * (delassus + delassus.T)
    eigenvalues = np.linalg.eigvalsh(delassus) if n else np.zeros(1)
    least = ZERO * max(1, n) * float(np.abs(eigenvalues).max())
    if eigenvalues[0] < -least:
        raise InputError(
            f"delassus: W must be positive semidefinite, but its smallest eigenvalue is {eigenvalues[0]:.6g}",
            field="delassus",
            value=problem.delassus,
        )
    find_law(problem.law)
    stiffness = 1.0 if problem.stiffness is None else problem.stiffness
    return ManyInputs(
        delassus,
        velocity,
        _per_contact("friction", problem.friction, n, 0.0, np.inf, "a finite number ≥ 0"),
        _per_contact("restitution", problem.restitution, n, 0.0, 1.0, "a number from 0 to 1"),
        _per_contact("stiffness", stiffness, n, np.nextafter(0.0, 1.0), np.inf, "a finite number > 0"),
        problem.law,
        np.broadcast_to(np.asarray(problem.surface_velocity, dtype=float), (n, 3)),
        bool(eigenvalues[0] <= least),
    )


def _per_contact(name: str, value: Any, n: int, low: float, high: float, right: str) -> Array:
    array = real_numbers(name, value, "a number, or one for each contact,")
    if array.shape not in ((), (n,)):
        raise InputError(
            f"{name}: shape {array.shape} given, a number or ({n},), one for each contact, expected",
            field=name,
            value=value,
        )
    for number in np.atleast_1d(array).tolist():
        if not (low <= number <= high and np.isfinite(number)):
            raise InputError(f"{name}: {number!r} given, {right} expected", field=name, value=value)
    return np.array(np.broadcast_to(array, (n,)))


def find_policy(name: str) -> Policy:
    """Return the policy of that name, or raise `UnknownNameError`."""
    return POLICIES[choice("simultaneous", name, POLICIES, "a policy")]


_compiled: set[Any] = set()


def compile_policy(name: str, *others: Any) -> None:
    """Compile or load all kernels of a policy when they are first asked for, and others with them.

    Args:
        name: Of the policy.
        others: Kernels that tell their types ahead.
    """
    kernels = (*others, *find_policy(name).kernels())
    if not _compiled.issuperset(kernels):
        from .._compile.jit import compile_all

        compile_all(*((kernel,) for kernel in kernels))
        _compiled.update(kernels)


def solve_many(problem: ImpactProblem, simultaneous: str, record: bool, **options: Any) -> ManySolution:
    """Resolve an impact at n contacts; see `solve_impact`."""
    policy = find_policy(simultaneous)
    for name in options:
        if name not in policy.options:
            raise UnknownNameError(
                f"{name}: unknown option of {simultaneous!r}, which takes "
                f"{', '.join(policy.options) or 'no options'}",
                field=name,
                value=options[name],
            )
    inputs = many_inputs(problem)
    compile_policy(simultaneous)
    found = policy.run(inputs, record, **options)
    if found.story.bounded:
        warnings.warn(" ".join(found.notes), BoundReachedWarning, stacklevel=3)
    again = partial(_resolved, simultaneous, inputs, options)
    return replace(found, story=found.story._replace(again=again))


def _resolved(simultaneous: str, inputs: ManyInputs, options: Mapping[str, Any], factors: Array) -> Array:
    """Return velocities (n, 3) after the impact with stiffnesses multiplied by factors (n,)."""
    scaled = inputs._replace(stiffness=factors * inputs.stiffness)
    return find_policy(simultaneous).run(scaled, False, **options).velocity


# ---- propagate


MISSED = 1e-6
"""Part of velocities, impulses and works that may be missed or gained, before waves count as lost."""

MOST_STEPS = 5000
"""Steps from event to event, at most."""


def _propagate(inputs: ManyInputs, record: bool, exponent: float = 1.0, rtol: float = 1e-16) -> ManySolution:
    from ._kernels.propagation import propagate

    if real_number("exponent", exponent) not in (1.0, 1.5):
        raise InputError(
            f"exponent: {in_short(exponent)} given, 1 (linear) or 1.5 (Hertz) expected",
            field="exponent",
            value=exponent,
        )
    if not isinstance(rtol, (int, float)) or not 1e-17 <= rtol <= 0.1:
        raise InputError(
            f"rtol: {in_short(rtol)} given, a number from 1e-17 to 0.1 expected", field="rtol", value=rtol
        )
    n = len(inputs.velocity)
    velocity, impulse, works = np.empty(3 * n), np.empty(3 * n), np.empty((n, 3))
    rows = np.empty((64 * n + 64, 5))
    path = np.empty((2048, 6 * n + 1)) if record else np.empty((0, 6 * n + 1))
    while True:
        counts = np.zeros(5, dtype=np.int64)
        stopped, missed = propagate(
            *(inputs.delassus, inputs.velocity.ravel(), inputs.friction, inputs.restitution),
            *(inputs.stiffness, float(exponent), float(rtol), MOST_STEPS),
            *(velocity, impulse, works, counts, rows, path),
        )
        steps, events, used, points, ended = counts.tolist()
        if used >= len(rows):
            rows = np.empty((4 * len(rows), 5))
        elif record and points >= len(path):
            path = np.empty((4 * len(path), 6 * n + 1))
        else:
            break
    if ended == 2 or not (stopped and missed <= max(MISSED, 100.0 * rtol)):
        return _propagate_in_steps(inputs, exponent, record) or _propagate_plastically(inputs)
    notes = _of_law(inputs)
    story = None
    if record:
        story = ManyPath(
            path[:points, 0].copy(),
            path[:points, 1 : 3 * n + 1].reshape(-1, n, 3),
            path[:points, 3 * n + 1 :].reshape(-1, n, 3),
        )
    segments = partial(segments_of, rows[:used].copy(), n)
    names = "propagate", "energetic"
    return _answer(inputs, names, velocity, impulse, works, (steps, events), segments, notes, story)


def _propagate_plastically(inputs: ManyInputs) -> ManySolution:
    """Stop all approaches, and restore nothing."""
    plastic, off = _all_at_once(inputs._replace(restitution=np.zeros(len(inputs.velocity))))
    if off > MISSED:  # an approach that only impulses beyond their cones stop
        _refuse(inputs)
    text = "The propagation was not resolved to the usual accuracy; the impact is taken as plastic."
    return replace(
        plastic,
        simultaneous="propagate",
        law="energetic",
        notes=(*plastic.notes, text),
        story=plastic.story._replace(bounded=True),
    )


STEP_ACCURACY, FINEST = 1e-10, 1e-13
"""Part of the largest velocity that a step may miss at first, and at least."""

MOST_SHORT_STEPS = 20_000
"""Steps that a pass may take."""

AGREE, USEFUL = 1e-7, 1e-3
"""Part of the largest velocity to which two passes agree at the end; beyond it they say nothing."""

FIRST_RESTITUTION, MOST_RESTITUTIONS = 4e-3, 3
"""The first of those that are halved to extrapolate to e = 0 in steps, and their number at most."""


def _propagate_in_steps(inputs: ManyInputs, exponent: float, record: bool) -> ManySolution | None:
    """Follow waves by adaptive steps; None where they do not come to an end."""
    n = len(inputs.velocity)
    plastic = (inputs.restitution == 0.0) & (np.diag(inputs.delassus)[2::3] > 0.0)
    missed, steps, accuracy = np.inf, 0, STEP_ACCURACY
    row: list[Array] = []
    for k in range(MOST_RESTITUTIONS if plastic.any() else 1):
        least = inputs._replace(restitution=np.where(plastic, 0.5**k * FIRST_RESTITUTION, inputs.restitution))
        found = _passes(least, exponent)
        if found is None:
            break
        last, row, steps, accuracy = row, [found[0]], steps + found[2], found[3]
        for m, before in enumerate(last):  # without the term of order m + 1 in e
            row.append(row[m] + (row[m] - before) / (2.0 ** (m + 1) - 1.0))
        missed = max(found[1], _differ(inputs, row[-1], last[-1]) if last else 0.0)
        if last and missed <= AGREE:
            break
    if not row or not missed <= USEFUL:
        return None
    numbers = row[-1]
    impulse = numbers[: 3 * n].reshape(n, 3)
    impulse[:, 2] = np.maximum(impulse[:, 2], 0.0)
    tangential = np.hypot(impulse[:, 0], impulse[:, 1])
    most = inputs.friction * impulse[:, 2]
    impulse[:, :2] *= np.where(tangential > most, most / np.maximum(tangential, 1e-300), 1.0)[:, None]
    velocity = inputs.velocity.ravel() + inputs.delassus @ impulse.ravel()
    works = numbers[3 * n :].reshape(n, 3)
    text = (
        "The impact has many events in short succession and was integrated by adaptive steps, "
        f"with velocities to about {missed:.1e} of the largest."
    )
    story = None
    if record:
        path = np.empty((MOST_SHORT_STEPS + 1, 3 * n + 1))
        points = _pass(least, exponent, accuracy, path)[0]
        path[points] = np.concatenate([path[points - 1, :1], impulse.ravel()])
        clock, impulses = path[: points + 1, 0].copy(), path[: points + 1, 1:]
        velocities = inputs.velocity.ravel() + impulses @ inputs.delassus
        story = ManyPath(clock, velocities.reshape(-1, n, 3), impulses.reshape(-1, n, 3))
    return _answer(
        *(inputs, ("propagate", "energetic"), velocity, impulse.ravel(), works, (steps, 0)),
        notes=(*_of_law(inputs), text),
        path=story,
        bounded=missed > MISSED,
    )


def _passes(inputs: ManyInputs, exponent: float) -> tuple[Array, float, int, float] | None:
    """Step through an impact with more and more accuracy, until two passes agree or agree no better.

    Returns:
        Impulses and works (6n,), by how much velocities differ from those of the pass before it, the number
        of all steps, and the accuracy of the last pass; None where passes do not agree.
    """
    accuracy, total, missed = STEP_ACCURACY, 0, np.inf
    best: Array | None = None
    for finer in (STEP_ACCURACY * 0.1**k for k in range(round(np.log10(STEP_ACCURACY / FINEST)) + 1)):
        steps, numbers = _pass(inputs, exponent, finer, np.empty((0, 3 * len(inputs.velocity) + 1)))
        if steps == 0:
            break
        before = missed
        if best is not None:
            missed = _differ(inputs, numbers, best)
        best, total, accuracy = numbers, total + steps, finer
        if missed <= AGREE or missed > 0.5 * before:  # finer steps would not agree better
            break
    return None if best is None or not missed <= USEFUL else (best, missed, total, accuracy)


def _pass(inputs: ManyInputs, exponent: float, accuracy: float, path: Array) -> tuple[int, Array]:
    """Return the number of steps through an impact, 0 for too many, and its impulses and works (6n,)."""
    from ._kernels.propagation_steps import step_through

    n = len(inputs.velocity)
    size = float(np.abs(inputs.velocity).max())
    scaled = inputs.stiffness / np.max(inputs.stiffness * np.diag(inputs.delassus)[2::3])
    eigenvalues, vectors = np.linalg.eigh(inputs.delassus)
    kept = eigenvalues > ZERO * n * eigenvalues[-1]
    rows = np.ascontiguousarray(vectors[:, kept] * np.sqrt(eigenvalues[kept]))
    impulse, works = np.empty(3 * n), np.empty((n, 3))
    steps = step_through(
        *(rows, inputs.velocity.ravel() / size, inputs.friction, inputs.restitution, scaled),
        *(float(exponent), accuracy, MOST_SHORT_STEPS, impulse, works, path),
    )
    path[:steps, 1:] *= size
    return steps, np.concatenate([impulse * size, works.ravel() * size * size])


def _differ(inputs: ManyInputs, one: Array, other: Array) -> float:
    """Return by how much two impulses (3n,), first in what is given, differ in velocities, of the largest."""
    rows = 3 * len(inputs.velocity)
    change = inputs.delassus @ (one[:rows] - other[:rows])
    return float(np.abs(change).max() / np.abs(inputs.velocity).max())


LAST = 5
"""Impacts that are named where their number has come to its bound."""


def _answer(
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
    """Return the solution that numbers make up.

    Args:
        inputs: The problem.
        names: Of the policy, and of the law that it has used.
        velocity: (3n,) after the impact.
        impulse: (3n,).
        works: (n, 3) of compression, restitution and friction.
        counts: Of iterations and events.
        segments: Makes those of each contact; None where there is no path.
        notes: What a reader should know.
        path: The recorded path.
        bounded: Whether a bound on steps or events was reached.
    """
    n = len(inputs.velocity)
    if segments is None:
        segments = partial(tuple, ((),) * n)
    story = ManyStory(segments, works, inputs.surface_velocity, inputs.singular, bounded)
    return ManySolution(velocity.reshape(n, 3), impulse.reshape(n, 3), *counts, *names, story, notes, path)


def _of_law(inputs: ManyInputs) -> tuple[str, ...]:
    """Tell where another law than the one asked for is used."""
    if inputs.law == "energetic" or not inputs.restitution.any():
        return ()
    return (
        (
            f"The energetic law is used: {inputs.law!r} does not define how impulses propagate between "
            "contacts."
        ),
    )


def _refuse(inputs: ManyInputs) -> None:
    j = int(np.argmin(inputs.velocity[:, 2]))
    raise UnstoppableApproachError(
        f"velocity: contact {j} approaches at {-inputs.velocity[j, 2]:.6g} m/s and no impulses at "
        f"the {len(inputs.velocity)} contacts can stop all of them; the mechanism cannot move "
        "along the normals",
        field="velocity",
        value=inputs.velocity,
    )


# ---- one after another


MOST_IMPACTS = 200
"""Single impacts per contact after which the limit of what goes on without end is taken."""

RESTS = 1e-12
"""Part of the largest velocity below which an approach is none, in a sequence."""


def _sequence(inputs: ManyInputs, record: bool) -> ManySolution:
    return _one_by_one(inputs, "sequence", lambda rates: int(np.argmin(rates)))


def _any(inputs: ManyInputs, record: bool, seed: int = 0) -> ManySolution:
    generator = np.random.default_rng(seed)
    rest = RESTS * float(np.abs(inputs.velocity).max(initial=0.0))
    return _one_by_one(inputs, "any", lambda rates: int(generator.choice(np.flatnonzero(rates < -rest))))


def _one_by_one(inputs: ManyInputs, name: str, choose: Callable[[Array], int]) -> ManySolution:
    n = len(inputs.velocity)
    velocity, impulse, works = inputs.velocity.ravel().copy(), np.zeros(3 * n), np.zeros((n, 3))
    rest = RESTS * float(np.abs(velocity).max(initial=0.0))
    segments: list[list[Segment]] = [[] for _ in range(n)]
    law, count, iterations = find_law(inputs.law).code, 0, 0
    last: list[str] = []
    while count < MOST_IMPACTS * n and (velocity[2::3] < -rest).any():
        j = choose(velocity[2::3])
        rows = slice(3 * j, 3 * j + 3)
        w = inputs.delassus[rows, rows]
        upper = w[np.triu_indices(3)].tolist()
        numbers: Inputs = (
            *upper,
            *velocity[rows].tolist(),
            float(inputs.friction[j]),
            float(inputs.restitution[j]),
            law,
            0.0,
            NO_FACTOR,
        )
        one = solve_inputs(numbers)
        last = [*last[1 - LAST :], f"contact {j} at {-velocity[3 * j + 2]:.3g} m/s"]
        start = float(impulse[3 * j + 2])
        segments[j] += [Segment(s.mode, s.phase, start + s.start, start + s.end) for s in one.segments]
        works[j] += one.work.compression, one.work.restitution, one.work.friction
        impulse[rows] += one.impulse
        velocity += inputs.delassus[:, rows] @ one.impulse
        velocity[3 * j + 2] = one.velocity[2]
        count += 1
        iterations += one.iterations
    notes: tuple[str, ...] = ()
    if (velocity[2::3] < -rest).any():
        rest_of_it = inputs._replace(velocity=velocity.reshape(n, 3), restitution=np.zeros(n))
        limit = _together(rest_of_it, False)
        velocity, impulse, works = (
            limit.velocity.ravel(),
            impulse + limit.impulse.ravel(),
            works + limit.story.works,
        )
        notes = (without_end(count, last), *limit.notes)
    parts = partial(tuple, tuple(map(tuple, segments)))
    names, counts, bounded = (name, inputs.law), (iterations, count), bool(notes)
    return _answer(inputs, names, velocity, impulse, works, counts, parts, notes, bounded=bounded)


def without_end(count: int, last: Sequence[str]) -> str:
    """Tell of single impacts whose limit has been taken, the last few of them named. (14.8)"""
    return (
        f"After {count} single impacts contacts still approached, and their limit was used, a "
        f"plastic impact of all contacts. The last impacts: {', '.join(last[-LAST:])}."
    )


# ---- all at once


def _together(inputs: ManyInputs, record: bool) -> ManySolution:
    return _all_at_once(inputs)[0]


def _all_at_once(inputs: ManyInputs) -> tuple[ManySolution, float]:
    """Return the solution of (14.7), and by what part of the velocities it misses Coulomb's law."""
    from ._kernels.plastic import impulses_together

    if inputs.law != "poisson" and inputs.restitution.any():
        raise LawError(
            f'law: {inputs.law!r} given, but "together" has only Poisson\'s law (or e = 0)',
            field="law",
            value=inputs.law,
        )
    n = len(inputs.velocity)
    velocity = inputs.velocity.ravel()
    compression, restitution = np.zeros((2, 3 * n))
    w, mu, k = inputs.delassus, inputs.friction, inputs.stiffness
    missed = impulses_together(w, velocity, mu, np.zeros(n), k, compression)
    between = velocity + inputs.delassus @ compression
    given = inputs.restitution * np.maximum(compression[2::3], 0.0)
    if given.any():
        further = impulses_together(w, between, mu, given, k, restitution)
        missed = max(missed, further)
    after = between + inputs.delassus @ restitution
    rest = 1e-6 * float(np.abs(velocity).max(initial=0.0))
    if (after[2::3] < -rest).any() or not np.isfinite(after).all():
        _refuse(inputs)
    works = np.zeros((n, 3))
    for start, end, impulse in ((velocity, between, compression), (between, after, restitution)):
        powers = (0.5 * (start + end) * impulse).reshape(n, 3)
        works[:, 0 if impulse is compression else 1] += powers[:, 2]
        works[:, 2] += powers[:, 0] + powers[:, 1]
    total = compression + restitution
    notes = () if missed <= 1e-9 else (f"Coulomb's law is met only to {missed:.1e} of the velocities.",)
    names, bounded = ("together", "poisson"), bool(notes)
    found = _answer(inputs, names, after, total, works, (2, 2), notes=notes, bounded=bounded)
    return found, missed


def _reflect(inputs: ManyInputs, record: bool) -> ManySolution:
    from ._kernels.plastic import impulses_together

    if inputs.friction.any():
        raise InputError(
            'friction: "reflect" is frictionless; all coefficients must be 0',
            field="friction",
            value=inputs.friction,
        )
    e = float(inputs.restitution.max(initial=0.0))
    if (inputs.restitution != e).any():
        raise InputError(
            'restitution: "reflect" takes one coefficient for all contacts',
            field="restitution",
            value=inputs.restitution,
        )
    n = len(inputs.velocity)
    start = inputs.velocity.ravel()
    rest = RESTS * float(np.abs(start).max(initial=0.0))
    plastic, elastic, part = np.zeros((3, 3 * n))
    none = np.zeros(n)
    impulses_together(inputs.delassus, start, none, none, inputs.stiffness, plastic)
    velocity, count = start.copy(), 0
    while (velocity[2::3] < -rest).any():
        if count >= MOST_IMPACTS * n:
            named = ", ".join(map(str, np.flatnonzero(velocity[2::3] < -rest).tolist()))
            raise PinimpactError(
                f'simultaneous: after {count} reflections contacts {named} still approach; use "propagate"',
                field="simultaneous",
                value="reflect",
            )
        struck = np.flatnonzero(velocity[2::3] < -rest)
        rows = (3 * struck[:, None] + np.arange(3)).ravel()
        found = np.zeros(len(rows))
        block = np.ascontiguousarray(inputs.delassus[np.ix_(rows, rows)])
        none = np.zeros(len(struck))
        impulses_together(block, velocity[rows], none, none, inputs.stiffness[struck], found)
        part[:] = 0.0
        part[rows] = 2.0 * found
        elastic += part
        velocity = velocity + inputs.delassus @ part
        count += 1
    impulse = (1.0 - e) * plastic + e * elastic
    after = start + inputs.delassus @ impulse
    powers = (0.5 * (start + after) * impulse).reshape(n, 3)
    works = np.zeros((n, 3))
    works[:, 0] = powers[:, 2]
    return _answer(inputs, ("reflect", "newton"), after, impulse, works, (count, count))


def _kernels_at_once() -> tuple[Any, ...]:
    from ._kernels.plastic import impulses_together

    return (impulses_together,)


def _kernels_of_waves() -> tuple[Any, ...]:
    from ._kernels.propagation import propagate
    from ._kernels.propagation_steps import step_through

    return propagate, step_through, *_kernels_at_once()


POLICIES: Mapping[str, Policy] = MappingProxyType(
    {
        "propagate": Policy(
            _propagate,
            _kernels_of_waves,
            "the LZB model: impulses propagate through stiff contacts on an internal clock, with "
            "the energetic law; unique, symmetric, creates no energy; depends on ratios of "
            "stiffness",
            {"exponent": 1.0, "rtol": 1e-16},
        ),
        "sequence": Policy(
            _sequence, tuple, "single impacts, the fastest contact first; depends on the order"
        ),
        "together": Policy(
            _together,
            _kernels_at_once,
            "all contacts at once by Poisson's law, a complementarity problem in two phases; no "
            "propagation; with friction not unique, and can create energy",
        ),
        "reflect": Policy(
            _reflect,
            _kernels_at_once,
            "generalized reflections, mixed with a plastic impact by e; frictionless, no propagation",
        ),
        "any": Policy(
            _any,
            tuple,
            "single impacts in an order drawn with seed=, to see how much the order matters",
            {"seed": 0},
        ),
    }
)
"""The policies by name."""
