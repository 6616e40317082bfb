"""The contact impulses of a time step. (theory.md, 16)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, declared
from ..._compile.jit import jit
from ..._numeric.coulomb_problem import solve_compliant, solve_coulomb
from ..._numeric.loops import flags
from ..._numeric.proximal_newton import SYSTEM, solve_velocities


@declared(FLOAT_ROWS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, result=float)
@jit
def step_impulses(delassus, free, friction, lower, upper, compliance, impulse):
    """Find the impulses of a step; return how far they are from Coulomb's law, in parts of `free`.

    Of several solutions the limit of small compliances is taken. (11.5)

    Args:
        delassus: (n, n) W of the contacts, three rows (t₁, t₂, n) each, then of scalar rows.
        free: (n,) velocities at the end of the step without impulses, and what gaps leave of them.
        friction: (nc,) coefficients of friction.
        lower, upper: (n − 3 nc,) bounds of the scalar rows.
        compliance: (nc,) relative compliances of the contacts; none where solutions are unique.
        impulse: (n,) where to begin; takes the impulses.
    """
    nc = len(friction)
    velocity, least, held = np.zeros((nc, 2)), np.zeros(nc), flags(nc, False)
    if len(compliance) > 0:
        return solve_compliant(
            delassus, free, velocity, friction, least, held, lower, upper, impulse, compliance
        )
    return solve_coulomb(delassus, free, velocity, friction, least, held, lower, upper, impulse)


@declared(*SYSTEM, result=float)
@jit
def redundant_impulses(mass, inverse, jacobian, free, friction, lower, upper, compliance, impulse):
    """Do so where there are more rows than velocities; arguments as of `solve_velocities`."""
    return solve_velocities(mass, inverse, jacobian, free, friction, lower, upper, compliance, impulse)
