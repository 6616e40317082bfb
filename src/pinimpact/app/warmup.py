"""Compile all kernels in advance: for a container image, a cluster, or a first run without delay."""

from __future__ import annotations

import importlib
import pkgutil

import numpy as np
import pinocchio as pin

import pinimpact

from .._compile.jit import compile_all, is_declared, kept_in
from ..contact_space._kernels.butcher import RK4
from ..contact_space._kernels.timing import repeat_exact, repeat_stepping
from ..contact_space.problem import ImpactProblem
from ..contact_space.solve import solve_impact
from ..geometry.plane import Plane
from ..robot.contact import Contact
from ..robot.inverse_kinematics import place_in_contact
from ..robot.matrices import contact_matrices
from ..robot.robot_impact import impact


def _one_joint() -> None:
    """Compile for a robot with one velocity, whose (6, 1) Jacobian has its own type in numba."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3(np.eye(3), np.array([0, 1.0, 0]))
    )
    model.addJointFrame(joint)
    data, contact = model.createData(), Contact("hinge", Plane(), offset=(0.0, 1.0, 0.0))
    q = place_in_contact(model, data, [0.1], contact)
    contact_matrices(model, data, q, contact)
    impact(model, data, q, [-1.0], contact)


def warm_up() -> str | None:
    """Compile or load all kernels of impacts, scenes and `cost`.

    Returns the common folder of their caches; None if no folder is writable, so that every process compiles.
    """
    modules = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(pinimpact.__path__, "pinimpact.")
        if "._kernels." in module.name or "._numeric." in module.name
    ]
    kernels = dict.fromkeys(item for module in modules for item in vars(module).values() if is_declared(item))
    compile_all(*((kernel,) for kernel in kernels))
    problem = ImpactProblem([[2, 0, 0.5], [0, 3, 0.4], [0.5, 0.4, 1]], (1, 0.5, -1), 0.3, 0.5)
    solve_impact(problem, "rk4")  # the type of its table is in no declared signature
    numbers = (*11 * (1.0,), 0)
    compile_all((repeat_exact, 1, *numbers), (repeat_stepping, 1, *numbers, RK4, 1, 0.0))  # for `cost`
    _one_joint()
    return kept_in(list(kernels))
