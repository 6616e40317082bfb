"""Plots of impacts and motions, one function each; matplotlib is imported when one is called.

Each takes ``ax=``, the axes to draw into, makes axes of its own without it, and returns them. Legends stand
beside or below the axes.
"""

from __future__ import annotations

from .figures import energy_figure, forces_figure, impact_figure, save_figure
from .impacts import energy_ledger, hodograph, impulses, velocities
from .impulse_space import impulse_space
from .motions import energy, forces, gaps, modes, overview
from .regime_map import regime_map

__all__ = [
    "energy",
    "energy_figure",
    "energy_ledger",
    "forces",
    "forces_figure",
    "gaps",
    "hodograph",
    "impact_figure",
    "impulse_space",
    "impulses",
    "modes",
    "overview",
    "regime_map",
    "save_figure",
    "velocities",
]
