"""Numbers of examples of hypothesis."""

from __future__ import annotations

from hypothesis import settings


def examples(count: int) -> settings:
    """Return settings for `count` examples, multiplied by the examples of the current profile over 100.

    The profiles are in conftest.py: "default" draws the same examples in each run, "random" ten times as many
    new ones.
    """
    return settings(max_examples=count * settings.default.max_examples // 100)
