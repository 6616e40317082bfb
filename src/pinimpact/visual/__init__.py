"""Plots and replays of impacts and motions; matplotlib and meshcat are imported only when used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_MODULES = ("html_replay", "plots", "work_precision")


def __getattr__(name: str) -> Any:
    """Import a module on first use, so that ``pinimpact.visual.plots`` works without a further import."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")


def __dir__() -> list[str]:
    return sorted(_MODULES)
