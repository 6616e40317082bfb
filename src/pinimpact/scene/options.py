"""Tolerances and bounds of an integration."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..checks import in_short, real_number
from ..contact_space.methods import LEAST_RTOL, checked_rtol
from ..errors import InputError
from ._kernels.tolerances import ATOL, DT, RTOL


class Options(NamedTuple):
    """Tolerances and bounds of a motion; see `simulate`."""

    rtol: float = RTOL
    atol: float = ATOL
    max_step: float | None = None
    max_impacts: float = 100_000
    dt: float = DT

    def checked(self) -> Options:
        """Return the checked options as floats, since kernels are compiled by type.

        Raises:
            InputError: A value that is out of range or not a number.
        """
        numbers = {name: value for name, value in self._asdict().items() if value is not None}
        check_numbers(**numbers)
        return self._replace(**{name: float(value) for name, value in numbers.items()})


def check_numbers(**numbers: float) -> None:
    """Check that options are positive; durations, step sizes and `atol` finite; `rtol` in its range.

    Raises:
        InputError: A value that is out of range or not a number.
    """
    for name, value in numbers.items():
        if name == "rtol":
            checked_rtol(value, LEAST_RTOL)
        number = real_number(name, value)
        if np.ndim(value) > 0:
            raise InputError(f"{name}: {in_short(value)} given; a number is expected", value=value)
        if not number > 0.0 or (name in ("duration", "dt", "atol") and not math.isfinite(number)):
            raise InputError(f"{name}: {number!r} given, a number > 0 expected", value=value)
        if name == "max_impacts" and number != math.inf and number != int(number):
            raise InputError(
                f"max_impacts: {number!r} given, a whole number expected", field=name, value=value
            )
