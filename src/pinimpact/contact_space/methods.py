"""The registry of methods for one contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import choice, real_number, whole_number
from ..errors import InputError, PinimpactError, UnknownNameError
from ..status import Status
from .inputs import Array, Inputs

if TYPE_CHECKING:
    from ._kernels.butcher import Tableau

Raw = tuple[Any, ...]
Run = Callable[..., Raw]
"""run(inputs, trace, path, **options) -> the thirteen values of `_kernels.ending.Result`."""


@dataclass(frozen=True, slots=True)
class Method:
    """A method of `solve_impact`.

    Attributes:
        load: Returns the function of the method; called on first use.
        summary: One line of description.
        options: Names of its keyword options and their defaults.
    """

    load: Callable[[], Run] = field(repr=False)
    summary: str
    options: Mapping[str, Any] = field(default_factory=dict)


_methods: dict[str, Method] = {}
_loaded: dict[str, Run] = {}

METHODS: Mapping[str, Method] = MappingProxyType(_methods)
"""The registered methods by name; `register_method` adds to them."""


def register_method(name: str, method: Method, *, replace: bool = False) -> None:
    """Make `method` available to `solve_impact` under `name`.

    Args:
        name: The name for ``method=`` of `solve_impact`.
        method: The method.
        replace: Whether to replace a registered method of that name. ``"exact"`` cannot be replaced: impacts
            of robots, batches and scenes run its kernel.

    Raises:
        InputError: The name exists already, and `replace` is False.
    """
    if name == "exact" and name in _methods:
        raise InputError(
            'name: "exact" cannot be replaced, because robots and scenes use it; choose another name',
            value=name,
        )
    if name in _methods and not replace:
        raise InputError(
            f"name: a method {name!r} is registered already; choose another name, or set replace=True",
            value=name,
        )
    _methods[name] = method
    _loaded.pop(name, None)


def load_method(name: str) -> Run:
    """Return the function that runs a registered method, or raise `UnknownNameError`."""
    if name not in tuple(_loaded):
        _loaded[name] = find_method(name).load()
    return _loaded[name]


def find_method(name: str) -> Method:
    """Return a registered method, or raise `UnknownNameError`."""
    return _methods[choice("method", name, _methods, "a registered method")]


def check_options(owner: str, known: Mapping[str, Any], options: Mapping[str, Any]) -> None:
    """Raise `UnknownNameError` for an unknown option of a method or policy."""
    for name, value in options.items():
        if name not in known:
            takes = ", ".join(known) or "no options"
            raise UnknownNameError(f"{name}: unknown option of {owner!r}, which takes {takes}", value=value)


def _load_exact() -> Run:
    from ._kernels.path import SCRATCH, solve_into

    def run(inputs: Inputs, trace: Array, path: Array) -> Raw:
        result: Raw = solve_into(*inputs, np.empty(SCRATCH), trace, path)
        return result

    return run


def checked_rtol(rtol: Any, least: float) -> float:
    """Return `rtol` as a float, or raise `InputError`."""
    number = real_number("rtol", rtol)
    if not least <= number <= LARGEST_RTOL:
        raise InputError(
            f"rtol: {number!r} given, a number from {least:g} to {LARGEST_RTOL:g} expected", value=rtol
        )
    return number


def _step(inputs: Inputs, table: Tableau, steps: int, rtol: float, trace: Array, path: Array) -> Raw:
    from ._kernels.stepping import solve_stepping

    result: Raw = solve_stepping(*inputs, table, steps, rtol, trace, path)
    if result[0] == Status.NOT_CONVERGED:
        name, value = ("rtol", rtol) if rtol > 0.0 else ("steps", steps)
        raise PinimpactError(
            f"{name}: with {value:g} the impact takes too many steps; slip lasts far longer than "
            f'|v₃|/c (v₃ = {inputs[8]:.6g} m/s, c = {inputs[5]:.6g}) or creeps; use "exact"',
            value=value,
        )
    return result


def _load_steps(table: str, default: int) -> Run:
    from ._kernels import butcher

    def run(inputs: Inputs, trace: Array, path: Array, steps: int = default) -> Raw:
        count = whole_number("steps", steps, 1, MOST_STEPS)
        return _step(inputs, getattr(butcher, table), count, 0.0, trace, path)

    return run


RTOL, LEAST_RTOL, LARGEST_RTOL = 1e-8, 3e-14, 0.1
"""Relative tolerances of adaptive steps: the default, the smallest that rounding allows, and the largest for
which error estimates are meaningful."""

MOST_STEPS = 10**9
FIRST_STEPS = 10
"""The scale of P₃ over the first step of the adaptive method."""


def _load_adaptive() -> Run:
    from ._kernels.butcher import DORMAND_PRINCE

    def run(inputs: Inputs, trace: Array, path: Array, rtol: float = RTOL) -> Raw:
        return _step(inputs, DORMAND_PRINCE, FIRST_STEPS, checked_rtol(rtol, LEAST_RTOL), trace, path)

    return run


def _load_solve_ivp() -> Run:
    from .scipy_baseline import solve_with_scipy

    def run(inputs: Inputs, trace: Array, path: Array, rtol: float = RTOL) -> Raw:
        return solve_with_scipy(inputs, trace, path, checked_rtol(rtol, LEAST_RTOL))

    return run


register_method("exact", Method(_load_exact, "power series and closed forms, to rounding error"))
for _name, _table, _steps, _summary in (
    ("euler", "EULER", 1000, "the paper's scheme: Euler steps in P₃, bisected at events"),
    ("rk4", "RK4", 100, "Runge–Kutta steps of order 4 in P₃, bisected at events"),
):
    register_method(_name, Method(partial(_load_steps, _table, _steps), _summary, {"steps": _steps}))
register_method(
    "adaptive", Method(_load_adaptive, "Dormand–Prince 5(4) in P₃ with chosen steps", {"rtol": RTOL})
)
register_method(
    "solve_ivp", Method(_load_solve_ivp, "scipy's solve_ivp with events, for comparison only", {"rtol": RTOL})
)
