"""The numbers by which a motion is integrated."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..checks import real_number
from ..errors import InputError
from ._kernels.tolerances import ATOL, DT, RTOL

LARGEST_RTOL = 0.1
"""The largest relative tolerance of a step: beyond it the error estimate says nothing."""


class Options(NamedTuple):
    """Tolerances and bounds of a motion; see `simulate`."""

    rtol: float = RTOL
    atol: float = ATOL
    max_step: float | None = None
    max_impacts: float = 100_000
    dt: float = DT

    def checked(self) -> Options:
        """Return them as numbers of one type each, for kernels are compiled by type.

        Raises:
            InputError: A number out of its range, or none.
        """
        numbers = {name: value for name, value in self._asdict().items() if value is not None}
        check_numbers(**numbers)
        return self._replace(**{name: float(value) for name, value in numbers.items()})


def check_numbers(**numbers: float) -> None:
    """Refuse what is not above zero, not finite where it is a time to cover, or too large for a tolerance.

    Raises:
        InputError: A number out of its range, or none.
    """
    for name, value in numbers.items():
        number = real_number(name, value)
        if not number > 0.0 or (name in ("duration", "dt", "atol") and not math.isfinite(number)):
            raise InputError(f"{name}: {number!r} given, a number > 0 expected", value=value)
        if name == "rtol" and number > LARGEST_RTOL:
            raise InputError(
                f"rtol: {number!r} given, a number up to {LARGEST_RTOL} expected", field=name, value=value
            )
        if name == "max_impacts" and number != math.inf and number != int(number):
            raise InputError(
                f"max_impacts: {number!r} given, a whole number expected", field=name, value=value
            )
