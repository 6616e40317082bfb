"""The front end of the contact-space solver."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ..checks import float_array
from ..errors import InputError, LawError, PinimpactError, UnknownNameError, UnstoppableApproachError
from ..status import LAWS, Status
from .methods import METHODS, Run
from .problem import ImpactProblem, law_code
from .solution import Array, Inputs, Path, Solution

ZERO = 32.0 * 2.0**-52
"""Asymmetry of W, relative to its largest entry, that counts as rounding; as for its eigenvalues."""

TRACE_ROWS = 32

_loaded: dict[str, Run] = {}
_EMPTY = np.empty((0, 6))


def _run(name: str) -> Run:
    run = _loaded.get(name)
    if run is None:
        method = METHODS.get(name)
        if method is None:
            raise UnknownNameError(
                f"method: {name!r} is not registered; the methods are {', '.join(map(repr, METHODS))}",
                field="method",
                value=name,
            )
        run = _loaded[name] = method.load()
    return run


def delassus_upper(delassus: Any) -> tuple[float, float, float, float, float, float]:
    """Return the upper triangle of a (3, 3) W, row by row; refuse a W that is not symmetric."""
    rows = float_array("delassus", delassus, (3, 3)).tolist()
    (w11, w12, w13), (w21, w22, w23), (w31, w32, w33) = rows
    if not (w12 == w21 and w13 == w31 and w23 == w32):
        asymmetry = max(abs(w12 - w21), abs(w13 - w31), abs(w23 - w32))
        largest = max(abs(x) for row in rows for x in row)
        if asymmetry > ZERO * largest:  # NaN is left to the solver's own checks
            raise InputError(
                f"delassus: W must be symmetric to {ZERO:.1e} of its largest entry {largest:.6g}, "
                f"but W and its transpose differ by {asymmetry:.6g}",
                field="delassus",
                value=delassus,
            )
        w12, w13, w23 = 0.5 * (w12 + w21), 0.5 * (w13 + w31), 0.5 * (w23 + w32)
    return w11, w12, w13, w22, w23, w33


def raise_for_status(raw: tuple[Any, ...], inputs: Inputs) -> None:
    """Raise the error that a failed solve stands for, naming the offending field and value."""
    status = Status(raw[0])
    figure = raw[10]
    v3, mu, e = inputs[8], inputs[9], inputs[10]
    if status == Status.INVALID_NUMBERS:
        for name, values in (("delassus", inputs[:6]), ("velocity", inputs[6:9])):
            if not np.isfinite(values).all():
                raise InputError(
                    f"{name}: {values} holds numbers that are not finite", field=name, value=values
                )
        if not (0.0 <= mu < float("inf")):
            raise InputError(
                f"friction: {mu!r} given, a finite number ≥ 0 expected", field="friction", value=mu
            )
        raise InputError(
            f"restitution: {e!r} given, a number from 0 to 1 expected", field="restitution", value=e
        )
    if status == Status.INDEFINITE_DELASSUS:
        norm = float(
            np.linalg.norm(
                [
                    [inputs[0], inputs[1], inputs[2]],
                    [inputs[1], inputs[3], inputs[4]],
                    [inputs[2], inputs[4], inputs[5]],
                ],
                2,
            )
        )
        raise InputError(
            f"delassus: W must be positive semidefinite, but its smallest eigenvalue is {figure:.6g}, "
            f"below −{ZERO * norm:.3g} (32 ε ‖W‖)",
            field="delassus",
            value=inputs[:6],
        )
    if status == Status.UNSTOPPABLE:
        raise UnstoppableApproachError(
            f"velocity: the contact approaches at {v3:.6g} m/s and no normal impulse can stop it: "
            f"v₃ stays at {figure:.6g} m/s (c = hᵀM⁻¹h = {inputs[5]:.6g}). The mechanism cannot yield along "
            "the normal; choose another contact frame, free a joint, or a velocity that it can produce",
            field="velocity",
            value=v3,
        )
    if status == Status.LAW_UNREACHABLE:
        raise LawError(
            f"law: {LAWS[inputs[11]]!r} with e = {e:.6g} cannot be met: v₃ tends to a limit short of it "
            f'({figure:.6g} missing); use "poisson", or a smaller restitution',
            field="law",
            value=LAWS[inputs[11]],
        )
    if status == Status.OUT_OF_RANGE:
        raise InputError(
            "delassus, velocity: the answer lies beyond what double precision holds; choose other units",
            field="delassus",
            value=inputs[:9],
        )
    raise PinimpactError(f"{status} Please report this problem: {inputs}")


def solve_inputs(
    inputs: Inputs,
    method: str = "exact",
    record: bool = False,
    surface_velocity: Any = (0.0, 0.0, 0.0),
    **options: Any,
) -> Solution:
    """Solve the problem given by its twelve numbers; otherwise as `solve_impact`."""
    run = _run(method)
    if options:
        known = METHODS[method].options
        for name in options:
            if name not in known:
                raise UnknownNameError(
                    f"{name}: method {method!r} has no such option; it has {', '.join(known) or 'none'}",
                    field=name,
                    value=options[name],
                )
        run = partial(run, **options)
    raw = run(inputs, _EMPTY, _EMPTY)
    if raw[0] > Status.LOCKED:
        raise_for_status(raw, inputs)

    def trace() -> Array:
        rows = np.empty((TRACE_ROWS, 6))
        return rows[: run(inputs, rows, _EMPTY)[11]]

    path = _record(run, inputs) if record else None
    return Solution(raw, inputs, trace, path, surface_velocity)


def _record(run: Run, inputs: Inputs) -> Path:
    points = np.empty((1024, 6))
    while True:
        count = run(inputs, _EMPTY, points)[12]
        if count < len(points):
            break
        points = np.empty((4 * len(points), 6))
    points = points[:count]
    return Path(
        normal_impulse=points[:, 0].copy(),
        velocity=points[:, 1:4].copy(),
        impulse=points[:, [4, 5, 0]],
    )


def solve_impact(
    problem: ImpactProblem, method: str = "exact", record: bool = False, **options: Any
) -> Solution:
    """Resolve one frictional impact along its path.

    Args:
        problem: W, v, μ, e and the restitution law.
        method: Name of a registered method; ``"exact"`` reaches rounding error.
        record: Whether to record the path.
        **options: The method's own keywords, such as ``steps=`` of ``"euler"``.

    Returns:
        The `Solution` in contact axes.

    Raises:
        InputError: A number of the problem is unusable; the message names it.
        UnknownNameError: No such law, method or option.
        UnstoppableApproachError: The contact approaches and cannot be stopped.
        LawError: The mechanism cannot reach what the law asks for.
    """
    v1, v2, v3 = float_array("velocity", problem.velocity, (3,)).tolist()
    try:
        mu, e = float(problem.friction), float(problem.restitution)
    except (TypeError, ValueError):
        raise InputError(
            f"friction, restitution: numbers expected, not {problem.friction!r}, {problem.restitution!r}",
            field="friction",
            value=(problem.friction, problem.restitution),
        ) from None
    upper = delassus_upper(problem.delassus)
    inputs = (*upper, v1, v2, v3, mu, e, law_code(problem.law))
    return solve_inputs(inputs, method, record, problem.surface_velocity, **options)
