"""Rigid-body impacts of robots with friction, and simulation of motions with contact.

`impact` returns the joint velocities after an impact, the impulse, the segments of slip and stick, and the
work; `simulate` the motion of a `Scene`; `solve_impact` solves an impact without a robot.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .contact_space.batch import BatchSolution as BatchSolution, solve_impacts as solve_impacts
    from .contact_space.derivatives import Boundary as Boundary, Derivatives as Derivatives
    from .contact_space.laws import LAWS as LAWS
    from .contact_space.many_solution import ManyPath as ManyPath, ManySolution as ManySolution
    from .contact_space.methods import (
        METHODS as METHODS,
        Method as Method,
        register_method as register_method,
    )
    from .contact_space.problem import ImpactProblem as ImpactProblem
    from .contact_space.simultaneous import POLICIES as POLICIES
    from .contact_space.solution import Path as Path, Segment as Segment, Solution as Solution, Work as Work
    from .contact_space.solve import solve_impact as solve_impact
    from .errors import (
        BoundReachedWarning as BoundReachedWarning,
        InertiaWarning as InertiaWarning,
        InputError as InputError,
        JointLimitWarning as JointLimitWarning,
        LawError as LawError,
        ModelError as ModelError,
        PinimpactError as PinimpactError,
        SimulationError as SimulationError,
        SteppedWarning as SteppedWarning,
        UnknownNameError as UnknownNameError,
        UnstoppableApproachError as UnstoppableApproachError,
    )
    from .geometry.plane import Plane as Plane
    from .geometry.sphere import Sphere as Sphere
    from .robot.batch import Hits as Hits, impacts as impacts
    from .robot.contact import Contact as Contact
    from .robot.derivatives import (
        ImpactDerivatives as ImpactDerivatives,
        impact_derivatives as impact_derivatives,
        impact_rows as impact_rows,
    )
    from .robot.held import HeldContactWarning as HeldContactWarning
    from .robot.inverse_kinematics import place_in_contact as place_in_contact
    from .robot.loading import load_robot as load_robot
    from .robot.many_derivatives import ManyImpactDerivatives as ManyImpactDerivatives
    from .robot.many_impact import ManyHit as ManyHit
    from .robot.matrices import ContactMatrices as ContactMatrices, contact_matrices as contact_matrices
    from .robot.pinocchio_bridge import PinocchioLayoutWarning as PinocchioLayoutWarning
    from .robot.robot_impact import Hit as Hit, impact as impact
    from .robot.solids import Box as Box, Shape as Shape
    from .scene.controls import JointPD as JointPD
    from .scene.events import Event as Event
    from .scene.records import Sensitivity as Sensitivity
    from .scene.single_saltation import saltation_matrix as saltation_matrix
    from .scene.scene import Scene as Scene
    from .scene.sensitivities import Linearization as Linearization
    from .scene.simulation import simulate as simulate
    from .scene.stepper import Stepper as Stepper
    from .scene.trajectory import Trajectory as Trajectory
    from .status import EFFECTS as EFFECTS, Flag as Flag, Status as Status
    from .studies.ensemble_result import Ensemble as Ensemble
    from .studies.ensembles import ensemble as ensemble
    from .visual.html_replay import replay as replay

__version__ = "0.1.0"

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
        "InertiaWarning",
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
    "scene.single_saltation": ("saltation_matrix",),
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

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that a script loads only the modules that it needs."""
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'pinimpact' has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted((*__all__, *_PACKAGES))
