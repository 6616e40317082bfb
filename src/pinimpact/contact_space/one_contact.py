"""Solution of an impact at one contact, and the errors of problems without solution."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ..errors import InputError, LawError, PinimpactError, UnstoppableApproachError
from ..status import Status
from .inputs import ENTRY, NO_ROWS, Inputs
from .laws import ALWAYS_MET, LAWS
from .methods import METHODS, Run, check_options, load_method
from .problem import ZERO
from .solution import Path, Solution


def raise_for_status(status: Status, figure: float, inputs: Inputs) -> None:
    """Raise the error for a status without solution; for `figure` see `_kernels.ending.Result`."""
    v3, mu, e = inputs[8], inputs[9], inputs[10]
    if status == Status.INVALID_NUMBERS:
        for name, values in (("delassus", inputs[:6]), ("velocity", inputs[6:9])):
            if not np.isfinite(values).all():
                raise InputError(f"{name}: {values} contains numbers that are not finite", value=values)
        if not (0.0 <= mu < float("inf")):
            raise InputError(f"friction: {mu!r} given, a finite number ≥ 0 expected", value=mu)
        raise InputError(f"restitution: {e!r} given, a number from 0 to 1 expected", value=e)
    if status == Status.INDEFINITE_DELASSUS:
        norm = float(np.linalg.norm(np.array(inputs[:6])[ENTRY], 2))
        raise InputError(
            f"delassus: W must be positive semidefinite, but its smallest eigenvalue is {figure:.6g}, "
            f"below −{ZERO * norm:.3g} (32 ε ‖W‖)",
            value=inputs[:6],
        )
    if status == Status.UNSTOPPABLE:
        why = "The mechanism cannot move along the normal; choose another contact frame, unlock a joint"
        if inputs[5] > ZERO * max(map(abs, inputs[:6])):
            why = "Friction keeps the normal velocity from rising; give less friction"
        raise UnstoppableApproachError(
            f"velocity: the contact approaches at {v3:.6g} m/s and no normal impulse can stop it: "
            f"v₃ stays at {figure:.6g} m/s (c = hᵀM⁻¹h = {inputs[5]:.6g}). {why}, or correct v",
            value=v3,
        )
    if status == Status.LAW_UNREACHABLE:
        law, others = LAWS[inputs[11]], " or ".join(map(repr, ALWAYS_MET))
        raise LawError(
            f"law: {law!r} with e = {e:.6g} cannot be met: v₃ converges to a limit below it "
            f"({figure:.6g} missing); use {others}, or a smaller restitution",
            value=law,
        )
    if status == Status.OUT_OF_RANGE:
        raise InputError(
            "delassus, velocity: the result is outside the range of double precision; choose other units",
            field="delassus",
            value=inputs[:9],
        )
    raise PinimpactError(f"{status} Please report this problem, {inputs}")


def solve_inputs(
    inputs: Inputs,
    method: str = "exact",
    record: bool = False,
    surface_velocity: Any = (0.0, 0.0, 0.0),
    **options: Any,
) -> Solution:
    """Solve a problem given as `Inputs`; other arguments as for `solve_impact`."""
    run = load_method(method)
    if options:
        check_options(method, METHODS[method].options, options)
        run = partial(run, **options)
    result = run(inputs, NO_ROWS, NO_ROWS)
    if result[0] > Status.LOCKED:
        raise_for_status(Status(result[0]), result[10], inputs)
    path = _record(run, inputs) if record else None
    return Solution(result, inputs, method, options, path, surface_velocity)


def _record(run: Run, inputs: Inputs) -> Path:
    points = np.empty((1024, 6))
    while True:
        count = run(inputs, NO_ROWS, points)[12]
        if count < len(points):
            break
        points = np.empty((4 * len(points), 6))
    points = points[:count]
    return Path(
        normal_impulse=points[:, 0].copy(), velocity=points[:, 1:4].copy(), impulse=points[:, [4, 5, 0]]
    )
