"""How many examples a property is tried on."""

from __future__ import annotations

from hypothesis import settings


def examples(count: int) -> settings:
    """Return settings for `count` examples, or as many times more as the profile in use has of its own.

    The profiles are those of conftest.py: "default" draws the same examples in every run, "random" new ones
    in every run, and ten times as many.
    """
    return settings(max_examples=count * settings.default.max_examples // 100)
