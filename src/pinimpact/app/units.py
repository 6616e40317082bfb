"""Quantities in files: plain numbers in SI units, or text such as "30 deg" and "5 cm"."""

from __future__ import annotations

import math
from typing import Any

UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "speed": {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001},
    "angular speed": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "time": {"s": 1.0, "ms": 0.001, "min": 60.0},
    "acceleration": {"m/s^2": 1.0},
}
"""The units of each kind of quantity, in SI units; the first applies to numbers without a unit."""


def quantity(value: Any, kind: str) -> float:
    """Return a quantity of a kind in SI units, or raise `ValueError`: not finite, or of another unit."""
    units = UNITS[kind]
    base = next(iter(units))
    number, unit = value, base
    what = f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
    if isinstance(value, str):
        number, _, unit = value.strip().partition(" ")
        unit = unit.strip()
    if isinstance(number, bool) or (unit and unit not in units):
        raise ValueError(f"{value!r} is not {what}; its units are {', '.join(units)}")
    try:
        found = float(number) * units[unit]
    except (KeyError, TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise ValueError(
            f"{value!r} is not {what}; write a number of {base}, or text such as '1 {unit or base}'"
        )
    return found
