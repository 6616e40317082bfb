"""Plots of impacts and motions, one function each; matplotlib is imported when one is called.

Each draws into the axes ``ax=``, or into new ones, and returns them. Legends are beside or below the axes.
"""

from __future__ import annotations

from .distributions import distributions
from .figures import energy_figure, forces_figure, impact_figure, save_figure
from .motions import energy, forces, gaps, modes, overview
from .one_impact import energy_ledger, hodograph, impulses, velocities
from .regimes import regime_map
from .routh import impulse_space

__all__ = [
    "distributions",
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
