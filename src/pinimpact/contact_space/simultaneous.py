"""Policies of `solve_impact` for several contacts at one instant, ``simultaneous=``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from .._numeric.tolerances import LITTLE, ROUNDING
from ..checks import choice
from ..errors import BoundReachedWarning
from ._kernels.tolerances import BY_STEPS, MISSED
from .at_once import MOST_IMPACTS, kernels_at_once, reflect, together
from .inputs import NO_FACTOR, Array, Inputs
from .jam_growth import from_rest
from .laws import law_code
from .many_inputs import ManyInputs, coupled_groups, many_inputs, solution_of
from .many_solution import ManySolution, Run
from .methods import check_options
from .one_contact import solve_inputs
from .problem import ImpactProblem
from .repeated import each_once, first_equal
from .solution import Segment
from .uncoupled import by_groups
from .waves import RTOL, kernels_of_waves, propagate_waves


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy for impacts at several contacts.

    Attributes:
        run: run(inputs, record, **options) -> `ManySolution`.
        kernels: Returns its kernels, without those of single impacts.
        summary: One line of description.
        options: Names of its keyword options and their defaults.
    """

    run: Run = field(repr=False)
    kernels: Callable[[], tuple[Any, ...]] = field(repr=False)
    summary: str
    options: Mapping[str, Any] = field(default_factory=dict)


def find_policy(name: str) -> Policy:
    """Return the policy of that name, or raise `UnknownNameError`."""
    return POLICIES[choice("simultaneous", name, POLICIES, "a policy")]


_compiled: set[Any] = set()


def compile_policy(name: str, *others: Any) -> None:
    """Compile or load the kernels of a policy, and other kernels with declared signatures, on first use."""
    kernels = (*others, *find_policy(name).kernels())
    if not _compiled.issuperset(kernels):
        from .._compile.jit import compile_all

        compile_all(*((kernel,) for kernel in kernels))
        _compiled.update(kernels)


def solve_many(problem: ImpactProblem, simultaneous: str, record: bool, **options: Any) -> ManySolution:
    """Solve an impact at n contacts; arguments as for `solve_impact`."""
    policy = find_policy(simultaneous)
    check_options(simultaneous, policy.options, options)
    inputs = many_inputs(problem)
    compile_policy(simultaneous)
    found = policy.run(inputs, record, **options)
    if found.story.bounded:
        warnings.warn(" ".join(found.notes), BoundReachedWarning, stacklevel=3)
    again = partial(_resolved, simultaneous, inputs, options)
    jumps = partial(_jumps, simultaneous, inputs, options, found.velocity)
    return found.with_story(again=again, jumps=jumps)


def _resolved(simultaneous: str, inputs: ManyInputs, options: Mapping[str, Any], factors: Array) -> Array:
    """Return velocities (n, 3) after the impact with stiffnesses multiplied by factors (n,)."""
    scaled = inputs._replace(stiffness=factors * inputs.stiffness)
    return find_policy(simultaneous).run(scaled, False, **options).velocity


NEARBY = (ROUNDING, MISSED, -MISSED)
"""Relative changes of the data in the test for jumps: more than rounding, less than can be measured."""

SMOOTH = 1e3
"""Largest ratio of the relative change of v⁺ to that of the data where the impact map is continuous."""


def _jumps(simultaneous: str, inputs: ManyInputs, options: Mapping[str, Any], velocity: Array) -> bool:
    """Return whether v⁺ (n, 3) jumps under small changes of the data.

    Each contact axis is scaled slightly, in v and in W. This preserves redundancy and zeros. Each group of
    coupled contacts is compared with its own largest velocity.
    """
    if len(coupled_groups(inputs.delassus)) > 1:
        return any(_jumps(simultaneous, one, options, velocity[at]) for at, one in inputs.groups())
    size = float(np.abs(inputs.velocity).max(initial=0.0))
    if size == 0.0:
        return False
    run = find_policy(simultaneous).run
    direction = np.random.default_rng(0).uniform(-1.0, 1.0, inputs.velocity.shape)[first_equal(inputs)]
    for change in NEARBY:
        scales = 1.0 + change * direction
        rows = scales.ravel()
        nearby = inputs._replace(
            delassus=rows[:, None] * inputs.delassus * rows, velocity=scales * inputs.velocity
        )
        moved = float(np.abs(run(nearby, False, **options).velocity - velocity).max())
        if moved > max(MISSED, SMOOTH * abs(change)) * size:
            return True
    return simultaneous == "propagate" and _jumps_at_zero(inputs, options, velocity, size)


