"""The front end of the contact-space solver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, overload

import numpy as np

from ..errors import InputError
from .derivatives import check_derivatives, derivatives_of
from .many_derivatives import derivatives_of_many
from .many_inputs import many_inputs
from .many_solution import ManySolution
from .one_contact import solve_inputs
from .one_sided import check_side
from .problem import ImpactProblem, contact_inputs, single_precision_hint
from .simultaneous import solve_many
from .solution import Solution


@overload
def solve_impact(
    problem: ImpactProblem,
    method: str = ...,
    record: bool = ...,
    *,
    simultaneous: None = ...,
    derivatives: bool = ...,
    side: int | None = ...,
    **options: Any,
) -> Solution: ...


@overload
def solve_impact(
    problem: ImpactProblem,
    method: str = ...,
    record: bool = ...,
    *,
    simultaneous: str,
    derivatives: bool = ...,
    side: int | None = ...,
    **options: Any,
) -> ManySolution: ...


def solve_impact(
    problem: ImpactProblem,
    method: str = "exact",
    record: bool = False,
    *,
    simultaneous: str | None = None,
    derivatives: bool = False,
    side: int | None = None,
    **options: Any,
) -> Solution | ManySolution:
    """Solve a frictional impact.

    Args:
        problem: W, v, μ, e and the restitution law, of one contact or of n.
        method: Name of a registered method for one contact; ``"exact"`` is accurate to rounding.
        record: Whether to record the path.
        simultaneous: Policy for n contacts, by default ``"propagate"``; see `POLICIES`.
        derivatives: Whether to compute ``solution.derivatives``, of one contact by ``"exact"``. Those of n
            contacts are differences of the policy, to 1e-9, and cost some ten impacts for each number.
        side: 1 or −1: columns without derivative are those to this side where they exist,
            for a change of that sign. (docs/derivatives.md, 6)
        **options: Options of the method or policy, such as ``steps=`` of ``"euler"``.

    Returns:
        The `Solution` in contact axes; for n contacts a `ManySolution`.

    Raises:
        InputError: A value of the problem is invalid.
        UnknownNameError: Unknown law, method, policy or option.
        UnstoppableApproachError: The contact approaches and no impulse can stop it.
        LawError: The mechanism cannot satisfy the restitution law.
    """
    if not isinstance(problem, ImpactProblem):
        raise InputError(
            f"problem: {type(problem).__name__} given; an ImpactProblem is expected", value=problem
        )
    check_side(side, "" if derivatives else "impacts without derivatives=True")
    if np.ndim(problem.velocity) == 2 or simultaneous is not None:
        if np.ndim(problem.velocity) != 2:
            raise InputError(
                f"velocity: shape {np.shape(problem.velocity)} given, (n, 3) expected with simultaneous=",
                value=problem.velocity,
            )
        policy = simultaneous or "propagate"
        solved = solve_many(problem, policy, record, **options)
        if not derivatives:
            return solved
        found = derivatives_of_many(many_inputs(problem), policy, options, solved, side)
        return replace(solved, derivatives=found)
    if method != "exact":
        check_derivatives(derivatives, method)
    inputs = contact_inputs(problem)
    try:
        solution = solve_inputs(inputs, method, record, problem.surface_velocity, **options)
    except InputError as error:
        hint = single_precision_hint(problem.delassus) if error.field == "delassus" else ""
        if not hint:
            raise
        raise InputError(f"{error}{hint}", field="delassus", value=problem.delassus) from None
    if derivatives:
        solution.derivatives = derivatives_of(inputs, side)
    return solution
