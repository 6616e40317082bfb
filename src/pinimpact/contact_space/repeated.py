"""Contacts that are listed several times: one contact with the sum of their stiffnesses. (theory.md, 14.8)"""

from __future__ import annotations

from functools import partial, wraps
from typing import Any

import numpy as np

from ..arrays import Integers
from ._kernels.tolerances import SLOW
from .inputs import Array
from .many_inputs import ManyInputs, solution_of
from .many_solution import ManyPath, ManySolution, Run, Segments
from .solution import Segment


def first_equal(inputs: ManyInputs) -> Integers:
    """Return the first contact (n,) with the same velocity, coefficients and rows of W as each contact.

    Velocities of a robot, sums of larger terms, are compared to `SLOW`.
    """
    n = len(inputs.velocity)
    close = SLOW * float(np.abs(inputs.velocity).max(initial=0.0))
    data = np.column_stack([inputs.friction, inputs.restitution, inputs.delassus.reshape(n, -1)])
    found: dict[bytes, list[int]] = {}
    first = np.arange(n)
    for j, row in enumerate(data):
        equal = found.setdefault(row.tobytes(), [])
        near = [k for k in equal if np.abs(inputs.velocity[k] - inputs.velocity[j]).max() <= close]
        if near:
            first[j] = near[0]
        else:
            equal.append(j)
    return first


def each_once(run: Run) -> Run:
    """Return a policy that solves equal contacts as one, and shares its impulse in ratio of stiffness."""

    @wraps(run)
    def run_once(inputs: ManyInputs, record: bool, **options: Any) -> ManySolution:
        first = first_equal(inputs)
        if (first == np.arange(len(first))).all():
            return run(inputs, record, **options)
        at, of = np.unique(first, return_inverse=True)
        stiffness = np.bincount(of, inputs.stiffness).astype(np.float64)
        one = run(inputs.part(at)._replace(stiffness=stiffness), record, **options)
        return _shared(inputs, one, at, of, inputs.stiffness / stiffness[of])

    return run_once


def _shared(inputs: ManyInputs, one: ManySolution, at: Integers, of: Integers, share: Array) -> ManySolution:
    """Return the solution of all contacts.

    Contact j has the part `share[j]` of contact `of[j]` of `one`, which is contact `at[of[j]]` of all.
    """
    path, apart = one.path, inputs.velocity - inputs.velocity[at[of]]
    if path is not None:
        path = ManyPath(path.clock, path.velocity[:, of] + apart, share[:, None] * path.impulse[:, of])
    found = solution_of(
        inputs,
        (one.simultaneous, one.law),
        one.velocity[of] + apart,
        share[:, None] * one.impulse[of],
        share[:, None] * one.story.works[of],
        (one.iterations, one.events),
        partial(_segments, one, of, share),
        one.notes,
        path,
        one.story.bounded,
    )
    return found.with_story(resolved=one.story.resolved)


def _segments(one: ManySolution, of: Integers, share: Array) -> Segments:
    """Return the segments of each contact, over its own P₃."""
    found = [one.segments[j] for j in of.tolist()]
    return tuple(
        tuple(Segment(s.mode, s.phase, part * s.start, part * s.end) for s in segments)
        for segments, part in zip(found, share.tolist(), strict=True)
    )