SMALL = (LITTLE, 0.1 * LITTLE)
"""Coefficients of restitution that replace zero in the test for a jump at e = 0; smaller ones cause too many
events."""

NO_LIMIT = 0.3
"""Least ratio of the change of v⁺ by the smaller of these to that by the larger, where there is a jump; if
the limit e → 0 exists, the ratio is about a tenth."""


def _jumps_at_zero(inputs: ManyInputs, options: Mapping[str, Any], velocity: Array, size: float) -> bool:
    """Return whether v⁺ (n, 3) for e = 0 appears not to be the limit e → 0."""
    none, moved, by_events = inputs.restitution == 0.0, [], {**options, "accuracy": 0.0}
    if not none.any():
        return False
    for small in SMALL:
        nearby = inputs._replace(restitution=np.where(none, small, inputs.restitution), law="energetic")
        found = find_policy("propagate").run(nearby, False, **by_events)
        if found.notes:  # not integrated from event to event
            return False
        moved.append(float(np.abs(found.velocity - velocity).max()))
    return moved[1] > max(10.0 * MISSED * size, NO_LIMIT * moved[0])


LAST = 5
"""Number of the last impacts that the note on a sequence without end lists."""


def _sequence(inputs: ManyInputs, record: bool) -> ManySolution:
    return _one_by_one(inputs, "sequence", lambda rates: int(np.argmin(rates)))


def _any(inputs: ManyInputs, record: bool, seed: int = 0) -> ManySolution:
    generator = np.random.default_rng(seed)
    rest = ROUNDING * float(np.abs(inputs.velocity).max(initial=0.0))
    return _one_by_one(inputs, "any", lambda rates: int(generator.choice(np.flatnonzero(rates < -rest))))


def _one_by_one(inputs: ManyInputs, name: str, choose: Callable[[Array], int]) -> ManySolution:
    n = len(inputs.velocity)
    velocity, impulse, works = inputs.velocity.ravel().copy(), np.zeros(3 * n), np.zeros((n, 3))
    rest = ROUNDING * float(np.abs(velocity).max(initial=0.0))
    segments: list[list[Segment]] = [[] for _ in range(n)]
    law, count, iterations = law_code(inputs.law), 0, 0
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
        last = [*last[1 - LAST :], f"contact {inputs.place(j)} at {-velocity[3 * j + 2]:.3g} m/s"]
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
        limit = together(rest_of_it, False)
        velocity, impulse, works = (
            limit.velocity.ravel(),
            impulse + limit.impulse.ravel(),
            works + limit.story.works,
        )
        notes = (without_end(count, last), *limit.notes)
    parts = partial(tuple, tuple(map(tuple, segments)))
    names, counts, bounded = (name, inputs.law), (iterations, count), bool(notes)
    return solution_of(inputs, names, velocity, impulse, works, counts, parts, notes, bounded=bounded)


def without_end(count: int, last: Sequence[str]) -> str:
    """Return the note on single impacts whose limit (14.8) was taken; `last` describes the last ones."""
    return (
        f"After {count} single impacts contacts still approached, and their limit was used, a "
        f"plastic impact of all contacts. The last impacts: {', '.join(last[-LAST:])}."
    )


POLICIES: Mapping[str, Policy] = MappingProxyType(
    {
        "propagate": Policy(
            by_groups(from_rest(each_once(propagate_waves))),
            kernels_of_waves,
            "the LZB model: impulses propagate through stiff contacts on an internal clock, with "
            "the energetic law; unique, symmetric, creates no energy; depends on ratios of "
            "stiffness",
            {"exponent": 1.0, "rtol": RTOL, "accuracy": BY_STEPS},
        ),
        "sequence": Policy(
            by_groups(_sequence),
            tuple,
            "single impacts, the fastest contact first; depends on the order",
        ),
        "together": Policy(
            by_groups(together),
            kernels_at_once,
            "all contacts at once by Poisson's law, a complementarity problem in two phases; no "
            "propagation; with friction not unique, and can create energy",
        ),
        "reflect": Policy(
            by_groups(reflect),
            kernels_at_once,
            "generalized reflections, mixed with a plastic impact by e; frictionless, no propagation",
        ),
        "any": Policy(
            by_groups(_any),
            tuple,
            "single impacts in an order drawn with seed=, to see how much the order matters",
            {"seed": 0},
        ),
    }
)
"""The policies by name."""
