"""The policies "together" and "reflect", which resolve all contacts at once. (theory.md, 14)"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._numeric.tolerances import ROUNDING
from ..errors import InputError, LawError, PinimpactError
from ._kernels.tolerances import FOUND, MISSED
from .many_inputs import ManyInputs, refuse, rows_of, solution_of
from .many_solution import ManySolution

MOST_IMPACTS = 200
"""Number of single impacts per contact after which the limit (14.8) of a sequence is taken."""


def together(inputs: ManyInputs, record: bool) -> ManySolution:
    """Solve an impact at n contacts by Poisson's law in two phases. (14.7)"""
    return solve_together(inputs)[0]


def solve_together(inputs: ManyInputs) -> tuple[ManySolution, float]:
    """Return the solution of (14.7), and the residual of Coulomb's law relative to the largest velocity."""
    from ._kernels.plastic import impulses_together

    if inputs.law != "poisson" and inputs.restitution.any():
        raise LawError(
            f'law: {inputs.law!r} given; "together" supports Poisson\'s law only, or e = 0', value=inputs.law
        )
    n = len(inputs.velocity)
    velocity = inputs.velocity.ravel()
    compression, restitution = np.zeros((2, 3 * n))
    w, mu, k = inputs.delassus, inputs.friction, inputs.stiffness
    residual = impulses_together(w, velocity, mu, np.zeros(n), k, compression)
    between = velocity + inputs.delassus @ compression
    given = inputs.restitution * np.maximum(compression[2::3], 0.0)
    if given.any():
        further = impulses_together(w, between, mu, given, k, restitution)
        residual = max(residual, further)
    after = between + inputs.delassus @ restitution
    rest = MISSED * float(np.abs(velocity).max(initial=0.0))
    if (after[2::3] < -rest).any() or not np.isfinite(after).all():
        refuse(inputs)
    works = np.zeros((n, 3))
    for start, end, impulse in ((velocity, between, compression), (between, after, restitution)):
        powers = (0.5 * (start + end) * impulse).reshape(n, 3)
        works[:, 0 if impulse is compression else 1] += powers[:, 2]
        works[:, 2] += powers[:, 0] + powers[:, 1]
    total = compression + restitution
    notes = () if residual <= FOUND else (f"Coulomb's law is met only to {residual:.1e} of the velocities.",)
    names, bounded = ("together", "poisson"), bool(notes)
    found = solution_of(inputs, names, after, total, works, (2, 2), notes=notes, bounded=bounded)
    return found, residual


def reflect(inputs: ManyInputs, record: bool) -> ManySolution:
    """Reflect the velocity until no contact approaches, and interpolate to a plastic impact by e."""
    from ._kernels.plastic import impulses_together

    if inputs.friction.any():
        raise InputError(
            f'friction: {inputs.friction.tolist()} given; "reflect" supports zero friction only',
            value=inputs.friction,
        )
    e = float(inputs.restitution.max(initial=0.0))
    if (inputs.restitution != e).any():
        raise InputError(
            f'restitution: {inputs.restitution.tolist()} given; "reflect" needs the same coefficient at all '
            "contacts",
            value=inputs.restitution,
        )
    n = len(inputs.velocity)
    start = inputs.velocity.ravel()
    rest = ROUNDING * float(np.abs(start).max(initial=0.0))
    plastic, elastic, part = np.zeros((3, 3 * n))
    none = np.zeros(n)
    impulses_together(inputs.delassus, start, none, none, inputs.stiffness, plastic)
    velocity, count = start.copy(), 0
    while (velocity[2::3] < -rest).any():
        if count >= MOST_IMPACTS * n:
            left = np.flatnonzero(velocity[2::3] < -rest).tolist()
            named = ", ".join(str(inputs.place(j)) for j in left)
            raise PinimpactError(
                f'simultaneous: after {count} reflections contacts {named} still approach; use "propagate"',
                value="reflect",
            )
        struck = np.flatnonzero(velocity[2::3] < -rest)
        rows = rows_of(struck)
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
    return solution_of(inputs, ("reflect", "newton"), after, impulse, works, (count, count))


def kernels_at_once() -> tuple[Any, ...]:
    """Return the kernels of both policies."""
    from ._kernels.plastic import impulses_together

    return (impulses_together,)
