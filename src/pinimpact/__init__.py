"""What happens to a robot in the instant in which it hits something with friction.

A URDF goes in through Pinocchio; out come the post-impact velocity, the impulse, and the story in
between: slip, stick, slip that turns or resumes, compression, restitution, and where every joule went.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .batch import BatchSolution, solve_impacts
    from .contacts import Contact, ContactMatrices, contact_matrices
    from .errors import (
        InputError,
        LawError,
        ModelError,
        PinimpactError,
        SimulationError,
        UnknownNameError,
        UnstoppableApproachError,
    )
    from .methods import METHODS, Method, register_method
    from .outcome import EFFECTS, LAWS, Flag, Status
    from .problem import ImpactProblem
    from .reset import HeldContactWarning, Hit, Hits, impact, impacts
    from .robots import load_robot
    from .scene import Scene
    from .simulation import simulate
    from .solution import Path, Segment, Solution, Work
    from .solvers import solve_impact
    from .surfaces import Plane
    from .trajectory import Trajectory
    from .visual.html import replay

__version__ = "0.1.0"

__all__ = [
    "EFFECTS",
    "LAWS",
    "METHODS",
    "BatchSolution",
    "Contact",
    "ContactMatrices",
    "Flag",
    "HeldContactWarning",
    "Hit",
    "Hits",
    "ImpactProblem",
    "InputError",
    "LawError",
    "Method",
    "ModelError",
    "Path",
    "PinimpactError",
    "Plane",
    "Scene",
    "Segment",
    "SimulationError",
    "Solution",
    "Status",
    "Trajectory",
    "UnknownNameError",
    "UnstoppableApproachError",
    "Work",
    "contact_matrices",
    "impact",
    "impacts",
    "load_robot",
    "register_method",
    "replay",
    "simulate",
    "solve_impact",
    "solve_impacts",
]

_HOMES = {
    "batch": ("BatchSolution", "solve_impacts"),
    "contacts": ("Contact", "ContactMatrices", "contact_matrices"),
    "errors": (
        "InputError",
        "LawError",
        "ModelError",
        "PinimpactError",
        "SimulationError",
        "UnknownNameError",
        "UnstoppableApproachError",
    ),
    "methods": ("METHODS", "Method", "register_method"),
    "outcome": ("EFFECTS", "LAWS", "Flag", "Status"),
    "problem": ("ImpactProblem",),
    "reset": ("HeldContactWarning", "Hit", "Hits", "impact", "impacts"),
    "robots": ("load_robot",),
    "scene": ("Scene",),
    "simulation": ("simulate",),
    "solution": ("Path", "Segment", "Solution", "Work"),
    "solvers": ("solve_impact",),
    "surfaces": ("Plane",),
    "trajectory": ("Trajectory",),
    "visual.html": ("replay",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that a script loads only what it calls."""
    if name not in _HOME:
        raise AttributeError(f"module 'pinimpact' has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
