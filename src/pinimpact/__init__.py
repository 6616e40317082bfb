"""Rigid-body impacts of robots with friction, and simulation of motions with contact.

`impact` returns the joint velocities after an impact, the impulse, the segments of slip and stick, and the
work; `simulate` the motion of a `Scene`; `solve_impact` solves an impact without a robot.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .contact_space.batch import BatchSolution, solve_impacts
    from .contact_space.derivatives import Boundary, Derivatives
    from .contact_space.laws import LAWS
    from .contact_space.many_solution import ManyPath, ManySolution
    from .contact_space.methods import METHODS, Method, register_method
    from .contact_space.problem import ImpactProblem
    from .contact_space.simultaneous import POLICIES
    from .contact_space.solution import Path, Segment, Solution, Work
    from .contact_space.solve import solve_impact
    from .errors import (
        BoundReachedWarning,
        InputError,
        JointLimitWarning,
        LawError,
        ModelError,
        PinimpactError,
        SimulationError,
        SteppedWarning,
        UnknownNameError,
        UnstoppableApproachError,
    )
    from .geometry.plane import Plane
    from .geometry.sphere import Sphere
    from .robot.batch import Hits, impacts
    from .robot.contact import Contact
    from .robot.derivatives import ImpactDerivatives, impact_derivatives, impact_rows
    from .robot.held import HeldContactWarning
    from .robot.inverse_kinematics import place_in_contact
    from .robot.loading import load_robot
    from .robot.many_derivatives import ManyImpactDerivatives
    from .robot.many_impact import ManyHit
    from .robot.matrices import ContactMatrices, contact_matrices
    from .robot.pinocchio_bridge import PinocchioLayoutWarning
    from .robot.robot_impact import Hit, impact
    from .robot.solids import Box, Shape
    from .scene.controls import JointPD
    from .scene.events import Event
    from .scene.records import Sensitivity
    from .scene.saltation import saltation_matrix
    from .scene.scene import Scene
    from .scene.sensitivities import Linearization
    from .scene.simulation import simulate
    from .scene.stepper import Stepper
    from .scene.trajectory import Trajectory
    from .status import EFFECTS, Flag, Status
    from .studies.ensemble_result import Ensemble
    from .studies.ensembles import ensemble
    from .visual.html_replay import replay

__version__ = "0.1.0"

__all__ = [
    "EFFECTS",
    "LAWS",
    "METHODS",
    "POLICIES",
    "BatchSolution",
    "BoundReachedWarning",
    "Boundary",
    "Box",
    "Contact",
    "ContactMatrices",
    "Derivatives",
    "Ensemble",
    "Event",
    "Flag",
    "HeldContactWarning",
    "Hit",
    "Hits",
    "ImpactDerivatives",
    "ImpactProblem",
    "InputError",
    "JointLimitWarning",
    "JointPD",
    "LawError",
    "Linearization",
    "ManyHit",
    "ManyImpactDerivatives",
    "ManyPath",
    "ManySolution",
    "Method",
    "ModelError",
    "Path",
    "PinimpactError",
    "PinocchioLayoutWarning",
    "Plane",
    "Scene",
    "Segment",
    "Sensitivity",
    "Shape",
    "SimulationError",
    "Solution",
    "Sphere",
    "Status",
    "SteppedWarning",
    "Stepper",
    "Trajectory",
    "UnknownNameError",
    "UnstoppableApproachError",
    "Work",
    "contact_matrices",
    "ensemble",
    "impact",
    "impact_derivatives",
    "impact_rows",
    "impacts",
    "load_robot",
    "place_in_contact",
    "register_method",
    "replay",
    "saltation_matrix",
    "simulate",
    "solve_impact",
    "solve_impacts",
]

_HOMES = {
    "contact_space.batch": ("BatchSolution", "solve_impacts"),
    "robot.batch": ("Hits", "impacts"),
    "robot.contact": ("Contact",),
    "robot.derivatives": ("ImpactDerivatives", "impact_derivatives", "impact_rows"),
    "robot.many_derivatives": ("ManyImpactDerivatives",),
    "robot.matrices": ("ContactMatrices", "contact_matrices"),
    "robot.pinocchio_bridge": ("PinocchioLayoutWarning",),
    "errors": (
        "BoundReachedWarning",
        "InputError",
        "JointLimitWarning",
        "LawError",
        "ModelError",
        "PinimpactError",
        "SimulationError",
        "SteppedWarning",
        "UnknownNameError",
        "UnstoppableApproachError",
    ),
    "contact_space.derivatives": ("Boundary", "Derivatives"),
    "contact_space.methods": ("METHODS", "Method", "register_method"),
    "contact_space.laws": ("LAWS",),
    "status": ("EFFECTS", "Flag", "Status"),
    "contact_space.problem": ("ImpactProblem",),
    "robot.held": ("HeldContactWarning",),
    "robot.many_impact": ("ManyHit",),
    "robot.robot_impact": ("Hit", "impact"),
    "robot.inverse_kinematics": ("place_in_contact",),
    "robot.loading": ("load_robot",),
    "geometry.plane": ("Plane",),
    "robot.solids": ("Box", "Shape"),
    "geometry.sphere": ("Sphere",),
    "scene.controls": ("JointPD",),
    "scene.events": ("Event",),
    "scene.saltation": ("saltation_matrix",),
    "scene.scene": ("Scene",),
    "scene.records": ("Sensitivity",),
    "scene.sensitivities": ("Linearization",),
    "scene.simulation": ("simulate",),
    "contact_space.solution": ("Path", "Segment", "Solution", "Work"),
    "contact_space.many_solution": ("ManyPath", "ManySolution"),
    "contact_space.simultaneous": ("POLICIES",),
    "contact_space.solve": ("solve_impact",),
    "scene.stepper": ("Stepper",),
    "scene.trajectory": ("Trajectory",),
    "studies.ensembles": ("ensemble",),
    "studies.ensemble_result": ("Ensemble",),
    "visual.html_replay": ("replay",),
}
_PACKAGES = ("studies", "visual")
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that a script loads only what it calls."""
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'pinimpact' has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted((*__all__, *_PACKAGES))
