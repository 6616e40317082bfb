"""Samples of cases, and numbers of examples of hypothesis."""

from __future__ import annotations

import pytest
from hypothesis import settings


def examples(count: int) -> settings:
    """Return settings for `count` examples, multiplied by the examples of the current profile over 100.

    The profiles are in conftest.py: "default" draws the same examples in each run, "random" ten times as many
    new ones.
    """
    return settings(max_examples=count * settings.default.max_examples // 100)


def one_of_each(first, second):
    """Return all pairs; those beyond one for each value of the longer sequence, in turn, are exhaustive."""
    shorter, more = min(len(first), len(second)), pytest.mark.exhaustive
    return [
        pytest.param(x, y, marks=() if (i + j) % shorter == 0 else more)
        for i, x in enumerate(first)
        for j, y in enumerate(second)
    ]
