"""Types of operators on numbers, which are determined once."""

from __future__ import annotations

from typing import Any

from numba import types

_known: dict[tuple[Any, tuple[Any, ...]], Any] = {}


class OperatorTypes:
    """A typing context that keeps the types of calls of numba's own functions with numbers.

    For each operator of a kernel, numba tries all implementations, among them those for arrays, sets and
    strings. That takes an eighth of the time of a compilation.

    Args:
        context: The typing context of numba that determines the types.
    """

    def __init__(self, context: Any) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def resolve_function_type(self, function: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Return the signature of a call."""
        numbers = all(isinstance(one, types.Number | types.Boolean) for one in arguments)
        if named or not (numbers and isinstance(function, types.Function)):
            return self._context.resolve_function_type(function, arguments, named)
        call = function, arguments
        if call not in _known:
            _known[call] = self._context.resolve_function_type(function, arguments, named)
        return _known[call]
