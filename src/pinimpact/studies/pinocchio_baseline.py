"""Pinocchio's constraint solvers for the same W, v and μ, which use another model of the impact.

They compute one impulse for the whole impact, with friction opposite to the *final* slip and no restitution.
The result agrees with the end of the path if slip keeps its direction, but not if it turns.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import COMPUTED
from ..checks import finite_array
from ..contact_space.solution import Array
from ..errors import UnknownNameError

SOLVERS = ("admm", "pgs")
MAX_ITERATIONS = 100_000


def solve_constraint(
    delassus: ArrayLike, velocity: ArrayLike, friction: float, solver: str = "admm"
) -> tuple[Array, Array]:
    """Solve an impact with e = 0 as a complementarity problem, by Pinocchio 4.1 or later.

    Args:
        delassus: (3, 3) Delassus matrix [1/kg].
        velocity: (3,) contact velocity before the impact [m/s].
        friction: Coefficient μ.
        solver: "admm" or "pgs".

    Returns:
        v⁺ (3,) [m/s] and P (3,) [N s], NaN if the solver does not converge.
    """
    W = finite_array("delassus", delassus, (3, 3))
    v = finite_array("velocity", velocity, (3,))
    if solver not in SOLVERS:
        raise UnknownNameError(f"solver: {solver!r} is not one of {', '.join(SOLVERS)}", value=solver)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    contact = pin.PointContactConstraintModel(model, joint)
    contact.setFriction(float(friction))
    constraints, data = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    constraints.append(pin.ConstraintModel(contact))
    data.append(constraints[0].createData())
    kind = solver.upper()
    run, settings, result = (
        getattr(pin, f"{kind}{what}")(*size)
        for what, size in (("ConstraintSolver", (3,)), ("SolverSettings", ()), ("SolverResult", ()))
    )
    settings.absolute_feasibility_tol = settings.relative_feasibility_tol = COMPUTED
    settings.absolute_complementarity_tol = settings.relative_complementarity_tol = COMPUTED
    settings.max_iterations, settings.solve_ncp = MAX_ITERATIONS, True
    operator = pin.DelassusOperatorDense(np.asfortranarray(W))
    if not run.solve(operator, v.copy(), constraints, data, settings, result):
        return np.full(3, np.nan), np.full(3, np.nan)
    impulse = np.array(result.retrieveConstraintImpulses()).ravel()
    return v + W @ impulse, impulse
