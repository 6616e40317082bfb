"""The policy "propagate": the LZB model, event-driven or, for very many events, by steps. (theory.md, 14)"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .._numeric.tolerances import LITTLE, TINY
from ..checks import in_short, real_number
from ..errors import InputError, IrregularMotionError
from ._kernels.tolerances import AGREE, BY_STEPS, FINEST, MISSED
from .at_once import solve_together
from .inputs import Array
from .many_inputs import ManyInputs, notes_on_law, refuse, solution_of
from .many_solution import ManyPath, ManySolution, segments_of
from .methods import checked_rtol
from .problem import ZERO

RTOL, LEAST_RTOL = 1e-16, 1e-17
"""Relative tolerance of the series of a step: the default, and the smallest."""

MOST_STEPS = 1000
"""Largest number of steps between two events, and of those per contact within which the fastest approach has
to halve. As long as it does, adaptive steps through the impact take longer. The number of those grows with
the inverse fourth root of their tolerance."""

COARSEST = 0.1 * LITTLE
"""Largest tolerance of adaptive steps."""


def propagate_waves(
    inputs: ManyInputs,
    record: bool,
    exponent: float = 1.0,
    rtol: float = RTOL,
    accuracy: float = BY_STEPS,
    most: int | None = None,
) -> ManySolution:
    """Solve an impact at n contacts by the LZB model, with F ∝ δ^exponent and series to a tolerance `rtol`.

    If there are too many events, the impact is integrated by adaptive steps with a tolerance `accuracy` of
    velocities relative to the largest, or taken as plastic if `accuracy` is zero or this fails. With `most`,
    the largest number of steps between two events (see `MOST_STEPS`), an `IrregularMotionError` is raised
    instead.
    """
    from ._kernels.propagation import propagate

    if real_number("exponent", exponent) not in (1.0, 1.5):
        raise InputError(
            f"exponent: {in_short(exponent)} given, 1 (linear) or 1.5 (Hertz) expected", value=exponent
        )
    rtol = checked_rtol(rtol, LEAST_RTOL)
    if not 0.0 <= real_number("accuracy", accuracy) <= COARSEST:
        raise InputError(f"accuracy: {in_short(accuracy)} given, 0 to {COARSEST:g} expected", value=accuracy)
    largest = round(MOST_STEPS * (BY_STEPS / max(accuracy, BY_STEPS)) ** 0.25) if most is None else most
    n = len(inputs.velocity)
    velocity, impulse, works = np.empty(3 * n), np.empty(3 * n), np.empty((n, 3))
    rows = np.empty((64 * n + 64, 5))
    path = np.empty((2048, 6 * n + 1)) if record else np.empty((0, 6 * n + 1))
    while True:
        counts = np.zeros(5, dtype=np.int64)
        stopped, residual = propagate(
            *(inputs.delassus, inputs.velocity.ravel(), inputs.friction, inputs.restitution),
            *(inputs.stiffness, float(exponent), float(rtol), largest),
            *(velocity, impulse, works, counts, rows, path),
        )
        steps, events, used, points, ended = counts.tolist()
        if used >= len(rows):
            rows = np.empty((16 * len(rows), 5))
        elif record and points >= len(path):
            path = np.empty((4 * len(path), 6 * n + 1))
        else:
            break
    if ended == 2 or not (stopped and residual <= max(MISSED, 100.0 * rtol)):
        if most is not None:
            raise IrregularMotionError("The impact has many events in short succession.")
        stepped = _propagate_in_steps(inputs, exponent, record, accuracy) if accuracy > 0.0 else None
        return stepped or _propagate_plastically(inputs)
    notes = notes_on_law(inputs)
    story = None
    if record:
        story = ManyPath(
            path[:points, 0].copy(),
            path[:points, 1 : 3 * n + 1].reshape(-1, n, 3),
            path[:points, 3 * n + 1 :].reshape(-1, n, 3),
        )
    segments = partial(segments_of, rows[:used].copy(), n)
    names = "propagate", "energetic"
    return solution_of(inputs, names, velocity, impulse, works, (steps, events), segments, notes, story)


def _propagate_plastically(inputs: ManyInputs) -> ManySolution:
    """Return the plastic impact, as a replacement of a propagation that failed."""
    plastic, residual = solve_together(inputs._replace(restitution=np.zeros(len(inputs.velocity))))
    if residual > MISSED:  # only impulses outside the friction cones stop the approach
        refuse(inputs)
    text = "The propagation was not resolved to the usual accuracy; the impact is taken as plastic."
    return replace(
        plastic,
        simultaneous="propagate",
        law="energetic",
        notes=(*plastic.notes, text),
        story=plastic.story._replace(bounded=True, resolved=False),
    )


FIRST, TENFOLD = 20.0, 10.0
"""The required accuracy over the tolerance of a step in the first pass, and the ratio of tolerances of
successive passes. The error is proportional to the tolerance, so the second pass has a ninth of the
difference of the two. One in fifty impacts needs a third pass."""

MOST_SHORT_STEPS = 20_000
"""Largest number of steps of a pass, about 0.3 s."""

SPENT = 50_000
"""Number of steps after which the extrapolation to e = 0 ends, once it has three coefficients of restitution,
the least for which two extrapolations can be compared."""

MOST_RESTITUTIONS = 8
"""Largest number of coefficients of restitution, `LITTLE` and its halves, that are extrapolated to e = 0."""


def _propagate_in_steps(
    inputs: ManyInputs, exponent: float, record: bool, asked: float
) -> ManySolution | None:
    """Integrate an impact by adaptive steps to the accuracy `asked`; return None if this fails."""
    if not np.diag(inputs.delassus)[2::3].any():  # no impulse changes a normal velocity
        return None
    n = len(inputs.velocity)
    plastic = (inputs.restitution == 0.0) & (np.diag(inputs.delassus)[2::3] > 0.0)
    by_steps, steps, accuracy, rows = np.inf, 0, asked / FIRST, _rows_of(inputs.delassus)
    error = math.inf
    numbers: Array | None = None
    last: Array | None = None
    for k in range(MOST_RESTITUTIONS if plastic.any() else 1):
        little = inputs._replace(restitution=np.where(plastic, 0.5**k * LITTLE, inputs.restitution))
        found = _passes(little, exponent, rows, asked, accuracy, by_steps)
        if found is None:
            break
        before = numbers
        numbers = found[0] if last is None else 2.0 * found[0] - last  # extrapolated, without the term in e
        last, by_steps, steps, accuracy, least = found[0], found[1], steps + found[2], found[3], little
        if not plastic.any():
            error = by_steps
        if before is not None:  # compare two extrapolations
            change = max(_differ(inputs, numbers, before), _approach_left(inputs, numbers))
            error = max(by_steps, change)
            if k > 1 and (change <= max(by_steps, AGREE, asked) or steps > SPENT):
                break
    if numbers is None:
        return None
    impulse = _within_cones(inputs, numbers)
    error = max(error, _differ(inputs, impulse.ravel(), numbers), _approach_left(inputs, impulse.ravel()))
    if not error <= LITTLE:
        return None
    velocity = inputs.velocity.ravel() + inputs.delassus @ impulse.ravel()
    works = numbers[3 * n :].reshape(n, 3)
    text = (
        "The impact has many events in short succession and was integrated by adaptive steps, "
        f"with velocities to about {error:.1e} of the largest."
    )
    story = None
    if record:
        path = np.empty((MOST_SHORT_STEPS + 1, 3 * n + 1))
        points = _pass(least, exponent, rows, accuracy, path)[0]
        path[points] = np.concatenate([path[points - 1, :1], impulse.ravel()])
        clock, impulses = path[: points + 1, 0].copy(), path[: points + 1, 1:]
        velocities = inputs.velocity.ravel() + impulses @ inputs.delassus
        story = ManyPath(clock, velocities.reshape(-1, n, 3), impulses.reshape(-1, n, 3))
    return solution_of(
        *(inputs, ("propagate", "energetic"), velocity, impulse.ravel(), works, (steps, 0)),
        notes=(*notes_on_law(inputs), text),
        path=story,
        bounded=error > max(MISSED, TENFOLD * asked),
    )


def _within_cones(inputs: ManyInputs, numbers: Array) -> Array:
    """Return the impulses (n, 3) at the start of `numbers`, projected onto the friction cones."""
    impulse = numbers[: inputs.velocity.size].reshape(-1, 3).copy()
    impulse[:, 2] = np.maximum(impulse[:, 2], 0.0)
    tangential = np.hypot(impulse[:, 0], impulse[:, 1])
    most = inputs.friction * impulse[:, 2]
    impulse[:, :2] *= np.where(tangential > most, most / np.maximum(tangential, TINY), 1.0)[:, None]
    return impulse


def _passes(
    inputs: ManyInputs, exponent: float, rows: Array, asked: float, accuracy: float, difference: float
) -> tuple[Array, float, int, float] | None:
    """Integrate an impact with decreasing tolerances until two passes agree.

    Args:
        inputs: The impact.
        exponent: η.
        rows: (3n, r) J with W = J Jᵀ.
        asked: Required accuracy, relative to the largest velocity.
        accuracy: Tolerance of a step in the first pass; is increased if there are too many steps.
        difference: Difference to the previous pass for a nearly equal impact; one pass then suffices. Else
            inf.

    Returns:
        Impulses and work (6n,), the difference of velocities from those of the previous pass, the number of
        all steps, and the tolerance; None if passes differ by more than `LITTLE`.
    """
    no_path = np.empty((0, 3 * len(inputs.velocity) + 1))
    steps, best = _pass(inputs, exponent, rows, accuracy, no_path)
    if steps > 0 and difference < np.inf:
        return best, difference, steps, accuracy
    finer, total, difference = steps > 0, steps or MOST_SHORT_STEPS, np.inf
    while steps == 0 and accuracy < max(AGREE, asked):
        accuracy *= TENFOLD
        steps, best = _pass(inputs, exponent, rows, accuracy, no_path)
        total += steps or MOST_SHORT_STEPS
    if steps == 0:
        return None
    while finer and difference > TENFOLD * asked and accuracy > FINEST:
        steps, other = _pass(inputs, exponent, rows, accuracy / TENFOLD, no_path)
        total += steps or MOST_SHORT_STEPS
        if steps == 0:
            break
        best, difference, accuracy = other, _differ(inputs, best, other), accuracy / TENFOLD
    if difference == np.inf:
        steps, other = _pass(inputs, exponent, rows, TENFOLD * accuracy, no_path)
        total, difference = total + steps, _differ(inputs, best, other) if steps > 0 else np.inf
    return (best, difference, total, accuracy) if difference <= LITTLE else None


def _pass(
    inputs: ManyInputs, exponent: float, rows: Array, accuracy: float, path: Array
) -> tuple[int, Array]:
    """Return the number of steps of an impact, 0 for too many, and its impulses and work (6n,)."""
    from ._kernels.propagation_steps import step_through

    n = len(inputs.velocity)
    size, mobility = float(np.abs(inputs.velocity).max()), np.diag(inputs.delassus)
    length = 2.0 ** round(0.5 * math.log2(mobility.max()))  # of the largest row; a power of two is exact
    mass = 1.0 / length**2
    scaled = inputs.stiffness / np.max(inputs.stiffness * mobility[2::3] * mass)
    impulse, works = np.empty(3 * n), np.empty((n, 3))
    steps = step_through(
        *(rows / length, inputs.velocity.ravel() / size, inputs.friction, inputs.restitution, scaled),
        *(float(exponent), accuracy, MOST_SHORT_STEPS, impulse, works, path),
    )
    path[:steps, 1:] *= mass * size
    return steps, mass * size * np.concatenate([impulse, works.ravel() * size])


def _rows_of(delassus: Array) -> Array:
    """Return J (3n, r) of full rank with W = J Jᵀ."""
    eigenvalues, vectors = np.linalg.eigh(delassus)
    kept = eigenvalues > ZERO * len(delassus) / 3 * eigenvalues[-1]
    return np.ascontiguousarray(vectors[:, kept] * np.sqrt(eigenvalues[kept]))


def _differ(inputs: ManyInputs, one: Array, other: Array) -> float:
    """Return the largest difference of velocities by the impulses (3n,) at the start of two arrays.

    It is relative to the largest velocity.
    """
    rows = 3 * len(inputs.velocity)
    change = inputs.delassus @ (one[:rows] - other[:rows])
    return float(np.abs(change).max() / np.abs(inputs.velocity).max())


def _approach_left(inputs: ManyInputs, impulse: Array) -> float:
    """Return the largest speed of approach after the impulses (3n,) at the start of an array.

    It is relative to the largest velocity, and a lower bound of the error of an extrapolation.
    """
    start = inputs.velocity.ravel()
    after = start + inputs.delassus @ impulse[: len(start)]
    return float(max(-after[2::3].min(), 0.0) / np.abs(start).max())


def kernels_of_waves() -> tuple[Any, ...]:
    """Return the kernels of the policy."""
    from ._kernels.plastic import impulses_together
    from ._kernels.propagation import propagate
    from ._kernels.propagation_steps import step_through

    return propagate, step_through, impulses_together
