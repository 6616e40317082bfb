"""How v°, W and the forces of a robot's impact change with the configuration. (derivatives.md, 5)"""

from __future__ import annotations

from ..._compile.declared import FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, declared
from ..._compile.jit import jit
from .configuration_slopes import force_slopes, mass_slopes, turn_slopes, velocity_slopes


@declared(
    *(FLOAT_ROWS, INTEGERS, INTEGERS, FLOAT_ROWS, INTEGERS, FLOATS, FLOAT_ROWS, FLOATS, FLOATS, FLOATS),
    *(FLOAT_ROWS, FLOAT_STACK, FLOAT_STACK, FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS),
)
@jit
def impact_slopes(
    J, joint, parent, inertia, ends, at, y, v, impulse, push, scratch, masses, moved, data, forces, turned
):
    """Fill how the data of an impact in contact space change with q, and its forces. (D17)

    Args:
        J, joint, parent, inertia, ends, at: As in `mass_slopes` and `velocity_slopes`.
        y: (3, nv) q̇ per unit impulse along each contact axis.
        v: (nv,) before the impact.
        impulse, push: (3,) P in contact axes and in the world.
        scratch: (2 joints, 6).
        masses: (3, nv, nv) scratch.
        moved: (3, 3, nv) scratch.
        data: (9, nv) receives ∂v°/∂q and the slopes of w₁₁, w₁₂, w₁₃, w₂₂, w₂₃, w₃₃.
        forces: (nv, nv) receives ∂(JᵀP)/∂q − P·D(y).
        turned: (3, nv) receives how P, fixed in the contact axes, changes in the world.
    """
    nv = len(v)
    velocity_slopes(J, joint, parent, ends, at, v, True, scratch, data[:3])
    for i in range(3):
        mass_slopes(J, joint, parent, inertia, y[i], scratch, masses[i])
        velocity_slopes(J, joint, parent, ends, at, y[i], False, scratch, moved[i])
    row = 3
    for i in range(3):
        for j in range(i, 3):
            for k in range(nv):
                data[row, k] = moved[i, j, k] + moved[j, i, k]
            for m in range(nv):
                for k in range(nv):
                    data[row, k] -= y[i, m] * masses[j, m, k]
            row += 1
    for m in range(nv):
        for k in range(nv):
            forces[m, k] = -(
                impulse[0] * masses[0, m, k] + impulse[1] * masses[1, m, k] + impulse[2] * masses[2, m, k]
            )
    force_slopes(J, joint, parent, ends, at, push, forces)
    turn_slopes(J, joint, parent, ends, at, push, turned)
