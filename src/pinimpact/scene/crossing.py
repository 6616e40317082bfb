"""Where a function of time within a step changes its sign."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable


def crossing(value: Callable[[float], float], a: float, b: float, h: float) -> float:
    """Return where a function that is above zero at a, and not at b, ceases to be, to rounding, not before.

    By Ridders' method, to the rounding of the step's length h. The time is a where the function is not above
    zero there.
    """
    fa, fb = value(a), value(b)
    if not fa > 0.0:
        return a
    while True:
        middle = 0.5 * (a + b)
        if b - a <= sys.float_info.epsilon * (abs(b) + h) or not a < middle < b or fb == 0.0:
            return b
        fm = value(middle)
        guess = middle + (middle - a) * fm / math.sqrt(fm * fm - fa * fb)
        for t, f in ((middle, fm), (guess, None)):
            if a < t < b:
                f = value(t) if f is None else f
                if f > 0.0:
                    a, fa = t, f
                else:
                    b, fb = t, f
